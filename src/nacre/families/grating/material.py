"""The grating material: parameters, orders and Bsdf."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from nacre.bsdf import Bsdf
from nacre.bsdf.bsdf import Spectrum
from nacre.bsdf.grids import interpolate, take_uniform
from nacre.bsdf.lobe import Lobe
from nacre.bsdf.lobes.diffuse import Diffuse
from nacre.bsdf.lobes.orders import OrdersLobe, limited_width
from nacre.bsdf.lobes.specular import AlignedSpecular, Specular
from nacre.bsdf.response import InterfaceResponse
from nacre.bsdf.tabulate import is_transparent
from nacre.bsdf.texture import Texture, parse_formula
from nacre.core.arrays import Array
from nacre.core.errors import UnsupportedError
from nacre.families.contract import Diffracting, Model, Pixels, Traits
from nacre.families.grating.outlines import outlines
from nacre.matter.indices.constant import OpticalConstant
from nacre.matter.periodic.order_tables import MAX_THETA, OrderTables, order_tables
from nacre.matter.periodic.orders import Orders, coarse_orders, solve_orders
from nacre.matter.periodic.structure import Cell, PatternLayer, PeriodicStack, Profile, Shape

MIRROR_NODES = 65


def _diffuse(lost: Array, wavelengths_nm: Array) -> Diffuse:
    """Return a reciprocal lobe that spreads the light lost from the orders, `[theta, wavelength]`, over all exits."""
    cosines = np.linspace(0.0, 1.0, MIRROR_NODES)
    entry = interpolate(lost, (np.arccos(cosines) / (0.5 * np.pi) * (len(lost) - 1),))
    x, weight = np.polynomial.legendre.leggauss(64)
    mu = 0.5 * (x + 1.0)
    mean = np.einsum("q,ql->l", weight * mu, take_uniform(entry, mu, 0))
    return Diffuse(wavelengths_nm, np.where(mean > 0.0, 1.0 / np.maximum(mean, 1e-12), 0.0), entry)


@dataclass(frozen=True)
class Spread:
    """Angular standard deviation of each order, and standard deviations of places and sizes."""

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
class GratingLayer:
    """One layer with its shapes."""

    thickness_nm: float
    material: OpticalConstant
    shapes: tuple[tuple[Shape, OpticalConstant], ...] = ()


@dataclass(frozen=True, eq=False)
class Grating(Model, Diffracting, Pixels):
    """A periodic structure of layers, or of a profile, on a substrate.

    Attributes:
        turn_deg: angle from u to the direction across the lines; `turn`: a texture in its place.
        tolerance: largest estimated error of an efficiency; None: by method.
        is_coarse: solve once at the smallest size, for searches among many similar materials.
    """

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

    @property
    def wavelengths_nm(self) -> Array:
        """Default grid."""
        return np.array(self.grid_nm)

    def stacks(self, wavelengths_nm: Array) -> list[PeriodicStack]:
        """Return the structure at wavelengths."""
        lam = np.asarray(wavelengths_nm, dtype=float)
        cover, substrate = self.ambient.n_complex(lam).real, self.substrate.n_complex(lam)
        grounds = [layer.material.n_complex(lam) ** 2 for layer in self.layers]
        shapes = [[material.n_complex(lam) ** 2 for _, material in layer.shapes] for layer in self.layers]
        return [
            PeriodicStack(
                self.cell,
                float(cover[k]),
                tuple(
                    PatternLayer(
                        layer.thickness_nm,
                        complex(ground[k]),
                        tuple((shape, complex(e[k])) for (shape, _), e in zip(layer.shapes, inner, strict=True)),
                    )
                    for layer, ground, inner in zip(self.layers, grounds, shapes, strict=True)
                ),
                complex(substrate[k]),
                self.profile,
            )
            for k in range(len(lam))
        ]

    def diffraction_orders(self, theta_rad: Array, azimuth_rad: float, wavelengths_nm: Array | None) -> Orders:
        """Return the orders for light from an azimuth in the frame of the surface."""
        lam = self.wavelengths_nm if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
        stacks = dict(zip(lam.tolist(), self.stacks(lam), strict=True))
        azimuth = azimuth_rad - np.radians(self.turn_deg)
        if self.is_coarse:
            return coarse_orders(lambda w: stacks[w], theta_rad, azimuth, lam)
        return solve_orders(lambda w: stacks[w], theta_rad, azimuth, lam, self.tolerance)

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
        x, y = self.pitch_nm
        return [
            (number, corners)
            for number, layer in enumerate(self.layers, start=1)
            for shape, _ in layer.shapes
            for corners in outlines(shape, x, y)
        ]

    def bsdf(self, wavelengths_nm: Array | None = None) -> Bsdf:
        """Solve the orders on a grid of directions: the zero order is a mirror, the others form a lobe.

        Orders transmitted beside the zero order are part of `spectrum` only. Light from behind is neither reflected nor
        diffracted; the zero order passes it.
        """
        lam = self.wavelengths_nm if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
        table = order_tables(self.stacks(lam), lam, self.tolerance)
        notes = {"estimated_error": float(f"{table.error:.2g}")}
        lobes: list[Lobe] = [self._mirror(table, lam)]
        if len(table.orders):
            width = limited_width(self.spread.angle_rad, table.lattice, float(lam[0]))
            kept = self.spread.coherent_share(table.orders @ table.lattice)[:, None].astype(np.float32)
            lobes.append(OrdersLobe(lam, table.reflected * kept, table.lattice, table.orders, width, self._rotation))
            if np.any(kept < 1.0):
                lost = np.einsum("taow,o->tw", table.reflected[:, :-1], 1.0 - kept[:, 0]) / (table.mirror.shape[1] - 1)
                lobes.append(_diffuse(lost, lam))
        return Bsdf(tuple(lobes), notes)

    @property
    def _rotation(self) -> Texture | None:
        """The turn in rad."""
        degree = np.pi / 180.0
        if self.turn is None:
            if self.turn_deg == 0.0:
                return None
            return Texture(
                self.turn_deg * degree, self.turn_deg * degree, formula=parse_formula(repr(self.turn_deg * degree))
            )
        made = self.turn
        if made.formula is not None:
            scaled = replace(parse_formula(f"({made.formula.text})*{degree!r}"), written=made.formula.written)
            return Texture(made.low * degree, made.high * degree, formula=scaled)
        return Texture(made.low * degree, made.high * degree, image=made.image, is_stepped=made.is_stepped)

    def _mirror(self, table: OrderTables, lam: Array) -> Lobe:
        """Return the zero order; if the turn varies over the surface, its mean over the azimuth."""
        index, outer = self.substrate.n_complex(lam), self.ambient.n_complex(lam).real
        transmits = is_transparent(index)
        eta = float(np.mean(index.real) / np.mean(outer)) if transmits else 1.0
        transmits = transmits and eta >= 1.0
        eta = eta if transmits and abs(eta - 1.0) > 1e-6 else 1.0
        cosines = np.linspace(0.0, 1.0, MIRROR_NODES)
        at = np.arccos(cosines) / (0.5 * np.pi) * (table.mirror.shape[0] - 1)
        reflected, passed = (
            np.moveaxis(interpolate(part, (at,)), 0, 1) for part in (table.mirror, table.passed)
        )  # [azimuth, cosine, wavelength]
        if not transmits:
            passed = np.zeros_like(passed)
        total = np.zeros((*reflected.shape[:1], 2 if eta > 1.0 else 0, len(lam)))
        if self.turn is None:
            response = InterfaceResponse(
                lam, cosines, reflected, passed, np.zeros_like(reflected), total, eta, transmits
            )
            return AlignedSpecular(response, float(np.radians(self.turn_deg)))
        reflected, passed = reflected[:-1].mean(axis=0), passed[:-1].mean(axis=0)
        response = InterfaceResponse(
            lam, cosines, reflected, passed, np.zeros_like(reflected), total[0], eta, transmits
        )
        return Specular(response)

    def spectrum(
        self, theta_rad: Array, wavelengths_nm: Array | None = None, polarisation: str = "both", seed: int = 0
    ) -> Spectrum:
        """Return the zero order (specular) and all others (diffuse), for light from azimuth 0.

        Raises:
            UnsupportedError: the polarisation is not known.
        """
        if polarisation not in ("s", "p", "both"):
            raise UnsupportedError(f'polarisation = "{polarisation}" is not known; use s, p or both')
        theta = np.atleast_1d(np.asarray(theta_rad, dtype=float))
        found = self.diffraction_orders(np.minimum(theta, MAX_THETA), 0.0, wavelengths_nm)
        is_zero = np.all(found.numbers == 0, axis=1)

        def part(efficiency: Array, chosen: Array) -> Array:
            both = np.nan_to_num(efficiency[:, :, chosen]).sum(axis=2)
            return np.asarray({"s": both[..., 0], "p": both[..., 1]}.get(polarisation, both.mean(axis=-1)))

        lam = found.wavelengths_nm
        transmits = is_transparent(self.substrate.n_complex(lam))
        return Spectrum(
            lam,
            np.degrees(theta),
            part(found.reflected, is_zero),
            part(found.transmitted, is_zero) if transmits else None,
            part(found.reflected, ~is_zero),
            part(found.transmitted, ~is_zero) if transmits else None,
        )
