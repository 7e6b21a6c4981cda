"""The effect of process errors on a finished design: Monte Carlo over height scale, blur and noise."""

from __future__ import annotations

import base64
import html
import io
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.files import atomic_path, write_text
from nacre.families.relief.surface import Tile, blur_matrix, slopes
from nacre.families.relief.validity import trust
from nacre.light import delta_e_2000, srgb_linear_to_xyz, xyz_to_lab
from nacre.optimise.relief.merit import (
    GAMMA,
    MEASURE_NODE_ERROR,
    Array,
    Evaluator,
    Losses,
    Measurement,
    Problem,
    measure,
)
from nacre.optimise.relief.target import TargetSpec

LIT_SHARE = 0.1  # colour differences count where the target is above this part of its maximum


@dataclass(frozen=True)
class Distribution:
    """One quantity over the draws."""

    nominal: float
    mean: float
    percentile_95: float


@dataclass(frozen=True)
class Robustness:
    """Losses and colour differences over the draws.

    Attributes:
        loss_fixed, loss_free: against the target.
        delta_e: mean CIEDE2000, over the target's lit directions, from the design as drawn to the design as made,
            at the scale of the fixed loss; its nominal value is 0.
        draws: number of draws.
    """

    loss_fixed: Distribution
    loss_free: Distribution
    delta_e: Distribution
    draws: int


def robustness(
    problem: Problem,
    heights_nm: Array,
    *,
    height_error: float = 0.03,
    blur_error: float = 0.1,
    noise: float = 0.05,
    draws: int = 100,
    seed: int = 1,
) -> Robustness:
    """Return losses and colour differences under errors of the process.

    Args:
        problem: what the design was made for.
        heights_nm: `[n, n]`.
        height_error: standard deviation of the factor on all heights.
        blur_error: standard deviation of the factor on the process blur.
        noise: standard deviation of the factor on each height by itself.
        draws: random processes.
        seed: of the draws.
    """
    generator = np.random.default_rng(seed)
    judge = Evaluator(problem, problem.search_upsamplings()[1], node_error=0.1)
    target = problem.target
    lit = target.max(axis=-1) > LIT_SHARE * target.max()
    nominal_rgb, _ = judge.rgb(judge.surface(heights_nm))
    nominal = measure(nominal_rgb, target, problem.intensity_scale)
    reference = _lab(nominal_rgb[lit], nominal.scale_fixed)
    rows = np.empty((draws, 3))
    for k in range(draws):
        scale = 1.0 + height_error * generator.standard_normal()
        widen = max(1.0 + blur_error * generator.standard_normal(), 0.1)
        made = heights_nm * scale * (1.0 + noise * generator.standard_normal(heights_nm.shape))
        blur = blur_matrix(problem.features, judge.upsampling, widen * problem.blur_nm / problem.feature_nm)
        rgb, _ = judge.rgb(judge.surface(made, blur.astype(np.float32)))
        losses = measure(rgb, target, problem.intensity_scale)
        difference = delta_e_2000(_lab(rgb[lit], nominal.scale_fixed), reference)
        rows[k] = losses.fixed, losses.free, float(np.mean(difference))
    means, tops = rows.mean(axis=0), np.percentile(rows, 95, axis=0)
    nominals = (nominal.fixed, nominal.free, 0.0)
    fixed, free, delta = (Distribution(n, float(m), float(t)) for n, m, t in zip(nominals, means, tops))
    return Robustness(fixed, free, delta, draws)


def _lab(rgb: Array, scale: float) -> Array:
    """Return Lab of the colours as displayed: clipped to [0, 1] after the scale, as the loss's gamma sees them."""
    shown = np.clip(scale * np.asarray(rgb, dtype=float), 0.0, 1.0) ** (1.0 / GAMMA)
    return np.asarray(xyz_to_lab(srgb_linear_to_xyz(shown**GAMMA)))


# The report of a design on one page: pictures, losses, spectra, heights, slopes, warnings.

PICTURE_PIXELS = 256  # side of each picture on the page
# where facets begin to shadow each other at the angles of a slice; the scalar model ignores it
STEEP_DEG, VERY_STEEP_DEG = 30.0, 45.0
# draws of the process by the samples along the tile: a second of work at most
DRAWS = ((512, 40), (1024, 12), (4096, 3))
HEIGHT_ERROR, BLUR_ERROR, NOISE = 0.03, 0.1, 0.05


def display(rgb: Array, scale: float) -> Array:
    """Return display-referred colours in [0, 1] of linear ones."""
    return np.clip(np.maximum(scale * rgb, 0.0) ** (1.0 / GAMMA), 0.0, 1.0)


