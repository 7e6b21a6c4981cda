// Target hue over the angle, drawn with the pointer; each angle also has a slider and a tick for the keyboard.

import { $, el } from "./common.js";
import { add, clear, hex } from "./charts.js";

export const CURVE_DEG = [0, 15, 30, 45, 60, 75];
const [LEFT, RIGHT, TOP, BOTTOM] = [30, 274, 6, 132], BANDS = 36, LIGHTNESS = 62, CHROMA = 40;
const x = (angle) => LEFT + (angle / 75) * (RIGHT - LEFT), y = (hue) => BOTTOM - (hue / 360) * (BOTTOM - TOP);
const rows = [];
let isTouched = false, changed = () => {};

export const hueColour = (hue, chroma = CHROMA) => hex(LIGHTNESS, chroma * Math.cos((hue * Math.PI) / 180), chroma * Math.sin((hue * Math.PI) / 180));

function draw() {
  const svg = $("hue-curve");
  clear(svg);
  for (let i = 0; i < BANDS; i++) {
    const high = ((i + 1) * 360) / BANDS, band = add(svg, "rect", { x: LEFT, y: y(high), width: RIGHT - LEFT, height: (BOTTOM - TOP) / BANDS + 0.5 });
    band.style.fill = hueColour(high - 180 / BANDS);
  }
  for (const hue of [0, 90, 180, 270, 360]) add(svg, "text", { x: LEFT - 4, y: y(hue) + 3, "text-anchor": "end" }, `${hue}°`);
  for (const angle of CURVE_DEG) add(svg, "text", { x: x(angle), y: BOTTOM + 13, "text-anchor": "middle" }, `${angle}°`);
  const used = rows.filter(({ tick }) => tick.checked);
  const d = used.map(({ angle, range }, i) => `${i ? "L" : "M"}${x(angle)} ${y(range.valueAsNumber)}`).join("");
  add(svg, "path", { d, class: "under" });
  add(svg, "path", { d, class: "over" });
  for (const { angle, range } of used) add(svg, "circle", { cx: x(angle), cy: y(range.valueAsNumber), r: 6, class: "handle" });
}

function put(row, hue) {
  row.range.value = Math.round(Math.max(0, Math.min(360, hue)));
  row.out.textContent = `${row.range.value}°`;
  row.chip.style.background = hueColour(row.range.valueAsNumber);
}

// The targets of the curve in a design request.
export function curveTargets() {
  const chroma = $("hue-chroma").valueAsNumber, span = $("hue-span").valueAsNumber;
  return rows.filter(({ tick }) => tick.checked).map(({ angle, range }) => ({ angle, hue: range.valueAsNumber, chroma, span }));
}

// Until the user draws it the curve shows the current hues.
export function suggestCurve(hueAt) {
  if (isTouched) return;
  for (const row of rows) put(row, hueAt(row.angle));
  draw();
}

export function initCurve(onChange) {
  changed = onChange;
  for (const angle of CURVE_DEG) {
    const tick = el("input", { type: "checkbox", checked: angle <= 60 }), range = el("input", { type: "range", min: 0, max: 360, step: 1, value: 180 });
    const row = { angle, tick, range, out: el("output"), chip: el("span", { className: "chip" }) };
    tick.setAttribute("aria-label", `${angle} degrees is a target`);
    range.setAttribute("aria-label", `Hue at ${angle} degrees`);
    rows.push(row);
    put(row, 180);
    for (const box of [tick, range]) {
      box.addEventListener("input", () => {
        if (box === range) tick.checked = true;
        isTouched = true;
        put(row, range.valueAsNumber);
        draw();
        changed();
      });
    }
    $("hue-rows").append(el("div", { className: "hue-row" }, tick, el("span", { textContent: `${angle}°` }), range, row.chip, row.out));
  }
  const svg = $("hue-curve");
  let isDown = false;
  const take = (event) => {
    const box = svg.getBoundingClientRect(), at = ((event.clientX - box.left) / box.width) * 280, down = ((event.clientY - box.top) / box.height) * 150;
    const row = rows.reduce((best, one) => (Math.abs(x(one.angle) - at) < Math.abs(x(best.angle) - at) ? one : best));
    row.tick.checked = isTouched = true;
    put(row, ((BOTTOM - down) / (BOTTOM - TOP)) * 360);
    draw();
    changed();
  };
  svg.addEventListener("pointerdown", (event) => { isDown = true; svg.setPointerCapture(event.pointerId); take(event); });
  svg.addEventListener("pointermove", (event) => { if (isDown) take(event); });
  for (const end of ["pointerup", "pointercancel"]) svg.addEventListener(end, () => { isDown = false; });
  draw();
}
