"""Choose pigments, a dye and their concentrations for measured colours of an effect paint.

The library of pigments and dyes and the paint to match are files. All combinations of the library's ingredients are
refined on a two-stream model of the paint; the best ones are corrected by the doubling method at their own point and
refined again until they converge (space mapping: Bandler et al., IEEE Trans. Microwave Theory Tech. 42, 2536 (1994)).
After the first stage texture is a product of powers of the volume fractions about each refinement's start.
Solutions are evaluated by a random walk.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.core.errors import NacreError, RecipeError, UnsupportedError
from nacre.core.files import check_room, check_writable, output_folder, read_text, write_text
from nacre.core.jit import clock
from nacre.families.contract import Surrogate, surrogate_radiance
from nacre.light import spectrum_to_xyz
from nacre.material.material import Material, material
from nacre.measure.colours import WALK_NM
from nacre.measure.geometry import Geometry, aspecular_pairs, named_geometries
from nacre.measure.texture import Fidelity, TextureQuantity, texture_values
from nacre.optimise.checkpoint import Checkpointer, DesignFolder, unreadable
from nacre.optimise.evaluation import geometries_of
from nacre.optimise.measurement import with_lines
from nacre.optimise.merit import MeritFunction
from nacre.optimise.methods.least_squares import minimise_residuals, sobol_points
from nacre.optimise.methods.surrogate import Correction
from nacre.optimise.problem import Budget, BudgetExhausted, Changes, Result, Search
from nacre.optimise.solutions import NEED_BYTES, RECIPE, clear_solutions, folder_of, write_recipe
from nacre.optimise.spec import (
    MOST_ANSWERS,
    DyeSpec,
    FormulationSpec,
    LibrarySpec,
    PigmentSpec,
)
from nacre.optimise.targets import Target, merit_function, read_targets
from nacre.optimise.task import read_data
from nacre.recipe.fingerprint import fingerprint
from nacre.recipe.model import LENGTH_UNITS_NM, RecipeContext, validate
from nacre.recipe.toml import parse_toml

LEAST = 1e-4  # fraction of the upper bound: a recipe needs a volume fraction above 0
STARTS = 2  # per combination
SCOUT_STEPS, COARSE_STEPS, FINE_STEPS = 7, 25, 12  # least-squares steps
SECOND = 10  # combinations refined on the two-stream model, for each solution
CORRECTIONS, REST = 6, 2e-3  # largest number of space-mapping steps; a smaller move ends them
FINALISTS = 4  # for each solution
GOOD_RMS, EDGE, POLISH_STEPS = 0.1, 0.05, 15  # final least squares: stop rms, distance from bounds, steps
WALKS = 1 << 16
BLACK, WHITE = 0.0, 0.8  # albedo of the contrast ratio's bases; ISO 6504-3 asks for at least 0.8 of the white
HIDING = Geometry("aspecular", 45.0, 45.0)  # 45/0
ADDITION_COST = 0.05  # residual, in tolerances, of an addition of the batch's own volume
MOST_ADDED = 1.0  # maximum addition of resin or an ingredient, relative to its volume in the batch
STAGE_SHARES = (0.35, 0.5, 0.7, 0.85)  # fraction of the time limit and the evaluations at the end of each stage
STATE_KEYS = ("stage", "ingredients", "start", "rms", "point")
MOST_COMBINATIONS = 5000
COLOUR_NOISE = 0.2  # noise of measured L*, a* and b*: repeatability of a good spectrophotometer
RELATIVE_STEP = 0.02  # relative step of a volume fraction for derivatives
LEAST_TEXTURE, TEXTURE_STEP = 1e-9, 0.05  # relative volume fraction step for texture derivatives
SUMMARY = "formulation.json"
STARTED = "started"  # status while solutions are written, so that a killed run does not block the next


TextureModel = Callable[[Sequence[float] | Array], Array]


@dataclass(frozen=True)
class Ingredient:
    """A pigment or a dye in a paint.

    Attributes:
        entry: library entry.
        path: recipe path of its volume fraction.
    """

    entry: PigmentSpec | DyeSpec
    path: str

    def fraction(self, unit: float) -> float:
        """Return the volume fraction of a coordinate in [0, 1]."""
        low, high = self.entry.volume_fraction
        return float(max(low + (high - low) * unit, LEAST * high))

    def unit(self, fraction: float) -> float:
        """Return the coordinate of a volume fraction."""
        low, high = self.entry.volume_fraction
        return float(np.clip((fraction - low) / (high - low), 0.0, 1.0))


@dataclass(frozen=True)
class Formula:
    """One formulation.

    Attributes:
        material: the paint's recipe.
        amounts: ingredient -> volume fraction of the dry stratum.
        amount_errors: its standard error for colours measured within `COLOUR_NOISE`; large if the paint hides its
            base, because the colours then fix the ratios only.
        mass_shares: ingredient -> share of the mass of the dry paint.
        cost_per_kg, cost_per_m2: cost of the dry stratum, in the library's currency.
        de00: `[geometry]`, by the random walk; for a spectrum the rms in per cent.
        lab: `[geometry, 3]` under the first lamp.
        texture: quantity of a target -> number and its deviation from the target in per cent.
        contrast_ratio: luminance at 45/0 over black, relative to that over white of albedo 0.8.
        is_met: whether every target is within its tolerance.
        distance: mean of weight x distance / tolerance over the targets.
    """

    material: Material
    amounts: dict[str, float]
    mass_shares: dict[str, float]
    cost_per_kg: float
    cost_per_m2: float
    de00: Array
    lab: Array
    contrast_ratio: float
    is_met: bool
    amount_errors: dict[str, float] = field(default_factory=dict)
    texture: dict[str, tuple[float, float]] = field(default_factory=dict)
    distance: float = 0.0


@dataclass(frozen=True)
class Formulation:
    """Result of `formulate`.

    Attributes:
        formulas: solutions with different ingredients, nearest first.
        labels: `[geometry]`.
        combinations: number of combinations that were searched.
        status: "done", "time" or "interrupted".
        seconds: used.
    """

    formulas: tuple[Formula, ...]
    labels: tuple[str, ...]
    combinations: int
    status: str
    seconds: float


@dataclass(frozen=True)
class Rematch:
    """Additions that correct a batch.

    Attributes:
        batch: ingredient -> volume fraction, estimated from the batch's colours.
        additions: ingredient or "resin" -> volume to add, per volume of the batch (dry).
        amounts: volume fractions after the additions.
        cost_per_kg_of_batch: cost of the additions.
        de00_before, de00_after: `[geometry]`, by the noise-free model.
    """

    batch: dict[str, float]
    additions: dict[str, float]
    amounts: dict[str, float]
    cost_per_kg_of_batch: float
    de00_before: Array
    de00_after: Array


@dataclass(frozen=True, eq=False)
class Task:
    """A checked target file."""

    spec: FormulationSpec
    library: LibrarySpec
    context: RecipeContext
    folder: Path
    targets: tuple[Target, ...]
    geometries: tuple[Geometry, ...]
    merit: MeritFunction
    start: Material
    files: Mapping[str, str]  # name -> digest, for all files that the target names

    @property
    def fingerprint(self) -> str:
        """Hash of everything that defines the task, without the time limit."""
        data = self.spec.model_dump(exclude={"search": {"seconds"}})
        library = self.library.model_dump()
        return fingerprint(data, dict(self.files), library=library, material=self.start.fingerprint)

    def budget(self) -> Budget:
        """Return the search's budget, which begins now."""
        return Budget(self.spec.search.evaluations or np.inf, self.spec.search.seconds)

    @property
    def thickness_um(self) -> float:
        """Thickness of the stratum."""
        stratum = self.start.data["strata"][0]
        key = next(key for key in stratum if key.startswith("thickness_"))
        return float(stratum[key]) * LENGTH_UNITS_NM[key.rpartition("_")[2]] / 1e3

    @property
    def quantities(self) -> tuple[TextureQuantity, ...]:
        """Texture targets, the last geometries."""
        return tuple(at for at in self.geometries if isinstance(at, TextureQuantity))

    @property
    def colour_geometries(self) -> tuple[Geometry, ...]:
        """Geometries with a colour or a spectrum."""
        return self.geometries[: len(self.geometries) - len(self.quantities)]

    @property
    def is_colour(self) -> NDArray[np.bool_]:
        """`[term]` of the merit function: whether it is of a colour or a spectrum."""
        return np.array([self.merit.operands[index].kind != "texture" for index, _ in self.merit.terms], dtype=bool)

    def with_colours(self, labs: Mapping[str, Array]) -> Task:
        """Return the task with other colours at its geometries, by label, and without texture.

        Raises:
            NacreError: a geometry of the task lacks a colour.
        """
        targets = []
        for target, label in zip(self.targets, self.labels):  # texture comes last
            lab = labs.get(label, labs.get(str(target.geometry)))
            if lab is None:
                raise NacreError(f'the batch has no colour at "{label}"; it has {", ".join(labs)}')
            targets.append(target.with_lab(lab))
        return self.with_targets(targets)

    def with_targets(self, targets: Sequence[Target]) -> Task:
        """Return the task with other targets."""
        rows = tuple(geometries_of(targets))
        merit = merit_function(targets, rows, self.spec.light, self.merit.wavelengths_nm)
        return replace(self, targets=tuple(targets), geometries=rows, merit=merit)

    def rms(self, factors: Array) -> float:
        """Return the rms of the residuals, in tolerances."""
        return float(np.sqrt(np.mean(np.asarray(self.merit.residuals(factors)) ** 2)))

    @property
    def labels(self) -> tuple[str, ...]:
        """Geometry of each colour target as the file names it."""
        return tuple(str(entry.geometry) for entry in self.spec.target if entry.quantity is None)


