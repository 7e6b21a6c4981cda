// Shared by the modules of the page: state, elements, requests to the server, the status line.

import { Recipe } from "./recipe.js";

export const app = { recipe: new Recipe(), socket: null, view: null, form: null, state: null, lastGood: null, lastName: "", error: null };

export const $ = (id) => document.getElementById(id);
export const el = (tag, props = {}, ...inside) => {
  const made = Object.assign(document.createElement(tag), props);
  made.append(...inside.filter((item) => item !== null && item !== undefined));
  return made;
};
export const shortName = (name) => (name.startsWith("example:") ? `${name.slice(8)} (example)` : name);

// `fetch` with a clear message if there is no server.
export async function request(path, options) {
  try {
    return await fetch(path, options);
  } catch (problem) {
    if (problem.name === "AbortError") throw problem;
    throw new Error("nacre studio does not answer; is it still running?");
  }
}

// Return the server's answer; throw its error message.
export async function ask(path, body, signal) {
  const options = body ? { method: "POST", body: JSON.stringify(body), headers: { "content-type": "application/json" } } : {};
  const answer = await request(path, { ...options, signal });
  if (answer.ok) return answer;
  const { error } = await answer.json().catch(() => ({}));
  throw new Error(error ?? `the server answered ${answer.status}`);
}

export async function api(path, body, signal) {
  return (await ask(path, body, signal)).json();
}

const RESTING_MS = 150;
let written = "", writing = 0;

// Write the status line. Repeated messages during a drag (`isNews` false) are delayed: writing them at once would repaint a
// part of the page for every picture of the object.
export function setStatus(kind, text, isNews = true) {
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

// Return the recipe's text after the server has applied all edits.
export async function fullText() {
  const until = performance.now() + 4000;
  while (app.recipe.edits.length && performance.now() < until) await new Promise((done) => setTimeout(done, 20));
  return app.recipe.text;
}
