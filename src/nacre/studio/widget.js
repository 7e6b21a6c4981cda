// The object in a notebook cell; messages come from the kernel.

import { drawRibbon, drawSpectrum } from "./page/charts.js";
import { unpack } from "./page/unpack.js";
import { View } from "./page/view.js";

const MESSAGE_MS = 40;         // between two messages during a drag
const OWN_KEYS = { "data-lm-suppress-shortcuts": "true" };  // otherwise JupyterLab handles the arrow keys
// VS Code would move to another cell on these keys.
const MOVES = new Set(["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "Home", "End", "PageUp", "PageDown"]);
const LABEL = "Sphere of the material in the studio's light; arrow keys turn the view";

function make(root, tag, props = {}, space = "http://www.w3.org/1999/xhtml") {
  const made = document.createElementNS(space, tag);
  for (const [name, value] of Object.entries(props)) name === "textContent" ? (made.textContent = value) : made.setAttribute(name, value);
  root.append(made);
  return made;
}

// Send the latest value of each number at a limited rate.
function sender(model) {
  const waiting = new Map();
  let timer = null;
  const send = () => {
    timer = null;
    if (!waiting.size) return;
    for (const [path, value] of waiting) model.send({ kind: "vary", path, value });
    waiting.clear();
    timer = setTimeout(send, MESSAGE_MS);
  };
  return (path, value) => {
    waiting.set(path, value);
    if (timer === null) send();
  };
}

const written = (value) => String(Number(value.toPrecision(4)));

function fillSliders(root, appearance, vary) {
  if (root.dataset.shown !== String(appearance.shown)) {
    root.replaceChildren();
    root.dataset.shown = appearance.shown;
    for (const { path, max } of appearance.numbers) {
      const label = make(root, "label"), range = { ...OWN_KEYS, type: "range", min: max / 200, max, step: max / 200, "data-path": path, "aria-label": path };
      make(label, "span", { textContent: path });
      const slider = make(label, "input", range), output = make(label, "output");
      slider.addEventListener("input", () => {
        output.textContent = written(Number(slider.value));
        vary(path, Number(slider.value));
      });
    }
  }
  const held = root.getRootNode().activeElement;
  appearance.numbers.forEach(({ value }, i) => {
    const [, slider, output] = root.children[i].children;
    if (slider === held) return;        // its value is newer than the answer
    slider.value = value;
    output.textContent = written(value);
  });
}

export function render({ model, el }) {
  const root = make(el, "div", { class: "nacre-studio" }), stage = make(root, "div", { class: "stage" });
  const canvas = make(stage, "canvas", { ...OWN_KEYS, class: "view", tabindex: "0", role: "img", "aria-label": LABEL });
  const picture = make(stage, "img", { alt: "", hidden: "" });       // replaces the sphere while its context is released
  const side = make(root, "div", { class: "side" });
  const state = make(side, "p", { class: "state", role: "status", textContent: "Solving" });
  const ribbon = make(side, "canvas", { class: "ribbon", width: "182", height: "1", role: "img", "aria-label": "Colour over angle, 0 to 90 degrees" });
  const colours = make(side, "p", { class: "quiet" });
  const chart = make(side, "div", { class: "chart" });
  make(chart, "canvas", { "aria-hidden": "true" });
  const spectrum = make(chart, "svg", { viewBox: "0 0 280 150", role: "img", "aria-label": "Reflectance over wavelength" }, "http://www.w3.org/2000/svg");
  const sliders = make(side, "div", { class: "sliders" }), notes = make(side, "p", { class: "quiet" });
  const vary = sender(model);
  root.addEventListener("keydown", (event) => {
    if (MOVES.has(event.key) && !event.ctrlKey && !event.metaKey && !event.altKey) event.stopPropagation();
  });
  let view = null, appearance = null, room = null, card = null, isNear = false;      // card: the WEBGL_lose_context extension

  // A browser has 16 WebGL contexts and blanks the oldest when another is created: only views near the screen have one, the others
  // show a picture.
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
    canvas.addEventListener("webglcontextrestored", () => { picture.hidden = true; });
    view.setRoom(new Float32Array(room.buffer), room, null);
    if (appearance) view.setAppearance(appearance);
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
    appearance = made;
    state.textContent = `${appearance.name}: ${appearance.draft ? "draft" : "solved"}`;
    root.dataset.state = appearance.draft ? "draft" : "settled";
    root.dataset.seq = appearance.seq;
    drawRibbon(ribbon, colours, appearance);
    drawSpectrum(spectrum, appearance);
    notes.textContent = appearance.notes.join(" ");
    fillSliders(sliders, appearance, vary);
    view?.setAppearance(appearance);
  }

  function receive(content, buffers) {
    // floats must be aligned to four bytes, which buffers of a host need not be; hosts pass a view or a buffer
    const [buffer] = (buffers ?? []).map((given) => ArrayBuffer.isView(given)
      ? given.buffer.slice(given.byteOffset, given.byteOffset + given.byteLength) : given);
    if (content.kind === "room") {
      room ??= { ...content, buffer };
      wake();
    }
    else if (content.kind === "appearance") show(unpack(buffer));
    else if (content.kind === "error") {
      state.textContent = content.message;
      root.dataset.state = "error";
    }
  }

  model.on("msg:custom", receive);
  model.send({ kind: "ready" });
  return () => {
    model.off("msg:custom", receive);
    watch.disconnect();
    card?.loseContext();
  };
}
