"""Reliefs by Maxwell's equations: orders of a periodic surface, each with the width given by the coherence length."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from nacre.bsdf.bsdf import Bsdf
from nacre.bsdf.lobes.orders import OrdersLobe, limited_width
from nacre.bsdf.texture import Texture, parse_formula
from nacre.core.arrays import Array
from nacre.families.contract import Diffracting, Fabricable, Figure, Traits
from nacre.families.relief.material import Relief
from nacre.families.relief.structures import Blocks, Lines
from nacre.matter.drawings import Drawer
from nacre.matter.periodic.order_tables import order_tables
from nacre.matter.periodic.orders import Orders, solve_orders
from nacre.matter.periodic.solve import LARGEST_ERROR
from nacre.matter.periodic.structure import NotConvergedError, PeriodicStack

TABLE_ERROR = 1e-2  # error of an efficiency in the tables over directions
TOLERANCE = {True: 1e-3, False: 2e-4}  # error of an efficiency, for narrow walls and for smooth curves
BLOCKS_TOLERANCE = 4e-3
QUARTER = 0.5 * np.pi


@dataclass(frozen=True, eq=False)
class VectorRelief(Diffracting, Fabricable):
    """A relief of lines or of blocks, solved rigorously.

    Attributes:
        scalar: the same relief in scalar theory, with the surface, coating and coherence.
        pattern: its period.
        tolerance: largest estimated efficiency error; None: 2e-4, of narrow walls 1e-3, of blocks 4e-3.
        reason: why this theory was chosen, or empty.
    """

    traits = Traits(noun="relief", default_geometry="45as15")

    scalar: Relief
    pattern: Lines | Blocks
    tolerance: float | None = None
    reason: str = ""

    @property
    def wavelengths_nm(self) -> Array:
        """The grid of the scalar relief."""
        return self.scalar.wavelengths_nm

    @property
    def warnings(self) -> tuple[str, ...]:
        """Why the theory was chosen, and a remark if the orders are narrower than the coherence requires."""
        lines: tuple[str, ...] = (self.reason,) if self.reason else ()
        width, requested = self._width(float(self.wavelengths_nm[0])), self._coherence_width
        if width < 0.99 * requested:
            lines += (
                f"orders of a period of {self.pattern.period_nm / 1e3:.3g} um overlap in light of this coherence; "
                f"pictures show them {requested / width:.2g} times narrower",
            )
        return lines

    @property
    def figures(self) -> Mapping[str, Figure]:
        """Figures of the material: the surface."""
        return {"structure": self.scalar.figures["structure"]}

    @property
    def fabrications(self) -> Mapping[str, Drawer]:
        """Fabrication files, as for the scalar relief."""
        return self.scalar.fabrications

    @property
    def order_width_rad(self) -> float:
        """Angular standard deviation of each order, by the spatial coherence of the light."""
        return self._coherence_width

    def stacks(self, wavelengths_nm: Array) -> list[PeriodicStack]:
        """Return the structure at wavelengths; x runs across lines."""
        body = self.scalar.coating.n_complex(wavelengths_nm)
        ambient = self.scalar.ambient
        cover = np.ones(len(wavelengths_nm)) if ambient is None else ambient.n_complex(wavelengths_nm).real
        return self.pattern.stacks(cover, body)

    def diffraction_orders(self, theta_rad: Array, azimuth_rad: float, wavelengths_nm: Array | None) -> Orders:
        """Return the reflected orders: (m, n), for lines along y (m, 0), for lines along x (0, n).

        Raises:
            NotConvergedError: the error is above the tolerance; without one, above 2e-2.
        """
        lam = self.wavelengths_nm if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
        stacks = dict(zip(lam.tolist(), self.stacks(lam), strict=True))
        turn = QUARTER if self._is_turned else 0.0
        is_strict = self.tolerance is not None
        orders = solve_orders(lambda w: stacks[w], theta_rad, azimuth_rad - turn, lam, self._tolerance, is_strict)
        if not is_strict and float(orders.error.max()) > LARGEST_ERROR:
            raise NotConvergedError(
                f"orders of the relief: error {orders.error.max():.1e}; allowed: at most {LARGEST_ERROR:g}, by flatter "
                'heights, more blur, or model.optics = "scalar"'
            )
        if not self._is_turned:
            return orders

        def turned(directions: Array) -> Array:
            return np.stack([-directions[..., 1], directions[..., 0], directions[..., 2]], axis=-1)

        return replace(
            orders, numbers=orders.numbers[:, ::-1], azimuth_rad=azimuth_rad,
            reflected_direction=turned(orders.reflected_direction),
            transmitted_direction=turned(orders.transmitted_direction),
        )  # fmt: skip

    def bsdf(self, wavelengths_nm: Array | None = None) -> Bsdf:
        """Solve the orders on a direction grid; the zero order is as wide as the others.

        Raises:
            NotConvergedError: the period is too long for the shortest wavelength.
        """
        lam = self.wavelengths_nm if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
        table = order_tables(self.stacks(lam), lam, self._tolerance, TABLE_ERROR)
        power = np.concatenate([table.mirror[:, :, None, :].astype(np.float32), table.reflected], axis=2)
        orders = np.concatenate([np.zeros((1, 2), dtype=np.int64), table.orders])
        width = self._width(float(lam[0]))
        rotation = Texture(QUARTER, QUARTER, formula=parse_formula(repr(QUARTER))) if self._is_turned else None
        lobe = OrdersLobe(lam, power, table.lattice / self.scalar.index_above, orders, width, rotation)
        return Bsdf((lobe,), {"optics": "vector", "estimated_error": float(f"{table.error:.2g}")})

    @property
    def _is_turned(self) -> bool:
        """Whether the lines lie along x."""
        return isinstance(self.pattern, Lines) and not self.pattern.along_x

    @property
    def _tolerance(self) -> float:
        if self.tolerance is not None:
            return self.tolerance
        return BLOCKS_TOLERANCE if isinstance(self.pattern, Blocks) else TOLERANCE[self.pattern.has_steps]

    @property
    def _coherence_width(self) -> float:
        return self.scalar.coherence.blur / self.scalar.index_above

    def _width(self, shortest_nm: float) -> float:
        return limited_width(self._coherence_width, self.pattern.lattice / self.scalar.index_above, shortest_nm)
