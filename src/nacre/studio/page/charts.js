// Charts: colour over the angle, spectra, the track in a*b*, colours under lamps.

import { boxOf, placeLabels } from "./labels.js";

const SVG = "http://www.w3.org/2000/svg";
// Curves are drawn on a canvas: without a graphics card a single SVG path doubles the time to paint the panel.
const DASHES = ["", "5 3", "1.5 2.5"];
export const clear = (node) => node.replaceChildren();
export const add = (root, tag, props, text) => {
  const made = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(props)) made.setAttribute(name, value);
  if (text !== undefined) made.textContent = text;
  root.append(made);
  return made;
};

// Return a function that draws curves on the canvas below an SVG, in its units: points, whether they are B's, dashes.
function curveDrawer(svg) {
  const canvas = svg.previousElementSibling, context = canvas.getContext("2d", { willReadFrequently: true });     // by the CPU
  const { width, height } = svg.viewBox.baseVal, scale = (Math.max(canvas.clientWidth, 1) * devicePixelRatio) / width, { color, caretColor } = getComputedStyle(canvas);
  const size = [width, height].map((side) => Math.round(side * scale));
  if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
  context.setTransform(1, 0, 0, 1, 0, 0);
  context.clearRect(0, 0, ...size);
  context.setTransform(scale, 0, 0, scale, 0, 0);
  context.lineJoin = "round";
  return (points, isOther = false, dashes = "") => {
    Object.assign(context, isOther ? { strokeStyle: caretColor, lineWidth: 1 } : { strokeStyle: color, lineWidth: 1.4 });
    context.setLineDash(dashes.split(" ").filter(Boolean).map(Number));
    context.beginPath();
    for (const [x, y] of points) context.lineTo(x, y);
    context.stroke();
  };
}

export function total(appearance) {
  return appearance.mirror.map((value, i) => value + appearance.gloss[i] + appearance.spread[i]);
}

// Reduce the chroma of colours outside sRGB at constant luminance, as on the sphere.
export function shown(r, g, b) {
  const y = Math.min(Math.max(0.2126 * r + 0.7152 * g + 0.0722 * b, 0), 1);
  const low = Math.min(r, g, b), high = Math.max(r, g, b);
  let keep = 1;
  if (low < 0) keep = Math.min(keep, y / Math.max(y - low, 1e-6));
  if (high > 1) keep = Math.min(keep, (1 - y) / Math.max(high - y, 1e-6));
  return [r, g, b].map((c) => {
    const x = Math.min(Math.max(y + keep * (c - y), 0), 1);
    return Math.round(255 * (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055));
  });
}

// Luminance of #rrggbb; black and white have equal contrast at 0.179 (WCAG 2).
function luminance(hex) {
  const [r, g, b] = [1, 3, 5].map((at) => Number.parseInt(hex.slice(at, at + 2), 16) / 255).map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4));
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
}

export function toLab(r, g, b) {
  const xyz = [
    (0.4124564 * r + 0.3575761 * g + 0.1804375 * b) / 0.95047,
    0.2126729 * r + 0.7151522 * g + 0.072175 * b,
    (0.0193339 * r + 0.119192 * g + 0.9503041 * b) / 1.08883,
  ].map((t) => (t > 216 / 24389 ? Math.cbrt(t) : (t * 24389) / 27 / 116 + 16 / 116));
  return [116 * xyz[1] - 16, 500 * (xyz[0] - xyz[1]), 200 * (xyz[1] - xyz[2])];
}

// Convert CIELAB to #rrggbb, clipped as above.
export function hex(lightness, a, b) {
  const f = (lightness + 16) / 116, [x, y, z] = [f + a / 500, f, f - b / 200].map((t, i) => [0.95047, 1, 1.08883][i] * (t > 6 / 29 ? t ** 3 : (t - 16 / 116) / 7.787));
  const rgb = [3.2404542 * x - 1.5371385 * y - 0.4985314 * z, -0.969266 * x + 1.8760108 * y + 0.041556 * z, 0.0556434 * x - 0.2040259 * y + 1.0572252 * z];
  return `#${shown(...rgb).map((c) => c.toString(16).padStart(2, "0")).join("")}`;
}

export function drawRibbon(canvas, text, appearance) {
  const context = canvas.getContext("2d", { willReadFrequently: true }), all = total(appearance), count = all.length / 3;
  const row = context.createImageData(canvas.width, 1);
  for (let x = 0; x < canvas.width; x++) {
    const at = (x / (canvas.width - 1)) * (count - 1), low = Math.min(Math.floor(at), count - 2), part = at - low;
    const rgb = [0, 1, 2].map((c) => all[3 * low + c] * (1 - part) + all[3 * low + 3 + c] * part);
    row.data.set([...shown(...rgb), 255], 4 * x);
  }
  context.putImageData(row, 0, 0);
  text.textContent = appearance.shown_deg.map((angle, i) => `${angle}°: ${appearance.swatches[0].hex[i]}`).join("   ");
}

