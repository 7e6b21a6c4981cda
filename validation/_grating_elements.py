"""Gratings by finite elements: the second solver of smooth profiles, which shares no step with those of `_gratings.py`
but the names of orders and the powers of their waves.

The plane of incidence lies across the grooves: H_y in p, E_y in s. Biquadratic elements on a grid that follows the
surface; periodicity by eliminating one side; above, a perfectly matched layer, and below a clear body, too; in a metal
the field is zero where it has decayed. What is solved for is the difference to a flat body whose face lies below the
grooves, so that its source lies in the ridges. `scikit-fem`, in `.venv-validate`, assembles.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sparse
import scipy.sparse.linalg
from numpy.typing import NDArray
from skfem import Basis, BilinearForm, ElementQuad2, LinearForm, MeshQuad, MeshQuad2

from validation._gratings import efficiencies, kept_orders

Array = NDArray[Any]
CELLS_A_WAVE = 12  # along x and z above the body
LEAST_COLUMNS = 40
CLEAR_UM, LAYER_UM, ABSORPTION = 0.45, 1.3, 3.0
SKINS, FINEST_SKINS, GROWTH = 11.0, 0.2, 1.3  # how deep the body reaches and how it is cut, in decay lengths
COARSEST_UM = 0.05


def elements(
    period: float, depth: float, n: complex, wavelength: float, angle_deg: float, is_p: bool, finer: float = 1.0
) -> tuple[Array, Array]:
    """Return the reflected orders that propagate and their efficiencies, of the sinusoid of `_relief_cases.profile`.

    Args:
        finer: divides the size of all cells.
    """
    k0 = 2 * np.pi / wavelength
    sine = float(np.sin(np.radians(angle_deg)))
    k_in, q_in = k0 * sine, k0 * float(np.cos(np.radians(angle_deg)))
    epsilon = complex(n) ** 2
    inner = k0 * complex(np.sqrt(epsilon - sine**2))
    is_clear = inner.imag < 1e-3 * k0
    cell = wavelength / CELLS_A_WAVE / finer
    columns = int(np.ceil(max(period / cell, LEAST_COLUMNS * finer)))
    line, top = 0.5 * depth + CLEAR_UM, 0.5 * depth + CLEAR_UM + LAYER_UM
    below, floor = _clear_levels(depth, cell / abs(n)) if is_clear else _metal_levels(1 / inner.imag, finer)
    upper = np.linspace(0, line, int(np.ceil(line / cell)) + 3)
    layer = np.linspace(line, top, int(np.ceil(LAYER_UM / cell)) + 1)
    levels = np.concatenate([below[:-1], upper, layer[1:]])
    # the flat body has its face at the floor: waves above it, as H_y or E_y
    above_part, inner_part = q_in, inner / epsilon if is_p else inner
    mirror = (above_part - inner_part) / (above_part + inner_part) * np.exp(-2j * q_in * floor) if is_clear else 0.0

    flat = MeshQuad.init_tensor(np.arange(columns + 1) / columns * period, levels)

    def raised(x: Array, t: Array) -> Array:
        """The surface t = 0 at the profile's height; flat from the line on, and from a clear body's floor."""
        fade = np.where(t >= 0, 1 - np.minimum(t / line, 1.0), 1 - np.minimum(t / floor, 1.0) if is_clear else 1.0)
        return np.asarray(t + 0.5 * depth * np.cos(2 * np.pi * x / period) * fade)

    flat_t = flat.p[1]
    middle = flat_t[flat.t].mean(axis=0)
    inside = np.flatnonzero(middle < 0)
    ridges = np.flatnonzero((middle < 0) & (middle > floor))
    curved = MeshQuad2.from_mesh(flat)
    points = curved.doflocs.copy()
    points[1] = raised(*points)
    mesh = MeshQuad2(points, curved.t)
    basis = Basis(mesh, ElementQuad2(), intorder=6)
    body = Basis(mesh, ElementQuad2(), elements=ridges, intorder=6)
    is_body = np.zeros(mesh.nelements)
    is_body[inside] = 1.0
    mark = np.repeat(is_body[:, None], basis.X.shape[1], axis=1)

    @BilinearForm(dtype=complex)
    def system(u: Any, v: Any, w: Any) -> Any:
        deep = np.maximum(w.x[1] - line, 0.0) / LAYER_UM
        if is_clear:
            deep = deep + np.maximum(floor - w.x[1], 0.0) / LAYER_UM
        stretch = 1 + 1j * ABSORPTION * 3.0 * deep**2
        here = np.where(w.mark > 0.5, epsilon, 1.0)
        stiff, mass = (1 / here, np.ones_like(here)) if is_p else (np.ones_like(here), here)
        return (
            stiff * (stretch * u.grad[0] * v.grad[0] + u.grad[1] * v.grad[1] / stretch) - k0**2 * mass * stretch * u * v
        )

    @LinearForm(dtype=complex)
    def source(v: Any, w: Any) -> Any:
        along = np.exp(1j * k_in * w.x[0])
        down, up = along * np.exp(-1j * q_in * w.x[1]), mirror * along * np.exp(1j * q_in * w.x[1])
        if is_p:
            slopes = 1j * (k_in * (down + up) * v.grad[0] - q_in * (down - up) * v.grad[1])
            return -(1 / epsilon - 1) * slopes
        return k0**2 * (epsilon - 1) * (down + up) * v

    matrix = system.assemble(basis, mark=mark).tocsr()
    right = source.assemble(body)
    x, z = basis.doflocs
    # the right side is the left one a phase on; ends are known
    left_dofs, right_dofs = (np.flatnonzero(np.abs(x - edge) < 1e-9) for edge in (0.0, period))
    left_dofs, right_dofs = left_dofs[np.argsort(z[left_dofs])], right_dofs[np.argsort(z[right_dofs])]
    phase = np.exp(1j * k_in * period)
    keep = np.setdiff1d(np.arange(basis.N), right_dofs)
    place = np.full(basis.N, -1)
    place[keep] = np.arange(keep.size)
    rows = np.concatenate([keep, right_dofs])
    columns_of = np.concatenate([place[keep], place[left_dofs]])
    values = np.concatenate([np.ones(keep.size), np.full(right_dofs.size, phase)])
    spread = sparse.csr_matrix((values, (rows, columns_of)), shape=(basis.N, keep.size))
    ends = np.zeros(basis.N, dtype=bool)
    ends[_level_dofs(mesh, basis, flat_t, levels[0])] = True
    ends[_level_dofs(mesh, basis, flat_t, levels[-1])] = True
    known = np.zeros(basis.N, dtype=complex)
    if not is_clear:
        last = _level_dofs(mesh, basis, flat_t, levels[0])
        known[last] = -np.exp(1j * (k_in * x[last] - q_in * z[last]))
    small = (spread.conj().T @ matrix @ spread).tocsc()
    load = spread.conj().T @ (right - matrix @ known)
    free = ~ends[keep]
    field = np.zeros(keep.size, dtype=complex)
    field[free] = scipy.sparse.linalg.splu(small[free][:, free]).solve(load[free])
    field = spread @ field + known
    on_line = np.flatnonzero(np.abs(z - line) < 1e-9)
    on_line = on_line[np.argsort(x[on_line])][:-1]
    series = np.fft.fft(field[on_line] * np.exp(-1j * k_in * x[on_line])) / on_line.size
    series[0] += mirror * np.exp(1j * q_in * line)
    numbers = kept_orders(period, wavelength, angle_deg, 0)
    return efficiencies(numbers, sine + numbers * wavelength / period, series[numbers])


def _level_dofs(mesh: Any, basis: Any, flat_t: Array, level: float) -> Array:
    """Nodes of a level of the grid: those of its corners and edges."""
    corners = np.flatnonzero(np.abs(flat_t - level) < 1e-9)
    edges = np.flatnonzero(np.isin(mesh.facets, corners).all(axis=0))
    return np.unique(np.concatenate([basis.nodal_dofs[:, corners].ravel(), basis.facet_dofs[:, edges].ravel()]))


def _metal_levels(skin: float, finer: float) -> tuple[Array, float]:
    """Levels of the grid from the bottom to the surface, 0, finest there, and the bottom."""
    step, below = FINEST_SKINS * skin / finer, [0.0]
    while -below[-1] < SKINS * skin:
        below.append(below[-1] - step)
        step = min(step * GROWTH, COARSEST_UM)
    return np.array(below[::-1]), below[-1]


def _clear_levels(depth: float, cell: float) -> tuple[Array, float]:
    """The same of a clear body, absorbing from the floor down, and the floor."""
    floor = -0.5 * depth - CLEAR_UM
    layer = np.linspace(floor - LAYER_UM, floor, int(np.ceil(LAYER_UM / cell)) + 1)
    return np.concatenate([layer[:-1], np.linspace(floor, 0.0, int(np.ceil(-floor / cell)) + 3)]), floor
