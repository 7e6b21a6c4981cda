"""Discs, rods and spheroids: meshes of their outlines, and their T-matrices by wavelength with a stated error."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from nacre.arrays import Array, ComplexArray
from nacre.errors import UnsupportedError
from nacre.families.metasurface.axial import AxialTMatrices, Body, gain, reciprocal, truncated
from nacre.families.metasurface.boundary import Mesh, block_t_matrix
from nacre.families.metasurface.sphere import AZIMUTHAL_ORDERS
from nacre.matter.indices.constant import OpticalConstant
from nacre.matter.jobs import in_threads, one_thread_each
from nacre.recipe.identity import identity
from nacre.recipe.kept import keep_arrays, kept_arrays

LEAST_ORDER, HIGHEST_ORDER = 20, 28  # close to a stack discs settle with l and its cut: at 10 to 1 %, at 20 to .2 %
EXPORTED_ORDER = 10  # of a file: 48 wavelengths of all orders would have 600 MB
SHORTEST_NM = 360.0
GRADING = 0.15  # of panels towards an edge: after n levels GRADING^(2 n nu) is left, nu the exponent of the field there
LADDER, CONTENT = (3, 7, 14), 1e-3  # levels, and what is good enough: nu is .5 to .8, but near 0 for silver at 360 nm
LONGEST = 4.0  # of a panel, over the index: degree 6 resolves two thirds of a wavelength to 1e-7
LONGEST_OVER_WIDTH = 3.0  # of a panel over the least extent: the far side's field varies as fast
MOST_PANELS = 40
REFUSED = 1e-2  # of the estimated error, relative
CHECKED_ORDER = 3
COARSE = {"degree": 4, "outer": 10, "far": 8, "on_itself": 10}


def cylinder_panels(radius: float, height: float, index: complex, levels: int = LADDER[0]) -> Array:
    """Return panels of the upper half of an upright cylinder, from the axis along the top and down to the middle.

    Graded towards the edge. Lengths times the ambient k; `index` over the ambient's.
    """
    longest = min(LONGEST / max(1.0, abs(index)), LONGEST_OVER_WIDTH * min(2 * radius, height))
    rows = []
    for r0, z0, length in ((0.0, height / 2, radius), (radius, 0.0, height / 2)):
        first = min(radius, height / 2, length)
        from_edge = [0.0, *(first * GRADING**n for n in range(levels, 0, -1)), length]
        marks = [0.0]
        for low, high in zip(from_edge, from_edge[1:]):
            pieces = max(1, int(np.ceil((high - low) / longest)))
            marks += [low + (high - low) * n / pieces for n in range(1, pieces + 1)]
        ends = length - np.array(marks[::-1])  # from the axis, or from the middle, to the edge
        if r0 == 0.0:
            rows += [(0.0, a, z0, b, z0) for a, b in zip(ends, ends[1:])]
        else:
            down = ends[::-1]
            rows += [(0.0, r0, a, r0, b) for a, b in zip(down, down[1:])]
    return np.array(rows)


def spheroid_panels(radius: float, height: float, index: complex, coarser: int = 0) -> Array:
    """Return panels of the upper half of a spheroid, from the pole to the equator; see `cylinder_panels`."""
    a, c = radius, height / 2
    longest = min(LONGEST / max(1.0, abs(index)), LONGEST_OVER_WIDTH * min(2 * a, 2 * c))
    tips = int(np.ceil(np.log2(max(a / c, c / a, 1.0))))
    count = max(2, int(np.ceil(max(a, c) * np.pi / 2 / longest))) + tips - coarser
    edges = np.linspace(0.0, np.pi / 2, max(count, 1) + 1)
    return np.array([(1.0, a, c, low, high) for low, high in zip(edges, edges[1:])])


@dataclass(frozen=True)
class SolvedBody(Body):
    """A homogeneous cylinder or spheroid, its axis along the normal, whose T-matrix is computed. See `Body`.

    Attributes:
        core: its material.
        ambient: the medium around.
    """

    method: ClassVar[str] = "PMCHWT, Galerkin, body of revolution"

    shape: str
    radius_nm: float
    height_nm: float
    core: OpticalConstant
    ambient: OpticalConstant
    source: str
    errors: dict[float, float] = field(default_factory=dict, compare=False)

    @property
    def name(self) -> str:  # type: ignore[override]  # read only, as all of a frozen dataclass
        """What it is, in words."""
        return f"{self.shape} of {self.core.name}, {2 * self.radius_nm:g} x {self.height_nm:g} nm"

    @property
    def circumscribing_nm(self) -> float:  # type: ignore[override]
        """Largest distance from the centre."""
        half = self.height_nm / 2
        return float(np.hypot(self.radius_nm, half)) if self.shape == "cylinder" else max(self.radius_nm, half)

    def of_radius(self, radius_nm: float) -> SolvedBody:
        """Return the same particle with another width, its height as it is; estimated errors are gathered in both."""
        return replace(self, radius_nm=radius_nm)

    @cached_property
    def lmax(self) -> int:  # type: ignore[override]
        """Highest multipole order: as Mie series need it, and at least what a near stack asks for.

        Raises:
            UnsupportedError: the particle is too large.
        """
        lam = max(SHORTEST_NM, self.ambient.range_nm[0])
        x = 2 * np.pi * float(self.ambient.n_complex(np.array([lam]))[0].real) * self.circumscribing_nm / lam
        order = max(LEAST_ORDER, int(np.ceil(x + 4.05 * np.cbrt(x) + 2)))
        if order > HIGHEST_ORDER:
            raise UnsupportedError(
                f"{self.source}: a particle of {2 * self.circumscribing_nm:.4g} nm from end to end needs multipoles "
                f"up to l = {order}; at most {HIGHEST_ORDER} are computed"
            )
        return order

    @property
    def stated_error(self) -> float | None:
        """The largest difference between two meshes, over the wavelengths that were asked for, relative to T."""
        return max(self.errors.values(), default=None)

    @cached_property
    def _solved(self) -> dict[tuple[float, int], ComplexArray]:
        return {}

    def t_matrix(self, wavelength_nm: float) -> ComplexArray:
        """Return T, `[m, n, n']`, with m up to 4.

        Raises:
            MaterialRangeError: an index is not known.
            UnsupportedError: it does not converge.
        """
        return self.azimuthal(float(wavelength_nm), AZIMUTHAL_ORDERS)

    def azimuthal(self, wavelength_nm: float, mmax: int) -> ComplexArray:
        """Return T as `t_matrix` does, with m up to `mmax`."""
        key = (wavelength_nm, mmax)
        if key not in self._solved:
            self._solved[key] = self._kept(wavelength_nm, mmax)
        return self._solved[key]

    def _numbers(self, wavelength_nm: float) -> tuple[float, float, complex]:
        """Radius and height times k, and the index over the ambient's."""
        lam = np.array([wavelength_nm])
        around = float(self.ambient.n_complex(lam)[0].real)
        k = 2 * np.pi * around / wavelength_nm
        return k * self.radius_nm, k * self.height_nm, complex(self.core.n_complex(lam)[0]) / around

    def _kept(self, wavelength_nm: float, mmax: int) -> ComplexArray:
        radius, height, index = self._numbers(wavelength_nm)
        numbers = [float(v).hex() for v in (radius, height, index.real, index.imag)]
        key = "tmatrix-" + identity({"shape": self.shape, "numbers": numbers}, {}, lmax=self.lmax, mmax=mmax)
        stored = kept_arrays(key)
        if stored and {"real", "imaginary", "error"} <= stored.keys():
            found, error = stored["real"] + 1j * stored["imaginary"], float(stored["error"])
        else:
            with one_thread_each():  # the matrices are small, and whoever asks has threads of its own
                found, error = self._solve(radius, height, index, mmax)
            keep_arrays(key, {"real": found.real, "imaginary": found.imag, "error": np.array(error)})
        self.errors[wavelength_nm] = max(error, self.errors.get(wavelength_nm, 0.0))
        if error > REFUSED:
            raise UnsupportedError(
                f"{self.source}: the T-matrix does not converge at {wavelength_nm:g} nm: two meshes differ by "
                f"{error:.2g}, {REFUSED:g} is allowed (at a sharp edge a metal of permittivity near -1 has no finite "
                'field); a "spheroid" of the same size has no edge'
            )
        return found

    def _solve(self, radius: float, height: float, index: complex, mmax: int) -> tuple[ComplexArray, float]:
        """Return T and its estimated error."""
        if self.shape != "cylinder":
            fine, coarse = (spheroid_panels(radius, height, index, n) for n in (0, 1))
            return self._compared(fine, Mesh(coarse, **COARSE), index, mmax)
        before = Mesh(cylinder_panels(radius, height, index, LADDER[0] - 1), **COARSE)
        for levels in LADDER:
            panels = cylinder_panels(radius, height, index, levels)
            found, error = self._compared(panels, before, index, mmax)
            if error <= CONTENT:
                break
            before = Mesh(panels)
        return found, error

    def _compared(self, panels: Array, coarse: Mesh, index: complex, mmax: int) -> tuple[ComplexArray, float]:
        """Return T and what a coarser mesh differs by, which is more than what is left."""
        if len(panels) > MOST_PANELS:
            raise UnsupportedError(
                f"{self.source}: a particle {2 * self.radius_nm:g} nm wide and {self.height_nm:g} nm high takes "
                f"{len(panels)} panels, too many to be solved; it is too large or too flat"
            )
        found = reciprocal(block_t_matrix(Mesh(panels), index, self.lmax, mmax))
        again = reciprocal(block_t_matrix(coarse, index, CHECKED_ORDER, 1))
        kept = np.concatenate([np.arange(CHECKED_ORDER), self.lmax + np.arange(CHECKED_ORDER)])
        change = float(np.linalg.norm(again - found[:2, kept[:, None], kept]) / np.linalg.norm(again))
        return found, max(change, gain(found), 1e-6)

    def index(self, wavelength_nm: float) -> complex | None:
        """Return the particle's own index."""
        return complex(self.core.n_complex(np.array([wavelength_nm]))[0])

    def all_known(self, wavelengths_nm: Array) -> AxialTMatrices:
        """Return the T-matrices at some wavelengths, with every azimuthal order, up to l = 10."""

        def whole(wavelength_nm: float) -> ComplexArray:
            return truncated(self.azimuthal(wavelength_nm, EXPORTED_ORDER), EXPORTED_ORDER)

        blocks = in_threads(whole, [float(w) for w in wavelengths_nm])
        around = self.ambient.n_complex(wavelengths_nm).real
        return AxialTMatrices(
            wavelengths_nm, np.stack(blocks), around, self.name, self.radius_nm, self.height_nm, self.circumscribing_nm,
            self.core.n_complex(wavelengths_nm),
        )  # fmt: skip