def comparison(problem: Problem, rgb: NDArray[Any], losses: Losses) -> NDArray[np.uint8]:
    """Return target | fixed scale | free scale of the first view and incidence, side by side, `[row, column, 3]`."""
    _, nx, ny, _ = problem.views[0].target.shape
    seen = np.asarray(rgb[: nx * ny], dtype=float).reshape(nx, ny, 3)
    parts = [
        np.clip(problem.views[0].target[0], 0.0, 1.0),
        display(seen, losses.scale_fixed),
        display(seen, losses.scale_free),
    ]
    gap = np.ones((nx, max(ny // 16, 1), 3))
    row = np.concatenate([parts[0], gap, parts[1], gap, parts[2]], axis=1)
    return np.round(255.0 * row).astype(np.uint8)


def write_picture(path: Path, pixels: NDArray[np.uint8], enlarge: int = 4) -> None:
    """Write an 8-bit PNG, each pixel enlarged."""
    from PIL import Image

    big = np.repeat(np.repeat(pixels, enlarge, axis=0), enlarge, axis=1)
    with atomic_path(path) as temporary:
        Image.fromarray(big).save(temporary)


def efficiency(problem: Problem, heights_nm: Array) -> float:
    """Return the share of the incident light that leaves in the target's directions, first view, all wavelengths.

    The integral of f cos(theta_o) over the directions where the target is brighter than a tenth of its maximum.
    """
    view = problem.views[0]
    judge = Evaluator(problem, problem.search_upsamplings()[1], node_error=MEASURE_NODE_ERROR)
    values, _ = judge.plans[0].forward(judge.surface(heights_nm))
    lit = view.target[0].max(axis=-1) > LIT_SHARE * view.target[0].max()
    cell = np.diff(view.geometry.psi_x[:2])[0] * np.diff(view.geometry.psi_y[:2])[0]
    return float(np.mean(values[0][:, lit].sum(axis=-1)) * cell)


def slope_summary(problem: Problem, heights_nm: Array) -> tuple[Array, dict[str, float]]:
    """Return the slope angles of the surface in degrees, and their rms, 99 % point and maximum."""
    upsampling = max(problem.search_upsamplings()[1], 8)
    surface = Tile(heights_nm, problem.feature_nm, problem.blur_nm).surface_nm(upsampling)
    dx, dy = slopes(surface, problem.feature_nm / upsampling)
    angles = np.degrees(np.arctan(np.hypot(dx, dy))).ravel()
    return angles, {
        "slope_rms_deg": float(np.sqrt(np.mean(angles**2))),
        "slope_99_percent_deg": float(np.percentile(angles, 99)),
        "slope_max_deg": float(angles.max()),
    }


def process_spread(problem: Problem, heights_nm: Array) -> Robustness | None:
    """Return the loss that errors of a typical process cause; None where a draw would take long."""
    samples = problem.features * problem.search_upsamplings()[1]
    for most, draws in DRAWS:
        if samples <= most:
            return robustness(
                problem, heights_nm, height_error=HEIGHT_ERROR, blur_error=BLUR_ERROR, noise=NOISE, draws=draws
            )
    return None


def warnings_of(problem: Problem, summary: dict[str, Any], facts: dict[str, float]) -> list[str]:
    """Return what a user should know before making the relief."""
    notes = []
    if facts["slope_99_percent_deg"] > VERY_STEEP_DEG:
        notes.append(
            f"1 % of the surface is steeper than {facts['slope_99_percent_deg']:.0f} degrees: facets shadow each other "
            "and light reflects twice there, which the scalar model ignores. Reduce the height or widen the blur."
        )
    elif facts["slope_99_percent_deg"] > STEEP_DEG:
        notes.append(
            f"1 % of the surface is steeper than {facts['slope_99_percent_deg']:.0f} degrees; expect some shadowing."
        )
    if summary["loss_black"] <= summary["loss_fixed"]:
        notes.append(
            f"At the intensity scale {summary['scale_fixed']:g} an all-black image has a lower loss "
            f"({summary['loss_black']:.4f}) than this design: judge it by the free loss, or change the scale."
        )
    if problem.intensity_scale is None and summary["brightness"] < problem.brightness_floor:
        notes.append(
            f"The design is dark: its brightness {summary['brightness']:.3g} is under the floor of "
            f"{problem.brightness_floor:.3g} (1 / scale). Ask for a smaller picture or a larger height."
        )
    if summary["status"] != "done":
        notes.append(f"The search was stopped ({summary['status']}); resume it to finish.")
    return notes


def write_report(
    path: Path,
    spec: TargetSpec,
    problem: Problem,
    heights_nm: Array,
    measured: Measurement,
    summary: dict[str, Any],
) -> dict[str, Any]:
    """Write a self-contained HTML page; return what it found: efficiency, slopes, robustness, warnings."""
    angles, facts = slope_summary(problem, heights_nm)
    share = efficiency(problem, heights_nm)
    judged = trust(Tile(heights_nm, problem.feature_nm, problem.blur_nm))
    notes = [f"Mind: {judged.line()}."] * judged.is_outside + warnings_of(problem, summary, facts)
    spread = process_spread(problem, heights_nm)
    losses = measured.losses
    shape = problem.views[0].target.shape[1:]
    seen = measured.rgb[: shape[0] * shape[1]].reshape(shape)
    span = max(float(np.ptp(heights_nm)), 1e-9)
    grey = np.repeat(((heights_nm - heights_nm.min()) / span)[..., None], 3, axis=-1)
    pictures = [
        ("target", np.clip(problem.views[0].target[0], 0, 1)),
        (f"achieved, scale {losses.scale_fixed:.4g}: loss {losses.fixed:.5f}", display(seen, losses.scale_fixed)),
        (f"achieved, best scale {losses.scale_free:.4g}: loss {losses.free:.5f}", display(seen, losses.scale_free)),
        (f"heights, 0 to {span / 1e3:.3f} um", grey),
    ]
    rows = {
        "loss, fixed scale": f"{losses.fixed:.5f} (scale {losses.scale_fixed:.4g})",
        "loss, free scale": f"{losses.free:.5f} (scale {losses.scale_free:.4g})",
        "loss of an all-black image": f"{losses.black:.5f}",
        "brightness (1 / scale) at the free scale": f"{1.0 / max(losses.scale_free, 1e-30):.4g}"
        + ("" if problem.intensity_scale else f", floor {problem.brightness_floor:.4g}"),
        "efficiency (share of the light inside the target)": f"{100 * share:.1f} %",
        "slope: rms, 99 %, maximum": f"{facts['slope_rms_deg']:.1f}, {facts['slope_99_percent_deg']:.1f}, "
        f"{facts['slope_max_deg']:.1f} degrees",
        "sampling of the measurement": f"{measured.upsampling} per feature, "
        f"largest phase step {measured.phase_step_rad:.2f} rad",
        "search": f"{summary['seconds']:.1f} s, {summary['evaluations']} evaluations, {spec.search.starts} starts, "
        f"seed {spec.search.seed}, {summary['status']}",
        "tile": f"{problem.features} x {problem.features} features of {problem.feature_nm / 1e3:g} um, "
        f"blur {problem.blur_nm / 1e3:g} um, heights up to {problem.height_max_nm / 1e3:g} um",
    }
    if spread is not None:
        rows |= {
            f"made {spread.draws} times, heights +-{100 * HEIGHT_ERROR:g} %, blur +-{100 * BLUR_ERROR:g} %, "
            f"noise {100 * NOISE:g} %": f"fixed loss mean {spread.loss_fixed.mean:.5f}, 95 % under "
            f"{spread.loss_fixed.percentile_95:.5f}; free loss mean {spread.loss_free.mean:.5f}, 95 % under "
            f"{spread.loss_free.percentile_95:.5f}; dE00 from the design mean {spread.delta_e.mean:.1f}, 95 % under "
            f"{spread.delta_e.percentile_95:.1f}"
        }
    body = [
        "<h1>Relief design</h1>",
        "".join(f'<p class="warning">{html.escape(note)}</p>' for note in notes),
        '<div class="row">' + "".join(_figure(title, image) for title, image in pictures) + "</div>",
        _colours(summary),
        "<table>" + "".join(f"<tr><td>{k}</td><td>{html.escape(v)}</td></tr>" for k, v in rows.items()) + "</table>",
        '<div class="row">',
        _spectra_chart(problem, heights_nm),
        _bar_chart("slope angle, degrees", *np.histogram(angles, bins=np.arange(0.0, 92.0, 2.0))),
        "</div>",
        f"<details><summary>design.json</summary><pre>{html.escape(json.dumps(summary, indent=2))}</pre></details>",
    ]
    write_text(path, _PAGE.replace("BODY", "\n".join(body)))
    found = {"efficiency": share, **facts, "phase_step_rad": measured.phase_step_rad, "warnings": notes}
    found |= {"expected_de00": judged.de00, "outside": judged.line() if judged.is_outside else ""}
    return found if spread is None else {**found, "robustness": asdict(spread)}


def _colours(summary: dict[str, Any]) -> str:
    """Return a table of the colours that were wanted at directions, asked beside reached; nothing where none was."""
    wants = [want for solution in summary.get("solutions", []) for want in solution["targets"] if want.get("asked_lab")]
    rows = [
        f"<tr><td>{html.escape(want['geometry'])}, {html.escape(want['lamp'])}</td>"
        + "".join(
            f'<td><i style="background:{colour}"></i> Lab {", ".join(f"{v:.1f}" for v in lab)}</td>'
            for colour, lab in (
                (want["asked_colour"], want["asked_lab"]),
                (want["reached"]["colour"], want["reached"]["lab"]),
            )
        )
        + f"<td>dE00 {want['de00']:.2f} (within {want['tolerance']:g}){'' if want['met'] else ' (missed)'}</td></tr>"
        for want in wants
    ]
    head = "<tr><th>want</th><th>asked</th><th>reached</th><th>distance</th></tr>"
    return f"<table>{head}{''.join(rows)}</table>" if rows else ""


_PAGE = """<!doctype html><html lang="en"><head><meta charset="utf-8"><title>nacre: relief design</title><style>
body{font:15px/1.5 system-ui,sans-serif;max-width:1180px;margin:2em auto;padding:0 1em;color:#222}
.row{display:flex;flex-wrap:wrap;gap:18px}figure{margin:0}figcaption{font-size:13px;max-width:256px}
img{image-rendering:pixelated;width:256px;height:256px;background:#000}
th{text-align:left}td i{display:inline-block;width:48px;height:18px;vertical-align:middle;border:1px solid #222}
td{padding:2px 18px 2px 0;border-bottom:1px solid #ddd}.warning{background:#fff2cc;padding:8px 12px}
</style></head><body>BODY</body></html>
"""


def _figure(title: str, image: Array) -> str:
    from PIL import Image

    pixels = np.round(255.0 * image).astype(np.uint8)
    factor = max(1, PICTURE_PIXELS // pixels.shape[0])
    stream = io.BytesIO()
    Image.fromarray(np.repeat(np.repeat(pixels, factor, axis=0), factor, axis=1)).save(stream, "PNG")
    data = base64.b64encode(stream.getvalue()).decode()
    return (
        f'<figure><img alt="" src="data:image/png;base64,{data}"><figcaption>{html.escape(title)}</figcaption></figure>'
    )


def _spectra_chart(problem: Problem, heights_nm: Array) -> str:
    """Chart the mean BRDF over the target's directions, and in the mirror direction, against wavelength."""
    view = problem.views[0]
    judge = Evaluator(problem, problem.search_upsamplings()[1], node_error=MEASURE_NODE_ERROR)
    values, _ = judge.plans[0].forward(judge.surface(heights_nm))
    target = view.target[0].max(axis=-1)
    lit = target > LIT_SHARE * target.max()
    centre = np.add.outer(view.geometry.psi_x**2, view.geometry.psi_y**2)
    mirror = centre <= centre.min() * 1.01
    curves = [
        ("inside the target", values[0][:, lit].mean(axis=-1), "#2266cc"),
        ("mirror direction", values[0][:, mirror].mean(axis=-1), "#cc5522"),
    ]
    nm = view.geometry.wavelengths_nm
    top = max(float(c[1].max()) for c in curves) or 1.0
    lines = []
    for k, (name, curve, colour) in enumerate(curves):
        x = 45 + 400 * (nm - nm[0]) / (nm[-1] - nm[0])
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, 200 - 180 * curve / top))
        lines.append(f'<polyline fill="none" stroke="{colour}" stroke-width="2" points="{points}"/>')
        lines.append(f'<text x="60" y="{28 + 16 * k}" fill="{colour}" font-size="13">{name}</text>')
    return _chart(lines, f"{nm[0]:.0f}", f"{nm[-1]:.0f} nm", f"{top:.3g} /sr", "BRDF")


def _bar_chart(title: str, counts: NDArray[Any], edges: Array) -> str:
    top = max(int(counts.max()), 1)
    width = 400 / len(counts)
    bars = [
        f'<rect x="{45 + k * width:.1f}" y="{200 - 180 * c / top:.1f}" width="{width - 1:.1f}" '
        f'height="{180 * c / top:.1f}" fill="#667"/>'
        for k, c in enumerate(counts)
    ]
    return _chart(bars, f"{edges[0]:.0f}", f"{edges[-1]:.0f}", f"{100 * top / max(counts.sum(), 1):.0f} %", title)


def _chart(marks: list[str], left: str, right: str, top: str, title: str) -> str:
    return (
        '<svg width="480" height="250" viewBox="0 0 480 250" font-family="system-ui">'
        '<path d="M45 15V200H450" fill="none" stroke="#999"/>'
        + "".join(marks)
        + f'<text x="40" y="216" font-size="12">{left}</text><text x="400" y="216" font-size="12">{right}</text>'
        f'<text x="2" y="14" font-size="12">{top}</text><text x="180" y="240" font-size="13">{title}</text></svg>'
    )