def read_formulation(target: str | Path | Mapping[str, Any]) -> Task:
    """Read and check a target file and its library.

    Raises:
        RecipeError: naming file, key, value and the allowed values.
    """
    data, context = read_data(target)
    spec: FormulationSpec = validate(FormulationSpec, data, context)
    source = context.source
    folder, library = context.folder, spec.library
    if isinstance(library, str):
        path = context.path(library)
        text = read_text(path, "library")
        folder = path.parent.resolve()
        library = validate(LibrarySpec, parse_toml(text, str(path)), RecipeContext(str(path), folder, text))
    assert isinstance(library, LibrarySpec)
    strata = spec.recipe.get("strata")
    if spec.recipe.get("family") != "pearl" or not isinstance(strata, list) or len(strata) != 1:
        raise RecipeError(f'{source}: recipe should be of family "pearl" with one stratum')
    for key in ("platelets", "dye"):
        if isinstance(strata[0], Mapping) and strata[0].get(key):
            raise RecipeError(f"{source}: recipe.strata[0].{key}: pigments and dyes come from the library; remove it")
    try:
        start = material(spec.recipe, folder)
    except NacreError as error:
        raise RecipeError(f"{source}: recipe: {str(error).removeprefix('recipe: ')}") from None
    named = named_geometries([entry.model_dump() for entry in spec.geometry], f"{source}: geometry")
    targets = read_targets(spec.target, spec.light, context, named, spec.instrument)
    targets = tuple(sorted(targets, key=lambda each: each.texture is not None))
    if targets[0].texture is not None:
        raise RecipeError(f"{source}: target: a formulation needs at least one colour, at a geometry such as 45as15")
    for each in targets:
        if each.texture is not None:
            continue
        if each.geometry.kind != "aspecular" or each.image is not None:
            raise RecipeError(f'{each.key}.geometry = "{each.geometry}" is not aspecular; write such as "45as15"')
    geometries = tuple(geometries_of(targets))
    merit = merit_function(targets, geometries, spec.light, with_lines(WALK_NM, spec.light.illuminants))
    task = Task(spec, library, context, folder, targets, geometries, merit, start, {})
    optics = [(each.name, each.platelet) for each in library.pigment] + [(each.name, each.dye) for each in library.dye]
    for name, table in optics:
        if "volume_fraction" in table:
            raise RecipeError(
                f'{source}: library: "{name}": the search chooses volume_fraction within the bounds of the '
                "ingredient; remove it from the optics"
            )
    for dye in library.dye:
        if "radius_nm" in dye.dye:
            raise RecipeError(
                f'{source}: library: dye "{dye.name}" scatters (radius_nm); only dissolved dyes are possible'
            )
    files = {**context.files, **start.context.files}
    paints = [_paint(task, [each], None) for each in library.pigment] + [_paint(task, [], d) for d in library.dye]
    for paint in paints:
        files |= paint.material.context.files
    return replace(task, files=files)


