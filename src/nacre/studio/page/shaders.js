// Shaders of the sphere, one triangle over the whole canvas, and of its integrated light; those of other objects are in
// meshes.js. Each looks up the colour over the angle and the blurred room; table.glsl, which precedes it, has the look-ups of
// exported tables.

export const COVER = `#version 300 es
void main() { vec2 p = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0); gl_Position = vec4(p, 0.0, 1.0); }`;

export const COMMON = `
precision highp sampler2DArray;
uniform sampler2D table;        // rows: mirror-like, glossy, spread, through, of A and of B; over the angle from 0 to 90 degrees
uniform float first;            // row of the drawn appearance
uniform sampler2DArray room;    // layers: blurred by roughness, the last for a matt white surface; then the shade of the ball and the light of the stage
uniform vec3 eye, right, up, ahead;
uniform vec2 size;
uniform vec4 foot;              // the shade on the floor: centre and half extents
uniform float alpha, gloss, layers, exposure, square;
uniform float solid;            // share of the light that the object blocks from the floor
// PLACE: surroundings with coloured light, visible behind the object; else the studio: single-channel light, a stage
#ifdef PLACE
#define LIGHT vec3
#define TINT(t) (t).rgb
#else
#define LIGHT float
#define TINT(t) (t).r
#endif
uniform LIGHT level, ground;    // radiance of a matt white floor, and the floor's reflectance
uniform vec3 lampTo, lampPower; // the small bright lamp (the sun), which is not in the room layers
uniform float lampRadius;
layout(location = 0) out vec4 colour;
const float PI = 3.14159265, BANDS = 8.0;
const vec3 CENTRE = vec3(0.0, 0.0, 1.0);
// colours of the drawn appearance over the angle (0 to 1): mirror-like, glossy, spread, through; of the graded ones at a place on the surface
#ifdef GRADED
uniform sampler2D placeMap;     // positions in the ranges of the numbers that vary over the surface
uniform float across;           // nodes along the second range
vec2 place = vec2(0.0);
void placeAtUv(vec2 uv) { place = texture(placeMap, uv).rg; }
vec3 tone(float x, float part) {
  float at = place.y * (across - 1.0), low = clamp(floor(at), 0.0, max(across - 2.0, 0.0)), row = (first + part) * across + low;
  vec3 one = nacreTexel(table, x, place.x, row, BANDS * across);
  return across < 1.5 ? one : mix(one, nacreTexel(table, x, place.x, row + 1.0, BANDS * across), at - low);
}
#else
vec3 tone(float x, float part) { return nacreTexel(table, x, 0.0, first + part, BANDS); }
#endif
// the stage of pictures (see surroundings.py): half width, front edge, start of the bend, radius, height, length
const float WIDTH = 20.0, FRONT = 16.0, BACK = 5.0, BEND = 4.5, TOP = 5.2, LENGTH = FRONT + BACK + 0.5 * PI * BEND + TOP - BEND;
const float HALF_WAY = 1.5;                              // median distance of the shade's rows in radii
const float NEAR_PLACE = 12.0, FAR_PLACE = 30.0;         // distances between which the floor blends into the surroundings

// lamp light reflected by facets of unit density; smooth facets show its disc
vec3 lampAt(vec3 d, float rough) {
  float between = acos(clamp(dot(d, lampTo), -1.0, 1.0));
  if (rough < 0.25 * lampRadius) return lampPower / (PI * lampRadius * lampRadius) * smoothstep(1.1, 0.9, between / lampRadius);
  float a2 = rough * rough + 0.125 * lampRadius * lampRadius, half2 = 0.5 + 0.5 * dot(d, lampTo), s = half2 * (a2 - 1.0) + 1.0;
  return lampPower * a2 / (4.0 * PI * s * s);
}
float layerOf(float rough) {
  return rough < 0.001 ? 0.0 : clamp(log2(rough / 0.03125) + 1.0, min(rough / 0.03125, 1.0), layers - 2.0);
}
LIGHT lookup(vec3 d, float layer) {
  float low = floor(layer);
  vec2 at = vec2(atan(d.y, d.x) / (2.0 * PI), acos(clamp(d.z, -1.0, 1.0)) / PI);
  LIGHT one = TINT(texture(room, vec3(at, low)));
  return mix(one, TINT(texture(room, vec3(at, min(low + 1.0, layers - 2.0)))), layer - low);
}
// the room and its lamp; integrated light adds the lamp separately
LIGHT roomAt(vec3 d, float rough) {
  LIGHT seen = lookup(d, layerOf(rough));
#if defined(PLACE) && !defined(GATHERS)
  seen += lampAt(d, rough);
#endif
  return seen;
}
LIGHT matt(vec3 n) {
  LIGHT seen = TINT(texture(room, vec3(atan(n.y, n.x) / (2.0 * PI), acos(clamp(n.z, -1.0, 1.0)) / PI, layers - 1.0)));
#ifdef PLACE
  seen += lampPower * max(dot(n, lampTo), 0.0) / PI;
#endif
  return seen;
}
// share of the floor's light that a ball leaves; other objects are ellipsoids
LIGHT shade(vec2 p) {
  vec2 q = (p - foot.xy) / foot.zw;
  float far = length(q);
  return mix(LIGHT(1.0), TINT(texture(room, vec3(atan(q.y, q.x) / (2.0 * PI), far / (far + HALF_WAY), layers))), solid);
}
// a point p on the floor or on the wall, with its length along the stage
LIGHT stage(vec2 p, float along, float wide) {
#ifdef PLACE
  return ground * level * shade(p);
#else
  float across = dot(p, normalize(right.xy)), half_ = 0.5 * WIDTH;
  LIGHT lit = TINT(texture(room, vec3(clamp(0.5 + across / (2.0 * WIDTH), 0.005, 0.995), along / LENGTH, layers + 1.0)));
  float from = length(vec2(across / 1.5, along - FRONT)) / 5.5, reflectance = 0.035 + 0.14 * exp(-from * from);
  if (square < 0.0) reflectance = 0.012;        // a dark stage
  if (square > 0.0) {
    vec2 at = abs(fract(vec2(across + WIDTH, along) / (2.0 * square) - 0.25) - 0.5) - 0.25;     // distance to the next edge, in periods
    vec2 sign_ = clamp(at * 2.0 * square / max(wide, 1e-4), -1.0, 1.0) * smoothstep(2.0 * square, 0.7 * square, wide);
    reflectance = 0.061 - 0.049 * sign_.x * sign_.y;
  }
  return reflectance * lit * shade(p);
#endif
}
LIGHT floorAt(vec2 p) { return stage(p, dot(p, normalize(ahead.xy)) + FRONT, 1.0); }
// Radiance from a cone about direction d, as wide as the lobe of that roughness; edges of the stage are sharp.
LIGHT trace(vec3 from, vec3 d, float rough) {
  LIGHT sky = roomAt(d, rough);
#ifdef PLACE
  if (d.z > -1e-3) return sky;
  vec2 hit = from.xy + d.xy * (from.z / -d.z);
  return mix(stage(hit, 0.0, 0.0), sky, smoothstep(NEAR_PLACE, FAR_PLACE, length(hit)));
#else
  vec2 back = normalize(ahead.xy), o = vec2(dot(from.xy, back) - BACK, from.z), e = vec2(dot(d.xy, back), d.z);
  float t = e.y < 0.0 ? -o.y / e.y : 1e9, along;
  if (o.x + t * e.x < 0.0 && e.y < 0.0) along = o.x + t * e.x + BACK + FRONT;
  else {
    if (e.x <= 0.0) return sky;
    o.y -= BEND;
    float a = dot(e, e), b = dot(o, e), c = dot(o, o) - BEND * BEND;
    t = (-b + sqrt(max(b * b - a * c, 0.0))) / a;
    vec2 at = o + t * e;
    if (at.y < 0.0) along = FRONT + BACK + BEND * atan(at.x, -at.y);
    else {
      t = (BEND - o.x) / e.x;
      float up = o.y + t * e.y;
      if (up > TOP - BEND) return sky;
      along = FRONT + BACK + BEND * 0.5 * PI + up;
    }
  }
  vec2 hit = from.xy + t * d.xy;
  if (along < 0.0 || abs(dot(hit, normalize(right.xy))) > WIDTH) return sky;
  return stage(hit, along, 4.0 * rough * t);
#endif
}
LIGHT incoming(vec3 from, vec3 d, float rough) {
  if (rough < 0.02) return trace(from, d, rough);
  LIGHT seen = roomAt(d, rough);
  float spread = 0.01 + 0.9 * rough;
  float below = smoothstep(spread, -spread, d.z);
  vec3 down = vec3(d.xy, min(d.z, -0.06 - 0.5 * rough));
  vec2 hit = from.xy + down.xy * (from.z / -down.z);
#ifdef PLACE
  float far = smoothstep(NEAR_PLACE, FAR_PLACE, length(hit)), along = 0.0;
#else
  float behind = dot(d.xy, normalize(ahead.xy)), along = dot(hit, normalize(ahead.xy)) + FRONT;
  float top = (TOP - from.z) * max(behind, 0.05) / (BACK + BEND - dot(from.xy, normalize(ahead.xy))), soft = 0.01 + 1.2 * rough;
  float wall = smoothstep(0.3 - rough, 0.6 + rough, behind / max(length(d.xy), 1e-4)) * smoothstep(top + soft, top - soft, d.z);
  seen = mix(seen, stage(hit, FRONT + BACK + BEND, 9.0), wall);
  float far = smoothstep(0.0, -FRONT, along);
#endif
  return mix(seen, mix(stage(hit, along, 6.0 * rough), seen, far), below);
}
// backdrop of the object
vec3 behind(vec3 d, float pixel) {
  float t = eye.z / max(-d.z, 0.01);
  vec2 hit = eye.xy + d.xy * t;
#ifdef PLACE
  LIGHT seen = lookup(d, 0.6) + lampAt(d, 0.0);
  return d.z < 0.0 ? mix(stage(hit, 0.0, 0.0), seen, smoothstep(NEAR_PLACE, FAR_PLACE, length(hit))) : seen;
#else
  // beyond its edges the stage continues with the light of its front and of its wall
  float along = dot(hit, normalize(ahead.xy)) + FRONT;
  if (along > FRONT + BACK || d.z > -0.01) {
    vec2 back = normalize(ahead.xy), o = vec2(dot(eye.xy, back) - BACK, eye.z - BEND), e = vec2(dot(d.xy, back), d.z);
    float a = dot(e, e), b = dot(o, e), c = dot(o, o) - BEND * BEND;
    t = (-b + sqrt(max(b * b - a * c, 0.0))) / a;
    vec2 at = o + t * e;
    along = FRONT + BACK + BEND * atan(max(at.x, 0.0), max(-at.y, 0.0));
    if (at.y > 0.0) { t = (BEND - o.x) / e.x; along = min(FRONT + BACK + BEND * 0.5 * PI + o.y + t * e.y, LENGTH); }
    hit = eye.xy + d.xy * t;
  }
  return vec3(stage(hit, max(along, 0.0), pixel * t * 1.5));
#endif
}
vec3 encode(vec3 c) {
  float y = clamp(dot(c, vec3(0.2126, 0.7152, 0.0722)), 0.0, 1.0);
  float low = min(c.r, min(c.g, c.b)), high = max(c.r, max(c.g, c.b)), keep = 1.0;
  if (low < 0.0) keep = min(keep, y / max(y - low, 1e-6));     // outside sRGB the chroma is reduced at constant luminance
  if (high > 1.0) keep = min(keep, (1.0 - y) / max(high - y, 1e-6));
  c = clamp(mix(vec3(y), c, keep), 0.0, 1.0);
  return mix(12.92 * c, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c));
}
// light of the material towards the eye
vec3 material(vec3 spot, vec3 d, vec3 n, vec3 down) {
  float cosine = clamp(-dot(d, n), 0.0, 1.0);
  vec3 mirror = tone(nacreAngle(cosine), 0.0), glossy = tone(nacreAngle(cosine), 1.0);
  vec3 spread = tone(nacreAngle(cosine), 2.0);
  float under = 0.5 * (1.0 - n.z);
  LIGHT light = matt(n) * smoothstep(-1.0, 0.6, n.z) + under * under * floorAt(down.xy);
  vec3 seen = mirror * incoming(spot, reflect(d, n), alpha) + spread * light;
  if (gloss > 0.0) seen += glossy * incoming(spot, reflect(d, n), gloss);
  return seen;
}
#ifdef CLEAR
vec3 through(float cosine) { return tone(nacreAngle(cosine), 3.0); }
#endif`;

