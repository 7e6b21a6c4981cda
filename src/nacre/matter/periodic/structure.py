"""Periodic structures at one wavelength: cell, shapes, layers, profile, and diffraction orders.

Sloping and rounded walls become slices with vertical walls.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from nacre.core.errors import NacreError
from nacre.matter.periodic.types import Array

MAX_UNKNOWNS = 1500  # unknowns in one linear system: some ten seconds
NORMAL = 1e-14  # smaller transverse wave numbers are zero
CLEAR_K = 1e-6  # a substrate with a smaller k transmits orders
LEAST_ELEVATION = 4e-7  # least angle between light and surface (k_z loses digits below); smaller ones use it
GRAZING = 1e-13  # least (k_z / k0)^2 for an order; below, a wave along the surface carries no energy


@dataclass(frozen=True)
class Cell:
    """The lattice, in nm: vectors (period_x, 0) and period_y (cos angle, sin angle); lines if period_y is None."""

    period_x: float
    period_y: float | None = None
    angle_rad: float = 0.5 * np.pi

    @property
    def is_rectangular(self) -> bool:
        """Whether the vectors are at right angles."""
        return self.period_y is not None and abs(self.angle_rad - 0.5 * np.pi) < 1e-12

    @property
    def vectors(self) -> Array:
        """The lattice vectors of two periods, `[2, 2]`, a row each."""
        assert self.period_y is not None
        second = self.period_y * np.array([np.cos(self.angle_rad), np.sin(self.angle_rad)])
        return np.array([[self.period_x, 0.0], second])

    def wave_vectors(self, orders: Array) -> Array:
        """Return 2 pi (m b_1 + n b_2), `[..., 2]` in 1/nm, of orders `[..., 2]`."""
        m, n = orders[..., 0], orders[..., 1]
        x = m / self.period_x
        if self.period_y is None:
            return 2.0 * np.pi * np.stack([x, 0.0 * x], axis=-1)
        y = (n / self.period_y - m * np.cos(self.angle_rad) / self.period_x) / np.sin(self.angle_rad)
        return 2.0 * np.pi * np.stack([x, y], axis=-1)


def reflection(axis_rad: float) -> Array:
    """Return the reflection `[2, 2]` on the line through the origin at an angle to x."""
    c, s = np.cos(2.0 * axis_rad), np.sin(2.0 * axis_rad)
    return np.array([[c, s], [s, -c]])


@dataclass(frozen=True)
class Rectangle:
    """Sides along x and y, in nm; a line reaches over all y."""

    x_0: float
    x_1: float
    y_0: float = -np.inf
    y_1: float = np.inf


@dataclass(frozen=True, eq=False)
class Region:
    """Any shape, by the signed distance to its wall (negative inside) and the outward normal there.

    Attributes:
        distance: function of x, y (arrays, nm).
        key: identifies the shape, for equality.
    """

    distance: Callable[[Array, Array], Array]
    key: tuple[object, ...]


Shape = Rectangle | Region


@dataclass(frozen=True)
class PatternLayer:
    """One layer: thickness in nm, permittivity of the ground, and shapes with their permittivities."""

    thickness_nm: float
    epsilon: complex
    shapes: tuple[tuple[Shape, complex], ...] = ()


@dataclass(frozen=True, eq=False)
class Profile:
    """A surface z = a(x), from -depth to 0, as functions of x / period; films follow it.

    Attributes:
        corners: `[corner]`, fractions of the period in [0, 1), ascending, where the slope jumps.
        height, slope: a and da/dx, both in units of the depth and of the period.
        key: identifies the profile; an empty one is never stored.
    """

    depth_nm: float
    corners: tuple[float, ...]
    height: Callable[[Array], Array]
    slope: Callable[[Array], Array]
    key: tuple[object, ...] = ()


@dataclass(frozen=True)
class PeriodicStack:
    """A periodic structure at one wavelength.

    Attributes:
        cover: real index of the light's medium.
        layers: from the top down.
        substrate: complex index.
        refined: for sloping walls, which `layers` approximate by steps: function that returns more steps.
        tilted: the layers of lines with straight walls, each with the distance by which the upper end of each wall lies
            inside its place at half the height.
    """

    cell: Cell
    cover: float
    layers: tuple[PatternLayer, ...]
    substrate: complex
    profile: Profile | None = None
    refined: Callable[[int], PeriodicStack] | None = field(default=None, compare=False)
    tilted: tuple[tuple[PatternLayer, tuple[float, ...]], ...] | None = field(default=None, compare=False)

    @property
    def is_clear(self) -> bool:
        """Whether orders leave into the substrate."""
        return self.substrate.imag < CLEAR_K

    @property
    def reach(self) -> float:
        """Largest transverse wave number of orders that propagate, over k0."""
        return max(self.cover, self.substrate.real if self.is_clear else 0.0)


@dataclass(frozen=True, eq=False)
class OrderSet:
    """Orders that propagate on one side.

    Attributes:
        numbers: `[order, 2]`.
        direction: `[order, 3]`, wave vector over k0, z up.
        jones: `[order, out, in]`, (s, p) of unit E: amplitudes at z = 0 or at the bottom plane, x = y = 0.
        efficiency: `[order, in]`.
    """

    numbers: Array
    direction: Array
    jones: Array
    efficiency: Array


@dataclass(frozen=True, eq=False)
class OrderSolution:
    """All orders for one incident wave.

    Attributes:
        error: estimated largest efficiency error.
        unknowns: size of the systems.
        method: solver name.
    """

    reflected: OrderSet
    transmitted: OrderSet
    error: float
    unknowns: int
    method: str


class NotConvergedError(NacreError):
    """The orders do not reach the tolerance within the largest size."""


class WallsMeetError(NotConvergedError):
    """Sloping walls meet, so that elements cannot follow them."""


def check_unknowns(count: int, k0: float) -> None:
    """Refuse a system that is too large.

    Raises:
        NotConvergedError: naming the size.
    """
    if count > MAX_UNKNOWNS:
        raise NotConvergedError(
            f"orders at {2.0 * np.pi / k0:g} nm need {count} unknowns; allowed: at most {MAX_UNKNOWNS}, by a smaller "
            "period or a longer wavelength"
        )


def incident_wave(stack: PeriodicStack, theta_rad: float, phi_rad: float) -> tuple[Array, float, Array]:
    """Return the transverse wave vector over k0 `[2]`, k_z / k0, and (E_x, E_y) `[2, in]` of unit s and p waves."""
    theta = min(theta_rad, 0.5 * np.pi - LEAST_ELEVATION)
    sine, cosine = np.sin(theta), np.cos(theta)
    c, s = np.cos(phi_rad), np.sin(phi_rad)
    transverse = stack.cover * sine * np.array([c, s])
    transverse[np.abs(transverse) < NORMAL] = 0.0
    return transverse, float(stack.cover * cosine), np.array([[-s, -cosine * c], [c, -cosine * s]])


def propagating(stack: PeriodicStack, k0: float, transverse: Array, index: float) -> tuple[Array, Array]:
    """Return the numbers `[order, 2]` and the transverse wave vectors over k0 `[order, 2]` of orders in a medium."""
    cell = stack.cell
    spans = (cell.period_x, cell.period_y or 0.0)
    top = [int(np.ceil((index + np.hypot(*transverse)) * k0 / (2.0 * np.pi) * p)) for p in spans]
    grid = np.stack(np.meshgrid(*[np.arange(-t, t + 1) for t in top], indexing="ij"), axis=-1).reshape(-1, 2)
    waves = transverse + cell.wave_vectors(grid) / k0
    keep = index**2 - np.sum(waves**2, axis=1) > GRAZING
    return grid[keep], waves[keep]


def transverse_axes(waves: Array, azimuth: Array | float) -> tuple[Array, Array]:
    """Return x and y of the unit vectors along wave vectors `[order, 2]`; those of `azimuth` if they vanish."""
    length = np.hypot(waves[:, 0], waves[:, 1])
    is_normal = length < 1e-12
    x, y = (waves / np.where(is_normal, 1.0, length)[:, None]).T
    return np.where(is_normal, np.cos(azimuth), x), np.where(is_normal, np.sin(azimuth), y)


def order_set(
    numbers: Array,
    transverse: Array,
    tangential: Array,
    index: Array | float,
    is_up: bool,
    incident: tuple[Array | float, Array | float],
) -> OrderSet:
    """Return orders from their tangential fields.

    Args:
        tangential: `[order, 2, in]`, E_x and E_y.
        index: index of the medium, one for all orders or `[order]`.
        incident: azimuth of the transverse part of the incident wave, and its k_z / k0 (positive), or `[order]`.
    """
    azimuth, k_z_in = incident
    t_x, t_y = transverse_axes(transverse, azimuth)
    k_z = np.sqrt(np.maximum(index**2 - np.hypot(transverse[:, 0], transverse[:, 1]) ** 2, 0.0))
    e_x, e_y = tangential[:, 0], tangential[:, 1]
    s = -t_y[:, None] * e_x + t_x[:, None] * e_y
    p = (t_x[:, None] * e_x + t_y[:, None] * e_y) * (index / np.maximum(k_z, 1e-12))[:, None]
    if not is_up:
        p = -p
    jones = np.stack([s, p], axis=1)
    direction = np.column_stack([transverse, k_z if is_up else -k_z])
    return OrderSet(numbers, direction, jones, np.sum(np.abs(jones) ** 2, axis=1) * (k_z / k_z_in)[:, None])


def empty_orders() -> OrderSet:
    """Return no orders."""
    return OrderSet(np.zeros((0, 2), dtype=int), np.zeros((0, 3)), np.zeros((0, 2, 2), dtype=complex), np.zeros((0, 2)))


COARSE = 6  # slices of a layer at first


@dataclass(frozen=True)
class Wall:
    """The section of a shape's wall; the shape has its size at half the layer's height.

    Attributes:
        angle_deg: between the wall and the plane below, inside the shape: 90 for a vertical wall, less where the shape
            narrows upward.
        rounding_nm: radius of the upper edge.
    """

    angle_deg: float = 90.0
    rounding_nm: float = 0.0

    @property
    def is_vertical(self) -> bool:
        """Whether one slice describes it."""
        return self.angle_deg == 90.0 and self.rounding_nm == 0.0

    def insets(self, thickness_nm: float, depths: Array) -> Array:
        """Return how far the wall lies inside its place at half the height, in nm, at depths below the layer's top.

        The rounding is the quarter of a circle that meets the upper plane and the vertical; its inset adds to that of
        the slope.
        """
        sloped = (0.5 * thickness_nm - depths) / np.tan(np.radians(self.angle_deg)) if self.angle_deg != 90.0 else 0.0
        r = self.rounding_nm
        inside = np.clip(r - depths, 0.0, r)
        return np.asarray(sloped + r - np.sqrt(np.maximum(r**2 - inside**2, 0.0)))


def inset(shape: Shape, distance_nm: float) -> Shape | None:
    """Return a shape whose walls lie further inside, or None if nothing is left.

    A line ends where the cell ends and moves its two walls only.
    """
    if distance_nm == 0.0:
        return shape
    if isinstance(shape, Rectangle):
        x_0, x_1 = shape.x_0 + distance_nm, shape.x_1 - distance_nm
        y_0, y_1 = shape.y_0 + distance_nm, shape.y_1 - distance_nm
        return Rectangle(x_0, x_1, y_0, y_1) if x_1 > x_0 and y_1 > y_0 else None
    outer = shape.distance
    return Region(lambda x, y: outer(x, y) + distance_nm, (*shape.key, "inset", distance_nm))


def sliced(
    thickness_nm: float, epsilon: complex, shapes: Sequence[tuple[Shape, complex, Wall]], count: int
) -> tuple[PatternLayer, ...]:
    """Return a layer as slices, each with the walls at its middle; one slice if all walls are vertical."""
    if all(wall.is_vertical for _, _, wall in shapes) or thickness_nm == 0.0:
        return (PatternLayer(thickness_nm, epsilon, tuple((shape, e) for shape, e, _ in shapes)),)
    edges = _edges(thickness_nm, max(wall.rounding_nm for _, _, wall in shapes), count)
    depths = 0.5 * (edges[1:] + edges[:-1])
    insets = [wall.insets(thickness_nm, depths) for _, _, wall in shapes]
    layers = []
    for k, thickness in enumerate(np.diff(edges)):
        placed = [(inset(shape, float(away[k])), e) for (shape, e, _), away in zip(shapes, insets, strict=True)]
        layers.append(PatternLayer(float(thickness), epsilon, tuple((s, e) for s, e in placed if s is not None)))
    return tuple(layers)


def _edges(thickness_nm: float, rounding_nm: float, count: int) -> Array:
    """Return the depths between the slices, closer at a rounded edge, where the wall turns."""
    even = np.linspace(0.0, 1.0, count + 1)
    if rounding_nm == 0.0:
        return thickness_nm * even
    upper = min(rounding_nm, thickness_nm)
    if upper == thickness_nm:
        return np.asarray(thickness_nm * (1.0 - np.cos(0.5 * np.pi * even)))
    half = max(count // 2, 1)
    above = upper * (1.0 - np.cos(0.5 * np.pi * np.linspace(0.0, 1.0, half + 1)))
    return np.concatenate([above, np.linspace(upper, thickness_nm, count - half + 1)[1:]])
