/** A `ShaderMaterial` for three's WebGLRenderer. */
import { CustomBlending, DoubleSide, FrontSide, OneFactor, OneMinusSrcAlphaFactor, ShaderMaterial, UniformsLib,
  UniformsUtils, Vector3 } from 'three';
import { NacreEnvironment } from './environment.js';
import { PARTS, TABLE, positions, textures } from './table.js';

export { NacreEnvironment, TABLE };

/** The look-ups of each part in GLSL. */
const LOOK_UPS = @GLSL@;

const VERTEX = /* glsl */`
varying vec3 vViewPosition;
varying vec2 vNacreUv;
#include <common>
#include <batching_pars_vertex>
#include <fog_pars_vertex>
#include <normal_pars_vertex>
#include <morphtarget_pars_vertex>
#include <skinning_pars_vertex>
#include <shadowmap_pars_vertex>
#include <logdepthbuf_pars_vertex>
#include <clipping_planes_pars_vertex>
void main() {
  vNacreUv = uv;
  #include <batching_vertex>
  #include <beginnormal_vertex>
  #include <morphinstance_vertex>
  #include <morphnormal_vertex>
  #include <skinbase_vertex>
  #include <skinnormal_vertex>
  #include <defaultnormal_vertex>
  #include <normal_vertex>
  #include <begin_vertex>
  #include <morphtarget_vertex>
  #include <skinning_vertex>
  #include <project_vertex>
  #include <logdepthbuf_vertex>
  #include <clipping_planes_vertex>
  vViewPosition = -mvPosition.xyz;
  #include <worldpos_vertex>
  #include <shadowmap_vertex>
  #include <fog_vertex>
}`;

const HEAD = /* glsl */`
varying vec3 vViewPosition;
varying vec2 vNacreUv;
#include <common>
#include <fog_pars_fragment>
#include <bsdfs>
#include <lights_pars_begin>
#include <normal_pars_fragment>
#include <shadowmap_pars_fragment>
#include <logdepthbuf_pars_fragment>
#include <clipping_planes_pars_fragment>
uniform vec3 nacreIrradiance[9];
uniform vec3 nacreTurn;
#ifdef NACRE_ENVIRONMENT
uniform sampler2D nacreEnvironment;
#endif
`;

