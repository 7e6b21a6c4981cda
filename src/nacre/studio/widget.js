// The object in a cell of a notebook: messages come from the kernel, there is no server.

import { drawRibbon, drawSpectrum } from "./page/charts.js";
import { unpack } from "./page/unpack.js";
import { View } from "./page/view.js";

const PATIENCE_MS = 40;         // between two messages of a slider that is dragged
const OWN_KEYS = { "data-lm-suppress-shortcuts": "true" };  // JupyterLab takes the arrow keys from what has the focus, unless it says so
// VS Code hears of every key that leaves the output, and moves to another cell.
const MOVES = new Set(["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "Home", "End", "PageUp", "PageDown"]);
const LABEL = "Sphere of the material in the studio's light; arrow keys turn the view";

function make(root, tag, props = {}, space = "http://www.w3.org/1999/xhtml") {
  const made = document.createElementNS(space, tag);
  for (const [name, value] of Object.entries(props)) name === "textContent" ? (made.textContent = value) : made.setAttribute(name, value);
  root.append(made);
  return made;
}

// Each number's latest value is sent, at most once in a while.
function sender(model) {
  const waiting = new Map();
  let timer = null;
  const send = () => {
    timer = null;
    if (!waiting.size) return;
    for (const [path, value] of waiting) model.send({ kind: "vary", path, value });
    waiting.clear();
    timer = setTimeout(send, PATIENCE_MS);
  };
  return (path, value) => {
    waiting.set(path, value);
    if (timer === null) send();
  };
}

const written = (value) => String(Number(value.toPrecision(4)));

function fillSliders(root, look, vary) {
  if (root.dataset.given !== String(look.given)) {
    root.replaceChildren();
    root.dataset.given = look.given;
    for (const { path, most } of look.numbers) {
      const label = make(root, "label"), range = { ...OWN_KEYS, type: "range", min: most / 200, max: most, step: most / 200, "data-path": path, "aria-label": path };
      make(label, "span", { textContent: path });
      const slider = make(label, "input", range), told = make(label, "output");
      slider.addEventListener("input", () => {
        told.textContent = written(Number(slider.value));
        vary(path, Number(slider.value));
      });
    }
  }
  const held = root.getRootNode().activeElement;
  look.numbers.forEach(({ value }, i) => {
    const [, slider, told] = root.children[i].children;
    if (slider === held) return;        // its own value is newer than the answer
    slider.value = value;
    told.textContent = written(value);
  });
}

export function render({ model, el }) {
  const root = make(el, "div", { class: "nacre-studio" }), stage = make(root, "div", { class: "stage" });
  const canvas = make(stage, "canvas", { ...OWN_KEYS, class: "view", tabindex: "0", role: "img", "aria-label": LABEL });
  const picture = make(stage, "img", { alt: "", hidden: "" });       // of the sphere while it sleeps
  const side = make(root, "div", { class: "side" });
  const state = make(side, "p", { class: "state", role: "status", textContent: "Solving" });
  const ribbon = make(side, "canvas", { class: "ribbon", width: "182", height: "1", role: "img", "aria-label": "Colour over angle, 0 to 90 degrees" });
  const colours = make(side, "p", { class: "quiet" });
  const chart = make(side, "div", { class: "chart" });
  make(chart, "canvas", { "aria-hidden": "true" });     // of its curves
  const spectrum = make(chart, "svg", { viewBox: "0 0 280 150", role: "img", "aria-label": "Reflectance over wavelength" }, "http://www.w3.org/2000/svg");
  const sliders = make(side, "div", { class: "sliders" }), notes = make(side, "p", { class: "quiet" });
  const vary = sender(model);
  root.addEventListener("keydown", (event) => {
    if (MOVES.has(event.key) && !event.ctrlKey && !event.metaKey && !event.altKey) event.stopPropagation();
  });
  let view = null, look = null, room = null, card = null, isNear = false;      // card: what takes the context away, and gives it back

  // A browser has 16 contexts of WebGL and blanks the oldest when one more is made: a notebook of many materials holds those that
  // are on the screen, or nearly, and pictures of the others.
  function wake() {
    if (!isNear || !room || canvas.hidden) return;
    if (view) { if (view.gl.isContextLost()) card?.restoreContext(); return; }
    try {
      view = new View(canvas, null, room.tables);
    } catch {
      canvas.hidden = true;
      make(root, "p", { class: "quiet", textContent: "This browser has no WebGL2: the sphere is not drawn." });
      return;
    }
    card = view.gl.getExtension("WEBGL_lose_context");
    canvas.addEventListener("webglcontextrestored", () => { picture.hidden = true; });        // the view has drawn itself anew
    view.setRoom(new Float32Array(room.buffer), room, null);
    if (look) view.setLook(look);
  }

  function sleep() {
    if (!view || !card || view.gl.isContextLost()) return;
    picture.src = canvas.toDataURL("image/jpeg", 0.9);
    picture.hidden = false;
    card.loseContext();
  }

  const watch = new IntersectionObserver((seen) => {
    isNear = seen.at(-1).isIntersecting;
    if (isNear) wake();
    else sleep();
  }, { rootMargin: "50%" });
  watch.observe(stage);

  function show(made) {
    look = made;
    state.textContent = `${look.name}: ${look.draft ? "draft, settling" : "settled"}`;
    root.dataset.state = look.draft ? "draft" : "settled";
    root.dataset.seq = look.seq;
    drawRibbon(ribbon, colours, look);
    drawSpectrum(spectrum, look);
    notes.textContent = look.notes.join(" ");
    fillSliders(sliders, look, vary);
    view?.setLook(look);
  }

  function hear(content, buffers) {
    // floats must begin at a multiple of four bytes, which a buffer of several messages does not promise; hosts give a view or all of it
    const [buffer] = (buffers ?? []).map((given) => ArrayBuffer.isView(given)
      ? given.buffer.slice(given.byteOffset, given.byteOffset + given.byteLength) : given);
    if (content.kind === "room") {
      room ??= { ...content, buffer };  // another view of this material may have asked as well
      wake();
    }
    else if (content.kind === "look") show(unpack(buffer));
    else if (content.kind === "error") {
      state.textContent = content.message;
      root.dataset.state = "error";
    }
  }

  model.on("msg:custom", hear);
  model.send({ kind: "ready" });
  return () => {
    model.off("msg:custom", hear);
    watch.disconnect();
    card?.loseContext();
  };
}
