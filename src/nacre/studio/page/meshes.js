// Shaders of objects other than the sphere. MESH: visible triangles; SHADE: their colours, once per pixel, more often at edges.

import { COMMON } from "./shaders.js";

const DEPTHS = `const float NEAR = 1.0, FAR = 60.0;`;

export const MESH_VERTEX = `#version 300 es
precision highp float;
layout(location = 0) in vec3 corner;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec2 surface;
uniform vec3 eye, right, up, ahead;
out vec3 n;
out vec2 uv;
${DEPTHS}
void main() {
  vec3 v = corner - eye;
  float depth = dot(v, ahead), half2 = dot(right, right);
  n = normal; uv = surface;
  gl_Position = vec4(dot(v, right) / half2, dot(v, up) / half2, (depth * (FAR + NEAR) - 2.0 * FAR * NEAR) / (FAR - NEAR), depth);
}`;

// Octahedral normal, 16 bits per coordinate; the part's number, whether a line of u, v passes, and the reflectance of the print
// (over a pixel of the picture, which is two of these wide); u and v, 16 bits each.
export const MESH = `
in vec3 n;
in vec2 uv;
uniform float part, printed;
uniform sampler2D paper;
layout(location = 0) out vec4 facing;
layout(location = 1) out vec4 kind;
layout(location = 2) out vec4 at;
vec2 split(float x) { float whole = floor(x * 65535.0 + 0.5), high = floor(whole / 256.0); return vec2(high, whole - 256.0 * high) / 255.0; }
void main() {
  vec3 m = n / max(abs(n.x) + abs(n.y) + abs(n.z), 1e-9);
  vec2 o = m.z >= 0.0 ? m.xy : (1.0 - abs(m.yx)) * vec2(m.x >= 0.0 ? 1.0 : -1.0, m.y >= 0.0 ? 1.0 : -1.0);
  facing = vec4(split(0.5 + 0.5 * o.x), split(0.5 + 0.5 * o.y));
  vec2 place = mix(uv, fract(uv), vec2(greaterThan(abs(uv - 0.5), vec2(0.5))));
  at = vec4(split(place.x), split(place.y));
  vec2 line = abs(fract(uv * 10.0 + 0.5) - 0.5) / max(fwidth(uv * 10.0), vec2(1e-5));
  kind = vec4(part / 255.0, smoothstep(2.5, 0.8, min(line.x, line.y)), printed > 0.5 ? texture(paper, uv, 1.0).r : 1.0, 1.0);
}`;

