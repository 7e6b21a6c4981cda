"""The report of a fit: one HTML file that needs nothing else, with the sheet that a design has too."""

from __future__ import annotations

import html
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from nacre.analysis.fit import Fit, FittedNumber, Measured
from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.core.files import write_text
from nacre.light import delta_e_2000, smooth_weights, spans_colour, swatch_hex, white_xyz, xyz_to_lab
from nacre.optimise.parameters import Parameter
from nacre.plot.html import DPI, data_uri, framed

if TYPE_CHECKING:
    from nacre.plot import DesignSheet, Figure

LIGHT = ("D65", "10deg")
MOST_CURVES = 5  # of a measurement with many angles: those that are furthest off
RIBBON_DEG = np.linspace(0.0, 80.0, 41)
AT_BOUND = 1e-3  # of the bounds
WORDS = ("measured", "fitted")


def write_fit_page(path: str | Path, fit: Fit, measured: Measured, free: Sequence[Parameter]) -> None:
    """Write the report of a fit as HTML: the numbers, what was measured beside what the fitted material gives.

    Args:
        fit, measured, free: of `run_fit`, `read_measurement` and `fit_parameters`.

    Raises:
        NacreError: the file cannot be written, or the fitted material cannot be computed.
    """
    name = fit.material.name
    picture = data_uri(_figure(fit, measured, free), DPI)
    starts = ", ".join(f"{start:.4g}" for start in fit.starts)
    body = [
        f"<h1>{html.escape(name)}, fitted</h1>",
        f'<p class="{"good" if all(n.is_determined for n in fit.numbers) else "far"}">'
        f"{html.escape(_verdict(fit, free))}</p>",
        _numbers(fit.numbers, free),
        f"<p>Relative rms {fit.relative_rms:.4g} over {measured.values.size} values, {fit.evaluations} evaluations. "
        f"The starts ended at {starts}; several equal ones speak for a global minimum.</p>",
        f'<img alt="measured and fitted" src="{picture}">',
        f"<details><summary>the fitted recipe</summary><pre>{html.escape(fit.material.text)}</pre></details>",
    ]
    write_text(Path(path), framed(f"{name}, fitted", body))


def _verdict(fit: Fit, free: Sequence[Parameter]) -> str:
    open_ends = [n.path for n in fit.numbers if not n.is_determined]
    ends = [n.path for n, f in zip(fit.numbers, free, strict=True) if _is_at_bound(n, f)]
    said = [f"{', '.join(open_ends)}: not determined by these data."] if open_ends else ["All numbers are determined."]
    if ends:
        said.append(f"{', '.join(ends)}: at a bound; the best may lie beyond it.")
    return " ".join(said)


def _is_at_bound(number: FittedNumber, free: Parameter) -> bool:
    return min(number.value - free.low, free.high - number.value) <= AT_BOUND * (free.high - free.low)


def _numbers(numbers: Sequence[FittedNumber], free: Sequence[Parameter]) -> str:
    lines = ["<table><tr><th>number</th><th>value</th><th>95 %</th><th>bounds</th><th></th></tr>"]
    for n, f in zip(numbers, free, strict=True):
        half = f"&plusmn; {n.half_width:.3g}" if np.isfinite(n.half_width) else ""
        remark = "" if n.is_determined else "not determined"
        if _is_at_bound(n, f):
            remark = f"{remark}, at a bound".lstrip(", ")
        lines.append(
            f"<tr><td><code>{html.escape(n.path)}</code></td><td>{n.value:.6g}</td><td>{half}</td>"
            f"<td>{f.low:g} to {f.high:g}</td><td>{remark}</td></tr>"
        )
    return "".join([*lines, "</table>"])


def _figure(fit: Fit, measured: Measured, free: Sequence[Parameter]) -> Figure:
    if measured.kind == "spectrum":
        from nacre.plot import design_figure

        return design_figure(_sheet(fit, measured, free))
    from nacre.plot import agreement_figure

    assert measured.gonio is not None
    away = np.degrees(np.arccos(np.clip(np.abs(measured.gonio.wo[:, 2]), 0.0, 1.0)))
    return agreement_figure(
        measured.values, measured.values + fit.residual, away, measured.wavelengths_nm, f"{fit.material.name}, fitted"
    )


def _sheet(fit: Fit, measured: Measured, free: Sequence[Parameter]) -> DesignSheet:
    """Return a spectrum's fit as the sheet of a design: measured for asked, fitted for reached."""
    from nacre.plot import DesignSheet, Swatch

    assert measured.angles_deg is not None
    nm = measured.wavelengths_nm
    is_coloured = spans_colour(nm)
    curves: dict[str, Array] = {}
    wanted: dict[str, Array] = {}
    swatches = []
    off = np.sqrt(np.mean(fit.residual**2, axis=-1))
    far = set(np.argsort(off.ravel())[::-1][:MOST_CURVES].tolist())
    for i, part in enumerate(measured.parts):
        for j, angle in enumerate(measured.angles_deg):
            label = f"{part.replace('_', ' ')}, {angle:g}\u00b0"
            seen = measured.values[i, j]
            made = seen + fit.residual[i, j]
            if is_coloured:
                swatches.append(Swatch(label, *_pair(seen, made, nm)))
            if i * len(measured.angles_deg) + j in far:
                curves[label], wanted[label] = made, np.stack([nm, seen])
    bars = [
        (n.path, 100.0 * n.half_width / (f.high - f.low))
        for n, f in zip(fit.numbers, free, strict=True)
        if np.isfinite(n.half_width)
    ]
    media, thicknesses = fit.material.layers()
    angles, ribbon, label = _ribbon(fit, measured)
    return DesignSheet(
        f"{fit.material.name}: relative rms {fit.relative_rms:.3g}", swatches, nm, curves, wanted, angles, ribbon,
        label, media, thicknesses, [f"{n.path} = {n.value:.5g}" for n in fit.numbers],
        sorted(bars, key=lambda bar: -bar[1]), "95 % half width, per cent of the bounds", LIGHT[0], WORDS,
    )  # fmt: skip


def _pair(seen: Array, made: Array, nm: Array) -> tuple[str, str, str]:
    """Return the screen colours of a measured and of the fitted spectrum, and their distance in words."""
    white = white_xyz(*LIGHT)
    xyz = np.stack([seen, made]) @ smooth_weights(nm, *LIGHT)
    lab = np.asarray(xyz_to_lab(np.clip(xyz, 0.0, None), white))
    return swatch_hex(xyz[0], white), swatch_hex(xyz[1], white), f"dE00 {float(delta_e_2000(lab[0], lab[1])):.2f}"


def _ribbon(fit: Fit, measured: Measured) -> tuple[Array, Array, str]:
    """Return angles and spectra of the first measured part; of what takes long the measured angles alone."""
    part, nm = measured.parts[0], measured.wavelengths_nm
    label = f"Angle of the light, fitted {part.replace('_', ' ')} (degrees)"
    assert measured.angles_deg is not None
    if fit.material.model.traits.is_quick:
        try:
            found = fit.material.spectrum(np.radians(RIBBON_DEG), nm).parts().get(part)
        except NacreError:  # an angle that this family does not answer
            found = None
        if found is not None:
            return RIBBON_DEG, found, label
    values = measured.values[0] + fit.residual[0]
    angles = measured.angles_deg
    if len(angles) == 1:  # a ribbon has a width
        angles, values = angles[0] + np.array([-0.5, 0.5]), np.repeat(values, 2, axis=0)
    return angles, values, label


__all__ = ["write_fit_page"]
