"""Colours at the geometries of multi-angle instruments, and texture, for the page's panel that follows the recipe."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import UnsupportedError
from nacre.families.contract import Surrogate
from nacre.light import spectrum_to_xyz, white_xyz, xyz_to_lab
from nacre.material.material import Material
from nacre.measure.colours import geometry_colours, recipe_geometries
from nacre.measure.geometry import ASPECULAR_DEG, Geometry
from nacre.measure.texture import (
    ANGLES_DEG,
    QUANTITY_NAMES,
    RELATIVE,
    TextureQuantity,
    measure_texture,
    texture_document,
    texture_values,
)
from nacre.optimise.evaluation import lab_hex
from nacre.optimise.measurement import missing_geometries, search_wavelengths, surrogate_factors
from nacre.studio.folder import built
from nacre.studio.incidence import mixes_polarisations

OBSERVER = "10deg"
ACROSS = ("45as25az90", "45as25az-90", "45as60az125.3", "45as60az-125.3")  # out of the plane of incidence
SLOW = "is measured by the report below, not while the recipe changes"
MIRROR = "reflects into the mirror direction only: see the colour over angle above"


def angle_tables(recipe: Mapping[str, str], lamp: str, is_fine: bool) -> dict[str, Any]:
    """Return `colours` at each geometry and `texture` as JSON data, without random walks.

    Args:
        recipe: from `read_recipe`.
        lamp: illuminant.
        is_fine: texture as in a report, with standard errors (0.5 to 2 CPU s), or in the accuracy of a search.

    Raises:
        NacreError: the recipe cannot be computed.
    """
    material = built(recipe)
    named = {str(at): at for at in (Geometry("aspecular", 45.0, angle) for angle in ASPECULAR_DEG)}
    named |= {text: Geometry.read(text, "geometry") for text in ACROSS}
    named |= {name: at for name, at in recipe_geometries(material).items() if at.kind == "aspecular"}
    try:
        labs = _colours(material, list(named.values()), lamp)
    except UnsupportedError as error:
        return {"colours": [], "texture": {"reason": str(error)}}
    white = white_xyz(lamp, OBSERVER)
    rows = [
        {"geometry": name, "lab": lab.tolist(), "srgb": lab_hex(lab, white)}
        for name, lab in zip(named, labs, strict=True)
    ]
    return {"colours": rows, "texture": _texture(material, lamp, is_fine)}


def _colours(material: Material, geometries: list[Geometry], lamp: str) -> Array:
    grid, model = search_wavelengths(material, [lamp]), material.model
    is_quick = model.traits.is_quick and not mixes_polarisations(material)  # whose tables over angle take seconds
    found = None if is_quick else surrogate_factors(material, geometries, grid)
    is_known = isinstance(model, Surrogate) and model.surrogate_error is not None
    if found is not None and (is_known or not np.any(found[1])):  # exact, or with a small error
        xyz = spectrum_to_xyz(found[0] + found[1], grid, lamp, OBSERVER)
        return np.asarray(xyz_to_lab(xyz, white_xyz(lamp, OBSERVER)))
    if not is_quick:
        raise UnsupportedError(f"This {model.traits.noun} {SLOW}.")
    if len(missing_geometries(material, geometries)) == len(set(geometries)):
        raise UnsupportedError(f"This {model.traits.noun} {MIRROR}.")
    return geometry_colours(material, geometries, lamp, OBSERVER)


def _texture(material: Material, lamp: str, is_fine: bool) -> dict[str, Any]:
    """Return rows of sparkle and graininess, or the reason why there are none."""
    asked = [TextureQuantity.named(name, "texture", light=(lamp, OBSERVER)) for name in QUANTITY_NAMES]
    pairs: list[list[Any]]
    try:
        if is_fine:
            document = texture_document(measure_texture(material, None, "statistics", lamp, OBSERVER))
            pairs = [_pair(document, each) for each in asked]
        else:
            pairs = [[float(value), None] for value in texture_values(material, asked, 0, "search")[0]]
    except UnsupportedError as error:
        return {"reason": str(error)}
    return {"scale": RELATIVE, "angles_deg": list(ANGLES_DEG), "values": dict(zip(QUANTITY_NAMES, pairs, strict=True))}


def _pair(document: Mapping[str, Any], quantity: TextureQuantity) -> list[float]:
    """Return a quantity and its standard error."""
    if quantity.kind == "graininess":
        return [document["graininess"]["value"], document["graininess"]["error"]]
    name, one = "grade" if quantity.kind == "sparkle" else quantity.kind, document["sparkle"][f"{quantity.theta_deg:g}"]
    return [one[name], one[f"{name}_error"]]
