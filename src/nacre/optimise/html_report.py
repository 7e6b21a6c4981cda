"""Design report: a self-contained HTML page, and a picture of the best solution."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nacre.core.arrays import Array
from nacre.core.files import write_text
from nacre.core.html import render_page
from nacre.core.jit import clock
from nacre.families.contract import is_direct
from nacre.light import lamp_lines_nm, white_xyz
from nacre.material.material import Material
from nacre.measure.geometry import Geometry
from nacre.measure.texture import TextureQuantity
from nacre.optimise.evaluation import TargetResult, geometries_of
from nacre.optimise.gamut import MIN_POINTS, gamut_chart, gamut_svg, target_gamut
from nacre.optimise.measurement import evaluation_wavelengths, search_wavelengths, simulate_measurement
from nacre.optimise.parameters import is_chosen
from nacre.optimise.solutions import Solution
from nacre.optimise.task import DesignTask
from nacre.optimise.yield_analysis import COLOUR, RMS, TEXTURE, effect_unit
from nacre.plot.style import DPI, data_uri
from nacre.recipe.paths import numbers_of

if TYPE_CHECKING:
    from nacre.plot.sheets import DesignSheet

REPORT, PICTURE = "report.html", "report.png"
RIBBON_DEG = np.linspace(0.0, 80.0, 41)
COARSE_DEG = np.linspace(0.0, 80.0, 9)  # angles for slow materials
ASPECULAR_DEG = np.array([-15.0, 0.0, 15.0, 25.0, 35.0, 45.0, 60.0, 75.0, 90.0, 110.0])
MIN_GAMUT_S = 3.0
PICTURES_SHARE, GAMUT_SHARE = 0.5, 0.7  # time limit shares at which pictures and the gamut end
MAX_LINE = 200


def write_page(folder: Path, task: DesignTask, design: Any, seconds: float, begun: float) -> None:
    """Write report.html and report.png.

    Args:
        folder: design folder.
        task: the design task.
        design: the `Design`; its summary gets the total time.
        seconds: time limit; in a short one only the best solution has a picture, and the gamut is omitted.
        begun: `core.jit.clock()` at the design start.

    Raises:
        NacreError: the folder cannot be written.
    """
    from nacre.plot import save_figure
    from nacre.plot.sheets import design_figure

    page_begun = clock()
    solutions = []
    for number, solution in enumerate(design.solutions, start=1):
        picture = None
        if number == 1 or clock() - page_begun < PICTURES_SHARE * seconds:
            figure = design_figure(sheet_of(task, solution, number, design))
            picture = data_uri(figure, DPI)
            if number == 1:
                save_figure(figure, folder / PICTURE, {"target": task.fingerprint})
        solutions.append(_entry(solution, picture, folder, task))
    remaining_s = GAMUT_SHARE * seconds - (clock() - page_begun)
    # at most as long as the design took
    remaining_s = min(remaining_s, max(design.seconds, MIN_GAMUT_S))
    gamut = _gamut(task, remaining_s, design.solutions[0].facts.get("evaluation_s", 0.0))
    design.summary["seconds"] = round(clock() - begun, 3)
    light, spec = task.spec.light, task.spec.model_dump(exclude_none=True)
    page = render_page(
        "design_report.html",
        title=task.name,
        design=design,
        message=design.message[:1].upper() + design.message[1:],
        solutions=solutions,
        lamps=[(lamp, white_xyz(lamp, light.observer)) for lamp in light.illuminants],
        observer=light.observer,
        gamut=gamut,
        target=task.context.text or json.dumps(spec, indent=2, default=str),
        document=json.dumps(design.summary, indent=2, default=str),
    )
    write_text(folder / REPORT, page)


def _entry(solution: Solution, picture: str | None, folder: Path, task: DesignTask) -> dict[str, Any]:
    """Return a solution's template data."""
    where = "" if solution.recipe is None else solution.recipe.parent.relative_to(folder).as_posix()
    return {
        "solution": solution,
        "where": "recipe.toml" if where == "." else where,
        "picture": picture,
        "worst": _distance(solution.worst),
        "layers": " | ".join(solution.material.layers()[0][1:-1]),
        "rows": [(r, r.document(task.spec.light.observer), _distance(r)) for r in solution.targets],
        "lines": [line for line in _numbers(solution, task) if len(line) < MAX_LINE],
        "yield": solution.facts.get("yield"),
        "total_nm": solution.facts.get("total_nm"),
    }


def _gamut(task: DesignTask, seconds: float, evaluation_s: float) -> dict[str, Any] | None:
    """Return gamut, chart and SVG at the first target colour; None if the time does not suffice.

    Args:
        evaluation_s: final evaluation time per solution, at all wavelengths.
    """
    lamps = task.spec.light.illuminants
    few, every = (len(choose(task.material, lamps)) for choose in (search_wavelengths, evaluation_wavelengths))
    if seconds <= 0.0 or (is_direct(task.material.model) and MIN_POINTS * evaluation_s * few / every > seconds):
        return None
    result = target_gamut(task, seconds)
    if result is None:
        return None
    gamut, marks = result
    return {"gamut": gamut, "chart": data_uri(gamut_chart(gamut, marks), DPI), "svg": gamut_svg(gamut, marks)}


