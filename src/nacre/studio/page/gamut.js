// The gamut in a*b*: colours within the bounds of the parameters at an angle, and whether it includes the targets.

import { $, el } from "./common.js";
import { add, clear } from "./charts.js";

let limits = null, found = [];    // outlines of sRGB and of the optimal colours; one event for each angle

export const angleOf = (geometry) => `${Number(/-?[\d.]+$/.exec(geometry.replace("as", " "))?.[0] ?? 0)}°`;

export function onGamutEvent(event) {
  if (event.kind === "limits") {
    limits = event;
    found = [];
  } else if (event.kind === "gamut") found.push(event);
  else return;
  const chosen = $("gamut-at").value;
  $("gamut-at").replaceChildren(...found.map(({ geometry }) => new Option(geometry, geometry)));
  if (found.some(({ geometry }) => geometry === chosen)) $("gamut-at").value = chosen;
  draw();
}

export function clearGamut() {
  [limits, found] = [null, []];
  $("gamut-box").hidden = true;
}

const describe = (target) => target.colour ?? `hue ${target.hue_deg?.map(Math.round).join("–")}°, chroma ${target.chroma?.replace(">=", "≥ ")}`;

function draw() {
  const svg = $("gamut"), one = found.find(({ geometry }) => geometry === $("gamut-at").value);
  $("gamut-box").hidden = !one;
  if (!one) return;
  clear(svg);
  const extent = 1.08 * Math.max(60, ...limits.srgb.flat().map(Math.abs), ...one.points.flatMap(([, a, b]) => [Math.abs(a), Math.abs(b)]));
  const x = (a) => 140 + (a / extent) * 116, y = (b) => 122 - (b / extent) * 116;
  const outline = (points, kind) => add(svg, "path", { d: `${points.map(([a, b], i) => `${i ? "L" : "M"}${x(a).toFixed(1)} ${y(b).toFixed(1)}`).join("")}Z`, class: kind });
  add(svg, "path", { d: "M24 122H256M140 6V238", class: "axis" });
  add(svg, "text", { x: 258, y: 125 }, "a*");
  add(svg, "text", { x: 144, y: 13 }, "b*");
  outline(limits.srgb, "rim");
  for (const [, a, b, fill] of one.points) add(svg, "circle", { cx: x(a).toFixed(1), cy: y(b).toFixed(1), r: 2.6, class: "reached" }).style.fill = fill;
  for (const { lab, inside, target } of one.targets) {
    if (lab) {
      const [, a, b] = lab;
      add(svg, "circle", { cx: x(a), cy: y(b), r: 7, class: "halo" });
      add(svg, "circle", { cx: x(a), cy: y(b), r: 7, class: inside ? "target in" : "target out" });
      if (!inside) add(svg, "path", { d: `M${x(a) - 5} ${y(b) - 5}l10 10m0 -10l-10 10`, class: "cross" });
      add(svg, "text", { x: x(a) + 10, y: y(b) + 3, class: "strong" }, inside ? "in" : "out");
    } else {
      // a range of hues, from the lowest chroma outward
      const [low, high] = target.hue_deg, least = Number(/[\d.]+/.exec(target.chroma ?? "0")?.[0] ?? 0), spread = (high - low + 360) % 360, far = extent * 1.05;
      const point = (radius, share) => { const turn = ((low + share * spread) * Math.PI) / 180; return `${x(radius * Math.cos(turn)).toFixed(1)} ${y(radius * Math.sin(turn)).toFixed(1)}`; };
      const steps = [0, 0.25, 0.5, 0.75, 1];
      add(svg, "path", { d: `M${steps.map((s) => point(least, s)).join("L")}L${[...steps].reverse().map((s) => point(far, s)).join("L")}Z`, class: inside ? "target in" : "target out" });
    }
  }
  svg.setAttribute("aria-label", `Reachable colours in a*, b* at ${one.geometry}`);
  const share = (100 * one.share_of_srgb).toPrecision(2);
  $("gamut-text").replaceChildren(
    ...found.flatMap(({ geometry, targets }) => targets.map((each) => el("li", { textContent: `${geometry}: ${describe(each.target)} is ${each.inside ? "inside" : `outside by ${each.lab ? "ΔE" : "about"} ${each.distance.toFixed(1)}`}` }))),
    el("li", { className: "quiet", textContent: `${one.points.length} structures sampled at ${one.geometry}; they cover ${share} % of sRGB (dashed). A design may reach colours outside the sample.` }));
}

export function initGamut() {
  $("gamut-at").addEventListener("change", draw);
}
