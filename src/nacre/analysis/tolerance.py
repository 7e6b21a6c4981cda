"""Tolerance analysis: distribution of colour and texture, yield and sensitivities under tolerances (Monte Carlo)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from nacre.analysis.report import SPECULAR_ANGLES_DEG
from nacre.analysis.ties import tied_maker, with_ties
from nacre.core.arrays import Array, direction
from nacre.core.errors import NacreError, RecipeError
from nacre.core.jobs import START_WORKERS_S, Workers, run_jobs
from nacre.families.contract import Diffracting
from nacre.light import delta_e_2000
from nacre.material.material import Material, MaterialLike, as_material
from nacre.measure.colours import geometry_colours, recipe_geometries
from nacre.measure.geometry import ASPECULAR_DEG, Geometry
from nacre.measure.texture import Instrument, TextureQuantity, check_texture, texture_values
from nacre.optimise.tolerances import Component, Tolerance, components, draw, read_tolerances, wilson_interval
from nacre.recipe.path_tables import by_path, with_options

MAX_DRAWS = 1_000_000
SENSITIVITY_STEP = 0.5  # central difference half step, in standard deviations
LIGHT_DEG = 45.0


@dataclass(frozen=True)
class ToleranceResult:
    """Tolerance analysis result.

    Attributes:
        geometry: "aspecular, 45 degree incidence", "mirror direction" or "geometries" (named ones).
        labels: `[angle]` geometries, such as "45as15", or their names.
        angles_deg: `[angle]`: aspecular angle or incidence; of named geometries the viewer's angle from the normal, or
            the incidence.
        nominal_lab: `[angle, 3]`.
        lab: `[draw, angle, 3]`.
        delta_e: `[draw, angle]`, dE00 to the nominal colour.
        limit: dE00 limit for the yield.
        yield_share: draw share within the limit at every angle, and within those of texture; `yield_interval`: its 95 %
            interval.
        sensitivities: (path or group, dE00 per standard deviation at the worst angle, variance share), largest first.
        contributions: (source, dE00 per standard deviation at the worst angles, variance share) of the causes of one
            source together, largest first.
        texture: per requested quantity.
        failed: draws that could not be computed; they count as outside the limit.
        clipped: path -> share of draws that were cut off at 0.
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
    clipped: dict[str, float]
    labels: tuple[str, ...] = ()
    contributions: tuple[tuple[str, float, float], ...] = ()
    texture: tuple[TextureSpread, ...] = ()


@dataclass(frozen=True)
class TextureSpread:
    """Distribution of one texture quantity.

    Attributes:
        quantity: such as "sparkle_45".
        nominal: its value, as in a report.
        off_percent: `[draw]`, deviation from it in per cent; NaN if a draw failed.
        limit_percent: largest accepted deviation.
        sensitivities: path or group -> per cent per standard deviation.
    """

    quantity: str
    nominal: float
    off_percent: Array
    limit_percent: float
    sensitivities: dict[str, float]


def recipe_tolerances(material: Material, options: tuple[str, ...] = ()) -> tuple[Tolerance, ...]:
    """Return tolerances from the recipe's `[tolerance]` table and `PATH=SPREAD` options, which take precedence.

    A tolerance is a number (standard deviation), a percentage ("2%"), or in the recipe a table `{deviation = 5}` or
    `{percent = 2}`, optionally with `distribution = "uniform"`; `[*]` means every index.

    Raises:
        RecipeError: with the path and the allowed values.
    """
    source = material.context.source
    table = by_path(material.data.get("tolerance", {}), {"deviation", "percent"}, source, "tolerance")
    overrides = []
    for option in options:
        path, equals, text = option.rpartition("=")
        if not equals:
            raise RecipeError(f'--tolerance "{option}" cannot be read; write it like layers[0].thickness_nm=2% or =5')
        overrides.append((path.strip(), text.strip()))
    table = with_options(table, overrides, "--tolerance")
    if not table:
        raise RecipeError(f"{source}: no tolerance is given; add a [tolerance] table or use --tolerance PATH=VALUE")
    return read_tolerances(table, material, source)