/** The light that one material sends, behind its look-ups. */
const PART = /* glsl */`
uniform float nacrePosition;
#ifdef NACRE_ALBEDO_BANDS
uniform sampler2D nacreAlbedo;
#endif
#ifdef NACRE_GLOSS
uniform sampler2D nacreGloss;
#endif
#ifdef NACRE_SPREAD_BANDS
uniform sampler2D nacreSpread;
#endif
#ifdef NACRE_THROUGH_BANDS
uniform sampler2D nacreThrough;
#endif
#ifdef NACRE_MAP
uniform sampler2D nacreMap;
#endif

struct NacreSurface { mat3 frame; vec3 wo; float p; float row; float side; };

float nacreBand(float bands, float side) { return min(side, bands - 1.0); }
vec3 nacreView(sampler2D picture, NacreSurface s, float bands) {
  return nacreColour(picture, abs(s.wo.z), s.row, nacreBand(bands, s.side), bands);
}
mat3 nacreFrame(vec3 n) {
  vec3 t = abs(n.z) < 0.9 ? cross(vec3(0.0, 0.0, 1.0), n) : cross(vec3(1.0, 0.0, 0.0), n);
#if defined(USE_TANGENT)
  t = vTangent;
#elif defined(NACRE_BRUSHED)
  vec3 px = dFdx(-vViewPosition), py = dFdy(-vViewPosition);
  vec2 sx = dFdx(vNacreUv), sy = dFdy(vNacreUv);
  vec3 along = cross(py, n) * sx.x + cross(n, px) * sy.x;
  if (dot(along, along) > 0.0) t = along * (dot(n, cross(px, py)) < 0.0 ? -1.0 : 1.0);
#endif
  t = normalize(t - dot(t, n) * n);
  return mat3(t, cross(n, t), n);
}

NacreSurface nacreSurface(vec3 normal, vec3 view) {
  NacreSurface s;
  s.frame = nacreFrame(normal);
  s.wo = view * s.frame;
#ifdef NACRE_ONE_SIDED
  s.wo.z = max(s.wo.z, 1e-4);
#endif
  s.side = s.wo.z < 0.0 ? 1.0 : 0.0;
  s.p = nacrePosition;
#ifdef NACRE_MAP
  if (nacrePosition < 0.0) s.p = texture2D(nacreMap, vNacreUv).r;
#endif
#ifdef NACRE_ROWS_AZIMUTH
  s.row = dot(s.wo.xy, s.wo.xy) > 1e-12 ? s.wo.x * s.wo.x / dot(s.wo.xy, s.wo.xy) : 0.5;
#else
  s.row = s.p;
#endif
  return s;
}
vec3 nacreLit(vec3 direction, NacreSurface s) {
  vec3 wi = direction * s.frame;
  return nacreBrdf(wi, s.wo, s.p) * abs(wi.z);
}
vec3 nacreEvenly(NacreSurface s) {
#ifdef NACRE_ALBEDO_BANDS
  return nacreView(nacreAlbedo, s, NACRE_ALBEDO_BANDS);
#else
  return vec3(0.0);
#endif
}
float nacreOpacity(NacreSurface s) {
#ifdef NACRE_THROUGH_BANDS
  return 1.0 - dot(nacreView(nacreThrough, s, NACRE_THROUGH_BANDS), vec3(0.2126, 0.7152, 0.0722));
#else
  return 1.0;
#endif
}

#ifdef NACRE_ENVIRONMENT
vec3 nacreTurned(vec3 w) { return vec3(nacreTurn.x * w.x + nacreTurn.y * w.z, w.y, nacreTurn.x * w.z - nacreTurn.y * w.x); }
vec3 nacreIncoming(NacreSurface s, vec3 wi, float density) {
  vec3 w = nacreTurned(normalize((vec4(s.frame * wi, 0.0) * viewMatrix).xyz));
  vec2 size = vec2(textureSize(nacreEnvironment, 0));
  float level = 0.5 * log2(max(size.x * size.y / (4.0 * NACRE_PI * NACRE_SAMPLES * max(density, 1e-6)), 1.0));
  vec2 at = vec2(atan(w.z, w.x) / (2.0 * NACRE_PI) + 0.5, asin(clamp(w.y, -1.0, 1.0)) / NACRE_PI + 0.5);
  return textureLod(nacreEnvironment, at, level).rgb * nacreTurn.z;
}
vec3 nacreIrradianceAt(NacreSurface s) {
  vec3 n = nacreTurned(normalize((vec4(s.frame[2] * (s.wo.z < 0.0 ? -1.0 : 1.0), 0.0) * viewMatrix).xyz));
  vec3 sum = nacreIrradiance[0] * 0.282095
    + 0.488603 * (nacreIrradiance[1] * n.y + nacreIrradiance[2] * n.z + nacreIrradiance[3] * n.x)
    + 1.092548 * (nacreIrradiance[4] * n.x * n.y + nacreIrradiance[5] * n.y * n.z + nacreIrradiance[7] * n.x * n.z)
    + nacreIrradiance[6] * 0.315392 * (3.0 * n.z * n.z - 1.0) + nacreIrradiance[8] * 0.546274 * (n.x * n.x - n.y * n.y);
  return max(sum, vec3(0.0)) * nacreTurn.z;
}
// A facet that is seen along w, w.z > 0 (Heitz 2018).
vec3 nacreVisible(vec3 w, vec2 alpha, vec2 u) {
  vec3 v = normalize(vec3(alpha * w.xy, w.z));
  float flat_ = dot(v.xy, v.xy);
  vec3 a = flat_ > 1e-9 ? vec3(-v.y, v.x, 0.0) * inversesqrt(flat_) : vec3(1.0, 0.0, 0.0), b = cross(v, a);
  float r = sqrt(u.x), phi = 2.0 * NACRE_PI * u.y - atan(v.y, v.x + 1e-9), x = r * cos(phi), y = r * sin(phi), s = 0.5 * (1.0 + v.z);
  y = (1.0 - s) * sqrt(max(0.0, 1.0 - x * x)) + s * y;
  vec3 m = x * a + y * b + sqrt(max(0.0, 1.0 - x * x - y * y)) * v;
  return normalize(vec3(alpha * m.xy, max(1e-6, m.z)));
}
// Density of directions that such facets reflect to: GGX of the facet times Smith's share that is seen, over 4 w.z.
float nacreVisibleDensity(vec3 w, vec3 m, vec2 alpha) {
  vec2 slope = m.xy / alpha, wide = alpha * w.xy;
  float s = dot(slope, slope) + m.z * m.z;
  float seen = 2.0 / (1.0 + sqrt(1.0 + dot(wide, wide) / max(w.z * w.z, 1e-12)));
  return seen / (NACRE_PI * alpha.x * alpha.y * s * s * 4.0 * max(w.z, 1e-6));
}
// A lattice of Fibonacci.
vec2 nacrePoint(int i) { return vec2((float(i) + 0.5) / NACRE_SAMPLES, fract(float(i) * 0.6180339887498949)); }
// What reaches the eye from all around.
vec3 nacreSurroundings(NacreSurface s) {
  vec3 sum = vec3(0.0), up = vec3(s.wo.xy, max(abs(s.wo.z), 1e-3));
  float turn = s.wo.z < 0.0 ? -1.0 : 1.0;
#if defined(NACRE_FACET) && !defined(NACRE_ROUGH)
  vec3 reflected, passed;
  nacreMirror(s.wo, s.p, reflected, passed);
  sum += reflected * nacreIncoming(s, vec3(-s.wo.xy, s.wo.z), 1e6);
#endif
#ifdef NACRE_ROUGH
  for (int i = 0; i < int(NACRE_SAMPLES); i ++) {
    vec3 m = nacreVisible(up, NACRE_ALPHA, nacrePoint(i)), wi = reflect(-up, m);
    if (wi.z <= 0.0) continue;
    float density = nacreVisibleDensity(up, m, NACRE_ALPHA);
    vec3 f = nacreFacets(vec3(wi.xy, turn * wi.z), vec3(up.xy, turn * up.z), s.p);
    sum += f * wi.z / density * nacreIncoming(s, vec3(wi.xy, turn * wi.z), density) / NACRE_SAMPLES;
  }
#endif
#ifdef NACRE_GLOSS
  float alphas[NACRE_GLOSS] = NACRE_GLOSS_ALPHAS;
  for (int k = 0; k < NACRE_GLOSS; k ++) {
    vec3 light = vec3(0.0);
    float weight = 0.0;
    for (int i = 0; i < int(NACRE_SAMPLES); i ++) {
      vec3 m = nacreVisible(up, vec2(alphas[k]), nacrePoint(i)), wi = reflect(-up, m);
      if (wi.z <= 0.0) continue;
      light += nacreIncoming(s, vec3(wi.xy, turn * wi.z), nacreVisibleDensity(up, m, vec2(alphas[k])));
      weight += 1.0;
    }
    vec3 colour = nacreColour(nacreGloss, abs(s.wo.z), s.row, float(k), float(NACRE_GLOSS));
    sum += light / max(weight, 1.0) * colour * (turn > 0.0 ? 1.0 : 0.0);
  }
#endif
#ifdef NACRE_SPREAD_BANDS
  sum += nacreIrradianceAt(s) / NACRE_PI * nacreView(nacreSpread, s, NACRE_SPREAD_BANDS);
#endif
  return sum;
}
#endif

`;

