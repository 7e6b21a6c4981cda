// The shader of the object: one triangle over the whole canvas; each pixel looks up its colour over the angle and the
// blurred room. Look-ups are those of exported tables: table.glsl stands before it, the same text as in `shader.glsl`.

export const VERTEX = `#version 300 es
void main() { vec2 p = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0); gl_Position = vec4(p, 0.0, 1.0); }`;

export const FRAGMENT = `
precision highp sampler2DArray;
uniform sampler2D table;        // rows: mirror-like, glossy, spread, of A and of B; over the angle from 0 to 90 degrees
uniform float first;            // row of the look that is drawn
uniform sampler2DArray room;    // layers: blurred by roughness, the last one for a matt white surface
uniform vec3 eye, right, up, ahead;
uniform vec2 size;
uniform float alpha, gloss, layers, exposure, level;    // level: of a matt white floor
out vec4 colour;
const float PI = 3.14159265;
const vec3 CENTRE = vec3(0.0, 0.0, 1.0);
// the stage of pictures: a grey floor that rises behind the object; fitted to what Mitsuba renders of it
const float FLOOR = 0.15, WALL = 9.5, TOP = 5.2, DIM = 0.2, FRONT = 16.0;

float lookup(vec3 d, float layer) {
  float low = floor(layer);
  vec2 at = vec2(atan(d.y, d.x) / (2.0 * PI), acos(clamp(d.z, -1.0, 1.0)) / PI);
  float one = texture(room, vec3(at, low)).r;
  return mix(one, texture(room, vec3(at, min(low + 1.0, layers - 2.0))).r, layer - low);
}
float matt(vec3 n) {
  return texture(room, vec3(atan(n.y, n.x) / (2.0 * PI), acos(clamp(n.z, -1.0, 1.0)) / PI, layers - 1.0)).r;
}
// the floor lit by the room, less what the sphere hides of it (form factor of a sphere from a horizontal element)
float stage(vec2 p) {
  float behind = max(dot(p, normalize(ahead.xy)), 0.0);
  float fall = DIM + (1.0 - DIM) / (1.0 + pow(behind / 5.4, 2.3));
  return FLOOR * level * fall * (1.0 - 0.9 * pow(dot(p, p) + 1.0, -1.5));
}
float incoming(vec3 from, vec3 d, float rough) {
  float layer = rough < 0.001 ? 0.0 : clamp(log2(rough / 0.03125) + 1.0, min(rough / 0.03125, 1.0), layers - 2.0);
  float seen = lookup(d, layer), spread = 0.01 + 0.9 * rough;
  float behind = dot(d.xy, normalize(ahead.xy));
  float top = (TOP - from.z) * max(behind, 0.05) / (WALL - dot(from.xy, normalize(ahead.xy))), soft = 0.01 + 1.2 * rough;
  float wall = smoothstep(0.3 - rough, 0.6 + rough, behind / max(length(d.xy), 1e-4)) * smoothstep(top + soft, top - soft, d.z);
  seen = mix(seen, DIM * FLOOR * level, wall);
  float below = smoothstep(spread, -spread, d.z);
  vec3 down = vec3(d.xy, min(d.z, -0.06 - 0.5 * rough));
  vec2 hit = from.xy + down.xy * (from.z / -down.z);
  float far = smoothstep(FRONT, 2.5 * FRONT, -dot(hit, normalize(ahead.xy)));
  return mix(seen, mix(stage(hit), seen, far), below);
}
vec3 encode(vec3 c) {
  float y = clamp(dot(c, vec3(0.2126, 0.7152, 0.0722)), 0.0, 1.0);
  float low = min(c.r, min(c.g, c.b)), high = max(c.r, max(c.g, c.b)), keep = 1.0;
  if (low < 0.0) keep = min(keep, y / max(y - low, 1e-6));     // out of gamut: chroma is lowered, luminance kept
  if (high > 1.0) keep = min(keep, (1.0 - y) / max(high - y, 1e-6));
  c = clamp(mix(vec3(y), c, keep), 0.0, 1.0);
  return mix(12.92 * c, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c));
}
void main() {
  vec3 sum = vec3(0.0);
  vec2 at = (gl_FragCoord.xy - 0.5 * size) / (0.5 * size.x);
  vec3 d = normalize(ahead + at.x * right + at.y * up);
  vec3 o = eye - CENTRE;
  float b = dot(o, d), c = dot(o, o) - 1.0, disc = b * b - c;
  vec3 back = vec3(stage(eye.xy + d.xy * (eye.z / max(-d.z, 0.01))));
  float pixel = 2.0 * length(right) / size.x * length(o);
  float cover = clamp(0.5 + (1.0 - sqrt(max(dot(o, o) - b * b, 0.0))) / pixel, 0.0, 1.0);
  if (cover > 0.0) {
    vec3 p = o + d * (-b - sqrt(max(disc, 0.0)));
    vec3 n = normalize(p);
    float cosine = clamp(-dot(d, n), 0.0, 1.0);
    vec3 mirror = nacreColour(table, cosine, 0.0, first, 6.0), glossy = nacreColour(table, cosine, 0.0, first + 1.0, 6.0);
    vec3 spread = nacreColour(table, cosine, 0.0, first + 2.0, 6.0);
    float ground = 0.5 * (1.0 - n.z);
    float light = matt(n) * smoothstep(-1.0, 0.6, n.z) + ground * ground * stage(p.xy * 1.6);
    vec3 seen = mirror * incoming(p + CENTRE, reflect(d, n), alpha) + spread * light;
    if (gloss > 0.0) seen += glossy * incoming(p + CENTRE, reflect(d, n), gloss);
    back = mix(back, seen, cover);
  }
  colour = vec4(encode(back * exp2(exposure)), 1.0);
}`;
