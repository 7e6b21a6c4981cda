"""R or T of one stack and its gradient in the thicknesses, from tables made once for a set of materials.

An optimisation evaluates the same few materials, directions and wavelengths millions of times. The wavevectors and
admittances of all media are therefore tabulated (`StackTables`), and a layer costs one sine, one cosine and one
exponential for both polarisations. The recursion uses reflection coefficients,

    G_j = (t + s X) / (s + t X),   s = q_j + q_{j+1},   t = q_j - q_{j+1},   X = G_{j+1} e^{2 i x},

upward from G = (q_last - q_substrate) / (q_last + q_substrate); only decaying exponentials occur. G_0 is analytic in
each X, with dG_j / dX = 4 q_j q_{j+1} / (s + t X)^2, so one downward pass gives all derivatives at the cost of the
upward pass.
T is the product of |2 q_j / (s + t X)|^2 and |e^{2 i x}|, times Re q_substrate / Re q_0.

`nacre.matter.stack.solve` is the general solver (any angle, grazing, evanescent media, amplitudes); a test compares
the two. A guided wave (s + t X = 0) has no solution here; light from a clear ambient does not excite one.
"""

# mypy: allow-untyped-defs, allow-incomplete-defs

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array, ComplexArray
from nacre.core.errors import NacreError
from nacre.core.jit import compiled
from nacre.matter.stack.kernel import ROUNDER, TWO_PI, TWO_PI_OVER_LN2, cos_half_turn, exp2_minus, sin_half_turn

SAMPLES = 88  # wavelengths per block: rows of 704 bytes, not a power of two, avoid cache-line conflicts
_ROWS = 8  # scratch rows per layer: e^{2ix}, X, dG/dX and, for transmission, t / (s + t X)
NORMAL_COS = 1.0 - 1e-12


class StackTables(NamedTuple):
    """Tabulated media for some wavelengths and directions; medium 0 is the ambient. Made by `stack_tables`.

    Attributes:
        turns_r, turns_i: `[row, medium, wavelength]`, 2 kz / wavelength, per nm: phase e^{2 i x} = e^{2 pi i turns d}.
        q_r, q_i: `[channel, medium, wavelength]`, admittances.
        row: `[channel]`, the row of a channel (a polarisation).
        share: `[channel]`, 1 at normal incidence (s and p coincide), else 1/2.
        first: `[row + 1]`, each row's first channel.
        is_transmitted: `[row]`.
        is_clear: `[medium]`, whether k = 0 at all wavelengths.
    """

    turns_r: Array
    turns_i: Array
    q_r: Array
    q_i: Array
    row: Any
    share: Array
    first: Any
    is_transmitted: Any
    is_clear: Any


def stack_tables(n: ArrayLike, wavelengths_nm: ArrayLike, angles_rad: ArrayLike, sides: Sequence[str]) -> StackTables:
    """Tabulate media for `spectra_and_gradients`.

    Args:
        n: complex `[medium, wavelength]`, k >= 0; medium 0 is the clear ambient.
        wavelengths_nm: `[wavelength]`.
        angles_rad: `[row]`, in the ambient, below pi/2.
        sides: `[row]`, "reflected" or "transmitted" (into the substrate); both unpolarised.

    Raises:
        NacreError: an absorbing ambient, an angle out of range, an unknown side.
    """
    indices: ComplexArray = np.ascontiguousarray(n, dtype=np.complex128)
    wavelengths = np.asarray(wavelengths_nm, dtype=float)
    angles = np.atleast_1d(np.asarray(angles_rad, dtype=float))
    if (np.abs(indices[0].imag) > 0.0).any():
        raise NacreError("the ambient must not absorb")
    if not ((angles >= 0.0) & (angles < 0.5 * np.pi)).all():
        raise NacreError("angles must be from 0 to below 90 degrees")
    if len(sides) != len(angles) or any(side not in ("reflected", "transmitted") for side in sides):
        raise NacreError('each direction needs a side, "reflected" or "transmitted"')
    turns, admittances, row, share, first = [], [], [], [], [0]
    for number, angle in enumerate(angles):
        across = (indices[0] * np.sin(angle)) ** 2
        kz = _decaying_roots(indices**2 - across)
        turns.append(2.0 * kz / wavelengths)
        is_normal = np.cos(angle) >= NORMAL_COS
        admittances.append(kz)
        if not is_normal:
            admittances.append(kz / indices**2)
        channels = 1 if is_normal else 2
        row += [number] * channels
        share += [1.0 / channels] * channels
        first.append(len(row))
    all_turns, all_q = np.array(turns), np.array(admittances)
    return StackTables(
        np.ascontiguousarray(all_turns.real),
        np.ascontiguousarray(all_turns.imag),
        np.ascontiguousarray(all_q.real),
        np.ascontiguousarray(all_q.imag),
        np.array(row),
        np.array(share),
        np.array(first),
        np.array([side == "transmitted" for side in sides]),
        (indices.imag == 0.0).all(axis=1),
    )


