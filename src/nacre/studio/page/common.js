// What the modules of the page share: the state of the page, its elements, the server, the line about the answer.

import { Recipe } from "./recipe.js";

export const app = { recipe: new Recipe(), wire: null, view: null, form: null, state: null, lastGood: null, lastName: "", error: null };

export const $ = (id) => document.getElementById(id);
export const el = (tag, props = {}, ...inside) => {
  const made = Object.assign(document.createElement(tag), props);
  made.append(...inside.filter((item) => item !== null && item !== undefined));
  return made;
};
export const shortName = (name) => (name.startsWith("example:") ? `${name.slice(8)} (example)` : name);

// What the server says to a question; without one, in words (browsers say "Failed to fetch", each its own).
export async function reach(path, options) {
  try {
    return await fetch(path, options);
  } catch (problem) {
    if (problem.name === "AbortError") throw problem;
    throw new Error("nacre studio does not answer; is it still running?");
  }
}

// The answer to a question, whole; an error of the server's as an Error with its line of text.
export async function ask(path, body, signal) {
  const options = body ? { method: "POST", body: JSON.stringify(body), headers: { "content-type": "application/json" } } : {};
  const answer = await reach(path, { ...options, signal });
  if (answer.ok) return answer;
  const told = await answer.json().catch(() => ({}));
  throw new Error(told.error ?? `the server answered ${answer.status}`);
}

export async function api(path, body, signal) {
  return (await ask(path, body, signal)).json();
}

const RESTING_MS = 150;
let written = "", writing = 0;

// The line about the answer. What comes again and again while a number is dragged (`isNews` false) is written once it has
// rested: to write it each time would paint a part of the page beside every picture of the object.
export function tell(kind, text, isNews = true) {
  const box = $("state");
  box.dataset.kind = kind;
  clearTimeout(writing);
  const write = () => {
    written = kind;
    if (box.textContent !== text) box.textContent = text;
  };
  if (isNews || (kind !== "solving" && kind !== written)) write();
  else writing = setTimeout(write, RESTING_MS);
}

// Changes that the server has not yet written into the text are written before the text leaves the page.
export async function wholeText() {
  const until = performance.now() + 4000;
  while (app.recipe.edits.length && performance.now() < until) await new Promise((done) => setTimeout(done, 20));
  return app.recipe.text;
}