def _paint(task: Task, pigments: Sequence[PigmentSpec], dye: DyeSpec | None) -> _Paint:
    """Return a paint of some ingredients.

    Raises:
        RecipeError: an ingredient is not valid.
        UnsupportedError: the paint lacks a noise-free model.
    """
    data = {**task.start.data, "strata": [dict(task.start.data["strata"][0])]}
    stratum = data["strata"][0]
    ingredients = []
    for pigment in pigments if task.quantities else ():
        if "diameter_um" not in pigment.platelet:
            raise RecipeError(
                f'{task.context.source}: library: "{pigment.name}": diameter_um is missing; texture targets need it'
            )
    if pigments:
        stratum["platelets"] = [
            p.platelet | {"volume_fraction": p.volume_fraction[1] / len(pigments)} for p in pigments
        ]
        ingredients += [Ingredient(p, f"strata[0].platelets[{i}].volume_fraction") for i, p in enumerate(pigments)]
    if dye is not None:
        stratum["dye"] = dye.dye | {"volume_fraction": dye.volume_fraction[1]}
        ingredients.append(Ingredient(dye, "strata[0].dye.volume_fraction"))
    try:
        made = material(data, task.folder)
    except NacreError as error:
        names = ", ".join(f'"{each.entry.name}"' for each in ingredients)
        raise RecipeError(f"{task.context.source}: library: {names}: {str(error).removeprefix('recipe: ')}") from None
    return _Paint(task, made, tuple(ingredients))


