// The settled picture: asked for, rendered by Mitsuba while the page stays free.

import { $, app, ask, shortName, wholeText } from "./common.js";
import { meshOf } from "./objects.js";
import { lightOf } from "./surround.js";

let rendering = null;

export async function render() {
  rendering?.abort();
  const mine = (rendering = new AbortController());
  const wanted = { text: await wholeText(), name: app.recipe.name, lamp: $("lamp").value, scene: $("scene").value, size: Number($("size").value), seconds: Number($("seconds").value), ...meshOf(), ...lightOf() };
  $("cancel").hidden = false;
  $("render-state").textContent = "Rendering; the page stays free.";
  try {
    const answer = await ask("api/picture", wanted, mine.signal);
    const image = $("picture"), old = image.src;
    image.src = URL.createObjectURL(await answer.blob());
    image.alt = `${wanted.scene} of ${shortName(wanted.name)} under ${wanted.lamp}, rendered by Mitsuba`;
    image.hidden = false;
    if (old) URL.revokeObjectURL(old);
    $("render-state").textContent = `${wanted.scene}, ${wanted.light}, ${wanted.lamp}, ${wanted.size} px: spectral path tracing by Mitsuba 3, denoised. As the recipe was when asked.`;
  } catch (problem) {
    if (mine === rendering) $("render-state").textContent = mine.signal.aborted ? "Cancelled." : problem.message;
  } finally {
    if (mine === rendering) $("cancel").hidden = true;
  }
}

export function listenSettled() {
  $("render").addEventListener("click", render);
  $("cancel").addEventListener("click", () => rendering?.abort());
}