def run_tolerance(
    thing: MaterialLike,
    tolerances: Iterable[Tolerance | str] = (),
    *,
    draws: int = 500,
    limit: float = 1.0,
    seed: int = 0,
    illuminant: str = "D65",
    observer: str = "10deg",
    samples: int | None = None,
    geometries: Sequence[str] = (),
    texture: Mapping[str | TextureQuantity, float] | None = None,
    workers: Workers | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> ToleranceResult:
    """Compute colour variation, yield and ranked sensitivities from manufacturing tolerances.

    Random walks use one seed for all draws; their noise does not contribute to the distribution.

    Args:
        thing: a material or a path.
        tolerances: such as "layers[0].thickness_nm=2%", in addition to those of the recipe's `[tolerance]`; or from
            `recipe_tolerances`.
        draws: material count.
        limit: dE00 within which a material passes, at every geometry.
        geometries: "45as15", "specular 0", or names of the recipe's `[[geometry]]`; default: those of the recipe, or
            else the standard angles.
        texture: quantity, such as "sparkle_45", -> largest accepted deviation in per cent; `TextureQuantity` names an
            instrument too.
        workers: processes or cluster that measure the draws of long runs, such as
            `nacre.core.jobs.Workers(cluster="tcp://host:port")`; the result does not depend on them.
        progress: called with (done, total): draws, and two materials per sensitivity.

    Raises:
        NacreError: there is no tolerance, the nominal material cannot be computed, or a number leaves its range.
    """
    material = as_material(thing)
    stated = tuple(tolerances)
    spreads = tuple(each for each in stated if isinstance(each, Tolerance))
    if spreads and len(spreads) < len(stated):
        raise NacreError("tolerances: give texts, or the result of recipe_tolerances; both together are not allowed")
    spreads = spreads or recipe_tolerances(material, tuple(map(str, stated)))
    if not 1 <= draws <= MAX_DRAWS:
        raise NacreError(f"--draws = {draws} must lie in [1, {MAX_DRAWS}]")
    if not 0 < limit < np.inf:
        raise NacreError(f"--limit = {limit} must be above 0, and finite")
    material = with_ties(material.at_low_fidelity().with_parts_loaded(each.path for each in spreads))
    own = recipe_geometries(material)
    chosen = {name.strip(): Geometry.read(name, "geometry", own) for name in geometries} or own
    colour = ColourProbe(material, illuminant, observer, samples, seed, chosen)
    quantities = _quantities(material, texture or {}, (illuminant, observer))
    measure = _Probe(colour, tuple(quantities), seed)
    nominal, sought = measure.parts(measure(material))
    for each, value in zip(quantities, sought, strict=True):
        if value <= 0:
            raise NacreError(f'texture: "{each}" = 0 for the recipe as it is; deviations are relative to it')
    generator = np.random.default_rng(seed)
    causes = components(spreads)
    drawn = draw(spreads, generator, draws)
    values = drawn.values
    flat = np.full((draws, measure.size), np.nan)
    total = draws + 2 * len(causes)
    trials = _Trials(material, tuple(values), measure)
    drawn_values = list(np.stack(list(values.values()), axis=1))
    results = run_jobs(_measure_draw, trials, drawn_values, workers, start_workers_s=START_WORKERS_S)
    for done, (index, colours) in enumerate(results, start=1):
        if colours is not None:
            flat[index] = colours  # otherwise it remains NaN and counts as failed
        if progress:
            progress(done, total)
    moves = []
    for number, cause in enumerate(causes, start=1):
        moves.append(_sensitivity(trials, {t.path: t.nominal for t in spreads}, cause, nominal, sought))
        if progress:
            progress(draws + 2 * number, total)
    changes = [change for change, _ in moves]
    lab, numbers = measure.parts(flat)
    variance = sum(change**2 for change in changes) or 1.0
    ranked = sorted(zip(causes, changes, strict=True), key=lambda pair: -pair[1])
    delta = np.asarray(delta_e_2000(np.broadcast_to(nominal, lab.shape), lab))
    off = 100.0 * (numbers / sought - 1.0)
    is_good = np.nan_to_num(delta, nan=np.inf).max(axis=1) <= limit
    is_good &= np.all(np.abs(np.nan_to_num(off, nan=np.inf)) <= list(quantities.values()), axis=1)
    good = int(np.sum(is_good))
    return ToleranceResult(
        geometry=colour.geometry,
        angles_deg=np.asarray(colour.angles_deg),
        labels=colour.labels,
        nominal_lab=nominal,
        lab=lab,
        delta_e=delta,
        limit=limit,
        yield_share=good / draws,
        yield_interval=wilson_interval(good, draws),
        sensitivities=tuple((each.name, change, change**2 / variance) for each, change in ranked),
        contributions=_contributions(causes, changes),
        clipped=drawn.clipped,
        failed=int(np.sum(np.isnan(delta).any(axis=1))),
        texture=_texture_spreads(
            material, quantities, seed, off, {c.name: m for c, (_, m) in zip(causes, moves, strict=True)}
        ),
    )


def _quantities(
    material: Material, texture: Mapping[str | TextureQuantity, float], light: tuple[str, str]
) -> dict[TextureQuantity, float]:
    """Return texture quantities and their limits.

    Raises:
        RecipeError: a quantity is not known, or of another instrument; or the material lacks texture.
    """
    limits = {}
    for name, limit in texture.items():
        each = TextureQuantity.named(name, "texture", light=light) if isinstance(name, str) else name
        if each in limits:
            raise RecipeError(f'texture: "{each}" occurs twice')
        if not 0 < limit < np.inf:
            raise RecipeError(f'texture: "{each}" = {limit:g} is not a limit in per cent; allowed: above 0')
        limits[each] = float(limit)
    if any((each.instrument or Instrument()) != (next(iter(limits)).instrument or Instrument()) for each in limits):
        raise RecipeError("texture: the quantities are of several instruments; allowed: one")
    if limits:
        check_texture(material, f'texture: "{next(iter(limits))}"')
    return limits


def _texture_spreads(
    material: Material, quantities: Mapping[TextureQuantity, float], seed: int, off: Array, moves: Mapping[str, Array]
) -> tuple[TextureSpread, ...]:
    values = texture_values(material, list(quantities), seed)[0]
    return tuple(
        TextureSpread(str(each), float(values[i]), off[:, i], limit, {name: float(m[i]) for name, m in moves.items()})
        for i, (each, limit) in enumerate(quantities.items())
    )


def _contributions(causes: Sequence[Component], changes: Sequence[float]) -> tuple[tuple[str, float, float], ...]:
    """Return the root of the summed variances of each source, and its share, largest first."""
    variances: dict[str, float] = {}
    for cause, change in zip(causes, changes, strict=True):
        variances[cause.source] = variances.get(cause.source, 0.0) + change**2
    total = sum(variances.values()) or 1.0
    contributions = [(source, float(np.sqrt(variance)), variance / total) for source, variance in variances.items()]
    return tuple(sorted(contributions, key=lambda each: -each[1]))


@dataclass(frozen=True)
class _Trials:
    """Measures materials whose numbers at `paths` are replaced by drawn values."""

    material: Material
    paths: tuple[str, ...]
    measure: _Probe

    @cached_property
    def make(self) -> Callable[[Mapping[str, Any]], Material]:
        """Function from values to materials, compiled once in each process."""
        return tied_maker(self.material, self.paths)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle without the compiled function."""
        return _Trials, (self.material, self.paths, self.measure)


def _measure_draw(trials: _Trials, values: Array) -> Array | None:
    """Return the numbers of one draw; None if it cannot be computed. Runs in a worker."""
    try:
        return trials.measure(trials.make(dict(zip(trials.paths, map(float, values), strict=True))))
    except NacreError:
        return None


class ColourProbe:
    """Measures CIELAB at fixed geometries.

    Default: the standard aspecular angles if the material scatters, in the mirror direction otherwise.
    """

    def __init__(
        self,
        material: Material,
        illuminant: str,
        observer: str,
        samples: int | None,
        seed: int,
        geometries: Mapping[str, Geometry] | None = None,
    ) -> None:
        self._options = (illuminant, observer, samples, seed)
        if geometries:
            self.geometry, self.labels, self._at = "geometries", tuple(geometries), list(geometries.values())
            self.angles_deg = tuple(at.view_deg if at.kind == "aspecular" else at.theta_deg for at in self._at)
            return
        scatters = self._scatters(material)
        self.geometry = "aspecular, 45 degree incidence" if scatters else "mirror direction"
        self.angles_deg = tuple(ASPECULAR_DEG if scatters else SPECULAR_ANGLES_DEG)
        self._at = [
            Geometry("aspecular", LIGHT_DEG, a) if scatters else Geometry("specular", a) for a in self.angles_deg
        ]
        self.labels = tuple(map(str, self._at))

    def _scatters(self, material: Material) -> bool:
        model = material.model
        if isinstance(model, Diffracting):  # their orders may all miss the geometries
            at = [Geometry("aspecular", LIGHT_DEG, angle) for angle in ASPECULAR_DEG]
            is_lit = model.scatters_orders(model.wavelengths_nm)
            return is_lit and bool(np.any(geometry_colours(material, at, *self._options)[:, 0] > 0.0))
        wi = np.broadcast_to(direction(np.radians(LIGHT_DEG)), (1, 3))
        few = material.values_at(wi, wi, np.array([550.0]))  # cheap for materials that scatter
        return few is not None or any(not lobe.is_delta for lobe in material.bsdf().lobes)

    def __call__(self, material: Material) -> Array:
        """Return CIELAB, `[geometry, 3]`."""
        return geometry_colours(material, self._at, *self._options)


@dataclass(frozen=True)
class _Probe:
    """Measures colours and texture as one row of numbers."""

    colour: ColourProbe
    texture: tuple[TextureQuantity, ...]
    seed: int

    @property
    def size(self) -> int:
        """Length of a row."""
        return 3 * len(self.colour.labels) + len(self.texture)

    def __call__(self, material: Material) -> Array:
        """Return CIELAB of all geometries, then the quantities in the accuracy of a search."""
        numbers = texture_values(material, self.texture, self.seed, "search")[0]
        return np.concatenate([np.ravel(self.colour(material)), numbers])

    def parts(self, rows: Array) -> tuple[Array, Array]:
        """Return colours `[..., geometry, 3]` and texture `[..., quantity]` of rows."""
        count = len(self.colour.labels)
        return rows[..., : 3 * count].reshape(*rows.shape[:-1], count, 3), rows[..., 3 * count :]


def _sensitivity(
    trials: _Trials, numbers: Mapping[str, float], cause: Component, nominal: Array, sought: Array
) -> tuple[float, Array]:
    """Return changes per standard deviation, from a central difference and the curvature.

    For y = a x + c x^2 and normal x, the variance is a^2 + 2 c^2: an axis at a symmetric angle has a = 0.

    Returns:
        dE00 at the worst angle, and the signed slopes of texture `[quantity]` in per cent.
    """
    low, high = cause.values(-SENSITIVITY_STEP), cause.values(SENSITIVITY_STEP)
    if low == high:
        return 0.0, np.zeros(len(sought))
    # a number that ends at 0 moves by less than the full step
    step = min((high[t.path] - low[t.path]) / t.standard_deviation for t in cause.tolerances if t.deviation != 0)
    measure = trials.measure
    (below, fewer), (above, more) = (
        measure.parts(measure(trials.make({**numbers, **values}))) for values in (low, high)
    )
    changes = [delta_e_2000(nominal, nominal + (above - below) / step)]
    if np.isclose(step, 2 * SENSITIVITY_STEP):
        bend = (above + below - 2 * nominal) / (2 * SENSITIVITY_STEP**2)
        changes.append(delta_e_2000(nominal, nominal + np.sqrt(2.0) * bend))
    return float(np.max(np.linalg.norm(changes, axis=0))), 100.0 * (more - fewer) / step / sought


def tolerance_document(result: ToleranceResult, tolerances: tuple[Tolerance, ...]) -> dict[str, Any]:
    """Return the result as JSON data: statistics per angle, yield, sensitivities."""
    lab = result.lab[~np.isnan(result.lab).any(axis=(1, 2))]
    delta = result.delta_e[~np.isnan(result.delta_e).any(axis=1)]
    percentiles = np.percentile(delta, [50, 95], axis=0) if len(delta) else np.zeros((2, len(result.angles_deg)))
    return {
        "geometry": result.geometry,
        "geometries": list(result.labels),
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
        "share_clipped_at_0": result.clipped,
        "sensitivities": [
            {"path": path, "delta_e_of_one_deviation": change, "share_of_variance": share}
            for path, change, share in result.sensitivities
        ],
        "contributions": [
            {"source": source, "delta_e_of_one_deviation": change, "share_of_variance": share}
            for source, change, share in result.contributions
        ],
        "texture": [_texture_document(each) for each in result.texture],
        "tolerances": [each.__dict__ for each in tolerances],
    }


def _texture_document(spread: TextureSpread) -> dict[str, Any]:
    off = spread.off_percent[~np.isnan(spread.off_percent)]
    has_any = len(off) > 0
    return {
        "quantity": spread.quantity,
        "nominal": spread.nominal,
        "mean_off_percent": float(off.mean()) if has_any else None,
        "deviation_percent": float(off.std()) if has_any else None,
        "off_percent_95": float(np.percentile(np.abs(off), 95)) if has_any else None,
        "limit_percent": spread.limit_percent,
        "within_limit": float(np.mean(np.abs(np.nan_to_num(spread.off_percent, nan=np.inf)) <= spread.limit_percent)),
        "percent_of_one_deviation": spread.sensitivities,
    }