@dataclass(frozen=True, eq=False)
class _Paint:
    """A paint of given ingredients; a point holds their coordinates in [0, 1]."""

    task: Task
    material: Material
    ingredients: tuple[Ingredient, ...]
    make: Callable[[Mapping[str, Any]], Material] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "make", self.material.parametrise([each.path for each in self.ingredients]))

    def made(self, fractions: Sequence[float] | Array) -> Material:
        """Return the recipe with these volume fractions."""
        return self.make({each.path: float(f) for each, f in zip(self.ingredients, fractions, strict=True)})

    def amounts(self, point: Array) -> dict[str, float]:
        """Return a point's volume fractions by ingredient."""
        names = (each.entry.name for each in self.ingredients)
        return dict(zip(names, self.fractions(point), strict=True))

    def fractions(self, point: Array) -> list[float]:
        """Return a point's volume fractions."""
        return [each.fraction(float(unit)) for each, unit in zip(self.ingredients, point, strict=True)]

    def factors(
        self, fractions: Sequence[float] | Array, is_fine: bool, texture: TextureModel | None = None
    ) -> tuple[Array, Array]:
        """Return the exact and approximate part of the factors, `[geometry, wavelength]` each.

        Args:
            texture: in place of the exact numbers of texture; the rows are 0 without it unless `is_fine`.

        Raises:
            UnsupportedError: the paint lacks a noise-free model.
        """
        made = self.made(fractions)
        grid = self.task.merit.wavelengths_nm
        radiance = surrogate_radiance(made.model, *aspecular_pairs(self.task.colour_geometries), grid, is_fine)
        if radiance is None:
            raise UnsupportedError(
                f"{self.task.context.source}: recipe: this paint has no noise-free model, which a formulation needs: "
                "an isotropic GGX or smooth interface and flakes without rotation and anisotropy"
            )
        exact, rest = (np.zeros((len(self.task.geometries), len(grid))) for _ in radiance)
        count = len(self.task.colour_geometries)
        exact[:count], rest[:count] = np.pi * radiance[0], np.pi * radiance[1]
        if self.task.quantities and (texture or is_fine):
            exact[count:] = (texture(fractions) if texture else self.texture(made, "search"))[:, None]
        return exact, rest

    def texture(self, made: Material, fidelity: Fidelity) -> Array:
        """Return the numbers of texture `[quantity]`; 0 without flakes."""
        if not made.data["strata"][0].get("platelets"):
            return np.zeros(len(self.task.quantities))
        return texture_values(made, self.task.quantities, fidelity=fidelity)[0]

    def texture_model(self, at: Array) -> TextureModel | None:
        """Return a power-law model of texture values `[quantity]` in the volume fractions about a point."""
        if not self.task.quantities:
            return None
        centre = np.array(self.fractions(at))
        value = self.texture(self.made(centre), "search")
        steps = centre * (1.0 + TEXTURE_STEP * np.vstack([np.zeros(len(centre)), np.eye(len(centre))]))
        logs = np.log(np.maximum([self.texture(self.made(each), "scout") for each in steps], LEAST_TEXTURE))
        powers = (logs[1:] - logs[0]) / np.log1p(TEXTURE_STEP)

        def by_powers(fractions: Sequence[float] | Array) -> Array:
            change: Array = np.log(np.asarray(fractions) / centre) @ powers
            return np.asarray(value * np.exp(np.clip(change, -3.0, 3.0)))

        return by_powers

    def fit(self, start: Array, correction: Correction | None, steps: int) -> tuple[float, Array]:
        """Return the rms distance in tolerances and the point of the nearest match of the two-stream model."""

        texture = self.texture_model(start) if steps > SCOUT_STEPS else lambda fractions: self.ends

        def residuals(point: Array) -> Array:
            exact, rest = self.factors(self.fractions(point), False, texture)
            factors = exact + rest if correction is None else correction.apply(exact, rest)
            return np.asarray(self.task.merit.residuals(factors))

        minimum = minimise_residuals(residuals, start, max_nfev=steps)
        return float(np.sqrt(np.mean(residuals(minimum.point) ** 2))), minimum.point

    @property
    def ends(self) -> Array:
        """Numbers of texture that meet their targets, `[quantity]`."""
        ends = [target.texture for target in self.task.targets if target.texture is not None]
        return np.array([high if low is None else low for low, high in ends], dtype=float)

    def polished(self, start: Array) -> tuple[float, Array]:
        """Return rms distance and point by space mapping, then by least squares of the doubling method if far."""
        rms, point = self.corrected(start)
        if rms < GOOD_RMS:
            return rms, point

        texture = self.texture_model(point)

        def residuals(at: Array) -> Array:
            exact, rest = self.factors(self.fractions(at), True, texture)
            return np.asarray(self.task.merit.residuals(exact + rest))

        inside = np.clip(point, EDGE, 1.0 - EDGE)  # an ingredient at a bound may come back
        minimum = minimise_residuals(residuals, inside, max_nfev=POLISH_STEPS)
        polished = float(np.sqrt(np.mean(residuals(minimum.point) ** 2)))
        return min((rms, point), (polished, minimum.point), key=lambda pair: pair[0])

    def corrected(self, start: Array, steps: int = CORRECTIONS) -> tuple[float, Array]:
        """Return the rms distance of the doubling method, in tolerances, and its point, by steps of space mapping."""
        best, best_point, point = np.inf, start, start
        for _ in range(steps):
            fractions = self.fractions(point)
            exact, rest = self.factors(fractions, True)
            rms = self.task.rms(exact + rest)
            if rms < best:
                best, best_point = rms, point
            correction = Correction(rest, self.factors(fractions, False)[1])
            moved = self.fit(point, correction, FINE_STEPS)[1]
            if float(np.max(np.abs(moved - point))) < REST:
                break
            point = moved
        return best, best_point


