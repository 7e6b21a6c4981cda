// The sphere: one triangle over the whole canvas; each pixel looks up its colour over the angle and the blurred room.
// Look-ups are those of exported tables: table.glsl stands before this shader, the same text as in `shader.glsl`.

const VERTEX = `#version 300 es
void main() { vec2 p = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0); gl_Position = vec4(p, 0.0, 1.0); }`;

const FRAGMENT = `
precision highp sampler2DArray;
uniform sampler2D table;        // rows: mirror-like, glossy, spread; over the angle from 0 to 90 degrees
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
    vec3 mirror = nacreColour(table, cosine, 0.0, 0.0, 3.0), glossy = nacreColour(table, cosine, 0.0, 1.0, 3.0);
    vec3 spread = nacreColour(table, cosine, 0.0, 2.0, 3.0);
    float ground = 0.5 * (1.0 - n.z);
    float light = matt(n) * smoothstep(-1.0, 0.6, n.z) + ground * ground * stage(p.xy * 1.6);
    vec3 seen = mirror * incoming(p + CENTRE, reflect(d, n), alpha) + spread * light;
    if (gloss > 0.0) seen += glossy * incoming(p + CENTRE, reflect(d, n), gloss);
    back = mix(back, seen, cover);
  }
  colour = vec4(encode(back * exp2(exposure)), 1.0);
}`;

const DISTANCE = Math.hypot(8.6, 1.77), TARGET = [0, 0, 0.93], FOV = 19;  // the camera of pictures of a sphere
const SLOW_MS = 20, FEWEST = 400;  // pixels a side
const FRONT = { azimuth: 0, elevation: 11.63 };

