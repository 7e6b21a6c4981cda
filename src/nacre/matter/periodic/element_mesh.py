"""Elements with curved sides on a doubly periodic cell with closed walls about one centre.

A disc, an ellipse, or a ring: blocks with four sides follow the walls, a few more fill the innermost region, and the
outermost reach the sides of the cell (of a lattice without right angles, the hexagon of the points nearest to one
node). E_z takes continuous tensor products of polynomials, (E_x, E_y) edge elements, which contain their gradients
(Nedelec, Numer. Math. 35, 315 (1980); Demkowicz, Computing with hp-adaptive finite elements (2006)).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
import scipy.sparse
from numpy.polynomial import legendre
from numpy.typing import NDArray

from nacre.core.arrays import gauss_legendre
from nacre.matter.periodic.structure import Cell, reflection
from nacre.matter.periodic.types import Array

WIDE = 0.9  # walls nearer to the sides of an oblique cell, relative to its centre, need the hexagon
CORE = 0.55  # corners of the innermost blocks, over the first wall's distance
THIN = 2  # degree along the radial lines in thin blocks
SAME = 1e-9  # distance of corners that are equal, over the size of the cell
EXTRA_POINTS = 6  # additional quadrature points beyond the degree, for curved sides


# degree along the walls, degree along the radial lines, and ends of the thin blocks over a radial line from a wall
Elements = tuple[int, int, tuple[float, ...]]


@dataclass(frozen=True)
class Oval:
    """An ellipse: centre, half axes in nm, and the angle of the first."""

    x: float
    y: float
    a: float
    b: float
    turn_rad: float = 0.0

    def radius(self, angle: Array) -> Array:
        """Return the distance from the centre to the wall."""
        own = angle - self.turn_rad
        return np.asarray(self.a * self.b / np.hypot(self.b * np.cos(own), self.a * np.sin(own)))


def _parallelogram(cell: Cell) -> Array:
    first, second = cell.vectors
    return np.array([0.5 * (s * first + t * second) for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))])


def cell_corners(cell: Cell, walls: tuple[Oval, ...]) -> Array:
    """Return the corners `[corner, 2]` of the cell about a node, counterclockwise: a hexagon if walls need it."""
    corners, angles = _parallelogram(cell), np.linspace(-np.pi, np.pi, 181)
    if cell.is_rectangular or np.all(walls[-1].radius(angles) < WIDE * _distance(corners, angles)):
        return corners
    return _hexagon(*cell.vectors)


def _hexagon(first: Array, second: Array) -> Array:
    """Return the corners `[6, 2]` around the points nearest to one lattice node."""
    while True:
        second = second - np.rint(second @ first / (first @ first)) * first
        if second @ second >= (first @ first) * (1.0 - 1e-12):
            break
        first, second = second, first
    if first @ second > 0.0:
        second = -second
    around = np.array([first, first + second, second, -first, -first - second, -second])
    around = around[np.argsort(np.arctan2(around[:, 1], around[:, 0]))]
    return np.array(
        [
            np.linalg.solve(np.stack([p, q]), 0.5 * np.array([p @ p, q @ q]))
            for p, q in zip(around, np.roll(around, -1, axis=0), strict=True)
        ]
    )


def _distance(corners: Array, angles: Array) -> Array:
    """Return the distance from the centre to a polygon's sides along each angle."""
    sides = np.roll(corners, -1, axis=0) - corners
    normals = np.stack([sides[:, 1], -sides[:, 0]], axis=-1)
    along = np.stack([np.cos(angles), np.sin(angles)], axis=-1) @ normals.T
    depth = np.sum(normals * corners, axis=-1)
    return np.asarray(np.min(np.where(along > 1e-12, depth / np.where(along > 1e-12, along, 1.0), np.inf), axis=1))


def side_distance(cell: Cell, angles: Array) -> Array:
    """Return the distance from a mesh's centre to the outermost sides that it can have."""
    return _distance(_parallelogram(cell) if cell.is_rectangular else _hexagon(*cell.vectors), angles)


