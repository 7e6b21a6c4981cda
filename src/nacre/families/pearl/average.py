"""The numba kernels that average a platelet's R and T over its substrate thickness.

With the substrate split off, r = r_A + C y/(1 - rho y) and |t|^2 = |t_A t_B|^2 |y| / |1 - rho y|^2, where
y = exp(i p tau) and p = 2 k0 kz_s. For a lossless substrate below its critical angle (p real) the geometric
series turns the average over tau into sums of Y_m = <y^m>, the characteristic function of the thickness:

    S1 = sum rho^m Y_m,  S2 = sum rho^(m-1) Y_m,  A = (1 + 2 Re S1) / (1 - |rho|^2)
    <R> = |r_A|^2 + 2 Re(conj(r_A) C S2) + |C|^2 A,   <T> = |t_A t_B|^2 A

For complex p the series does not factorise; there the integrand is damped and a quadrature in tau converges.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from nacre.matter.jit import compiled

MAX_TERMS = 4000
GAUSSIAN, TABULATED = 0, 1
RHO_FLOOR = 1e-15
SHORT_PHASE = 0.7  # rad over the support: near the critical angle the series dies too slowly, the integrand is smooth
POINTS_PER_PANEL = 16
SAME_WIDTH = 1e-12
PANEL_PER_DISTANCE = 2.4  # 16 Gauss points on a panel 2.4 pole distances wide leave about 1e-11


@compiled(error_model="numpy")
def _interpolate(table: Any, position: float) -> complex:
    """Six-point Lagrange interpolation on a uniform grid that starts at 0; mirrored (conjugate) below 0."""
    last = table.shape[0] - 1
    if position >= last - 2:
        return 0.0j
    base = int(position)
    f = position - base
    a, b, c, d, e = f + 2.0, f + 1.0, f - 1.0, f - 2.0, f - 3.0
    cde = c * d * e
    low = a * b * f
    first = table[base - 2] if base >= 2 else table[2 - base].conjugate()
    second = table[base - 1] if base >= 1 else table[1 - base].conjugate()
    return (
        (-b * f * cde / 120.0) * first
        + (a * f * cde / 24.0) * second
        + (-a * b * cde / 12.0) * table[base]
        + (low * d * e / 12.0) * table[base + 1]
        + (-low * c * e / 24.0) * table[base + 2]
        + (low * c * d / 120.0) * table[base + 3]
    )


@compiled(error_model="numpy")
def _series(rho: complex, p: float, kind: int, mean: float, deviation: float, table: Any, step: float) -> Any:
    """Return S1, S2. `mean` is the centre about which `table` is stored."""
    size = abs(rho)
    s1, s2 = 0.0j, 0.0j
    power = 1.0 + 0.0j
    rotation = complex(math.cos(p * mean), math.sin(p * mean))
    phase = 1.0 + 0.0j
    magnitude = 1.0
    limit = table.shape[0] * step
    for m in range(1, MAX_TERMS + 1):
        x = m * p
        phase *= rotation
        if kind == GAUSSIAN:
            damping = 0.5 * (x * deviation) ** 2
            if damping > 36.0:
                break
            average = phase * math.exp(-damping)
        else:
            if x > limit:
                break
            average = phase * _interpolate(table, x / step)
        s2 += power * average
        power *= rho
        s1 += power * average
        magnitude *= size
        if magnitude < 1e-17:
            break
    return s1, s2


@compiled(error_model="numpy", inline="always")
def _wave(p: complex, tau: float) -> complex:
    """exp(i p tau)."""
    x = p.real * tau
    return complex(math.cos(x), math.sin(x)) * math.exp(-p.imag * tau)


@compiled(error_model="numpy")
def _point(big_c: complex, r_a: complex, transfer: float, rho: complex, y: complex) -> Any:
    """R and T of one thickness."""
    denominator = 1.0 - rho * y
    over = 1.0 / (denominator.real * denominator.real + denominator.imag * denominator.imag)
    r = r_a + big_c * y * complex(denominator.real * over, -denominator.imag * over)
    return r.real * r.real + r.imag * r.imag, transfer * math.sqrt(y.real * y.real + y.imag * y.imag) * over


@compiled(error_model="numpy")
def _pole_distance(rho: complex, p: complex, low: float, high: float) -> float:
    """Distance from [low, high] to the nearest complex thickness at which rho exp(i p tau) = 1.

    A Gauss rule on a panel converges as fast as the panel is short against this distance.
    """
    if abs(rho) < 1e-6:
        return high - low
    log = 1j * np.log(rho)
    nearest = high - low
    first = int(math.floor(p.real * low / (2.0 * math.pi))) - 1
    last = int(math.ceil(p.real * high / (2.0 * math.pi))) + 1
    for m in range(first, last + 1):
        pole = (2.0 * math.pi * m + log) / p
        beyond = max(low - pole.real, pole.real - high, 0.0)
        nearest = min(nearest, math.sqrt(beyond * beyond + pole.imag * pole.imag))
    return max(nearest, 1e-6 * (high - low))


@compiled(error_model="numpy", nogil=True)
def average_platelet(
    p: Any, r_a: Any, big_c: Any, rho: Any, transfer: Any, is_fixed: bool, kind: int, mean: float, deviation: float,
    table: Any, step: float, low: float, high: float, nodes: Any, weights: Any, starts: Any, out_r: Any, out_t: Any,
    first_point: int, last_point: int,
) -> None:  # fmt: skip
    """Fill <R> and <T> of the points first_point..last_point, so that threads can share the work.

    Args:
        p: complex `[point]`, 2 k0 kz of the substrate, 1/nm; shared by both polarisations.
        r_a, big_c, rho: complex `[polarisation, point]`: r_A, t_A t_A' r_B and r_A' r_B.
        transfer: `[polarisation, point]`, |t_A t_B|^2.
        is_fixed: one thickness `mean` for all.
        kind: GAUSSIAN (closed form in `mean`, `deviation`) or TABULATED (`table` about `mean`, step `step`).
        low, high: support of the distribution, nm.
        nodes, weights, starts: quadrature ladder, set i in starts[i]:starts[i + 1], ascending in size by two.
        out_r, out_t: output `[polarisation, point]`.
    """
    levels = starts.shape[0] - 1
    inside, shared_width = np.empty(POINTS_PER_PANEL, np.complex128), 0.0
    for i in range(first_point, last_point):
        for pol in range(r_a.shape[0]):
            reflection = rho[pol, i]
            if is_fixed:
                y = _wave(p[i], mean)
                out_r[pol, i], out_t[pol, i] = _point(big_c[pol, i], r_a[pol, i], transfer[pol, i], reflection, y)
                continue
            size = min(abs(reflection), 1.0 - RHO_FLOOR)
            if p[i].imag == 0.0 and p[i].real * (high - low) > SHORT_PHASE:
                s1, s2 = _series(reflection, p[i].real, kind, mean, deviation, table, step)
                r0, c0 = r_a[pol, i], big_c[pol, i]
                airy = (1.0 + 2.0 * s1.real) / (1.0 - size * size)
                cross = (r0.conjugate() * c0 * s2).real
                out_r[pol, i] = (
                    r0.real * r0.real + r0.imag * r0.imag + 2.0 * cross + (c0.real * c0.real + c0.imag * c0.imag) * airy
                )
                out_t[pol, i] = transfer[pol, i] * airy
                continue
            panels = (high - low) / (PANEL_PER_DISTANCE * _pole_distance(reflection, p[i], low, high)) + 8.0
            level = 0
            while level < levels - 1 and starts[level + 1] - starts[level] < POINTS_PER_PANEL * panels:
                level += 1
            total_r, total_t = 0.0, 0.0
            for panel in range(starts[level], starts[level + 1], POINTS_PER_PANEL):
                # panels of equal width share exp(ip (tau - tau_first)), so that a node costs a product
                width = nodes[panel + POINTS_PER_PANEL - 1] - nodes[panel]
                if panel == starts[level] or abs(width - shared_width) > SAME_WIDTH * width:
                    shared_width = width
                    for k in range(POINTS_PER_PANEL):
                        inside[k] = _wave(p[i], nodes[panel + k] - nodes[panel])
                first = _wave(p[i], nodes[panel])
                for k in range(POINTS_PER_PANEL):
                    r, t = _point(big_c[pol, i], r_a[pol, i], transfer[pol, i], reflection, first * inside[k])
                    total_r += weights[panel + k] * r
                    total_t += weights[panel + k] * t
            out_r[pol, i] = total_r
            out_t[pol, i] = total_t