// Integrated light of the ball over its normals (see light.js): the angle to the eye is the radius, the azimuth about it the
// angle.
export const BALL = `${COMMON}
uniform sampler2D throughMirror, throughGloss, throughMatt, backdrop, mirrored;
vec3 rayAt(vec2 place) {
  vec2 at = (place - 0.5 * size) / (0.5 * size.x);
  return normalize(ahead + at.x * right + at.y * up);
}
#ifdef CLEAR
// light transmitted by a ball of a free film: the backdrop, and the reflection in its far wall
vec3 passed(vec3 d, vec3 p, vec3 straight) {
  float cosine = clamp(-dot(d, p), 0.0, 1.0);
  vec3 wall = p + 2.0 * cosine * d, back = reflect(d, wall), t = through(cosine);
  vec3 image = vec3(trace(wall + 2.0 * cosine * back + CENTRE, back, alpha));
  return t * t * (straight + tone(nacreAngle(cosine), 0.0) * image);
}
#endif
vec3 onBall(vec3 d) {
  vec3 o = eye - CENTRE;
  float b = dot(o, d);
  return normalize(o + d * (-b - sqrt(max(b * b - dot(o, o) + 1.0, 0.0))));
}
#ifdef GRADED
// u around the vertical axis, v from the lowest point up, as on the sphere of pictures
void placeOnBall(vec3 p) { placeAtUv(vec2(fract(atan(p.y, p.x) / (2.0 * PI)), acos(clamp(-p.z, -1.0, 1.0)) / PI)); }
#endif
#if defined(FACETS) || defined(GLOSS) || defined(MATT) || defined(LOBE)
#define WIDE
// light of wide lobes and of a matt surface; a smooth mirror needs a single look-up
vec3 wide(vec3 d) {
  vec3 o = eye - CENTRE, p = onBall(d), toEye = normalize(o);
  float far = acos(clamp(dot(p, toEye), -1.0, 1.0)) / acos(1.0 / length(o));
  vec2 side = vec2(dot(p, normalize(right)), dot(p, cross(toEye, normalize(right))));
  vec2 at = 0.5 + 0.5 * min(far, 1.0) * side / max(length(side), 1e-6);
  vec3 seen = vec3(0.0);
#ifdef LOBE
  seen = texture(throughMatt, at).rgb;
#endif
#ifdef MATT
  seen = texture(throughMatt, at).rgb * tone(nacreAngle(clamp(-dot(d, p), 0.0, 1.0)), 2.0);
#endif
#ifdef FACETS
  vec4 m = texture(throughMirror, at);
  seen += tone(nacreAngle(m.a), 0.0) * m.rgb;
#endif
#ifdef GLOSS
  vec4 g = texture(throughGloss, at);
  seen += tone(nacreAngle(g.a), 1.0) * g.rgb;
#endif
  return seen;
}
#endif
void main() {
#ifdef GATHERED
  vec4 back = texelFetch(backdrop, ivec2(gl_FragCoord.xy), 0);
  if (back.a > 0.0) {
    vec3 seen = vec3(0.0);
#ifdef GRADED
    placeOnBall(onBall(rayAt(gl_FragCoord.xy)));
#endif
#ifndef FACETS
    vec4 m = texelFetch(mirrored, ivec2(gl_FragCoord.xy), 0);
    seen = tone(m.a, 0.0) * m.rgb;
#endif
#ifdef WIDE
    seen += wide(rayAt(gl_FragCoord.xy));
#endif
#ifdef CLEAR
    vec3 d = rayAt(gl_FragCoord.xy);
    seen += passed(d, onBall(d), back.rgb);
#endif
    back.rgb = mix(back.rgb, seen, back.a);
  }
#else
  vec3 d = rayAt(gl_FragCoord.xy), o = eye - CENTRE;
  float b = dot(o, d), pixel = 2.0 * length(right) / size.x;
  float cover = clamp(0.5 + (1.0 - sqrt(max(dot(o, o) - b * b, 0.0))) / (pixel * length(o)), 0.0, 1.0);
  vec4 back = vec4(behind(d, pixel), cover);
  if (cover > 0.0) {
    vec3 p = onBall(d);
#ifdef GRADED
    placeOnBall(p);
#endif
    vec3 seen = material(p + CENTRE, d, p, p * 1.6);
#ifdef CLEAR
    seen += passed(d, p, back.rgb);
#endif
    back.rgb = mix(back.rgb, seen, cover);
  }
#endif
  colour = vec4(encode(back.rgb * exp2(exposure)), 1.0);
}`;