@dataclass(frozen=True, eq=False)
class Block:
    """A map of (-1, 1) x (-1, 1): radial lines between an inner and an outer side, or a quadrilateral.

    Attributes:
        ends: `[2, 2, 2]`, x and y on the inner and on the outer side, at eta = -1, 1.
        degrees: those along xi and along eta for continuous functions.
        walls: inner and outer oval; None: a straight side.
        angles: those between which the radial lines lie.
        span: begin and end along the radial lines, 0 at the inner side, 1 at the outer.
    """

    region: int
    ends: Array
    degrees: tuple[int, int]
    walls: tuple[Oval | None, Oval | None] = (None, None)
    angles: tuple[float, float] = (0.0, 0.0)
    span: tuple[float, float] = (0.0, 1.0)

    @property
    def corners(self) -> Array:
        """Return x and y `[2, 2, 2]` at xi = -1, 1 and eta = -1, 1."""
        part = np.array(self.span)[:, None, None]
        return np.asarray((1.0 - part) * self.ends[0] + part * self.ends[1])

    @property
    def lengths(self) -> tuple[float, float]:
        """Longest distance between corners along xi and along eta."""
        c = self.corners
        return float(np.hypot(*(c[0] - c[1]).T).max()), float(np.hypot(*(c[:, 0] - c[:, 1]).T).max())

    def at(self, xi: Array, eta: Array) -> Array:
        """Return x and y `[2, point]` from the centre."""
        sides = []
        part = self.span[0] + 0.5 * (xi + 1.0) * (self.span[1] - self.span[0])
        angle = self.angles[0] + 0.5 * (eta + 1.0) * (self.angles[1] - self.angles[0])
        for k, wall in enumerate(self.walls):
            start, end = self.ends[k]
            if wall is None:
                side = start[:, None] + (end - start)[:, None] * 0.5 * (eta + 1.0)
            else:
                side = wall.radius(angle) * np.array([np.cos(angle), np.sin(angle)])
            sides.append(side)
        return np.asarray((1.0 - part) * sides[0] + part * sides[1])


def _spans(steps: tuple[float, ...], first: bool, last: bool) -> list[tuple[float, float, bool]]:
    """Return radial intervals that are graded towards the walls at their ends, and whether each is thin."""
    edges = [0.0, *(steps[::-1] if first else ()), *(1.0 - step for step in steps if last), 1.0]
    middle = len(steps) if first else 0
    return [(a, b, k != middle) for k, (a, b) in enumerate(zip(edges, edges[1:], strict=False))]


def _blocks(cell: Cell, walls: tuple[Oval, ...], elements: Elements) -> list[Block]:
    degree, radial, steps = elements
    corners = cell_corners(cell, walls)
    angles = np.unwrap(np.arctan2(corners[:, 1], corners[:, 0]))
    angles = np.append(angles, angles[0] + 2.0 * np.pi)
    unit = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    rings = [CORE * walls[0].radius(angles)[:, None] * unit]
    rings += [wall.radius(angles)[:, None] * unit for wall in walls]
    rings.append(np.concatenate([corners, corners[:1]]))
    curves: list[Oval | None] = [None, *walls, None]
    made = []
    for k in range(len(rings) - 1):
        for start, end, is_thin in _spans(steps, k > 0, k < len(walls)):
            own = (THIN if is_thin else radial, degree)
            for j in range(len(corners)):
                at = np.array([[rings[k][j], rings[k][j + 1]], [rings[k + 1][j], rings[k + 1][j + 1]]])
                made.append(
                    Block(k, at, own, (curves[k], curves[k + 1]), (angles[j], angles[j + 1]), (start, end))
                )  # fmt: skip
    inner, both = rings[0], (degree, degree)
    if len(corners) == 4:
        made.append(Block(0, np.array([[inner[0], inner[3]], [inner[1], inner[2]]]), both))
    else:
        middle = np.zeros(2)
        made += [
            Block(0, np.array([[middle, inner[j + 2]], [inner[j], inner[j + 1]]]), both) for j in (0, 2, 4)
        ]  # fmt: skip
    return made


