// Comparison of two appearances, and the history of the recipe as pictures.

import { $, app, el, shortName, setStatus, fullText } from "./common.js";

const { recipe } = app;
const THUMBNAIL = 56, RESTING_MS = 600;         // reading a picture back takes as long as drawing two, therefore only after a pause
let stored = null, page = null, timer = 0;    // page: functions of main.js, { chart, go, showRecipe, listRecipes }
let scrolledTo = "";        // step that the strip was scrolled to; reading its position forces a layout
const pictures = new Map(), colours = new Map();     // thumbnail of a recipe by its text, or a colour until there is one

// ---- A and B

export const other = () => stored?.appearance ?? null;

// Lab colours of B in a request; the server answers their difference from A.
export const comparedLab = () => (stored ? { compared_lab: stored.appearance.swatches.map(({ lab }) => lab) } : {});

export const storedRecipe = () => (stored ? [{ text: stored.text, name: stored.name }] : []);

// Another lamp needs new colours of B: its request precedes that of the edited recipe.
let pending = null;       // request of B without an answer

export const isStale = () => Boolean(stored) && ![stored.lamp, stored.failed].includes($("lamp").value);

export function question(seq, own) {
  if (!isStale() || recipe.edits.length) return own(seq);
  pending = { seq, lamp: $("lamp").value };
  return { name: stored.name, text: stored.text, edits: [], lamp: pending.lamp, ...stored.appearance.incidence };
}

// Handle an answer for B; the request of the recipe follows. Return whether it was one.
export function handlesAnswer(answer) {
  if (pending?.seq !== answer.seq) return false;
  const { lamp } = pending;
  if (answer.draft) return true;
  pending = null;
  if (stored && answer.error) stored.failed = lamp;
  else if (stored) {
    Object.assign(stored, { appearance: answer, lamp });
    if (app.view) app.view.setOther(answer);
  }
  show();
  app.socket.ask();
  return true;
}

async function store() {
  const text = await fullText(), appearance = app.lastGood;
  if (!appearance) return;
  const { name, version, saved } = recipe;
  stored = { name, text, version, saved, appearance, lamp: $("lamp").value };
  put($("keep-b").textContent === "Store as B" ? "both" : side());
  setStatus("settled", `Stored as B: ${shortName(name)}`);
}

function drop() {
  stored = null;
  put("a");
  $("keep-b").focus();
}

// Edit B; the current recipe becomes B.
async function swap() {
  const { name, text, version, saved } = stored;
  await store();
  if (name !== recipe.name) recipe.open({ name, text: saved, version });
  recipe.type(text);
  recipe.action = "Swapped with B";
  page.listRecipes();
  $("text").value = recipe.text;
  app.socket.ask();
  await page.showRecipe();
}

const side = () => document.querySelector('input[name="side"]:checked').value;

function put(chosenSide) {
  document.querySelector(`input[name="side"][value="${chosenSide}"]`).checked = true;
  $("keep-b").textContent = stored ? "Replace B" : "Store as B";
  $("keep-b").title = stored ? `B is ${shortName(stored.name)}` : "Store this appearance to compare others with it";
  $("two").hidden = !stored;
  if (app.view) app.view.setOther(other());
  show();
  page.chart();
  app.socket.ask();
}

function show() {
  const chosenSide = side(), at = Number($("split").value);
  $("split").disabled = chosenSide !== "both";
  $("side-a").hidden = !stored || chosenSide === "b";
  $("side-b").hidden = !stored || chosenSide === "a";
  // B keeps the colours of its lamp until there are new ones
  $("side-b").textContent = stored && stored.lamp !== $("lamp").value ? `B under ${stored.lamp}` : "B";
  $("cut").hidden = !stored || chosenSide !== "both";
  $("cut").style.left = `${at}%`;
  if (app.view) app.view.show(chosenSide, at / 100);
}

// ---- the steps

