// The page: the recipe on the left, the object in the middle, colours and spectra on the right.

import { comparedLab, isStale, initCompare, question, showHistory, handlesAnswer } from "./compare.js";
import { initAngles, updateAngles } from "./angles.js";
import { $, api, app, el, shortName, setStatus } from "./common.js";
import { listRecipes, initFiles, open, saveHere, welcome } from "./files.js";
import { updateTolerance, initTolerance } from "./tolerance.js";
import { updateDesign, initDesign } from "./design.js";
import { Form } from "./form.js";
import { initDownloads } from "./downloads.js";
import { incidenceOf, initIncidence } from "./incidence.js";
import { listObjects, initObjects } from "./objects.js";
import { drawPanels, panels } from "./panels.js";
import { valueAt } from "./recipe.js";
import { initReport } from "./report.js";
import { initRendering, render, restartRendering, replacePreview } from "./rendering.js";
import { fetchRoom, initSurroundings } from "./surroundings.js";
import { View } from "./view.js";
import { Socket } from "./socket.js";

const { recipe } = app, models = new Map(), LISTING = / List: nacre indices search (.*)$/, TABS = ["form", "toml", "design"];

let wrapped = "";       // text and width of the numbered lines

// ---- connection and answers

function onState(kind) {
  if (kind === "lost") setStatus("lost", "Connection lost; reconnecting. Your edits are preserved.");
  else if (kind === "refused") setStatus("lost", "nacre studio was restarted: open the address that it printed in this tab. Your edits are preserved.");
  else if (kind === "open") setStatus("solving", "Connected");
  else if (kind === "asked" && $("state").dataset.kind !== "lost") setStatus("solving", "Solving", false);
}

function onAnswer(answer, isNewest) {
  if (handlesAnswer(answer)) return;
  if (answer.error) return onError(answer, isNewest);
  const isOurs = recipe.settle(answer, isNewest);
  app.lastGood = answer;
  if (isOurs) app.lastName = recipe.name;
  if (app.view) app.view.setAppearance(answer);
  const isChanged = isNewest && isOurs;
  if (isChanged) recipe.step();
  panels(isChanged ? showRecipe : null);
  if (!isNewest) return;
  setError(null);
  const ms = Math.max(1, Math.round(answer.seconds * 1000)), took = ms < 1000 ? `${ms} ms` : `${(ms / 1000).toFixed(1)} s`;
  setStatus(answer.draft ? "draft" : "settled", answer.draft ? "Draft with few angles and wavelengths; solving in full" : `Solved in ${took}`, false);
  if (isOurs) restartRendering();
  updateDesign(answer);
  updateAngles();
  if (!answer.draft) updateTolerance();
  if (!answer.draft && isStale()) app.socket.ask();
}

async function onError(answer, isNewest) {
  if (!isNewest) return;
  recipe.settle(answer, true);
  setError(answer);
  const shown = app.lastGood && (app.lastName === recipe.name ? "; the last valid one is shown" : `; ${shortName(app.lastName)} is still shown`);
  setStatus("error", `The recipe has a mistake${shown ?? ""}`);
  if (!recipe.data && !$("form").hidden && recipe.past.length === 1) tab("toml");      // a newly opened invalid recipe has no form
  await showRecipe();
}

function setError(answer) {
  if (!answer && !app.error) return;      // the usual case; numbering the lines would force a layout
  app.error = answer;
  $("error").hidden = !answer;
  if (answer) $("error").textContent = (answer.line ? `Line ${answer.line}: ` : "") + answer.error.replace(LISTING, "");
  offer(answer);
  number();
}

// Names to click instead of the command that lists them.
async function offer(answer) {
  const box = $("error-choices"), wanted = LISTING.exec(answer?.error ?? "")?.[1], path = /: ([\w.[\]]+) = "/.exec(answer?.error ?? "")?.[1];
  box.hidden = true;
  if (!wanted || !path || !recipe.data) return;
  const meant = [...(answer.error.match(/Did you mean .*/)?.[0] ?? "").matchAll(/"([^"]+)"/g)].map(([, name]) => ({ name, title: name }));
  const { found } = await api(`api/indices?q=${encodeURIComponent(wanted)}`).catch(() => ({ found: [] }));
  if (app.error !== answer) return;
  const all = [...meant, ...found.filter(({ name }) => !meant.some((one) => one.name === name))];
  box.replaceChildren(...all.map(({ name, title }) => {
    const button = el("button", { type: "button", textContent: name, title });
    button.addEventListener("click", () => change({ op: "set", path, value: name }));
    return button;
  }));
  box.hidden = !all.length;
}

// Angles and wavelengths of a dropped measurement, for Psi and Delta beside it.
function ellipsometryAsked() {
  const found = app.ellipsometry ?? [], nm = found.flatMap((one) => one.nm);
  return found.length ? { ellipsometry: { angles_deg: found.map((one) => one.angle_deg), range_nm: [Math.min(...nm), Math.max(...nm)] } } : {};
}

const own = (seq) => ({ ...recipe.question(seq), ...comparedLab(), ...ellipsometryAsked(), ...incidenceOf(), lamp: $("lamp").value });

// ---- the recipe as form and TOML

async function modelOf(family) {
  if (!app.state.families.includes(family)) return null;
  if (!models.has(family)) models.set(family, api(`api/form?family=${encodeURIComponent(family)}`).catch(() => null));
  return models.get(family);
}

