// The page: the recipe on the left, the object in the middle, what the numbers say on the right.

import { drawRibbon, drawSpectrum, drawSwatches, drawTrack } from "./charts.js";
import { Form } from "./form.js";
import { Recipe, valueAt } from "./recipe.js";
import { View } from "./view.js";
import { Wire } from "./wire.js";

const $ = (id) => document.getElementById(id);
const recipe = new Recipe(), models = new Map();
let wire = null, view = null, form = null, state = null, lastGood = null, error = null, rendering = null, charting = 0;

async function api(path, body) {
  const options = body ? { method: "POST", body: JSON.stringify(body), headers: { "content-type": "application/json" } } : {};
  const answer = await fetch(path, options);
  const told = await answer.json();
  if (!answer.ok) throw new Error(told.error ?? `the server answered ${answer.status}`);
  return told;
}

// ---- what is shown of the connection and of the answer

function tell(kind, text) {
  const box = $("state");
  box.dataset.kind = kind;
  if (box.textContent !== text) box.textContent = text;
}

function onState(kind) {
  if (kind === "lost") tell("lost", "Connection lost; trying again. Nothing typed is lost.");
  else if (kind === "open") tell("solving", "Connected");
  else if (kind === "asked" && $("state").dataset.kind !== "lost") tell("solving", "Solving");
}

async function onAnswer(answer, isNewest) {
  if (answer.error) return onError(answer, isNewest);
  const isOurs = recipe.settle(answer, isNewest);
  lastGood = answer;
  if (view) view.setLook(answer);
  if (!charting) charting = setTimeout(chart, 0);
  $("notes").replaceChildren(...answer.notes.map((note) => Object.assign(document.createElement("li"), { textContent: note })));
  if (!isNewest) return;
  setError(null);
  const ms = Math.max(1, Math.round(answer.seconds * 1000));
  tell(answer.draft ? "draft" : "settled", answer.draft ? "Draft: few angles and wavelengths. Settling" : `Settled, solved in ${ms} ms`);
  if (isOurs) {
    recipe.step();
    await showRecipe();
  }
}

// The object comes first, the charts after it, once for all answers that came meanwhile.
function chart() {
  charting = 0;
  drawRibbon($("ribbon"), $("ribbon-text"), lastGood);
  drawSpectrum($("spectrum"), lastGood);
  drawTrack($("track"), lastGood);
  drawSwatches($("swatches"), lastGood);
}

async function onError(answer, isNewest) {
  if (!isNewest) return;
  recipe.settle(answer, true);
  setError(answer);
  tell("error", lastGood ? "The recipe has a mistake; the last good one is shown" : "The recipe has a mistake");
  await showRecipe();
}

function setError(told) {
  error = told;
  $("error").hidden = !told;
  if (told) $("error").textContent = (told.line ? `Line ${told.line}: ` : "") + told.error;
  number();
}

// ---- the recipe, as a form and as TOML

async function modelOf(family) {
  if (!models.has(family)) models.set(family, api(`api/form?family=${encodeURIComponent(family)}`).catch(() => null));
  return models.get(family);
}

async function showRecipe() {
  const text = $("text");
  if (text.value !== recipe.text && !(document.activeElement === text && error)) text.value = recipe.text;
  number();
  $("undo").disabled = !recipe.canUndo;
  $("redo").disabled = !recipe.canRedo;
  $("save").disabled = !recipe.isChanged && !recipe.name.startsWith("example:");
  document.title = `${recipe.isChanged ? "• " : ""}${shortName(recipe.name)} – nacre studio`;
  recipe.keep();
  if (!recipe.data) return;
  const model = await modelOf(recipe.data.family ?? "");
  if (model) form.show(model, recipe.data);
}

function number() {
  const count = $("text").value.split("\n").length;
  if ($("lines").childElementCount !== count) {
    $("lines").replaceChildren(...Array.from({ length: count }, (_, i) => Object.assign(document.createElement("div"), { textContent: i + 1 })));
  }
  [...$("lines").children].forEach((line, i) => line.classList.toggle("bad", error?.line === i + 1));
  $("lines").scrollTop = $("text").scrollTop;
}

function change(edit) {
  recipe.change(edit);
  recipe.keep();
  if (edit.op !== "set" || typeof edit.value === "object" || typeof edit.value === "string") showRecipe();
  wire.ask();
}