export function showHistory() {
  const strip = $("history"), { past, at } = recipe, appearance = app.lastGood;
  if (appearance && past[at]?.text === appearance.text) colours.set(appearance.text, appearance.swatches[0].hex[0]);
  if (strip.childElementCount !== past.length || strip.dataset.of !== recipe.name) strip.replaceChildren(...past.map((_, i) => button(i)));
  strip.dataset.of = recipe.name;
  [...strip.children].forEach((made, i) => {
    const { text, action } = past[i], picture = pictures.get(text), image = made.firstChild;
    const name = `Step ${i + 1} of ${past.length}: ${action}`;
    if (made.title !== name) { made.title = name; made.setAttribute("aria-label", name); }
    if (picture && image.src !== picture) image.src = picture;
    // during a drag the step keeps its picture: each repainted button delays the object
    const isUnchanged = i === at && image.src && !image.hidden;
    image.hidden = !picture && !isUnchanged;
    made.lastChild.hidden = !image.hidden;
    if (image.hidden && colours.has(text)) made.style.background = colours.get(text);
    made.tabIndex = i === at ? 0 : -1;      // a single tab stop; arrow keys move along the strip
    if (i === at) made.setAttribute("aria-current", "step");
    else made.removeAttribute("aria-current");
  });
  strip.hidden = !past.length;
  const here = strip.children[at], where = `${at} of ${past.length}`;
  if (here && where !== scrolledTo) strip.scrollLeft = here.offsetLeft - strip.offsetLeft - strip.clientWidth / 2;
  scrolledTo = where;
  clearTimeout(timer);
  timer = setTimeout(take, RESTING_MS);
}

function button(i) {
  const made = el("button", { type: "button" }, Object.assign(new Image(THUMBNAIL, THUMBNAIL), { alt: "", hidden: true }), el("span", { textContent: i + 1 }));
  made.addEventListener("click", () => page.go(i - recipe.at));
  return made;
}

// Store the thumbnail of the current step after a pause.
function take() {
  const now = recipe.past[recipe.at], rested = performance.now() - app.socket.asked;
  if (rested < RESTING_MS || (app.view && !$("view").dataset.seq)) {
    timer = setTimeout(take, Math.max(RESTING_MS - rested, RESTING_MS / 4));
    return;
  }
  if (!app.view || !now || recipe.edits.length || app.lastGood?.draft || app.lastGood?.text !== now.text) return;
  pictures.set(now.text, app.view.thumbnail(THUMBNAIL));
  const texts = new Set(recipe.past.map(({ text }) => text));
  for (const cache of [pictures, colours]) for (const text of cache.keys()) if (!texts.has(text)) cache.delete(text);
  const image = $("history").children[recipe.at]?.firstChild;
  if (!image) return;
  image.src = pictures.get(now.text);
  image.hidden = false;
  image.nextSibling.hidden = true;
}

export function initCompare(pageHooks) {
  page = pageHooks;
  const click = (id, act) => $(id).addEventListener("click", act);
  click("keep-b", store);
  click("swap-b", swap);
  click("drop-b", drop);
  for (const box of document.querySelectorAll('input[name="side"]')) box.addEventListener("change", show);
  $("split").addEventListener("input", show);
  $("history").addEventListener("keydown", (event) => {
    const by = { ArrowLeft: -1, ArrowRight: 1 }[event.key], to = [...$("history").children].indexOf(event.target) + by;
    if (!by || !$("history").children[to]) return;
    event.preventDefault();
    $("history").children[to].focus();
  });
  $("lamp").addEventListener("change", show);
  $("view").addEventListener("keydown", (event) => {
    if (event.key.toLowerCase() !== "b" || event.ctrlKey || event.metaKey || event.altKey || !stored) return;
    event.preventDefault();
    document.querySelector(`input[name="side"][value="${side() === "b" ? "a" : "b"}"]`).checked = true;
    show();
  });
}
