"""The grating material: parameters, orders and Bsdf."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from nacre.bsdf import Bsdf
from nacre.bsdf.lobe import Lobe
from nacre.bsdf.lobes.interface import AlignedSpecular, Diffuse, Specular
from nacre.bsdf.lobes.orders import OrdersLobe, limited_width
from nacre.bsdf.response import InterfaceResponse
from nacre.bsdf.tabulate import is_transparent
from nacre.bsdf.texture import ParameterAxis, Texture, angle_texture
from nacre.core.arrays import Array, gauss_legendre, interpolate, rotation_about_z, take_uniform
from nacre.core.errors import UnsupportedError
from nacre.families.contract import Diffracting, DirectEvaluation, Fabricable, Pixels, Traits
from nacre.families.grating.profiles import outlines
from nacre.light import sampling_warning
from nacre.matter.drawings import CellField, Drawer, DrawingRequest
from nacre.matter.indices.constant import OpticalConstant
from nacre.matter.periodic.order_tables import MAX_THETA, OrderTables, in_common, order_tables
from nacre.matter.periodic.orders import Orders, coarse_orders, solutions_of, solve_orders
from nacre.matter.periodic.solve import LARGEST_ERROR
from nacre.matter.periodic.structure import (
    COARSE,
    Cell,
    PatternLayer,
    PeriodicStack,
    Profile,
    Rectangle,
    Region,
    Shape,
    Wall,
    propagating,
    sliced,
)

MIRROR_NODES = 129
LEAST_BELL = 1e-4  # fraction of an order's peak below which it is not solved
MOST_DIRECT = 1000  # number of solutions from which a table over all directions is faster
NODE_RATIO = 0.12  # relative distance between neighbouring nodes of a period


def _diffuse(share: Array, wavelengths_nm: Array) -> Diffuse:
    """Return a reciprocal lobe that spreads the light lost from the orders, `[theta, wavelength]`, over all exits."""
    cosines = np.linspace(0.0, 1.0, MIRROR_NODES)
    entry = interpolate(share, (np.arccos(cosines) / (0.5 * np.pi) * (len(share) - 1),))
    x, weight = gauss_legendre(64)
    mu = 0.5 * (x + 1.0)
    mean = np.einsum("q,ql->l", weight * mu, take_uniform(entry, mu, 0))
    return Diffuse(wavelengths_nm, np.where(mean > 0.0, 1.0 / np.maximum(mean, 1e-12), 0.0), entry)


@dataclass(frozen=True)
class Spread:
    """Angular standard deviation that each order should have, and standard deviations of places and sizes."""

    angle_rad: float
    period_deviation_nm: float = 0.0
    size_deviation_nm: float = 0.0

    def coherent_share(self, vectors: Array) -> Array:
        """Return the share of each order that disorder leaves in it: the Debye-Waller factor exp(-(2 pi g s)^2).

        Walls deviate by their place and by half the deviation of a size, s^2 = place^2 + (size / 2)^2. The zero order
        keeps its light.

        Args:
            vectors: `[order, 2]`, g in 1/nm.
        """
        deviation = np.hypot(self.period_deviation_nm, 0.5 * self.size_deviation_nm)
        return np.asarray(np.exp(-np.sum((2.0 * np.pi * deviation * vectors) ** 2, axis=1)))


@dataclass(frozen=True, eq=False)
class VaryingPeriod:
    """A period that varies over the surface."""

    texture: Texture

    @property
    def nodes(self) -> tuple[float, ...]:
        """Periods at which orders are solved, ascending and even."""
        low, high = self.texture.low, self.texture.high
        count = int(np.ceil(np.log(high / low) / NODE_RATIO)) + 1 if high > low else 1
        return tuple(np.linspace(low, high, count).tolist())


@dataclass(frozen=True, eq=False)
class GratingLayer:
    """One layer with its shapes, their materials and their walls."""

    thickness_nm: float
    material: OpticalConstant
    shapes: tuple[tuple[Shape, OpticalConstant, Wall], ...] = ()


@dataclass(frozen=True, eq=False)
class Grating(Diffracting, DirectEvaluation, Pixels, Fabricable):
    """A periodic structure of layers, or of a profile, on a substrate.

    Attributes:
        cell: the lattice; where the period varies, that of the surface's middle.
        turn_deg: angle from u to the direction across the lines; `turn`: a texture in its place.
        period: unset for a single one.
        tolerance: largest estimated efficiency error; None: by method.
        is_coarse: solve once at the smallest size, for searches among many similar materials.
    """

    has_mirror = True
    is_direct = False  # a table over all directions is quicker for many of them
    version = 8  # degree 6 of the smallest elements
    traits = Traits(noun="grating", default_parts=("specular_reflectance", "diffuse_reflectance"), takes_ambient=True)

    ambient: OpticalConstant
    layers: tuple[GratingLayer, ...]
    substrate: OpticalConstant
    cell: Cell
    profile: Profile | None
    spread: Spread
    turn_deg: float
    turn: Texture | None
    tolerance: float | None
    grid_nm: tuple[float, ...]
    is_coarse: bool = False
    period: VaryingPeriod | None = None

    @property
    def wavelengths_nm(self) -> Array:
        """Default grid."""
        return np.array(self.grid_nm)

    def stacks(self, wavelengths_nm: Array) -> list[PeriodicStack]:
        """Return the structure at wavelengths; sloping walls as steps that can be refined."""
        lam = np.asarray(wavelengths_nm, dtype=float)
        cover, substrate = self.ambient.n_complex(lam).real, self.substrate.n_complex(lam)
        grounds = [layer.material.n_complex(lam) ** 2 for layer in self.layers]
        inner = [[material.n_complex(lam) ** 2 for _, material, _ in layer.shapes] for layer in self.layers]
        is_sloped = any(not wall.is_vertical for layer in self.layers for _, _, wall in layer.shapes)

        is_straight = is_sloped and self.cell.period_y is None and all(
            isinstance(shape, Rectangle) and wall.rounding_nm == 0.0
            for layer in self.layers for shape, _, wall in layer.shapes
        )  # fmt: skip

        def made(k: int, count: int) -> PeriodicStack:
            layers: list[PatternLayer] = []
            tilted: list[tuple[PatternLayer, tuple[float, ...]]] = []
            for layer, ground, values in zip(self.layers, grounds, inner, strict=True):
                shapes = [
                    (shape, complex(e[k]), wall) for (shape, _, wall), e in zip(layer.shapes, values, strict=True)
                ]  # fmt: skip
                layers += sliced(layer.thickness_nm, complex(ground[k]), shapes, count)
                pattern = PatternLayer(layer.thickness_nm, complex(ground[k]), tuple((s, e) for s, e, _ in shapes))
                insets = (float(wall.insets(layer.thickness_nm, np.zeros(1))[0]) for _, _, wall in shapes)
                tilted.append((pattern, tuple(insets)))
            refined = partial(made, k) if is_sloped and count == COARSE else None
            return PeriodicStack(
                self.cell, float(cover[k]), tuple(layers), complex(substrate[k]), self.profile, refined,
                tuple(tilted) if is_straight and count == COARSE else None,
            )  # fmt: skip

        return [made(k, COARSE) for k in range(len(lam))]

    @property
    def order_width_rad(self) -> float:
        """Angular standard deviation, limited so that neighbouring orders do not overlap."""
        return self._order_width(self.wavelengths_nm)

    def _order_width(self, lam: Array) -> float:
        cell = self.cell if self.period is None else self._cell_of(self.period.nodes[-1])
        outer = float(np.mean(self.ambient.n_complex(lam).real))  # direction cosines are those in the ambient
        lattice = cell.wave_vectors(np.eye(2)) / (2.0 * np.pi) / outer
        return limited_width(self.spread.angle_rad, lattice, float(min(lam[0], self.grid_nm[0])))

    @property
    def warnings(self) -> tuple[str, ...]:
        """A warning if the orders are narrower than the requested width."""
        width, widths = np.degrees([self.order_width_rad, self.spread.angle_rad])
        if width > 0.99 * widths:
            return ()
        return (f"orders.spread_deg = {widths:.3g} makes orders overlap; they are {width:.2g} degrees wide",)

    @property
    def coarse_warning(self) -> str:
        """Warning for two periods; coarse colours of lines are within dE00 0.15 of converged ones."""
        if not self.is_coarse or self.cell.period_y is None:
            return ""
        return (
            "among many variants its orders are solved once, by the smallest basis: colours are off by up to dE00 3 at "
            "narrow resonances (discs of silicon: 0.5 in the median); model.tolerance solves until orders converge"
        )

    def diffraction_orders(self, theta_rad: Array, azimuth_rad: float, wavelengths_nm: Array | None) -> Orders:
        """Return the orders for light from an azimuth in the surface's frame."""
        lam = self.wavelengths_nm if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
        stacks = dict(zip(lam.tolist(), self.stacks(lam), strict=True))
        azimuth = azimuth_rad - np.radians(self.turn_deg)
        if self.is_coarse:
            orders = coarse_orders(lambda w: stacks[w], theta_rad, azimuth, lam)
        else:
            orders = solve_orders(lambda w: stacks[w], theta_rad, azimuth, lam, self.tolerance)
        turn = rotation_about_z(np.radians(self.turn_deg)).T  # rows: axes of the lattice in the surface's frame
        return replace(
            orders, azimuth_rad=azimuth_rad, reflected_direction=orders.reflected_direction @ turn,
            transmitted_direction=orders.transmitted_direction @ turn,
        )  # fmt: skip

    def transmits_orders(self, wavelengths_nm: Array) -> bool:
        """Whether the substrate is clear."""
        return is_transparent(self.substrate.n_complex(wavelengths_nm))

    def scatters_orders(self, wavelengths_nm: Array) -> bool:
        """Whether orders beside the mirror propagate at some direction of the light."""
        if self.profile is None and not any(layer.shapes for layer in self.layers):
            return False
        lam = np.asarray(wavelengths_nm, dtype=float)
        grating = self if self.period is None else replace(self, cell=self._cell_of(self.period.nodes[-1]))
        return any(
            len(propagating(stack, 2.0 * np.pi / w, np.zeros(2), stack.cover + stack.reach)[0]) > 1
            for stack, w in zip(grating.stacks(lam), lam.tolist(), strict=True)
        )

    @property
    def pitch_nm(self) -> tuple[float, float]:
        """Periods along x and y; lines repeat along y with the same period.

        Raises:
            UnsupportedError: the cell is not a rectangle.
        """
        if self.cell.period_y is not None and not self.cell.is_rectangular:
            raise UnsupportedError("pixels of an oblique cell cannot fill a field; allowed: a rectangular cell")
        return self.cell.period_x, self.cell.period_y or self.cell.period_x

    def pixel_polygons(self) -> list[tuple[int, Array]]:
        """Return the layer (from 1, the upper one first) and the corners of each shape, about the cell's centre."""
        return self._polygons(self.pitch_nm)

    def _polygons(self, sides_nm: tuple[float, float]) -> list[tuple[int, Array]]:
        return [
            (number, corners)
            for number, layer in enumerate(self.layers, start=1)
            for shape, _, _ in layer.shapes
            for corners in outlines(shape, *sides_nm)
        ]

    @property
    def fabrications(self) -> Mapping[str, Drawer]:
        """Masks of layers with shapes, unless they vary over the surface."""
        is_drawn = self.period is None and self.turn is None and any(layer.shapes for layer in self.layers)
        return {"gds": self._field, "oas": self._field} if is_drawn else {}

    def _field(self, request: DrawingRequest) -> CellField:
        """Return a rectangular cell; a hexagonal lattice has two points in it.

        Raises:
            UnsupportedError: another oblique lattice.
        """
        a = self.cell.period_x
        if self.cell.period_y == a and abs(abs(np.cos(self.cell.angle_rad)) - 0.5) < 1e-9:
            if any(isinstance(s, Region) and s.key[0] == "image" for layer in self.layers for s, _, _ in layer.shapes):
                raise UnsupportedError("an image of an oblique cell cannot be drawn; allowed: a rectangular cell")
            sides = a, float(np.sqrt(3.0)) * a
            at_corner = self._polygons((a, a))
            polygons = [(k, c + at * np.array(sides)) for at in (-0.25, 0.25) for k, c in at_corner]
        else:
            sides = self.pitch_nm
            polygons = self._polygons(sides)
        layers = {str(k): {"thickness_nm": each.thickness_nm} for k, each in enumerate(self.layers, start=1)}
        return CellField(tuple(polygons), sides, {"layers": layers, "turn_deg": self.turn_deg})

    def bsdf(self, wavelengths_nm: Array | None = None) -> Bsdf:
        """Solve the orders on a direction grid: the zero order is a mirror, the others form a lobe.

        Transmitted orders form another lobe, which passes light of both sides. Light from behind is not reflected.

        Raises:
            NotConvergedError: the orders do not converge.
        """
        lam = self.wavelengths_nm if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
        cells = [self.cell] if self.period is None else [self._cell_of(p) for p in self.period.nodes]
        largest = max(LARGEST_ERROR, self.tolerance or 0.0)
        tables = in_common([
            order_tables(replace(self, cell=cell).stacks(lam), lam, self.tolerance, largest_error=largest)
            for cell in cells
        ])  # fmt: skip
        error, between = max(t.error for t in tables), max(t.between for t in tables)
        notes: dict[str, Any] = {
            "estimated_error": float(f"{error:.2g}"),
            "interpolation_error": float(f"{between:.2g}"),
        }
        warnings: list[str] = []
        for part in (each for t in tables for each in (t.mirror, t.passed, t.reflected.sum(axis=2))):
            some = part[: -1 : len(part) // 2, : -1 : max(part.shape[1] // 4, 1)]  # 0 and 45 degrees, four azimuths
            if not warnings and (remark := sampling_warning(some, lam)):
                warnings.append(remark)
        if error > largest:
            warnings.append(f"the table of its orders has errors up to {error:.2g}; nacre orders solves better")
        if between > largest:
            warnings.append(
                f"interpolation in the table of its orders has errors up to {between:.2g}, beside angles at which an "
                "order begins to propagate; nacre orders solves each direction; fewer wavelengths allow a finer table"
            )
        if warnings:
            notes["warnings"] = warnings
        axes: tuple[ParameterAxis, ...] = ()
        if self.period is not None and len(cells) > 1:
            axes = (ParameterAxis("lattice.period_nm", np.array(self.period.nodes), self.period.texture),)
        eta = self._eta(lam)
        lobes: list[Lobe] = [self._mirror(tables, lam, eta, axes)]
        first = tables[0]
        if not len(first.orders):
            return Bsdf(tuple(lobes), notes)
        outer, width = float(np.mean(self.ambient.n_complex(lam).real)), self._order_width(lam)
        coherent = [self.spread.coherent_share(t.orders @ t.lattice)[:, None].astype(np.float32) for t in tables]
        for name, index in (("reflected", 0.0), ("transmitted", eta)):
            parts = [getattr(t, name) * share for t, share in zip(tables, coherent, strict=True)]
            if name == "transmitted" and (index == 0.0 or not any(np.any(part) for part in parts)):
                continue
            power = np.stack(parts) if axes else parts[0]
            lattice = first.lattice / outer
            lobes.append(OrdersLobe(lam, power, lattice, first.orders, width, self._rotation, index, axes))
        if any(np.any(share < 1.0) for share in coherent):
            diffuse = [
                np.einsum("taow,o->tw", t.reflected[:, :-1], 1.0 - share[:, 0]) / (t.mirror.shape[1] - 1)
                for t, share in zip(tables, coherent, strict=True)
            ]
            lobes.append(_diffuse(np.mean(diffuse, axis=0), lam))
        return Bsdf(tuple(lobes), notes)

    def values_at(self, wi: Array, wo: Array, wavelengths_nm: Array) -> Array | None:
        """Solve the orders that leave along `wo`, each at its wavelengths.

        None if the material varies over the surface, is disordered or without orders, or for directions below.
        """
        disorder = self.spread.period_deviation_nm + self.spread.size_deviation_nm
        is_uniform = self.period is None and self.turn is None and disorder == 0.0
        is_above = bool(np.all(wi[:, 2] > 0.0) and np.all(wo[:, 2] > 0.0))
        if not (is_uniform and is_above and self.scatters_orders(wavelengths_nm)):
            return None
        lobe, stacks = self._unsolved(wavelengths_nm), self.stacks(wavelengths_nm)
        number, bell, directions = lobe.lines(wi, wo)
        pairs, waves = np.nonzero(bell > LEAST_BELL * bell.max(initial=0.0))
        lights = np.concatenate([each[pairs] for each in directions])
        theta = np.minimum(np.arccos(np.clip(lights[:, 2], 0.0, 1.0)), MAX_THETA).tolist()
        phi = (np.arctan2(lights[:, 1], lights[:, 0]) + np.pi).tolist()
        cases = list(zip(np.tile(waves, 2).tolist(), theta, phi, strict=True))
        distinct = list(dict.fromkeys(cases))
        if len(distinct) > MOST_DIRECT:
            return None
        waved = [(stacks[w], float(wavelengths_nm[w]), t, p) for w, t, p in distinct]
        solved = dict(zip(distinct, solutions_of(waved, self.tolerance, self.is_coarse), strict=True))
        values = np.zeros(bell.shape)
        for k, case in enumerate(cases):  # as in `OrdersLobe`, the mean over exchanged directions
            side, at = solved[case].reflected, (pairs[k % len(pairs)], waves[k % len(pairs)])
            is_own = np.all(side.numbers == lobe.orders[number[at]], axis=1)
            values[at] += 0.5 * bell[at] * float(side.efficiency[is_own].mean(axis=1).sum())
        return values

    @property
    def line_nm(self) -> float:
        """Standard deviation in wavelength of the narrowest order at fixed directions."""
        return self._unsolved(self.wavelengths_nm).line_nm

    def _unsolved(self, lam: Array) -> OrdersLobe:
        """Return the lobe of reflected orders without their efficiencies."""
        stacks = self.stacks(lam)
        numbers = {
            (int(m), int(n))
            for stack, w in zip(stacks, lam.tolist(), strict=True)
            for m, n in propagating(stack, 2.0 * np.pi / w, np.zeros(2), 2.0 * stack.cover)[0]
        }
        orders = np.array(sorted(numbers - {(0, 0)}), dtype=np.int64).reshape(-1, 2)
        lattice = self.cell.wave_vectors(np.eye(2)) / (2.0 * np.pi) / float(np.mean([s.cover for s in stacks]))
        none = np.zeros((2, 2, len(orders), len(lam)), dtype=np.float32)
        return OrdersLobe(np.asarray(lam), none, lattice, orders, self._order_width(lam), self._rotation)

    def _cell_of(self, period_nm: float) -> Cell:
        return Cell(period_nm, None if self.cell.period_y is None else period_nm, self.cell.angle_rad)

    def _eta(self, lam: Array) -> float:
        """Return the relative index below, for the refraction of all wavelengths; 0 if no light passes."""
        index, outer = self.substrate.n_complex(lam), self.ambient.n_complex(lam).real
        eta = float(np.mean(index.real) / np.mean(outer)) if is_transparent(index) else 0.0
        if eta < 1.0:
            return 0.0
        return eta if eta - 1.0 > 1e-6 else 1.0

    @property
    def _rotation(self) -> Texture | None:
        """The turn in rad."""
        return angle_texture(self.turn_deg if self.turn is None else self.turn)

    def _mirror(
        self, tables: list[OrderTables], lam: Array, eta: float, axes: tuple[ParameterAxis, ...]
    ) -> Lobe:  # fmt: skip
        """Return the zero order; if the turn or the period varies over the surface, its mean over the azimuth."""
        transmits, eta = eta > 0.0, max(eta, 1.0)
        cosines = np.linspace(0.0, 1.0, MIRROR_NODES)
        at = np.arccos(cosines) / (0.5 * np.pi) * (tables[0].mirror.shape[0] - 1)

        def over_cosine(part: Array) -> Array:
            return np.moveaxis(interpolate(part, (at,)), 0, 1)  # [azimuth, cosine, wavelength]

        reflected = np.stack([over_cosine(t.mirror) for t in tables])
        passed = np.stack([over_cosine(t.passed) for t in tables]) * float(transmits)
        beyond = 2 if eta > 1.0 else 0
        if self.turn is None and self.period is None:
            total = np.zeros((*reflected.shape[1:2], beyond, len(lam)))
            response = InterfaceResponse(
                lam, cosines, reflected[0], passed[0], np.zeros_like(reflected[0]), total, eta, transmits
            )
            return AlignedSpecular(response, float(np.radians(self.turn_deg)))
        reflected, passed = reflected[:, :-1].mean(axis=1), passed[:, :-1].mean(axis=1)
        total = np.zeros((len(tables), beyond, len(lam)))
        if not axes:
            reflected, passed, total = reflected[0], passed[0], total[0]
        response = InterfaceResponse(
            lam, cosines, reflected, passed, np.zeros_like(reflected), total, eta, transmits, parameters=axes
        )
        return Specular(response)