function typed() {
  recipe.type($("text").value);
  recipe.keep();
  number();
  wire.ask();
}

function tab(isForm) {
  for (const [name, on] of [["form", isForm], ["toml", !isForm]]) {
    $(name).hidden = !on;
    $(`tab-${name}`).setAttribute("aria-selected", String(on));
    $(`tab-${name}`).tabIndex = on ? 0 : -1;
  }
  $("help").hidden = !isForm;
  number();
}

function step(by) {
  if (!recipe.move(by)) return;
  $("text").value = recipe.text;
  wire.ask();
  showRecipe();
}

// ---- files

const shortName = (name) => (name.startsWith("example:") ? `${name.slice(8)} (example)` : name);

function listRecipes() {
  const names = [...new Set([recipe.name, ...state.recipes])].filter(Boolean);
  const options = names.map((name) => new Option(shortName(name), name));
  $("recipes").replaceChildren(...options, new Option("Examples …", ""));
  $("recipes").value = recipe.name;
}

async function open(name) {
  try {
    recipe.open(await api(`api/recipe?name=${encodeURIComponent(name)}`));
  } catch (problem) {
    setError({ error: problem.message, line: null });
    listRecipes();
    return;
  }
  setError(null);
  listRecipes();
  $("text").value = recipe.text;
  await showRecipe();
  wire.ask();
}

async function choose(name) {
  if (name === "") {
    $("recipes").value = recipe.name;
    $("welcome").showModal();
  } else if (!recipe.isChanged || confirm(`${shortName(recipe.name)} has changes that are not saved. Leave it?`)) {
    $("welcome").close();
    await open(name);
  } else $("recipes").value = recipe.name;
}

// Changes that the server has not yet written into the text are written before the text leaves the page.
async function wholeText() {
  const until = performance.now() + 4000;
  while (recipe.edits.length && performance.now() < until) await new Promise((done) => setTimeout(done, 20));
  return recipe.text;
}

async function save(name, mark) {
  const text = await wholeText();
  const told = await api("api/save", { name, text, mark });
  Object.assign(recipe, { name, mark: told.mark, saved: text });
  state.recipes = [...new Set([...state.recipes, name])].sort();
  listRecipes();
  await showRecipe();
  wire.ask();
  tell("settled", `Saved ${name}`);
}

function saveAs() {
  const plain = recipe.name.replace(/^example:/, "").split("/").pop().replace(/\.toml$/, "");
  $("new-name").value = `${plain}${state.recipes.includes(`${plain}.toml`) ? "-2" : ""}.toml`;
  $("name-error").textContent = "";
  $("name-dialog").showModal();
}

async function saveNamed(event) {
  event.preventDefault();
  const given = $("new-name").value.trim(), name = given.endsWith(".toml") ? given : `${given}.toml`;
  try {
    await save(name, name === recipe.name ? recipe.mark : "");
    $("name-dialog").close();
  } catch (problem) {
    $("name-error").textContent = problem.message;
  }
}

async function saveHere() {
  if (recipe.name.startsWith("example:")) return saveAs();
  try {
    await save(recipe.name, recipe.mark);
  } catch (problem) {
    setError({ error: problem.message, line: null });
  }
}

async function copy() {
  const text = await wholeText();
  try {
    await navigator.clipboard.writeText(text);
    tell("settled", "Copied the recipe as TOML");
  } catch {
    tab(false);
    $("text").focus();
    $("text").select();
    tell("settled", "The browser refused the clipboard; the text is selected");
  }
}

// ---- the settled picture

async function render() {
  rendering?.abort();
  const mine = (rendering = new AbortController());
  const ask = { text: await wholeText(), name: recipe.name, lamp: $("lamp").value, scene: $("scene").value, size: Number($("size").value), seconds: Number($("seconds").value) };
  $("cancel").hidden = false;
  $("render-state").textContent = "Rendering; the page stays free.";
  try {
    const answer = await fetch("api/picture", { method: "POST", body: JSON.stringify(ask), signal: mine.signal });
    if (!answer.ok) throw new Error((await answer.json()).error);
    const image = $("picture"), old = image.src;
    image.src = URL.createObjectURL(await answer.blob());
    image.alt = `${ask.scene} of ${shortName(ask.name)} under ${ask.lamp}, rendered by Mitsuba`;
    image.hidden = false;
    if (old) URL.revokeObjectURL(old);
    $("render-state").textContent = `${ask.scene}, ${ask.lamp}, ${ask.size} px: spectral path tracing by Mitsuba 3, denoised. As the recipe was when asked.`;
  } catch (problem) {
    if (mine === rendering) $("render-state").textContent = mine.signal.aborted ? "Cancelled." : problem.message;
  } finally {
    if (mine === rendering) $("cancel").hidden = true;
  }
}

