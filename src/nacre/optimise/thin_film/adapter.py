"""Thin-film search of a design task: recipes as stack problems, and stacks as recipe changes."""

from __future__ import annotations

import contextlib
import re
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from nacre.bsdf.texture import Texture
from nacre.core.arrays import Array
from nacre.core.errors import RecipeError
from nacre.families.film.material import Film
from nacre.material.material import Material
from nacre.matter.indices.crystal import AnisotropicConstant
from nacre.matter.stack.solve import powers
from nacre.measure.geometry import Geometry
from nacre.optimise.evaluation import geometries_of
from nacre.optimise.merit import MeritFunction, default_wavelengths_nm
from nacre.optimise.parameters import Parameter
from nacre.optimise.problem import BudgetExhausted, Changes, Search
from nacre.optimise.solutions import are_alike
from nacre.optimise.spec import LayersSpec
from nacre.optimise.targets import Target, merit_function
from nacre.optimise.task import DesignTask, bounds_of, palette_name, substrates
from nacre.optimise.thin_film.search import Medium, Slot, StackProblem, StackSolution, default_evaluations, search
from nacre.optimise.thin_film.search import many as many_stacks
from nacre.recipe.model import LENGTH_UNITS_NM
from nacre.recipe.path_tables import by_path
from nacre.recipe.paths import EVERY

ENGINE_GEOMETRIES = ("specular", "transmitted")
SIDES = {"specular": "reflected", "transmitted": "transmitted"}
OWN_WAVELENGTHS = (16, 600)  # target spectra with as many wavelengths define the grid
STEP_NM = 2.0  # grid step for other target spectra
_LAYER = re.compile(r"layers\[(\d+)\]\.(material|thickness_(?:nm|um|mm))$")
_TOLERANCE = re.compile(r"layers\[(\d+|\*)\]\.thickness_(nm|um|mm)$")