@lru_cache(maxsize=16)
def shape_functions(degree: int, count: int) -> tuple[Array, Array, Array]:
    """Return N `[degree + 1, point]`, their derivatives D `[degree, point]`, and the map from D to N' `[N, D]`.

    N_0 and N_1 are 1 at one end; the others vanish at both.
    """
    x, _ = gauss_legendre(count)
    values = legendre.legvander(x, degree).T
    norm = np.sqrt(np.arange(degree) + 0.5)
    n, d = np.empty((degree + 1, count)), norm[:, None] * values[:degree]
    d[0] = 0.5
    n[0], n[1] = 0.5 * (1.0 - x), 0.5 * (1.0 + x)
    for k in range(1, degree):
        n[k + 1] = norm[k] * (values[k + 1] - values[k - 1]) / (2 * k + 1)
    slope = np.zeros((degree + 1, degree))
    slope[0, 0], slope[1, 0] = -1.0, 1.0
    slope[np.arange(2, degree + 1), np.arange(1, degree)] = 1.0
    return n, d, slope


@dataclass(frozen=True, eq=False)
class ElementMesh:
    """Both spaces on one cell.

    Matrices of blocks are those of all local functions, block after block; `joints` join them. Lengths are in nm.

    Attributes:
        masses: mass matrices of the edge functions per region (their scale does not depend on the unit of length).
        heights: mass matrices of continuous functions, per region.
        rotation: curl times curl of the edge functions.
        gradient: from continuous to edge functions.
        edge, node: `[local]` numbers of the joined functions, signs, and offsets `[local, 2]` by lattice vectors.
        blocks: their maps.
        sizes: how many joined edge and continuous functions there are.
    """

    cell: Cell
    masses: tuple[scipy.sparse.csr_matrix, ...]
    heights: tuple[scipy.sparse.csr_matrix, ...]
    rotation: scipy.sparse.csr_matrix
    gradient: scipy.sparse.csr_matrix
    edge: tuple[NDArray[np.intp], Array, Array]
    node: tuple[NDArray[np.intp], Array, Array]
    blocks: tuple[Block, ...]
    sizes: tuple[int, int]

    def joints(self, wave: Array) -> tuple[scipy.sparse.csr_matrix, scipy.sparse.csr_matrix]:
        """Return the maps from the joined edge and continuous functions to local ones, at a wave vector in 1/nm."""
        joints = []
        for (number, sign, offset), size in zip((self.edge, self.node), self.sizes, strict=True):
            values = sign * np.exp(1j * (offset @ wave))
            shape = (len(number), size)
            joints.append(scipy.sparse.csr_matrix((values, (np.arange(len(number)), number)), shape=shape))
        return joints[0], joints[1]

    def mirror(self, axis_rad: float, wave: Array) -> tuple[scipy.sparse.csr_matrix, scipy.sparse.csr_matrix] | None:
        """Return the reflection of the joined edge and continuous functions; None: the mesh is not symmetric.

        Args:
            axis_rad: angle of the line through the centre on which points stay.
            wave: the wave vector in 1/nm, along that line.
        """
        local = _mirrored(self.blocks, axis_rad)
        if local is None:
            return None
        reflections = []
        for matrix, joint in zip(local, self.joints(wave), strict=True):
            # one of the local functions that belong to each joined one
            number, at = np.unique(joint.indices, return_index=True)
            pick = scipy.sparse.csr_matrix((joint.data[at].conj(), (number, at)), shape=joint.shape[::-1])
            reflections.append(pick @ matrix @ joint)
        return reflections[0], reflections[1]

    def plane_waves(self, wave: Array, numbers: Array) -> Array:
        """Return the overlap integrals between local edge functions (x and y) and plane waves, `[2, local, order]`.

        Args:
            wave: wave vector of order (0, 0) in 1/nm.
            numbers: `[order, 2]`.
        """
        vectors = self.cell.wave_vectors(numbers) + wave
        overlaps = []
        for at, weighted in _weighted(self.blocks, round(float(np.hypot(*vectors.T).max()) * 1e6)):
            values = np.exp(1j * (at.T @ vectors.T)).view(float)  # real products take half the time
            overlaps.append(np.ascontiguousarray(weighted @ values).view(complex))
        return np.concatenate(overlaps, axis=1)