def formulate(
    target: str | Path | Mapping[str, Any] | Task,
    out: str | Path | None = None,
    progress: Callable[[int, int, float], None] | None = None,
    resume: bool = False,
) -> Formulation:
    """Match measured colours of an effect paint with pigments and a dye from a library.

    An interrupt ends the search; the combinations evaluated so far give the solutions.

    Args:
        target: a TOML file as in `FormulationSpec`, a dictionary of its keys, or the result of `read_formulation`.
        out: folder for the recipes, `formulation.json` and the search state; default: nothing is written.
        progress: called with (combinations done, all, best rms distance in tolerances) in each stage.
        resume: continue a stopped search of the same target in `out`.

    Raises:
        RecipeError: the file or its library is not valid, or `out` holds another target's search.
        UnsupportedError: the paint lacks a noise-free model.
        NacreError: the folder cannot be written, or its search state cannot be read.
    """
    if out is not None:
        check_answers(Path(out))
    task = target if isinstance(target, Task) else read_formulation(target)
    search = PaintSearch(task, progress)
    if out is None:
        return search.answers(search.run(task.budget()))
    checkpointer = Checkpointer.open(Path(out), task.fingerprint, resume)
    with output_folder(out):
        return FormulationFolder(task, search, checkpointer).design(task.context.source)


Candidate = tuple[float, "_Paint", Array]  # rms distance in tolerances, paint, point
Refinement = Callable[["_Paint", Array], tuple[float, Array]]


class PaintSearch(Search):
    """Successive refinement: every combination, the better ones, and the finalists by the doubling method.

    An evaluation is one refined combination.

    Attributes:
        combinations: number of combinations that were searched.
        finalists: candidates of the last stage with any, best first.
    """

    default_evaluations = np.inf
    is_met = False  # the stages end the search

    def __init__(self, task: Task, progress: Callable[[int, int, float], None] | None) -> None:
        super().__init__(task.spec.search.solutions)
        self.task, self.progress = task, progress
        self.combinations, self.finalists = 0, list[Candidate]()
        self._refined: dict[tuple[Any, ...], tuple[float, Array]] = {}  # stage, ingredients, start -> rms, point

    def state(self, solutions: Sequence[Changes]) -> tuple[Sequence[Changes], dict[str, Any]]:
        """Return all refinements, which `restore` reads."""
        rows = [[*key, rms, point.tolist()] for key, (rms, point) in self._refined.items()]
        return [dict(zip(STATE_KEYS, row, strict=True)) for row in rows], {}

    def restore(self, checkpointer: Checkpointer) -> None:
        """Restore the refinements from a checkpoint.

        Raises:
            NacreError: it is damaged.
        """
        try:
            for one in checkpointer.solutions:
                stage, names, start, rms, point = (one[key] for key in STATE_KEYS)
                refined = float(rms), np.array(point, dtype=float)
                if len(refined[1]) != len(names) or not np.isfinite([refined[0], *refined[1]]).all():
                    raise ValueError
                self._refined[stage, tuple(names), tuple(start)] = refined
        except (KeyError, TypeError, ValueError):
            raise unreadable(checkpointer.folder) from None

    def solutions(self) -> list[tuple[float, Changes]]:
        """Return the volume fractions of the best candidates."""
        return [(rms, paint.amounts(point)) for rms, paint, point in self.finalists[: self.solution_count]]

    def answers(self, result: Result) -> Formulation:
        """Evaluate the finalists by a random walk.

        Raises:
            KeyboardInterrupt: before there was a candidate.
        """
        if not self.finalists:
            raise KeyboardInterrupt
        formulas = [_formula(paint, paint.fractions(at)) for _, paint, at in self.finalists[: self.solution_count]]
        ranked = tuple(sorted(formulas, key=lambda each: each.distance))
        status = "done" if result.status == "exhausted" else result.status
        seconds = clock() - self.budget.start_time
        return Formulation(ranked, self.task.labels, self.combinations, status, seconds)

    def _search(self, known: Sequence[Mapping[str, Any]]) -> None:
        most = self.solution_count
        chosen = _combinations(self.task)
        scouted = ((_paint(self.task, *one), np.array([float(number)])) for number, one in enumerate(chosen))
        is_complete = self._stage(0, scouted, len(chosen), self._scout)
        refinements: tuple[tuple[int, Refinement], ...] = (
            (SECOND * most, lambda paint, start: paint.fit(start, None, COARSE_STEPS)),
            (FINALISTS * most, lambda paint, start: paint.corrected(start, 2)),
            (2 * most, lambda paint, start: paint.polished(start)),
        )
        for stage, (count, refine) in enumerate(refinements, start=1):
            better = [(paint, point) for _, paint, point in self.finalists[:count]]
            is_complete &= self._stage(stage, better, len(better), refine)
        if not is_complete:
            raise BudgetExhausted

    def _scout(self, paint: _Paint, number: Array) -> tuple[float, Array]:
        starts = sobol_points(len(paint.ingredients), STARTS, [self.task.spec.search.seed, int(number[0])])
        rms, point = min((paint.fit(start, None, SCOUT_STEPS) for start in starts), key=lambda pair: pair[0])
        if self.task.quantities:  # ranks paints that differ in their texture only
            made = paint.made(paint.fractions(point))
            exact, rest = paint.factors(paint.fractions(point), False, lambda _: paint.texture(made, "scout"))
            rms = self.task.rms(exact + rest)
        return rms, point

    def _stage(self, stage: int, entries: Iterable[tuple[_Paint, Array]], count: int, refine: Refinement) -> bool:
        """Refine paints from their starts within the stage's share of the budget; return whether all were refined."""
        share, least = STAGE_SHARES[stage], self.solution_count if stage else 1
        end_time = self.budget.start_time + share * self.budget.seconds
        refined: list[Candidate] = []
        for paint, start in entries:
            if len(refined) >= least and self.budget.is_over(share * self.budget.evaluations, end_time):
                return False
            key = (stage, tuple(each.entry.name for each in paint.ingredients), tuple(start.tolist()))
            if key not in self._refined:
                self._refined[key] = refine(paint, start)
            self.budget.used += 1  # cached refinements count too: equal budgets then give equal solutions
            rms, point = self._refined[key]
            refined.append((rms, paint, point))
            self.finalists = sorted(refined, key=lambda each: each[0])
            self.combinations += stage == 0
            self.best, best, point = self.finalists[0]
            self.best_changes = best.amounts(point)
            self.report()
            if self.progress:
                self.progress(len(refined), count, self.best)
        return True