class ThinFilmSearch(Search):
    """Genetic search of a film's stack."""

    def __init__(self, task: DesignTask, seed: int) -> None:
        super().__init__(task.spec.search.solutions)
        self.task, self.seed = task, seed
        self.entries: dict[str, Any] = {}  # medium name -> its recipe entry
        self.problem = self._problem()
        self.default_evaluations = default_evaluations(self.problem)
        self._found: list[tuple[float, Changes]] = []

    def _search(self, known: Sequence[Mapping[str, Any]]) -> None:
        self._found = [(self._objective(changes), dict(changes)) for changes in known]
        self.best = min((objective for objective, _ in self._found), default=np.inf)

        def report(objective: float, solution: Callable[[], StackSolution]) -> None:
            is_better = objective < self.best
            if is_better:
                self.best, self.best_changes = objective, self.changes(solution())
            self.report(is_better)

        with interrupt_flag() as is_interrupted:
            stacks = search(self.problem, self.budget, self.solution_count, self.seed, report, is_interrupted)
            is_stopped = is_interrupted()
        self._found = [*((s.objective, self.changes(s)) for s in stacks), *self._found]
        if is_stopped:
            raise KeyboardInterrupt
        self.best = min((objective for objective, _ in self.solutions()), default=np.inf)
        if not self.is_met and self.budget.share_used > 0.5:
            raise BudgetExhausted

    def solutions(self) -> list[tuple[float, Changes]]:
        """Return distinct solutions, best first."""
        stacks = list(self._found)
        if not self.problem.prefer_few_layers and not self.problem.has_tolerance:
            stacks.sort(key=lambda one: one[0])  # otherwise in the search's order, by layers or by yield
        chosen: list[tuple[float, Changes]] = []
        for objective, changes in stacks:
            if not any(are_alike(changes, other) for _, other in chosen):
                chosen.append((objective, changes))
        return chosen[: self.solution_count]

    def changes(self, solution: StackSolution) -> Changes:
        """Return a stack as recipe changes."""
        below = {"substrate": self.entries[solution.substrate]} if len(self.problem.substrates) > 1 else {}
        if self.task.spec.layers is not None:
            layers = [
                {"material": self.entries[name], "thickness_nm": float(d)}
                for name, d in zip(solution.materials, solution.thicknesses_nm)
            ]
            return {"layers": layers, **below}
        changes: Changes = {}
        for parameter in self.task.parameters:
            match = _LAYER.match(parameter.path)
            if match is None:
                continue
            i, key = int(match[1]), match[2]
            if key == "material":
                changes[parameter.path] = self.entries[solution.materials[i]]
            else:
                value = float(solution.thicknesses_nm[i]) / LENGTH_UNITS_NM[key.rpartition("_")[2]]
                changes[parameter.path] = min(max(value, parameter.low), parameter.high)
        return {**changes, **below}

    def merit_of(self, targets: Sequence[Target]) -> MeritFunction:
        """Return the merit function of other targets at the same geometries."""
        grid = self.problem.merit.wavelengths_nm
        return merit_function(targets, geometries_of(self.task.targets), self.task.spec.light, grid)

    def _objective(self, changes: Mapping[str, Any]) -> float:
        made, merit = self.task.material.vary(changes), self.problem.merit
        factors = stack_factors(made, geometries_of(self.task.targets), merit.wavelengths_nm)
        return np.inf if factors is None else float(merit.objective(merit.distances(factors)))

    def _problem(self) -> StackProblem:
        task = self.task
        spec, rows = task.spec, geometries_of(task.targets)
        grid = engine_wavelengths(task.targets)
        slots, names, below = self._given_layers() if spec.layers is None else self._open_stack(spec.layers)
        media = self._media([*names, *below], grid)
        film = _film(task.material)
        relative, absolute = self._tolerances(len(slots) if slots is not None else None)
        return StackProblem(
            merit=merit_function(task.targets, rows, spec.light, grid),
            palette=tuple(media[: len(names)]),
            substrates=tuple(media[len(names) :]),
            angles_rad=tuple(float(np.radians(at.theta_deg)) for at in rows),
            sides=tuple(SIDES[at.kind] for at in rows),
            ambient=film.ambient.n_complex(grid).real,
            max_layers=spec.layers.max_layers if spec.layers is not None else len(slots or ()),
            bounds_nm=None
            if spec.layers is None
            else {palette_name(e): bounds_of(spec.layers, e) for e in spec.layers.palette},
            slots=slots,
            max_total_nm=spec.limits.max_total_nm if spec.limits.max_total_nm is not None else np.inf,
            prefer_few_layers=spec.limits.max_layers == "fewest",
            relative_tolerance=relative,
            absolute_tolerance_nm=absolute,
        )

    def _open_stack(self, layers: LayersSpec) -> tuple[None, list[str], list[str]]:
        below = substrates(layers) or [self.task.material.data["substrate"]]
        return None, [self._name(entry) for entry in layers.palette], [self._name(entry) for entry in below]

    def _name(self, entry: Any) -> str:
        """Return the name of a medium, whose entry is then known."""
        name = palette_name(entry)
        self.entries[name] = entry
        return name

    def _given_layers(self) -> tuple[tuple[Slot, ...], list[str], list[str]]:
        """Return the recipe's layers as slots, with materials and substrates by name."""
        film, layers = _film(self.task.material), self.task.material.data.get("layers", [])
        free = {number.path: number for number in self.task.parameters}
        names: dict[str, None] = {}
        slots = []
        for i, layer in enumerate(layers):
            choice = free.get(f"layers[{i}].material")
            entries = list(choice.choices) if choice is not None else [layer["material"]]
            own = tuple(self._name(entry) for entry in entries)
            names |= dict.fromkeys(own)
            low = high = film.layers[i].thickness_at()
            for unit, factor in LENGTH_UNITS_NM.items():
                number = free.get(f"layers[{i}].thickness_{unit}")
                if number is not None:
                    low, high = factor * number.low, factor * number.high
            slots.append(Slot(own, float(low), float(high)))
        choice = free.get("substrate")
        below = list(choice.choices) if choice is not None else [self.task.material.data["substrate"]]
        return tuple(slots), list(names), [self._name(entry) for entry in below]

    def _media(self, names: Sequence[str], grid: Array) -> list[Medium]:
        """Return the media with the recipe's indices."""
        data = [{"material": self.entries[name], "thickness_nm": 1.0} for name in names]
        film = _film(self.task.material.vary({"layers": data}))
        media = []
        for name, layer in zip(names, film.layers, strict=True):
            if isinstance(layer.material, AnisotropicConstant):
                source = self.task.context.source
                raise RecipeError(f'{source}: "{name}" is anisotropic; a stack search takes isotropic materials')
            media.append(Medium(name, layer.material.n_complex(grid)))
        return media

    def _tolerances(self, slots: int | None) -> tuple[float | tuple[float, ...], float | tuple[float, ...]]:
        """Return the thickness tolerances, relative and in nm: one number, or one per layer.

        Raises:
            RecipeError: a tolerance of anything but layer thicknesses.
        """
        table = by_path(self.task.spec.tolerance, {"deviation", "percent"}, self.task.context.source, "tolerance")
        relative, absolute = np.zeros(max(slots or 1, 1)), np.zeros(max(slots or 1, 1))
        # an index takes precedence over [*]
        for path, entry in sorted(table.items(), key=lambda pair: -pair[0].count(EVERY)):
            match = _TOLERANCE.match(path)
            if match is None or (slots is None and match[1] != "*"):
                raise RecipeError(
                    f'{self.task.context.source}: tolerance."{path}" is not a thickness of the stack; '
                    'write "layers[*].thickness_nm"'
                )
            share, size = _deviation(entry, LENGTH_UNITS_NM[match[2]])
            which: Any = slice(None) if match[1] == "*" else int(match[1])
            relative[which], absolute[which] = share, size
        if slots is None:
            return float(relative[0]), float(absolute[0])
        return tuple(map(float, relative)), tuple(map(float, absolute))