def _flip(degree: int, sign: int, is_slope: bool) -> Array:
    """Return the coefficients after x -> sign x, of N from `shape_functions`, or of D dx."""
    if is_slope:
        return np.asarray(np.diag(float(sign) ** (np.arange(degree) + 1)))
    flips = np.diag(float(sign) ** np.arange(degree + 1))
    if sign < 0:
        flips[:2, :2] = [[0.0, 1.0], [1.0, 0.0]]
    return flips


def _turned(degrees: tuple[int, int], signs: tuple[int, int], swaps: bool) -> tuple[Array, Array]:
    """Return the coefficients of a block's edge and continuous functions after xi, eta -> signs (xi, eta).

    Args:
        swaps: exchange xi and eta then.
    """
    n, m = (_flip(degree, sign, False) for degree, sign in zip(degrees, signs, strict=True))
    d, e = (_flip(degree, sign, True) for degree, sign in zip(degrees, signs, strict=True))

    def both(along: Array, across: Array) -> Array:
        to = "ca" if swaps else "ac"
        made = np.einsum(f"ab,cd->{to}bd", along, across)
        return made.reshape(len(along) * len(across), -1)

    first, second = both(d, m), both(n, e)
    a, b = np.zeros((len(first), second.shape[1])), np.zeros((len(second), first.shape[1]))
    rows = [[b, second], [first, a]] if swaps else [[first, a], [b, second]]
    return np.block(rows), both(n, m)


@lru_cache(maxsize=16)
def _mirrored(
    blocks: tuple[Block, ...], axis_rad: float
) -> tuple[scipy.sparse.csr_matrix, scipy.sparse.csr_matrix] | None:
    """Return the reflection matrices for local edge and continuous functions; None: the blocks are not symmetric."""
    turn = reflection(axis_rad)
    every = np.array([block.corners for block in blocks])
    size = np.abs(every).max()
    parts: list[list[list[Array | None]]] = [[[None] * len(blocks) for _ in blocks] for _ in range(2)]
    for k, block in enumerate(blocks):
        image = every[k] @ turn
        for j, swaps, x, y in product(range(len(blocks)), (False, True), (1, -1), (1, -1)):
            moved = image[::x, ::y]
            moved = moved.swapaxes(0, 1) if swaps else moved
            if block.region == blocks[j].region and np.abs(moved - every[j]).max() < SAME * size:
                break
        else:
            return None
        if block.degrees != blocks[j].degrees:
            return None
        for kind, made in enumerate(_turned(block.degrees, (x, y), swaps)):
            parts[kind][j][k] = made
    edge, node = (scipy.sparse.csr_matrix(scipy.sparse.bmat(kind)) for kind in parts)
    return edge, node


@lru_cache(maxsize=2)
def _weighted(blocks: tuple[Block, ...], most: int) -> tuple[tuple[Array, Array], ...]:
    """Return the points of each block, and x and y of its edge functions times weights `[2, function, point]`.

    Args:
        most: largest wave number, in 1e-6 / nm.
    """
    weighted = []
    for block in blocks:
        counts = tuple(
            degree // 2 + 8 + int(0.5e-6 * most * length)
            for degree, length in zip(block.degrees, block.lengths, strict=True)
        )
        both, _, (xi, eta), weight = _square(block.degrees, (counts[0], counts[1]))
        at, a, b = _mapped(block, xi, eta)
        weighted.append((at, _fields(both, a, b) * weight))
    return tuple(weighted)


@lru_cache(maxsize=16)
def _square(
    degrees: tuple[int, int], counts: tuple[int, int]
) -> tuple[tuple[Array, Array], tuple[Array, Array, Array], tuple[Array, Array], Array]:
    """Return the edge functions along xi and eta; continuous ones, curls and gradients; points; weights."""
    (n, d, slope), (m, e, tilt) = (shape_functions(*each) for each in zip(degrees, counts, strict=True))
    (x, w), (y, v) = (gauss_legendre(count) for count in counts)
    xi, eta = (axis.ravel() for axis in np.meshgrid(x, y, indexing="ij"))
    turned = np.concatenate([-_product(d, tilt @ e), _product(slope @ d, e)])
    step = np.concatenate([np.kron(slope, np.eye(len(m))).T, np.kron(np.eye(len(n)), tilt).T])
    return (_product(d, m), _product(n, e)), (_product(n, m), turned, step), (xi, eta), np.outer(w, v).ravel()


