// Downloads: exports, fabrication files and pictures, made by the server.

import { $, api, app, ask, el, shortName, fullText } from "./common.js";
import { filterOf } from "./incidence.js";
import { sceneOf } from "./objects.js";
import { placeOf } from "./surroundings.js";

const VERBS = { export: "Export", fabricate: "Fabricate", picture: "Picture" };
const ABOUT = {
  "export:rgl": "Tensor file that Mitsuba (measured) and pbrt-v4 read.",
  "export:merl": "MERL table of an isotropic material, linear RGB.",
  "export:csv": "Goniometer table of all directions and wavelengths.",
  "export:zemax": "Scatter file of Zemax OpticStudio.",
  "export:gltf": "glTF with KHR_materials_iridescence: the best-fitting single film.",
  "export:materialx": "MaterialX: the best-fitting single film.",
  "export:usd": "USD: the best-fitting single film, as a MaterialX network.",
  "export:three": "three.js: materials for both renderers, with an example page.",
  "export:exr": "One slice over half and difference angle.",
  "export:nacre": "The solved material; it loads without its recipe.",
  "export:lut": "Tables of colour with GLSL, OSL, Blender and MaterialX readers, for the lamp chosen above.",
  "fabricate:png16": "16-bit grey image.", "fabricate:tiff16": "16-bit grey image.", "fabricate:stl": "Solid for printing.",
  "fabricate:gds": "Mask layout.", "fabricate:oas": "Mask layout.", "fabricate:csv": "Positions or values as a table.",
  "fabricate:npy": "Array of values.", "fabricate:sheet": "Table of layers, from the light's side.",
  "picture:.png": "8-bit picture.", "picture:.jpg": "8-bit picture.", "picture:.webp": "8-bit picture.",
  "picture:.exr": "Linear light with the picture before denoising as a layer.", "picture:.spectral.exr": "Spectra in bands of 10 nm.",
};
// options and their formats
const FIELDS = {
  angle_step_deg: { words: "Angle step", unit: "°", min: 0.5, max: 30, usual: 10, of: ["export:csv"] },
  wavelength_nm: { words: "One wavelength (empty: XYZ)", unit: "nm", min: 1, max: 1e6, of: ["export:zemax"] },
  width_mm: { words: "Area, width (empty: one period)", unit: "mm", min: 0, max: 1000, of: ["fabricate"], not: ["fabricate:sheet"] },
  height_mm: { words: "Area, height", unit: "mm", min: 0, max: 1000, of: ["fabricate"], not: ["fabricate:sheet"] },
  levels: { words: "Levels (empty: as drawn)", unit: "", min: 2, max: 256, of: ["fabricate:gds", "fabricate:oas"] },
  width: { words: "Width", unit: "px", min: 16, max: 4096, usual: 1024, of: ["picture"] },
  height: { words: "Height", unit: "px", min: 16, max: 4096, usual: 1024, of: ["picture"] },
  noise: { words: "Noise, relative", unit: "", min: 0.002, max: 1, usual: 0.02, of: ["picture"] },
};
let pending = null;

const isFor = (to, { of, not = [] }) => of.some((name) => to === name || to.startsWith(`${name}:`)) && !not.includes(to);

async function open() {
  $("files").showModal();
  $("file-error").textContent = "";
  try {
    const found = await api("api/formats", { text: await fullText(), name: app.recipe.name }), chosen = $("file-to").value;
    $("file-to").replaceChildren(...Object.entries(VERBS).filter(([verb]) => found[verb].length).map(([verb, words]) => {
      const group = el("optgroup", { label: words });
      group.append(...found[verb].map((to) => new Option(to, `${verb}:${to}`)));
      return group;
    }));
    const all = [...$("file-to").options].map(({ value }) => value);
    $("file-to").value = all.includes(chosen) ? chosen : "picture:.png";
    $("file-make").disabled = $("file-fields").hidden = false;
    put();
  } catch (problem) {
    $("file-make").disabled = $("file-fields").hidden = true;
    $("file-about").textContent = $("file-state").textContent = "";
    $("file-remarks").replaceChildren();
    $("file-error").textContent = problem.message;
  }
}

function put() {
  const to = $("file-to").value;
  $("file-about").textContent = ABOUT[to] ?? "";
  for (const [name, field] of Object.entries(FIELDS)) $(`file-${name}`).closest("label").hidden = !isFor(to, field);
  for (const name of ["scene", "turned"]) $(`file-${name}`).closest("label").hidden = !to.startsWith("picture:");
}

function options() {
  const to = $("file-to").value, found = {};
  for (const [name, field] of Object.entries(FIELDS)) {
    const { value, valueAsNumber } = $(`file-${name}`);
    if (isFor(to, field) && value !== "") found[name] = valueAsNumber;
  }
  if (to.startsWith("picture:") && $("file-turned").checked && app.view) {
    const { azimuth, elevation } = app.view;
    Object.assign(found, { azimuth: azimuth > 180 ? azimuth - 360 : azimuth, elevation });
  }
  return found;
}

async function make(event) {
  event.preventDefault();
  pending?.abort();
  const request = (pending = new AbortController()), [verb, to] = $("file-to").value.split(/:(.*)/s);
  const question = { text: await fullText(), name: app.recipe.name, verb, to, lamp: $("lamp").value, ...sceneOf($("file-scene")), options: options(), ...placeOf(), ...(verb === "picture" && $("file-scene").value !== "screen" ? filterOf() : {}) };
  $("file-error").textContent = "";
  $("file-remarks").replaceChildren();
  $("file-state").textContent = "Creating the file; you may close this dialog and continue.";
  $("file-cancel").hidden = false;
  try {
    const answer = await ask("api/file", question, request.signal), content = await answer.blob();
    const name = decodeURIComponent(/filename\*=UTF-8''(.*)$/.exec(answer.headers.get("content-disposition"))?.[1] ?? "nacre");
    give(name, content);
    $("file-state").textContent = `${name} of ${shortName(question.name)}, ${size(content.size)}: saved to the browser's downloads.`;
    $("file-remarks").replaceChildren(...JSON.parse(answer.headers.get("x-nacre-remarks") ?? "[]").map((line) => el("li", { textContent: line })));
  } catch (problem) {
    if (request !== pending) return;
    $("file-state").textContent = request.signal.aborted ? "Cancelled." : "";
    if (!request.signal.aborted) $("file-error").textContent = problem.message;
  } finally {
    if (request === pending) $("file-cancel").hidden = true;
  }
}

const size = (bytes) => (bytes < 2e3 ? `${bytes} bytes` : bytes < 2e6 ? `${Math.round(bytes / 1e3)} kB` : `${(bytes / 1e6).toFixed(1)} MB`);

function give(name, content) {
  const address = URL.createObjectURL(content), link = el("a", { href: address, download: name });
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(address), 60_000);
}

export function initDownloads() {
  $("file-fields").append(...Object.entries(FIELDS).map(([name, { words, unit, min, max, usual }]) => {
    const box = el("input", { type: "number", id: `file-${name}`, min, max, step: "any", value: usual ?? "" });
    return el("label", {}, el("span", { textContent: words }), box, el("span", { className: "unit", textContent: unit }));
  }));
  $("file").addEventListener("click", open);
  $("file-to").addEventListener("change", put);
  $("file-form").addEventListener("submit", make);
  $("file-close").addEventListener("click", () => $("files").close());
  $("file-cancel").addEventListener("click", () => pending?.abort());
}
