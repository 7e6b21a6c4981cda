// The shaders of the object. BALL: one triangle over the whole canvas, with the sphere. MESH: what triangles are seen where;
// SHADE: their colours, each pixel once, or more often at an edge. Each looks up its colour over the angle and the blurred room. Look-ups are those of exported tables: table.glsl stands before it, the same text as in `shader.glsl`.

export const COVER = `#version 300 es
void main() { vec2 p = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0); gl_Position = vec4(p, 0.0, 1.0); }`;

const COMMON = `
precision highp sampler2DArray;
uniform sampler2D table;        // rows: mirror-like, glossy, spread, of A and of B; over the angle from 0 to 90 degrees
uniform float first;            // row of the look that is drawn
uniform sampler2DArray room;    // layers: blurred by roughness, the last one for a matt white surface
uniform vec3 eye, right, up, ahead;
uniform vec2 size;
uniform vec4 foot;              // the shade on the floor: its middle and half its extents
uniform float alpha, gloss, layers, exposure;
// PLACE: surroundings with colours of their own, seen behind the object; else the studio: light of one channel, a stage
#ifdef PLACE
#define LIGHT vec3
#define TINT(t) (t).rgb
#else
#define LIGHT float
#define TINT(t) (t).r
#endif
uniform LIGHT level, ground;    // of a matt white floor, and its reflectance
out vec4 colour;
const float PI = 3.14159265;
const vec3 CENTRE = vec3(0.0, 0.0, 1.0);
// the stage of pictures: a grey floor that rises behind the object; fitted to what Mitsuba renders of it
const float WALL = 9.5, TOP = 5.2, DIM = 0.2, FRONT = 16.0;
const float NEAR_PLACE = 12.0, FAR_PLACE = 30.0;         // of a place: where the floor goes over into it

LIGHT lookup(vec3 d, float layer) {
  float low = floor(layer);
  vec2 at = vec2(atan(d.y, d.x) / (2.0 * PI), acos(clamp(d.z, -1.0, 1.0)) / PI);
  LIGHT one = TINT(texture(room, vec3(at, low)));
  return mix(one, TINT(texture(room, vec3(at, min(low + 1.0, layers - 2.0)))), layer - low);
}
LIGHT matt(vec3 n) {
  return TINT(texture(room, vec3(atan(n.y, n.x) / (2.0 * PI), acos(clamp(n.z, -1.0, 1.0)) / PI, layers - 1.0)));
}
// the floor lit by the room, less what a sphere hides of it (form factor from a horizontal element); an object as its
// own ellipsoid
LIGHT stage(vec2 p) {
#ifdef PLACE
  float fall = 1.0;
#else
  float behind = max(dot(p, normalize(ahead.xy)), 0.0);
  float fall = DIM + (1.0 - DIM) / (1.0 + pow(behind / 5.4, 2.3));
#endif
  vec2 q = (p - foot.xy) / foot.zw;
  return ground * level * fall * (1.0 - 0.9 * pow(dot(q, q) + 1.0, -1.5));
}
LIGHT incoming(vec3 from, vec3 d, float rough) {
  float layer = rough < 0.001 ? 0.0 : clamp(log2(rough / 0.03125) + 1.0, min(rough / 0.03125, 1.0), layers - 2.0);
  LIGHT seen = lookup(d, layer);
  float spread = 0.01 + 0.9 * rough;
  float below = smoothstep(spread, -spread, d.z);
  vec3 down = vec3(d.xy, min(d.z, -0.06 - 0.5 * rough));
  vec2 hit = from.xy + down.xy * (from.z / -down.z);
#ifdef PLACE
  float far = smoothstep(NEAR_PLACE, FAR_PLACE, length(hit));
#else
  float behind = dot(d.xy, normalize(ahead.xy));
  float top = (TOP - from.z) * max(behind, 0.05) / (WALL - dot(from.xy, normalize(ahead.xy))), soft = 0.01 + 1.2 * rough;
  float wall = smoothstep(0.3 - rough, 0.6 + rough, behind / max(length(d.xy), 1e-4)) * smoothstep(top + soft, top - soft, d.z);
  seen = mix(seen, DIM * ground * level, wall);
  float far = smoothstep(FRONT, 2.5 * FRONT, -dot(hit, normalize(ahead.xy)));
#endif
  return mix(seen, mix(stage(hit), seen, far), below);
}
// what stands behind the object
vec3 behind(vec3 d) {
  vec2 hit = eye.xy + d.xy * (eye.z / max(-d.z, 0.01));
#ifdef PLACE
  LIGHT seen = lookup(d, 0.6);
  return d.z < 0.0 ? mix(stage(hit), seen, smoothstep(NEAR_PLACE, FAR_PLACE, length(hit))) : seen;
#else
  return vec3(stage(hit));
#endif
}
vec3 encode(vec3 c) {
  float y = clamp(dot(c, vec3(0.2126, 0.7152, 0.0722)), 0.0, 1.0);
  float low = min(c.r, min(c.g, c.b)), high = max(c.r, max(c.g, c.b)), keep = 1.0;
  if (low < 0.0) keep = min(keep, y / max(y - low, 1e-6));     // out of gamut: chroma is lowered, luminance kept
  if (high > 1.0) keep = min(keep, (1.0 - y) / max(high - y, 1e-6));
  c = clamp(mix(vec3(y), c, keep), 0.0, 1.0);
  return mix(12.92 * c, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c));
}
// what the material sends to the eye from a place on it
vec3 material(vec3 spot, vec3 d, vec3 n, vec3 down) {
  float cosine = clamp(-dot(d, n), 0.0, 1.0);
  vec3 mirror = nacreColour(table, cosine, 0.0, first, 6.0), glossy = nacreColour(table, cosine, 0.0, first + 1.0, 6.0);
  vec3 spread = nacreColour(table, cosine, 0.0, first + 2.0, 6.0);
  float under = 0.5 * (1.0 - n.z);
  LIGHT light = matt(n) * smoothstep(-1.0, 0.6, n.z) + under * under * stage(down.xy);
  vec3 seen = mirror * incoming(spot, reflect(d, n), alpha) + spread * light;
  if (gloss > 0.0) seen += glossy * incoming(spot, reflect(d, n), gloss);
  return seen;
}`;