// Backdrop and coverage of the ball; the light that a smooth ball reflects, and the angle to the eye as a table position. Once
// per view, independent of the recipe.
export const BACKDROP = `${COMMON}
layout(location = 1) out vec4 inMirror;
void main() {
  vec2 at = (gl_FragCoord.xy - 0.5 * size) / (0.5 * size.x);
  vec3 d = normalize(ahead + at.x * right + at.y * up), o = eye - CENTRE;
  float pixel = 2.0 * length(right) / size.x, b = dot(o, d), c = dot(o, o) - 1.0;
  colour = vec4(behind(d, pixel), clamp(0.5 + (1.0 - sqrt(max(dot(o, o) - b * b, 0.0))) / (pixel * length(o)), 0.0, 1.0));
  vec3 p = normalize(o + d * (-b - sqrt(max(b * b - c, 0.0))));
  inMirror = vec4(vec3(trace(p + CENTRE, reflect(d, p), 0.0)), nacreAngle(-dot(d, p)));
}`;

// Light reflected by a white ball, by lobe: facets about the normal (with the mean cosine of incidence), the fitted gloss, a
// matt surface; each over the same lattice of directions at all points.
export const GATHER = `${COMMON}
uniform float pixels, beckmann, compensated, lobes;     // lobes: sum of 1 facets, 2 gloss, 4 matt surface, 8 table
layout(location = 1) out vec4 asGloss;
layout(location = 2) out vec4 asMatt;
uniform float count;

float smith(float cosine, float a, bool isBeckmann) {
  float tangent = a * sqrt(max(1.0 - cosine * cosine, 0.0)) / max(cosine, 1e-4);
  if (!isBeckmann) return 2.0 / (1.0 + sqrt(1.0 + tangent * tangent));
  float x = 1.0 / max(tangent, 1e-4);
  return x >= 1.6 ? 1.0 : min((3.535 * x + 2.181 * x * x) / (1.0 + 2.276 * x + 2.577 * x * x), 1.0);
}
// Facets sampled by their density; each direction has its solid angle.
vec4 facets(vec3 spot, vec3 n, vec3 side, vec3 v, float a, bool isBeckmann, out float lost) {
  vec3 other = cross(n, side), sum = vec3(0.0);
  float cv = max(dot(n, v), 0.01), whole = 0.0, met = 0.0, bright = 0.0;
  for (int i = 0; float(i) < count; i++) {
    float left = 1.0 - (float(i) + 0.5) / count, turn = 2.0 * PI * fract(0.618034 * float(i));
    float slope2 = a * a * (isBeckmann ? -log(left) : (1.0 - left) / left), z = inversesqrt(1.0 + slope2);
    vec3 m = z * (n + sqrt(slope2) * (cos(turn) * side + sin(turn) * other));
    float vm = dot(v, m);
    vec3 d = 2.0 * vm * m - v;
    float cd = dot(d, n);
    if (vm <= 0.0 || cd <= 0.0) continue;
    float weight = vm * smith(cd, a, isBeckmann) * smith(cv, a, isBeckmann) / (cv * z);
    float density = (isBeckmann ? left : left * left) / (PI * a * a * z * z * z);
    vec3 light = vec3(trace(spot, d, 0.5 * sqrt(vm / (count * density * PI))));
    float y = weight * dot(light, vec3(0.2126, 0.7152, 0.0722));
    sum += weight * light; whole += weight; met += y * vm; bright += y;
  }
#ifdef PLACE
  float cl = dot(lampTo, n);
  if (cl > 0.0) {     // the lamp with its extent
    vec3 m = normalize(lampTo + v);
    float z = dot(n, m), z2 = z * z, a2 = a * a + 0.125 * lampRadius * lampRadius, s = z2 * (a2 - 1.0) + 1.0;
    float density = isBeckmann ? exp((1.0 - 1.0 / z2) / a2) / (PI * a2 * z2 * z2) : a2 / (PI * s * s);
    vec3 light = count * density * smith(cl, a, isBeckmann) * smith(cv, a, isBeckmann) / (4.0 * cv) * lampPower;
    float y = dot(light, vec3(0.2126, 0.7152, 0.0722));
    sum += light; met += y * dot(v, m); bright += y;
  }
#endif
  lost = max(1.0 - whole / count, 0.0);
  return vec4(sum / count, bright > 0.0 ? met / bright : cv);
}
// Light of a lobe table: half of the directions about the mirror direction, as wide as the gloss, half about the normal;
// normalised to the appearance's total at this angle.
vec3 scattered(vec3 spot, vec3 n, vec3 side, vec3 v) {
  vec3 other = cross(n, side), sum = vec3(0.0), whole = vec3(1e-5), wo = vec3(dot(v, side), dot(v, other), max(dot(v, n), 0.02));
  float a2 = gloss * gloss;
  for (int i = 0; float(i) < 2.0 * count; i++) {
    float u = (floor(0.5 * float(i)) + 0.5) / count, turn = 2.0 * PI * fract(0.618034 * floor(0.5 * float(i)));
    vec3 wi;
    if ((i & 1) == 0) wi = vec3(sqrt(u) * cos(turn), sqrt(u) * sin(turn), sqrt(1.0 - u));
    else {
      if (gloss <= 0.0) continue;
      float slope = gloss * sqrt(u / (1.0 - u)), z = inversesqrt(1.0 + slope * slope);
      wi = reflect(-wo, z * vec3(slope * cos(turn), slope * sin(turn), 1.0));
      if (wi.z <= 1e-3) continue;
    }
    float density = wi.z / PI;
    if (gloss > 0.0) {
      vec3 h = normalize(wi + wo);
      float d = h.z * h.z * (a2 - 1.0) + 1.0;
      density += a2 * h.z / (PI * d * d * 4.0 * max(dot(h, wo), 1e-3));
    }
    vec3 f = nacreScattered(wi, wo) * wi.z / (count * density);
    sum += f * vec3(trace(spot, wi.x * side + wi.y * other + wi.z * n, 0.5 * inversesqrt(count * density * PI)));
    whole += f;
  }
#ifdef PLACE
  vec3 lit = vec3(dot(lampTo, side), dot(lampTo, other), dot(lampTo, n));
  if (lit.z > 0.0) sum += nacreScattered(lit, wo) * lit.z * lampPower;
#endif
  float cosine = wo.z;
  return sum / whole * (tone(nacreAngle(cosine), 1.0) + tone(nacreAngle(cosine), 2.0));
}
void main() {
  vec2 at = (gl_FragCoord.xy - 0.5 * pixels) / (0.5 * pixels - 1.0);
  vec3 o = eye - CENTRE, toEye = normalize(o), across = normalize(right), upward = cross(toEye, across);
  float far = min(length(at), 1.0) * acos(1.0 / length(o));
  vec3 n = cos(far) * toEye + sin(far) * (at.x * across + at.y * upward) / max(length(at), 1e-6);
  vec3 spot = n + CENTRE, v = normalize(eye - spot), side = normalize(cross(abs(n.z) < 0.9 ? vec3(0.0, 0.0, 1.0) : vec3(1.0, 0.0, 0.0), n));
  int kinds = int(lobes + 0.5);
  float lost = 0.0, none;
  colour = asGloss = asMatt = vec4(0.0);
  if ((kinds & 1) != 0) colour = facets(spot, n, side, v, alpha, beckmann > 0.5, lost);
  if ((kinds & 8) != 0) { asMatt.rgb = scattered(spot, n, side, v); kinds &= 1; }
  if ((kinds & 2) != 0) asGloss = facets(spot, n, side, v, gloss, false, none);
  bool isKept = compensated > 0.5 && lost > 0.0;
  if ((kinds & 4) == 0 && !isKept) return;
  vec3 other = cross(n, side), between = vec3(0.0);
  float whole = 0.0;
  for (int i = 0; float(i) < count; i++) {
    float u = (float(i) + 0.5) / count, turn = 2.0 * PI * fract(0.618034 * float(i)), z = sqrt(1.0 - u);
    vec3 light = vec3(trace(spot, z * n + sqrt(u) * (cos(turn) * side + sin(turn) * other), 0.5 * inversesqrt(count * max(z, 0.05))));
    asMatt.rgb += light / count;
    float loss = 1.0 - smith(z, alpha, beckmann > 0.5) + 1e-4;      // approximate loss of the facets
    between += loss * light; whole += loss;
  }
#ifdef PLACE
  float cl = max(dot(lampTo, n), 0.0);
  asMatt.rgb += lampPower * cl / PI;
  between += count * (1.0 - smith(max(cl, 1e-4), alpha, beckmann > 0.5)) * lampPower * cl / PI;
#endif
  if (isKept) colour.rgb += lost * between / whole;    // compensation of multiple scattering
}`;