def sheet_of(task: DesignTask, solution: Solution, number: int, design: Any) -> DesignSheet:
    """Return a solution's sheet.

    Raises:
        NacreError: the solution cannot be computed.
    """
    from nacre.plot.sheets import DesignSheet, Swatch

    light, material = task.spec.light, solution.material
    grid = _shown_wavelengths(material, light.illuminants)
    rows = [at for at in geometries_of(task.targets) if not isinstance(at, TextureQuantity)]
    rows = rows or [Geometry.read(material.model.traits.default_geometry, "geometry")]
    angles, ribbon_rows, label = _ribbon(rows[0], material)
    seed = task.spec.search.seed
    measured = simulate_measurement(material, [*rows, *ribbon_rows], grid, seed=seed, memory={})
    swatches = []
    for r in solution.targets:
        if r.lab is not None:
            document = r.document(light.observer)
            name = f"{r.target.geometry}" + (f", {r.lamp}" if len(light.illuminants) > 1 else "")
            swatches.append(Swatch(name, document["asked_colour"], document["reached"]["colour"], _distance(r)))
    bars, bars_title = _bars(solution, task)
    share = solution.yield_share
    worst = f"{_distance(solution.worst)} at {solution.worst.target.geometry}"
    made = "" if share is None else f"; yield {100 * share:.0f} %"
    return DesignSheet(
        f"{task.name}, answer {number} of {len(design.solutions)}: {worst}{made}",
        swatches,
        measured.wavelengths_nm,
        {str(at): row for at, row in zip(rows, measured.factors)},
        {str(one.geometry): one.spectrum for one in task.targets if one.spectrum is not None},
        angles,
        measured.factors[len(rows) :],
        label,
        *material.layers(),
        _numbers(solution, task),
        bars,
        bars_title,
        light.illuminants[0],
    )


def _shown_wavelengths(made: Material, lamps: Sequence[str]) -> Array:
    """Return the wavelengths for curves and ribbon: the search wavelengths.

    For slow wavelengths (aspherical particles): as many final evaluation wavelengths, which are already solved.
    """
    few = search_wavelengths(made, lamps)
    if not is_direct(made.model):
        return few
    fine = evaluation_wavelengths(made, lamps)
    lines = [line for lamp in lamps for line in lamp_lines_nm(lamp)]
    return np.unique([*fine[:: max(1, len(fine) // len(few))], fine[-1], *np.intersect1d(fine, lines)])


def _ribbon(first: Geometry, material: Material) -> tuple[Array, list[Geometry], str]:
    """Return angles, geometries and axis label for the ribbon, from the first target's geometry."""
    if first.kind == "aspecular":
        angles = ASPECULAR_DEG[np.abs(ASPECULAR_DEG - first.theta_deg) < 89.0]
        label = f"Aspecular angle, light from {first.theta_deg:g}\u00b0"
        return angles, [Geometry("aspecular", first.theta_deg, float(a)) for a in angles], label
    angles = RIBBON_DEG if material.model.traits.is_quick else COARSE_DEG
    return angles, [Geometry(first.kind, float(a)) for a in angles], f"Angle of the light, {first.kind} (degrees)"


def _numbers(solution: Solution, task: DesignTask) -> list[str]:
    """Return the parameter values, one per line; lists of tables are expanded to their numbers."""
    lines = []
    for path, value in solution.changes.items():
        if isinstance(value, list | dict) and (inner := numbers_of(value, path)):
            chosen = [each for each in inner if is_chosen(each, solution.changes, task.parameters)]
            lines += [f"{each} = {_short(inner[each])}" for each in chosen]
        else:
            lines.append(f"{path} = {_short(value)}")
    return lines


def _short(value: Any) -> str:
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def _bars(solution: Solution, task: DesignTask) -> tuple[list[tuple[str, float]], str]:
    details = solution.facts.get("yield")
    kind = effect_unit(task.targets)
    unit = {RMS: "rms % ", TEXTURE: "% ", COLOUR: "dE00 "}[kind]
    if details is not None:
        return [(c["path"], c["moves"]) for c in details["costs"]], f"{unit}of one standard deviation"
    effects = solution.facts.get("sensitivity", [])
    count = len([p for p in numbers_of(solution.material.data) if is_chosen(p, solution.changes, task.parameters)])
    part = f"\n({len(effects)} of {count} numbers, in the time)" if 0 < len(effects) < count else ""
    moves = [(s["path"], s[f"{kind}_of_1_percent"]) for s in effects]
    return moves, f"{unit}of a change of 1 %{part}"


def _distance(result: TargetResult) -> str:
    if result.number is not None:
        return f"{result.distance_text} (within {result.target.tolerance:g} %)"
    if result.lamp is None:
        return f"rms {result.distance:.2f} %"
    noise = f" \u00b1 {result.noise:.2f}" if result.noise else ""
    return f"dE00 {result.distance:.2f}{noise} (within {result.target.tolerance:g})"
