// What the numbers say of the newest answer, and the recipe as it became. To paint that takes as long as to paint the object: it
// waits until the object is on the screen and nothing more is asked, so that no picture of the object waits for it.

import { drawRibbon, drawSpectrum, drawSwatches, drawTrack } from "./charts.js";
import { cloudReach, drawCloud } from "./cloud.js";
import { $, app, el } from "./common.js";
import { other } from "./compare.js";
import { drawStructure } from "./drawing.js";

const AFTER_MS = 20;                            // from the object to the panels
const SHORTEST_MS = 300, LONGEST_MS = 500;      // between two paintings while a number is dragged: with pauses, without
let timer = 0, drawn = -LONGEST_MS, waiting = null, noted = "";         // noted: what the notes say

// An answer has come; `also` is done with the next painting, in place of one that waits for it.
export function panels(also) {
  waiting = also ?? waiting;
  clearTimeout(timer);
  timer = setTimeout(look, Math.max(AFTER_MS, drawn + SHORTEST_MS - performance.now()));
}

function look() {
  const isAsked = app.wire.heard < app.wire.seq;
  if (isAsked && performance.now() < drawn + LONGEST_MS) timer = setTimeout(look, AFTER_MS);
  else drawPanels();
}

// All of them, now.
export function drawPanels() {
  clearTimeout(timer);
  drawn = performance.now();
  const also = waiting;
  waiting = null;
  also?.();
  const look = app.lastGood, kept = other();
  if (!look) return;
  showNotes(look.notes);
  drawRibbon($("ribbon"), $("ribbon-text"), look);
  $("ribbons").classList.toggle("two", Boolean(kept));
  if (kept) drawRibbon($("ribbon-b"), $("ribbon-b-text"), kept);
  drawSpectrum($("spectrum"), look, kept);
  drawCloud($("cloud-ribbon"), $("track"), drawTrack($("track"), look, kept, cloudReach()));
  drawSwatches($("swatches"), look, kept);
  const words = drawStructure($("structure"), look.data, look.profile);
  $("structure-text").textContent = words;
  $("structure-box").hidden = !words;
}

function showNotes(notes) {
  const said = notes.join("\n");
  if (said !== noted) $("notes").replaceChildren(...notes.map((note) => el("li", { textContent: note })));
  noted = said;
}