export class View {
  // Throws where the browser has no WebGL2; `tables` is the text of the exported shaders.
  constructor(canvas, onTurn, tables) {
    const gl = canvas.getContext("webgl2", { antialias: false, alpha: false, preserveDrawingBuffer: true });
    if (!gl) throw new Error("no WebGL2");
    Object.assign(this, { canvas, gl, onTurn, tables, look: null, room: null, exposure: 0, ...FRONT, isAsked: false, most: 1024, trials: 3 });
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => { this.uploaded = null; this.build(); this.upload(); this.draw(); });
    this.build();
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.listen();
  }

  build() {
    const gl = this.gl;
    const program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, `#version 300 es\n${this.tables}${FRAGMENT}`]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) throw new Error("no WebGL2");
    gl.useProgram(program);
    this.at = Object.fromEntries(["table", "room", "eye", "right", "up", "ahead", "size", "alpha", "gloss", "layers", "exposure", "level"]
      .map((name) => [name, gl.getUniformLocation(program, name)]));
    this.tableTexture = this.texture(0, gl.TEXTURE_2D, gl.CLAMP_TO_EDGE);
    this.roomTexture = this.texture(1, gl.TEXTURE_2D_ARRAY, gl.REPEAT);
    gl.uniform1i(this.at.table, 0);
    gl.uniform1i(this.at.room, 1);
  }

  texture(unit, kind, wrap) {
    const gl = this.gl, made = gl.createTexture();
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(kind, made);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(kind, filter, gl.LINEAR);
    gl.texParameteri(kind, gl.TEXTURE_WRAP_S, wrap);
    gl.texParameteri(kind, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    return made;
  }

  setRoom(values, { rows, columns, alphas }) {
    const layers = alphas.length + 1, level = values[(layers - 1) * rows * columns];  // of the last layer, at the zenith
    this.room = { values, rows, columns, layers, level };
    this.upload();
    this.draw();
  }

  setLook(look) {
    this.look = look;
    this.upload();
    this.draw();
  }

  upload() {
    const gl = this.gl;
    if (this.room && this.uploaded !== this.room) {
      const { values, rows, columns, layers } = this.room;
      gl.activeTexture(gl.TEXTURE1);
      this.uploaded = this.room;
      gl.texImage3D(gl.TEXTURE_2D_ARRAY, 0, gl.R16F, columns, rows, layers, 0, gl.RED, gl.FLOAT, values);
    }
    if (!this.look) return;
    const count = this.look.mirror.length / 3, texels = new Float32Array(3 * count * 4);
    [this.look.mirror, this.look.gloss, this.look.spread].forEach((part, row) => {
      for (let i = 0; i < count; i++) texels.set([part[3 * i], part[3 * i + 1], part[3 * i + 2], 1], 4 * (row * count + i));
    });
    gl.activeTexture(gl.TEXTURE0);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA16F, count, 3, 0, gl.RGBA, gl.FLOAT, texels);
  }

  resize() {
    const side = Math.max(64, Math.min(this.most, Math.round(this.canvas.clientWidth * Math.min(devicePixelRatio, 2))));
    if (this.canvas.width !== side) Object.assign(this.canvas, { width: side, height: side });
    this.draw();
  }

  draw() {
    const gl = this.gl;
    if (!this.look || !this.room || gl.isContextLost()) return;
    const azimuth = (this.azimuth * Math.PI) / 180, elevation = (this.elevation * Math.PI) / 180;
    const toEye = [Math.sin(azimuth) * Math.cos(elevation), -Math.cos(azimuth) * Math.cos(elevation), Math.sin(elevation)];
    const half = Math.tan((FOV * Math.PI) / 360);
    const right = [Math.cos(azimuth) * half, Math.sin(azimuth) * half, 0];
    const up = [-Math.sin(azimuth) * Math.sin(elevation) * half, Math.cos(azimuth) * Math.sin(elevation) * half, Math.cos(elevation) * half];
    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    gl.uniform3fv(this.at.eye, TARGET.map((t, i) => t + DISTANCE * toEye[i]));
    gl.uniform3fv(this.at.ahead, toEye.map((x) => -x));
    gl.uniform3fv(this.at.right, right);
    gl.uniform3fv(this.at.up, up);
    gl.uniform2f(this.at.size, this.canvas.width, this.canvas.height);
    gl.uniform1f(this.at.alpha, this.look.alpha);
    gl.uniform1f(this.at.gloss, this.look.gloss_alpha);
    gl.uniform1f(this.at.layers, this.room.layers);
    gl.uniform1f(this.at.level, this.room.level);
    gl.uniform1f(this.at.exposure, this.exposure);
    const began = performance.now();
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    if (this.trials > 0) this.judge(began);
    this.canvas.dataset.seq = this.look.seq;
  }

  // Without a graphics card the CPU draws: then fewer pixels keep the page at the pointer's speed.
  judge(began) {
    const gl = this.gl;
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));  // waits until all is drawn
    this.trials -= 1;
    if (this.trials === 0 && performance.now() - began > SLOW_MS) this.most = FEWEST;
    requestAnimationFrame(() => {
      this.resize();
      this.canvas.dataset.judged = String(this.trials === 0);
    });
  }

  turn(azimuth, elevation) {
    this.azimuth = ((azimuth % 360) + 360) % 360;
    this.elevation = Math.max(2, Math.min(85, elevation));
    if (this.isAsked) return;
    this.isAsked = true;
    requestAnimationFrame(() => { this.isAsked = false; this.draw(); });
  }

  front() { this.turn(FRONT.azimuth, FRONT.elevation); }

  listen() {
    let last = null;
    this.canvas.addEventListener("pointerdown", (event) => {
      last = event;
      this.canvas.setPointerCapture(event.pointerId);
    });
    this.canvas.addEventListener("pointermove", (event) => {
      if (!last) return;
      this.turn(this.azimuth - 0.4 * (event.clientX - last.clientX), this.elevation + 0.4 * (event.clientY - last.clientY));
      last = event;
    });
    for (const end of ["pointerup", "pointercancel"]) this.canvas.addEventListener(end, () => { last = null; });
    this.canvas.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: [-5, 0], ArrowRight: [5, 0], ArrowUp: [0, 5], ArrowDown: [0, -5] }[event.key];
      if (!step) return;
      event.preventDefault();
      this.turn(this.azimuth + step[0], this.elevation + step[1]);
    });
  }
}
