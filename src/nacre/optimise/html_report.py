"""The report of a design by wants: one HTML file that needs nothing else, and a picture of the best answer."""

from __future__ import annotations

import html
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nacre.core.arrays import Array
from nacre.core.files import write_text
from nacre.families.contract import is_direct
from nacre.light import lamp_lines_nm, white_xyz
from nacre.material.material import Material
from nacre.optimise.evaluation import TargetResult, geometries_of
from nacre.optimise.gamut import MIN_POINTS, gamut_chart, gamut_svg, target_gamut
from nacre.optimise.measurement import Geometry, evaluation_wavelengths, search_wavelengths, simulate_measurement
from nacre.optimise.solutions import Solution
from nacre.optimise.sparsify import is_chosen
from nacre.optimise.task import DesignTask
from nacre.optimise.yield_analysis import RMS_OF_1_PERCENT
from nacre.plot.html import DPI, data_uri, framed
from nacre.recipe.paths import numbers_of

if TYPE_CHECKING:
    from nacre.plot.sheets import DesignSheet

REPORT, PICTURE = "report.html", "report.png"
RIBBON_DEG = np.linspace(0.0, 80.0, 41)
COARSE_DEG = np.linspace(0.0, 80.0, 9)  # where an angle takes long
ASPECULAR_DEG = np.array([-15.0, 0.0, 15.0, 25.0, 35.0, 45.0, 60.0, 75.0, 90.0, 110.0])
LEAST_GAMUT_S = 3.0


def write_page(folder: Path, target: DesignTask, design: Any, seconds: float, begun: float) -> None:
    """Write report.html and report.png.

    Args:
        folder: of the design.
        target: what was asked.
        design: the `Design`.
        seconds: time for it; answers behind the first go without their pictures, and the page without its gamut, where
            it is short.
        begun: when the whole design did, by the monotonic clock; its summary gets the seconds that the page tells.

    Raises:
        NacreError: the folder cannot be written.
    """
    from nacre.plot import save_figure
    from nacre.plot.sheets import design_figure

    page_begun = time.monotonic()
    sections = []
    for number, solution in enumerate(design.solutions, start=1):
        picture = ""
        if number == 1 or time.monotonic() - page_begun < 0.5 * seconds:
            figure = design_figure(sheet_of(target, solution, number, design))
            picture = data_uri(figure, DPI)
        if number == 1:
            save_figure(figure, folder / PICTURE, {"target": target.fingerprint})
        sections.append(_section(number, solution, picture, folder, target))
    # who has the answer is not kept waiting for the gamut: no longer than for all the rest
    left = 0.7 * seconds - (time.monotonic() - page_begun)
    gamut = _gamut(
        target, min(left, max(design.seconds, LEAST_GAMUT_S)), design.solutions[0].facts.get("judging_s", 0.0)
    )
    took = design.summary["seconds"] = round(time.monotonic() - begun, 3)
    body = [
        f"<h1>{html.escape(target.name)}</h1>",
        f'<p class="{"good" if design.status == "met" else "far"}">{html.escape(_capital(design.message))}.</p>',
        f"<p>{len(design.solutions)} answers, {took:.1f} s. {_light(target)}</p>",
        _overview(design.solutions),
        *sections,
        *gamut,
    ]
    text = html.escape(
        target.context.text or json.dumps(target.spec.model_dump(exclude_none=True), indent=2, default=str)
    )
    body += [
        f"<details><summary>the target</summary><pre>{text}</pre></details>",
        f"<details><summary>design.json</summary><pre>{html.escape(json.dumps(design.summary, indent=2, default=str))}"
        "</pre></details>",
    ]
    write_text(folder / REPORT, framed(target.name, body))