export const BALL = `${COMMON}
void main() {
  vec2 at = (gl_FragCoord.xy - 0.5 * size) / (0.5 * size.x);
  vec3 d = normalize(ahead + at.x * right + at.y * up);
  vec3 o = eye - CENTRE;
  float b = dot(o, d), c = dot(o, o) - 1.0, disc = b * b - c;
  vec3 back = behind(d);
  float pixel = 2.0 * length(right) / size.x * length(o);
  float cover = clamp(0.5 + (1.0 - sqrt(max(dot(o, o) - b * b, 0.0))) / pixel, 0.0, 1.0);
  if (cover > 0.0) {
    vec3 p = o + d * (-b - sqrt(max(disc, 0.0)));
    back = mix(back, material(p + CENTRE, d, normalize(p), p * 1.6), cover);
  }
  colour = vec4(encode(back * exp2(exposure)), 1.0);
}`;

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

// The normal as a place on an octahedron, 16 bits each way; the part's number, and whether a line of u, v runs there.
export const MESH = `
in vec3 n;
in vec2 uv;
uniform float part;
layout(location = 0) out vec4 facing;
layout(location = 1) out vec4 kind;
vec2 split(float x) { float whole = floor(x * 65535.0 + 0.5), high = floor(whole / 256.0); return vec2(high, whole - 256.0 * high) / 255.0; }
void main() {
  vec3 m = n / max(abs(n.x) + abs(n.y) + abs(n.z), 1e-9);
  vec2 o = m.z >= 0.0 ? m.xy : (1.0 - abs(m.yx)) * vec2(m.x >= 0.0 ? 1.0 : -1.0, m.y >= 0.0 ? 1.0 : -1.0);
  facing = vec4(split(0.5 + 0.5 * o.x), split(0.5 + 0.5 * o.y));
  vec2 line = abs(fract(uv * 10.0 + 0.5) - 0.5) / max(fwidth(uv * 10.0), vec2(1e-5));
  kind = vec4(part / 255.0, smoothstep(2.5, 0.8, min(line.x, line.y)), 0.0, 1.0);
}`;

export const SHADE = `${COMMON}
${DEPTHS}
uniform sampler2D facing, kind, depth;
uniform vec3 plain[8];          // of what is not of the material: matt and mirror reflectance, roughness; else below 0
uniform float grid;

int partAt(ivec2 at) { return int(texelFetch(kind, at, 0).r * 255.0 + 0.5); }
vec3 normalAt(ivec2 at) {
  vec4 f = texelFetch(facing, at, 0) * 255.0;
  vec2 o = vec2(f.x * 256.0 + f.y, f.z * 256.0 + f.w) / 65535.0 * 2.0 - 1.0;
  vec3 n = vec3(o, 1.0 - abs(o.x) - abs(o.y));
  if (n.z < 0.0) n.xy = (1.0 - abs(n.yx)) * vec2(n.x >= 0.0 ? 1.0 : -1.0, n.y >= 0.0 ? 1.0 : -1.0);
  return normalize(n);
}
vec3 seenAt(ivec2 fine) {
  vec2 at = (vec2(fine) + 0.5 - size) / size.x;        // fine pixels: two to one
  vec3 ray = ahead + at.x * right + at.y * up, d = normalize(ray);
  int part = partAt(fine);
  if (part == 0) return behind(d);
  float z = 2.0 * texelFetch(depth, fine, 0).r - 1.0;
  vec3 spot = eye + ray * (2.0 * FAR * NEAR / (FAR + NEAR - z * (FAR - NEAR))), n = normalAt(fine), seen;
  if (dot(n, d) > 0.12) n = -n;                        // seen from behind, not just over a rounded edge
  vec3 own = plain[part - 1];
  if (own.x < 0.0) {
    seen = material(spot, d, n, spot * 1.2);
    return grid > 0.5 ? mix(seen, vec3(0.02), 0.75 * texelFetch(kind, fine, 0).g) : seen;
  }
  float cosine = clamp(-dot(d, n), 0.0, 1.0), under = 0.5 * (1.0 - n.z);
  LIGHT light = matt(n) * smoothstep(-1.0, 0.6, n.z) + under * under * stage(spot.xy * 1.2);
  float fresnel = own.y > 0.0 ? own.y + (1.0 - own.y) * pow(1.0 - cosine, 5.0) * (1.0 - own.z) : 0.0;
  return vec3(own.x * light + fresnel * incoming(spot, reflect(d, n), own.z));
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