def _decaying_roots(kz2: ComplexArray) -> ComplexArray:
    root = np.sqrt(kz2)
    wrong = (root.imag < 0.0) | ((root.imag == 0.0) & (root.real < 0.0))
    return np.where(wrong, -root, root)


def scratch(layers: int) -> Array:
    """Return working memory for stacks with up to `layers` layers."""
    return np.zeros((layers + 3) * _ROWS * SAMPLES)


@compiled(error_model="numpy", fastmath={"contract"})
def _phase(b: Any, turns_r: Any, turns_i: Any, d: float, clear: bool, count: int) -> None:
    """Write a layer's e^{2ix} to the first two rows of its block `b`."""
    if clear:
        for i in range(count):
            turns = turns_r[i] * d
            f = turns - ((turns + ROUNDER) - ROUNDER)
            s = sin_half_turn(f, f * f)
            c = cos_half_turn(f * f)
            b[i] = c * c - s * s
            b[SAMPLES + i] = 2.0 * s * c
    else:
        for i in range(count):
            turns = turns_r[i] * d
            f = turns - ((turns + ROUNDER) - ROUNDER)
            s = sin_half_turn(f, f * f)
            c = cos_half_turn(f * f)
            e = exp2_minus(turns_i[i] * d * TWO_PI_OVER_LN2)
            b[i] = e * (c * c - s * s)
            b[SAMPLES + i] = 2.0 * e * s * c


@compiled(error_model="numpy", fastmath={"contract"})
def _up(b: Any, g: Any, upper_r: Any, upper_i: Any, lower_r: Any, lower_i: Any, count: int) -> None:
    """Carry G (rows `g`) through a layer and the interface above it; store data for the downward pass in block `b`."""
    for i in range(count):
        ar, ai = upper_r[i], upper_i[i]
        br, bi = lower_r[i], lower_i[i]
        er, ei = b[i], b[SAMPLES + i]
        gr, gi = g[i], g[SAMPLES + i]
        xr, xi = gr * er - gi * ei, gr * ei + gi * er
        sr, si, tr, ti = ar + br, ai + bi, ar - br, ai - bi
        dr = sr + tr * xr - ti * xi
        di = si + tr * xi + ti * xr
        over = 1.0 / (dr * dr + di * di)
        vr, vi = dr * over, -di * over
        nr = tr + sr * xr - si * xi
        ni = ti + sr * xi + si * xr
        g[i] = nr * vr - ni * vi
        g[SAMPLES + i] = nr * vi + ni * vr
        b[2 * SAMPLES + i] = xr
        b[3 * SAMPLES + i] = xi
        pr, pi = 4.0 * (ar * br - ai * bi), 4.0 * (ar * bi + ai * br)
        v2r, v2i = vr * vr - vi * vi, 2.0 * vr * vi
        b[4 * SAMPLES + i] = pr * v2r - pi * v2i
        b[5 * SAMPLES + i] = pr * v2i + pi * v2r
        b[6 * SAMPLES + i] = tr * vr - ti * vi
        b[7 * SAMPLES + i] = tr * vi + ti * vr
        # |2 q / (s + t X)|^2 |e^{2ix}|, a factor of T
        g[2 * SAMPLES + i] *= 4.0 * (ar * ar + ai * ai) * over * np.sqrt(er * er + ei * ei)


@compiled(error_model="numpy", fastmath={"contract"})
def _down(b: Any, a: Any, turns_r: Any, turns_i: Any, share: float, gradients: Any, count: int) -> None:
    """Carry dR/dG (rows `a`) down through an interface and a layer; add the layer's derivative."""
    factor = -TWO_PI * share
    for i in range(count):
        ar, ai = a[i], a[SAMPLES + i]
        dr, di = b[4 * SAMPLES + i], b[5 * SAMPLES + i]
        br, bi = ar * dr - ai * di, ar * di + ai * dr
        xr, xi = b[2 * SAMPLES + i], b[3 * SAMPLES + i]
        cr, ci = br * xr - bi * xi, br * xi + bi * xr
        kr, ki = turns_r[i], turns_i[i]
        gradients[i] += factor * (cr * ki + ci * kr)
        er, ei = b[i], b[SAMPLES + i]
        a[i] = br * er - bi * ei
        a[SAMPLES + i] = br * ei + bi * er


@compiled(error_model="numpy", fastmath={"contract"})
def _down_transmitted(b: Any, a: Any, turns_r: Any, turns_i: Any, share: float, gradients: Any, count: int) -> None:
    """As `_down`, for T, whose value is in the row after `a`'s two."""
    for i in range(count):
        ar, ai = a[i], a[SAMPLES + i]
        dr, di = b[4 * SAMPLES + i], b[5 * SAMPLES + i]
        passed = a[2 * SAMPLES + i]
        br = ar * dr - ai * di - 2.0 * passed * b[6 * SAMPLES + i]
        bi = ar * di + ai * dr - 2.0 * passed * b[7 * SAMPLES + i]
        xr, xi = b[2 * SAMPLES + i], b[3 * SAMPLES + i]
        cr, ci = br * xr - bi * xi, br * xi + bi * xr
        kr, ki = turns_r[i], turns_i[i]
        gradients[i] -= TWO_PI * share * (cr * ki + ci * kr + passed * ki)
        er, ei = b[i], b[SAMPLES + i]
        a[i] = br * er - bi * ei
        a[SAMPLES + i] = br * ei + bi * er


