// The page: the recipe on the left, the object in the middle, what the numbers say on the right.

import { beside, isStale, listenCompare, question, showHistory, takes } from "./compare.js";
import { $, api, app, el, shortName, tell } from "./common.js";
import { listRecipes, listenFiles, open, saveHere, welcome } from "./files.js";
import { cloudSettled, listenCloud } from "./cloud.js";
import { designSettled, listenDesign } from "./design.js";
import { Form } from "./form.js";
import { listenMaker } from "./maker.js";
import { listObjects, listenObjects } from "./objects.js";
import { drawPanels, panels } from "./panels.js";
import { valueAt } from "./recipe.js";
import { listenReport } from "./report.js";
import { listenSettled, render, settledEdited, standIn } from "./settled.js";
import { fetchRoom, listenSurround } from "./surround.js";
import { View } from "./view.js";
import { Wire } from "./wire.js";

const { recipe } = app, models = new Map(), TABS = ["form", "toml", "design"];

// ---- what is shown of the connection and of the answer

function onState(kind) {
  if (kind === "lost") tell("lost", "Connection lost; trying again. Nothing typed is lost.");
  else if (kind === "refused") tell("lost", "nacre studio was started anew: open the address that it printed, in this tab. Nothing typed is lost.");
  else if (kind === "open") tell("solving", "Connected");
  else if (kind === "asked" && $("state").dataset.kind !== "lost") tell("solving", "Solving", false);
}

function onAnswer(answer, isNewest) {
  if (takes(answer)) return;
  if (answer.error) return onError(answer, isNewest);
  const isOurs = recipe.settle(answer, isNewest);
  app.lastGood = answer;
  if (isOurs) app.lastName = recipe.name;
  if (app.view) app.view.setLook(answer);
  const isChanged = isNewest && isOurs;
  if (isChanged) recipe.step();
  panels(isChanged ? showRecipe : null);
  if (!isNewest) return;
  setError(null);
  const ms = Math.max(1, Math.round(answer.seconds * 1000)), took = ms < 1000 ? `${ms} ms` : `${(ms / 1000).toFixed(1)} s`;
  tell(answer.draft ? "draft" : "settled", answer.draft ? "Draft: few angles and wavelengths. Settling" : `Settled, solved in ${took}`, false);
  if (isOurs) settledEdited();
  designSettled(answer);
  if (!answer.draft) cloudSettled();
  if (!answer.draft && isStale()) app.wire.ask();
}

async function onError(answer, isNewest) {
  if (!isNewest) return;
  recipe.settle(answer, true);
  setError(answer);
  const shown = app.lastGood && (app.lastName === recipe.name ? "; the last good one is shown" : `; ${shortName(app.lastName)} is still shown`);
  tell("error", `The recipe has a mistake${shown ?? ""}`);
  if (!recipe.data && !$("form").hidden && recipe.past.length === 1) tab("toml");      // just opened: nothing else can be seen of it
  await showRecipe();
}

function setError(told) {
  if (!told && !app.error) return;      // as nearly always: to number the lines lays the page out
  app.error = told;
  $("error").hidden = !told;
  if (told) $("error").textContent = (told.line ? `Line ${told.line}: ` : "") + told.error;
  number();
}

const own = (seq) => ({ ...recipe.question(seq), ...beside(), lamp: $("lamp").value });

// ---- the recipe, as a form and as TOML

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
  recipe.keep();
  showHistory();
  if (!recipe.data) { app.form.clear("The form is here as soon as its TOML can be read."); return; }
  const model = await modelOf(recipe.data.family ?? "");
  if (model) app.form.show(model, recipe.data);
}

function number() {
  const count = $("text").value.split("\n").length;
  if ($("lines").childElementCount !== count) {
    $("lines").replaceChildren(...Array.from({ length: count }, (_, i) => el("div", { textContent: i + 1 })));
  }
  [...$("lines").children].forEach((line, i) => line.classList.toggle("bad", app.error?.line === i + 1));
  $("lines").scrollTop = $("text").scrollTop;
}

function change(edit) {
  recipe.change(edit);
  recipe.keep();
  if (edit.op !== "set" || typeof edit.value === "object" || typeof edit.value === "string") showRecipe();
  app.wire.ask();
}

function typed() {
  recipe.type($("text").value);
  recipe.keep();
  number();
  app.wire.ask();
}

function tab(name) {
  for (const each of TABS) {
    $(each).hidden = each !== name;
    $(`tab-${each}`).setAttribute("aria-selected", String(each === name));
    $(`tab-${each}`).tabIndex = each === name ? 0 : -1;
  }
  $("help").hidden = name !== "form";
  number();
  if (name === "design") designSettled(app.lastGood);
}

function step(by) {
  if (!recipe.move(by)) return;
  $("text").value = recipe.text;
  app.wire.ask();
  showRecipe();
}

// ---- the beginning

function theme(kind) {
  if (kind === "auto") delete document.documentElement.dataset.theme;
  else document.documentElement.dataset.theme = kind;
  localStorage.setItem("nacre-studio-theme", kind);
  drawPanels();         // its pens have colours of the theme
}

function listen() {
  const click = (id, act) => $(id).addEventListener("click", act);
  listenFiles({ setError, showRecipe, tab });
  listenSettled();
  listenReport();
  listenMaker();
  listenObjects();
  listenSurround();
  listenCompare({ chart: drawPanels, go: step, showRecipe, listRecipes });
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
  listenDesign({ showRecipe });
  listenCloud(drawPanels);
  $("lamp").addEventListener("change", () => app.wire.ask());
  $("theme").addEventListener("change", () => theme($("theme").value));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawPanels);
  $("text").addEventListener("input", typed);
  $("text").addEventListener("scroll", number);
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
  if (!app.view) standIn();
  const roomAsked = app.view ? fetchRoom("studio") : null;
  app.state = await api("api/state");
  app.wire = new Wire((seq) => (recipe.name ? question(seq, own) : null), onAnswer, onState);
  welcome();
  listObjects();
  if (recipe.recall()) {
    listRecipes();
    $("text").value = recipe.text;
    app.wire.ask();
  } else {
    await open(app.state.first || app.state.begin || app.state.starts[0].name);
    if (!app.state.first) $("welcome").showModal();
  }
  if (app.view) app.view.setRoom((await roomAsked).room, app.state.surround, null);
  else render();
}

start().catch((problem) => tell("error", problem.message));
