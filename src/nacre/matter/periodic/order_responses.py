"""Orders at every direction from a few solutions, with exact Rayleigh anomalies.

Where an order begins to propagate, efficiencies change as a square root, and surface waves make sharp lines nearby.
Both come from the waves outside. The response Z of the structure between media of constant admittance Y_0 has neither:
it maps sources of (H_y, -H_x) in some orders (channels) at both faces to the (E_x, E_y) of these orders there, and is a
smooth function of the transverse wave vector. With the admittances Y of the true media, e = (1 + Z (Y - Y_0))^-1 Z s,
exactly. Orders that nowhere come near propagation are not channels: Z contains their true media. A tensor product of
Chebyshev polynomials over one cell of the reciprocal lattice thus gives every direction of light.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from nacre.matter.periodic.crossed_solver import fourier_response, rectangle_response
from nacre.matter.periodic.element_solver import oval_response
from nacre.matter.periodic.lamellar_solver import lamellar_responses
from nacre.matter.periodic.line_elements import element_response
from nacre.matter.periodic.line_solver import line_response
from nacre.matter.periodic.scattering_matrix import outgoing_root
from nacre.matter.periodic.solve import RUNS, coarse_method, line_step
from nacre.matter.periodic.structure import GRAZING, PeriodicStack, transverse_axes
from nacre.matter.periodic.types import Array

NEAR = 1.2  # orders with a wave number up to this times the index are channels
FAINT_K = 0.3  # extinction of a substrate up to which anomalies of lines are visible
LEAST_NODES, EVEN_NODES, MOST_NODES = (6, 8), (8, 8), 40  # along both axes
EXPENSIVE = "rectangles", "fourier", "ovals", "profile", "elements"
TAIL = {True: 2e-3, False: 5e-4}  # largest of the last coefficients, if solutions are expensive and if not
CHUNK = 2e6  # numbers in the matrices of all directions

Counts = tuple[int, int]  # nodes along both axes


@dataclass(frozen=True, eq=False)
class Channels:
    """The orders of both faces over one cell of the reciprocal lattice, for one wavelength.

    Attributes:
        stack: the structure.
        k0: in 1/nm.
        lattice: `[2, 2]`, rows of the reciprocal lattice over k0; the second is 0 for lines.
        span: `[2, 2]`, rows that span the cell: transverse = u @ span, u from -1 to 1.
        upper, lower: `[order, 2]`, order numbers.
    """

    stack: PeriodicStack
    k0: float
    lattice: Array
    span: Array
    upper: Array
    lower: Array

    @property
    def size(self) -> int:
        """Number of channels, two for each order."""
        return 2 * (len(self.upper) + len(self.lower))

    def image(self, turn: Array) -> Array:
        """Return the map `[channel, channel]` of the channels under a rotation or reflection of the lattice.

        Args:
            turn: `[2, 2]`, orthogonal, applied from the right.
        """
        parts = []
        for numbers in (self.upper, self.lower):
            place = {(int(m), int(n)): k for k, (m, n) in enumerate(numbers)}
            other = np.rint(numbers @ self.lattice @ turn @ np.linalg.pinv(self.lattice)).astype(int)
            to = np.zeros((len(numbers), len(numbers)))
            to[[place[int(m), int(n)] for m, n in other], np.arange(len(numbers))] = 1.0
            parts.append(np.kron(turn.T, to))
        return np.asarray(scipy.linalg.block_diag(*parts))


Symmetry = tuple[Array, bool]  # symmetry of the response: `turn` of `Channels.image`, and whether it is also transposed


def channels_of(stack: PeriodicStack, wavelength_nm: float) -> Channels:
    """Return the channels of a structure."""
    k0, cell = 2.0 * np.pi / wavelength_nm, stack.cell
    lattice = cell.wave_vectors(np.eye(2)) / k0
    if cell.period_y is None:
        span = np.diag([min(0.5 * lattice[0, 0], stack.cover), stack.cover])
    else:
        limit = [min(0.5, stack.cover / np.hypot(*row)) if cell.is_rectangular else 0.5 for row in lattice]
        span = np.array(limit)[:, None] * lattice
    u = np.linspace(-1.0, 1.0, 17)
    inside = np.stack(np.meshgrid(u, u, indexing="ij"), axis=-1).reshape(-1, 2) @ span
    is_line = cell.period_y is None
    faint = stack.substrate.imag < FAINT_K if is_line else stack.is_clear

    def near(index: float) -> Array:
        top = [1 + int(np.ceil((index * NEAR + np.abs(inside).max()) / s)) if s else 0 for s in _heights(lattice)]
        grid = np.stack(np.meshgrid(*[np.arange(-t, t + 1) for t in top], indexing="ij"), axis=-1).reshape(-1, 2)
        waves = (grid @ lattice)[:, None] + inside
        return np.asarray(grid[np.sum(waves**2, axis=-1).min(axis=1) < (NEAR * index) ** 2])

    lower = near(stack.substrate.real) if faint else np.zeros((0, 2), dtype=int)
    return Channels(stack, k0, lattice, span, near(stack.cover), lower)


def _heights(lattice: Array) -> Array:
    """Return the distance between neighbouring order rows along both vectors; for lines the second is 0."""
    if not np.any(lattice[1]):
        return np.array([lattice[0, 0], 0.0])
    return np.asarray(abs(np.linalg.det(lattice)) / np.hypot(lattice[::-1, 0], lattice[::-1, 1]))


def responses(channels: Channels, transverse: Array, step: int = 0) -> Array:
    """Return Z `[case, channel, channel]` at wave vectors over k0 `[case, 2]`, none of them on an axis.

    Channels are E_x of the upper orders, then E_y, then both of the lower ones.

    Args:
        step: number of the size, as for `solve_coarse`.
    """
    stack, k0, upper, lower = channels.stack, channels.k0, channels.upper, channels.lower
    method = coarse_method(stack, 2.0 * np.pi / k0)
    if method == "lines":
        step = line_step(stack, step)
    if method == "lines" and step == 0:
        return lamellar_responses(stack, k0, transverse, upper[:, 0], lower[:, 0])
    runs: dict[str, Callable[..., Array]] = {
        "lines": line_response, "rectangles": rectangle_response, "fourier": fourier_response,
        "ovals": oval_response, "profile": element_response, "elements": element_response,
    }  # fmt: skip
    run = runs[method]
    size = RUNS[method][1][step - (method == "lines")]
    return np.array([run(stack, k0, each, size, upper, lower) for each in transverse])


def nodes(count: int) -> Array:
    """Return the zeros of the Chebyshev polynomial, descending."""
    return np.cos((np.arange(count) + 0.5) * (np.pi / count))


@dataclass(frozen=True, eq=False)
class Fit:
    """Chebyshev coefficients `[i, j, channel, channel]` of Z."""

    channels: Channels
    coefficients: Array

    @property
    def tails(self) -> tuple[float, float]:
        """Largest of the last two coefficients along each axis."""
        c = np.abs(self.coefficients)
        return float(c[-2:].max()), float(c[:, -2:].max())

    def orders(self, transverse: Array) -> list[tuple[NDArray[np.int64], Array]]:
        """Return the numbers `[order, 2]` and the efficiencies `[direction, order]` of both sides, upper first.

        Args:
            transverse: `[direction, 2]`, wave vectors over k0 of unpolarised light. Dark orders have 0.
        """
        step = max(1, int(CHUNK / self.channels.size**2))
        chunks = [self._part(transverse[k : k + step]) for k in range(0, len(transverse), step)]
        number = np.concatenate([chunk[0] for chunk in chunks])
        sides = []
        for side, numbers in enumerate((self.channels.upper, self.channels.lower), start=1):
            values = np.concatenate([chunk[side] for chunk in chunks])
            row, channel = np.nonzero(values)
            own = numbers[channel] - number[row]
            every, place = np.unique(own, axis=0, return_inverse=True)
            table = np.zeros((len(transverse), len(every)))
            table[row, place.reshape(-1)] = values[row, channel]
            sides.append((every.astype(np.int64), table))
        return sides

    def _part(self, transverse: Array) -> tuple[Array, Array, Array]:
        """Return the cell of each wave `[direction, 2]`, and efficiencies `[direction, order]` of the channels."""
        of, stack = self.channels, self.channels.stack
        number = _nearest(of.lattice, transverse)
        inside = transverse - number @ of.lattice
        u = np.clip(inside @ np.linalg.inv(of.span), -1.0, 1.0)
        i, j, size, _ = self.coefficients.shape
        basis = chebyshev.chebvander(u[:, 0], i - 1)[:, :, None] * chebyshev.chebvander(u[:, 1], j - 1)[:, None]
        flat = np.ascontiguousarray(self.coefficients).reshape(i * j, size**2).view(float)
        z = (basis.reshape(-1, i * j) @ flat).view(complex).reshape(-1, size, size)
        sides = [(of.upper, complex(stack.cover)), (of.lower, stack.substrate)]
        admittance = [_admittance(inside[:, None] + numbers @ of.lattice, index) for numbers, index in sides]
        system, first = np.broadcast_to(np.eye(size, dtype=complex), z.shape).copy(), 0
        for (numbers, index), (xx, xy, yy) in zip(sides, admittance, strict=True):
            count = len(numbers)
            x, y = (slice(first + k * count, first + (k + 1) * count) for k in (0, 1))
            system[:, :, x] += z[:, :, x] * (xx - index.real)[:, None] + z[:, :, y] * xy[:, None]
            system[:, :, y] += z[:, :, x] * xy[:, None] + z[:, :, y] * (yy - index.real)[:, None]
            first += 2 * count
        k_z, light = _light(transverse, stack.cover)
        place, count = _places(of.upper, number), len(of.upper)
        row = np.arange(len(z))
        xx, xy, yy = (part[row, place, None] for part in admittance[0])
        source = [xx * light[:, 0] + xy * light[:, 1], xy * light[:, 0] + yy * light[:, 1]]
        driven = sum(z[row, :, place + k * count][:, :, None] * (2.0 * source[k])[:, None] for k in (0, 1))
        e = np.linalg.solve(system, driven)
        for k in (0, 1):
            e[row, place + k * count] -= light[:, k]
        parts, first = [], 0
        for (numbers, _), (xx, xy, yy) in zip(sides, admittance, strict=True):
            count = len(numbers)
            e_x, e_y = e[:, first : first + count], e[:, first + count : first + 2 * count]
            first += 2 * count
            flux = np.abs(e_x) ** 2 * xx[..., None] + np.abs(e_y) ** 2 * yy[..., None]
            flux = flux + 2.0 * (e_x.conj() * e_y).real * xy[..., None]
            parts.append(flux.real.mean(axis=-1) / k_z[:, None])
        return number, np.where(_propagates(of, inside, 0), parts[0], 0.0), np.where(
            _propagates(of, inside, 1), parts[1], 0.0
        )  # fmt: skip


def _propagates(of: Channels, inside: Array, side: int) -> Array:
    numbers, index = ((of.upper, of.stack.cover), (of.lower, of.stack.substrate.real))[side]
    waves = inside[:, None] + numbers @ of.lattice
    is_used = side == 0 or of.stack.is_clear
    return np.asarray(is_used & (index**2 - np.sum(waves**2, axis=-1) > GRAZING))


def _nearest(lattice: Array, transverse: Array) -> Array:
    """Return the order whose cell contains a wave vector `[direction, 2]`."""
    inverse = np.array([[1.0 / lattice[0, 0], 0.0], [0.0, 0.0]]) if not np.any(lattice[1]) else np.linalg.inv(lattice)
    return np.asarray(np.rint(transverse @ inverse).astype(int))


def _places(numbers: Array, requested: Array) -> Array:
    """Return the row of each requested order; all must exist."""
    low = numbers.min(axis=0)
    table = np.zeros(numbers.max(axis=0) - low + 1, dtype=int)
    table[tuple((numbers - low).T)] = np.arange(len(numbers))
    return np.asarray(table[tuple((requested - low).T)])


def _light(transverse: Array, index: float) -> tuple[Array, Array]:
    """Return k_z / k0 and (E_x, E_y) `[direction, 2, in]` of downward unit s and p waves."""
    sine = np.hypot(transverse[:, 0], transverse[:, 1])
    c, s = transverse_axes(transverse, 0.0)
    k_z = np.sqrt(index**2 - sine**2)
    cosine = k_z / index
    return k_z, np.stack([np.stack([-s, -cosine * c], axis=-1), np.stack([c, -cosine * s], axis=-1)], axis=1)


def _admittance(waves: Array, index: complex) -> tuple[Array, Array, Array]:
    """Return f / e (xx, xy, yy) `[direction, order]` of outgoing waves `[direction, order, 2]`."""
    alpha, beta = waves[..., 0], waves[..., 1]
    squared = index**2 - alpha**2 - beta**2
    gamma = outgoing_root(squared)
    return (index**2 - beta**2) / gamma, alpha * beta / gamma, (index**2 - alpha**2) / gamma


def _node_images(channels: Channels, counts: Counts, turn: Array) -> NDArray[np.intp]:
    """Return the number (row by row) of the node to which a symmetry maps each node."""
    along = [nodes(count) for count in counts]
    u = np.stack(np.meshgrid(*along, indexing="ij"), axis=-1).reshape(-1, 2)
    other = u @ channels.span @ turn @ np.linalg.pinv(channels.span)
    at = [np.argmin(np.abs(own - part[:, None]), axis=1) for own, part in zip(along, other.T, strict=True)]
    return np.asarray(at[0] * counts[1] + at[1])


def solved_nodes(channels: Channels, counts: Counts, images: list[Symmetry]) -> Array:
    """Return the nodes `[node, 2]` (numbers along both axes) from which symmetries lead to all others."""
    first = np.arange(counts[0] * counts[1])
    for _ in images:
        for turn, _ in images:
            np.minimum.at(first, _node_images(channels, counts, turn), first.copy())
    own = np.flatnonzero(first == np.arange(len(first)))
    return np.stack(np.divmod(own, counts[1]), axis=1)


def fitted(channels: Channels, values: Array, counts: Counts, images: list[Symmetry]) -> Fit:
    """Return the fit to Z at the nodes of `solved_nodes`, `[node, channel, channel]`."""
    size = channels.size
    own = solved_nodes(channels, counts, images) @ np.array([counts[1], 1])
    full, is_known = np.empty((counts[0] * counts[1], size, size), dtype=complex), np.zeros(counts[0] * counts[1], bool)
    full[own], is_known[own] = values, True
    while not np.all(is_known):
        for turn, is_transposed in images:
            to, of = _node_images(channels, counts, turn), channels.image(turn)
            new = is_known & ~is_known[to]
            part = full[new].swapaxes(1, 2) if is_transposed else full[new]
            full[to[new]], is_known[to[new]] = of @ part @ of.T, True
    matrices = [np.linalg.inv(chebyshev.chebvander(nodes(n), n - 1)) for n in counts]
    coefficients = np.tensordot(matrices[0], full.reshape(*counts, size, size), axes=1)
    coefficients = np.moveaxis(np.tensordot(matrices[1], coefficients, axes=(1, 1)), 0, 1)
    return Fit(channels, coefficients)


def next_counts(fit: Fit, tail: float) -> Counts | None:
    """Return node counts, extrapolated from the decay, for last coefficients below `tail`; None if they are already."""
    larger = []
    sizes = np.abs(fit.coefficients).max(axis=(2, 3))
    for axis, last in enumerate(fit.tails):
        count = fit.coefficients.shape[axis]
        if last <= tail or count >= MOST_NODES:
            larger.append(count)
            continue
        rate = np.log(max(float(sizes.max()) / last, 1.5)) / (count - 2)
        more = 2 * int(np.ceil(0.5 * np.log(last / tail) / rate))
        larger.append(min(count + max(2, more), 2 * count - count % 2, MOST_NODES))
    return None if tuple(larger) == fit.coefficients.shape[:2] else (larger[0], larger[1])
