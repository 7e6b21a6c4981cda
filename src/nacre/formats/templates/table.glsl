// Look-ups of nacre's tables of colour. Linear sRGB; white is (1, 1, 1). GLSL ES 3.00 and newer.
//
// Local frame: z is the normal; wi points to the light, wo to the eye, both away from the surface.
// Columns run over an angle from 0 to 90 degrees, rows (from the bottom of a picture up) over what varies over the
// surface, p from 0 to 1; a picture may hold several such bands, one above the other.
#ifdef GL_ES
precision highp float;
precision highp sampler2D;
#endif

const float NACRE_PI = 3.14159265358979;

// Colours from the EXR pictures; with NACRE_PNG from the PNG ones, which hold sRGB code values of colour / scale.
vec3 nacreDecode(vec3 c, float scale) {
#ifdef NACRE_PNG
  return scale * mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), step(0.04045, c));
#else
  return c;
#endif
}
// x and y in [0, 1], both ends at the middles of texels
vec3 nacreTexel(sampler2D picture, float x, float y, float band, float bands) {
  vec2 size = vec2(textureSize(picture, 0));
  vec2 cell = vec2(size.x, size.y / bands);
  vec2 at = clamp(vec2(x, y), 0.0, 1.0) * (cell - 1.0) + 0.5 + vec2(0.0, band * cell.y);
  return texture(picture, at / size).rgb;
}
float nacreAngle(float cosine) { return acos(clamp(cosine, 0.0, 1.0)) * (2.0 / NACRE_PI); }

// The colour at an angle of view or of incidence.
vec3 nacreColour(sampler2D picture, float cosine, float p, float band, float bands) {
  return nacreTexel(picture, nacreAngle(cosine), p, band, bands);
}

#ifdef NACRE_FACET
// ---- the interface of a film. Bands: reflected, from outside; passed, from outside; reflected, from inside at the
// conjugate angle; reflected, from inside beyond the critical angle.
uniform sampler2D nacreFacet;

vec3 nacreFacetBand(float x, float p, float band) {
  return nacreDecode(nacreTexel(nacreFacet, x, p, band, NACRE_FACET_BANDS), NACRE_FACET_SCALE);
}
// What a smooth interface reflects and passes at the cosine in the light's own medium.
void nacreInterface(float cosine, bool inside, float p, out vec3 reflected, out vec3 passed) {
  passed = vec3(0.0);
  cosine = clamp(cosine, 0.0, 1.0);
#ifdef NACRE_TRANSMITS
  float outer = inside ? sqrt(max(0.0, 1.0 - NACRE_ETA * NACRE_ETA * (1.0 - cosine * cosine))) : cosine;
  float critical = sqrt(max(0.0, 1.0 - 1.0 / (NACRE_ETA * NACRE_ETA)));
  if (inside && cosine < critical) {
    reflected = nacreFacetBand(nacreAngle(cosine / critical), p, 3.0);
    return;
  }
  reflected = nacreFacetBand(nacreAngle(outer), p, inside ? 2.0 : 0.0);
  passed = nacreFacetBand(nacreAngle(outer), p, 1.0);
#else
  reflected = inside ? vec3(0.0) : nacreFacetBand(nacreAngle(cosine), p, 0.0);
#endif
}
// The mirror-like part: what leaves in the mirror direction, and straight on (or refracted), of a smooth surface.
void nacreMirror(vec3 w, float p, out vec3 reflected, out vec3 passed) {
  nacreInterface(abs(w.z), (w.z < 0.0) != NACRE_FLIPPED, p, reflected, passed);
#ifdef NACRE_ROUGH
  reflected = vec3(0.0);  // see nacreFacets
#endif
#ifdef NACRE_BENDS
  passed = vec3(0.0);
#endif
}

#ifdef NACRE_ROUGH
const vec2 NACRE_ALPHA = vec2(NACRE_ALPHA_X, NACRE_ALPHA_Y);

float nacreDensity(vec3 m) {
  float z = max(m.z, 1e-6);
  vec2 slope = m.xy / NACRE_ALPHA;
  float s = dot(slope, slope), area = NACRE_PI * NACRE_ALPHA.x * NACRE_ALPHA.y;
#if NACRE_DISTRIBUTION == 0
  return 1.0 / (area * (s + z * z) * (s + z * z));
#elif NACRE_DISTRIBUTION == 1
  return exp(-s / (z * z)) / (area * z * z * z * z);
#else
  vec2 e = 2.0 / (NACRE_ALPHA * NACRE_ALPHA) - 2.0;
  float add = NACRE_DISTRIBUTION == 2 ? 2.0 : 1.0;
  float power = dot(e, m.xy * m.xy) / max(dot(m.xy, m.xy), 1e-12);
  return sqrt((e.x + add) * (e.y + add)) / (2.0 * NACRE_PI) * pow(z, power);
#endif
}
float nacreSmith(vec3 w) {
  vec2 flat_ = NACRE_ALPHA * w.xy;
  float tan2 = dot(flat_, flat_) / max(w.z * w.z, 1e-12);
#if NACRE_DISTRIBUTION == 0
  return 2.0 / (1.0 + sqrt(1.0 + tan2));
#else
  float a = inversesqrt(max(tan2, 1e-12));
  return a >= 1.6 ? 1.0 : min((3.535 * a + 2.181 * a * a) / (1.0 + 2.276 * a + 2.577 * a * a), 1.0);
#endif
}
float nacreMasking(vec3 wi, vec3 wo, vec3 m) {
  float im = dot(wi, m), om = dot(wo, m);
  if (im * wi.z <= 0.0 || om * wo.z <= 0.0) return 0.0;
#if NACRE_DISTRIBUTION <= 1
  return nacreSmith(wi) * nacreSmith(wo);
#else
  float least = min(abs(wi.z / im), abs(wo.z / om));
  return NACRE_DISTRIBUTION == 2 ? min(1.0, 2.0 * m.z * least) : least;
#endif
}
#ifdef NACRE_LOSS
// light scattered between facets: what they lose along wi, times what they lose along wo, times a colour
uniform sampler2D nacreLoss;
uniform sampler2D nacreExchange;