/** The names of a part in GLSL: the second one has its own. */
const named = (text, part) => (part === 0 ? text : text.replace(
  /\b(nacre|Nacre|NACRE_)(?!(Environment|Turn|Irradiance|ENVIRONMENT)\b)/g, '$1B_'));
/** A value in GLSL, or that of both parts by the share of the first one. */
const both = (text) => (PARTS.length === 1 ? text.replaceAll('PART', 'first')
  : `mix(${named(text, 1).replaceAll('PART', 'second')}, ${text.replaceAll('PART', 'first')}, s.share)`);

const SHARE = TABLE.pictures.share ? 'texture2D(nacreShare, vNacreUv).r' : (TABLE.share ?? 1).toFixed(6);
const FRAGMENT = /* glsl */`${HEAD}
${PARTS.map((_, i) => named(LOOK_UPS[i] + PART, i)).join('\n')}
${TABLE.pictures.share ? 'uniform sampler2D nacreShare;' : ''}
struct NacreHere { float share; ${PARTS.map((_, i) => named(`NacreSurface ${i === 0 ? 'first' : 'second'};`, i)).join(' ')} };

void RE_Direct_Nacre(const in IncidentLight light, const in vec3 where, const in vec3 n, const in vec3 view,
    const in vec3 coat, const in NacreHere s, inout ReflectedLight sent) {
  sent.directSpecular += light.color * ${both('nacreLit(light.direction, s.PART)')};
}
void RE_IndirectDiffuse_Nacre(const in vec3 irradiance, const in vec3 where, const in vec3 n, const in vec3 view,
    const in vec3 coat, const in NacreHere s, inout ReflectedLight sent) {
  sent.indirectDiffuse += irradiance / PI * ${both('nacreEvenly(s.PART)')};
}
#define RE_Direct RE_Direct_Nacre
#define RE_IndirectDiffuse RE_IndirectDiffuse_Nacre

void main() {
  #include <clipping_planes_fragment>
  #include <logdepthbuf_fragment>
  vec3 normal = normalize(vNormal);
  vec3 view = isOrthographic ? vec3(0.0, 0.0, 1.0) : normalize(vViewPosition);
  NacreHere material;
  material.share = ${SHARE};
  ${PARTS.map((_, i) => `material.${i === 0 ? 'first' : 'second'} = ${named('nacreSurface', i)}(normal, view);`).join(' ')}
  ReflectedLight reflectedLight = ReflectedLight(vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0));
  #include <lights_fragment_begin>
  vec3 sent = reflectedLight.directSpecular + reflectedLight.indirectDiffuse;
  NacreHere s = material;
#ifdef NACRE_ENVIRONMENT
  sent += ${both('nacreSurroundings(s.PART)')};
#endif
#ifndef NACRE_UNCLIPPED
  sent = max(sent, vec3(0.0));
#endif
  gl_FragColor = vec4(sent, clamp(${both('nacreOpacity(s.PART)')}, 0.0, 1.0));
  #include <tonemapping_fragment>
  #include <colorspace_fragment>
  #include <fog_fragment>
}`;