def _product(first: Array, second: Array) -> Array:
    return np.einsum("ip,jq->ijpq", first, second).reshape(len(first) * len(second), -1)


def _fields(both: tuple[Array, Array], a: Array, b: Array) -> Array:
    """Return x and y of the edge functions times the area `[2, function, point]`.

    Args:
        both: functions along xi and along eta, on the square.
        a, b: derivatives of x and y along xi and eta.
    """
    along, across = both
    return np.stack([np.concatenate([b[1] * along, -a[1] * across]), np.concatenate([-b[0] * along, a[0] * across])])


def edge_count(cell: Cell, walls: tuple[Oval, ...], elements: Elements) -> int:
    """Return the joined edge function count."""
    return sum(2 * block.degrees[0] * block.degrees[1] for block in _blocks(cell, walls, elements))


@lru_cache(maxsize=6)
def element_mesh(cell: Cell, walls: tuple[Oval, ...], elements: Elements) -> ElementMesh:
    """Return the elements for nested ovals about one centre, from the innermost.

    Args:
        elements: see `Elements`.
    """
    blocks = _blocks(cell, walls, elements)
    masses: list[list[Array]] = [[] for _ in range(len(walls) + 1)]
    heights: list[list[Array]] = [[] for _ in range(len(walls) + 1)]
    rotation, steps = [], []
    for block in blocks:
        counts = block.degrees[0] + EXTRA_POINTS, block.degrees[1] + EXTRA_POINTS
        both, (nodal, turned, step), (xi, eta), weight = _square(block.degrees, counts)
        _, a, b = _mapped(block, xi, eta)
        area = a[0] * b[1] - b[0] * a[1]
        fields = _fields(both, a, b)
        mass = np.einsum("cip,cjp->ij", fields * (weight / area), fields, optimize=True)
        height = (nodal * (weight * area)) @ nodal.T
        for k in range(len(masses)):
            masses[k].append(mass if k == block.region else np.zeros_like(mass))
            heights[k].append(height if k == block.region else np.zeros_like(height))
        rotation.append((turned * (weight / area)) @ turned.T)
        steps.append(step)
    node, edge = _numbered(cell, blocks)

    def diagonal(parts: list[Array]) -> scipy.sparse.csr_matrix:
        made = scipy.sparse.csr_matrix(scipy.sparse.block_diag(parts))
        made.eliminate_zeros()
        return made

    return ElementMesh(
        cell, tuple(diagonal(m) for m in masses), tuple(diagonal(h) for h in heights),
        diagonal(rotation), diagonal(steps), edge, node, tuple(blocks),
        (int(edge[0].max()) + 1, int(node[0].max()) + 1),
    )  # fmt: skip


def _mapped(block: Block, xi: Array, eta: Array) -> tuple[Array, Array, Array]:
    """Return x and y at the points and their derivatives along xi and eta, each `[2, point]`."""
    at = block.at(xi, eta)
    one = np.ones_like(xi)
    along = 0.5 * (block.at(one, eta) - block.at(-one, eta))
    step = 1e-5  # central differences with four terms: exact to 1e-12
    across = (
        8.0 * (block.at(xi, eta + step) - block.at(xi, eta - step))
        - (block.at(xi, eta + 2.0 * step) - block.at(xi, eta - 2.0 * step))
    ) / (12.0 * step)
    return at, along, across


Numbered = tuple[NDArray[np.intp], Array, Array]
Place = tuple[int, bool, Array]  # number of a corner or side, whether its direction is opposite, and its offset


