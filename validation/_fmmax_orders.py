"""The orders of a relief by `fmmax` (rigorous coupled waves), in the environment that holds it: `.venv-validate`.

Imported by the process that makes or repeats the cases, never by nacre.
"""

from __future__ import annotations

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from fmmax import basis, fields, fmm, scattering

jax.config.update("jax_enable_x64", True)
GRID = 4096  # samples of the permittivity along a period of a grating


def grating_orders(
    period: float, profile: Any, depth: float, slices: int, n: complex, wavelength: float, angle_deg: float,
    truncation: int,
) -> tuple[Any, dict[str, Any]]:  # fmt: skip
    """Return the numbers of the orders that propagate and, for "s" and "p", their efficiencies.

    Calls of one truncation and one number of slices share a compiled function.

    Args:
        profile: heights over `depth`, 0 to 1, of one period on an even grid of `GRID` samples.
        slices: number of layers that the profile is cut into, each at the middle of its height.
    """
    levels = 1.0 - (np.arange(slices) + 0.5) / slices  # from the top down
    filled = (profile[None, :] > levels[:, None])[:, :, None]
    numbers = np.arange(-truncation, truncation + 1)
    order = np.concatenate([[0], np.delete(numbers, truncation)])
    coefficients = np.stack([order, 0 * order], axis=-1)
    # across the grooves nothing changes: any short period will do
    lattice = basis.LatticeVectors(u=period * basis.X, v=0.1 * period * basis.Y)
    found = _reflected(
        coefficients, lattice, np.where(filled, n**2, 1.0), depth / slices, n, wavelength, angle_deg
    )  # fmt: skip
    alpha = np.sin(np.radians(angle_deg)) + numbers * wavelength / period
    goes = np.abs(alpha) < 1.0
    rank = np.argsort(order)
    return numbers[goes], {which: values[rank][goes] for which, values in found.items()}


def layered_orders(
    period: float, filled: Any, thicknesses: Any, n: complex, wavelength: float, angle_deg: float, truncation: int
) -> tuple[Any, dict[str, Any]]:
    """The same for layers of any thickness, from the top down: `filled[layer, x]` says where the body is.

    Layers are solved one by one and not compiled together: for a hundred of them that would take minutes.
    """
    numbers = np.arange(-truncation, truncation + 1)
    order = np.concatenate([[0], np.delete(numbers, truncation)])
    expansion = basis.Expansion(basis_coefficients=np.stack([order, 0 * order], axis=-1))
    lattice = basis.LatticeVectors(u=period * basis.X, v=0.1 * period * basis.Y)
    wave = 2 * np.pi / wavelength * np.array([np.sin(np.radians(angle_deg)), 0.0])
    solve = jax.jit(
        functools.partial(
            fmm.eigensolve_isotropic_media, jnp.asarray(wavelength), jnp.asarray(wave), lattice, expansion=expansion,
            formulation=fmm.Formulation.JONES_DIRECT_FOURIER,
        )
    )  # fmt: skip
    above = solve(permittivity=jnp.ones((1, 1), dtype=complex))
    below = solve(permittivity=jnp.full((1, 1), n**2, dtype=complex))
    layers = [solve(permittivity=jnp.asarray(np.where(row, n**2, 1.0))[:, None]) for row in filled]
    matrix = scattering.stack_s_matrix(
        [above, *layers, below], [jnp.zeros(()), *map(jnp.asarray, thicknesses), jnp.zeros(())]
    )
    alpha = np.sin(np.radians(angle_deg)) + numbers * wavelength / period
    goes, rank = np.abs(alpha) < 1.0, np.argsort(order)
    flux = np.asarray(_flux(matrix, above, len(order)))
    size = len(order)
    return numbers[goes], {
        which: (flux[k, :size] + flux[k, size:])[rank][goes] for k, which in enumerate("sp")
    }  # fmt: skip


def relief_orders(
    period: float, heights: Any, slices: int, n: complex, wavelength: float, angle_deg: float, terms: int
) -> tuple[Any, dict[str, Any]]:
    """The same for a relief periodic in x and y, the plane of incidence along x: orders `[order, 2]`, all states of
    polarisation of an order together.

    Args:
        heights: `[x, y]` of one period, in um.
        terms: how many orders are kept, about.
    """  # fmt: skip
    depth = float(np.ptp(heights))
    profile = (heights - heights.min()) / depth
    levels = 1.0 - (np.arange(slices) + 0.5) / slices
    lattice = basis.LatticeVectors(u=period * basis.X, v=period * basis.Y)
    expansion = basis.generate_expansion(lattice, terms)
    filled = profile[None, :, :] > levels[:, None, None]
    coefficients = np.asarray(expansion.basis_coefficients)
    found = _reflected(
        coefficients, lattice, np.where(filled, n**2, 1.0), depth / slices, n, wavelength, angle_deg
    )  # fmt: skip
    lateral = np.array([np.sin(np.radians(angle_deg)), 0.0]) + coefficients * wavelength / period
    goes = np.hypot(*lateral.T) < 1.0
    return coefficients[goes], {which: values[goes] for which, values in found.items()}


