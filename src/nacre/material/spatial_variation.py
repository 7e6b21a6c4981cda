"""Recipe numbers that vary over the surface, for any family: solved at nodes and interpolated linearly.

The node count follows from the allowed colour error between two of them; a hat function of the texture weights the
lobes of each node. Numbers for which a family has tables of its own (a film's thickness) are not treated here.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nacre.bsdf import Bsdf
from nacre.bsdf.bsdf import Spectrum
from nacre.bsdf.lobes.masked import MaskedLobe, hat
from nacre.bsdf.tabulate import comparison_xyz
from nacre.bsdf.texture import Texture, TextureSpec, read_grey
from nacre.core.arrays import Array, direction
from nacre.core.errors import UnsupportedError
from nacre.families.contract import Figure, Model, Traits
from nacre.formats.number_maps import NumberMap
from nacre.light import delta_e_2000, spans_colour, xyz_to_lab
from nacre.measure.evaluate import evaluate_at_own
from nacre.measure.geometry import aspecular_direction
from nacre.recipe.model import LENGTH_UNITS_NM, RecipeContext, validate

MAX_NUMBERS = 2
MAX_NODES = 9  # each adds a set of lobes to every kernel
COLOUR_ERROR = 1.0  # dE00 midway between nodes, at any test geometry
WALK_SAMPLES = 65_536  # paths of a random walk: noise well below the colour error
TEST_ANGLES_DEG = (0.0, 45.0)  # mirror direction and transmission
TEST_ASPECULAR_DEG = (15.0, 25.0, 45.0, 75.0)
TEST_RANGE_NM = (400.0, 720.0, 9)  # nine bands suffice for pigments and particles


@dataclass(frozen=True)
class Number:
    """A varying number: its recipe path and its texture, in the recipe's unit."""

    path: str
    texture: Texture


@dataclass(frozen=True)
class Varying(Model):
    """A material with one or two numbers that vary over the surface.

    Attributes:
        numbers: the varying numbers.
        fixed: builds the uniform material of given values.
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
        """Read the textures and build the material at the ends of their ranges.

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
        made = cls(tuple(numbers), fixed)
        for corner in itertools.product(*((n.texture.low, n.texture.high) for n in numbers)):
            fixed(made._values(corner))
        return made

    def _values(self, values: tuple[float, ...]) -> dict[str, float]:
        return {number.path: float(value) for number, value in zip(self.numbers, values, strict=True)}

    def _axes(self) -> tuple[list[Array], dict[str, Any]]:
        """Return each number's nodes, and their count and colour error for the provenance."""
        axes, notes = [], {}
        middle = [0.5 * (n.texture.low + n.texture.high) for n in self.numbers]
        for i, number in enumerate(self.numbers):

            def colours(value: float, i: int = i) -> Array:
                return node_colours(self.fixed(self._values((*middle[:i], value, *middle[i + 1 :]))))

            nodes, error = choose_nodes(colours, number.texture.low, number.texture.high, number.path)
            axes.append(nodes)
            notes[number.path] = {"nodes": len(nodes), "colour_error_dE00": round(error, 4)}
        return axes, notes

    def _grid(self, axes: list[Array]) -> Iterator[tuple[tuple[int, ...], Any]]:
        """Yield index and material of each node."""
        for index in itertools.product(*(range(len(nodes)) for nodes in axes)):
            yield index, self.fixed(self._values(tuple(nodes[k] for nodes, k in zip(axes, index, strict=True))))

    @property
    def wavelengths_nm(self) -> Array:
        """The finest grid of the materials at the ends of the ranges."""
        ends = itertools.product(*((n.texture.low, n.texture.high) for n in self.numbers))
        return max((np.asarray(self.fixed(self._values(end)).model.wavelengths_nm) for end in ends), key=len)

    def bsdf(self, wavelengths_nm: Array | None = None) -> Bsdf:
        """Return the masked lobes of all nodes on one grid.

        Raises:
            UnsupportedError: `MAX_NODES` are not enough.
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
        """The material's figures at the surface centre."""
        middle = np.array([0.5, 0.5])
        values = tuple(float(number.texture(middle)) for number in self.numbers)
        figures: Mapping[str, Figure] = self.fixed(self._values(values)).model.figures
        return figures


