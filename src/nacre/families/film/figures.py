"""Figures of films: field profile, colour over thickness and angle, structure."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nacre.bsdf.tabulate import SLICE_SHARE, reflected_lab
from nacre.core.arrays import Array, ComplexArray
from nacre.core.errors import UnsupportedError
from nacre.families.contract import Figure
from nacre.families.film.material import COLOUR_COSINES, Film
from nacre.light import delta_e_2000
from nacre.light.tristimulus import REFERENCE_NM
from nacre.matter.indices.constant import OpticalConstant
from nacre.matter.indices.crystal import AnisotropicConstant
from nacre.matter.stack import solve as solver
from nacre.matter.stack.incoherent import incoherent_powers

MAP_NM = 1000.0  # thickness range of a clear layer's colours before they fade
OPAQUE_DEPTHS = 3.0  # penetration depths, below which less than e^-6 is reflected
NUDGE = 0.1  # relative thickness change for the comparison of layers


def field(
    film: Film, theta_deg: float = 0.0, wavelengths_nm: ArrayLike | None = None, points: int = 400
) -> dict[str, NDArray[Any]]:
    """Return |E|^2 through the stack: `z_nm[z]`, `wavelengths_nm[l]`, `s[z, l]`, `p[z, l]`, `interfaces_nm`.

    Raises:
        UnsupportedError: a layer is incoherent and has no standing wave.
    """
    from nacre.matter.stack.field import field_profile  # needs numba, which pictures do not

    if not film.stack.is_coherent:
        raise UnsupportedError("a stack with an incoherent layer has no field profile")
    lam = film.wavelengths_nm if wavelengths_nm is None else np.atleast_1d(np.asarray(wavelengths_nm, dtype=float))
    d = film.stack.thicknesses_nm
    margin = max(200.0, 0.2 * float(d.sum()))
    z = np.linspace(-margin, float(d.sum()) + margin, points)
    if film.is_anisotropic:
        s, p = film.stack.polarised_field(float(np.radians(theta_deg)), lam, z[::2], slice_share=SLICE_SHARE)
        z = z[::2]
    else:
        profile = field_profile(film.stack.indices(lam), d, lam, np.array([np.radians(theta_deg)]), z)
        s, p = profile.s[:, 0], profile.p[:, 0]
    edges = np.concatenate([[0.0], np.cumsum(d)])
    return {
        "z_nm": z,
        "wavelengths_nm": lam,
        "s": s,
        "p": p,
        "interfaces_nm": edges,
        "names": np.array([medium.name for medium in _media(film)]),
        "theta_deg": np.array(theta_deg),
    }


def colour_map(
    film: Film,
    layer: int | None = None,
    thicknesses_nm: ArrayLike | None = None,
    angles_deg: ArrayLike | None = None,
    wavelengths_nm: ArrayLike | None = None,
) -> dict[str, NDArray[Any]]:
    """Return reflectance over thickness and angle: `thicknesses_nm[t]`, `angles_deg[a]`, `reflectance[t, a, l]`.

    Args:
        layer: varied layer, 0 the outermost; default: the layer with the largest effect on colour.
        thicknesses_nm: default: 0 to 1000 nm or three penetration depths, if shorter; at least twice its own thickness.

    Raises:
        UnsupportedError: the film has no such layer.
    """
    layer = leading_layer(film) if layer is None else layer
    if not 0 <= layer < len(film.layers):
        raise UnsupportedError(f"layer = {layer} does not exist; the film has {len(film.layers)}")
    whole = np.linspace(0.0, _reach_nm(film, layer), 201)
    runs = whole if thicknesses_nm is None else np.atleast_1d(np.asarray(thicknesses_nm, float))
    angles = np.linspace(0.0, 85.0, 86) if angles_deg is None else np.atleast_1d(np.asarray(angles_deg, dtype=float))
    lam = film.wavelengths_nm if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
    d = np.broadcast_to(film.stack.thicknesses_nm, (len(runs), len(film.layers))).copy()
    d[:, layer] = runs
    tables = film.tables(lam)
    if film.is_anisotropic:
        if tables.flipped:
            raise UnsupportedError("no colour map of an anisotropic film on a substrate rarer than its ambient")
        reflectance, transmittance = tables.outside(d, np.cos(np.radians(angles)))
    elif any(tables.incoherent):
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
        "y_label": np.array(f"Thickness of layers[{layer}] (nm)" if len(film.layers) > 1 else "Thickness (nm)"),
    }


def leading_layer(film: Film) -> int:
    """Return the layer with the largest dE00 between 90 % and 110 % thickness."""
    d = film.stack.thicknesses_nm
    tables = film.tables(film.wavelengths_nm)
    moved = []
    for i in range(len(d)):
        ends = np.stack([d, d])
        ends[:, i] *= [1.0 - NUDGE, 1.0 + NUDGE]
        less, more = reflected_lab(tables.outside(ends, COLOUR_COSINES)[0], tables.wavelengths_nm)
        moved.append(float(np.max(delta_e_2000(less, more))))
    return int(np.argmax(moved)) if moved else 0


def _reach_nm(film: Film, layer: int) -> float:
    """Return the largest thickness in a layer's map."""
    lam = np.linspace(*film.range_nm, 9)
    k = float(np.min(_mean_index(film.layers[layer].material, lam).imag))
    opaque = OPAQUE_DEPTHS * REFERENCE_NM / (4.0 * np.pi * max(k, 1e-9))
    return max(min(MAP_NM, opaque), 2.0 * float(film.stack.thicknesses_nm[layer]))


def structure(film: Film, wavelength_nm: float = 550.0) -> dict[str, NDArray[Any]]:
    """Return the drawn stack: `names[medium]`, `thicknesses_nm[layer]`, `n[medium]`, `k[medium]`."""
    at = np.array([float(np.clip(wavelength_nm, *film.range_nm))])
    media = _media(film)
    index = np.array([_mean_index(medium, at)[0] for medium in media])
    return {
        "names": np.array([medium.name for medium in media]),
        "thicknesses_nm": film.stack.thicknesses_nm,
        "n": index.real,
        "k": index.imag,
        "wavelength_nm": at[0] * np.ones(()),
        "incoherent": np.array([layer.incoherent for layer in film.layers], dtype=bool),
    }


def _media(film: Film) -> list[OpticalConstant | AnisotropicConstant]:
    return [film.ambient, *(layer.material for layer in film.layers), film.substrate]


def _mean_index(medium: OpticalConstant | AnisotropicConstant, wavelengths_nm: Array) -> ComplexArray:
    """Return n + ik, of an anisotropic medium that of its mean permittivity."""
    if isinstance(medium, AnisotropicConstant):
        return medium.mean_index(wavelengths_nm)
    return medium.n_complex(wavelengths_nm)


FIGURES: dict[str, Figure] = {"field": field, "colour-map": colour_map, "structure": structure}