class FormulationFolder(DesignFolder[Formulation]):
    """A running formulation; its folder contains the best paint so far."""

    search: PaintSearch

    def __init__(self, task: Task, search: PaintSearch, checkpointer: Checkpointer) -> None:
        super().__init__(checkpointer, clock(), task.spec.search.seconds, None, None)
        self.task, self.search = task, search
        search.restore(checkpointer)

    def budget(self) -> Budget:
        """Return the search budget."""
        return self.task.budget()

    def claim(self) -> None:
        """Mark the folder's formulation as incomplete."""
        _mark(self.folder)

    def write_best(self, worst: float, changes: Changes) -> dict[str, Any]:
        """Write the best paint."""
        _, paint, point = self.search.finalists[0]
        made = paint.made(paint.fractions(point))
        return {"files": write_recipe(self.folder, made, {}, {}, made)[1]}

    def write_running(self, part: dict[str, Any]) -> None:
        """Leave the summary as `claim` wrote it."""

    def finish(self, result: Result) -> Formulation:
        """Evaluate the finalists and write them."""
        formulation = self.search.answers(result)
        write_formulation(formulation, self.folder)
        return formulation


def _combinations(task: Task) -> list[tuple[tuple[PigmentSpec, ...], DyeSpec | None]]:
    """Return all sets of pigments with and without a dye."""
    most = min(task.spec.search.max_pigments, len(task.library.pigment))
    sets = [
        (chosen, dye)
        for count in range(most, -1, -1)
        for chosen in combinations(task.library.pigment, count)
        for dye in (None, *task.library.dye)
        if chosen or dye is not None
    ]
    if not sets:
        raise RecipeError(f"{task.context.source}: search.max_pigments = 0, and the library has no dye")
    if len(sets) > MOST_COMBINATIONS:
        raise RecipeError(
            f"{task.context.source}: the library gives {len(sets)} combinations; at most {MOST_COMBINATIONS} are "
            "allowed: shorten it or lower search.max_pigments"
        )
    return sets


def _formula(paint: _Paint, fractions: Sequence[float]) -> Formula:
    """Evaluate a solution by a random walk, with its cost and its hiding power."""
    task = paint.task
    made = paint.made(fractions)
    merit = task.merit
    numbers = paint.texture(made, "final") if task.quantities else np.zeros(0)
    rows = np.broadcast_to(numbers[:, None], (len(numbers), len(merit.wavelengths_nm)))
    power = np.concatenate([np.pi * _reference(made, task), rows])
    names = [each.entry.name for each in paint.ingredients]
    amounts = dict(zip(names, map(float, fractions), strict=True))
    resin = task.library.resin
    masses = {each.entry.name: amounts[each.entry.name] * each.entry.density_kg_l for each in paint.ingredients}
    masses["resin"] = (1.0 - sum(amounts.values())) * resin.density_kg_l
    density = sum(masses.values())
    shares = {name: mass / density for name, mass in masses.items()}
    prices = {each.entry.name: each.entry.cost_per_kg for each in paint.ingredients} | {"resin": resin.cost_per_kg}
    cost = sum(prices[name] * share for name, share in shares.items())
    distances = np.asarray(merit.distances(power))
    limits = np.array([merit.operands[index].tolerance for index, _ in merit.terms])
    return Formula(
        material=made,
        amounts=amounts,
        mass_shares=shares,
        cost_per_kg=cost,
        cost_per_m2=cost * density * task.thickness_um / 1e3,  # kg/l = kg/m2 for each mm
        de00=distances[task.is_colour],
        lab=np.asarray(merit.labs(power))[: len(task.colour_geometries), 0],
        contrast_ratio=_contrast_ratio(made, task),
        is_met=bool(np.all(distances <= limits)),
        distance=float(np.mean(distances * merit.scale)),
        amount_errors=dict(zip(names, map(float, _amount_errors(paint, fractions)), strict=True)),
        texture={
            str(at): (float(number), float(off))
            for at, number, off in zip(task.quantities, numbers, distances[~task.is_colour], strict=True)
        },
    )