class _Numbers:
    """Numbers of the corners and sides of a periodic mesh, and of the functions on them.

    Attributes:
        starts: the first function at each corner, side or block.
        total: function count.
    """

    def __init__(self, cell: Cell) -> None:
        self.lattice = cell.vectors
        self.inverse = np.linalg.inv(self.lattice)
        self.seen: list[tuple[Array, Array]] = []
        self.starts: dict[object, int] = {}
        self.total = 0

    def place(self, middle: Array, direction: Array) -> Place:
        """Return the place of a side, or of a corner, which has direction 0."""
        for k, (other, way) in enumerate(self.seen):
            cells = (middle - other) @ self.inverse
            if np.abs(cells - np.rint(cells)).max() < 1e-6 and way.any() == direction.any():
                return k, bool(way @ direction < 0.0), np.rint(cells) @ self.lattice
        self.seen.append((middle, direction))
        return len(self.seen) - 1, False, np.zeros(2)

    def first(self, key: object, own: int) -> int:
        """Return the first function of a corner, side or block that has `own` functions."""
        if key not in self.starts:
            self.starts[key] = self.total
            self.total += own
        return self.starts[key]


def _numbered(cell: Cell, blocks: list[Block]) -> tuple[Numbered, Numbered]:
    """Return the joined numbers, signs and offsets of the local continuous and edge functions."""
    nodes, edges = _Numbers(cell), _Numbers(cell)
    parts: tuple[list[list[float]], list[list[float]]] = ([], [])
    for number, block in enumerate(blocks):
        c = block.corners
        corners = {(i, j): nodes.place(c[i, j], np.zeros(2)) for i in (0, 1) for j in (0, 1)}
        sides = {}
        for k in (0, 1):
            for axis, (start, end) in enumerate(((c[0, k], c[1, k]), (c[k, 0], c[k, 1]))):
                sides[axis, k] = nodes.place(0.5 * (start + end), end - start)
        parts[0].extend(_node_rows(nodes, number, block.degrees, corners, sides))
        parts[1].extend(_edge_rows(edges, number, block.degrees, sides))
    node, edge = (
        (rows[:, 0].astype(np.intp), rows[:, 1], rows[:, 2:]) for rows in map(np.array, parts)
    )  # fmt: skip
    return node, edge


def _node_rows(
    nodes: _Numbers, number: int, degrees: tuple[int, int], corners: dict[tuple[int, int], Place],
    sides: dict[tuple[int, int], Place],
) -> list[list[float]]:  # fmt: skip
    """Return number, sign and offset of each continuous function of a block."""
    rows = []
    for i, j in np.ndindex(degrees[0] + 1, degrees[1] + 1):
        sign = 1.0
        if i < 2 and j < 2:
            who, _, offset = corners[i, j]
            at = nodes.first(who, 1)
        elif i < 2 or j < 2:
            axis, k, order = (0, j, i) if j < 2 else (1, i, j)
            who, is_opposite, offset = sides[axis, k]
            at = nodes.first(who, degrees[axis] - 1) + order - 2
            sign = (-1.0) ** order if is_opposite else 1.0
        else:
            offset = np.zeros(2)
            at = (
                nodes.first(("block", number), (degrees[0] - 1) * (degrees[1] - 1)) + (i - 2) * (degrees[1] - 1) + j - 2
            )
        rows.append([at, sign, *offset])
    return rows


def _edge_rows(
    edges: _Numbers, number: int, degrees: tuple[int, int], sides: dict[tuple[int, int], Place]
) -> list[list[float]]:  # fmt: skip
    """Return number, sign and offset of each edge function of a block: those along xi, then those along eta."""
    rows = []
    for axis in (0, 1):
        shape = [degrees[0] + 1, degrees[1] + 1]
        shape[axis] -= 1
        for index in np.ndindex(*shape):
            order, k, across = index[axis], index[1 - axis], degrees[1 - axis] - 1
            if k < 2:
                who, is_opposite, offset = sides[axis, k]
                rows.append(
                    [edges.first(who, degrees[axis]) + order, (-1.0) ** (order + 1) if is_opposite else 1.0, *offset]
                )
            else:
                start = edges.first(("block", axis, number), degrees[axis] * across)
                rows.append([start + order * across + k - 2, 1.0, 0.0, 0.0])
    return rows
