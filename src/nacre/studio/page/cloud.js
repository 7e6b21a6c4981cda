// The cloud of tolerance: what the ribbon and the track become when layers come out some per cent off.

import { $, app, wholeText } from "./common.js";
import { add, shown, toLab } from "./charts.js";
import { listen } from "./lines.js";

const RESTING_MS = 500, AT_DEG = [0, 30, 60], MOST_DOTS = 120;
let cloud = null, of = "", words = "", drawing = null, timer = 0, redraw = () => {};

const key = () => `${app.recipe.name}\n${app.recipe.text}\n${$("lamp").value}\n${$("spread").value}`;

// Colour `[3]` of one draw at an angle, between those that were computed.
function at(rgb, angles, angle) {
  const high = Math.max(1, angles.findIndex((one) => one >= angle)), last = angles.length - 1, i = angle >= angles[last] ? last : high;
  const part = Math.min(1, (angle - angles[i - 1]) / (angles[i] - angles[i - 1]));
  return [0, 1, 2].map((c) => rgb[i - 1][c] * (1 - part) + rgb[i][c] * part);
}

const isShown = () => Boolean(cloud) && of === key() && $("cloud").checked;

// How far the cloud lies from grey in a* or b*, at most; 0 where there is none.
export function cloudReach() {
  if (!isShown()) return 0;
  const colours = cloud.rgb.slice(0, MOST_DOTS).flatMap((one) => AT_DEG.map((angle) => toLab(...at(one, cloud.angles, angle))));
  return Math.max(...colours.flatMap(([, a, b]) => [Math.abs(a), Math.abs(b)]));
}

export function drawCloud(canvas, svg, scale) {
  canvas.hidden = !isShown();
  $("cloud-text").hidden = !$("cloud").checked;
  if (canvas.hidden) return;
  const { rgb, angles } = cloud, context = canvas.getContext("2d");
  canvas.height = rgb.length;
  rgb.forEach((one, row) => {
    for (let i = 0; i < canvas.width; i++) {
      context.fillStyle = `rgb(${shown(...at(one, angles, (90 * i) / (canvas.width - 1))).join(" ")})`;
      context.fillRect(i, row, 1, 1);
    }
  });
  const dots = add(svg, "g", { class: "cloud" });
  for (const one of rgb.slice(0, MOST_DOTS)) {
    for (const angle of AT_DEG) {
      const colour = at(one, angles, angle), [, a, b] = toLab(...colour);
      add(dots, "circle", { cx: scale.x(a).toFixed(1), cy: scale.y(b).toFixed(1), r: 1.7 }).style.fill = `rgb(${shown(...colour).join(" ")})`;
    }
  }
  svg.prepend(dots);
}

function tell(event) {
  cloud = event;
  const said = AT_DEG.map((angle) => {
    const i = event.angles.reduce((best, one, k) => (Math.abs(one - angle) < Math.abs(event.angles[best] - angle) ? k : best), 0);
    return `${event.angles[i]}°: ΔE ${event.most[i].toFixed(1)}`;
  });
  words = $("cloud-text").textContent = `95 % of ${event.rgb.length} draws lie within ${said.join(", ")}${event.failed ? `; ${event.failed} could not be computed` : ""}.`;
  redraw();
}

async function ask() {
  drawing?.abort();
  if (!$("cloud").checked) return;
  const mine = (drawing = new AbortController());
  try {
    const text = await wholeText();
    if (mine !== drawing) return;
    const asked = key();
    $("cloud-text").textContent = "Drawing materials as they would be made";
    await listen("api/cloud", { text, name: app.recipe.name, lamp: $("lamp").value, percent: $("spread").valueAsNumber }, mine.signal, (event) => {
      if (event.kind !== "cloud" || mine !== drawing) return;
      of = asked;
      tell(event);
    });
  } catch (problem) {
    if (mine === drawing && !mine.signal.aborted) $("cloud-text").textContent = problem.message;
  }
}

// After each settled answer: the cloud is of the recipe as it stands, or not shown.
export function cloudSettled() {
  if (!$("cloud").checked) return;
  drawing?.abort();
  clearTimeout(timer);
  $("cloud-text").textContent = of === key() ? words : "The recipe was changed; drawing anew";
  if (of === key()) return;
  timer = setTimeout(ask, RESTING_MS);
}

export function listenCloud(chart) {
  redraw = chart;
  $("cloud").addEventListener("change", () => {
    $("spread").disabled = !$("cloud").checked;
    redraw();
    if (of !== key() || !$("cloud").checked) ask();
  });
  $("spread").addEventListener("change", ask);
}
