// Design inside: colours wanted at angles, what may change, the gamut, and answers as they are found.

import { $, api, app, el, shortName, wholeText } from "./common.js";
import { toLab, total } from "./charts.js";
import { curveWants, listenCurve, suggestCurve } from "./hues.js";
import { listen, session } from "./lines.js";
import { angleOf, forgetReach, hearReach, listenReach } from "./reach.js";

const { recipe } = app;
const FIRST_WANTS = [{ at: 0, colour: "#8a4fb0" }], MOST_WANTS = 8, BESIDE_DEG = 15, SAID_MS = 1500;
let page = null, searching = null, reaching = null;      // page: what main.js does: showRecipe()
let listing = Promise.resolve();        // of what may change
let shape = "", isChosen = false, count = 0;    // of the recipe that the free numbers are of; whether the way of seeing was chosen by hand

// ---- what is wanted

const isCurve = () => $("wants-as-curve").checked;

function addWant({ at, colour, within = 2 }) {
  const row = el("div", { className: "want" }), name = `colour ${++count}`;
  const angle = el("input", { type: "number", value: at, min: -40, max: 110, step: "any" }), pick = el("input", { type: "color", value: colour });
  const good = el("input", { type: "number", value: within, min: 0.1, max: 50, step: "any" });
  const gone = el("button", { type: "button", textContent: "✕", title: "Take out" });
  for (const [box, words] of [[angle, "Angle of"], [pick, "Choose"], [good, "ΔE that is near enough, of"], [gone, "Take out"]]) box.setAttribute("aria-label", `${words} ${name}`);
  gone.addEventListener("click", () => { row.remove(); $("want-add").disabled = false; $("want-add").focus(); asked(); });
  row.append(angle, el("span", { textContent: "°" }), pick, el("span", { textContent: "ΔE ≤" }), good, gone);
  row.addEventListener("input", asked);
  $("wants").append(row);
  $("want-add").disabled = $("wants").childElementCount >= MOST_WANTS;
  asked();
}

function wants() {
  if (isCurve()) return curveWants();
  return [...$("wants").children].map((row) => {
    const [at, colour, within] = row.querySelectorAll("input");
    return { at: at.valueAsNumber, colour: colour.value, within: within.valueAsNumber };
  });
}

// Something else is asked for: the gamut that is shown marks what was asked before.
function asked() {
  forgetReach();
}

// ---- what may change

async function showFree() {
  const text = await wholeText(), kept = new Map([...$("free").children].map((row) => [row.dataset.path, row]));
  try {
    const found = await api("api/free", { text, name: recipe.name });
    if (!isChosen) $("look").value = found.look;
    // beside its mirror there is most to see some degrees off it
    const angle = $("wants").querySelector("input");
    if (!isChosen && found.look === "aspecular" && angle?.value === "0") angle.value = BESIDE_DEG;
    $("design-refused").hidden = !found.refused;
    $("design-refused").textContent = found.refused ?? "";
    $("design-box").hidden = Boolean(found.refused);
    $("free").replaceChildren(...found.numbers.map((number) => kept.get(number.path) ?? freeRow(number)));
  } catch (problem) {
    $("design-refused").hidden = false;
    $("design-refused").textContent = problem.message;
    $("design-box").hidden = true;
  }
}

function freeRow({ path, low, high, about, free }) {
  const tick = el("input", { type: "checkbox", checked: free }), ends = [low, high].map((value) => el("input", { type: "number", value, step: "any" }));
  ends.forEach((box, i) => box.setAttribute("aria-label", `${i ? "Highest" : "Lowest"} ${path}`));
  const broken = path.split(".").flatMap((part, i) => (i ? [document.createElement("wbr"), `.${part}`] : [part]));
  const label = el("label", {}, tick, el("span", { title: path }, ...broken), about ? el("span", { className: "quiet", textContent: about }) : null);
  const row = el("div", { className: "free-row" }, label, ...ends);
  row.dataset.path = path;
  const put = () => { for (const box of ends) box.disabled = !tick.checked; };
  tick.addEventListener("change", () => { put(); asked(); });
  row.addEventListener("input", asked);
  put();
  return row;
}

function free() {
  return [...$("free").children].map((row) => [row, ...row.querySelectorAll("input")]).filter(([, tick]) => tick.checked)
    .map(([row, , low, high]) => ({ path: row.dataset.path, low: low.valueAsNumber, high: high.valueAsNumber }));
}

async function question() {
  const text = await wholeText();
  await listing;        // whoever is quick asks before the numbers that may change have come
  return { text, name: recipe.name, lamp: $("lamp").value, look: $("look").value, wants: wants(), free: free(), seconds: $("design-seconds").valueAsNumber };
}

// ---- the gamut, and the search

async function reach() {
  reaching?.abort();
  const mine = (reaching = new AbortController());
  $("design-error").textContent = "";
  $("gamut-state").textContent = "Drawing structures; the page stays free.";
  try {
    await listen("api/reach", await question(), mine.signal, (event) => { if (mine === reaching) hearReach(event); });
    if (mine === reaching) $("gamut-state").textContent = "";
  } catch (problem) {
    if (mine !== reaching) return;
    $("gamut-state").textContent = "";
    if (!mine.signal.aborted) $("design-error").textContent = problem.message;
  }
}