/** How light that passes is mixed with what lies behind: the mean of the channels. */
export const CLEAR = PARTS.some((part) => part.pictures.through) ? {
  transparent: true, blending: CustomBlending, blendSrc: OneFactor, blendDst: OneMinusSrcAlphaFactor,
  side: PARTS.every((part) => part.is_two_sided) ? DoubleSide : FrontSide,
} : {};

export class NacreMaterial extends ShaderMaterial {
  /**
   * @param {{ environment?: NacreEnvironment | null, value?: number | null, tangents?: boolean, unclipped?: boolean }} [options] light from all around; value of
   *   the number that varies over the surface, the same everywhere (by default the recipe's map over uv); whether the
   *   geometry has tangents, along which a brushed surface runs (by default from uv); whether colours outside sRGB keep
   *   their negative channels (for pipelines in floats: three's tone mapping makes no number of them).
   */
  constructor({ environment = null, value = null, tangents = false, unclipped = false } = {}) {
    const uniforms = UniformsUtils.merge([UniformsLib.lights, UniformsLib.fog, {
      nacreTurn: { value: new Vector3(1, 0, 1) },
      nacreIrradiance: { value: Array.from({ length: 9 }, () => new Vector3()) }, nacreEnvironment: { value: null },
    }]);
    for (const [i, part] of PARTS.entries()) {
      uniforms[named('nacrePosition', i)] = { value: 0 };
      for (const [name, texture] of Object.entries(textures(part))) {
        uniforms[named(`nacre${name[0].toUpperCase()}${name.slice(1)}`, i)] = { value: texture };
      }
    }
    super({ uniforms, vertexShader: VERTEX, fragmentShader: FRAGMENT, lights: true, fog: true, ...CLEAR });
    this.defines = { ...(tangents && { USE_TANGENT: '' }), ...(unclipped && { NACRE_UNCLIPPED: '' }) };
    this.type = 'NacreMaterial';
    this.name = TABLE.name;
    this.environment = environment;
    this.value = value;
  }
  /** Light from all around, or null. */
  get environment() { return this._environment ?? null; }
  set environment(environment) {
    this._environment = environment;
    this.uniforms.nacreEnvironment.value = environment ? environment.texture : null;
    if (environment) {
      this.defines.NACRE_ENVIRONMENT = '';
      this.uniforms.nacreIrradiance.value = environment.irradiance;
    } else delete this.defines.NACRE_ENVIRONMENT;
    this.needsUpdate = true;
  }
  /** Value of the number that varies over the surface; null: the recipe's map. */
  set value(value) { positions(value).forEach((at, i) => { this.uniforms[named('nacrePosition', i)].value = at; }); }
  onBeforeRender() {
    const light = this._environment;
    if (light) this.uniforms.nacreTurn.value.set(Math.cos(light.rotation), Math.sin(light.rotation), light.intensity);
  }
  dispose() {
    for (const { value } of Object.values(this.uniforms)) if (value?.isDataTexture && value !== this._environment?.texture) value.dispose();
    super.dispose();
  }
}
