"""The shape of spread light, as a picture over half and difference angle that the page looks up as exported tables do.

The page takes from it only where the light goes; how much there is, the look's own spectra say. So a coarse grid of
wavelengths will do, and of a random walk what its recipe's family says of it without noise.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from nacre.arrays import Array
from nacre.bsdf import Bsdf
from nacre.bsdf.lobes.microfacet import Microfacet
from nacre.exchange.lobes import is_isotropic
from nacre.exchange.lut.table import lobe_directions, lobe_weight
from nacre.materials.material import Material

SHAPE = (4, 14, 24)  # slices, rows and columns of the picture: azimuth, difference angle, root of the half angle
LOBE_NM = np.arange(400.0, 705.0, 8.0)

ToRgb = Callable[[Array, Array], Array]  # spectra and their wavelengths -> colours


def lobe_picture(material: Material, bsdf: Bsdf | None, to_rgb: ToRgb) -> Array | None:
    """Return pi f 2 cos_i cos_o / (cos_i + cos_o) of spread light, `[slice, row, column, 3]`; or None.

    Args:
        bsdf: solved on any wavelengths, or None where the material gives its spectra without one.
        to_rgb: of spectra `[pair, wavelength]` on wavelengths `[wavelength]`.
    """
    wi, wo = lobe_directions(*SHAPE)
    pairs = wi.reshape(-1, 3), wo.reshape(-1, 3)
    values, wavelengths = _values(material, bsdf, *pairs)
    if values is None:
        return None
    rgb = to_rgb(np.nan_to_num(values), wavelengths)
    weighted = rgb.reshape(*SHAPE, 3) * np.pi * lobe_weight(wi, wo)[..., None]
    return weighted if weighted.max() > 0 else None


def _values(material: Material, bsdf: Bsdf | None, wi: Array, wo: Array) -> tuple[Array | None, Array]:
    if bsdf is None:
        bsdf = material.bsdf(LOBE_NM, keep=False)
    lobes = tuple(lobe for lobe in bsdf.lobes if not lobe.is_delta and not isinstance(lobe, Microfacet))
    spread = dataclasses.replace(bsdf, lobes=lobes)
    if not lobes:
        return None, LOBE_NM
    if not any(lobe.is_stochastic for lobe in lobes):
        return (spread.evaluate(wi, wo) if is_isotropic(spread) else None), bsdf.wavelengths_nm
    found = material.model.likeness_at(wi, wo, LOBE_NM)
    return None if found is None else found[0] + found[1], LOBE_NM
