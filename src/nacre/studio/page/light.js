// Light of the room reflected by the ball, integrated over each lobe. It is independent of the recipe's colours, therefore it is
// integrated and cached once view, room and roughness stop changing, strip by strip. Until then the page uses one look-up in
// a blurred room. Other objects use the light of a ball: each pixel at the point that reflects the same part of the room.

const REST_MS = 160, STRIP_MS = 12, STRIPS = 16;
const FINE = 256, ROUGH = 0.08;                 // pixels along a side; above this roughness the coarse size is used
export const COARSE = 128;
const MAX_CACHED = 3;
const FIRST_UNIT = 5;                           // textures 0 to 4 are the view's own

export class Light {
  // `draw(strip)` renders a part of the buffer; `onDone` is called when a light is complete.
  constructor(gl, draw, onDone) {
    Object.assign(this, { gl, draw, onDone, cached: new Map(), pending: new Map(), current: null, timer: 0 });
    this.isAble = Boolean(gl.getExtension("EXT_color_buffer_float") || gl.getExtension("EXT_color_buffer_half_float"));
  }

  // Bind the light of an appearance and return true, or schedule its integration.
  bind(key, appearance) {
    if (!this.isAble) return false;
    const made = this.cached.get(key);
    if (made) {
      this.cached.delete(key);
      this.cached.set(key, made);         // least recently used first
      made.textures.forEach((texture, i) => this.on(FIRST_UNIT + i, texture));
      return true;
    }
    this.pending.set(key, appearance);
    return false;
  }

  // Called after a picture: drop lights that it did not use.
  settle(keys) {
    for (const key of this.pending.keys()) if (!keys.includes(key)) this.pending.delete(key);
    if (this.current && !this.pending.has(this.current.key)) { this.free(this.current); this.current = null; }
    clearTimeout(this.timer);
    if (this.pending.size) this.timer = setTimeout(() => this.go(), REST_MS);
  }

  get isDone() { return !this.pending.size || !this.isAble; }

  forget() {
    for (const made of this.cached.values()) this.free(made);
    this.cached.clear();
    this.pending.clear();
    if (this.current) this.free(this.current);
    this.current = null;
  }

  on(unit, texture) {
    this.gl.activeTexture(this.gl.TEXTURE0 + unit);
    this.gl.bindTexture(this.gl.TEXTURE_2D, texture);
  }

  go() {
    const gl = this.gl, [entry] = this.pending;
    if (!entry || gl.isContextLost()) return;
    const [key, appearance] = entry;
    this.current ??= this.begin(key, appearance);
    if (!this.current) return;
    const { frame, pixels, at } = this.current, next = Math.min(at + Math.ceil(pixels / STRIPS), pixels);
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    gl.viewport(0, 0, pixels, pixels);
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(0, at, pixels, next - at);
    this.draw(appearance, pixels);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    this.current.at = next;
    if (next < pixels) { this.timer = setTimeout(() => this.go(), STRIP_MS); return; }
    this.cached.set(key, this.current);
    this.current = null;
    this.pending.delete(key);
    for (const old of this.cached.keys()) {
      if (this.cached.size <= MAX_CACHED) break;
      this.free(this.cached.get(old));
      this.cached.delete(old);
    }
    if (this.pending.size) this.timer = setTimeout(() => this.go(), STRIP_MS);
    this.onDone();
  }

  begin(key, appearance) {
    const gl = this.gl, widths = [appearance.alpha, appearance.gloss_alpha].filter((width) => width > 0.001);
    const pixels = widths.length && Math.min(...widths) < ROUGH ? FINE : COARSE;
    const made = { key, pixels, at: 0, frame: gl.createFramebuffer(), textures: [] };
    gl.bindFramebuffer(gl.FRAMEBUFFER, made.frame);
    for (let i = 0; i < 3; i++) {
      const texture = gl.createTexture();
      this.on(FIRST_UNIT + i, texture);
      for (const way of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, way, gl.LINEAR);
      for (const way of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, way, gl.CLAMP_TO_EDGE);
      gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA16F, pixels, pixels);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0 + i, gl.TEXTURE_2D, texture, 0);
      made.textures.push(texture);
    }
    gl.drawBuffers([0, 1, 2].map((i) => gl.COLOR_ATTACHMENT0 + i));
    if (gl.checkFramebufferStatus(gl.FRAMEBUFFER) !== gl.FRAMEBUFFER_COMPLETE) {
      this.isAble = false;
      this.free(made);
      return null;
    }
    return made;
  }

  free({ frame, textures }) {
    for (const texture of textures) this.gl.deleteTexture(texture);
    this.gl.deleteFramebuffer(frame);
  }
}
