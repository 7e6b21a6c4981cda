// Charts and form of the newest answer. Painting them takes as long as painting the object, therefore they wait until the
// object is on the screen and no request is pending.

import { drawEllipsometry, drawRibbon, drawSpectrum, drawSwatches, drawTrack } from "./charts.js";
import { scatterExtent, drawScatter } from "./tolerance.js";
import { $, app, el } from "./common.js";
import { other } from "./compare.js";
import { drawStructure } from "./drawing.js";
import { showIncidence } from "./incidence.js";

const AFTER_MS = 20;                            // delay after the object
const SHORTEST_MS = 300, LONGEST_MS = 500;      // between two updates during a drag, with and without pauses
let timer = 0, drawn = -LONGEST_MS, waiting = null, shownNotes = "";         // shownNotes: text of the notes

// Schedule an update after an answer; `also` runs with it and replaces a waiting one.
export function panels(also) {
  waiting = also ?? waiting;
  clearTimeout(timer);
  timer = setTimeout(drawWhenIdle, Math.max(AFTER_MS, drawn + SHORTEST_MS - performance.now()));
}

function drawWhenIdle() {
  const isPending = app.socket.heard < app.socket.seq;
  if (isPending && performance.now() < drawn + LONGEST_MS) timer = setTimeout(drawWhenIdle, AFTER_MS);
  else drawPanels();
}

// Update all panels now.
export function drawPanels() {
  clearTimeout(timer);
  drawn = performance.now();
  const also = waiting;
  waiting = null;
  also?.();
  const appearance = app.lastGood, compared = other();
  if (!appearance) return;
  showNotes(appearance.notes);
  showIncidence(appearance);
  drawRibbon($("ribbon"), $("ribbon-text"), appearance);
  $("ribbons").classList.toggle("two", Boolean(compared));
  if (compared) drawRibbon($("ribbon-b"), $("ribbon-b-text"), compared);
  drawSpectrum($("spectrum"), appearance, compared, app.measured);
  const beside = app.ellipsometry ?? [];
  $("ellipsometry-box").hidden = !beside.length;
  if (beside.length) {
    drawEllipsometry($("ellipsometry"), beside, appearance.psi_delta);
    $("ellipsometry-text").textContent = appearance.psi_delta?.note ?? "Measured dotted, computed as lines.";
  }
  drawScatter($("tolerance-ribbon"), $("track"), drawTrack($("track"), appearance, compared, scatterExtent()));
  drawSwatches($("swatches"), appearance, compared);
  const words = drawStructure($("structure"), appearance.data, appearance.profile);
  $("structure-text").textContent = words;
  $("structure-box").hidden = !words;
}

document.addEventListener("measured", () => panels());

function showNotes(notes) {
  const text = notes.join("\n");
  if (text !== shownNotes) $("notes").replaceChildren(...notes.map((note) => el("li", { textContent: note })));
  shownNotes = text;
}