def sheet_of(target: DesignTask, solution: Solution, number: int, design: Any) -> DesignSheet:
    """Return what the picture of an answer shows.

    Raises:
        NacreError: the answer cannot be computed.
    """
    from nacre.plot.sheets import DesignSheet, Swatch

    light = target.spec.light
    made, seed = solution.material, target.spec.search.seed
    grid = _shown_wavelengths(made, light.illuminants)
    rows = geometries_of(target.targets)
    angles, ribbon_rows, label = _ribbon(rows[0], made)
    seen = simulate_measurement(made, [*rows, *ribbon_rows], grid, seed=seed, memory={})
    swatches = []
    for r in solution.targets:
        if r.lab is not None:
            document = r.document(light.observer)
            lamp = f", {r.lamp}" if len(light.illuminants) > 1 else ""
            swatches.append(
                Swatch(
                    f"{r.target.geometry}{lamp}", document["asked_colour"], document["reached"]["colour"], _distance(r)
                )
            )
    curves = {str(at): row for at, row in zip(rows, seen.factors)}
    wanted = {str(w.geometry): w.spectrum for w in target.targets if w.spectrum is not None}
    media, thicknesses = made.layers()
    bars, title = _bars(solution, target)
    share = solution.yield_share
    made_well = "" if share is None else f"; yield {100 * share:.0f} %"
    return DesignSheet(
        f"{target.name}, answer {number} of {len(design.solutions)}: {_distance(solution.worst)}"
        f" at {solution.worst.target.geometry}{made_well}",
        swatches,
        seen.wavelengths_nm,
        curves,
        wanted,
        angles,
        seen.factors[len(rows) :],
        label,
        media,
        thicknesses,
        _numbers(solution, target),
        bars,
        title,
        light.illuminants[0],
    )