async function search() {
  searching?.abort();
  const mine = (searching = new AbortController()), name = recipe.name;
  let seconds = 0, said = 0, finals = [], ended = "";
  $("design-error").textContent = "";
  $("solutions").replaceChildren();
  $("design-progress").removeAttribute("value");
  busy(true);
  $("design-state").textContent = "Beginning";
  try {
    await listen("api/design", await question(), mine.signal, (event) => {
      if (mine !== searching) return;
      if (event.kind === "waiting") $("design-state").textContent = "Waiting for another page's design";
      if (event.kind === "begun") { seconds = event.seconds; $("design-state").textContent = "Searching; the page stays free."; }
      if (event.kind === "progress" || event.kind === "solution") {
        $("design-progress").value = Math.min(1, event.seconds / seconds);
        if (event.kind === "solution" || performance.now() - said > SAID_MS) {
          said = performance.now();
          const best = event.worst === undefined || event.kind === "progress" ? "" : event.worst === null ? "; a better answer" : `; the best so far misses by ΔE ${event.worst.toFixed(2)}`;
          if (event.kind === "solution") $("design-state").dataset.best = best;
          $("design-state").textContent = `${Math.round(event.seconds)} s of ${seconds}${$("design-state").dataset.best ?? ""}`;
        }
      }
      if (event.kind === "solution") $("solutions").replaceChildren(card(event, "Best so far", name));
      if (event.kind === "final") {
        finals.push(event);
        $("solutions").replaceChildren(...finals.map((one, i) => card(one, `Answer ${i + 1}`, name)));
      }
      if (event.kind === "ended") ended = event.message;
    });
    if (mine === searching) $("design-state").textContent = ended ? `${ended[0].toUpperCase()}${ended.slice(1)}.` : "Stopped before there was an answer.";
  } catch (problem) {
    if (mine !== searching) return;
    $("design-state").textContent = "";
    if (!mine.signal.aborted) $("design-error").textContent = problem.message;
  } finally {
    if (mine === searching) busy(false);
  }
}

function busy(is) {
  delete $("design-state").dataset.best;
  $("design-progress").hidden = !is;
  $("design-stop").hidden = !is;
  $("design-stop").disabled = false;
  $("design-go").hidden = is;
}

// The search ends with what it has, judged anew; where nothing answers any more, the page lets go of it.
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

function card({ wants: seen, worst, text, changes }, title, name) {
  const load = el("button", { type: "button", textContent: "Load" });
  load.setAttribute("aria-label", `Load ${title.toLowerCase()} into the recipe`);
  load.addEventListener("click", () => take(text, name, title));
  const rows = seen.map(({ at, asked: wanted, got, de00, met }) => el("li", {}, `${angleOf(at)} `, chip(wanted, "asked"), chip(got, "reached"), ` ΔE ${de00.toFixed(2)} ${met ? "near enough" : "too far"}`));
  const numbers = Object.entries(changes).map(([path, value]) => `${path} = ${value}`).join(", ");
  const miss = worst === null || worst === undefined ? "" : `, worst ΔE ${worst.toFixed(2)}`;
  return el("li", { className: "answer" }, el("div", { className: "bar" }, el("b", { textContent: `${title}${miss}` }), el("span", { className: "gap" }), load),
    el("ul", {}, ...rows), el("p", { className: "quiet", textContent: numbers, title: numbers }));
}

function take(text, name, title) {
  if (name !== recipe.name) {
    $("design-error").textContent = `This answer is of ${shortName(name)}; open it to load the answer.`;
    return;
  }
  recipe.type(text);
  recipe.group = `design ${++count}`;
  recipe.said = `${title} of a design`;
  recipe.keep();
  $("text").value = text;
  app.wire.ask();
  page.showRecipe();
  $("design-state").textContent = `${title} is loaded; undo takes it back.`;
}

// ---- the rest of the page

// After each answer: the numbers that may be free are those of the recipe as it stands.
export function designSettled(look) {
  if ($("design").hidden || !look?.data) return;
  const all = total(look);
  suggestCurve((angle) => {
    const [, a, b] = toLab(all[3 * angle], all[3 * angle + 1], all[3 * angle + 2]);
    return ((Math.atan2(b, a) * 180) / Math.PI + 360) % 360;
  });
  const now = recipe.name + JSON.stringify(look.data, (key, value) => (typeof value === "number" ? 0 : value));
  if (now === shape) return;
  if (!shape.startsWith(recipe.name)) {
    $("free").replaceChildren();
    isChosen = false;
  }
  shape = now;
  forgetReach();
  listing = showFree();
}

export function listenDesign(given) {
  page = given;
  const click = (id, act) => $(id).addEventListener("click", act);
  click("want-add", () => { addWant({ at: Math.min(75, 15 * $("wants").childElementCount), colour: "#3f8f5f" }); $("wants").lastChild.querySelector("input").focus(); });
  click("reach", reach);
  click("design-go", search);
  click("design-stop", stop);
  $("look").addEventListener("change", () => { isChosen = true; asked(); });
  for (const id of ["wants-as-colours", "wants-as-curve"]) {
    $(id).addEventListener("change", () => { $("wants-box").hidden = isCurve(); $("curve-box").hidden = !isCurve(); asked(); });
  }
  for (const id of ["hue-chroma", "hue-span"]) $(id).addEventListener("input", asked);
  listenCurve(asked);
  listenReach();
  FIRST_WANTS.forEach(addWant);
}
