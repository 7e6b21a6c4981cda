// The design tab: target colours at angles, parameters, the gamut, and the solutions of the search.

import { $, api, app, el, shortName, fullText } from "./common.js";
import { toLab, total } from "./charts.js";
import { curveTargets, initCurve, suggestCurve } from "./hue_curve.js";
import { listen, session } from "./event_stream.js";
import { angleOf, clearGamut, onGamutEvent, initGamut } from "./gamut.js";

const { recipe } = app;
const FIRST_TARGETS = [{ angle: 0, colour: "#8a4fb0" }], MAX_TARGETS = 8, ASPECULAR_DEG = 15, MESSAGE_MS = 1500;
let page = null, searching = null, sampling = null;      // page: functions of main.js, { showRecipe }
let listing = Promise.resolve();        // the current update of the parameters
let shape = "", isChosen = false, count = 0;    // structure of the recipe whose parameters are listed; whether the user chose the geometry

// ---- targets

const isCurve = () => $("targets-as-curve").checked;

function addTarget({ angle: value, colour, tolerance = 2 }) {
  const row = el("div", { className: "target" }), name = `colour ${++count}`;
  const angle = el("input", { type: "number", value, min: -40, max: 110, step: "any" }), pick = el("input", { type: "color", value: colour });
  const limit = el("input", { type: "number", value: tolerance, min: 0.1, max: 50, step: "any" });
  const remove = el("button", { type: "button", textContent: "✕", title: "Remove" });
  for (const [box, words] of [[angle, "Angle of"], [pick, "Choose"], [limit, "Tolerance ΔE of"], [remove, "Remove"]]) box.setAttribute("aria-label", `${words} ${name}`);
  remove.addEventListener("click", () => { row.remove(); $("target-add").disabled = false; $("target-add").focus(); clearGamut(); });
  row.append(angle, el("span", { textContent: "°" }), pick, el("span", { textContent: "ΔE ≤" }), limit, remove);
  row.addEventListener("input", clearGamut);
  $("targets").append(row);
  $("target-add").disabled = $("targets").childElementCount >= MAX_TARGETS;
  clearGamut();
}

function targets() {
  if (isCurve()) return curveTargets();
  return [...$("targets").children].map((row) => {
    const [angle, colour, tolerance] = row.querySelectorAll("input");
    return { angle: angle.valueAsNumber, colour: colour.value, tolerance: tolerance.valueAsNumber };
  });
}

// ---- parameters

async function showParameters() {
  const text = await fullText(), rows = new Map([...$("parameters").children].map((row) => [row.dataset.path, row]));
  try {
    const answer = await api("api/parameters", { text, name: recipe.name });
    if (!isChosen) $("geometry").value = answer.geometry;
    const angle = $("targets").querySelector("input");
    if (!isChosen && answer.geometry === "aspecular" && angle?.value === "0") angle.value = ASPECULAR_DEG;
    $("design-refused").hidden = !answer.refused;
    $("design-refused").textContent = answer.refused ?? "";
    $("design-box").hidden = Boolean(answer.refused);
    $("parameters").replaceChildren(...answer.parameters.map((one) => rows.get(one.path) ?? parameterRow(one)));
  } catch (problem) {
    $("design-refused").hidden = false;
    $("design-refused").textContent = problem.message;
    $("design-box").hidden = true;
  }
}

function parameterRow({ path, low, high, about, selected }) {
  const tick = el("input", { type: "checkbox", checked: selected }), ends = [low, high].map((value) => el("input", { type: "number", value, step: "any" }));
  ends.forEach((box, i) => box.setAttribute("aria-label", `${i ? "Highest" : "Lowest"} ${path}`));
  const broken = path.split(".").flatMap((part, i) => (i ? [document.createElement("wbr"), `.${part}`] : [part]));
  const label = el("label", {}, tick, el("span", { title: path }, ...broken), about ? el("span", { className: "quiet", textContent: about }) : null);
  const row = el("div", { className: "parameter-row" }, label, ...ends);
  row.dataset.path = path;
  const put = () => { for (const box of ends) box.disabled = !tick.checked; };
  tick.addEventListener("change", () => { put(); clearGamut(); });
  row.addEventListener("input", clearGamut);
  put();
  return row;
}

function parameters() {
  return [...$("parameters").children].map((row) => [row, ...row.querySelectorAll("input")]).filter(([, tick]) => tick.checked)
    .map(([row, , low, high]) => ({ path: row.dataset.path, low: low.valueAsNumber, high: high.valueAsNumber }));
}

async function question() {
  const text = await fullText();
  await listing;
  return { text, name: recipe.name, lamp: $("lamp").value, geometry: $("geometry").value, targets: targets(), parameters: parameters(), seconds: $("design-seconds").valueAsNumber };
}

// ---- gamut and search

async function sampleGamut() {
  sampling?.abort();
  const request = (sampling = new AbortController());
  $("design-error").textContent = "";
  $("gamut-state").textContent = "Sampling structures; the page stays responsive.";
  try {
    await listen("api/gamut", await question(), request.signal, (event) => { if (request === sampling) onGamutEvent(event); });
    if (request === sampling) $("gamut-state").textContent = "";
  } catch (problem) {
    if (request !== sampling) return;
    $("gamut-state").textContent = "";
    if (!request.signal.aborted) $("design-error").textContent = problem.message;
  }
}