def _shown_wavelengths(made: Material, lamps: Sequence[str]) -> Array:
    """Return the grid of the curves and of the ribbon: that of the search.

    Where a wavelength takes long (a body that is no sphere), those of the judge, who has solved them: about as many.
    """
    few = search_wavelengths(made, lamps)
    if not is_direct(made.model):
        return few
    known = evaluation_wavelengths(made, lamps)
    lines = [line for lamp in lamps for line in lamp_lines_nm(lamp)]
    return np.unique([*known[:: max(1, len(known) // len(few))], known[-1], *np.intersect1d(known, lines)])


def _ribbon(first: Geometry, material: Material) -> tuple[Array, list[Geometry], str]:
    """Return the angles of the ribbon over which the first want's kind of look is shown."""
    if first.kind == "aspecular":
        angles = ASPECULAR_DEG[np.abs(ASPECULAR_DEG - first.theta_deg) < 89.0]
        label = f"Aspecular angle, light from {first.theta_deg:g}\u00b0"
        return angles, [Geometry("aspecular", first.theta_deg, float(a)) for a in angles], label
    angles = RIBBON_DEG if material.model.traits.is_quick else COARSE_DEG
    return angles, [Geometry(first.kind, float(a)) for a in angles], f"Angle of the light, {first.kind} (degrees)"


def _numbers(solution: Solution, target: DesignTask) -> list[str]:
    """Return what was chosen, a number a line; of a list of tables, out of which some may be gone, all numbers."""
    lines = []
    for path, value in solution.changes.items():
        if isinstance(value, list | dict) and (inner := numbers_of(value, path)):
            chosen = [each for each in inner if is_chosen(each, solution.changes, target.parameters)]
            lines += [f"{each} = {_short(inner[each])}" for each in chosen]
        else:
            lines.append(f"{path} = {_short(value)}")
    return lines


def _short(value: Any) -> str:
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def _bars(solution: Solution, target: DesignTask) -> tuple[list[tuple[str, float]], str]:
    details = solution.facts.get("yield")
    unit = "rms % " if all(want.spectrum is not None for want in target.targets) else "dE00 "
    if details is not None:
        return [(c["path"], c["moves"]) for c in details["costs"]], f"{unit}of one standard deviation"
    found = solution.facts.get("sensitivity", [])
    count = len([p for p in numbers_of(solution.material.data) if is_chosen(p, solution.changes, target.parameters)])
    part = f"\n({len(found)} of {count} numbers, in the time)" if 0 < len(found) < count else ""
    moves = [(s["path"], s.get("de00_of_1_percent", s.get(RMS_OF_1_PERCENT))) for s in found]
    return moves, f"{unit}of a change of 1 %{part}"


def _distance(reached: TargetResult) -> str:
    if reached.lamp is None:
        return f"rms {reached.distance:.2f} %"
    noise = f" \u00b1 {reached.noise:.2f}" if reached.noise else ""
    return f"dE00 {reached.distance:.2f}{noise} (within {reached.target.tolerance:g})"


def _overview(solutions: Sequence[Solution]) -> str:
    lines = ["<table><tr><th>answer</th><th>worst</th><th>at</th><th>thickness</th><th>layers</th><th>yield</th></tr>"]
    for number, solution in enumerate(solutions, start=1):
        media, _ = solution.material.layers()
        total, share = solution.facts.get("total_nm"), solution.yield_share
        made = "" if share is None else f"{100 * share:.0f} %"
        lines.append(
            f'<tr><td><a href="#answer-{number}">{number}</a></td><td>{_distance(solution.worst)}</td>'
            f"<td>{solution.worst.target.geometry}</td><td>{'' if total is None else f'{total:.0f} nm'}</td>"
            f"<td>{html.escape(' | '.join(media[1:-1]))}</td><td>{made}</td></tr>"
        )
    return "".join([*lines, "</table>"])


def _section(number: int, solution: Solution, picture: str, folder: Path, target: DesignTask) -> str:
    light = target.spec.light
    rows = ["<table><tr><th>want</th><th>lamp</th><th>asked | reached</th><th></th><th>distance</th></tr>"]
    for r in solution.targets:
        document = r.document(light.observer)
        pair = said = ""
        if r.lab is not None and r.lamp is not None:
            pair = "".join(
                f'<i style="background:{c}"></i>' for c in (document["asked_colour"], document["reached"]["colour"])
            )
            pair = f'<span class="pair">{pair}</span>'
            assert r.target_lab is not None
            said = f"{_lab(r.target_lab)} | {_lab(r.lab)}"
        mark = "" if r.is_met else " (missed)"
        rows.append(
            f"<tr><td>{r.target.geometry}</td><td>{r.lamp or ''}</td><td>{pair}</td><td class=small>{said}</td>"
            f"<td>{_distance(r)}{mark}</td></tr>"
        )
    made = [f"<li>{html.escape(line)}</li>" for line in _numbers(solution, target) if len(line) < 200]
    where = solution.recipe.parent.relative_to(folder).as_posix() if solution.recipe is not None else ""
    details = solution.facts.get("yield")
    said = ""
    if details is not None:
        low, high = (100 * share for share in details["interval_95"])
        said = (
            f"<p>Yield {100 * details['share']:.0f} % ({low:.0f} to {high:.0f} %, {details['draws']} draws);"
            f" what costs most of it: <code>{html.escape(str(details['costs_most']))}</code>.</p>"
        )
    total = solution.facts.get("total_nm")
    thick = "" if total is None else f"<p>Thickness of all layers: {total:.1f} nm.</p>"
    return (
        f'<h2 id="answer-{number}">Answer {number} <span class="small">{"recipe.toml" if where == "." else where}'
        f"</span></h2>{''.join(rows)}</table>{said}{thick}"
        + (f'<img alt="sheet of answer {number}" src="{picture}">' if picture else "")
        + (f"<details><summary>numbers</summary><ul>{''.join(made)}</ul></details>" if made else "")
    )


def _gamut(target: DesignTask, seconds: float, judging_s: float) -> list[str]:
    """Return what can be reached at the first colour that is wanted, as parts of the page; nothing without the time.

    Args:
        judging_s: what a look at one answer took, on all of its wavelengths.
    """
    lamps = target.spec.light.illuminants
    few, every = (len(choose(target.material, lamps)) for choose in (search_wavelengths, evaluation_wavelengths))
    if seconds <= 0.0 or (is_direct(target.material.model) and MIN_POINTS * judging_s * few / every > seconds):
        return []
    found = target_gamut(target, seconds)
    if found is None:
        return []
    gamut, wanted = found
    facts = (
        f"{html.escape(gamut.geometry)}, {gamut.illuminant}: within dE00 {gamut.tolerance:g} of one of "
        f"{len(gamut.lab)} reached colours lie {100 * gamut.share_of_srgb:.2g} % of the colours of sRGB and "
        f"{100 * gamut.share_of_optimal:.2g} % of the optimal colours (solid line), which no surface goes beyond. Let "
        "the pointer rest on a point to see its structure; crosses are what was wanted."
    )
    chart = f'<img alt="what can be reached" src="{data_uri(gamut_chart(gamut, wanted), DPI)}">'
    details = f"<details><summary>structures</summary>{gamut_svg(gamut, wanted)}</details>"
    return [f"<h2>What can be reached</h2><p>{facts}</p>", chart, details]


def _lab(lab: Array) -> str:
    return ", ".join(f"{v:.1f}" for v in lab)


def _light(target: DesignTask) -> str:
    light = target.spec.light
    white = [", ".join(f"{v:.4f}" for v in white_xyz(lamp, light.observer)) for lamp in light.illuminants]
    lamps = "; ".join(f"{lamp} (white {w})" for lamp, w in zip(light.illuminants, white))
    return f"Colours under {lamps}, {light.observer} observer, each against its own white."


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


__all__ = ["write_page"]
