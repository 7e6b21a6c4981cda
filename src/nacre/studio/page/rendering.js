// The rendered picture: Mitsuba refines it in passes; an edit restarts it.

import { $, app, shortName, fullText } from "./common.js";
import { listen } from "./event_stream.js";
import { filterName, filterOf } from "./incidence.js";
import { sceneName, sceneOf } from "./objects.js";
import { lightOf } from "./surroundings.js";

const RESTING_MS = 500;
let rendering = null, of = "", timer = 0;     // of: text of the recipe being rendered, or ""
let shown = "";         // last request, if pictures replace the preview

function clearTimer() {
  clearTimeout(timer);
  timer = 0;
}

export async function render() {
  rendering?.abort();
  clearTimer();
  const request = (rendering = new AbortController());
  $("cancel").hidden = false;
  $("render-progress").hidden = false;
  $("render-progress").removeAttribute("value");
  $("render-state").textContent = "Starting; the page stays responsive.";
  try {
    const body = { text: await fullText(), name: app.recipe.name, lamp: $("lamp").value, ...sceneOf($("scene")), size: Number($("size").value), seconds: Number($("seconds").value), ...lightOf(), ...filterOf() };
    if (request !== rendering) return;
    of = body.text;
    shown = key();
    const scene = sceneName($("scene")), what = `${scene}, ${body.light}, ${body.lamp}${filterName(body)}, ${body.size} px`;
    await listen("api/picture", body, request.signal, (event) => {
      if (request !== rendering) return;
      if (event.kind === "waiting") $("render-state").textContent = "Waiting for another picture";
      if (event.kind === "begun") $("render-state").textContent = "Compiling the scene";
      if (event.kind === "progress") {
        $("render-progress").value = event.done / Math.max(event.of, 1);
        $("render-state").dataset.left = `, about ${Math.max(1, Math.round(event.seconds_left))} s left`;
      }
      if (event.kind === "picture") put(event, scene, body, what);
    });
  } catch (problem) {
    if (request === rendering && !request.signal.aborted) $("render-state").textContent = problem.message;
  } finally {
    if (request === rendering) done();
  }
}

function put({ png, spp, is_last: isLast }, scene, body, what) {
  const image = $("picture");
  image.src = png;
  image.dataset.spp = spp;
  image.alt = `${scene} of ${shortName(body.name)} under ${body.lamp}${filterName(body)}, rendered by Mitsuba`;
  image.hidden = false;
  $("render-state").textContent = isLast ? `${what}: ${spp} samples per pixel by Mitsuba 3, denoised. Recipe at the time of the request.` : `${what}: ${spp} samples per pixel so far${$("render-state").dataset.left ?? ""}`;
}

function done() {
  of = "";
  rendering = null;
  delete $("render-state").dataset.left;
  $("cancel").hidden = true;
  $("render-progress").hidden = true;
}

function cancel() {
  clearTimer();
  rendering?.abort();
  done();
  $("render-state").textContent = "Cancelled.";
}

const key = () => [app.recipe.text, $("lamp").value, $("scene").value, $("surround").value, JSON.stringify(filterOf())].join("\n");

// Without a live preview: show the picture instead and render it after each change.
export function replacePreview() {
  for (const id of ["exposure", "front"]) ($(id).closest("label") ?? $(id)).hidden = true;
  $("stage").prepend($("picture"));
  for (const id of ["lamp", "object", "surround", "scene", "filter", "filter-angle"]) $(id).addEventListener("change", restartRendering);
}

// After an edit: cancel the rendering and restart it after a pause.
export function restartRendering() {
  if (timer) clearTimer();
  else if (app.view ? !of || of === app.recipe.text : shown === key()) return;
  rendering?.abort();
  of = "";
  $("render-state").textContent = "The recipe has changed; restarting";
  timer = setTimeout(() => { timer = 0; render(); }, RESTING_MS);
}

export function initRendering() {
  $("render").addEventListener("click", render);
  $("cancel").addEventListener("click", cancel);
}