async function showRecipe() {
  const text = $("text");
  if (text.value !== recipe.text && !(document.activeElement === text && app.error)) text.value = recipe.text;
  number();
  $("undo").disabled = !recipe.canUndo;
  $("redo").disabled = !recipe.canRedo;
  $("save").disabled = !recipe.isChanged && !recipe.name.startsWith("example:");
  document.title = `${recipe.isChanged ? "• " : ""}${shortName(recipe.name)} – nacre studio`;
  recipe.store();
  showHistory();
  if (!recipe.data) { app.form.clear("The form appears when the TOML is valid."); return; }
  const model = await modelOf(recipe.data.family ?? "");
  if (model) app.form.show(model, recipe.data);
}

function number() {
  const count = $("text").value.split("\n").length;
  if ($("lines").childElementCount !== count) {
    $("lines").replaceChildren(...Array.from({ length: count }, (_, i) => el("div", { textContent: i + 1 })));
  }
  wrap();
  [...$("lines").children].forEach((line, i) => line.classList.toggle("bad", app.error?.line === i + 1));
  $("lines").scrollTop = $("text").scrollTop;
}

// A number stands beside the first row of its line: long lines are wrapped.
function wrap() {
  const text = $("text"), box = $("wrapped"), width = text.clientWidth - 16, key = `${width} ${text.value}`;
  if ($("toml").hidden || width <= 0 || wrapped === key) return;
  wrapped = key;
  box.style.width = `${width}px`;
  box.replaceChildren(...text.value.split("\n").map((line) => el("div", { textContent: line || " " })));
  const heights = [...box.children].map((line) => line.offsetHeight);
  [...$("lines").children].forEach((line, i) => { line.style.height = `${heights[i]}px`; });
  box.replaceChildren();
}

function change(edit) {
  recipe.change(edit);
  recipe.store();
  if (edit.op !== "set" || typeof edit.value === "object" || typeof edit.value === "string") showRecipe();
  app.socket.ask();
}

function typed() {
  recipe.type($("text").value);
  recipe.store();
  number();
  app.socket.ask();
}

function tab(name) {
  for (const each of TABS) {
    $(each).hidden = each !== name;
    $(`tab-${each}`).setAttribute("aria-selected", String(each === name));
    $(`tab-${each}`).tabIndex = each === name ? 0 : -1;
  }
  $("help").hidden = name !== "form";
  number();
  if (name === "design") updateDesign(app.lastGood);
}

function step(by) {
  if (!recipe.move(by)) return;
  $("text").value = recipe.text;
  app.socket.ask();
  showRecipe();
}

// ---- start

function theme(kind) {
  if (kind === "auto") delete document.documentElement.dataset.theme;
  else document.documentElement.dataset.theme = kind;
  localStorage.setItem("nacre-studio-theme", kind);
  drawPanels();         // the curves use colours of the theme
}

function listen() {
  const click = (id, act) => $(id).addEventListener("click", act);
  initFiles({ setError, showRecipe, tab });
  initRendering();
  initIncidence();
  initReport();
  initAngles();
  initDownloads();
  initObjects();
  initSurroundings();
  initCompare({ chart: drawPanels, go: step, showRecipe, listRecipes });
  click("undo", () => step(-1));
  click("redo", () => step(1));
  click("front", () => app.view?.front());
  TABS.forEach((here, i) => {
    click(`tab-${here}`, () => tab(here));
    $(`tab-${here}`).addEventListener("keydown", ({ key }) => {
      const by = { ArrowLeft: TABS.length - 1, ArrowRight: 1 }[key], there = TABS[(i + by) % TABS.length];
      if (!by) return;
      tab(there);
      $(`tab-${there}`).focus();
    });
  });
  initDesign({ showRecipe });
  initTolerance(drawPanels);
  $("lamp").addEventListener("change", () => app.socket.ask());
  $("theme").addEventListener("change", () => theme($("theme").value));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawPanels);
  $("text").addEventListener("input", typed);
  $("text").addEventListener("scroll", number);
  addEventListener("resize", number);
  $("exposure").addEventListener("input", () => {
    $("stops").textContent = Number($("exposure").value).toFixed(1);
    if (app.view) { app.view.exposure = Number($("exposure").value); app.view.draw(); }
  });
  addEventListener("keydown", (event) => {
    if (!(event.ctrlKey || event.metaKey) || event.altKey || document.querySelector("dialog[open]")) return;
    const key = event.key.toLowerCase(), isText = event.target === $("text");
    if (key === "s") { event.preventDefault(); saveHere(); }
    else if (!isText && (key === "y" || (key === "z" && event.shiftKey))) { event.preventDefault(); step(1); }
    else if (!isText && key === "z") { event.preventDefault(); step(-1); }
  });
}

async function start() {
  const kind = localStorage.getItem("nacre-studio-theme") ?? "auto";
  $("theme").value = kind;
  theme(kind);
  app.form = new Form($("form"), $("help"), { change, search: async (text) => (await api(`api/indices?q=${encodeURIComponent(text)}`)).found });
  app.form.read = (path) => valueAt(recipe.data, path);
  const tables = await fetch("page/table.glsl").then((answer) => answer.text());
  try {
    app.view = new View($("view"), null, tables);
  } catch {
    $("view").hidden = true;
    $("no-gl").hidden = false;
  }
  listen();
  if (!app.view) replacePreview();
  const roomAsked = app.view ? fetchRoom("studio") : null;
  app.state = await api("api/state");
  app.socket = new Socket((seq) => (recipe.name ? question(seq, own) : null), onAnswer, onState);
  welcome();
  listObjects();
  if (recipe.recall()) {
    listRecipes();
    $("text").value = recipe.text;
    app.socket.ask();
  } else {
    await open(app.state.first || app.state.begin || app.state.starts[0].name);
    if (!app.state.first) $("welcome").showModal();
  }
  if (app.view) app.view.setRoom((await roomAsked).room, app.state.surroundings, null);
  else render();
}

start().catch((problem) => setStatus("error", problem.message));