@compiled(error_model="numpy", fastmath={"contract"})
def _bottom(g: Any, upper_r: Any, upper_i: Any, lower_r: Any, lower_i: Any, q_0: Any, count: int) -> None:
    """Start in the substrate: G at the last interface, and the first factors of T."""
    for i in range(count):
        ar, ai = upper_r[i], upper_i[i]
        br, bi = lower_r[i], lower_i[i]
        sr, si = ar + br, ai + bi
        over = 1.0 / (sr * sr + si * si)
        tr, ti = ar - br, ai - bi
        g[i] = (tr * sr + ti * si) * over
        g[SAMPLES + i] = (ti * sr - tr * si) * over
        g[2 * SAMPLES + i] = 4.0 * (ar * ar + ai * ai) * over * max(br, 0.0) / q_0[i]


@compiled(error_model="numpy", fastmath={"contract"})
def _top(a: Any, g: Any, seen: Any, share: float, is_transmitted: bool, count: int) -> None:
    """Add a channel's R or T to a spectrum, and start the downward pass."""
    if is_transmitted:
        for i in range(count):
            passed = g[2 * SAMPLES + i]
            seen[i] += share * passed
            a[i] = a[SAMPLES + i] = 0.0
            a[2 * SAMPLES + i] = passed
    else:
        for i in range(count):
            gr, gi = g[i], g[SAMPLES + i]
            seen[i] += share * (gr * gr + gi * gi)
            a[i] = 2.0 * gr
            a[SAMPLES + i] = -2.0 * gi


@compiled(error_model="numpy", fastmath={"contract"}, nogil=True)
def spectra_and_gradients(tables, media, thicknesses, layers, substrate, with_gradients, w, spectra, gradients):
    """Fill R or T of one stack, and the derivatives in the thicknesses.

    Args:
        tables: `StackTables`.
        media: indices of the layers' media in the tables, from the top, `[>= layers]`.
        thicknesses: `[>= layers]`, nm.
        layers: layer count; 0 is a bare substrate.
        substrate: index of its medium.
        with_gradients: whether `gradients` is filled.
        w: memory from `scratch(layers or more)`.
        spectra: output `[row, wavelength]`.
        gradients: output `[row, >= layers, wavelength]`, per nm.
    """
    turns_r, turns_i, q_r, q_i = tables.turns_r, tables.turns_i, tables.q_r, tables.q_i
    rows, _, total = turns_r.shape
    size = _ROWS * SAMPLES
    # slices rather than offsets: numba then excludes negative indices, and the loops vectorise
    g, a = w[layers * size : (layers + 1) * size], w[(layers + 1) * size : (layers + 2) * size]
    for start in range(0, total, SAMPLES):
        stop = min(start + SAMPLES, total)
        count = stop - start
        for row in range(rows):
            seen = spectra[row, start:stop]
            for j in range(layers):
                m = media[j]
                b = w[j * size : (j + 1) * size]
                kr, ki = turns_r[row, m, start:stop], turns_i[row, m, start:stop]
                _phase(b, kr, ki, thicknesses[j], tables.is_clear[m], count)
                if with_gradients:
                    gradients[row, j, start:stop] = 0.0
            seen[:] = 0.0
            for channel in range(tables.first[row], tables.first[row + 1]):
                share = tables.share[channel]
                qr, qi = q_r[channel], q_i[channel]
                last = media[layers - 1] if layers > 0 else 0
                _bottom(
                    g, qr[last, start:stop], qi[last, start:stop], qr[substrate, start:stop],
                    qi[substrate, start:stop], qr[0, start:stop], count,
                )  # fmt: skip
                for j in range(layers - 1, -1, -1):
                    upper, m = media[j - 1] if j > 0 else 0, media[j]
                    _up(
                        w[j * size : (j + 1) * size], g, qr[upper, start:stop], qi[upper, start:stop],
                        qr[m, start:stop], qi[m, start:stop], count,
                    )  # fmt: skip
                _top(a, g, seen, share, tables.is_transmitted[row], count)
                if with_gradients:
                    for j in range(layers):
                        m = media[j]
                        b = w[j * size : (j + 1) * size]
                        kr, ki = turns_r[row, m, start:stop], turns_i[row, m, start:stop]
                        if tables.is_transmitted[row]:
                            _down_transmitted(b, a, kr, ki, share, gradients[row, j, start:stop], count)
                        else:
                            _down(b, a, kr, ki, share, gradients[row, j, start:stop], count)