def _deviation(entry: Any, factor_nm: float) -> tuple[float, float]:
    """Return a tolerance as (relative, nm), one of them 0; a uniform one by its standard deviation."""
    scale = 1.0
    if isinstance(entry, Mapping):
        scale = 1.0 / np.sqrt(3.0) if entry.get("distribution") == "uniform" else 1.0
        entry = entry["deviation"] if "deviation" in entry else f"{entry['percent']}%"
    text = str(entry).strip()
    number = scale * float(text.removesuffix("%"))
    return (number / 100.0, 0.0) if text.endswith("%") else (0.0, number * factor_nm)


def thin_film_search(target: DesignTask, seed: int) -> ThinFilmSearch | None:
    """Return the thin-film search of a task, or None if it varies anything but a stack.

    Raises:
        RecipeError: a stack is searched for targets that also depend on other quantities.
    """
    others = [one for one in target.targets if not _in_engine(one.geometry)]
    if target.spec.layers is not None:
        if others:
            raise RecipeError(
                f'{others[0].key}.geometry = "{others[0].geometry}": [layers] allows only specular and transmitted '
                "targets; for others vary the thicknesses of given layers"
            )
        _check_plain(target)
        return ThinFilmSearch(target, seed)
    is_stack = not others and is_plain(target.material) and all(_is_of_stack(number) for number in target.parameters)
    spreads = by_path(target.spec.tolerance, {"deviation", "percent"}, target.context.source, "tolerance")
    return ThinFilmSearch(target, seed) if is_stack and all(_TOLERANCE.match(path) for path in spreads) else None


def thin_film_search_many(
    tasks: Sequence[DesignTask], which: Sequence[int], take: Callable[[int, dict[str, Any]], None]
) -> bool:
    """Find the best changes for some of many tasks that differ only in their colours.

    Args:
        which: task numbers that are sought.
        take: called with each number and its changes, from threads.

    Returns:
        False at once unless the task is a stack search with a free layer count and without tolerances.

    Raises:
        RecipeError: as `thin_film_search`.
    """
    spec = tasks[0].spec
    if spec.tolerance or spec.limits.max_layers is not None:
        return False
    one = thin_film_search(tasks[0], spec.search.seed)
    if one is None:
        return False
    if which:
        many_stacks(
            one.problem,
            [one.merit_of(other.targets) for other in tasks],
            spec.search.seed,
            which=which,
            on_progress=lambda number, solution: take(number, one.changes(solution)),
        )
    return True


def _check_plain(target: DesignTask) -> None:
    if not is_plain(target.material):
        raise RecipeError(
            f"{target.context.source}: layers: the stack of a film with ridges or a preset cannot be searched"
        )