export const SHADE = `${COMMON}
${DEPTHS}
uniform sampler2D facing, kind, depth;
uniform sampler2D throughMirror, throughGloss, throughMatt;
#ifdef GRADED
uniform sampler2D surfaceAt;
#endif
uniform vec3 plain[8];          // companion objects: diffuse and specular reflectance, roughness; negative: the material
uniform float grid;
#ifdef CLEAR
uniform sampler2D farFacing, farKind, farDepth, sheets;     // surface behind the material, and the number of layers in front of it
#endif

int partAt(ivec2 at) { return int(texelFetch(kind, at, 0).r * 255.0 + 0.5); }
vec3 normalIn(sampler2D facing_, ivec2 at) {
  vec4 f = texelFetch(facing_, at, 0) * 255.0;
  vec2 o = vec2(f.x * 256.0 + f.y, f.z * 256.0 + f.w) / 65535.0 * 2.0 - 1.0;
  vec3 n = vec3(o, 1.0 - abs(o.x) - abs(o.y));
  if (n.z < 0.0) n.xy = (1.0 - abs(n.yx)) * vec2(n.x >= 0.0 ? 1.0 : -1.0, n.y >= 0.0 ? 1.0 : -1.0);
  return normalize(n);
}
vec3 normalAt(ivec2 at) { return normalIn(facing, at); }
vec3 placeAt(sampler2D depth_, ivec2 at, vec3 ray) {
  float z = 2.0 * texelFetch(depth_, at, 0).r - 1.0;
  return eye + ray * (2.0 * FAR * NEAR / (FAR + NEAR - z * (FAR - NEAR)));
}
// companion objects; own: diffuse and specular reflectance, roughness
vec3 plainly(vec3 own, vec3 spot, vec3 d, vec3 n) {
  float cosine = clamp(-dot(d, n), 0.0, 1.0), under = 0.5 * (1.0 - n.z);
  LIGHT light = matt(n) * smoothstep(-1.0, 0.6, n.z) + under * under * floorAt(spot.xy * 1.2);
  float fresnel = own.y > 0.0 ? own.y + (1.0 - own.y) * pow(1.0 - cosine, 5.0) * (1.0 - own.z) : 0.0;
  return vec3(own.x * light + fresnel * incoming(spot, reflect(d, n), own.z));
}
vec3 turned(vec3 n, vec3 d) { return dot(n, d) > 0.12 ? -n : n; }   // back faces, except at rounded edges
#ifdef GATHERED
// position in the light of the ball, by its normal
vec2 placeOf(vec3 n) {
  vec3 o = eye - CENTRE, toEye = normalize(o), across = normalize(right);
  float far = acos(clamp(dot(n, toEye), -1.0, 1.0)) / acos(1.0 / length(o));
  vec2 side = vec2(dot(n, across), dot(n, cross(toEye, across)));
  return 0.5 + 0.5 * min(far, 1.0) * side / max(length(side), 1e-6);
}
// the point of the ball that reflects the same part of the room: flat parts have a different view direction at each pixel
vec3 byLobes(vec3 spot, vec3 d, vec3 n) {
  vec3 r = reflect(d, n), o = eye - CENTRE, there = normalize(r + normalize(o));
  there = normalize(r + normalize(o - there));
  float cosine = clamp(-dot(d, n), 0.0, 1.0), change = cosine - clamp(dot(there, normalize(o - there)), 0.0, 1.0);
  vec2 at = placeOf(there);
#ifdef FACETS
  vec4 m = texture(throughMirror, at);
  vec3 seen = tone(nacreAngle(clamp(m.a + change, 0.0, 1.0)), 0.0) * m.rgb;
#else
  vec3 seen = tone(nacreAngle(cosine), 0.0) * incoming(spot, r, alpha);
#endif
#ifdef LOBE
  seen += texture(throughMatt, gloss > 0.0 ? at : placeOf(n)).rgb;
#endif
#ifdef MATT
  seen += tone(nacreAngle(cosine), 2.0) * texture(throughMatt, placeOf(n)).rgb;
#endif
#ifdef GLOSS
  vec4 g = texture(throughGloss, at);
  seen += tone(nacreAngle(clamp(g.a + change, 0.0, 1.0)), 1.0) * g.rgb;
#endif
  return seen;
}
#endif
vec3 seenAt(ivec2 fine) {
  vec2 at = (vec2(fine) + 0.5 - size) / size.x;        // two fine pixels per pixel
  vec3 ray = ahead + at.x * right + at.y * up, d = normalize(ray);
  int part = partAt(fine);
  if (part == 0) return behind(d, 2.0 * length(right) / size.x);
  vec3 spot = placeAt(depth, fine, ray), n = turned(normalAt(fine), d), own = plain[part - 1], seen;
  if (own.x < 0.0) {
#ifdef GRADED
    vec4 uv = texelFetch(surfaceAt, fine, 0) * 255.0;
    placeAtUv(vec2(uv.x * 256.0 + uv.y, uv.z * 256.0 + uv.w) / 65535.0);
#endif
#ifdef GATHERED
    seen = byLobes(spot, d, n);
#else
    seen = material(spot, d, n, spot * 1.2);
#endif
#ifdef CLEAR
    int farther = int(texelFetch(farKind, fine, 0).r * 255.0 + 0.5);
    float times = texelFetch(sheets, fine, 0).r * 255.0;
    vec3 beyond = farther == 0 ? behind(d, 2.0 * length(right) / size.x)
      : plainly(plain[farther - 1] * vec3(texelFetch(farKind, fine, 0).b, 1.0, 1.0), placeAt(farDepth, fine, ray), d, turned(normalIn(farFacing, fine), d));
    seen += pow(through(clamp(-dot(d, n), 0.0, 1.0)), vec3(max(times, 1.0))) * beyond;
#endif
    return grid > 0.5 ? mix(seen, vec3(0.02), 0.75 * texelFetch(kind, fine, 0).g) : seen;
  }
  return plainly(own * vec3(texelFetch(kind, fine, 0).b, 1.0, 1.0), spot, d, n);
}
void main() {
  ivec2 first = 2 * ivec2(gl_FragCoord.xy);
  int part = partAt(first);
  vec3 n = normalAt(first);
  bool isEdge = false;
  for (int i = 1; i < 4; i++) {
    ivec2 at = first + ivec2(i & 1, i >> 1);
    isEdge = isEdge || partAt(at) != part || (part != 0 && dot(normalAt(at), n) < 0.97);
  }
  vec3 sum = seenAt(first);
  if (isEdge || (grid > 0.5 && part != 0)) {
    for (int i = 1; i < 4; i++) sum += seenAt(first + ivec2(i & 1, i >> 1));
    sum *= 0.25;
  }
  colour = vec4(encode(sum * exp2(exposure)), 1.0);
}`;