def _amount_errors(paint: _Paint, fractions: Sequence[float]) -> Array:
    """Return the standard errors of the volume fractions `[ingredient]`, from the Fisher information of the colours.

    The prior is uniform within the bounds of the library.
    """

    def labs(at: Array) -> Array:
        factors = sum(paint.factors(at, True, lambda _: paint.ends))
        return np.ravel(paint.task.merit.labs(factors)[: len(paint.task.colour_geometries)])

    centre = np.asarray(fractions, dtype=float)
    steps = RELATIVE_STEP * centre
    columns = [(labs(centre + step) - labs(centre)) / step.sum() for step in np.diag(steps)]
    slopes = np.stack(columns, axis=1) / COLOUR_NOISE
    widths = np.array([high - low for low, high in (each.entry.volume_fraction for each in paint.ingredients)])
    information = slopes.T @ slopes + np.diag(12.0 / widths**2)
    return np.sqrt(np.diag(np.linalg.inv(information)))


def _reference(made: Material, task: Task) -> Array:
    """Return the BRDF `[geometry, wavelength]` by a random walk, or by the doubling method if there is none."""
    pairs, grid = aspecular_pairs(task.colour_geometries), task.merit.wavelengths_nm
    assert isinstance(made.model, Surrogate)  # checked in `factors`
    estimate = made.model.estimate_radiance(*pairs, grid, WALKS, task.spec.search.seed)
    if estimate is not None:
        return estimate[0]
    radiance = surrogate_radiance(made.model, *pairs, grid, True)
    assert radiance is not None
    return radiance[0] + radiance[1]


def _contrast_ratio(made: Material, task: Task) -> float:
    """Return the luminance over black divided by that over white, at 45/0."""
    light = (task.spec.light.illuminants[0], task.spec.light.observer)
    luminances = []
    for albedo in (BLACK, WHITE):
        radiance = surrogate_radiance(
            made.vary({"base": {"albedo": albedo}}).model, *aspecular_pairs([HIDING]), task.merit.wavelengths_nm, True
        )
        assert radiance is not None
        luminances.append(float(spectrum_to_xyz(radiance[0] + radiance[1], task.merit.wavelengths_nm, *light)[0, 1]))
    return luminances[0] / luminances[1]


