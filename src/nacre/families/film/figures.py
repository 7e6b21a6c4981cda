"""Arrays of the figures that only films have."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nacre.errors import UnsupportedError
from nacre.families.contract import Figure
from nacre.families.film.material import Film
from nacre.matter.indices.constant import OpticalConstant
from nacre.matter.stack import solve as solver
from nacre.matter.stack.field import field_profile
from nacre.matter.stack.incoherent import incoherent_powers


def field(
    film: Film, theta_deg: float = 0.0, wavelengths_nm: ArrayLike | None = None, points: int = 400
) -> dict[str, NDArray[Any]]:
    """Return |E|^2 through the stack: `z_nm[z]`, `wavelengths_nm[l]`, `s[z, l]`, `p[z, l]`, `interfaces_nm`.

    Raises:
        UnsupportedError: a layer is incoherent and has no standing wave.
    """
    if not film.stack.is_coherent:
        raise UnsupportedError("a stack with an incoherent layer has no field profile")
    lam = film.wavelengths_nm if wavelengths_nm is None else np.atleast_1d(np.asarray(wavelengths_nm, dtype=float))
    d = film.stack.thicknesses_nm
    margin = max(200.0, 0.2 * float(d.sum()))
    z = np.linspace(-margin, float(d.sum()) + margin, points)
    profile = field_profile(film.stack.indices(lam), d, lam, np.array([np.radians(theta_deg)]), z)
    edges = np.concatenate([[0.0], np.cumsum(d)])
    return {
        "z_nm": z,
        "wavelengths_nm": lam,
        "s": profile.s[:, 0],
        "p": profile.p[:, 0],
        "interfaces_nm": edges,
        "names": np.array([medium.name for medium in _media(film)]),
        "theta_deg": np.array(theta_deg),
    }


def colour_map(
    film: Film,
    layer: int = 0,
    thicknesses_nm: ArrayLike | None = None,
    angles_deg: ArrayLike | None = None,
    wavelengths_nm: ArrayLike | None = None,
) -> dict[str, NDArray[Any]]:
    """Return reflectance over thickness and angle: `thicknesses_nm[t]`, `angles_deg[a]`, `reflectance[t, a, l]`.

    Args:
        layer: which layer's thickness runs, 0 the outermost; its range defaults to 0 ... 1000 nm.

    Raises:
        UnsupportedError: the film has no such layer.
    """
    if not 0 <= layer < len(film.layers):
        raise UnsupportedError(f"layer = {layer} does not exist; the film has {len(film.layers)}")
    runs = np.linspace(0.0, 1000.0, 201) if thicknesses_nm is None else np.atleast_1d(np.asarray(thicknesses_nm, float))
    angles = np.linspace(0.0, 85.0, 86) if angles_deg is None else np.atleast_1d(np.asarray(angles_deg, dtype=float))
    lam = film.wavelengths_nm if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
    d = np.broadcast_to(film.stack.thicknesses_nm, (len(runs), len(film.layers))).copy()
    d[:, layer] = runs
    tables = film.tables(lam)
    if any(tables.incoherent):
        solved = [incoherent_powers(tables.n, row, tables.incoherent, lam, np.radians(angles)) for row in d]
        reflectance = np.stack([p.reflectance for p in solved])
        transmittance = np.stack([p.transmittance for p in solved])
    else:
        powers = solver.powers(tables.n, d, lam, np.radians(angles))
        reflectance, transmittance = powers.reflectance, powers.transmittance
    return {
        "thicknesses_nm": runs,
        "angles_deg": angles,
        "wavelengths_nm": lam,
        "reflectance": reflectance,
        "transmittance": transmittance if tables.transmits else np.zeros_like(transmittance),
        "layer": np.array(layer),
    }


def structure(film: Film, wavelength_nm: float = 550.0) -> dict[str, NDArray[Any]]:
    """Return the stack as drawn: `names[medium]`, `thicknesses_nm[layer]`, `n[medium]`, `k[medium]`."""
    at = np.array([float(np.clip(wavelength_nm, *film.range_nm))])
    media = _media(film)
    index = np.array([medium.n_complex(at)[0] for medium in media])
    return {
        "names": np.array([medium.name for medium in media]),
        "thicknesses_nm": film.stack.thicknesses_nm,
        "n": index.real,
        "k": index.imag,
        "wavelength_nm": at[0] * np.ones(()),
        "incoherent": np.array([layer.incoherent for layer in film.layers], dtype=bool),
    }


def _media(film: Film) -> list[OpticalConstant]:
    return [film.ambient, *(layer.material for layer in film.layers), film.substrate]


FIGURES: dict[str, Figure] = {"field": field, "colour-map": colour_map, "structure": structure}