def _reflected(
    coefficients: Any, lattice: Any, permittivity: Any, thickness: float, n: complex, wavelength: float,
    angle_deg: float,
) -> dict[str, Any]:  # fmt: skip
    expansion = basis.Expansion(basis_coefficients=coefficients)
    wave = 2 * np.pi / wavelength * np.array([np.sin(np.radians(angle_deg)), 0.0])
    count = len(coefficients)
    flux = _solve(
        expansion, lattice.u, lattice.v, jnp.asarray(permittivity, dtype=complex), thickness, n**2, wavelength, wave
    )
    return {which: np.asarray(flux[k, :count] + flux[k, count:]) for k, which in enumerate(("s", "p"))}


@functools.partial(jax.jit, static_argnums=0)
def _solve(
    expansion: Any, u: Any, v: Any, permittivity: Any, thickness: Any, below_epsilon: Any, wavelength: Any, wave: Any
) -> Any:
    """Power of each reflected wave, `[incident state, wave]`, of light of power 1 in order 0."""
    lattice = basis.LatticeVectors(u=u, v=v)
    solve = functools.partial(
        fmm.eigensolve_isotropic_media, wavelength, wave, lattice, expansion=expansion,
        formulation=fmm.Formulation.JONES_DIRECT_FOURIER,
    )  # fmt: skip
    above = solve(permittivity=jnp.ones((1, 1), dtype=complex))
    below = solve(permittivity=jnp.full((1, 1), below_epsilon, dtype=complex))
    layers = [solve(permittivity=layer) for layer in permittivity]
    matrix = scattering.stack_s_matrix(
        [above, *layers, below], [jnp.zeros(()), *[jnp.asarray(thickness)] * len(layers), jnp.zeros(())]
    )
    return _flux(matrix, above, expansion.num_terms)


def _flux(matrix: Any, above: Any, count: int) -> Any:
    """Power of each reflected wave, `[incident state, wave]`, of light of power 1 in order 0."""
    found = []
    for column in (0, count):
        incident = jnp.zeros((2 * count, 1), dtype=complex).at[column, 0].set(1.0)
        forward, backward = fields.amplitude_poynting_flux(incident, matrix.s21 @ incident, above)
        found.append(-backward[:, 0] / forward[:, 0].sum())
    return jnp.stack(found)


def crossed_orders(
    lattice: tuple[tuple[float, float], tuple[float, float]], permittivity: Any, thickness: float, below: complex,
    light: tuple[float, float, float], terms: int,
) -> dict[str, Any]:  # fmt: skip
    """Return the orders of one patterned layer of two periods on a half space, in air.

    Args:
        lattice: vectors.
        permittivity: `[u, v]` on an even grid along the vectors.
        below: index of the half space.
        light: wavelength, incidence angle and azimuth of the transverse part of the wave vector, in degrees.
        terms: about how many Fourier orders.

    Returns:
        "numbers" `[order, 2]`, "reflected" and "transmitted" `[order, in]` for s and p light; zero for orders that do
        not propagate.
    """
    wavelength, theta, phi = light[0], np.radians(light[1]), np.radians(light[2])
    vectors = basis.LatticeVectors(u=jnp.asarray(lattice[0]), v=jnp.asarray(lattice[1]))
    expansion = basis.generate_expansion(vectors, terms)
    c, s = np.cos(phi), np.sin(phi)
    tangential = np.array([[-s, np.cos(theta) * c], [c, np.cos(theta) * s]])  # E_x, E_y of s and p light
    across = 2 * np.pi / wavelength * np.sin(theta) * np.array([c, s])
    sides = _crossed(
        expansion, vectors.u, vectors.v, jnp.asarray(permittivity, dtype=complex), thickness, below**2,
        jnp.asarray(wavelength), jnp.asarray(across), tangential,
    )  # fmt: skip
    reflected, transmitted = map(np.asarray, sides)
    return {"numbers": np.asarray(expansion.basis_coefficients), "reflected": reflected, "transmitted": transmitted}


def _crossed(
    expansion: Any, u: Any, v: Any, permittivity: Any, thickness: Any, below_epsilon: Any, wavelength: Any, wave: Any,
    tangential: Any,
) -> Any:  # fmt: skip
    """Power of each reflected and each transmitted order, `[order, incident state]`, of light of power 1 in order 0."""
    solve = functools.partial(
        fmm.eigensolve_isotropic_media, wavelength, wave, basis.LatticeVectors(u=u, v=v), expansion=expansion,
        formulation=fmm.Formulation.JONES_DIRECT_FOURIER,
    )  # fmt: skip
    media = (jnp.ones((1, 1), dtype=complex), permittivity, jnp.full((1, 1), below_epsilon, dtype=complex))
    layers = [solve(permittivity=each) for each in media]
    matrix = scattering.stack_s_matrix(layers, [jnp.zeros(()), jnp.asarray(thickness), jnp.zeros(())])
    count = expansion.num_terms
    unit = jnp.zeros((2 * count, 2), dtype=complex).at[0, 0].set(1.0).at[count, 1].set(1.0)
    (e_x, e_y, _), _ = fields.fields_from_wave_amplitudes(unit, jnp.zeros_like(unit), layers[0])
    incident = unit @ jnp.linalg.solve(jnp.array([e_x[0], e_y[0]]), tangential.astype(complex))
    up, down = matrix.s21 @ incident, matrix.s11 @ incident
    flux_in, flux_up = fields.amplitude_poynting_flux(incident, up, layers[0])
    flux_down, _ = fields.amplitude_poynting_flux(down, jnp.zeros_like(down), layers[-1])
    power = flux_in.sum(axis=0)
    return tuple((flux[:count] + flux[count:]) / power for flux in (-flux_up, flux_down))
