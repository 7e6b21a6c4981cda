"""Compiled merit function: residuals of stack spectra and their derivatives by its thicknesses.

Numba version of `nacre.optimise.merit` for the thin-film search: a call takes microseconds. A test compares both.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from nacre.core.arrays import Array
from nacre.core.jit import compiled
from nacre.optimise.merit import KINDS, MEAN_SHARE, MeritFunction, Operand

COLOUR, HUE, CHROMA, LIGHTNESS, SPECTRUM = range(len(KINDS))
UNSPECIFIED = -1.0
STEP = 1e-5  # step in Lab for forward differences
HUE_MARGIN = 4.0  # degrees per dE00, at a chroma of some 40
SOFT = 0.08  # width over which failures are smoothed, as a fraction of the tolerance
RADIANS = math.pi / 180.0


class CompiledMerit(NamedTuple):
    """`MeritFunction` as arrays; its terms are sorted by row and lamp.

    Attributes:
        weights: `[lamp, 3, wavelength]`.
        whites: `[lamp, 3]`.
        kind, row, lamp: `[term]`.
        lab: `[term, 3]`.
        low, high: `[term]`, infinite where open.
        scale, weight: `[term]`, weight / tolerance, and the weight: a scaled distance above it is out of tolerance.
        wanted: `[term, wavelength]`, of spectra; negative if unspecified.
        residuals: `[1]`, their number.
    """

    weights: Array
    whites: Array
    kind: Any
    row: Any
    lamp: Any
    lab: Array
    low: Array
    high: Array
    scale: Array
    weight: Array
    wanted: Array
    residuals: Any


def compile_merit(merit: MeritFunction, margin: float = 0.0) -> CompiledMerit:
    """Return the arrays for `evaluate`.

    Args:
        margin: fraction of the tolerance by which ranges are narrowed (at most by a tenth), so that descents that
            stop near a bound end inside.
    """
    order = sorted(
        range(len(merit.terms)),
        key=lambda t: (merit.operands[merit.terms[t][0]].row, merit.terms[t][1], merit.terms[t]),
    )
    chosen = [(merit.operands[merit.terms[t][0]], merit.terms[t][1], t) for t in order]
    ranges = [_narrowed(goal, margin) for goal, _, _ in chosen]
    samples = len(merit.wavelengths_nm)
    wanted, shares = np.zeros((len(chosen), samples)), np.ones(len(chosen))
    sizes = {"colour": 3, "spectrum": samples}
    for i, (goal, _, _) in enumerate(chosen):
        if goal.reflectance is not None:
            is_specified = np.isfinite(goal.reflectance)
            wanted[i] = np.where(is_specified, goal.reflectance, UNSPECIFIED)
            shares[i] = np.sqrt(samples / is_specified.sum())
    return CompiledMerit(
        np.ascontiguousarray(np.swapaxes(merit.colour_weights, 1, 2)),
        merit.whites,
        np.array([KINDS.index(goal.kind) for goal, _, _ in chosen]),
        np.array([goal.row for goal, _, _ in chosen]),
        np.array([lamp for _, lamp, _ in chosen]),
        np.ascontiguousarray(merit.lab[order]),
        np.array([ends[0] for ends in ranges]),
        np.array([ends[1] for ends in ranges]),
        np.ascontiguousarray(merit.scale[order] * shares),
        np.array([goal.weight for goal, _, _ in chosen]),
        wanted,
        np.array([sum(sizes.get(goal.kind, 1) for goal, _, _ in chosen)]),
    )


def _narrowed(goal: Operand, margin: float) -> tuple[float, float]:
    low = -np.inf if goal.low is None else float(goal.low)
    high = np.inf if goal.high is None else float(goal.high)
    by = margin * goal.tolerance
    if goal.kind == "hue":
        width = high - low if high - low >= 360.0 else (high - low) % 360.0
        by = min(HUE_MARGIN * by, 0.1 * width)
        return (low, high) if width >= 360.0 else (low + by, low + width - by)
    if goal.kind == "chroma":
        by *= 1.0 + 0.045 * (low if np.isfinite(low) else high)  # dE00 divides chroma differences by this factor
    by = min(by, 0.1 * (high - low))
    return low + by, high - by


@compiled(error_model="numpy")
def components(l1: float, a1: float, b1: float, l2: float, a2: float, b2: float) -> tuple[float, float, float]:
    """Return three numbers whose length is the dE00 of two colours, as `light.delta_e_2000_components`."""
    c1, c2 = math.sqrt(a1 * a1 + b1 * b1), math.sqrt(a2 * a2 + b2 * b2)
    mean = 0.5 * (c1 + c2)
    mean7 = mean * mean * mean * mean * mean * mean * mean
    stretch = 1.5 - 0.5 * math.sqrt(mean7 / (mean7 + 6103515625.0))
    a1, a2 = a1 * stretch, a2 * stretch
    c1, c2 = math.sqrt(a1 * a1 + b1 * b1), math.sqrt(a2 * a2 + b2 * b2)
    h1, h2 = math.atan2(b1, a1), math.atan2(b2, a2)
    turn = h2 - h1
    if turn > math.pi:
        turn -= 2.0 * math.pi
    elif turn < -math.pi:
        turn += 2.0 * math.pi
    if c1 * c2 == 0.0:
        turn = 0.0
    hue = h2 if c1 == 0.0 else h1 + 0.5 * turn
    chroma, off = 0.5 * (c1 + c2), 0.5 * (l1 + l2) - 50.0
    weight = (
        1.0
        - 0.17 * math.cos(hue - 30.0 * RADIANS)
        + 0.24 * math.cos(2.0 * hue)
        + 0.32 * math.cos(3.0 * hue + 6.0 * RADIANS)
        - 0.20 * math.cos(4.0 * hue - 63.0 * RADIANS)
    )
    x = (l2 - l1) / (1.0 + 0.015 * off * off / math.sqrt(20.0 + off * off))
    y = (c2 - c1) / (1.0 + 0.045 * chroma)
    z = 2.0 * math.sqrt(c1 * c2) * math.sin(0.5 * turn) / (1.0 + 0.015 * chroma * weight)
    degrees = hue / RADIANS
    if degrees < 0.0:
        degrees += 360.0
    from_blue = (degrees - 275.0) / 25.0
    blue = 0.0
    if from_blue * from_blue < 40.0:
        c7 = chroma * chroma * chroma * chroma * chroma * chroma * chroma
        blue = -2.0 * math.sqrt(c7 / (c7 + 6103515625.0)) * math.sin(60.0 * RADIANS * math.exp(-from_blue * from_blue))
    return x, y + 0.5 * blue * z, z * math.sqrt(1.0 - 0.25 * blue * blue)


@compiled(error_model="numpy")
def _parts(merit: Any, t: int, l: float, a: float, b: float) -> tuple[float, float, float]:
    """Return the components of the colour difference from a target colour, or from the nearest colour in a range."""
    kind, low, high = merit.kind[t], merit.low[t], merit.high[t]
    wl, wa, wb = merit.lab[t, 0], merit.lab[t, 1], merit.lab[t, 2]
    if kind == LIGHTNESS:
        wl, wa, wb = min(max(l, low), high), a, b
    elif kind == CHROMA:
        chroma = math.sqrt(a * a + b * b)
        clipped = min(max(chroma, low), high)
        wl, wa, wb = l, clipped, 0.0
        if chroma > 0.0:
            wa, wb = clipped * (a / chroma), clipped * (b / chroma)
    elif kind == HUE:
        width = high - low
        if width < 360.0:
            width = width % 360.0
        above = (math.atan2(b, a) / RADIANS - low) % 360.0
        chroma = math.sqrt(a * a + b * b)
        end = high if above - width <= 360.0 - above else low
        wl, wa, wb = l, chroma * math.cos(end * RADIANS), chroma * math.sin(end * RADIANS)
        if above <= width:
            wa, wb = a, b
    return components(wl, wa, wb, l, a, b)


@compiled(error_model="numpy", fastmath={"contract", "reassoc"})
def _dot(a: Any, b: Any, count: int) -> float:
    total = 0.0
    for i in range(count):
        total += a[i] * b[i]
    return total


@compiled(error_model="numpy")
def _f(ratio: float) -> tuple[float, float]:
    """Return the CIELAB function f and its derivative."""
    if ratio > 216.0 / 24389.0:
        root = math.exp(math.log(ratio) / 3.0)
        return root, root / (3.0 * ratio)
    return (24389.0 / 27.0 * ratio + 16.0) / 116.0, 24389.0 / 27.0 / 116.0


@compiled(error_model="numpy")
def lab_of(merit: Any, spectrum: Any, lamp: int) -> tuple[float, float, float]:
    """Return CIELAB of a spectrum under a lamp."""
    count = spectrum.shape[0]
    fx, _ = _f(_dot(merit.weights[lamp, 0], spectrum, count) / merit.whites[lamp, 0])
    fy, _ = _f(_dot(merit.weights[lamp, 1], spectrum, count) / merit.whites[lamp, 1])
    fz, _ = _f(_dot(merit.weights[lamp, 2], spectrum, count) / merit.whites[lamp, 2])
    return 116.0 * fy - 16.0, 500.0 * (fx - fy), 200.0 * (fy - fz)


@compiled(error_model="numpy")
def _spectrum_term(
    merit: Any, t: int, at: int, spectra: Any, slopes: Any, layers: int, with_gradients: bool, r: Any, jacobian: Any
) -> float:
    """Fill residuals and Jacobian of a spectrum from row `at` on; return its scaled distance."""
    row, count = merit.row[t], spectra.shape[1]
    share = merit.scale[t] * 100.0 / math.sqrt(count)
    total = 0.0
    for i in range(count):
        off = share * (spectra[row, i] - merit.wanted[t, i]) if merit.wanted[t, i] >= 0.0 else 0.0
        total += off * off
        r[at + i] = off
    if with_gradients:
        for j in range(layers):
            for i in range(count):
                jacobian[at + i, j] = share * slopes[row, j, i] if merit.wanted[t, i] >= 0.0 else 0.0
    return math.sqrt(total)


@compiled(error_model="numpy")
def _lab(
    merit: Any, row: int, lamp: int, spectra: Any, slopes: Any, layers: int, with_gradients: bool, lab: Any,
    by_layer: Any,
) -> None:  # fmt: skip
    """Fill CIELAB `lab[3]` of a row under a lamp and its derivatives `by_layer[3, layer]`."""
    count = spectra.shape[1]
    f, slope = np.empty(3), np.empty(3)
    for c in range(3):
        f[c], slope[c] = _f(_dot(merit.weights[lamp, c], spectra[row], count) / merit.whites[lamp, c])
        slope[c] /= merit.whites[lamp, c]
    lab[0], lab[1], lab[2] = 116.0 * f[1] - 16.0, 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2])
    if with_gradients:
        for j in range(layers):
            x = slope[0] * _dot(merit.weights[lamp, 0], slopes[row, j], count)
            y = slope[1] * _dot(merit.weights[lamp, 1], slopes[row, j], count)
            z = slope[2] * _dot(merit.weights[lamp, 2], slopes[row, j], count)
            by_layer[0, j], by_layer[1, j], by_layer[2, j] = 116.0 * y, 500.0 * (x - y), 200.0 * (y - z)


@compiled(error_model="numpy")
def _colour_term(
    merit: Any, t: int, at: int, lab: Any, by_layer: Any, layers: int, with_gradients: bool, r: Any, jacobian: Any
) -> float:
    """Fill residuals and Jacobian of a colour or range from row `at` on; return its scaled distance."""
    scale = merit.scale[t]
    is_colour = merit.kind[t] == COLOUR
    base, by_lab = np.empty(3), np.empty((3, 3))
    distance = 0.0
    # a single call of the formula: numba inlines every call and would compile for minutes
    for k in range(4 if with_gradients else 1):
        moved_l = lab[0] + STEP if k == 1 else lab[0]
        moved_a = lab[1] + STEP if k == 2 else lab[1]
        moved_b = lab[2] + STEP if k == 3 else lab[2]
        x, y, z = _parts(merit, t, moved_l, moved_a, moved_b)
        if not is_colour:
            x = math.sqrt(x * x + y * y + z * z)
            y = z = 0.0
        if k == 0:
            distance = scale * math.sqrt(x * x + y * y + z * z)
            base[0], base[1], base[2] = x, y, z
        else:
            by_lab[0, k - 1] = scale * (x - base[0]) / STEP
            by_lab[1, k - 1] = scale * (y - base[1]) / STEP
            by_lab[2, k - 1] = scale * (z - base[2]) / STEP
    for c in range(3 if is_colour else 1):
        r[at + c] = scale * base[c]
        for j in range(layers if with_gradients else 0):
            jacobian[at + c, j] = (
                by_lab[c, 0] * by_layer[0, j] + by_lab[c, 1] * by_layer[1, j] + by_lab[c, 2] * by_layer[2, j]
            )
    return distance


@compiled(error_model="numpy", nogil=True)
def evaluate(
    merit: Any, spectra: Any, slopes: Any, layers: int, with_gradients: bool, r: Any, jacobian: Any, u: Any
) -> None:
    """Fill the residuals `r`, their Jacobian `[residual, layer]` and the scaled distances `u[term]`.

    Distances to ranges are the smooth ones, which agree with the exact ones if they are small.

    Args:
        merit: `CompiledMerit`.
        spectra: `[row, wavelength]`.
        slopes: `[row, layer, wavelength]`, read only `with_gradients`.
    """
    at = 0
    last_row, last_lamp = -1, -1
    lab, by_layer = np.empty(3), np.empty((3, max(layers, 1)))
    for t in range(merit.kind.shape[0]):
        row, lamp = merit.row[t], merit.lamp[t]
        if merit.kind[t] == SPECTRUM:
            u[t] = _spectrum_term(merit, t, at, spectra, slopes, layers, with_gradients, r, jacobian)
            at += spectra.shape[1]
            continue
        if row != last_row or lamp != last_lamp:
            _lab(merit, row, lamp, spectra, slopes, layers, with_gradients, lab, by_layer)
            last_row, last_lamp = row, lamp
        u[t] = _colour_term(merit, t, at, lab, by_layer, layers, with_gradients, r, jacobian)
        at += 3 if merit.kind[t] == COLOUR else 1


@compiled(error_model="numpy")
def objective(u: Any) -> float:
    """Return the objective of scaled distances, as `MeritFunction.objective`."""
    worst, total = 0.0, 0.0
    for t in range(u.shape[0]):
        worst = max(worst, u[t])
        total += u[t]
    return worst + MEAN_SHARE * total / u.shape[0]


@compiled(error_model="numpy", fastmath={"contract", "reassoc"})
def failure_share(merit: Any, r: Any, jacobian: Any, layers: int, sigma: Any, draws: Any) -> float:
    """Return the smoothed share of manufactured stacks out of tolerance, by the linear model at the nominal stack.

    Args:
        sigma: `[>= layers]`, standard deviations, nm.
        draws: `[draw, >= layers]`, standard normal numbers, the same for every stack.
    """
    missed = 0.0
    for k in range(draws.shape[0]):
        worst = 0.0
        at = 0
        for t in range(merit.kind.shape[0]):
            kind = merit.kind[t]
            size = 3 if kind == COLOUR else (merit.wanted.shape[1] if kind == SPECTRUM else 1)
            total = 0.0
            for c in range(at, at + size):
                moved = r[c]
                for j in range(layers):
                    moved += jacobian[c, j] * sigma[j] * draws[k, j]
                total += moved * moved
            worst = max(worst, math.sqrt(total) / max(merit.weight[t], 1e-9))
            at += size
        missed += 1.0 / (1.0 + math.exp(-min(max((worst - 1.0) / SOFT, -50.0), 50.0)))
    return missed / draws.shape[0]