async function search() {
  searching?.abort();
  const request = (searching = new AbortController()), name = recipe.name;
  let seconds = 0, shown = 0, finals = [], ended = "";
  $("design-error").textContent = "";
  $("solutions").replaceChildren();
  $("design-progress").removeAttribute("value");
  busy(true);
  $("design-state").textContent = "Starting";
  try {
    await listen("api/design", await question(), request.signal, (event) => {
      if (request !== searching) return;
      if (event.kind === "waiting") $("design-state").textContent = "Waiting for another page's design";
      if (event.kind === "begun") { seconds = event.seconds; $("design-state").textContent = "Searching; the page stays responsive."; }
      if (event.kind === "progress" || event.kind === "solution") {
        $("design-progress").value = Math.min(1, event.seconds / seconds);
        if (event.kind === "solution" || performance.now() - shown > MESSAGE_MS) {
          shown = performance.now();
          const best = event.worst === undefined || event.kind === "progress" ? "" : event.worst === null ? "; a better solution" : `; best so far: ΔE ${event.worst.toFixed(2)}`;
          if (event.kind === "solution") $("design-state").dataset.best = best;
          $("design-state").textContent = `${Math.round(event.seconds)} s of ${seconds}${$("design-state").dataset.best ?? ""}`;
        }
      }
      if (event.kind === "solution") $("solutions").replaceChildren(card(event, "Best so far", name));
      if (event.kind === "final") {
        finals.push(event);
        $("solutions").replaceChildren(...finals.map((one, i) => card(one, `Solution ${i + 1}`, name)));
      }
      if (event.kind === "ended") ended = event.message;
    });
    if (request === searching) $("design-state").textContent = ended ? `${ended[0].toUpperCase()}${ended.slice(1)}.` : "Stopped before there was a solution.";
  } catch (problem) {
    if (request !== searching) return;
    $("design-state").textContent = "";
    if (!request.signal.aborted) $("design-error").textContent = problem.message;
  } finally {
    if (request === searching) busy(false);
  }
}

function busy(is) {
  delete $("design-state").dataset.best;
  $("design-progress").hidden = !is;
  $("design-stop").hidden = !is;
  $("design-stop").disabled = false;
  $("design-go").hidden = is;
}

// Finish the search with its current best solutions, or abort it if the server does not know it.
async function stop() {
  $("design-stop").disabled = true;
  $("design-state").textContent = "Stopping with the best so far";
  await api("api/stop", { session }).then(({ stopping }) => { if (!stopping) searching?.abort(); }).catch(() => searching?.abort());
}

function chip(colour, words) {
  const made = el("span", { className: "chip", title: `${words} ${colour}` });
  made.style.background = colour;
  return made;
}

function card({ targets: results, worst, text, changes }, title, name) {
  const load = el("button", { type: "button", textContent: "Load" });
  load.setAttribute("aria-label", `Load ${title.toLowerCase()} into the recipe`);
  load.addEventListener("click", () => take(text, name, title));
  const rows = results.map(({ geometry, target, reached, de00, met }) => el("li", {}, `${angleOf(geometry)} `, chip(target, "target"), chip(reached, "reached"), ` ΔE ${de00.toFixed(2)} ${met ? "within tolerance" : "outside tolerance"}`));
  const numbers = Object.entries(changes).map(([path, value]) => `${path} = ${value}`).join(", ");
  const miss = worst === null || worst === undefined ? "" : `, worst ΔE ${worst.toFixed(2)}`;
  return el("li", { className: "answer" }, el("div", { className: "bar" }, el("b", { textContent: `${title}${miss}` }), el("span", { className: "gap" }), load),
    el("ul", {}, ...rows), el("p", { className: "quiet", textContent: numbers, title: numbers }));
}

function take(text, name, title) {
  if (name !== recipe.name) {
    $("design-error").textContent = `This solution belongs to ${shortName(name)}; open that recipe to load it.`;
    return;
  }
  recipe.type(text);
  recipe.group = `design ${++count}`;
  recipe.action = `${title} of a design`;
  recipe.store();
  $("text").value = text;
  app.socket.ask();
  page.showRecipe();
  $("design-state").textContent = `${title} is loaded; Undo restores the recipe.`;
}

// ---- connections to the page

// After each answer: list the parameters of the current recipe.
export function updateDesign(appearance) {
  if ($("design").hidden || !appearance?.data) return;
  const all = total(appearance);
  suggestCurve((angle) => {
    const [, a, b] = toLab(all[3 * angle], all[3 * angle + 1], all[3 * angle + 2]);
    return ((Math.atan2(b, a) * 180) / Math.PI + 360) % 360;
  });
  const now = recipe.name + JSON.stringify(appearance.data, (key, value) => (typeof value === "number" ? 0 : value));
  if (now === shape) return;
  if (!shape.startsWith(recipe.name)) {
    $("parameters").replaceChildren();
    isChosen = false;
  }
  shape = now;
  clearGamut();
  listing = showParameters();
}

export function initDesign(pageHooks) {
  page = pageHooks;
  const click = (id, act) => $(id).addEventListener("click", act);
  document.addEventListener("measured", ({ detail }) => { if (detail.colours.length) addTarget({ angle: 0, colour: detail.colours[0].hex }); });
  click("target-add", () => { addTarget({ angle: Math.min(75, 15 * $("targets").childElementCount), colour: "#3f8f5f" }); $("targets").lastChild.querySelector("input").focus(); });
  click("gamut-go", sampleGamut);
  click("design-go", search);
  click("design-stop", stop);
  $("geometry").addEventListener("change", () => { isChosen = true; clearGamut(); });
  for (const id of ["targets-as-colours", "targets-as-curve"]) {
    $(id).addEventListener("change", () => { $("targets-box").hidden = isCurve(); $("curve-box").hidden = !isCurve(); clearGamut(); });
  }
  for (const id of ["hue-chroma", "hue-span"]) $(id).addEventListener("input", clearGamut);
  initCurve(clearGamut);
  initGamut();
  FIRST_TARGETS.forEach(addTarget);
}