// Reflectance in the chart: of polarised light, if that is selected.
const reflectance = (appearance) => appearance.polarised ?? appearance.total;

// `measured`: curves of a dropped file, drawn dotted.
export function drawSpectrum(svg, appearance, other, measured = []) {
  const draw = curveDrawer(svg);
  clear(svg);
  const [left, right, top, bottom] = [26, 276, 6, 128], appearances = other ? [other, appearance] : [appearance];
  const x = (nm) => left + ((nm - 380) / 400) * (right - left), peak = Math.max(...appearances.map((one) => Math.max(...reflectance(one))), ...measured.map(({ values }) => Math.max(...values)));
  const most = peak > 1.001 ? peak : [0.05, 0.1, 0.2, 0.5, 1].find((m) => peak <= m) ?? 1;
  const y = (value) => bottom - (value / most) * (bottom - top);
  for (const share of [0, 0.5, 1]) {
    add(svg, "line", { x1: left, x2: right, y1: y(share * most), y2: y(share * most), class: "axis" });
    add(svg, "text", { x: left - 4, y: y(share * most) + 3, "text-anchor": "end" }, Number((share * most).toPrecision(3)));
  }
  for (const nm of [400, 500, 600, 700]) add(svg, "text", { x: x(nm), y: bottom + 13, "text-anchor": "middle" }, `${nm}${nm === 700 ? " nm" : ""}`);
  for (const one of appearances) {
    const { wavelengths: lam, shown_deg } = one, values = reflectance(one);
    shown_deg.forEach((_, row) => {
      const points = [];
      for (let i = 0; i < lam.length; i++) if (lam[i] >= 380 && lam[i] <= 780) points.push([x(lam[i]), y(values[row * lam.length + i])]);
      draw(points, appearances.length > 1 && one === other, DASHES[row]);
    });
  }
  for (const { nm, values } of measured) draw(nm.map((lam, i) => [x(lam), y(Math.max(values[i], 0))]), true, "1 2");
  appearance.shown_deg.forEach((angle, row) => {
    add(svg, "line", { x1: left + 54 * row, x2: left + 54 * row + 18, y1: 146, y2: 146, class: "curve", "stroke-dasharray": DASHES[row] });
    add(svg, "text", { x: left + 22 + 54 * row, y: 149 }, `${angle}°`);
  });
  if (!other) return;
  [["A", "curve", 192], ["B", "curve other", 236]].forEach(([name, kind, at]) => {
    add(svg, "line", { x1: at, x2: at + 18, y1: 146, y2: 146, class: kind });
    add(svg, "text", { x: at + 22, y: 149 }, name);
  });
}

// Psi and Delta over the wavelength: `measured` of a dropped file, dotted, and `computed` at the same angles.
export function drawEllipsometry(svg, measured, computed) {
  const draw = curveDrawer(svg);
  clear(svg);
  const [left, right] = [26, 276], nm = measured.flatMap((one) => one.nm), [low, high] = [Math.min(...nm), Math.max(...nm)];
  const x = (lam) => left + ((lam - low) / Math.max(high - low, 1e-9)) * (right - left);
  [["psi", 90, 8, 96], ["delta", 360, 114, 202]].forEach(([name, most, top, bottom]) => {
    const y = (value) => bottom - (value / most) * (bottom - top);
    for (const share of [0, 0.5, 1]) {
      add(svg, "line", { x1: left, x2: right, y1: y(share * most), y2: y(share * most), class: "axis" });
      add(svg, "text", { x: left - 4, y: y(share * most) + 3, "text-anchor": "end" }, `${share * most}°`);
    }
    add(svg, "text", { x: right, y: top + 9, "text-anchor": "end" }, name === "psi" ? "Ψ" : "Δ");
    const curves = (lam, values, isMeasured, dashes) => {       // Delta continues from 360 to 0 degrees
      let part = [];
      values.forEach((value, i) => {
        if (i && Math.abs(value - values[i - 1]) > 0.5 * most) { draw(part, isMeasured, dashes); part = []; }
        part.push([x(lam[i]), y(value)]);
      });
      draw(part, isMeasured, dashes);
    };
    computed?.psi?.forEach((_, row) => curves(computed.nm, computed[name][row], false, DASHES[row]));
    for (const one of measured) curves(one.nm, one[name], true, "1 2");
  });
  for (const share of [0, 0.5, 1]) add(svg, "text", { x: x(low + share * (high - low)), y: 215, "text-anchor": share === 0 ? "start" : share === 1 ? "end" : "middle" }, `${Math.round(low + share * (high - low))}${share === 1 ? " nm" : ""}`);
  measured.forEach(({ angle_deg: angle }, row) => {
    add(svg, "line", { x1: left + 62 * row, x2: left + 62 * row + 18, y1: 230, y2: 230, class: "curve", "stroke-dasharray": DASHES[row] });
    add(svg, "text", { x: left + 22 + 62 * row, y: 233 }, `${Number(angle.toFixed(2))}°`);
  });
}

