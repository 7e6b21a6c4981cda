"""Films in ridges by Maxwell's equations: supercells of ridges of random heights, widths and places."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from nacre.bsdf import Bsdf
from nacre.bsdf.lobe import Lobe
from nacre.bsdf.lobes.ridge import RidgeTable
from nacre.core.arrays import Array
from nacre.families.contract import Traits
from nacre.families.film.material import Film
from nacre.families.film.ridges import remainder
from nacre.light import delta_e_2000, white_xyz, xyz_to_lab, xyz_weights
from nacre.matter.periodic.ridge_supercells import (
    ALONG,
    RidgeCase,
    RidgeStatistics,
    even_wavelengths,
    ridge_table,
    solved_case,
    solved_wavelengths,
    truncation_error,
)
from nacre.matter.periodic.structure import NotConvergedError

ALONG_NODES = 21  # the solved directions are among them
VIEWS_DEG, HALF_VIEW_DEG = (0.0, 15.0, 30.0, 45.0, 60.0), 7.5  # views for which the colour error is stated
COLOUR_NM = 400.0, 700.0  # range without which a colour has no meaning
LARGEST_ERROR = 0.1  # as a share of the reflected light
BRIGHTEST = 1.0 - 1e-6


@dataclass(frozen=True)
class SupercellFilm(Film):
    """A film in ridges, solved by supercells; see `Ridges` for their statistics."""

    traits = Traits(noun="film", default_parts=("diffuse_reflectance",))

    @cached_property
    def wavelengths_nm(self) -> Array:
        """Default grid, the solved wavelengths."""
        low, high = self.range_nm
        if self.step_nm is None:
            return even_wavelengths(low, high)
        step = self.step_nm
        return np.linspace(low, high, max(2, int(np.ceil((high - low) / step - 1e-9)) + 1))

    def bsdf(self, wavelengths_nm: Array | None = None) -> Bsdf:
        """Solve the supercells in steps of at most 20 nm and return the lobe; solutions are stored.

        Raises:
            MaterialRangeError: an optical constant is not known at a wavelength.
            NotConvergedError: the layers need more orders than are solved, as metals do.
            UnsupportedError: an opaque substrate hides the diffuse base.
        """
        lam = self.wavelengths_nm if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
        assert self.ridges is not None
        self._refuse_hidden_base(self.transmits(lam))
        grid = solved_wavelengths(lam)
        cases = self.cases(grid)
        worst = truncation_error(cases[len(cases) // 2])
        if worst > LARGEST_ERROR:
            raise NotConvergedError(
                f'ridges.optics = "vector" is not solved: error {worst:.1g} of the orders; allowed: at most '
                f'{LARGEST_ERROR:g}, by layers of smaller index or optics = "scalar"'
            )
        tables = [[solved_case(case, along) for case in cases] for along in ALONG]
        solved = np.stack([np.stack([mean for mean, _ in each], axis=-1) for each in tables])
        rows = np.stack([normal for _, normal in tables[0]], axis=-1)
        table = ridge_table(solved, cases, ALONG_NODES)
        place = np.interp(lam, grid, np.arange(len(grid)))
        low = np.minimum(place.astype(int), max(len(grid) - 2, 0))
        high, part = np.minimum(low + 1, len(grid) - 1), place - low
        table = table[..., low] * (1.0 - part) + table[..., high] * part
        table *= np.minimum(1.0, BRIGHTEST / np.maximum(_brightest(table), 1e-12))
        # equal rounding on both sides of the diagonal keeps the lobe reciprocal
        power = table.astype(np.float32)
        power = 0.5 * (power + np.swapaxes(power, 1, 2))
        lobe = RidgeTable(lam, power, self.ridges.spread_along, self.ridges.fill, self.ridges.rotation)
        lobes: list[Lobe] = [lobe]
        if self.base_albedo > 0:
            lobes.append(remainder(lobe, np.full(len(lam), self.base_albedo)))
        notes = {
            "optics": "vector", "supercells": self.ridges.draws, "ridges_in_a_supercell": self.ridges.count,
            "truncation_error": float(f"{worst:.2g}"),
        }  # fmt: skip
        if self.ridges.draws > 1 and grid[0] <= COLOUR_NM[0] and grid[-1] >= COLOUR_NM[1]:
            notes["colour_error_dE00"] = round(colour_error(rows, grid), 2)
        return Bsdf(tuple(lobes), notes)

    def cases(self, grid: Array) -> list[RidgeCase]:
        """Return the supercells at wavelengths."""
        ridges, stack = self.ridges, self.stack
        assert ridges is not None
        statistics = RidgeStatistics(
            ridges.pitch_nm, ridges.width_nm, ridges.count, ridges.height_deviation_nm, ridges.width_deviation_nm,
            ridges.shift_deviation_nm,
        )  # fmt: skip
        n = stack.indices(grid)  # [medium, wavelength]
        thicknesses = tuple(layer.thickness_at() for layer in self.layers)
        return [
            RidgeCase(
                statistics, thicknesses, tuple(complex(v) for v in n[1:-1, w]), float(n[0, w].real),
                complex(n[-1, w]), float(lam), ridges.draws,
            )
            for w, lam in enumerate(grid)
        ]  # fmt: skip


def _brightest(table: Array) -> Array:
    """Return the largest share that leaves from any direction, `[wavelength]`."""
    return np.asarray(np.trapezoid(table, dx=2.0 / (table.shape[2] - 1), axis=2).max(axis=(0, 1)))


def colour_error(rows: Array, wavelengths_nm: Array) -> float:
    """Return the standard error of the colours seen under light along the normal, dE00, by the jackknife.

    The mean over views at 0 to 60 degrees, each 15 degrees wide, with the view along the normal as white.

    Args:
        rows: `[draw, b, wavelength]`, D for light along the normal; two draws or more.
    """
    count = len(rows)
    nodes = np.linspace(-1.0, 1.0, rows.shape[1])
    views = np.empty((count, len(VIEWS_DEG), rows.shape[2]))
    for k, view in enumerate(VIEWS_DEG):
        low, high = np.sin(np.radians([view - HALF_VIEW_DEG, view + HALF_VIEW_DEG]))
        inside = np.mean([(nodes >= low) & (nodes <= high), (-nodes >= low) & (-nodes <= high)], axis=0)
        views[:, k] = np.einsum("b,dbl->dl", inside / inside.sum(), rows)
    mean = views.mean(axis=0)
    weights, white = xyz_weights(wavelengths_nm, "D65", "2deg"), white_xyz("D65", "2deg")
    scale = white[1] / max(float(mean[0] @ weights[:, 1]), 1e-30)
    lab = xyz_to_lab(mean @ weights * scale, white)
    without = (mean * count - views) / (count - 1)
    away = delta_e_2000(xyz_to_lab(without @ weights * scale, white), lab)
    return float(np.sqrt((count - 1) / count * np.sum(np.square(away), axis=0)).mean())