float nacreLost(vec3 w, float side) {
  float flat_ = dot(w.xy, w.xy);
  float t = flat_ > 1e-12 ? w.x * w.x / flat_ : 0.5;
  return nacreTexel(nacreLoss, sqrt(abs(w.z)), t, side, NACRE_LOSS_SIDES).r * NACRE_LOSS_SCALE;
}
vec3 nacreBetween(vec3 wi, vec3 wo, float p) {
  float i = wi.z < 0.0 ? 1.0 : 0.0, o = wo.z < 0.0 ? 1.0 : 0.0;
  if (max(i, o) >= NACRE_LOSS_SIDES) return vec3(0.0);
  float band = i * NACRE_LOSS_SIDES + o;
  vec3 tint = nacreTexel(nacreExchange, 0.0, p, band, NACRE_LOSS_SIDES * NACRE_LOSS_SIDES);
  return nacreDecode(tint, NACRE_EXCHANGE_SCALE) * nacreLost(wi, i) * nacreLost(wo, o);
}
#endif
// The rough interface, 1/sr, without the cosine; on the other side the radiance BTDF.
vec3 nacreFacets(vec3 wi, vec3 wo, float p) {
  if (NACRE_FLIPPED) { wi.z = -wi.z; wo.z = -wo.z; }
  bool insideI = wi.z < 0.0, insideO = wo.z < 0.0, same = insideI == insideO;
#ifdef NACRE_BENDS
  float ni = same || !insideI ? 1.0 : NACRE_ETA, no = same || !insideO ? 1.0 : NACRE_ETA;
#else
  if (!same) return vec3(0.0);
  float ni = 1.0, no = 1.0;
#endif
  vec3 m = ni * wi + no * wo;
  if (abs(wi.z) < 1e-5 || abs(wo.z) < 1e-5 || dot(m, m) < 1e-12) return vec3(0.0);
  m = normalize(m);
  if (m.z < 0.0) m = -m;
  float im = dot(wi, m), om = dot(wo, m);
  float spread = nacreDensity(m) * nacreMasking(wi, wo, m) / abs(wi.z * wo.z);
  vec3 reflected, passed, value;
  nacreInterface(abs(im), insideI, p, reflected, passed);
  if (same) value = 0.25 * spread * reflected;
  else value = spread * passed * abs(im * om) * no * no / max((ni * im + no * om) * (ni * im + no * om), 1e-12);
#ifdef NACRE_LOSS
  value += nacreBetween(wi, wo, p);
#endif
  return value;
}
#endif
#endif

#ifdef NACRE_LOBE
// ---- scattered light. Columns: root of the half angle; rows: difference angle over the largest possible one; bands:
// azimuth of the difference. Holds pi f 2 cos_i cos_o / (cos_i + cos_o).
uniform sampler2D nacreLobe;

vec3 nacreScattered(vec3 wi, vec3 wo) {
  if (wi.z <= 0.0 || wo.z <= 0.0) return vec3(0.0);
  vec3 h = normalize(wi + wo);
  float cosH = clamp(h.z, 0.0, 1.0), sinH = length(h.xy);
  float sinD = 0.5 * length(wi - wo), cosD = sqrt(max(0.0, 1.0 - sinD * sinD));
  float along = sinH * sinD < 1e-6 ? 0.0 : clamp(abs(wi.z - cosD * cosH) / (sinH * sinD), 0.0, 1.0);
  float x = sqrt(atan(sinH, cosH) * (2.0 / NACRE_PI));
  float y = atan(sinD, cosD) / max(atan(cosH, sinH * along), 1e-6);
  float at = acos(along) * (2.0 / NACRE_PI) * (NACRE_LOBE_SLICES - 1.0), low = min(floor(at), NACRE_LOBE_SLICES - 2.0);
  vec3 value = mix(nacreDecode(nacreTexel(nacreLobe, x, y, low, NACRE_LOBE_SLICES), NACRE_LOBE_SCALE),
                   nacreDecode(nacreTexel(nacreLobe, x, y, low + 1.0, NACRE_LOBE_SLICES), NACRE_LOBE_SCALE), at - low);
  float ci = max(wi.z, 1e-4), co = max(wo.z, 1e-4);
  return value * (ci + co) / (2.0 * NACRE_PI * ci * co);
}
#endif

// All but mirror directions, 1/sr, without the cosine; p: the number that varies over the surface, from 0 to 1.
vec3 nacreBrdf(vec3 wi, vec3 wo, float p) {
  vec3 value = vec3(0.0);
#ifdef NACRE_ROUGH
  value += nacreFacets(wi, wo, p);
#endif
#ifdef NACRE_LOBE
  value += nacreScattered(wi, wo);
#endif
  return value;
}