def node_colours(material: Any) -> Array:
    """Return XYZ `[geometry, 3]` of a material at the geometries where interpolation is tested.

    If the material covers only a part of the visible range, each wavelength counts as a grey, see `comparison_xyz`.
    """
    low, high, count = TEST_RANGE_NM
    own = np.asarray(material.model.wavelengths_nm)
    low, high = (max(low, own[0]), min(high, own[-1])) if spans_colour(own) else (own[0], own[-1])
    grid = np.linspace(low, high, count) if high > low else own
    bsdf = material.bsdf(grid)
    wo = np.stack([aspecular_direction(45.0, angle) for angle in TEST_ASPECULAR_DEG])
    wi = np.broadcast_to(direction(np.radians(45.0)), wo.shape)
    parts = [np.pi * evaluate_at_own(bsdf, wi, wo, samples=WALK_SAMPLES)]
    if bsdf.transmits:
        parts.append(np.pi * evaluate_at_own(bsdf, wi, wo * [1.0, 1.0, -1.0], samples=WALK_SAMPLES))
    mirror = bsdf.specular(np.radians(TEST_ANGLES_DEG))
    parts += [mirror.reflectance, mirror.transmittance]
    return comparison_xyz(np.concatenate(parts), grid).reshape(-1, 3)


def choose_nodes(colours: Callable[[float], Array], low: float, high: float, path: str) -> tuple[Array, float]:
    """Bisect intervals until the colours midway between nodes are within the error; return nodes and error.

    Args:
        colours: XYZ `[geometry, 3]` at a value.
        low, high: range of the number.
        path: name of the number, for messages.

    Raises:
        UnsupportedError: `MAX_NODES` are not enough, or the ends cannot be blended.
    """
    if high <= low:
        return np.array([low]), 0.0
    nodes = [low, high]
    known = {value: colours(value) for value in nodes}
    if known[low].shape != known[high].shape:
        raise UnsupportedError(
            f"{path}: the material transmits light at one end of {low:g} to {high:g} and not at the other, so the "
            "two cannot be blended; narrow the range with min or max"
        )
    differences: dict[tuple[float, float], float] = {}
    while True:
        for before, after in itertools.pairwise(nodes):
            if (before, after) not in differences:
                middle = 0.5 * (before + after)
                known[middle] = colours(middle)
                blended = 0.5 * (known[before] + known[after])
                difference = delta_e_2000(xyz_to_lab(blended), xyz_to_lab(known[middle]))
                differences[before, after] = float(np.max(difference))
        errors = [differences[pair] for pair in itertools.pairwise(nodes)]
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


def number_maps(material: Any) -> list[NumberMap]:
    """Return a map for every number of a recipe that an image gives; formulas are omitted.

    Args:
        material: anything with `data` and `context`.

    Raises:
        RecipeError: an image cannot be read.
    """
    maps = []
    for path, table in _images(material.data):
        grey = read_grey(material.context.path(table["texture"]), f"{material.context.source}: {path}.texture")
        factor = LENGTH_UNITS_NM.get(path.rpartition("_")[2], 0.0)
        low, high = (float(table[end]) * (factor or 1.0) for end in ("min", "max"))
        maps.append(NumberMap(path, low + (high - low) * grey, low, high, "nm" if factor else ""))
    return maps


def _images(data: Any, path: str = "") -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield the path and the table of every image with a range."""
    if isinstance(data, list | tuple):
        for i, value in enumerate(data):
            yield from _images(value, f"{path}[{i}]")
    elif isinstance(data, Mapping):
        if isinstance(data.get("texture"), str) and {"min", "max"} <= set(data):
            yield path, data
            return
        for key, value in data.items():
            yield from _images(value, f"{path}.{key}" if path else str(key))
