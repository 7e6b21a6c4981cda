// The object on its stage, turned by the pointer or by keys; one look, or two side by side.

import { FRAGMENT, VERTEX } from "./shaders.js";

const DISTANCE = Math.hypot(8.6, 1.77), TARGET = [0, 0, 0.93], FOV = 19;  // the camera of pictures of a sphere
const SLOW_MS = 20, FEWEST = 400;  // pixels a side
const FRONT = { azimuth: 0, elevation: 11.63 };

export class View {
  // Throws where the browser has no WebGL2; `tables` is the text of the exported shaders.
  constructor(canvas, onTurn, tables) {
    const gl = canvas.getContext("webgl2", { antialias: false, alpha: false, preserveDrawingBuffer: true });
    if (!gl) throw new Error("no WebGL2");
    Object.assign(this, { canvas, gl, onTurn, tables, look: null, other: null, side: "a", split: 0.5, room: null, exposure: 0, ...FRONT, isAsked: false, most: 1024, trials: 3 });
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
    this.at = Object.fromEntries(["table", "first", "room", "eye", "right", "up", "ahead", "size", "alpha", "gloss", "layers", "exposure", "level"]
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

  // A look to compare with, or null; which is drawn: "a", "b", or "both", split at a share of the width.
  setOther(other) {
    this.other = other;
    this.upload();
    this.draw();
  }

  show(side, split) {
    Object.assign(this, { side, split });
    this.draw();
  }

  // A small picture of A as the canvas shows it, as a data address.
  thumbnail(pixels) {
    const { side } = this, small = Object.assign(document.createElement("canvas"), { width: pixels, height: pixels });
    if (side !== "a") this.show("a", this.split);
    const edge = 0.12 * this.canvas.width, inner = this.canvas.width - 2 * edge;
    small.getContext("2d").drawImage(this.canvas, edge, edge, inner, inner, 0, 0, pixels, pixels);
    if (side !== "a") this.show(side, this.split);
    return small.toDataURL("image/jpeg", 0.82);
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
    const count = this.look.mirror.length / 3, texels = new Float32Array(6 * count * 4), other = this.other ?? this.look;
    [this.look.mirror, this.look.gloss, this.look.spread, other.mirror, other.gloss, other.spread].forEach((part, row) => {
      for (let i = 0; i < count; i++) texels.set([part[3 * i], part[3 * i + 1], part[3 * i + 2], 1], 4 * (row * count + i));
    });
    gl.activeTexture(gl.TEXTURE0);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA16F, count, 6, 0, gl.RGBA, gl.FLOAT, texels);
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
    gl.uniform1f(this.at.layers, this.room.layers);
    gl.uniform1f(this.at.level, this.room.level);
    gl.uniform1f(this.at.exposure, this.exposure);
    const began = performance.now();
    const { width } = this.canvas, side = this.other ? this.side : "a";
    const cut = side === "a" ? width : side === "b" ? 0 : Math.round(width * this.split);
    this.drawLook(this.look, 0, 0, cut);
    if (this.other) this.drawLook(this.other, 3, cut, width);
    if (this.trials > 0) this.judge(began);
    this.canvas.dataset.seq = this.look.seq;
  }

  drawLook(look, first, from, to) {
    if (to <= from) return;
    const gl = this.gl;
    gl.uniform1f(this.at.first, first);
    gl.uniform1f(this.at.alpha, look.alpha);
    gl.uniform1f(this.at.gloss, look.gloss_alpha);
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(from, 0, to - from, this.canvas.height);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
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
