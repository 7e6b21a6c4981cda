"""Spheres, cylinders and spheroids, optionally coated: size distributions, meshes and T-matrices."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import ClassVar

import numpy as np

from nacre.core.arrays import Array, ComplexArray
from nacre.core.disk_cache import cache_arrays, cached_arrays
from nacre.core.errors import UnsupportedError
from nacre.core.parallel import in_threads, single_threaded_blas
from nacre.families.metasurface.tmatrix.axisymmetric import AxialTMatrices, Body, gain, reciprocal, truncated
from nacre.families.metasurface.tmatrix.bem import Mesh, block_t_matrix
from nacre.families.metasurface.tmatrix.particle_on_stack import AZIMUTHAL_ORDERS
from nacre.families.metasurface.tmatrix.substrate import Substrate
from nacre.matter.indices.constant import OpticalConstant
from nacre.matter.mie import mie_coefficients
from nacre.recipe.fingerprint import fingerprint

SIZE_NODES = 5


@dataclass(frozen=True)
class Shell:
    """A coating around the core."""

    material: OpticalConstant
    thickness_nm: float


@dataclass(frozen=True)
class Sizes:
    """Core radii for spheres, or full radii for other particles, and their number fractions."""

    radii_nm: tuple[float, ...]
    shares: tuple[float, ...]

    def larger_by(self, coat_nm: float) -> Sizes:
        """Return the sizes with a coat."""
        return Sizes(tuple(r + coat_nm for r in self.radii_nm), self.shares)

    @classmethod
    def of(cls, radius_nm: float, deviation_nm: float = 0.0, distribution: str = "gaussian") -> Sizes:
        """Quadrature nodes for a size distribution with the given mean and standard deviation."""
        if deviation_nm == 0.0:
            return cls((radius_nm,), (1.0,))
        x, w = np.polynomial.hermite_e.hermegauss(SIZE_NODES)
        if distribution == "lognormal":
            variance = np.log1p((deviation_nm / radius_nm) ** 2)
            radii = radius_nm * np.exp(np.sqrt(variance) * x - variance / 2)
        else:
            radii = radius_nm + deviation_nm * x
        return cls(tuple(float(r) for r in radii), tuple(float(v) for v in w / w.sum()))


def sphere_t_matrix(
    core: OpticalConstant, shell: Shell | None, radius_nm: float, lmax: int, surface: Substrate
) -> ComplexArray:
    """Return the diagonal T for one sphere at the wavelength of `surface`, `[n]`: -b_l, then -a_l (Mie)."""
    lam = np.array([surface.wavelength_nm])
    radii, indices = [radius_nm], [complex(core.n_complex(lam)[0])]
    if shell is not None:
        radii.append(radius_nm + shell.thickness_nm)
        indices.append(complex(shell.material.n_complex(lam)[0]))
    x = surface.inner_wavenumber * np.array(radii)
    a, b = mie_coefficients(lmax, x, np.array(indices) / surface.inner_index)
    return np.concatenate([-b, -a])


LEAST_ORDER, HIGHEST_ORDER = 20, 28  # discs near a stack converge to 1 % at l = 10, to 0.2 % at l = 20
EXPORTED_ORDER = 10  # limits an exported file with 48 wavelengths, 600 MB with all orders
SHORTEST_NM = 360.0
GRADING = 0.15  # panel ratio towards an edge: GRADING^(2 n nu) remains after n levels, nu the field exponent
LADDER, CONTENT = (3, 7, 14), 1e-3  # levels, and the target error: nu is 0.5 to 0.8, but near 0 for silver at 360 nm
SMOOTH_LADDER = (-1, 0, 3)  # additional spheroid panels
LONGEST = 4.0  # panel length times index; degree 6 resolves 2/3 wavelength to 1e-7
LONGEST_OVER_WIDTH = 3.0  # panel length over the smallest extent: the far side's field varies as fast
MOST_PANELS, MOST_WITH_COAT = 40, 60
REFUSED = 1e-2  # largest accepted relative error
CHECKED_ORDER = 3
RIM_PIECES = 2  # panels on a coat rim
CLOSER = 1.5  # refinement for the next coat mesh
COAT_STEPS = 4.0  # grading ratio beyond the coat thickness
COAT_RESOLUTION = (
    0.5  # relative to the coat thickness; closer to the edge the outer surface need not follow the core mesh
)
COARSE = partial(Mesh, degree=4, outer=10, far=8, on_itself=10)


def cylinder_panels(
    radius: float, height: float, index: float, levels: int = LADDER[0], coat: float = 0.0
) -> tuple[Array, Array]:
    """Return panels for the upper half cylinder, and for the outer coat surface, rounded about the edge.

    They run from the axis along the top to the equator, graded towards the edge. Close surfaces are cut at the same
    places, since panel current fields change at the ends.

    Args:
        radius, height: cylinder, times the ambient k.
        index: highest modulus over the ambient index.
        levels: grading levels.
        coat: thickness times the ambient k.
    """
    longest = min(LONGEST / max(1.0, index), LONGEST_OVER_WIDTH * min(2 * radius, height))
    bare: list[tuple[float, ...]] = []
    coated: list[tuple[float, ...]] = []
    for is_top, length in ((True, radius), (False, height / 2)):
        marks = [0.0]
        for low, high in pairwise([0.0, *_grading(length, min(radius, height / 2), levels, coat), length]):
            pieces = max(1, int(np.ceil((high - low) / longest)))
            marks += [low + (high - low) * n / pieces for n in range(1, pieces + 1)]
        coat_marks = [0.0, *(m for m in marks[1:-1] if m > COAT_RESOLUTION * coat), length]
        for rows, selected, out in ((bare, marks, 0.0), (coated, coat_marks, coat)):
            ends = [length - m for m in selected]  # from the axis or the equator
            if is_top:
                rows += [(0.0, low, height / 2 + out, high, height / 2 + out, 0.0) for high, low in pairwise(ends)][
                    ::-1
                ]
            else:
                rows += [(0.0, radius + out, high, radius + out, low, 0.0) for high, low in pairwise(ends)]
        if is_top:
            turns = _turns(max(RIM_PIECES, int(np.ceil(coat * np.pi / 2 * max(1.0, index) / LONGEST))))
            coated += [(2.0, radius, height / 2, a, b, coat) for a, b in pairwise(turns)]
    return np.array(bare), np.array(coated)


def _grading(length: float, width: float, levels: int, coat: float) -> list[float]:
    """Return the cuts on a line from an edge, including coat thickness multiples."""
    first = min(width, length)
    finest = first * GRADING**levels
    if not finest < coat < length / 2:
        return [first * GRADING**n for n in range(levels, 0, -1)]
    inner = [coat * GRADING**n for n in range(1, levels + 1) if coat * GRADING**n >= finest]
    outer = [coat * COAT_STEPS**n for n in range(levels + 9) if coat * COAT_STEPS**n < length / 2]
    return [*inner[::-1], *outer]


def film_mode(core: complex, coat: complex, thickness: float) -> float:
    """Return the wavenumber for the shortest wave guided by a thin coat, over the ambient k, in the quasistatic limit.

    Between two half spaces: e^(2 k t) = (e - e1)(e - e2) / ((e + e1)(e + e2)).
    """
    e, around = coat**2, (1.0 + 0.0j, core**2)
    above, below = (complex(np.prod([e + sign * other for other in around])) for sign in (-1.0, 1.0))
    if abs(above) <= abs(below) or below == 0.0:  # no guided wave, or a surface resonance
        return 0.0
    return float(abs(np.log(above / below))) / (2 * thickness)


def _turns(count: int) -> Array:
    return np.linspace(0.0, np.pi / 2, count + 1)


def spheroid_panels(radius: float, height: float, index: float, coarser: int = 0, coat: float = 0.0) -> Array:
    """Return panels for the upper half spheroid, from the pole to the equator; see `cylinder_panels`.

    With `coat`, they belong to the outer surface; without their last column, to the core.
    """
    a, c = radius, height / 2
    count = 2
    for wide, high in ((a, c), (a + coat, c + coat)):
        longest = min(LONGEST / max(1.0, index), LONGEST_OVER_WIDTH * min(2 * wide, 2 * high))
        count = max(count, int(np.ceil(max(wide, high) * np.pi / 2 / longest)))
    tips = int(np.ceil(np.log2(max(a / c, c / a, 1.0))))
    edges = _turns(max(count + tips - coarser, 1))
    return np.array([(1.0, a, c, low, high, coat) for low, high in zip(edges, edges[1:])])


@dataclass(frozen=True)
class SolvedBody(Body):
    """A cylinder or spheroid with its axis along the normal, whose T-matrix is computed by `bem`. See `Body`.

    Attributes:
        radius_nm, height_nm: with the shell.
        core: core material.
        ambient: the surrounding medium.
        shell: a coat with uniform thickness, rounded about cylinder edges (optional).
        edge_nm: cylinder core edge radius; 0 for sharp edges.
    """

    method: ClassVar[str] = "PMCHWT, Galerkin, body of revolution"

    shape: str
    radius_nm: float
    height_nm: float
    core: OpticalConstant
    ambient: OpticalConstant
    source: str
    shell: Shell | None = None
    edge_nm: float = 0.0
    errors: dict[float, float] = field(default_factory=dict, compare=False)

    @property
    def name(self) -> str:  # type: ignore[override]  # read only, as all of a frozen dataclass
        """Particle description."""
        radius, height = self.core_extents_nm
        coat = "" if self.shell is None else f", in {self.shell.thickness_nm:g} nm of {self.shell.material.name}"
        edge = f", edges of {self.edge_nm:g} nm" if self.edge_nm else ""
        return f"{self.shape} of {self.core.name}, {2 * radius:g} x {height:g} nm{edge}{coat}"

    @property
    def core_extents_nm(self) -> tuple[float, float]:
        """Core radius and height."""
        coat = 0.0 if self.shell is None else self.shell.thickness_nm
        return self.radius_nm - coat, self.height_nm - 2 * coat

    @property
    def circumscribing_nm(self) -> float:  # type: ignore[override]
        """Largest distance from the centre."""
        if self.shape != "cylinder":
            return max(self.radius_nm, self.height_nm / 2)
        radius, height = self.core_extents_nm
        corner = float(np.hypot(radius - self.edge_nm, height / 2 - self.edge_nm))
        return corner + self.edge_nm + self.radius_nm - radius

    def with_radius(self, radius_nm: float) -> SolvedBody:
        """Return the same particle with another width and the same height; both share the error estimates."""
        return replace(self, radius_nm=radius_nm)

    @cached_property
    def lmax(self) -> int:  # type: ignore[override]
        """Highest multipole order: as for Mie series, and at least what a near stack needs.

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
    def estimated_error(self) -> float | None:
        """The largest relative difference between two meshes over the computed wavelengths."""
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
        """Return T with m up to `mmax`; see `t_matrix`."""
        key = (wavelength_nm, mmax)
        if key not in self._solved:
            self._solved[key] = self._cached(wavelength_nm, mmax)
        return self._solved[key]

    def reduced(self, wavelength_nm: float) -> tuple[float, float, complex, tuple[float, complex] | None, float]:
        """Return core radius and height, index, (thickness, index) of the shell, and edge radius.

        Lengths are multiplied by the ambient's wavenumber, indices divided by its index.
        """

        def relative(medium: OpticalConstant) -> complex:
            return complex(medium.n_complex(np.array([wavelength_nm]))[0]) / around

        around = float(self.ambient.n_complex(np.array([wavelength_nm]))[0].real)
        k = 2 * np.pi * around / wavelength_nm
        radius, height = (k * length for length in self.core_extents_nm)
        coat = None if self.shell is None else (k * self.shell.thickness_nm, relative(self.shell.material))
        return radius, height, relative(self.core), coat, k * self.edge_nm

    def _cached(self, wavelength_nm: float, mmax: int) -> ComplexArray:
        radius, height, index, coat, edge = self.reduced(wavelength_nm)
        thickness, outside = (0.0, 1.0) if coat is None else coat
        parts = (radius, height, index.real, index.imag, thickness, outside.real, outside.imag)
        numbers = [float(v).hex() for v in (*parts, *([edge] if edge else []))]
        key = "tmatrix-" + fingerprint({"shape": self.shape, "numbers": numbers}, {}, lmax=self.lmax, mmax=mmax)
        stored = cached_arrays(key)
        if stored and {"real", "imaginary", "error"} <= stored.keys():
            found, error = stored["real"] + 1j * stored["imaginary"], float(stored["error"])
        else:
            with single_threaded_blas():  # the matrices are small, and callers run in threads
                found, error = self._solve(radius, height, index, mmax, coat, edge)
            cache_arrays(key, {"real": found.real, "imaginary": found.imag, "error": np.array(error)})
        self.errors[wavelength_nm] = max(error, self.errors.get(wavelength_nm, 0.0))
        if error > REFUSED:
            raise UnsupportedError(
                f"{self.source}: the T-matrix does not converge at {wavelength_nm:g} nm: two meshes differ by "
                f"{error:.2g}, {REFUSED:g} is allowed{self._remedy}"
            )
        return found

    @property
    def _remedy(self) -> str:
        if self.shape != "cylinder":
            return ""
        if self.edge_nm:
            return "; a larger edge_radius_nm may help"
        beside = "ambient's" if self.shell is None else "shell's"
        return (
            f" (at a sharp edge a metal whose permittivity is near minus the {beside} has no finite field); give the "
            "edges a radius: edge_radius_nm = 1, say"
        )

    def _solve(
        self,
        radius: float,
        height: float,
        index: complex,
        mmax: int,
        coat: tuple[float, complex] | None = None,
        edge: float = 0.0,
    ) -> tuple[ComplexArray, float]:
        """Return T and its estimated error; `coat` is (thickness, index), `edge` the edge radius."""
        thickness, shell = (0.0, index) if coat is None else coat
        highest = max(abs(index), abs(shell))
        if coat is not None:
            highest = max(highest, film_mode(index, shell, thickness))

        def mesh(fineness: int, closer: float, make: Callable[..., Mesh] = Mesh) -> Mesh:
            if self.shape == "cylinder":
                # a rounded cylinder is the outer coat surface on a smaller sharp one
                sharp = (radius - edge, height - 2 * edge, closer * highest, fineness)
                core, outside = cylinder_panels(*sharp, edge + thickness)
                if edge:
                    core = cylinder_panels(*sharp, edge)[1]
            else:
                outside = spheroid_panels(radius, height, closer * highest, -fineness, thickness)
                core = np.column_stack([outside[:, :-1], np.zeros(len(outside))])
            return make(core) if coat is None else make(outside, core)

        start, *finer = (LADDER[0] - 1, *LADDER) if self.shape == "cylinder" else SMOOTH_LADDER
        before, closer = mesh(start, 1.0, COARSE), 1.0
        for fineness in finer:
            now = mesh(fineness, closer)
            found, error = self._compared(now, before, index, mmax, coat)
            if error <= CONTENT:
                break
            before = now
            # refine a coat also away from the core edge
            closer *= 1.0 if coat is None and not edge else CLOSER
        return found, error

    def _compared(
        self, fine: Mesh, coarse: Mesh, index: complex, mmax: int, coat: tuple[float, complex] | None
    ) -> tuple[ComplexArray, float]:
        """Return T and its relative difference from a coarser mesh, an upper error bound."""
        count = len(fine.panels) + (0 if fine.core is None else len(fine.core))
        if count > (MOST_PANELS if coat is None else MOST_WITH_COAT):
            raise UnsupportedError(
                f"{self.source}: a particle {2 * self.radius_nm:g} nm wide and {self.height_nm:g} nm high takes "
                f"{count} panels, too many to be solved; it is too large or too flat"
                + ("" if coat is None else ", or its coat too thin")
            )
        outermost, core = (index, None) if coat is None else (coat[1], index)
        found = reciprocal(block_t_matrix(fine, outermost, self.lmax, mmax, core))
        again = reciprocal(block_t_matrix(coarse, outermost, CHECKED_ORDER, 1, core))
        selected = np.concatenate([np.arange(CHECKED_ORDER), self.lmax + np.arange(CHECKED_ORDER)])
        change = float(np.linalg.norm(again - found[:2, selected[:, None], selected]) / np.linalg.norm(again))
        return found, max(change, gain(found), 1e-6)

    def index(self, wavelength_nm: float) -> complex | None:
        """Return the particle index."""
        return complex(self.core.n_complex(np.array([wavelength_nm]))[0])

    def exported_t_matrices(self, wavelengths_nm: Array) -> AxialTMatrices:
        """Return the T-matrices at the given wavelengths, with all azimuthal orders, up to degree 10."""

        def whole(wavelength_nm: float) -> ComplexArray:
            return truncated(self.azimuthal(wavelength_nm, EXPORTED_ORDER), EXPORTED_ORDER)

        blocks = in_threads(whole, [float(w) for w in wavelengths_nm])
        around = self.ambient.n_complex(wavelengths_nm).real
        return AxialTMatrices(
            wavelengths_nm,
            np.stack(blocks),
            around,
            self.name,
            self.radius_nm,
            self.height_nm,
            self.circumscribing_nm,
            None if self.shell is not None else self.core.n_complex(wavelengths_nm),
        )
