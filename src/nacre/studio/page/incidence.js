// Azimuth and polarisation of the light on anisotropic films, and the filter before the camera of rendered pictures.

import { $, app } from "./common.js";

const NAMES = { s: "s-polarised light", p: "p-polarised light", left: "left circular light", right: "right circular light" };

// Of a request for the appearance; other materials ignore it.
export const incidenceOf = () => ({ azimuth_deg: Number($("azimuth").value), polarisation: $("polarisation").value });

// Show the controls if the material depends on them; `appearance` is the newest answer.
export function showIncidence({ incidence }) {
  $("azimuth-bar").hidden = $("polarisation-bar").hidden = !incidence;
  const name = `Reflectance over wavelength${NAMES[incidence?.polarisation] ? ` of ${NAMES[incidence.polarisation]}` : ""}`;
  if ($("spectrum").getAttribute("aria-label") !== name) $("spectrum").setAttribute("aria-label", name);
}

// Filter of a rendered picture, and its name.
export function filterOf() {
  const kind = $("filter").value, angle = $("filter-angle").valueAsNumber;
  if (kind === "none") return {};
  return { polariser: kind === "linear" ? (Number.isFinite(angle) ? angle : 0) : kind };
}
export const filterName = ({ polariser }) => (polariser === undefined ? "" : `, ${typeof polariser === "number" ? `linear filter at ${polariser}°` : `${polariser} circular filter`}`);

export function initIncidence() {
  $("azimuth").addEventListener("input", () => {
    $("azimuth-value").textContent = $("azimuth").value;
    app.socket.ask();
  });
  $("polarisation").addEventListener("change", () => app.socket.ask());
  $("filter").addEventListener("change", () => { $("filter-angle").closest("label").hidden = $("filter").value !== "linear"; });
}
