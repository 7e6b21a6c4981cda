"""CIELAB colours at several geometries as fit data or a diagnosis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.families.contract import Model, is_direct, surrogate_radiance
from nacre.light import default_wavelengths, spectrum_to_xyz, white_xyz, xyz_to_lab
from nacre.material.material import Material
from nacre.measure.colours import geometry_colours, recipe_geometries
from nacre.measure.geometry import Geometry, aspecular_pairs
from nacre.optimise.colour_list import read_colours

LIGHT = ("D65", "10deg")


@dataclass(frozen=True, eq=False)
class ColourData:
    """Measured CIELAB.

    Attributes:
        labels: `[geometry]`, such as "45as15", or names of the recipe's `[[geometry]]`.
        values: `[geometry, 3]`.
        light: illuminant and observer.
        name: file, for reports.
        geometries: of the labels; empty before `resolved`.
    """

    labels: tuple[str, ...]
    values: Array
    light: tuple[str, str] = LIGHT
    name: str = ""
    geometries: tuple[Geometry, ...] = ()
    kind: str = "colours"

    @property
    def wavelengths_nm(self) -> Array:
        """The visible range, of which a colour is a sum."""
        return default_wavelengths()

    def resolved(self, material: Material) -> ColourData:
        """Return the data with its geometries.

        Raises:
            RecipeError: a label is no geometry and no recipe name.
        """
        named = recipe_geometries(material)
        where = f"{self.name or 'colour'}: geometry"
        return replace(self, geometries=tuple(Geometry.read(label, where, named) for label in self.labels))

    def model(self, material: Material, samples: int | None, seed: int) -> Array:
        """Return the material's CIELAB, `[geometry, 3]`."""
        rows = self.geometries or self.resolved(material).geometries
        return geometry_colours(material, rows, *self.light, samples, seed)

    def surrogate(self, model: Model) -> Array | None:
        """Return CIELAB of a random walk's noise-free surrogate; None without one."""
        if is_direct(model) or any(geometry.kind != "aspecular" for geometry in self.geometries):
            return None
        grid = np.asarray(model.wavelengths_nm)
        found = surrogate_radiance(model, *aspecular_pairs(self.geometries), grid, True)
        if found is None:
            return None
        xyz = spectrum_to_xyz(np.pi * (found[0] + found[1]), grid, *self.light)
        return np.asarray(xyz_to_lab(xyz, white_xyz(*self.light)))

    def noise_scale(self, weights: str) -> Array:
        """Return the relative noise of the values: equal for L*, a* and b* at all geometries."""
        return np.full(self.values.shape, float(np.sqrt(np.mean(self.values**2))) or 1.0)


def stated_colours(stated: Mapping[str, Sequence[float]]) -> ColourData:
    """Return colours from a table geometry -> L*, a*, b*; D65, 10 degree observer.

    Raises:
        NacreError: a colour is not three finite numbers.
    """
    for label, lab in stated.items():
        if np.shape(lab) != (3,) or not np.isfinite(np.asarray(lab, dtype=float)).all():
            raise NacreError(f'colour at "{label}" = {list(lab)} should hold L*, a*, b*')
    return ColourData(tuple(stated), np.array([list(lab) for lab in stated.values()], dtype=float))


def colour_measurement(path: Path) -> ColourData:
    """Read a colour list whose names are geometries: `geometry, L*, a*, b*`.

    Raises:
        NacreError: a row is not a colour or has no name.
    """
    rows = read_colours(path, 1, LIGHT)
    for number, row in enumerate(rows, start=1):
        if not row.name:
            raise NacreError(f"{path}: colour {number} has no geometry; write 45as15,L*,a*,b* in each row")
    return ColourData(tuple(row.name for row in rows), np.array([row.lab[0] for row in rows]), LIGHT, str(path))
