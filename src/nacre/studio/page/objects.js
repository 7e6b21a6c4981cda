// The object: the sphere, shapes of pictures, or the user's mesh.

import { $, app, ask, request } from "./common.js";
import { openMade } from "./files.js";

const cached = new Map();         // objects by name
const NAMES = { speedshape: "speed shape", body: "car" };
const MAX_MESH = 64 << 20;
let own = null, wanted = "sphere", file = null, scan = null;

function unpack(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const places = new Float32Array(buffer, 4 + length, 8 * header.vertices);
  const order = new Uint32Array(buffer, 4 + length + places.byteLength, header.indices), [rows, columns] = header.print;
  return { ...header, places, order, paper: new Uint8Array(buffer, order.byteOffset + order.byteLength, rows * columns) };
}

// Scene of a picture; the user's mesh replaces the sphere and is given by its id.
export const sceneOf = (select) => (select.value === "own" ? { scene: "sphere", mesh: own.id } : { scene: select.value });

// Displayed name of the scene.
export const sceneName = (select) => select.selectedOptions[0].textContent;

const SCENES = ["scene", "file-scene"];

async function choose(name) {
  $("pick-mesh").hidden = name !== "own";
  if (name === "own" && !own) {
    $("object-error").textContent = "Drop a mesh on the picture or choose a file.";
    return;
  }
  wanted = name;
  $("object").value = name;
  $("object-error").textContent = "";
  $("up").closest("label").hidden = name !== "own";
  $("grid").closest("label").hidden = name === "sphere";
  for (const select of SCENES.map($)) if ([...select.options].some(({ value }) => value === name)) select.value = name;
  if (!app.view) return;
  try {
    if (name !== "sphere" && name !== "own" && !cached.has(name)) {
      $("object-error").textContent = "Loading";
      cached.set(name, unpack(await (await ask(`api/object?name=${name}`)).arrayBuffer()));
      $("object-error").textContent = "";
    }
    if (wanted !== name) return;
    app.view.setObject(name === "sphere" ? null : name === "own" ? own : cached.get(name));
    $("view").dataset.object = name;
    $("view").setAttribute("aria-label", `${name === "own" ? own.name : NAMES[name] ?? name} of the material in the studio's light; arrow keys turn the view, B shows the stored appearance`);
  } catch (problem) {
    if (wanted !== name) return;
    await choose($("view").dataset.object ?? "sphere");         // restore the shown object
    $("object-error").textContent = problem.message;
  }
}

// Read a file of an instrument: its curves join the spectra, its first colour the targets of the design.
async function measure(given) {
  try {
    if (given.size > MAX_MESH) throw new Error(`${given.name}: ${given.size >> 20} MiB; the page takes files up to ${MAX_MESH >> 20} MiB`);
    const answer = await request(`api/measurement?name=${encodeURIComponent(given.name)}`, { method: "POST", body: given });
    const found = await answer.json();
    if (!answer.ok) throw new Error(found.error ?? `the server answered ${answer.status}`);
    app.measured = found.curves;
    app.ellipsometry = found.ellipsometry;
    scan = found.is_scan ? given : null;
    $("make-relief").hidden = !scan;
    $("object-error").textContent = found.summary[0];
    if (found.ellipsometry.length) app.socket.ask();
    document.dispatchEvent(new CustomEvent("measured", { detail: found }));
  } catch (problem) {
    $("object-error").textContent = problem.message;
  }
}

// Store the dropped scan in the opened folder and open a recipe of its relief.
async function makeRelief() {
  try {
    const answer = await request(`api/scan?name=${encodeURIComponent(scan.name)}`, { method: "POST", body: scan }), found = await answer.json();
    if (!answer.ok) throw new Error(found.error ?? `the server answered ${answer.status}`);
    $("make-relief").hidden = true;
    await openMade(found);
  } catch (problem) {
    $("object-error").textContent = problem.message;
  }
}

async function give(given) {
  if (!given) return;
  if (!$("own-mesh").accept.split(",").some((suffix) => given.name.toLowerCase().endsWith(suffix))) return measure(given);
  file = given;
  $("make-relief").hidden = true;
  $("object-error").textContent = `Reading ${given.name}`;
  try {
    if (given.size > MAX_MESH) throw new Error(`${given.name}: ${given.size >> 20} MiB; the page takes meshes up to ${MAX_MESH >> 20} MiB`);
    const address = `api/mesh?name=${encodeURIComponent(given.name)}&up=${$("up").value}`;
    const answer = await request(address, { method: "POST", body: given });
    if (!answer.ok) throw new Error((await answer.json().catch(() => ({}))).error ?? `the server answered ${answer.status}`);
    if (given !== file) return;
    own = unpack(await answer.arrayBuffer());
    for (const select of ["object", ...SCENES].map($)) {
      const option = [...select.options].find(({ value }) => value === "own") ?? select.appendChild(new Option("", "own"));
      option.textContent = own.name;
    }
    await choose("own");
    const drawn = own.indices / 3;
    if (drawn < own.faces) $("object-error").textContent = `${own.name}: drawn with ${drawn} of its ${own.faces} triangles; pictures use all`;
  } catch (problem) {
    $("object-error").textContent = problem.message;
  }
}

export function listObjects() {
  $("object").replaceChildren(new Option("sphere", "sphere"), ...app.state.objects.map((name) => new Option(NAMES[name] ?? name, name)), new Option("your mesh …", "own"));
}

export function initObjects() {
  $("make-relief").addEventListener("click", makeRelief);
  $("object").addEventListener("change", () => choose($("object").value));
  $("own-mesh").addEventListener("change", () => { give($("own-mesh").files[0]); $("own-mesh").value = ""; });
  $("pick-mesh").addEventListener("click", () => $("own-mesh").click());
  $("up").addEventListener("change", () => give(file));
  $("grid").addEventListener("change", () => { if (app.view) { app.view.grid = $("grid").checked; app.view.draw(); } });
  const stage = $("stage");
  for (const kind of ["dragover", "dragenter"]) {
    stage.addEventListener(kind, (event) => { event.preventDefault(); stage.classList.add("over"); });
  }
  stage.addEventListener("dragleave", () => stage.classList.remove("over"));
  stage.addEventListener("drop", (event) => {
    event.preventDefault();
    stage.classList.remove("over");
    give(event.dataTransfer.files[0]);
  });
}
