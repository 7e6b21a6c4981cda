// Colour scatter under manufacturing tolerances, on the ribbon and on the track.

import { $, app, fullText } from "./common.js";
import { add, shown, toLab } from "./charts.js";
import { listen } from "./event_stream.js";

const RESTING_MS = 500, AT_DEG = [0, 30, 60], MOST_DOTS = 120;
let scatter = null, scatterKey = "", message = "", sampling = null, timer = 0, redraw = () => {};

const key = () => `${app.recipe.name}\n${app.recipe.text}\n${$("lamp").value}\n${$("percent").value}\n${$("azimuth").value}`;

// Interpolated colour `[3]` of one draw at an angle.
function at(rgb, angles, angle) {
  const high = Math.max(1, angles.findIndex((one) => one >= angle)), last = angles.length - 1, i = angle >= angles[last] ? last : high;
  const part = Math.min(1, (angle - angles[i - 1]) / (angles[i] - angles[i - 1]));
  return [0, 1, 2].map((c) => rgb[i - 1][c] * (1 - part) + rgb[i][c] * part);
}

const isShown = () => Boolean(scatter) && scatterKey === key() && $("tolerance").checked;

// Largest |a*| or |b*| of the scatter; 0 if it is not shown.
export function scatterExtent() {
  if (!isShown()) return 0;
  const colours = scatter.rgb.slice(0, MOST_DOTS).flatMap((one) => AT_DEG.map((angle) => toLab(...at(one, scatter.angles, angle))));
  return Math.max(...colours.flatMap(([, a, b]) => [Math.abs(a), Math.abs(b)]));
}

export function drawScatter(canvas, svg, scale) {
  canvas.hidden = !isShown();
  $("tolerance-text").hidden = !$("tolerance").checked;
  if (canvas.hidden) return;
  const { rgb, angles } = scatter, context = canvas.getContext("2d");
  canvas.height = rgb.length;
  rgb.forEach((one, row) => {
    for (let i = 0; i < canvas.width; i++) {
      context.fillStyle = `rgb(${shown(...at(one, angles, (90 * i) / (canvas.width - 1))).join(" ")})`;
      context.fillRect(i, row, 1, 1);
    }
  });
  const dots = add(svg, "g", { class: "scatter" });
  for (const one of rgb.slice(0, MOST_DOTS)) {
    for (const angle of AT_DEG) {
      const colour = at(one, angles, angle), [, a, b] = toLab(...colour);
      add(dots, "circle", { cx: scale.x(a).toFixed(1), cy: scale.y(b).toFixed(1), r: 1.7 }).style.fill = `rgb(${shown(...colour).join(" ")})`;
    }
  }
  svg.prepend(dots);
}

function show(event) {
  scatter = event;
  const ranges = AT_DEG.map((angle) => {
    const i = event.angles.reduce((best, one, k) => (Math.abs(one - angle) < Math.abs(event.angles[best] - angle) ? k : best), 0);
    return `${event.angles[i]}°: ΔE ${event.percentile_95[i].toFixed(1)}`;
  });
  message = $("tolerance-text").textContent = `95 % of ${event.rgb.length} draws lie within ${ranges.join(", ")}${event.failed ? `; ${event.failed} could not be computed` : ""}.`;
  redraw();
}

async function ask() {
  sampling?.abort();
  if (!$("tolerance").checked) return;
  const request = (sampling = new AbortController());
  try {
    const text = await fullText();
    if (request !== sampling) return;
    const requested = key();
    $("tolerance-text").textContent = "Sampling manufactured materials";
    await listen("api/tolerance", { text, name: app.recipe.name, lamp: $("lamp").value, percent: $("percent").valueAsNumber, azimuth_deg: Number($("azimuth").value) }, request.signal, (event) => {
      if (event.kind !== "tolerance" || request !== sampling) return;
      scatterKey = requested;
      show(event);
    });
  } catch (problem) {
    if (request === sampling && !request.signal.aborted) $("tolerance-text").textContent = problem.message;
  }
}

// After each final answer: sample again if the recipe has changed.
export function updateTolerance() {
  if (!$("tolerance").checked) return;
  sampling?.abort();
  clearTimeout(timer);
  $("tolerance-text").textContent = scatterKey === key() ? message : "The recipe has changed; sampling again";
  if (scatterKey === key()) return;
  timer = setTimeout(ask, RESTING_MS);
}

export function initTolerance(chart) {
  redraw = chart;
  $("tolerance").addEventListener("change", () => {
    $("percent").disabled = !$("tolerance").checked;
    redraw();
    if (scatterKey !== key() || !$("tolerance").checked) ask();
  });
  $("percent").addEventListener("change", ask);
}
