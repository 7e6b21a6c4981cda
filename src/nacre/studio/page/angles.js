// Colours at the geometries of multi-angle instruments, and texture; they follow the recipe while the panel is open.

import { $, api, app, el, shortName, fullText } from "./common.js";
import { cells } from "./report.js";

let busy = false, again = false, done = "";       // done: the question that is answered in full

// Ask for the newest recipe, one request at a time. Texture comes in the accuracy of a search at first, and with its
// standard errors once the recipe rests.
export async function updateAngles() {
  again = true;
  if (busy || !$("angles-box").open || !app.lastGood) return;
  busy = true;
  for (let fine = false; again || fine;) {
    if (again) fine = false;
    again = false;
    const recipe = { text: await fullText(), name: app.recipe.name }, lamp = $("lamp").value;
    const key = [lamp, recipe.name, recipe.text].join("\n");
    if (key === done) { fine = false; continue; }
    try {
      show(await api("api/angles", { recipe, lamp, fine }), recipe.name, lamp);
      fine = !fine && !$("angles-tables").hidden;
      if (!fine) done = key;
    } catch (problem) {
      $("angles-tables").hidden = true;
      $("angles-state").textContent = problem.message;
      fine = false;
    }
  }
  busy = false;
}

function show({ colours, texture }, name, lamp) {
  const hasColours = colours.length > 0, about = texture.reason ?? `Texture is ${texture.scale}.`;
  $("angles-tables").replaceChildren(...(hasColours ? [colourTable(colours), ...textureTables(texture)] : []));
  $("angles-tables").hidden = !hasColours;
  $("angles-state").textContent = hasColours ? `${shortName(name)}, ${lamp}, 10° observer; light at 45°, az: viewer out of the plane. ${about}` : about;
}

const table = (caption, heads, rows) => el("table", {}, el("caption", { textContent: caption }),
  el("thead", {}, el("tr", {}, ...cells("th", heads, "col"))), el("tbody", {}, ...rows));

function colourTable(found) {
  return table("colours", ["geometry", "L*", "a*", "b*", "sRGB"], found.map(({ geometry, lab, srgb }) => {
    const chip = el("span", { className: "chip", title: srgb });
    chip.style.background = srgb;
    return el("tr", {}, ...cells("th", [geometry], "row"), ...cells("td", [...lab.map((v) => v.toFixed(1)), chip]));
  }));
}

const number = ([value, error]) => (error === null ? value.toPrecision(3) : `${value.toPrecision(3)} ± ${error.toPrecision(1)}`);

function textureTables({ values, angles_deg }) {
  if (!values) return [];
  const rows = angles_deg.map((angle) => el("tr", {}, ...cells("th", [`${angle}°`], "row"),
    ...cells("td", ["intensity", "area", "sparkle"].map((name) => number(values[`${name}_${angle}`])))));
  return [table("sparkle", ["lamp", "intensity Si", "area Sa (%)", "grade SG"], rows),
    table("graininess", ["light", "G (%)"], [el("tr", {}, ...cells("th", ["diffuse"], "row"), ...cells("td", [number(values.graininess)]))])];
}

export function initAngles() {
  $("angles-box").addEventListener("toggle", updateAngles);
}
