// The industry report, measured by the server in a subprocess.

import { $, api, app, el, shortName, fullText } from "./common.js";
import { storedRecipe } from "./compare.js";

let measuring = null;

async function measure() {
  measuring?.abort();
  const request = (measuring = new AbortController());
  const recipes = [{ text: await fullText(), name: app.recipe.name }, ...storedRecipe()], lamp = $("lamp").value;
  $("report-cancel").hidden = false;
  $("report-state").textContent = "Measuring; the page stays responsive.";
  try {
    const found = await api("api/report", { recipes, lamp }, request.signal);
    $("report-tables").replaceChildren(...found.reports.flatMap((report, i) => tables(report, found.reports.length > 1 ? `${"AB"[i]}: ` : "")), ...differences(found));
    $("report-tables").hidden = false;
    $("report-state").textContent = `${shortName(recipes[0].name)}, ${lamp}, 10° observer; flop under D65, gloss and haze under C. Recipe at the time of the request.`;
  } catch (problem) {
    if (request === measuring) $("report-state").textContent = request.signal.aborted ? "Cancelled." : problem.message;
  } finally {
    if (request === measuring) $("report-cancel").hidden = true;
  }
}

export const cells = (tag, values, scope) => values.map((value) => {
  const made = value instanceof Node ? el(tag, {}, value) : el(tag, { textContent: value });
  if (scope) made.scope = scope;
  return made;
});

function tables({ colours, numbers }, side) {
  const made = colours.map(({ kind, what, angles_deg, geometries, lab, srgb, travel_ab }) => {
    const rows = angles_deg.map((angle, i) => {
      const chip = el("span", { className: "chip", title: srgb[i] });
      chip.style.background = srgb[i];
      return el("tr", {}, ...cells("th", [kind === "geometries" ? geometries[i] : `${angle}°`], "row"), ...cells("td", [...lab[i].map((v) => v.toFixed(1)), chip]));
    });
    return el("table", {}, el("caption", { textContent: `${side}${what}; travel in a*b* ${travel_ab.toFixed(1)}` }),
      el("thead", {}, el("tr", {}, ...cells("th", ["angle", "L*", "a*", "b*", "sRGB"], "col"))), el("tbody", {}, ...rows));
  });
  const rows = numbers.map(([name, value]) => el("tr", {}, ...cells("th", [name], "row"), ...cells("td", [value])));
  return [...made, el("table", {}, el("caption", { textContent: `${side}numbers` }), el("tbody", {}, ...rows))];
}

function differences({ reports, differences: found }) {
  return Object.entries(found ?? {}).map(([name, values]) => {
    const { angles_deg = [], geometries = [] } = reports[0].colours.find(({ kind }) => kind === name) ?? {};
    const rows = values.map((value, i) => el("tr", {}, ...cells("th", [name === "geometries" ? geometries[i] : `${angles_deg[i]}°`], "row"), ...cells("td", [value.toFixed(2)])));
    return el("table", {}, el("caption", { textContent: `CIEDE2000 between A and B, ${name}` }), el("tbody", {}, ...rows));
  });
}

export function initReport() {
  $("report").addEventListener("click", measure);
  $("report-cancel").addEventListener("click", () => measuring?.abort());
}
