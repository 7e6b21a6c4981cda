"""The relief material: parameters, Bsdf and figures."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf.bsdf import Bsdf
from nacre.core.arrays import direction
from nacre.core.errors import UnsupportedError
from nacre.families.contract import DirectEvaluation, Draft, ExcessEnergy, Fabricable, Figure, Model, Traits
from nacre.families.relief.diffraction_orders import Coherence, Prefactor, choose_sampling, coating_reflectance
from nacre.families.relief.plane_cut import Reflectance, local_response
from nacre.families.relief.scan import Scan
from nacre.families.relief.spectrum_map import EXCESS_ANGLES_DEG, MapReport, map_values, spectrum_map
from nacre.families.relief.structures import Blocks, Lines, blocks_of, lines_of
from nacre.families.relief.surface import Array, Tile, Validity, assess, slopes
from nacre.matter.drawings import Drawer, DrawingRequest, HeightMap
from nacre.matter.indices.constant import OpticalConstant
from nacre.matter.periodic.structure import MAX_UNKNOWNS

# a blurred diffraction line passes within lambda / 10: 30 nm resolve the spectra
WAVELENGTH_COUNT = 17
DRAFT_ERROR = 1e-2  # error allowed in a draft by sampling and nodes; invisible in 8 bits
INDEX_NM = 550.0  # wavelength at which the coherence window uses the medium's index
NOTED_EXCESS = 1.2  # ratio of albedo to Fresnel reflectance above which the energy bound is reported
LEAST_RESOLVED_DEG = 60.0  # scans that resolve scattering only up to a smaller angle give a warning
FLAT_NM = 0.05  # a scan with a smaller Sq counts as a plane: less than an atom
COARSE_BLURS = 3.0  # ratio of a scan's angular resolution to the coherence blur above which a warning is given
FIGURE_POINTS = 1024
WAY_OUT = 'model.optics = "vector" solves Maxwell\'s equations for these'
STATISTICS = {
    "scan": 'statistics = "scan": the scan itself diffracts, since its heights are not random',
    "random": 'statistics = "random": random heights with the power spectral density of the scan',
    "isotropic": 'statistics = "isotropic": random heights with the mean power spectral density of the scan',
}


@dataclass(frozen=True)
class Relief(Model, DirectEvaluation, Draft, Fabricable, ExcessEnergy):
    """A height map with an opaque coating, in light of finite coherence.

    Attributes:
        tile: one period, heights and process; or a scan, which has none.
        coherence: coherence window.
        coating: optical constant of the opaque coating.
        prefactor: "kirchhoff" conserves energy, "published" compares with the source.
        error: allowed relative error of sampling and interpolation.
        bounded: limit the albedo to Fresnel.
        ambient: medium above, with directions inside it; default: vacuum.
        remark: why scalar theory was chosen, or empty.
    """

    traits = Traits(
        noun="relief",
        unpolarised_reason="is computed by scalar diffraction, which has no polarisation; ask for both",
        default_geometry="45as15",  # its specular reflection is a lobe of finite width
    )
    is_direct = False
    version = 2  # heights that do not close at their edges are scans

    tile: Tile | Scan
    coherence: Coherence
    coating: OpticalConstant
    prefactor: Prefactor = "kirchhoff"
    error: float = 3e-3
    bounded: bool = True
    ambient: OpticalConstant | None = None
    remark: str = ""

    @property
    def wavelengths_nm(self) -> Array:
        """Default grid: 360-830 nm in about 30 nm, finer for reliefs deeper than 2 um."""
        deep = max(1.0, self.tile.height_range_nm / 2000.0)
        return np.linspace(360.0, 830.0, int(np.ceil(WAVELENGTH_COUNT * deep)))

    def bsdf(self, wavelengths_nm: Array | None = None) -> Bsdf:
        """Return the four-dimensional lobe; the provenance lists the chosen nodes.

        Raises:
            MaterialRangeError: the coating is not known at a wavelength.
            UnsupportedError: the table would be too large.
        """
        grid = self.wavelengths_nm if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
        lobe, report = self._map(tuple(grid.tolist()))
        limits = {"warnings": [_bound_note(report)]} if max(report.excess, default=0.0) > NOTED_EXCESS else {}
        return Bsdf((lobe,), {"relief": report_summary(report), **limits})

    def values_at(self, wi: Array, wo: Array, wavelengths_nm: Array) -> Array:
        """Return the lobe at pairs, `[pair, wavelength]`, without the table of all directions.

        Equal to `bsdf` up to single-precision rounding, 1e-5 of the maximum.
        """
        grid = np.asarray(wavelengths_nm, dtype=float)
        window, n, reflectance = self._optics(grid)
        return map_values(
            self.tile, window, grid / n, reflectance, wi, wo, self.prefactor, self.error, self.bounded
        )  # fmt: skip

    @functools.lru_cache(maxsize=2)  # noqa: B019  (a relief is immutable and its lobe takes seconds)
    def _map(self, wavelengths: tuple[float, ...]) -> tuple[Any, MapReport]:
        grid = np.array(wavelengths)
        window, n, reflectance = self._optics(grid)
        lobe, report = spectrum_map(self.tile, window, grid / n, reflectance, self.prefactor, self.error, self.bounded)
        return replace(lobe, wavelengths_nm=grid), report

    @property
    def draft(self) -> Relief:
        """The relief on coarser nodes without the energy bound, whose sums over all exits cost the most.

        The bound affects mostly grazing light; see `spectrum_map.energy_guard`.
        """
        return replace(self, error=max(self.error, DRAFT_ERROR), bounded=False)

    def _optics(self, grid: Array) -> tuple[Coherence, Array, Reflectance]:
        """Return the coherence window in the medium above, its index `[wavelength]`, and the coating's reflectance."""
        n = np.ones(len(grid)) if self.ambient is None else self.ambient.n_complex(grid).real
        # wavelengths and source angles are smaller inside a medium by its index
        window = Coherence(self.coherence.width_in_wavelengths * self.index_above)
        return window, n, coating_reflectance(self.coating.n_complex(grid) / n)

    def __hash__(self) -> int:
        return id(self)

    def report(self, wavelengths_nm: Array | None = None) -> dict[str, Any]:
        """Return sampling, nodes and energy bound as plain numbers."""
        grid = self.wavelengths_nm if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
        return report_summary(self._map(tuple(grid.tolist()))[1])

    @property
    def excess_reason(self) -> str:
        """Why the albedo may exceed the Fresnel reflectance; "" if it cannot."""
        if self.prefactor == "published":
            return 'prefactor = "published" does not conserve energy'
        return "" if self.bounded else "bounded = false leaves scalar diffraction unbounded"

    @property
    def warnings(self) -> tuple[str, ...]:
        """Slopes too steep, or features too small, for scalar diffraction; corrections applied to a scan."""
        validity = self.validity
        lines: tuple[str, ...] = (self.remark,) if self.remark else ()
        if validity.is_outside:
            lines += (validity.line(),)
        if not isinstance(self.tile, Scan):
            if validity.is_outside and self.pattern is not None and not self.vector_obstacle(MAX_UNKNOWNS):
                lines = (*lines[:-1], f"{lines[-1]}; {WAY_OUT} {self.pattern.noun}")
            return lines
        angle = self.tile.resolved_deg
        if angle < LEAST_RESOLVED_DEG and self.tile.sq_nm > FLAT_NM:
            pitch = f"{self.tile.pitch_nm / 1e3:.3g} um"
            lines += (f"points {pitch} apart resolve scatter up to {angle:.0f} degrees from the mirror direction",)
        width_nm = min(self.tile.heights_nm.shape) * self.tile.pitch_nm
        if INDEX_NM / width_nm > COARSE_BLURS * self.coherence.blur and self.tile.sq_nm > FLAT_NM:
            near = np.degrees(np.arcsin(min(1.0, INDEX_NM / width_nm)))
            width = f"{width_nm / 1e3:.3g} um"
            lines += (f"a scan {width} wide counts scatter within {near:.2g} degrees of the mirror direction to it",)
        if self.tile.statistics is None and self.tile.sq_nm > FLAT_NM:
            lines += (STATISTICS[self.tile.kind],)
        return self.tile.remarks + lines

    @functools.cached_property
    def pattern(self) -> Lines | Blocks | None:
        """The smallest period, for vector optics; a scan has none."""
        return None if isinstance(self.tile, Scan) else lines_of(self.tile) or blocks_of(self.tile)

    def vector_obstacle(self, most: int) -> str:
        """Return why the relief cannot be solved by Maxwell's equations with `most` unknowns, or nothing."""
        if self.pattern is None:
            return "a scan has no period"
        if isinstance(self.pattern, Lines):
            return self.pattern.obstacle
        shortest = self.wavelengths_nm[:1]
        index = complex(self.coating.n_complex(shortest)[0]) / self.index_above
        return self.pattern.obstacle(index, float(shortest[0]) / self.index_above, most)

    @functools.cached_property
    def validity(self) -> Validity:
        """The expected colour error."""
        if isinstance(self.tile, Scan):
            return self.tile.validity(self.index_above)
        return assess(self.tile, self.index_above)

    @property
    def surface_figures(self) -> Mapping[str, float]:
        """Roughness of a scan: Sq and others, in um."""
        return dict(self.tile.figures) if isinstance(self.tile, Scan) else {}

    @property
    def _period(self) -> Tile:
        """The period.

        Raises:
            UnsupportedError: the surface is a scan, which is not periodic.
        """
        if isinstance(self.tile, Scan):
            raise UnsupportedError("a scan is not a period; this needs heights with periodic = true")
        return self.tile

    @property
    def index_above(self) -> float:
        """Index of the medium above, at 550 nm."""
        return 1.0 if self.ambient is None else float(self.ambient.n_complex(np.array([INDEX_NM])).real[0])

    @property
    def figures(self) -> Mapping[str, Figure]:
        """The surface, and its microscope image.

        "structure": `heights_nm` `[x, y]` of the blurred surface, `x_nm`, `slope` (magnitude).
        "microscope": `brdf` `[x, y, wavelength]` at every window position (`spectra`: the same as a picture, with
        `extent_um`), for an aperture of half angle `aperture_deg` (5) around the direction `view_deg` = (theta, phi)
        (0, 0), light along `light_deg` (0, 0).
        """
        if isinstance(self.tile, Scan):
            return {"structure": self._structure}
        return {"structure": self._structure, "microscope": self._microscope}

    @property
    def fabrications(self) -> Mapping[str, Drawer]:
        """The heights of a period, in all formats of height maps."""
        if isinstance(self.tile, Scan):
            return {}
        return dict.fromkeys(("png16", "tiff16", "stl", "gds", "oas", "csv"), self._height_map)

    def _height_map(self, request: DrawingRequest) -> HeightMap:
        heights = self._period.heights_nm
        return HeightMap((heights - heights.min()) / 1e3, self._period.feature_nm / 1e3)

    def _structure(self) -> dict[str, NDArray[Any]]:
        if isinstance(self.tile, Scan):
            heights = self.tile.heights_nm[:FIGURE_POINTS, :FIGURE_POINTS]
            dx, dy = np.gradient(heights, self.tile.pitch_nm)
            x = np.arange(heights.shape[0]) * self.tile.pitch_nm
            return {"heights_nm": heights, "x_nm": x, "slope": np.hypot(dx, dy)}
        upsampling = 8
        surface = self.tile.surface_nm(upsampling)
        dx, dy = slopes(surface, self.tile.feature_nm / upsampling)
        x = (np.arange(surface.shape[0]) + 0.5) * self.tile.feature_nm / upsampling
        return {"heights_nm": surface, "x_nm": x, "slope": np.hypot(dx, dy)}

    def _microscope(
        self,
        light_deg: tuple[float, float] = (0.0, 0.0),
        view_deg: tuple[float, float] = (0.0, 0.0),
        aperture_deg: float = 5.0,
        wavelengths_nm: Array | None = None,
        exits: int = 7,
    ) -> dict[str, NDArray[Any]]:
        grid = np.linspace(400.0, 700.0, 7) if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
        wi = direction(*np.radians(light_deg))
        centre = direction(*np.radians(view_deg))
        # exits over the aperture: the centre and a ring that encloses half its area
        ring = np.radians(aperture_deg) / np.sqrt(2.0)
        around = np.arange(exits - 1) * (2.0 * np.pi / max(exits - 1, 1))
        offsets = np.stack([ring * np.cos(around), ring * np.sin(around)], axis=-1)
        lateral = np.concatenate([centre[None, :2], centre[None, :2] + offsets])
        lateral = lateral[(lateral**2).sum(axis=-1) < 0.999]
        wo = np.concatenate([lateral, np.sqrt(1.0 - (lateral**2).sum(axis=-1, keepdims=True))], axis=-1)
        highest = int(np.ceil(self._period.period_nm * (np.abs(lateral + wi[:2]).max() + 0.2) / grid.min()))
        sampling = choose_sampling(self._period, 2.0 / float(grid.min()), highest, 1e-2)
        brdf = local_response(self._period, self.coherence, wi, wo, grid, sampling.samples_per_feature, self.prefactor)
        cosine = float(np.linalg.norm(wi + centre) / 2.0)
        brdf = brdf * coating_reflectance(self.coating.n_complex(grid))(np.array(cosine))
        step = self._period.feature_nm / sampling.samples_per_feature
        x = (np.arange(brdf.shape[0]) + 0.5) * step
        extent_um = np.array(self._period.period_nm / 1e3)
        # a picture's rows run along y
        picture = np.swapaxes(brdf, 0, 1)
        return {"brdf": brdf, "wavelengths_nm": grid, "x_nm": x, "spectra": picture, "extent_um": extent_um}


def _bound_note(report: MapReport) -> str:
    """Return how strongly the energy bound acts."""
    worst = int(np.argmax(report.excess))
    return (
        f"bounded = true scales the relief, which would reflect up to {max(report.excess):.2g} times the light at "
        f"{EXCESS_ANGLES_DEG[worst]:g} degrees; exits at grazing angles lose light at every incidence"
    )


def report_summary(report: MapReport) -> dict[str, Any]:
    """Return a report as plain numbers."""
    summary = asdict(report)
    sampling = summary.pop("sampling")
    return {**sampling, **summary, "excess_angles_deg": [0, 30, 60, 75, 85]}
