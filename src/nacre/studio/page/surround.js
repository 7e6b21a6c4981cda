// The surroundings of the object: the studio, or a place that is seen behind it.

import { $, app, ask } from "./common.js";
import { unpack } from "./unpack.js";

const kept = new Map();
let wanted = "studio";
const SKIES = { sun: " The preview draws no sharp shadow of the sun.", sky: "" };

// What pictures are asked in: the same light as on the page.
export const lightOf = () => ({ light: wanted });

// Pictures to take away have the light that belongs to their scene, but in a place that place's.
export const placeOf = () => (wanted === "studio" ? {} : { light: wanted });

export async function fetchRoom(name) {
  if (!kept.has(name)) kept.set(name, ask(`api/surround?name=${name}`).then((answer) => answer.arrayBuffer()).then(unpack));
  try {
    return await kept.get(name);
  } catch (problem) {
    kept.delete(name);
    throw problem;
  }
}

async function choose() {
  const name = (wanted = $("surround").value);
  try {
    if (name in SKIES && !kept.has(name)) $("surround-note").textContent = "Asking Mitsuba for this sky; that takes some seconds, once.";
    const { room, lamp } = await fetchRoom(name), { surround } = app.state;
    if (wanted !== name || !app.view) return;
    app.view.setRoom(room, surround, surround.places[name], lamp);
    $("view").dataset.surround = name;
    $("surround-note").textContent = surround.places[name] ? `This place has light of its own colours, which the lamp above does not change; the preview multiplies by them, the settled picture is spectral.${SKIES[name] ?? ""}` : "";
  } catch (problem) {
    $("surround-note").textContent = problem.message;
  }
}

export function listenSurround() {
  $("surround").addEventListener("change", choose);
}
