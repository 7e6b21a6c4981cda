"""A recipe number that varies over the surface, for any family: solved at some values, interpolated between.

The values (nodes) are as many as keep the colour between two of them within a stated error; each node's lobes are
weighted by a hat function of the texture (linear interpolation). Numbers for which a family has its own tables (a
film's thickness) are not treated here.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nacre.bsdf import Bsdf
from nacre.bsdf.bsdf import Spectrum
from nacre.bsdf.grids import direction
from nacre.bsdf.lobes.masked import MaskedLobe, hat
from nacre.bsdf.tabulate import comparison_xyz
from nacre.bsdf.texture import Texture
from nacre.bsdf.texture_spec import TextureSpec
from nacre.core.arrays import Array
from nacre.core.errors import UnsupportedError
from nacre.families.contract import Figure, Model, Traits
from nacre.light import delta_e_2000, spans_colour, xyz_to_lab
from nacre.measure.evaluate import evaluate_with_error
from nacre.measure.instruments import aspecular_direction
from nacre.recipe.model import RecipeContext, validate

MAX_NUMBERS = 2
MAX_NODES = 9  # each is one more set of lobes in every kernel
COLOUR_ERROR = 1.0  # dE00 midway between nodes, at any of the test geometries
WALK_SAMPLES = 65_536  # of a random walk: its noise stays well below that
JUDGED_ANGLES_DEG = (0.0, 45.0)  # of the mirror direction and of transmission
JUDGED_ASPECULAR_DEG = (15.0, 25.0, 45.0, 75.0)
JUDGED_NM = (400.0, 720.0, 9)  # pigments and particles have broad bands; the walk's noise evens out over nine


@dataclass(frozen=True)
class Number:
    """A number that varies: its path in the recipe and the texture that gives it, in the recipe's own unit."""

    path: str
    texture: Texture


@dataclass(frozen=True)
class Varying(Model):
    """A material of which one or two numbers vary over the surface.

    Attributes:
        numbers: what varies.
        fixed: builds the plain material of given values.
    """

    traits = Traits(noun="material with a varying number")

    numbers: tuple[Number, ...]
    fixed: Callable[[Mapping[str, float]], Any]

    @classmethod
    def read(
        cls,
        tables: Mapping[str, Mapping[str, Any]],
        fixed: Callable[[Mapping[str, float]], Any],
        context: RecipeContext,
    ) -> Varying:
        """Read the textures and check that the material exists at the ends of their ranges.

        Raises:
            RecipeError: a texture cannot be read, or a value in its range is not allowed.
            UnsupportedError: more than `MAX_NUMBERS` vary.
        """
        if len(tables) > MAX_NUMBERS:
            raise UnsupportedError(
                f"{context.source}: {len(tables)} numbers vary over the surface ({', '.join(tables)}); "
                f"at most {MAX_NUMBERS} can"
            )
        numbers = []
        for path, table in tables.items():
            spec = validate(TextureSpec, table, replace(context, source=f"{context.source}: {path}"))
            numbers.append(Number(path, spec.build(context, path)))
        found = cls(tuple(numbers), fixed)
        for corner in itertools.product(*((n.texture.low, n.texture.high) for n in numbers)):
            fixed(found._values(corner))
        return found

    def _values(self, values: tuple[float, ...]) -> dict[str, float]:
        return {number.path: float(value) for number, value in zip(self.numbers, values, strict=True)}

    def _axes(self) -> tuple[list[Array], dict[str, Any]]:
        """Return each number's nodes, and how many there are and why, for the provenance."""
        axes, notes = [], {}
        middle = [0.5 * (n.texture.low + n.texture.high) for n in self.numbers]
        for i, number in enumerate(self.numbers):

            def colours(value: float, i: int = i) -> Array:
                return judged_colours(self.fixed(self._values((*middle[:i], value, *middle[i + 1 :]))))

            nodes, error = choose_nodes(colours, number.texture.low, number.texture.high, number.path)
            axes.append(nodes)
            notes[number.path] = {"nodes": len(nodes), "colour_error_dE00": round(error, 4)}
        return axes, notes

    def _grid(self, axes: list[Array]) -> Iterator[tuple[tuple[int, ...], Any]]:
        """Yield each node's index and material."""
        for index in itertools.product(*(range(len(nodes)) for nodes in axes)):
            yield index, self.fixed(self._values(tuple(nodes[k] for nodes, k in zip(axes, index, strict=True))))

    @property
    def wavelengths_nm(self) -> Array:
        """The finest of the grids of the materials at the ends."""
        ends = itertools.product(*((n.texture.low, n.texture.high) for n in self.numbers))
        return max((np.asarray(self.fixed(self._values(end)).model.wavelengths_nm) for end in ends), key=len)

    def bsdf(self, wavelengths_nm: Array | None = None) -> Bsdf:
        """Return the lobes of all nodes, masked, on one grid: the finest of the ends' own unless one is given.

        Raises:
            UnsupportedError: more nodes would be needed than are allowed.
        """
        if wavelengths_nm is None:
            wavelengths_nm = self.wavelengths_nm
        axes, notes = self._axes()
        lobes = []
        for index, material in self._grid(axes):
            for inner in material.bsdf(wavelengths_nm).lobes:
                lobe = inner
                for number, nodes, k in zip(self.numbers, axes, index, strict=True):
                    if len(nodes) > 1:
                        lobe = MaskedLobe(
                            lobe.wavelengths_nm, lobe, number.texture, nodes=nodes, node=k, name=number.path
                        )
                lobes.append(lobe)
        return Bsdf(tuple(lobes), {"varying": notes})

    def spectrum(self, theta_rad: Array, wavelengths_nm: Array | None, polarisation: str, seed: int = 0) -> Spectrum:
        """Return the mean spectrum over the surface.

        Raises:
            NacreError: as the material itself.
        """
        axes, _ = self._axes()
        axis = (np.arange(64) + 0.5) / 64
        uv = np.stack(np.meshgrid(axis, axis), axis=-1)
        values = [number.texture(uv) for number in self.numbers]
        total: dict[str, Array] = {}
        first: Spectrum | None = None
        for index, material in self._grid(axes):
            share = np.ones(uv.shape[:-1])
            for value, nodes, k in zip(values, axes, index, strict=True):
                share = share * (hat(value, nodes, k) if len(nodes) > 1 else 1.0)
            weight = float(share.mean())
            if weight <= 0.0:
                continue
            one: Spectrum = material.spectrum(theta_rad, wavelengths_nm, polarisation, seed=seed)
            first, wavelengths_nm = first or one, one.wavelengths_nm
            for name, part in one.parts().items():
                total[name] = total.get(name, 0.0) + weight * part
        assert first is not None  # the weights sum to 1
        return replace(first, **total)

    @property
    def figures(self) -> Mapping[str, Figure]:
        """The figures of the material at the middle of the surface."""
        middle = np.array([0.5, 0.5])
        values = tuple(float(number.texture(middle)) for number in self.numbers)
        found: Mapping[str, Figure] = self.fixed(self._values(values)).model.figures
        return found


