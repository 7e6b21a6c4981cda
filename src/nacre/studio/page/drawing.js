// Drawing of the structure to scale: layers, flakes in resin, spheres on layers or packed, a relief. It depends on the data of
// the recipe, not on the name of its family.

import { add, clear } from "./charts.js";

const WIDTH = 280, LEFT = 4, BAR = 108, TEXT_X = 126, LINE = 11, MAX_LABELS = 13;
const TINTS = 6, MAX_TYPES = 3;
const MAX_DRAWN = 60;      // spheres, flakes
const LENGTHS = { nm: 1, um: 1e3, mm: 1e6 };
const MAX_SHARE = 0.6;     // of the height; a thicker layer is drawn cut

export function lengthNm(table, stem) {
  for (const [unit, factor] of Object.entries(LENGTHS)) {
    const value = table?.[`${stem}_${unit}`];
    if (typeof value === "number") return value * factor;
    if (value && typeof value === "object") {     // a varying value: use the mean of its limits
      const ends = [value.min, value.max].filter((end) => typeof end === "number");
      if (ends.length) return (factor * ends.reduce((a, b) => a + b, 0)) / ends.length;
    }
  }
  return null;
}

function isVaried(table, stem) {
  return Object.keys(LENGTHS).some((unit) => table?.[`${stem}_${unit}`] && typeof table[`${stem}_${unit}`] === "object");
}

export function inUnits(nm) {
  if (nm === null) return "thickness varies";
  const [value, unit] = nm >= 1e6 ? [nm / 1e6, "mm"] : nm >= 2e3 ? [nm / 1e3, "µm"] : [nm, "nm"];
  return `${Number(value.toPrecision(4))} ${unit}`;
}

export function materialName(material) {
  if (typeof material === "string") return material;
  if (!material || typeof material !== "object") return "?";
  if (typeof material.n === "number") return `n = ${material.n}${material.k ? ` + ${material.k}i` : ""}`;
  return String(material.rii ?? material.file ?? Object.keys(material)[0] ?? "?").split("/").slice(0, 2).join("/");
}

class Tints {
  constructor() { this.known = new Map(); }
  of(name) {
    if (name === "air" || name === "vacuum") return "air";
    if (!this.known.has(name)) this.known.set(name, this.known.size % TINTS);
    return `tint${this.known.get(name)}`;
  }
}

// Draw a stack of [{name, nm, note}] from the top, starting at y; return its lower end and the labels.
function stack(svg, entries, y, height, tints, x = LEFT, width = BAR) {
  const known = entries.map(({ nm }) => nm ?? 0);
  let cut = [], scale = 0;
  for (let round = 0; round < 3; round++) {
    const rest = known.reduce((sum, nm, i) => sum + (cut.includes(i) ? 0 : nm), 0);
    const room = height * (1 - cut.length * 0.25);
    scale = rest > 0 ? room / rest : 0;
    const large = known.findIndex((nm, i) => !cut.includes(i) && nm * scale > MAX_SHARE * room && nm > 30 * (rest - nm) && known.length > cut.length + 1);
    if (large < 0) break;
    cut.push(large);
  }
  const places = [];
  for (const [i, { name, nm, note }] of entries.entries()) {
    const tall = cut.includes(i) ? 0.25 * height : (nm ?? 0) * scale;
    add(svg, "rect", { x, y, width, height: Math.max(tall, 0.4), class: `part ${tints.of(name)}` });
    if (cut.includes(i)) add(svg, "path", { d: zigzag(x, y + tall / 2, width), class: "gap" });
    places.push({ y: y + tall / 2, text: `${name}, ${note ?? inUnits(nm)}${cut.includes(i) ? " (cut)" : ""}` });
    y += tall;
  }
  return { end: y, scale, places, cut: cut.length > 0 };
}

function zigzag(x, y, width) {
  let d = `M${x} ${y}`;
  for (let i = 1; i <= 12; i++) d += `L${x + (width * i) / 12} ${y + (i % 2 ? 3 : -3)}`;
  return d;
}

