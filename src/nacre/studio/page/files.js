// The opened folder: its recipes, the starting points, saving, copying.

import { $, api, app, el, shortName, setStatus, fullText } from "./common.js";

const { recipe } = app;
let page = null;    // functions of main.js, { setError, showRecipe, tab }

export function listRecipes() {
  const names = [...new Set([recipe.name, ...app.state.recipes])].filter(Boolean);
  $("recipes").replaceChildren(...names.map((name) => new Option(shortName(name), name)), new Option("Examples …", ""));
  $("recipes").value = recipe.name;
}

export async function open(name) {
  try {
    await openMade(await api(`api/recipe?name=${encodeURIComponent(name)}`));
  } catch (problem) {
    page.setError({ error: problem.message, line: null });
    listRecipes();
  }
}

// Open a recipe by name, text and version; version "": it is not in the folder yet.
export async function openMade(found) {
  recipe.open(found);
  if (!found.version && !found.name.startsWith("example:")) recipe.saved = null;
  page.setError(null);
  for (const id of ["object-error", "design-error", "file-error", "file-state"]) $(id).textContent = "";        // of the last recipe
  $("file-remarks").replaceChildren();
  listRecipes();
  $("text").value = recipe.text;
  await page.showRecipe();
  app.socket.ask();
}

async function choose(name) {
  if (name === "") {
    $("recipes").value = recipe.name;
    $("welcome").showModal();
  } else if (!recipe.isChanged || confirm(`${shortName(recipe.name)} has unsaved changes. Leave it?`)) {
    $("welcome").close();
    await open(name);
  } else $("recipes").value = recipe.name;
}

async function save(name, version) {
  const text = await fullText();
  const saved = await api("api/save", { name, text, version });
  Object.assign(recipe, { name, version: saved.version, saved: text });
  app.state.recipes = [...new Set([...app.state.recipes, name])].sort();
  listRecipes();
  await page.showRecipe();
  app.socket.ask();
  setStatus("settled", `Saved ${name}`);
}

function saveAs() {
  const plain = recipe.name.replace(/^example:/, "").split("/").pop().replace(/\.toml$/, "");
  $("new-name").value = `${plain}${app.state.recipes.includes(`${plain}.toml`) ? "-2" : ""}.toml`;
  $("name-error").textContent = "";
  $("name-dialog").showModal();
}

async function saveNamed(event) {
  event.preventDefault();
  const entered = $("new-name").value.trim(), name = entered.endsWith(".toml") ? entered : `${entered}.toml`;
  try {
    await save(name, name === recipe.name ? recipe.version : "");
    $("name-dialog").close();
  } catch (problem) {
    $("name-error").textContent = problem.message;
  }
}

export async function saveHere() {
  if (recipe.name.startsWith("example:")) return saveAs();
  try {
    await save(recipe.name, recipe.version);
  } catch (problem) {
    page.setError({ error: problem.message, line: null });
  }
}

async function copy() {
  const text = await fullText();
  try {
    await navigator.clipboard.writeText(text);
    setStatus("settled", "Copied the recipe as TOML");
  } catch {
    page.tab("toml");
    $("text").focus();
    $("text").select();
    setStatus("settled", "The browser refused the clipboard; the text is selected");
  }
}

export function welcome() {
  const { starts, examples } = app.state;
  $("starts").replaceChildren(...starts.map(({ name, title, about }) => {
    const words = about.length > 76 ? `${about.slice(0, 74).replace(/\s+\S*$/, "")} …` : about;
    const button = el("button", { type: "button" },
      Object.assign(new Image(), { src: `page/start-${title.replaceAll("/", "-")}.jpg`, alt: "" }),
      el("b", { textContent: title.split("/").pop().replaceAll(/[-_]/g, " ") }), el("span", { textContent: words }));
    button.addEventListener("click", () => choose(name));
    return button;
  }));
  $("all-examples").replaceChildren(new Option("choose …", ""), ...examples.map(({ name, title, family }) => new Option(`${title} (${family})`, name)));
}

export function initFiles(pageHooks) {
  page = pageHooks;
  const click = (id, act) => $(id).addEventListener("click", act);
  click("copy", copy);
  click("save", saveHere);
  click("save-as", saveAs);
  click("close-welcome", () => $("welcome").close());
  click("name-cancel", () => $("name-dialog").close());
  $("name-form").addEventListener("submit", saveNamed);
  $("recipes").addEventListener("change", () => choose($("recipes").value));
  $("all-examples").addEventListener("change", ({ target }) => target.value && choose(target.value));
}
