"""Angles of narrow resonances: light that circulates in a layer between boundaries of nearly total reflection.

A wave in layer j returns to itself after the round trip g = r_up r_down exp(2 i kz d), with the amplitude reflectances
of the stacks above and below it. Guided and leaky modes and fringes of high finesse lie at arg g = 0 with |g| near 1.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array, ComplexArray
from nacre.matter.stack.inputs import decaying_root

LEAST_ROUND_TRIP = 0.9  # |g| of weaker resonances, which are wide
SECANT_STEPS = 6
MOST_RESONATORS = 6  # layers of largest optical thickness


def narrow_resonances(n: ComplexArray, thicknesses_nm: Array, wavelengths_nm: Array, kappa: Array) -> Array:
    """Return kx/k0 of narrow resonances at each wavelength, as pairs `[found, 2]`: index of the wavelength, kx/k0.

    Args:
        n: `[medium, wavelength]`, first and last medium included.
        thicknesses_nm: `[layer]`.
        wavelengths_nm: `[wavelength]`.
        kappa: `[sample, wavelength]`, ascending kx/k0 that bracket the resonances.
    """
    found = []
    waves = np.broadcast_to(np.arange(len(wavelengths_nm)), kappa.shape)
    optical = thicknesses_nm * n[1:-1].real.mean(axis=1)
    for layer, p_polarised in product(np.argsort(-optical)[:MOST_RESONATORS].tolist(), (0, 1)):

        def turn(at: Array, wave: ArrayLike, layer: int = layer, p_polarised: int = p_polarised) -> ComplexArray:
            own = np.asarray(wave)
            return _round_trip(n[:, own], thicknesses_nm, wavelengths_nm[own], at, layer, bool(p_polarised))

        g = turn(kappa, waves)
        crosses = (g.imag[:-1] * g.imag[1:] <= 0.0) & (g.real[:-1] + g.real[1:] > 0.0)
        strong = np.maximum(np.abs(g[:-1]), np.abs(g[1:])) > LEAST_ROUND_TRIP
        rows, columns = np.nonzero(crosses & strong)
        low, high = kappa[rows, columns], kappa[rows + 1, columns]
        below, above = g.imag[rows, columns], g.imag[rows + 1, columns]
        for step in range(SECANT_STEPS):
            share = below / np.where(below == above, 1.0, below - above)
            at = low + (high - low) * (np.clip(share, 0.02, 0.98) if step % 3 else 0.5)
            here = turn(at, columns).imag
            is_left = here * below > 0.0
            low, below = np.where(is_left, at, low), np.where(is_left, here, below)
            high, above = np.where(is_left, high, at), np.where(is_left, above, here)
        share = below / np.where(below == above, 1.0, below - above)
        found.append(np.stack([columns, low + (high - low) * np.clip(share, 0.0, 1.0)], axis=-1))
    return np.concatenate(found) if found else np.zeros((0, 2))


def _round_trip(
    n: ComplexArray, thicknesses_nm: Array, wavelengths_nm: Array, kappa: Array, layer: int, p_polarised: bool
) -> ComplexArray:
    """Return g of one layer; `n` is `[medium, *shape of kappa]`."""
    medium = layer + 1
    kz = decaying_root((n * n - kappa**2).astype(complex))
    admittance = kz / (n * n) if p_polarised else kz
    phase = np.exp(2j * np.concatenate([[0.0], thicknesses_nm, [0.0]]).reshape(-1, *[1] * kappa.ndim) * kz
                   * (2.0 * np.pi / wavelengths_nm))  # fmt: skip
    total = phase[medium]
    for order in (range(medium), range(len(n) - 1, medium, -1)):
        reflected = np.zeros_like(kz[0])
        outer = None
        for here in [*order, medium]:
            if outer is not None:
                step = _fresnel(admittance[here], admittance[outer])
                inner = reflected * phase[outer] if outer != order[0] else reflected
                reflected = (step + inner) / (1.0 + step * inner)
            outer = here
        total = total * reflected
    return np.asarray(total)


def _fresnel(here: ComplexArray, beyond: ComplexArray) -> ComplexArray:
    total = here + beyond
    return np.asarray((here - beyond) / np.where(total == 0.0, 1e-300, total))