// Write names beside their layers without overlap; return false if there are too many.
function label(svg, places, from, to) {
  if (places.length > MAX_LABELS) return false;
  const at = places.map(({ y }) => Math.min(Math.max(y, from + 4), to));
  for (let i = 1; i < at.length; i++) at[i] = Math.max(at[i], at[i - 1] + LINE);
  for (let i = at.length - 1; i >= 0; i--) at[i] = Math.min(at[i], i === at.length - 1 ? to : at[i + 1] - LINE);
  places.forEach(({ y, text }, i) => {
    add(svg, "line", { x1: LEFT + BAR, y1: y.toFixed(1), x2: TEXT_X - 3, y2: at[i].toFixed(1), class: "lead" });
    add(svg, "text", { x: TEXT_X, y: at[i] + 3 }, text.length > 30 ? `${text.slice(0, 29)}…` : text);
  });
  return true;
}

function counts(svg, entries, tints, y) {
  const found = new Map();
  for (const { name, nm } of entries) {
    const { count, sum } = found.get(name) ?? { count: 0, sum: 0 };
    found.set(name, { count: count + 1, sum: sum + (nm ?? 0) });
  }
  for (const [name, { count, sum }] of [...found].slice(0, 9)) {
    add(svg, "rect", { x: TEXT_X, y: y - 8, width: 10, height: 9, class: `part ${tints.of(name)}` });
    add(svg, "text", { x: TEXT_X + 15, y }, `${count} × ${name}`);
    add(svg, "text", { x: TEXT_X + 15, y: y + 11 }, `${inUnits(sum)} in total`);
    y += 27;
  }
}

const layersOf = (list) => (list ?? []).map((layer) => ({ name: materialName(layer.material), nm: lengthNm(layer, "thickness"), varies: isVaried(layer, "thickness") }))
  .map((layer) => ({ ...layer, note: layer.varies ? (layer.nm === null ? "varies" : `varies about ${inUnits(layer.nm)}`) : undefined }));

// Reproducible random numbers.
function random(seed) {
  let state = seed;
  return () => {
    state = (state * 1103515245 + 12345) % 2147483648;
    return state / 2147483648;
  };
}

function ground(svg, name, y, tints) {
  add(svg, "rect", { x: LEFT, y, width: BAR, height: 20, class: `part ${tints.of(name)}` });
  add(svg, "path", { d: zigzag(LEFT, y + 20, BAR), class: "gap" });
}

function layered(svg, data, tints) {
  const layers = layersOf(data.layers), ambient = materialName(data.ambient ?? "air"), substrate = materialName(data.substrate ?? "?");
  add(svg, "text", { x: LEFT, y: 10 }, `${ambient}, light comes from above`);
  let top = 18;
  const particle = data.particle, spheres = particle ? particleOf(particle) : null;
  const depth = layers.reduce((sum, { nm }) => sum + (nm ?? 0), 0);
  const tall = 118;
  const scale = spheres ? tall / Math.max(depth + 2 * spheres.outer + spheres.gap, 1) : 0;
  if (spheres) top = beads(svg, spheres, data.monolayer, top, scale, tints);
  const drawn = stack(svg, layers, top, spheres ? depth * scale : tall, tints);
  ground(svg, substrate, drawn.end, tints);
  const places = [...(spheres ? spheres.places : []), ...drawn.places, { y: drawn.end + 10, text: `${substrate}, below` }];
  const ends = drawn.end + 26;
  if (!label(svg, places, 18, ends - 4)) {
    counts(svg, layers, tints, 30);
    label(svg, places.slice(-1), 18, ends - 4);
  }
  const words = [];
  if (layers.length) words.push(`${layers.length} layer${layers.length > 1 ? "s" : ""}, ${inUnits(depth)} in total${drawn.cut ? "; the thick one is cut" : ", to scale"}`);
  else words.push(`no layers, only ${substrate}`);
  if (spheres) words.unshift(`spheres of ${inUnits(2 * spheres.outer)}`);
  const ridges = data.ridges ?? (data.preset ? {} : null), pitch = lengthNm(ridges, "pitch");
  if (ridges) words.push(pitch ? `in ridges ${inUnits(pitch)} apart` : "in ridges; the preset gives the other values");
  return { ends, words: words.join(", ") };
}

function particleOf(particle) {
  const radius = lengthNm(particle, "radius") ?? 50, coat = particle.shell ? lengthNm(particle.shell, "thickness") ?? 0 : 0;
  return { radius, outer: radius + coat, gap: lengthNm(particle, "gap") ?? 0, name: materialName(particle.material), shell: particle.shell ? materialName(particle.shell.material) : "", places: [] };
}

