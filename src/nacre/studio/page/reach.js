// The gamut in a*b*: what the free numbers reach at an angle, and whether the colours asked for are in it.

import { $, el } from "./common.js";
import { add, clear } from "./charts.js";

let limits = null, found = [];    // rims of sRGB and of all surface colours; one entry for each angle

export const angleOf = (at) => `${Number(/-?[\d.]+$/.exec(at.replace("as", " "))?.[0] ?? 0)}°`;

export function hearReach(event) {
  if (event.kind === "limits") {
    limits = event;
    found = [];
  } else if (event.kind === "reach") found.push(event);
  else return;
  const chosen = $("gamut-at").value;
  $("gamut-at").replaceChildren(...found.map(({ at }) => new Option(at, at)));
  if (found.some(({ at }) => at === chosen)) $("gamut-at").value = chosen;
  draw();
}

export function forgetReach() {
  [limits, found] = [null, []];
  $("gamut-box").hidden = true;
}

const inWords = (asked) => asked.colour ?? `hue ${asked.hue_deg?.map(Math.round).join("–")}°, chroma ${asked.chroma?.replace(">=", "≥ ")}`;

function draw() {
  const svg = $("gamut"), one = found.find(({ at }) => at === $("gamut-at").value);
  $("gamut-box").hidden = !one;
  if (!one) return;
  clear(svg);
  const reach = 1.08 * Math.max(60, ...limits.srgb.flat().map(Math.abs), ...one.points.flatMap(([, a, b]) => [Math.abs(a), Math.abs(b)]));
  const x = (a) => 140 + (a / reach) * 116, y = (b) => 122 - (b / reach) * 116;
  const rim = (points, kind) => add(svg, "path", { d: `${points.map(([a, b], i) => `${i ? "L" : "M"}${x(a).toFixed(1)} ${y(b).toFixed(1)}`).join("")}Z`, class: kind });
  add(svg, "path", { d: "M24 122H256M140 6V238", class: "axis" });
  add(svg, "text", { x: 258, y: 125 }, "a*");
  add(svg, "text", { x: 144, y: 13 }, "b*");
  rim(limits.srgb, "rim");
  for (const [, a, b, fill] of one.points) add(svg, "circle", { cx: x(a).toFixed(1), cy: y(b).toFixed(1), r: 2.6, class: "reached" }).style.fill = fill;
  for (const { lab, inside, asked } of one.asked) {
    if (lab) {
      const [, a, b] = lab;
      add(svg, "circle", { cx: x(a), cy: y(b), r: 7, class: "halo" });
      add(svg, "circle", { cx: x(a), cy: y(b), r: 7, class: inside ? "asked in" : "asked out" });
      if (!inside) add(svg, "path", { d: `M${x(a) - 5} ${y(b) - 5}l10 10m0 -10l-10 10`, class: "cross" });
      add(svg, "text", { x: x(a) + 10, y: y(b) + 3, class: "strong" }, inside ? "in" : "out");
    } else {
      // a range of hues, from the chroma asked for outward
      const [low, high] = asked.hue_deg, least = Number(/[\d.]+/.exec(asked.chroma ?? "0")?.[0] ?? 0), spread = (high - low + 360) % 360, far = reach * 1.05;
      const at = (radius, share) => { const turn = ((low + share * spread) * Math.PI) / 180; return `${x(radius * Math.cos(turn)).toFixed(1)} ${y(radius * Math.sin(turn)).toFixed(1)}`; };
      const steps = [0, 0.25, 0.5, 0.75, 1];
      add(svg, "path", { d: `M${steps.map((s) => at(least, s)).join("L")}L${[...steps].reverse().map((s) => at(far, s)).join("L")}Z`, class: inside ? "asked in" : "asked out" });
    }
  }
  svg.setAttribute("aria-label", `Reachable colours in a*, b* at ${one.at}`);
  const share = (100 * one.share_of_srgb).toPrecision(2);
  $("gamut-said").replaceChildren(
    ...found.flatMap(({ at, asked }) => asked.map((each) => el("li", { textContent: `${at}: ${inWords(each.asked)} is ${each.inside ? "inside" : `outside, missed by ${each.lab ? "ΔE" : "about"} ${each.distance.toFixed(1)}`}` }))),
    el("li", { className: "quiet", textContent: `${one.points.length} structures drawn at ${one.at}; their colours reach ${share} % of those of sRGB (dashed). What none of them came near may still be reached by a design.` }));
}

export function listenReach() {
  $("gamut-at").addEventListener("change", draw);
}
