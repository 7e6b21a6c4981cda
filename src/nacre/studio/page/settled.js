// The settled picture: asked for, rendered by Mitsuba pass by pass while the page stays free; a new edit begins it anew.

import { $, app, shortName, wholeText } from "./common.js";
import { listen } from "./lines.js";
import { sceneName, sceneOf } from "./objects.js";
import { lightOf } from "./surround.js";

const RESTING_MS = 500;
let rendering = null, of = "", timer = 0;     // of: the text that is being rendered; "" where nothing is
let shown = "";         // what was asked for last, where pictures are all that is shown of the object

function forgetTimer() {
  clearTimeout(timer);
  timer = 0;
}

export async function render() {
  rendering?.abort();
  forgetTimer();
  const mine = (rendering = new AbortController());
  $("cancel").hidden = false;
  $("render-progress").hidden = false;
  $("render-progress").removeAttribute("value");
  $("render-state").textContent = "Beginning; the page stays free.";
  try {
    const wanted = { text: await wholeText(), name: app.recipe.name, lamp: $("lamp").value, ...sceneOf($("scene")), size: Number($("size").value), seconds: Number($("seconds").value), ...lightOf() };
    if (mine !== rendering) return;
    of = wanted.text;
    shown = key();
    const scene = sceneName($("scene")), what = `${scene}, ${wanted.light}, ${wanted.lamp}, ${wanted.size} px`;
    await listen("api/picture", wanted, mine.signal, (event) => {
      if (mine !== rendering) return;
      if (event.kind === "waiting") $("render-state").textContent = "Waiting for another picture";
      if (event.kind === "begun") $("render-state").textContent = "Compiling the scene";
      if (event.kind === "progress") {
        $("render-progress").value = event.done / Math.max(event.of, 1);
        $("render-state").dataset.left = `, about ${Math.max(1, Math.round(event.seconds_left))} s left`;
      }
      if (event.kind === "picture") put(event, scene, wanted, what);
    });
  } catch (problem) {
    if (mine === rendering && !mine.signal.aborted) $("render-state").textContent = problem.message;
  } finally {
    if (mine === rendering) done();
  }
}

function put({ png, spp, is_last: isLast }, scene, wanted, what) {
  const image = $("picture");
  image.src = png;
  image.dataset.spp = spp;
  image.alt = `${scene} of ${shortName(wanted.name)} under ${wanted.lamp}, rendered by Mitsuba`;
  image.hidden = false;
  $("render-state").textContent = isLast ? `${what}: ${spp} samples a pixel by Mitsuba 3, denoised. As the recipe was when asked.` : `${what}: ${spp} samples a pixel so far${$("render-state").dataset.left ?? ""}`;
}

function done() {
  of = "";
  rendering = null;
  delete $("render-state").dataset.left;
  $("cancel").hidden = true;
  $("render-progress").hidden = true;
}

function cancel() {
  forgetTimer();
  rendering?.abort();
  done();
  $("render-state").textContent = "Cancelled.";
}

const key = () => [app.recipe.text, $("lamp").value, $("scene").value, $("surround").value].join("\n");

// Without a live preview the picture stands in its place, and each change asks for a new one.
export function standIn() {
  for (const id of ["exposure", "front"]) ($(id).closest("label") ?? $(id)).hidden = true;
  $("stage").prepend($("picture"));
  for (const id of ["lamp", "object", "surround", "scene"]) $(id).addEventListener("change", settledEdited);
}

// The recipe is another one now: what is being rendered is given up at once, and begun anew when the edits rest.
export function settledEdited() {
  if (timer) forgetTimer();
  else if (app.view ? !of || of === app.recipe.text : shown === key()) return;
  rendering?.abort();
  of = "";
  $("render-state").textContent = "The recipe was changed; beginning anew";
  timer = setTimeout(() => { timer = 0; render(); }, RESTING_MS);
}

export function listenSettled() {
  $("render").addEventListener("click", render);
  $("cancel").addEventListener("click", cancel);
}
