"""The cloud of tolerance on the ribbon: the colours over the angle of materials as they are made.

The spreads are those of `nacre tolerance`: the recipe's `[tolerance]`, and of every other layer's thickness so many per
cent. What is drawn is the page's own quantity, all reflected light over the angle.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.light import (
    SRGB_WHITE_XYZ,
    adapt_xyz,
    delta_e_2000,
    spectrum_to_xyz,
    white_xyz,
    xyz_to_lab,
    xyz_to_srgb_linear,
)
from nacre.material.material import Material
from nacre.measure.spectrum import bsdf_spectrum
from nacre.studio.design_request import LENGTH, THICKNESS, number, opened_parts
from nacre.studio.folder import Opened
from nacre.studio.measured import built, placed, read_lamp
from nacre.studio.told import Tell

DRAWS = (4, 400)
MOST_PERCENT = 50.0
FINE_DEG = np.array([*np.arange(0.0, 90.0, 5.0), 88.0])
QUICK_S = 0.05  # of one material on all its wavelengths; what takes longer is drawn at few angles and wavelengths
COARSE_DEG, COARSE_NM = np.array([0.0, 20.0, 40.0, 60.0, 75.0, 88.0]), np.arange(400.0, 701.0, 25.0)
SECONDS, TOLD_S = 20.0, 1.5  # of all draws; between two clouds that grow
FEWEST = 4


def read_cloud(body: Mapping[str, Any], opened: Opened) -> dict[str, Any]:
    """Return the bounded question of a cloud: `recipe`, `lamp`, `percent`, `draws`.

    Raises:
        NacreError: a value that is not allowed, in one line.
    """
    lamp = read_lamp(body)
    return {
        "recipe": placed(body, opened), "lamp": lamp,
        "percent": number(body.get("percent", 2), "spread in %", 0.0, MOST_PERCENT),
        "draws": int(number(body.get("draws", 64), "draws", *DRAWS)),
    }  # fmt: skip


def clouded(question: Mapping[str, Any], tell: Tell) -> None:
    """Tell "cloud" as it grows: linear sRGB `rgb` `[draw, angle, 3]`, and dE00 to the recipe's own colour.

    Raises:
        NacreError: the recipe is wrong, has nothing that spreads, or cannot be computed.
    """
    from nacre.analysis.tolerance import recipe_tolerances

    material = opened_parts(built(question["recipe"])).at_low_fidelity()
    spreads = recipe_tolerances(material, options_of(material, question["percent"]))
    began = time.monotonic()
    angles, grid = _fineness(material, question["lamp"])
    nominal = _seen(material, angles, grid, question["lamp"])
    draws = question["draws"]
    generator = np.random.default_rng(0)
    values = {spread.path: spread.draw(generator, draws) for spread in spreads}
    found: list[Array] = []
    failed, told = 0, time.monotonic()
    for i in range(draws):
        try:
            made = material.vary({path: float(drawn[i]) for path, drawn in values.items()})
            found.append(_seen(made, angles, grid, question["lamp"]))
        except NacreError:
            failed += 1
        if time.monotonic() - began > SECONDS and len(found) >= FEWEST:
            break
        if time.monotonic() - told > TOLD_S and len(found) >= FEWEST:
            told = time.monotonic()
            tell(_cloud(nominal, found, angles, question, failed, len(spreads)))
    if not found:
        raise NacreError("no material within these spreads can be computed")
    tell(_cloud(nominal, found, angles, question, failed, len(spreads)))


def options_of(material: Material, percent: float) -> tuple[str, ...]:
    """Return `PATH=PERCENT%` for the thickness of every layer, or where there is none for every length; what the
    recipe's own `[tolerance]` names is left to it.

    Raises:
        NacreError: the recipe gives no length.
    """
    own = material.data.get("tolerance", {})
    numbers = [path for path, value in material.parameters.items() if value != 0.0]
    spread = [path for path in numbers if THICKNESS.search(path)] or [path for path in numbers if LENGTH.search(path)]
    if not spread and not own:
        raise NacreError(
            f"this {material.model.traits.noun} has no thickness or length that varies; "
            "name the parameters that do under [tolerance]"
        )
    return tuple(f"{path}={percent:g}%" for path in spread if path not in own)


def _fineness(material: Material, lamp: str) -> tuple[Array, Array | None]:
    """Return the angles and wavelengths to draw with: all of what is quick, few of what takes long."""
    if not material.model.traits.is_quick:
        return COARSE_DEG, COARSE_NM
    for _ in range(2):  # the first may compile
        began = time.monotonic()
        _seen(material, FINE_DEG, None, lamp)
        took = time.monotonic() - began
    return (FINE_DEG, None) if took <= QUICK_S else (COARSE_DEG, COARSE_NM)


def _seen(material: Material, angles_deg: Array, grid: Array | None, lamp: str) -> Array:
    """Return XYZ under the lamp, `[angle, 3]`, of all light that is reflected."""
    theta = np.radians(angles_deg)
    spectrum = material.model.spectrum(theta, grid, "both", 0)
    if spectrum is None:
        spectrum = bsdf_spectrum(material.bsdf(grid), theta)
    parts = spectrum.parts()
    total = sum(np.nan_to_num(parts[name]) for name in ("specular_reflectance", "diffuse_reflectance") if name in parts)
    return np.asarray(spectrum_to_xyz(total, spectrum.wavelengths_nm, lamp))


def _cloud(
    nominal: Array, found: list[Array], angles: Array, question: Mapping[str, Any], failed: int, spreads: int
) -> dict[str, Any]:
    white = white_xyz(question["lamp"])
    xyz = np.stack(found)
    rgb = xyz_to_srgb_linear(adapt_xyz(xyz, white, SRGB_WHITE_XYZ))
    far = np.asarray(delta_e_2000(xyz_to_lab(nominal, white), xyz_to_lab(xyz, white)))
    return {
        "kind": "cloud", "angles": angles.tolist(), "rgb": np.round(rgb, 5).tolist(), "asked": question["draws"],
        "failed": failed, "spreads": spreads, "median": np.round(np.median(far, axis=0), 2).tolist(),
        "most": np.round(np.percentile(far, 95, axis=0), 2).tolist(),
    }  # fmt: skip
