// The object on its stage, turned by pointer or keys; one appearance, or two side by side.

import { COARSE, Light } from "./light.js";
import { MESH, MESH_VERTEX, SHADE } from "./meshes.js";
import { BACKDROP, BALL, COVER, GATHER } from "./shaders.js";

// camera of pictures of a sphere, and the shade below it
const SPHERE = { distance: Math.hypot(8.6, 1.77), target: [0, 0, 0.93], fov: 19, foot: [0, 0, 1, 1], azimuth: 0, elevation: 11.63 };
const UNIFORMS = ["table", "first", "room", "eye", "right", "up", "ahead", "size", "foot", "ball", "alpha", "gloss", "layers", "exposure", "level", "ground", "plain", "part", "grid", "facing", "kind", "depth", "throughMirror", "throughGloss", "throughMatt", "square", "lampTo", "lampPower", "lampRadius", "paper", "printed", "pixels", "beckmann", "compensated", "lobes", "count", "nacreLobe", "backdrop", "mirrored", "solid", "farFacing", "farKind", "farDepth", "sheets", "placeMap", "surfaceAt", "across"];
const SAMPLERS = ["table", "room", "facing", "kind", "depth", "throughMirror", "throughGloss", "throughMatt", "nacreLobe", "backdrop", "mirrored", "paper", "farFacing", "farKind", "farDepth", "sheets", "placeMap", "surfaceAt"];
const SQUARE = 0.55;    // chequers below clear materials, as in pictures
const DEFINES = { gathered: "#define GATHERED\n", shadeGathered: "#define GATHERED\n", gather: "#define GATHERS\n#define NACRE_LOBE\n#define NACRE_LOBE_SLICES 4.0\n#define NACRE_LOBE_SCALE 1.0\n" };   // see `lobe_image` in appearance.py
const EXTRA = 2;        // layers of the room that are not light: shade of the ball, light of the stage
const SHADERS = { ball: [COVER, BALL], gathered: [COVER, BALL], gather: [COVER, GATHER], backdrop: [COVER, BACKDROP], mesh: [MESH_VERTEX, MESH], shade: [COVER, SHADE], shadeGathered: [COVER, SHADE] };
const FINER = 2;        // triangles are drawn at twice the resolution for smooth edges
const MOST_PARTS = 8;
const NEAR_UNIT = 2, PAPER_UNIT = 11, FAR_UNIT = 12, PLACE_UNIT = 16, SURFACE_UNIT = 17;    // texture units, see `SAMPLERS`
const SLOW_MS = 20, FEWEST = 400;  // pixels a side
let backdrops = 0;      // drawn so far

// integrated lobes: facets, gloss, matt surface; or a lobe table instead of the last two
const lobeBits = (appearance) => (appearance.lobe ? 8 : 0) + (appearance.alpha >= 0.001 ? 1 : 0) + (appearance.gloss_alpha > 0 ? 2 : 0) + (appearance.spread.some((value) => value > 1e-4) ? 4 : 0);

// Look-ups of the integrated lobes; a lobe table uses the slot of the matt surface.
const lobesOf = (appearance) => [[1, "FACETS"], ...(appearance.lobe ? [[8, "LOBE"]] : [[2, "GLOSS"], [4, "MATT"]])].map(([bit, lobe]) => (lobeBits(appearance) & bit ? `#define ${lobe}\n` : "")).join("");
const OF_LOBES = ["gathered", "shadeGathered"], OF_THROUGH = [...OF_LOBES, "ball", "shade"];
const definesOf = (name, appearance) => (appearance && OF_LOBES.includes(name) ? lobesOf(appearance) : "") + (appearance?.through && OF_THROUGH.includes(name) ? "#define CLEAR\n" : "") + (appearance?.grades && OF_THROUGH.includes(name) ? "#define GRADED\n" : "");
const BANDS = 4;        // parts of the table per appearance
const shapeOf = (appearance, name) => appearance.arrays.find(([one]) => one === name)?.[1];
// Nodes of a graded appearance, as [of the second range, of the first].
const nodesOf = (appearance) => shapeOf(appearance, "grades")?.slice(1, 3) ?? [1, 1];

