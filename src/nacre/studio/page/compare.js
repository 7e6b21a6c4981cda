// Two looks beside each other, and the steps of the recipe as pictures to go back to.

import { $, app, el, shortName, tell, wholeText } from "./common.js";

const { recipe } = app;
const THUMBNAIL = 56, RESTING_MS = 600;         // to read a picture back takes as long as to draw two: not while a number is dragged
let kept = null, page = null, timer = 0;    // page: what main.js does: chart(), go(by), showRecipe(), listRecipes()
let placed = "";        // which step the strip was scrolled to; asking where it lies lays the whole page out
const pictures = new Map(), colours = new Map();     // of recipes, by their text: a small picture; before there is one, a colour

// ---- A and B

export const other = () => kept?.look ?? null;

// What the server is told of B: its colours, to which it adds how far A's are from them.
export const beside = () => (kept ? { beside: kept.look.swatches.map(({ lab }) => lab) } : {});

export const keptRecipe = () => (kept ? [{ text: kept.text, name: kept.name }] : []);

// Under another lamp B's colours are solved anew: its question goes before the one of the recipe that is edited.
let asked = null;       // the question of B that is not answered yet

export const isStale = () => Boolean(kept) && ![kept.lamp, kept.failed].includes($("lamp").value);

export function question(seq, own) {
  if (!isStale() || recipe.edits.length) return own(seq);
  asked = { seq, lamp: $("lamp").value };
  return { name: kept.name, text: kept.text, edits: [], lamp: asked.lamp };
}

// Whether an answer is B's; the recipe's own question follows.
export function takes(answer) {
  if (asked?.seq !== answer.seq) return false;
  const { lamp } = asked;
  if (answer.draft) return true;
  asked = null;
  if (kept && answer.error) kept.failed = lamp;
  else if (kept) {
    Object.assign(kept, { look: answer, lamp });
    if (app.view) app.view.setOther(answer);
  }
  show();
  app.wire.ask();
  return true;
}

async function keep() {
  const text = await wholeText(), look = app.lastGood;
  if (!look) return;
  const { name, mark, saved } = recipe;
  kept = { name, text, mark, saved, look, lamp: $("lamp").value };
  put($("keep-b").textContent === "Keep as B" ? "both" : side());
  tell("settled", `Kept as B: ${shortName(name)}`);
}

function drop() {
  kept = null;
  put("a");
  $("keep-b").focus();
}

// B becomes the recipe that is edited, and what was edited becomes B.
async function swap() {
  const { name, text, mark, saved } = kept;
  await keep();
  if (name !== recipe.name) recipe.open({ name, text: saved, mark });
  recipe.type(text);
  recipe.said = "Swapped with B";
  page.listRecipes();
  $("text").value = recipe.text;
  app.wire.ask();
  await page.showRecipe();
}

const side = () => document.querySelector('input[name="side"]:checked').value;

function put(wanted) {
  document.querySelector(`input[name="side"][value="${wanted}"]`).checked = true;
  $("keep-b").textContent = kept ? "Replace B" : "Keep as B";
  $("keep-b").title = kept ? `B is ${shortName(kept.name)}` : "Keep this look, to compare others with it";
  $("two").hidden = !kept;
  if (app.view) app.view.setOther(other());
  show();
  page.chart();
  app.wire.ask();
}

function show() {
  const wanted = side(), at = Number($("split").value);
  $("split").disabled = wanted !== "both";
  $("side-a").hidden = !kept || wanted === "b";
  $("side-b").hidden = !kept || wanted === "a";
  // until it is solved anew its colours are those of the lamp that it was kept under
  $("side-b").textContent = kept && kept.lamp !== $("lamp").value ? `B, kept under ${kept.lamp}` : "B";
  $("cut").hidden = !kept || wanted !== "both";
  $("cut").style.left = `${at}%`;
  if (app.view) app.view.show(wanted, at / 100);
}

// ---- the steps

export function showHistory() {
  const strip = $("history"), { past, at } = recipe, look = app.lastGood;
  if (look && past[at]?.text === look.text) colours.set(look.text, look.swatches[0].hex[0]);
  if (strip.childElementCount !== past.length || strip.dataset.of !== recipe.name) strip.replaceChildren(...past.map((_, i) => button(i)));
  strip.dataset.of = recipe.name;       // a button keeps its picture while it is dragged, but for no other recipe
  [...strip.children].forEach((made, i) => {
    const { text, what } = past[i], picture = pictures.get(text), image = made.firstChild;
    const name = `Step ${i + 1} of ${past.length}: ${what}`;
    if (made.title !== name) { made.title = name; made.setAttribute("aria-label", name); }
    if (picture && image.src !== picture) image.src = picture;
    // the step that is being dragged keeps its picture until it rests: each repainted button delays the object
    const isKept = i === at && image.src && !image.hidden;
    image.hidden = !picture && !isKept;
    made.lastChild.hidden = !image.hidden;
    if (image.hidden && colours.has(text)) made.style.background = colours.get(text);
    made.tabIndex = i === at ? 0 : -1;      // one stop for Tab; arrow keys go along
    if (i === at) made.setAttribute("aria-current", "step");
    else made.removeAttribute("aria-current");
  });
  strip.hidden = !past.length;
  const here = strip.children[at], where = `${at} of ${past.length}`;
  if (here && where !== placed) strip.scrollLeft = here.offsetLeft - strip.offsetLeft - strip.clientWidth / 2;
  placed = where;
  clearTimeout(timer);
  timer = setTimeout(take, RESTING_MS);
}

function button(i) {
  const made = el("button", { type: "button" }, Object.assign(new Image(THUMBNAIL, THUMBNAIL), { alt: "", hidden: true }), el("span", { textContent: i + 1 }));
  made.addEventListener("click", () => page.go(i - recipe.at));
  return made;
}

// The picture of the step that is shown, once it has settled and nothing has changed for a moment.
function take() {
  const now = recipe.past[recipe.at], rested = performance.now() - app.wire.asked;
  if (rested < RESTING_MS || (app.view && !$("view").dataset.seq)) {     // or the room has not come yet
    timer = setTimeout(take, Math.max(RESTING_MS - rested, RESTING_MS / 4));
    return;
  }
  if (!app.view || !now || recipe.edits.length || app.lastGood?.draft || app.lastGood?.text !== now.text) return;
  pictures.set(now.text, app.view.thumbnail(THUMBNAIL));
  const texts = new Set(recipe.past.map(({ text }) => text));
  for (const known of [pictures, colours]) for (const text of known.keys()) if (!texts.has(text)) known.delete(text);
  const image = $("history").children[recipe.at]?.firstChild;
  if (!image) return;
  image.src = pictures.get(now.text);
  image.hidden = false;
  image.nextSibling.hidden = true;
}

export function listenCompare(given) {
  page = given;
  const click = (id, act) => $(id).addEventListener("click", act);
  click("keep-b", keep);
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
    if (event.key.toLowerCase() !== "b" || event.ctrlKey || event.metaKey || event.altKey || !kept) return;
    event.preventDefault();
    document.querySelector(`input[name="side"][value="${side() === "b" ? "a" : "b"}"]`).checked = true;
    show();
  });
}