def judged_colours(material: Any) -> Array:
    """Return XYZ `[geometry, 3]` of a material at the geometries where interpolation is tested.

    Of a material that is known in a part of the colours only, each wavelength is taken as a grey, see `comparison_xyz`.
    """
    low, high, count = JUDGED_NM
    own = np.asarray(material.model.wavelengths_nm)
    low, high = (max(low, own[0]), min(high, own[-1])) if spans_colour(own) else (own[0], own[-1])
    grid = np.linspace(low, high, count) if high > low else own
    bsdf = material.bsdf(grid)
    wo = np.stack([aspecular_direction(45.0, angle) for angle in JUDGED_ASPECULAR_DEG])
    wi = np.broadcast_to(direction(np.radians(45.0)), wo.shape)
    parts = [np.pi * evaluate_with_error(bsdf, wi, wo, samples=WALK_SAMPLES)[0]]
    if bsdf.transmits:
        parts.append(np.pi * evaluate_with_error(bsdf, wi, wo * [1.0, 1.0, -1.0], samples=WALK_SAMPLES)[0])
    mirror = bsdf.specular(np.radians(JUDGED_ANGLES_DEG))
    parts += [mirror.reflectance, mirror.transmittance]
    return comparison_xyz(np.concatenate(parts), grid).reshape(-1, 3)


def choose_nodes(colours: Callable[[float], Array], low: float, high: float, path: str) -> tuple[Array, float]:
    """Halve intervals until colours midway between nodes are within the error; return nodes and error.

    Args:
        colours: XYZ `[geometry, 3]` at a value.
        low, high: range of the number.
        path: its name, for the message.

    Raises:
        UnsupportedError: the most nodes are not enough, or the ends do not blend.
    """
    if high <= low:
        return np.array([low]), 0.0
    nodes = [low, high]
    known = {value: colours(value) for value in nodes}
    if known[low].shape != known[high].shape:
        raise UnsupportedError(
            f"{path}: the material transmits light at only one of {low:g} and {high:g}, so the two cannot be "
            "blended; keep the number off that end with min or max"
        )
    judged: dict[tuple[float, float], float] = {}
    while True:
        for before, after in itertools.pairwise(nodes):
            if (before, after) not in judged:
                middle = 0.5 * (before + after)
                known[middle] = colours(middle)
                blended = 0.5 * (known[before] + known[after])
                difference = delta_e_2000(xyz_to_lab(blended), xyz_to_lab(known[middle]))
                judged[before, after] = float(np.max(difference))
        errors = [judged[pair] for pair in itertools.pairwise(nodes)]
        worst = max(errors)
        if worst <= COLOUR_ERROR:
            return np.array(nodes), worst
        if len(nodes) >= MAX_NODES:
            raise UnsupportedError(
                f"{path} from {low:g} to {high:g} changes colours too much for {MAX_NODES} nodes "
                f"(dE00 {worst:.2f} between them, {COLOUR_ERROR:g} is allowed); narrow its range"
            )
        at = errors.index(worst)
        nodes.insert(at + 1, 0.5 * (nodes[at] + nodes[at + 1]))