// Share of the light that an object blocks from the floor; light passes a free film twice.
const solidOf = ({ through }) => (through ? 1 - (0.2126 * through[0] + 0.7152 * through[1] + 0.0722 * through[2]) ** 2 : 1);

export class View {
  // Throws if the browser has no WebGL2; `tables` is the text of the exported shaders.
  constructor(canvas, onTurn, tables) {
    const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, preserveDrawingBuffer: true });
    if (!gl) throw new Error("no WebGL2");
    Object.assign(this, { canvas, gl, onTurn, tables, appearance: null, other: null, side: "a", split: 0.5, room: null, exposure: 0, object: SPHERE, grid: false, azimuth: SPHERE.azimuth, elevation: SPHERE.elevation, isScheduled: false, most: 1024, trials: 3 });
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => { this.uploaded = null; this.build(); this.upload(); this.setObject(this.object, true); });
    this.build();
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.listen();
  }

  build() {
    const gl = this.gl;
    this.programs = new Map();
    this.light = new Light(gl, (appearance, pixels) => this.gather(appearance, pixels), () => this.draw());
    this.use("ball");
    this.buffer = this.corners = this.lobeTexture = this.backdrop = null;
    this.painted = {};          // by row: the ball for which the whole canvas was drawn, see `boxOf`
    this.columns = this.rows = 0;           // of the uploaded table
    this.placed = new Map();    // maps of the surface, by graded appearance
    this.tableTexture = this.texture(0, gl.TEXTURE_2D, gl.CLAMP_TO_EDGE);
    this.paperTexture = this.texture(PAPER_UNIT, gl.TEXTURE_2D, gl.CLAMP_TO_EDGE);
    this.roomTexture = this.texture(1, gl.TEXTURE_2D_ARRAY, gl.REPEAT);
  }

  // A program by its features, compiled on first use. Each set of lobes has its own: on the CPU an unused branch costs as much as
  // a used one.
  use(name, appearance) {
    const gl = this.gl, isPlace = Boolean(this.room?.floor) && name !== "mesh", lobes = definesOf(name, appearance), key = name + isPlace + lobes;
    if (!this.programs.has(key)) {
      const program = gl.createProgram(), [vertex, fragment] = SHADERS[name];
      for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, `#version 300 es\n${DEFINES[name] ?? ""}${lobes}${isPlace ? "#define PLACE\n" : ""}${this.tables}${fragment}`]]) {
        const shader = gl.createShader(kind);
        gl.shaderSource(shader, source);
        gl.compileShader(shader);
        if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) console.warn(gl.getShaderInfoLog(shader));
        gl.attachShader(program, shader);
      }
      gl.linkProgram(program);
      if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) throw new Error("no WebGL2");
      gl.useProgram(program);
      const at = Object.fromEntries(UNIFORMS.map((one) => [one, gl.getUniformLocation(program, one)]));
      SAMPLERS.forEach((one, unit) => { if (at[one]) gl.uniform1i(at[one], unit); });
      this.programs.set(key, { program, at });
    }
    const { program, at } = this.programs.get(key);
    gl.useProgram(program);
    return at;
  }

  texture(unit, kind, wrap, filter = this.gl.LINEAR) {
    const gl = this.gl, made = gl.createTexture();
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(kind, made);
    for (const way of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(kind, way, filter);
    gl.texParameteri(kind, gl.TEXTURE_WRAP_S, wrap);
    gl.texParameteri(kind, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    return made;
  }

  // Radiance over all directions by layers, with one channel or three; `floor`: its colour for a visible place, else null;
  // `lamp`: the small bright lamp.
  setRoom(values, { rows, columns, alphas }, floor, lamp = null) {
    const layers = alphas.length + 1, channels = values.length / ((layers + EXTRA) * rows * columns);
    const zenith = channels * (layers - 1) * rows * columns, power = lamp ? lamp.irradiance : [0, 0, 0], towards = lamp ? lamp.towards : [0, 0, 1];
    const of = (c) => values[zenith + Math.min(c, channels - 1)] + (power[c] * towards[2]) / Math.PI;       // the last layer and the lamp
    this.light.forget();
    this.room = { values, rows, columns, layers, channels, floor, level: [of(0), of(1), of(2)], lamp: { towards, power, radius: lamp ? lamp.radius : 1 } };
    this.upload();
    this.draw();
  }

  setAppearance(appearance) {
    this.appearance = appearance;
    this.upload();
    this.draw();
  }

  // The compared appearance or null; shown are "a", "b", or "both", split at a share of the width.
  setOther(other) {
    this.other = other;
    this.upload();
    this.draw();
  }

  show(side, split) {
    Object.assign(this, { side, split });
    this.draw();
  }

  // A thumbnail of A as a data URI.
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
      const { values, rows, columns, layers, channels } = this.room;
      gl.activeTexture(gl.TEXTURE1);
      this.uploaded = this.room;
      const [held, sent] = channels === 1 ? [gl.R16F, gl.RED] : [gl.RGB16F, gl.RGB];
      gl.texImage3D(gl.TEXTURE_2D_ARRAY, 0, held, columns, rows, layers + EXTRA, 0, sent, gl.FLOAT, values);
    }
    if (!this.appearance) return;
    const count = this.appearance.mirror.length / 3, appearances = [this.appearance, this.other ?? this.appearance];
    const [across, along] = [0, 1].map((i) => Math.max(...appearances.map((appearance) => nodesOf(appearance)[i]))), rows = 2 * BANDS * across * along, texels = new Float32Array(rows * count * 4);
    let at = 0;
    for (const appearance of appearances) {
      const [second, first] = nodesOf(appearance);
      [appearance.mirror, appearance.gloss, appearance.spread, appearance.through].forEach((part, band) => {
        for (let j = 0; j < across; j++) for (let i = 0; i < along; i++) {
          const near = (k, given, wanted) => Math.round((k * (given - 1)) / Math.max(wanted - 1, 1));
          const from = appearance.grades ? 3 * count * ((band * second + near(j, second, across)) * first + near(i, first, along)) : 0, values = appearance.grades ?? part;
          for (let k = 0; k < count; k++, at += 4) if (values) texels.set([values[from + 3 * k], values[from + 3 * k + 1], values[from + 3 * k + 2], 1], at);
        }
      });
    }
    this.across = across;
    gl.activeTexture(gl.TEXTURE0);
    if (this.columns === count && this.rows === rows) gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, count, rows, gl.RGBA, gl.FLOAT, texels);
    else gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA16F, count, rows, 0, gl.RGBA, gl.FLOAT, texels);
    this.rows = rows;
    for (const [appearance, texture] of this.placed) if (!appearances.includes(appearance)) { gl.deleteTexture(texture); this.placed.delete(appearance); }
    this.columns = count;
  }

  // Bind the map of the surface of a graded appearance.
  place(appearance) {
    const gl = this.gl, known = this.placed.get(appearance);
    if (known) {
      gl.activeTexture(gl.TEXTURE0 + PLACE_UNIT);
      gl.bindTexture(gl.TEXTURE_2D, known);
      return;
    }
    const [rows, columns] = shapeOf(appearance, "grade_map");
    this.placed.set(appearance, this.texture(PLACE_UNIT, gl.TEXTURE_2D, gl.CLAMP_TO_EDGE, appearance.stepped ? gl.NEAREST : gl.LINEAR));
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RG16F, columns, rows, 0, gl.RG, gl.FLOAT, appearance.grade_map);
  }

  resize() {
    const side = Math.max(64, Math.min(this.most, Math.round(this.canvas.clientWidth * Math.min(devicePixelRatio, 2))));
    if (this.canvas.width !== side) Object.assign(this.canvas, { width: side, height: side });
    this.draw();
  }

  // An object from the server (see objects.js), or null for the sphere; the camera is that of its pictures.
  setObject(object, isSame = false) {
    const gl = this.gl;
    this.object = object ?? SPHERE;
    if (this.corners) for (const one of [this.corners, this.order]) gl.deleteBuffer(one);
    this.corners = null;
    if (this.object.places) {
      this.corners = gl.createBuffer();
      this.order = gl.createBuffer();
      gl.bindBuffer(gl.ARRAY_BUFFER, this.corners);
      gl.bufferData(gl.ARRAY_BUFFER, this.object.places, gl.STATIC_DRAW);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.order);
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, this.object.order, gl.STATIC_DRAW);
      this.print(this.object);
      [[0, 3, 0], [1, 3, 12], [2, 2, 24]].forEach(([at, count, offset]) => {
        gl.enableVertexAttribArray(at);
        gl.vertexAttribPointer(at, count, gl.FLOAT, false, 32, offset);
      });
    } else for (const at of [0, 1, 2]) gl.disableVertexAttribArray(at);
    if (!isSame) Object.assign(this, { azimuth: this.object.azimuth, elevation: this.object.elevation });
    this.draw();
  }

  // The print on a part, or a blank sheet.
  print({ paper, print: [rows, columns] }) {
    const gl = this.gl;
    gl.activeTexture(gl.TEXTURE0 + PAPER_UNIT);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    if (rows) gl.texImage2D(gl.TEXTURE_2D, 0, gl.R8, columns, rows, 0, gl.RED, gl.UNSIGNED_BYTE, paper);
    else gl.texImage2D(gl.TEXTURE_2D, 0, gl.R8, 1, 1, 0, gl.RED, gl.UNSIGNED_BYTE, new Uint8Array([255]));
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 4);
    gl.generateMipmap(gl.TEXTURE_2D);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
  }

  draw() {
    const gl = this.gl;
    if (!this.appearance || !this.room || gl.isContextLost()) return;
    const { width, height } = this.canvas, side = this.other ? this.side : "a", began = performance.now();
    const cut = side === "a" ? width : side === "b" ? 0 : Math.round(width * this.split);
    if (this.object.places) this.drawTriangles(FINER * width, FINER * height, [this.appearance, this.other].some((appearance) => appearance?.through));
    gl.viewport(0, 0, width, height);
    this.drawAppearance(this.appearance, 0, 0, cut);
    if (this.other) this.drawAppearance(this.other, BANDS, cut, width);
    this.light.settle([this.appearance, this.other ?? this.appearance].map((appearance) => this.keyOf(appearance)));
    if (this.trials > 0) this.measureSpeed(began);
    this.canvas.dataset.seq = this.appearance.seq;
  }

  drawAppearance(appearance, first, from, to) {
    if (to <= from) return;
    const gl = this.gl, { places, parts } = this.object, [plainly, well] = places ? ["shade", "shadeGathered"] : ["ball", "gathered"];
    const isGathered = this.light.bind(this.keyOf(appearance), appearance);
    if (isGathered && !places) this.drawBackdrop(appearance, first);
    const [left, bottom, right, top] = this.boxOf(isGathered && !places, first, from, to);
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(left, bottom, Math.max(right - left, 0), top - bottom);
    const at = this.prepare(isGathered ? well : plainly, appearance, first);
    if (appearance.grades) {
      this.place(appearance);
      gl.uniform1f(at.across, this.across);
    }
    this.canvas.dataset.light = isGathered ? "gathered" : this.light.isAble ? "gathering" : "blurred";
    if (places) {
      const plain = new Float32Array(3 * MOST_PARTS).fill(-1);      // negative: the material
      parts.forEach((part, i) => { if (part.plain) plain.set(part.plain, 3 * i); });
      gl.uniform3fv(at.plain, plain);
      gl.uniform1f(at.grid, this.grid ? 1 : 0);
    }
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  // The part of the canvas that an appearance changes: all of it, or the box around the ball if the backdrop is unchanged.
  boxOf(isGathered, first, from, to) {
    const { width, height } = this.canvas, key = isGathered ? [this.backdrop.count, this.exposure, from, to].join() : "", known = key && this.painted[first] === key;
    if (!isGathered) this.painted = {};
    else this.painted[first] = key;
    if (!known) return [from, 0, to, height];
    const { toEye, right, up, half } = this.frame(), { distance, target } = this.object;
    const off = [0, 0, 1].map((c, i) => c - target[i]), dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2], z = distance - dot(off, toEye);
    const span = (axis, size) => {      // tangents from the eye to a ball of radius 1, in pixels
      const x = dot(off, axis) / half, reach = Math.sqrt(x * x + z * z - 1);
      return [-1, 1].map((way) => size * (0.5 + (0.5 * (x * z + way * reach)) / (z * z - 1) / half) + 2 * way);
    };
    const [left, last] = span(right, width).map(Math.round), [bottom, top] = span(up, height).map(Math.round);
    return [Math.max(from, left), Math.max(0, bottom), Math.min(to, last), Math.min(height, top)];
  }

  // Backdrop and mirror image of the ball, cached while view, size, room and stage stay the same.
  drawBackdrop(appearance, first) {
    const gl = this.gl, { width, height } = this.canvas, key = [this.azimuth, this.elevation, width, height, appearance.clear, solidOf(appearance)].join();
    if (this.backdrop?.key === key && this.backdrop.room === this.room) return;
    if (this.backdrop?.width !== width) {
      if (this.backdrop) { this.backdrop.textures.forEach((old) => gl.deleteTexture(old)); gl.deleteFramebuffer(this.backdrop.frame); }
      this.backdrop = { width, frame: gl.createFramebuffer(), textures: [] };
      gl.bindFramebuffer(gl.FRAMEBUFFER, this.backdrop.frame);
      for (const i of [0, 1]) {
        const texture = this.texture(9 + i, gl.TEXTURE_2D, gl.CLAMP_TO_EDGE, gl.NEAREST);
        gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA16F, width, height);
        gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0 + i, gl.TEXTURE_2D, texture, 0);
        this.backdrop.textures.push(texture);
      }
      gl.drawBuffers([gl.COLOR_ATTACHMENT0, gl.COLOR_ATTACHMENT1]);
    }
    const bind = (textures) => textures.forEach((texture, i) => { gl.activeTexture(gl.TEXTURE9 + i); gl.bindTexture(gl.TEXTURE_2D, texture); });
    Object.assign(this.backdrop, { key, room: this.room, count: (backdrops += 1) });
    bind([null, null]);         // a texture cannot be read while it is drawn
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.backdrop.frame);
    gl.disable(gl.SCISSOR_TEST);
    this.prepare("backdrop", appearance, first);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.enable(gl.SCISSOR_TEST);
    bind(this.backdrop.textures);
  }

  // Dependencies of the integrated light; the recipe's colours are not among them.
  keyOf(appearance) {
    const { target, distance, foot } = this.object;
    return JSON.stringify([target, distance, foot, this.azimuth, this.elevation, appearance.alpha, appearance.gloss_alpha, lobeBits(appearance), appearance.facets, appearance.lobe ? appearance.seq : 0]);
  }

  gather(appearance, pixels) {
    const gl = this.gl, at = this.prepare("gather", appearance, appearance === this.other ? BANDS : 0), { distribution, compensated } = appearance.facets;
    gl.uniform1f(at.pixels, pixels);
    gl.uniform1f(at.count, pixels > COARSE ? 64 : 128);      // directions of a lobe; fewer for a fine grid
    gl.uniform1f(at.beckmann, distribution === "ggx" ? 0 : 1);
    gl.uniform1f(at.compensated, compensated ? 1 : 0);
    gl.uniform1f(at.lobes, lobeBits(appearance));
    if (appearance.lobe) this.lobe(appearance);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  // Upload the lobe table.
  lobe({ lobe, arrays }) {
    const gl = this.gl, [, [slices, rows, columns]] = arrays.find(([name]) => name === "lobe"), texels = new Float32Array((4 * lobe.length) / 3);
    for (let i = 0; i < lobe.length / 3; i++) texels.set([lobe[3 * i], lobe[3 * i + 1], lobe[3 * i + 2], 1], 4 * i);
    this.lobeTexture ??= this.texture(8, gl.TEXTURE_2D, gl.CLAMP_TO_EDGE);
    gl.activeTexture(gl.TEXTURE8);
    gl.bindTexture(gl.TEXTURE_2D, this.lobeTexture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA16F, columns, slices * rows, 0, gl.RGBA, gl.FLOAT, texels);
  }

  // Draw normal, part and depth; pixels are coloured afterwards, more often at edges. For a free film also the surface behind it,
  // and the number of its layers in front.
  drawTriangles(width, height, isClear) {
    const gl = this.gl;
    if (this.buffer?.width !== width || (isClear && !this.buffer.far)) this.makeBuffer(width, height, isClear);
    const { near, far, sheets } = this.buffer, isPlain = ({ plain }) => Boolean(plain);
    gl.viewport(0, 0, width, height);
    gl.disable(gl.SCISSOR_TEST);
    gl.enable(gl.DEPTH_TEST);
    this.drawParts(near, () => true);
    if (isClear) {
      this.drawParts(far, isPlain);
      gl.depthMask(false);
      gl.enable(gl.BLEND);
      gl.blendFunc(gl.ONE, gl.ONE);
      this.drawParts(sheets, (part) => !isPlain(part), 1);
      gl.disable(gl.BLEND);
      gl.depthMask(true);
    }
    gl.disable(gl.DEPTH_TEST);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  }

  // `number`: common number of all parts; by default each has its own.
  drawParts(frame, isWanted, number) {
    const gl = this.gl;
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    for (const i of number ? [1] : [0, 1]) gl.clearBufferfv(gl.COLOR, i, [0, 0, 0, 0]);
    if (!number) gl.clearBufferfi(gl.DEPTH_STENCIL, 0, 1, 0);
    const at = this.prepare("mesh", this.appearance, 0);
    this.object.parts.slice(0, MOST_PARTS).forEach((part, i) => {
      if (!isWanted(part)) return;
      gl.uniform1f(at.part, number ?? i + 1);
      gl.uniform1f(at.printed, part.printed ? 1 : 0);
      gl.drawElements(gl.TRIANGLES, part.count, gl.UNSIGNED_INT, 4 * part.start);
    });
  }

  makeBuffer(width, height, isClear) {
    const gl = this.gl, made = { width, textures: [], frames: [] };
    if (this.buffer) {
      for (const old of this.buffer.textures) gl.deleteTexture(old);
      for (const old of this.buffer.frames) gl.deleteFramebuffer(old);
    }
    const frame = () => {
      const one = gl.createFramebuffer();
      made.frames.push(one);
      gl.bindFramebuffer(gl.FRAMEBUFFER, one);
      return one;
    };
    const attach = (unit, format, point) => {
      const texture = this.texture(unit, gl.TEXTURE_2D, gl.CLAMP_TO_EDGE, gl.NEAREST);
      gl.texStorage2D(gl.TEXTURE_2D, 1, format, width, height);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, point, gl.TEXTURE_2D, texture, 0);
      made.textures.push(texture);
      return texture;
    };
    const whole = (unit) => {
      const one = frame();
      attach(unit, gl.RGBA8, gl.COLOR_ATTACHMENT0);
      attach(unit + 1, gl.RGBA8, gl.COLOR_ATTACHMENT1);
      gl.drawBuffers([gl.COLOR_ATTACHMENT0, gl.COLOR_ATTACHMENT1]);
      return [one, attach(unit + 2, gl.DEPTH24_STENCIL8, gl.DEPTH_STENCIL_ATTACHMENT)];
    };
    [made.near] = whole(NEAR_UNIT);
    attach(SURFACE_UNIT, gl.RGBA8, gl.COLOR_ATTACHMENT2);
    gl.drawBuffers([gl.COLOR_ATTACHMENT0, gl.COLOR_ATTACHMENT1, gl.COLOR_ATTACHMENT2]);
    if (isClear) {
      const [far, depth] = whole(FAR_UNIT);
      made.far = far;
      made.sheets = frame();
      attach(FAR_UNIT + 3, gl.RGBA8, gl.COLOR_ATTACHMENT1);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_STENCIL_ATTACHMENT, gl.TEXTURE_2D, depth, 0);
      gl.drawBuffers([gl.NONE, gl.COLOR_ATTACHMENT1]);
    }
    this.buffer = made;
  }

  // Direction to the eye, and half width and height of the picture at distance 1.
  frame() {
    const azimuth = (this.azimuth * Math.PI) / 180, elevation = (this.elevation * Math.PI) / 180, half = Math.tan((this.object.fov * Math.PI) / 360);
    const toEye = [Math.sin(azimuth) * Math.cos(elevation), -Math.cos(azimuth) * Math.cos(elevation), Math.sin(elevation)];
    const right = [Math.cos(azimuth) * half, Math.sin(azimuth) * half, 0];
    return { toEye, right, up: [-Math.sin(azimuth) * Math.sin(elevation) * half, Math.cos(azimuth) * Math.sin(elevation) * half, Math.cos(elevation) * half], half };
  }

  prepare(name, appearance, first) {
    const gl = this.gl, at = this.use(name, appearance), { distance, target, foot } = this.object;
    const { toEye, right, up } = this.frame();
    gl.uniform3fv(at.eye, target.map((t, i) => t + distance * toEye[i]));
    gl.uniform3fv(at.ahead, toEye.map((x) => -x));
    gl.uniform3fv(at.right, right);
    gl.uniform3fv(at.up, up);
    gl.uniform2f(at.size, this.canvas.width, this.canvas.height);
    gl.uniform4fv(at.foot, foot);
    gl.uniform1f(at.first, first);
    gl.uniform1f(at.solid, solidOf(appearance));
    gl.uniform1f(at.alpha, appearance.alpha);
    gl.uniform1f(at.gloss, appearance.gloss_alpha);
    gl.uniform1f(at.layers, this.room.layers);
    const { floor, level, lamp } = this.room;
    if (floor) {
      for (const [where, value] of [[at.level, level], [at.ground, floor], [at.lampTo, lamp.towards], [at.lampPower, lamp.power]]) gl.uniform3fv(where, value);
      gl.uniform1f(at.lampRadius, lamp.radius);
    } else gl.uniform1f(at.square, this.object.dark ? -1 : appearance.clear ? SQUARE : 0);
    gl.uniform1f(at.exposure, this.exposure);
    return at;
  }

  // Without a graphics card fewer pixels keep the page responsive.
  measureSpeed(began) {
    const gl = this.gl;
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));  // waits for the drawing to finish
    this.trials -= 1;
    if (this.trials === 0 && performance.now() - began > SLOW_MS) this.most = FEWEST;
    requestAnimationFrame(() => {
      this.resize();
      this.canvas.dataset.measured = String(this.trials === 0);
    });
  }

  turn(azimuth, elevation) {
    this.azimuth = ((azimuth % 360) + 360) % 360;
    this.elevation = Math.max(2, Math.min(85, elevation));
    if (this.isScheduled) return;
    this.isScheduled = true;
    requestAnimationFrame(() => { this.isScheduled = false; this.draw(); });
  }

  front() { this.turn(this.object.azimuth, this.object.elevation); }

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
