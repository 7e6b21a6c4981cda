// The object in the middle: the sphere, the shapes of pictures, or an own mesh that is dropped or chosen.

import { $, app, ask, reach } from "./common.js";

const kept = new Map();         // objects by their names, as the server sent them
const NAMES = { speedshape: "speed shape", body: "car" };
const MOST_MESH = 64 << 20;
let own = null, wanted = "sphere", file = null;

function unpack(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const told = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const places = new Float32Array(buffer, 4 + length, 8 * told.vertices);
  const order = new Uint32Array(buffer, 4 + length + places.byteLength, told.indices), [rows, columns] = told.print;
  return { ...told, places, order, paper: new Uint8Array(buffer, order.byteOffset + order.byteLength, rows * columns) };
}

// What pictures are asked of: a scene, or in the sphere's place the own mesh, by the name that the server keeps it under.
export const sceneOf = (select) => (select.value === "own" ? { scene: "sphere", mesh: own.id } : { scene: select.value });

// In words.
export const sceneName = (select) => select.selectedOptions[0].textContent;

const SCENES = ["scene", "file-scene"];

async function choose(name) {
  $("pick-mesh").hidden = name !== "own";
  if (name === "own" && !own) {
    $("object-error").textContent = "Drop a mesh on the picture, or choose its file.";
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
    if (name !== "sphere" && name !== "own" && !kept.has(name)) {
      $("object-error").textContent = "Loading";
      kept.set(name, unpack(await (await ask(`api/object?name=${name}`)).arrayBuffer()));
      $("object-error").textContent = "";
    }
    if (wanted !== name) return;        // another one was chosen meanwhile
    app.view.setObject(name === "sphere" ? null : name === "own" ? own : kept.get(name));
    $("view").dataset.object = name;
    $("view").setAttribute("aria-label", `${name === "own" ? own.name : NAMES[name] ?? name} of the material in the studio's light; arrow keys turn the view, B shows the kept look`);
  } catch (problem) {
    if (wanted !== name) return;
    await choose($("view").dataset.object ?? "sphere");         // the one that is still shown
    $("object-error").textContent = problem.message;
  }
}

async function give(given) {
  if (!given) return;
  file = given;
  $("object-error").textContent = `Reading ${given.name}`;
  try {
    if (given.size > MOST_MESH) throw new Error(`${given.name}: ${given.size >> 20} MiB; the page takes meshes of ${MOST_MESH >> 20} MiB at most`);
    const address = `api/mesh?name=${encodeURIComponent(given.name)}&up=${$("up").value}`;
    const answer = await reach(address, { method: "POST", body: given });
    if (!answer.ok) throw new Error((await answer.json().catch(() => ({}))).error ?? `the server answered ${answer.status}`);
    if (given !== file) return;
    own = unpack(await answer.arrayBuffer());
    for (const select of ["object", ...SCENES].map($)) {
      const option = [...select.options].find(({ value }) => value === "own") ?? select.appendChild(new Option("", "own"));
      option.textContent = own.name;
    }
    await choose("own");
    const drawn = own.indices / 3;
    if (drawn < own.faces) $("object-error").textContent = `${own.name}: drawn with ${drawn} of its ${own.faces} triangles; pictures take all`;
  } catch (problem) {
    $("object-error").textContent = problem.message;
  }
}

export function listObjects() {
  $("object").replaceChildren(new Option("sphere", "sphere"), ...app.state.objects.map((name) => new Option(NAMES[name] ?? name, name)), new Option("own mesh …", "own"));
}

export function listenObjects() {
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