function sphere(svg, { radius, outer, name, shell }, x, y, scale, tints) {
  if (shell) add(svg, "circle", { cx: x, cy: y, r: outer * scale, class: `part ${tints.of(shell)}` });
  add(svg, "circle", { cx: x, cy: y, r: radius * scale, class: `part ${tints.of(name)}` });
}

// Draw spheres above the layers at their mean distance; return the upper end of the layers.
function beads(svg, spheres, monolayer, y, scale, tints) {
  const { radius, outer, gap, name, shell, places } = spheres;
  const perArea = typeof monolayer?.density_per_um2 === "number" ? monolayer.density_per_um2 / 1e6 : (typeof monolayer?.coverage === "number" ? monolayer.coverage : 0.1) / (Math.PI * outer * outer);
  const apart = Math.max(Math.sqrt(1 / perArea), 2 * outer) * scale, middle = y + outer * scale, first = LEFT + outer * scale;
  const many = Math.min(Math.floor((BAR - 2 * outer * scale) / apart + 1e-9) + 1, MAX_DRAWN);
  const rest = (BAR - 2 * outer * scale - (many - 1) * apart) / 2;
  for (let i = 0; i < many; i++) sphere(svg, spheres, first + Math.max(rest, 0) + i * apart, middle, scale, tints);
  places.push({ y: middle, text: `${name}, radius ${inUnits(radius)}` });
  if (shell) places.push({ y: middle + 1, text: `shell of ${shell}, ${inUnits(outer - radius)}` });
  return y + (2 * outer + gap) * scale;
}

function strata(svg, data, tints) {
  const baseName = data.base ? (data.base.recipe ? "another recipe" : data.base.none ? "nothing" : `base of ${data.base.albedo ?? 0}`) : "black base";
  const list = data.strata.map((one) => ({ one, name: materialName(one.resin ?? one.matrix ?? "air"), nm: lengthNm(one, "thickness") }));
  add(svg, "text", { x: LEFT, y: 10 }, "air, light comes from above");
  const drawn = stack(svg, list, 18, 84, tints), next = random(7);
  let y = 18;
  for (const [i, { one }] of list.entries()) {
    const end = 2 * drawn.places[i].y - y;
    for (const kind of one.platelets ?? []) flakes(svg, kind, y, end, next);
    if (one.spheres) packed(svg, particleOf(one.spheres), one.spheres.volume_fraction, { x: LEFT, y, width: BAR, height: end - y }, tints, next);
    y = end;
  }
  ground(svg, baseName, drawn.end, tints);
  label(svg, [...drawn.places, { y: drawn.end + 10, text: baseName }], 18, drawn.end + 22);
  let ends = drawn.end + 30;
  const kinds = list.flatMap(({ one }) => one.platelets ?? []);
  for (const [i, kind] of kinds.slice(0, MAX_TYPES).entries()) ends = platelet(svg, kind, i, kinds.length, ends, tints);
  const words = kinds.length ? `; below ${kinds.length > 1 ? "sections of its flakes" : "a section of its flakes"}${kinds.length > MAX_TYPES ? `, ${MAX_TYPES} of ${kinds.length} types` : ""}` : "";
  return { ends, words: `${list.length} strat${list.length > 1 ? "a" : "um"}, ${inUnits(list.reduce((sum, { nm }) => sum + (nm ?? 0), 0))}${words}` };
}

// Draw flakes symbolically: their number follows the volume fraction, their tilt the deviation.
function flakes(svg, { volume_fraction: share, normal_deviation: deviation }, top, bottom, next) {
  const many = Math.min(Math.round(120 * Math.sqrt(typeof share === "number" ? share : 0.05)), MAX_DRAWN);
  const tilt = (typeof deviation === "number" ? deviation : 0.1) * 1.2;
  for (let i = 0; i < many; i++) {
    const x = LEFT + 7 + next() * (BAR - 14), y = top + 3 + next() * Math.max(bottom - top - 6, 0), turn = (next() - 0.5) * 2 * tilt;
    const [dx, dy] = [5 * Math.cos(turn), 5 * Math.sin(turn)];
    add(svg, "line", { x1: (x - dx).toFixed(1), y1: (y - dy).toFixed(1), x2: (x + dx).toFixed(1), y2: (y + dy).toFixed(1), class: "flake" });
  }
}