def rematch(target: str | Path | Mapping[str, Any] | Task, amounts: Mapping[str, float], batch: Any) -> Rematch:
    """Correct a batch by small additions.

    The batch's volume fractions are fitted to its colours, starting at the intended ones. Additions of ingredients and
    resin are then optimised for the target colours, with a small penalty on their volume.

    Args:
        target: as for `formulate`.
        amounts: intended volume fractions by ingredient.
        batch: geometry -> measured CIELAB `[3]`.

    Raises:
        NacreError: an ingredient is not in the library, or a geometry lacks a colour.
    """
    task = target if isinstance(target, Task) else read_formulation(target)
    pigments = [entry for entry in task.library.pigment if entry.name in amounts]
    dyes = [entry for entry in task.library.dye if entry.name in amounts]
    names_known = [entry.name for entry in (*pigments, *dyes)]
    for name in amounts:
        if name not in names_known:
            raise NacreError(f'"{name}" is not in the library of {task.context.source}')
    if len(dyes) > 1 or not names_known:
        raise NacreError("a batch has at least one ingredient and at most one dye")
    dye = dyes[0] if dyes else None
    estimated = _paint(task.with_colours(batch), pigments, dye)
    start = np.array([each.unit(amounts[each.entry.name]) for each in estimated.ingredients])
    made = np.array(estimated.fractions(estimated.corrected(start)[1]))
    task = task.with_targets([each for each in task.targets if each.texture is None])
    paint = _paint(task, pigments, dye)
    exact, rest = paint.factors(made, True)
    before = np.asarray(task.merit.distances(exact + rest))

    def after(volumes: Array) -> Array:
        return np.asarray((made + volumes[1:]) / (1.0 + volumes.sum()))

    def added(unit: Array) -> Array:  # quadratic, for small additions; an ingredient at most doubles
        return np.asarray(MOST_ADDED * np.concatenate([[1.0], made]) * unit**2)

    unit = np.full(len(made) + 1, 0.1)
    best: tuple[float, Array] = (np.inf, unit)
    for _ in range(CORRECTIONS):
        at = after(added(unit))
        exact, rest = paint.factors(at, True)
        penalty = ADDITION_COST * unit
        loss = float(np.sum(np.asarray(task.merit.residuals(exact + rest)) ** 2) + penalty @ penalty)
        if loss < best[0]:
            best = (loss, unit)
        correction = Correction(rest, paint.factors(at, False)[1])

        def residuals(x: Array, correction: Correction = correction) -> Array:
            factors = correction.apply(*paint.factors(after(added(x)), False))
            return np.concatenate([np.asarray(task.merit.residuals(factors)), ADDITION_COST * x])

        moved = minimise_residuals(residuals, unit, max_nfev=COARSE_STEPS).point
        if float(np.max(np.abs(moved - unit))) < REST:
            break
        unit = moved
    volumes = added(best[1])
    names = [each.entry.name for each in paint.ingredients]
    exact, rest = paint.factors(after(volumes), True)
    resin = task.library.resin
    densities = [resin.density_kg_l, *(each.entry.density_kg_l for each in paint.ingredients)]
    prices = [resin.cost_per_kg, *(each.entry.cost_per_kg for each in paint.ingredients)]
    mass = (1.0 - made.sum()) * resin.density_kg_l + float(made @ np.array(densities[1:]))
    return Rematch(
        batch=dict(zip(names, map(float, made), strict=True)),
        additions=dict(zip(["resin", *names], map(float, volumes), strict=True)),
        amounts=dict(zip(names, map(float, after(volumes)), strict=True)),
        cost_per_kg_of_batch=float(np.sum(volumes * densities * np.array(prices))) / mass,
        de00_before=before,
        de00_after=np.asarray(task.merit.distances(exact + rest)),
    )


def formulation_document(formulation: Formulation) -> dict[str, Any]:
    """Return the result as JSON data."""
    return {
        "status": formulation.status,
        "seconds": round(formulation.seconds, 2),
        "combinations": formulation.combinations,
        "geometries": list(formulation.labels),
        "formulas": [
            {
                "volume_fractions": each.amounts,
                "volume_fraction_errors": each.amount_errors,
                "mass_shares": each.mass_shares,
                "cost_per_kg": each.cost_per_kg,
                "cost_per_m2": each.cost_per_m2,
                "de00": each.de00.tolist(),
                "mean_de00": float(np.mean(each.de00)),
                "lab": each.lab.tolist(),
                "texture": {name: {"value": v, "off_percent": off} for name, (v, off) in each.texture.items()},
                "contrast_ratio": each.contrast_ratio,
                "met": each.is_met,
            }
            for each in formulation.formulas
        ],
    }


def check_answers(folder: Path) -> None:
    """Check, before a search, that its solutions can be written to a folder.

    Raises:
        NacreError: the folder cannot be written, or holds a recipe that is not a formulation's.
    """
    if not os.path.lexists(folder):
        check_writable(folder)
    check_room(folder, NEED_BYTES)
    recipes = [folder_of(folder, number) / RECIPE for number in range(1, MOST_ANSWERS + 1)]
    foreign = next((path for path in recipes if os.path.lexists(path)), None)
    if foreign is not None and not (folder / SUMMARY).exists():
        raise NacreError(
            f"{folder}: holds a {foreign.relative_to(folder)} from another source; choose another folder with -o"
        )
    if folder.is_dir():
        check_writable(folder / SUMMARY)


def write_formulation(formulation: Formulation, folder: Path) -> None:
    """Write `formulation.json`, `recipe.toml` for the first solution, and `2/recipe.toml` and so on for the others.

    Other solutions from an earlier formulation in the folder are removed. Until all are written, `status` is "started".

    Raises:
        NacreError: the folder cannot be written or holds other files of these names.
    """
    check_answers(folder)
    document = formulation_document(formulation)
    folder.mkdir(parents=True, exist_ok=True)
    _mark(folder)
    for number, each in enumerate(formulation.formulas, start=1):
        names = write_recipe(folder_of(folder, number), each.material, {}, {}, each.material)[1]
        document["formulas"][number - 1]["files"] = names
    clear_solutions(folder, len(formulation.formulas), SUMMARY, "formulas")
    write_text(folder / SUMMARY, json.dumps(document, indent=1) + "\n")


def _mark(folder: Path) -> None:
    """Mark the summary of the earlier solutions as incomplete."""
    earlier: dict[str, Any] = {"formulas": []}
    with contextlib.suppress(OSError, ValueError, TypeError):
        earlier |= json.loads((folder / SUMMARY).read_text(encoding="utf-8"))
    if earlier.get("status") != STARTED:
        write_text(folder / SUMMARY, json.dumps({**earlier, "status": STARTED}) + "\n")
