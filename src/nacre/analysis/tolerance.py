"""From manufacturing spreads to colour spread: how often is a coating within tolerance, and which number decides?"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from nacre.analysis.report import SPECULAR_ANGLES_DEG
from nacre.bsdf.grids import direction
from nacre.core.arrays import Array
from nacre.core.errors import NacreError, RecipeError
from nacre.light import delta_e_2000, spectrum_to_xyz, white_xyz, xyz_to_lab
from nacre.material.material import Material
from nacre.measure import instruments as geometry
from nacre.measure.wavelengths import colour_spectrum, colour_values
from nacre.optimise.tolerances import Tolerance, read_tolerances, wilson_interval
from nacre.recipe.path_tables import by_path, with_options

MAX_DRAWS = 1_000_000
SENSITIVITY_STEP = 0.5  # of a standard deviation: inside the spread, and far above rounding


@dataclass(frozen=True)
class ToleranceResult:
    """The outcome of a tolerance study.

    Attributes:
        geometry: "aspecular, 45 degree incidence" or "mirror direction".
        angles_deg: `[angle]`.
        nominal_lab: `[angle, 3]`.
        lab: `[draw, angle, 3]`.
        delta_e: `[draw, angle]`, dE00 to the nominal colour.
        limit: the dE00 limit of the yield.
        yield_share: share of draws within the limit at every angle; its 95 % interval is `yield_interval`.
        sensitivities: (path, dE00 of one standard deviation at the worst angle, share of variance), largest first.
        failed: draws that could not be computed, counted as outside the limit.
    """

    geometry: str
    angles_deg: Array
    nominal_lab: Array
    lab: Array
    delta_e: Array
    limit: float
    yield_share: float
    yield_interval: tuple[float, float]
    sensitivities: tuple[tuple[str, float, float], ...]
    failed: int


def recipe_tolerances(material: Material, options: tuple[str, ...] = ()) -> tuple[Tolerance, ...]:
    """Collect the spreads of the recipe's `[tolerance]` table and of `PATH=SPREAD` options, which win.

    A spread is a number (standard deviation), a percentage ("2%"), or in the recipe a table
    `{deviation = 5}`, `{percent = 2}`, each with `distribution = "uniform"` if wanted; `[*]` stands for every index.

    Raises:
        RecipeError: naming the path and what is allowed.
    """
    source = material.context.source
    table = by_path(material.data.get("tolerance", {}), {"deviation", "percent"}, source, "tolerance")
    given = []
    for option in options:
        path, equals, text = option.rpartition("=")
        if not equals:
            raise RecipeError(f'--spread "{option}" cannot be read; write it like layers[0].thickness_nm=2% or =5')
        given.append((path.strip(), text.strip()))
    table = with_options(table, given, "--spread")
    if not table:
        raise RecipeError(f"{source}: no spread is given; add a [tolerance] table or use --spread PATH=VALUE")
    return read_tolerances(table, material, source, "tolerance")


def run_tolerance(
    material: Material,
    spreads: tuple[Tolerance, ...],
    *,
    draws: int = 500,
    limit: float = 1.0,
    seed: int = 0,
    illuminant: str = "D65",
    observer: str = "10deg",
    samples: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> ToleranceResult:
    """Draw materials within their spreads and measure their colours.

    Random walks use one seed for all draws, so that their noise is not taken for spread.

    Args:
        material: the nominal material.
        spreads: from `recipe_tolerances`.
        draws: number of materials.
        limit: the dE00 within which a material passes, at every angle.
        progress: called with (done, all): draws, and the two materials of each spread's sensitivity.

    Raises:
        NacreError: the nominal material cannot be computed, or a number is out of its range.
    """
    if not 1 <= draws <= MAX_DRAWS:
        raise NacreError(f"--draws = {draws} must lie in [1, {MAX_DRAWS}]")
    if not limit > 0:
        raise NacreError(f"--limit = {limit} must be above 0")
    material = material.at_low_fidelity().with_parts_loaded(spread.path for spread in spreads)
    measure = ColourProbe(material, illuminant, observer, samples, seed)
    nominal = measure(material)
    generator = np.random.default_rng(seed)
    values = {spread.path: spread.draw(generator, draws) for spread in spreads}
    lab = np.full((draws, *nominal.shape), np.nan)
    done, every = 0, draws + 2 * len(spreads)

    def step() -> None:
        nonlocal done
        done += 1
        if progress:
            progress(done, every)

    for i in range(draws):
        try:
            lab[i] = measure(material.vary({path: float(v[i]) for path, v in values.items()}))
        except NacreError:
            pass  # stays NaN and counts as failed: an impossible draw is a finding, not an end
        step()
    delta = np.asarray(delta_e_2000(np.broadcast_to(nominal, lab.shape), lab))
    failed = int(np.sum(np.isnan(delta).any(axis=1)))
    good = int(np.sum(np.nan_to_num(delta, nan=np.inf).max(axis=1) <= limit))
    return ToleranceResult(
        measure.what, np.asarray(measure.angles_deg), nominal, lab, delta, limit, good / draws,
        wilson_interval(good, draws), _sensitivities(material, spreads, measure, nominal, step), failed,
    )  # fmt: skip


class ColourProbe:
    """Measures the Lab of a material at fixed angles: aspecular where it scatters, mirror-like where it does not."""

    def __init__(self, material: Material, illuminant: str, observer: str, samples: int | None, seed: int) -> None:
        self._light = (illuminant, observer)
        self._samples, self._seed = samples, seed
        wi = np.broadcast_to(direction(np.radians(45.0)), (1, 3))
        few = material.values_at(wi, wi, np.array([550.0]))  # answered by what scatters, without solving all of it
        scatters = few is not None or any(not lobe.is_delta for lobe in material.bsdf().lobes)
        self.what = "aspecular, 45 degree incidence" if scatters else "mirror direction"
        self.angles_deg: tuple[float, ...] = geometry.ASPECULAR_DEG if scatters else SPECULAR_ANGLES_DEG
        self._wo = np.stack([geometry.aspecular_direction(45.0, a) for a in geometry.ASPECULAR_DEG])
        self._scatters = scatters

    def __call__(self, material: Material) -> Array:
        """Return Lab, `[angle, 3]`."""
        if self._scatters:
            wi = np.broadcast_to(direction(np.radians(45.0)), self._wo.shape)
            values, grid = colour_values(material, wi, self._wo, self._light[0], self._samples, self._seed)
            values = np.pi * values
        else:
            # a smooth material needs no table over angles, only its stack at these
            spectrum = colour_spectrum(material, np.radians(self.angles_deg), self._light[0])
            reflectance = spectrum.specular_reflectance
            values = (
                np.zeros((len(self.angles_deg), len(spectrum.wavelengths_nm))) if reflectance is None else reflectance
            )
            grid = spectrum.wavelengths_nm
        return np.asarray(xyz_to_lab(spectrum_to_xyz(values, grid, *self._light), white_xyz(*self._light)))


def _sensitivities(
    material: Material,
    spreads: tuple[Tolerance, ...],
    measure: ColourProbe,
    nominal: Array,
    step_done: Callable[[], None],
) -> tuple[tuple[str, float, float], ...]:
    """Rank the spreads by the colour change of one standard deviation, from a central difference."""
    changes = []
    for spread in spreads:
        sigma = spread.standard_deviation
        step = SENSITIVITY_STEP * sigma
        low = max(spread.nominal - step, 0.0) if spread.nominal >= 0 else spread.nominal - step
        high = spread.nominal + step
        if high <= low:
            changes.append(0.0)
            step_done()
            step_done()
            continue
        ends = []
        for value in (low, high):
            ends.append(measure(material.vary({spread.path: value})))
            step_done()
        below, above = ends
        slope = (above - below) / (high - low) * sigma
        changes.append(float(np.max(delta_e_2000(nominal, nominal + slope))))
    total = sum(change**2 for change in changes) or 1.0
    ranked = sorted(zip(spreads, changes, strict=True), key=lambda pair: -pair[1])
    return tuple((spread.path, change, change**2 / total) for spread, change in ranked)


def tolerance_document(result: ToleranceResult, spreads: tuple[Tolerance, ...]) -> dict[str, Any]:
    """Return the outcome as JSON-able data: statistics an angle, yield, sensitivities."""
    lab = result.lab[~np.isnan(result.lab).any(axis=(1, 2))]
    delta = result.delta_e[~np.isnan(result.delta_e).any(axis=1)]
    percentiles = np.percentile(delta, [50, 95], axis=0) if len(delta) else np.zeros((2, len(result.angles_deg)))
    return {
        "geometry": result.geometry,
        "angles_deg": result.angles_deg.tolist(),
        "nominal_lab": result.nominal_lab.tolist(),
        "mean_lab": lab.mean(axis=0).tolist() if len(lab) else None,
        "deviation_lab": lab.std(axis=0).tolist() if len(lab) else None,
        "delta_e_2000_median": percentiles[0].tolist(),
        "delta_e_2000_95": percentiles[1].tolist(),
        "limit": result.limit,
        "yield": result.yield_share,
        "yield_interval_95": list(result.yield_interval),
        "draws": len(result.lab),
        "failed_draws": result.failed,
        "sensitivities": [
            {"path": path, "delta_e_of_one_deviation": change, "share_of_variance": share}
            for path, change, share in result.sensitivities
        ],
        "spreads": [spread.__dict__ for spread in spreads],
    }


__all__ = ["ColourProbe", "Tolerance", "ToleranceResult", "recipe_tolerances", "run_tolerance", "tolerance_document"]