// ---- the beginning

function welcome() {
  $("starts").replaceChildren(...state.starts.map(({ name, title, about }) => {
    const picture = Object.assign(new Image(), { src: `page/start-${title.replaceAll("/", "-")}.jpg`, alt: "" });
    const button = Object.assign(document.createElement("button"), { type: "button" });
    const words = about.length > 76 ? `${about.slice(0, 74).replace(/\s+\S*$/, "")} …` : about;
    button.append(picture, Object.assign(document.createElement("b"), { textContent: title.split("/").pop().replaceAll(/[-_]/g, " ") }), Object.assign(document.createElement("span"), { textContent: words }));
    button.addEventListener("click", () => choose(name));
    return button;
  }));
  $("all-examples").replaceChildren(new Option("choose …", ""), ...state.examples.map(({ name, title, family }) => new Option(`${title} (${family})`, name)));
}

function theme(kind) {
  if (kind === "auto") delete document.documentElement.dataset.theme;
  else document.documentElement.dataset.theme = kind;
  localStorage.setItem("nacre-studio-theme", kind);
}

function listen() {
  const click = (id, act) => $(id).addEventListener("click", act);
  click("undo", () => step(-1));
  click("redo", () => step(1));
  click("copy", copy);
  click("save", saveHere);
  click("save-as", saveAs);
  click("render", render);
  click("cancel", () => rendering?.abort());
  click("front", () => view?.front());
  click("tab-form", () => tab(true));
  click("tab-toml", () => tab(false));
  click("close-welcome", () => $("welcome").close());
  click("name-cancel", () => $("name-dialog").close());
  $("name-form").addEventListener("submit", saveNamed);
  for (const [here, there] of [["form", "toml"], ["toml", "form"]]) {
    $(`tab-${here}`).addEventListener("keydown", (event) => {
      if (!["ArrowLeft", "ArrowRight"].includes(event.key)) return;
      tab(there === "form");
      $(`tab-${there}`).focus();
    });
  }
  $("recipes").addEventListener("change", () => choose($("recipes").value));
  $("all-examples").addEventListener("change", ({ target }) => target.value && choose(target.value));
  $("lamp").addEventListener("change", () => wire.ask());
  $("theme").addEventListener("change", () => theme($("theme").value));
  $("text").addEventListener("input", typed);
  $("text").addEventListener("scroll", number);
  $("exposure").addEventListener("input", () => {
    $("stops").textContent = Number($("exposure").value).toFixed(1);
    if (view) { view.exposure = Number($("exposure").value); view.draw(); }
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
  form = new Form($("form"), $("help"), { change, search: async (text) => (await api(`api/indices?q=${encodeURIComponent(text)}`)).found });
  form.read = (path) => valueAt(recipe.data, path);
  const tables = await fetch("page/table.glsl").then((answer) => answer.text());
  try {
    view = new View($("view"), null, tables);
  } catch {
    $("view").hidden = true;
    $("no-gl").hidden = false;
  }
  listen();
  const roomAsked = view ? fetch("api/surround").then((answer) => answer.arrayBuffer()) : null;
  state = await api("api/state");
  wire = new Wire((seq) => (recipe.name ? { ...recipe.question(seq), lamp: $("lamp").value } : null), onAnswer, onState);
  welcome();
  if (recipe.recall()) {
    listRecipes();
    $("text").value = recipe.text;
    wire.ask();
  } else {
    await open(state.first || state.recipes[0] || state.starts[0].name);
    if (!state.first) $("welcome").showModal();
  }
  if (view) view.setRoom(new Float32Array(await roomAsked), state.surround);
  else render();
}

start().catch((problem) => tell("error", problem.message));