def is_plain(material: Material) -> bool:
    """Whether a material is one uniform stack of interfering layers."""
    film = material.model
    return (
        isinstance(film, Film)
        and film.ridges is None
        and "preset" not in material.data
        and not film.is_anisotropic
        and not any(isinstance(layer.thickness_nm, Texture) or layer.incoherent for layer in film.layers)
        # neither repeated, nor graded, nor with rough interfaces
        and all(layer.path == f"layers[{i}]" for i, layer in enumerate(film.layers))
    )


def _in_engine(at: Geometry) -> bool:
    return at.kind in ENGINE_GEOMETRIES and at.polarisation == "both"


def _film(material: Material) -> Film:
    assert isinstance(material.model, Film)
    return material.model


def _is_of_stack(number: Parameter) -> bool:
    if number.path == "substrate" or number.path.endswith(".material"):
        return bool(number.choices)
    return bool(_LAYER.match(number.path)) and not number.choices


def engine_wavelengths(targets: Sequence[Target]) -> Array:
    """Return the search wavelengths: those of colours, or of the spectra without colours.

    The final evaluation uses a target spectrum's wavelengths, hence the search does too if there are enough.
    """
    spectra = [one.spectrum for one in targets if one.spectrum is not None]
    if not spectra:
        return default_wavelengths_nm()
    low, high = min(float(s[0, 0]) for s in spectra), max(float(s[0, -1]) for s in spectra)
    if len(spectra) < len(targets):
        grid = default_wavelengths_nm()
        return (
            np.union1d(grid, np.arange(np.floor(low), np.ceil(high) + STEP_NM, STEP_NM))
            if low < grid[0] or high > grid[-1]
            else grid
        )
    own = np.unique(np.concatenate([s[0] for s in spectra]))
    if OWN_WAVELENGTHS[0] <= len(own) <= OWN_WAVELENGTHS[1]:
        return own
    return np.linspace(low, high, max(int(np.ceil((high - low) / STEP_NM)) + 1, 4))


def stack_factors(
    material: Material, rows: Sequence[Geometry], wavelengths_nm: Array, thicknesses_nm: Array | None = None
) -> Array | None:
    """Return the factors of a stack `[..., row, wavelength]`, or None for other materials.

    Args:
        thicknesses_nm: `[..., layer]`; default: the material defaults.
    """
    if not is_plain(material) or not all(_in_engine(at) for at in rows):
        return None
    film = _film(material)
    d = np.array([layer.thickness_at() for layer in film.layers]) if thicknesses_nm is None else thicknesses_nm
    angles = np.unique([at.theta_deg for at in rows])
    solved = powers(film.stack.indices(wavelengths_nm), d, wavelengths_nm, np.radians(angles))
    pick = {"specular": solved.reflectance, "transmitted": solved.transmittance}
    columns = [pick[at.kind][..., int(np.searchsorted(angles, at.theta_deg)), :] for at in rows]
    return np.stack(columns, axis=-2)


def drawn_factors(
    material: Material, paths: Sequence[str], values: Array, rows: Sequence[Geometry], wavelengths_nm: Array
) -> Array | None:
    """Return the factors `[draw, row, wavelength]` of random thicknesses, or None for other parameters.

    Args:
        paths: thickness paths.
        values: `[draw, path]`.
    """
    if not is_plain(material):
        return None
    d = np.repeat([[layer.thickness_at() for layer in _film(material).layers]], len(values), axis=0)
    for path, column in zip(paths, values.T, strict=True):
        match = _TOLERANCE.match(path)
        if match is None or match[1] == "*":
            return None
        d[:, int(match[1])] = column * LENGTH_UNITS_NM[match[2]]
    return stack_factors(material, rows, wavelengths_nm, d)


@contextlib.contextmanager
def interrupt_flag() -> Iterator[Callable[[], bool]]:
    """Turn Ctrl-C into a flag, with which the search returns its best; a second Ctrl-C interrupts."""
    interrupted = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield interrupted.is_set
        return
    before = signal.getsignal(signal.SIGINT)

    def note(number: int, frame: Any) -> None:
        if interrupted.is_set():
            raise KeyboardInterrupt
        interrupted.set()

    signal.signal(signal.SIGINT, note)
    try:
        yield interrupted.is_set
    finally:
        signal.signal(signal.SIGINT, before)