function platelet(svg, kind, i, many, y, tints) {
  const core = kind.substrate ? [{ name: materialName(kind.substrate.material), nm: lengthNm(kind.substrate, "thickness") }] : [];
  const upper = layersOf(kind.coatings), lower = kind.lower_coatings ? layersOf(kind.lower_coatings).reverse() : core.length ? [...upper].reverse() : [];
  const share = typeof kind.volume_fraction === "number" ? `, ${Number((100 * kind.volume_fraction).toPrecision(3))} % of the volume` : "";
  add(svg, "text", { x: LEFT, y: y + 9 }, `Flake${many > 1 ? ` ${i + 1}` : ""}${share}`);
  const drawn = stack(svg, [...upper, ...core, ...lower], y + 15, 62, tints);
  label(svg, drawn.places, y + 15, drawn.end);
  return drawn.end + 12;
}

// Draw disordered spheres to scale; only a part of the layer fits.
function packed(svg, spheres, fraction, { x, y, width, height }, tints, next) {
  const scale = Math.min(height / (6 * spheres.outer), 12 / spheres.outer), r = spheres.outer * scale;
  const apart = Math.max(2 * r * Math.cbrt(0.74 / (typeof fraction === "number" ? fraction : 0.5)), 2 * r), row = apart * 0.866;
  for (let line = 0, top = y + r; top + r <= y + height + 0.1; line++, top += row) {
    for (let left = x + r + (line % 2 ? apart / 2 : 0); left + r <= x + width; left += apart) {
      const slack = Math.min(apart - 2 * r, r) / 2;
      sphere(svg, spheres, left + (next() - 0.5) * slack, top + (next() - 0.5) * Math.min(slack, y + height - r - top), scale, tints);
    }
  }
}

function glass(svg, data, tints) {
  const spheres = particleOf(data.spheres), matrix = materialName(data.matrix ?? "air"), fraction = data.spheres.volume_fraction;
  const box = { x: LEFT, y: 6, width: BAR, height: 104 };
  add(svg, "rect", { ...box, class: `part ${tints.of(matrix)}` });
  packed(svg, spheres, fraction, box, tints, random(3));
  const places = [{ y: 30, text: `${spheres.name}, radius ${inUnits(spheres.radius)}` }];
  if (spheres.shell) places.push({ y: 45, text: `shell of ${spheres.shell}, ${inUnits(spheres.outer - spheres.radius)}` });
  places.push({ y: 70, text: `in ${matrix}` });
  label(svg, places, 6, 108);
  const share = typeof fraction === "number" ? `, ${Number((100 * fraction).toPrecision(3))} % of the volume` : "";
  const balls = data.balls ? ` packed into balls of ${inUnits(2 * (lengthNm(data.balls, "radius") ?? 0))}` : "";
  return { ends: 114, words: `part of a layer of ${inUnits(lengthNm(data, "thickness"))}: disordered spheres${share}${balls}` };
}

// `profile`: heights along one line of a relief.
function relief(svg, data, profile) {
  const { heights_um: heights, length_um: length, depth_um: depth } = profile, [top, bottom] = [14, 74];
  const x = (i) => LEFT + (i / heights.length) * (WIDTH - 2 * LEFT), y = (h) => bottom - (depth > 0 ? h / depth : 0) * (bottom - top);
  let d = `M${LEFT} 90`;
  heights.forEach((h, i) => { d += `L${x(i).toFixed(1)} ${y(h).toFixed(1)}L${x(i + 1).toFixed(1)} ${y(h).toFixed(1)}`; });
  add(svg, "path", { d: `${d}V90Z`, class: "part tint1" });
  add(svg, "text", { x: LEFT, y: 9 }, `${materialName(data.coating ?? "Al")}, one line across the relief`);
  const wide = Number(length.toPrecision(3)), deep = Number((depth * 1e3).toPrecision(3));
  return { ends: 94, words: `${wide} µm wide, ${deep} nm deep; heights are exaggerated, without the blur of the process` };
}

// Draw the structure and return a description, or "" if it is unknown.
export function drawStructure(svg, data, profile) {
  clear(svg);
  const tints = new Tints();
  let made = null;
  if (profile) made = relief(svg, data, profile);
  else if (Array.isArray(data?.strata)) made = strata(svg, data, tints);
  else if (data?.spheres && typeof data.spheres === "object") made = glass(svg, data, tints);
  else if (data && ("layers" in data || "particle" in data || ("substrate" in data && !data.strata))) made = layered(svg, data, tints);
  if (!made) return "";
  svg.setAttribute("viewBox", `0 0 ${WIDTH} ${Math.ceil(made.ends)}`);
  return made.words;
}
