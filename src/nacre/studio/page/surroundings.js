// The surroundings of the object: the studio, or a place visible behind it.

import { $, app, ask } from "./common.js";
import { unpack } from "./unpack.js";

const cached = new Map();
let chosen = "studio";
const SKIES = { sun: " The preview has no sharp shadow of the sun.", sky: "" };

// Light of a rendered picture: that of the page.
export const lightOf = () => ({ light: chosen });

// Light of a downloaded picture: that of its scene, or of the place.
export const placeOf = () => (chosen === "studio" ? {} : { light: chosen });

export async function fetchRoom(name) {
  if (!cached.has(name)) cached.set(name, ask(`api/surroundings?name=${name}`).then((answer) => answer.arrayBuffer()).then(unpack));
  try {
    return await cached.get(name);
  } catch (problem) {
    cached.delete(name);
    throw problem;
  }
}

async function choose() {
  const name = (chosen = $("surround").value);
  try {
    if (name in SKIES && !cached.has(name)) $("surround-note").textContent = "Mitsuba computes this sky once; this takes some seconds.";
    const { room, lamp } = await fetchRoom(name), { surroundings: sizes } = app.state;
    if (chosen !== name || !app.view) return;
    app.view.setRoom(room, sizes, sizes.places[name], lamp);
    $("view").dataset.surround = name;
    $("surround-note").textContent = sizes.places[name] ? `This place has its own light, independent of the lamp above; the preview multiplies colours, the rendered picture is spectral.${SKIES[name] ?? ""}` : "";
  } catch (problem) {
    $("surround-note").textContent = problem.message;
  }
}

export function initSurroundings() {
  $("surround").addEventListener("change", choose);
}