// `least`: smallest extent of the axes.
export function drawTrack(svg, appearance, other, least) {
  const draw = curveDrawer(svg);
  clear(svg);
  const track = (one) => {
    const all = total(one), points = [];
    for (let i = 0; i < all.length / 3; i++) points.push(toLab(all[3 * i], all[3 * i + 1], all[3 * i + 2]));
    return { all, points, is: one };
  };
  const tracks = (other ? [other, appearance] : [appearance]).map(track);
  const reach = Math.max(20, least, ...tracks.flatMap(({ points }) => points.map(([, a, b]) => Math.max(Math.abs(a), Math.abs(b))))) * 1.1;
  const x = (a) => 140 + (a / reach) * 88, y = (b) => 95 - (b / reach) * 88;
  add(svg, "line", { x1: 52, x2: 228, y1: 95, y2: 95, class: "axis" });
  add(svg, "line", { x1: 140, x2: 140, y1: 7, y2: 183, class: "axis" });
  const words = [[244, 95, "a*"], [158, 11, "b*"]].map(([left, top, name]) => [left, top, `${name} ${Math.round(reach)}`]), labels = [];
  for (const [left, top, text] of words) add(svg, "text", { x: left, y: top + 3, "text-anchor": "middle" }, text);
  for (const { all, points, is } of tracks) {
    const isOther = tracks.length > 1 && is === other;
    draw(points.map(([, a, b]) => [x(a), y(b)]), isOther);
    for (const angle of [0, 30, 60]) {
      const [, a, b] = points[angle], fill = `rgb(${shown(all[3 * angle], all[3 * angle + 1], all[3 * angle + 2]).join(" ")})`;
      if (isOther) add(svg, "rect", { x: x(a) - 4, y: y(b) - 4, width: 8, height: 8, class: "dot other", fill });
      else add(svg, "circle", { cx: x(a), cy: y(b), r: 5, class: "dot", fill });
      labels.push({ x: x(a), y: y(b), r: 5, text: `${tracks.length > 1 ? (isOther ? "B " : "A ") : ""}${angle}°` });
    }
  }
  const curve = tracks.flatMap(({ points }) => points.filter((_, i) => i % 3 === 0).map(([, a, b]) => [x(a), y(b)]));
  placeLabels(labels, words.map(([left, top, text]) => boxOf(left, top, text)), curve, [0, 0, 280, 190]).forEach((at, i) => {
    const { x: left, y: top, text } = labels[i];
    if (at.isLed) add(svg, "line", { x1: left, y1: top, x2: Math.min(Math.max(left, at.box[0]), at.box[2]), y2: Math.min(Math.max(top, at.box[1]), at.box[3]), class: "lead" });
    add(svg, "text", { x: at.x.toFixed(1), y: (at.y + 3.5).toFixed(1), "text-anchor": "middle", class: "mark" }, text);
  });
  return { x, y };
}

export function drawSwatches(table, appearance, other) {
  const make = (tag, props) => Object.assign(document.createElement(tag), props);
  const head = document.createElement("tr");
  head.append(make("th", { textContent: "Lamp", scope: "col" }), ...appearance.shown_deg.map((angle) => make("th", { textContent: `${angle}°`, scope: "col" })));
  const rows = appearance.swatches.map(({ lamp, hex, lab: values }, k) => {
    const row = document.createElement("tr");
    row.append(make("th", { textContent: lamp, scope: "row" }));
    hex.forEach((colour, i) => {
      const chip = (name, fill) => {
        const made = make("span", { className: "chip", title: name + fill, textContent: name });
        made.style.background = fill;
        // the letter in black or white, for contrast
        made.style.color = luminance(fill) > 0.179 ? "#000" : "#fff";
        return made;
      };
      const cell = document.createElement("td"), differs = appearance.difference?.[k]?.[i];
      if (other) cell.append(chip("A ", colour), chip("B ", other.swatches[k].hex[i]));
      else cell.append(chip("", colour));
      cell.append(values[i].map((v) => Math.round(v)).join(" "));
      if (other && differs !== undefined) cell.append(make("b", { textContent: `ΔE ${differs.toFixed(1)}`, title: "CIEDE2000 between A and B" }));
      row.append(cell);
    });
    return row;
  });
  table.classList.toggle("two", Boolean(other));
  table.replaceChildren(head, ...rows);
}
