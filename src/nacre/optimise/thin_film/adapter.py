"""Films whose layers are sought go to the search of stacks, which knows their derivatives."""

from __future__ import annotations

import contextlib
import re
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from nacre.bsdf.texture import Texture
from nacre.core.arrays import Array
from nacre.core.errors import RecipeError
from nacre.families.film.material import Film
from nacre.material.material import Material
from nacre.matter.stack.solve import powers
from nacre.optimise.evaluation import geometries_of
from nacre.optimise.measurement import Geometry
from nacre.optimise.merit import MeritFunction, default_wavelengths_nm
from nacre.optimise.parameters import Parameter
from nacre.optimise.solutions import are_alike
from nacre.optimise.spec import LayersSpec
from nacre.optimise.targets import Target, merit_function
from nacre.optimise.task import DesignTask, bounds_of, palette_name, substrates
from nacre.optimise.thin_film.problem import Medium, Slot, StackProblem
from nacre.optimise.thin_film.search import StackSolution, search
from nacre.optimise.thin_film.search import many as many_stacks
from nacre.recipe.path_tables import by_path
from nacre.recipe.paths import EVERY
from nacre.recipe.units import LENGTH_UNITS_NM

ENGINE_KINDS = ("specular", "transmitted")
SIDES = {"specular": "reflected", "transmitted": "transmitted"}
OWN = (16, 600)  # so many wavelengths of wanted spectra are searched as they are
STEP_NM = 2.0  # of the grid where spectra are wanted
MET = 0.2
_LAYER = re.compile(r"layers\[(\d+)\]\.(material|thickness_(?:nm|um|mm))$")
_SPREAD = re.compile(r"layers\[(\d+|\*)\]\.thickness_(nm|um|mm)$")


class ThinFilmSearch:
    """The search of one film's stack.

    Args:
        target: what is asked, of a film.
        seed: of the search.
    """

    def __init__(self, target: DesignTask, seed: int) -> None:
        self.target, self.seed = target, seed
        self.entries: dict[str, Any] = {}  # name of a medium -> as a recipe writes it
        self.problem = self._problem()
        self._answers: list[tuple[float, dict[str, Any]]] = []
        self._known: list[tuple[float, dict[str, Any]]] = []

    def run(
        self, seconds: float, tell: Callable[[float, dict[str, Any]], None] | None, known: Sequence[Mapping[str, Any]]
    ) -> str:
        """Search; return why it ended: "met", "time" or "interrupted".

        Args:
            known: answers of an earlier run, which are kept if nothing better is found.
        """
        self._known = [(self._objective(changes), dict(changes)) for changes in known]
        best = min((o for o, _ in self._known), default=np.inf)
        begun = time.monotonic()
        told: list[Any] = [np.inf, {}]  # the best that was told

        def show(progress: Any) -> None:
            if tell is not None:
                if progress.objective < told[0]:
                    told[0] = progress.objective
                    told[1] = self.changes(progress.solution()) if progress.objective < best else {}
                tell(min(progress.objective, best), told[1])

        with interrupt_flag() as is_interrupted:
            found = search(self.problem, seconds, self.target.spec.search.solutions, self.seed, show, is_interrupted)
            stopped = is_interrupted()
        self._answers = [(s.objective, self.changes(s)) for s in found]
        if stopped:
            return "interrupted"
        reached = min((o for o, _ in self.answers()), default=np.inf)
        return "met" if reached <= MET or time.monotonic() - begun < 0.5 * seconds else "time"

    def answers(self) -> list[tuple[float, dict[str, Any]]]:
        """Return answers that differ from one another, the best first."""
        chosen: list[tuple[float, dict[str, Any]]] = []
        pool = [*self._answers, *self._known]
        if not self.problem.fewest and not self.problem.has_spread:
            pool.sort(key=lambda a: a[0])  # else the search's own order is by layers or by yield
        for objective, changes in pool:
            if not any(are_alike(changes, other) for _, other in chosen):
                chosen.append((objective, changes))
        return chosen[: self.target.spec.search.solutions]

    def changes(self, solution: StackSolution) -> dict[str, Any]:
        """Return a stack as changes of the recipe."""
        below = {"substrate": self.entries[solution.substrate]} if len(self.problem.substrates) > 1 else {}
        if self.target.spec.layers is not None:
            layers = [
                {"material": self.entries[name], "thickness_nm": float(d)}
                for name, d in zip(solution.materials, solution.thicknesses_nm)
            ]
            return {"layers": layers, **below}
        found: dict[str, Any] = {}
        for number in self.target.parameters:
            match = _LAYER.match(number.path)
            if match is None:
                continue
            i, word = int(match[1]), match[2]
            if word == "material":
                found[number.path] = self.entries[solution.materials[i]]
            else:
                value = float(solution.thicknesses_nm[i]) / LENGTH_UNITS_NM[word.rpartition("_")[2]]
                found[number.path] = min(max(value, number.low), number.high)
        return {**found, **below}

    def goals(self, wants: Sequence[Target]) -> MeritFunction:
        """Return goals of other wants at the same geometries."""
        return merit_function(
            wants, geometries_of(self.target.targets), self.target.spec.light, self.problem.goals.wavelengths_nm
        )

    def _objective(self, changes: Mapping[str, Any]) -> float:
        made = self.target.material.vary(changes)
        seen = stack_factors(made, geometries_of(self.target.targets), self.problem.goals.wavelengths_nm)
        return np.inf if seen is None else float(self.problem.goals.objective(self.problem.goals.distances(seen)))

    def _problem(self) -> StackProblem:
        target = self.target
        spec, rows = target.spec, geometries_of(target.targets)
        grid = engine_wavelengths(target.targets)
        slots, names, below = self._given_layers() if spec.layers is None else self._open_stack(spec.layers)
        media = self._media([*names, *below], grid)
        film = _film(target.material)
        relative, absolute = self._spreads(len(slots) if slots is not None else None)
        return StackProblem(
            goals=merit_function(target.targets, rows, spec.light, grid),
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
            total_nm=spec.limits.max_total_nm if spec.limits.max_total_nm is not None else np.inf,
            fewest=spec.limits.max_layers == "fewest",
            spread_relative=relative,
            spread_nm=absolute,
        )

    def _open_stack(self, layers: LayersSpec) -> tuple[None, list[str], list[str]]:
        for entry in layers.palette:
            self.entries[palette_name(entry)] = entry
        below = substrates(layers) or [self.target.material.data["substrate"]]
        return None, [palette_name(e) for e in layers.palette], [self._below(entry) for entry in below]

    def _below(self, entry: Any) -> str:
        name = palette_name(entry)
        self.entries[name] = entry
        return name

    def _given_layers(self) -> tuple[tuple[Slot, ...], list[str], list[str]]:
        """Return the recipe's layers as slots, with what is free in them."""
        film, layers = _film(self.target.material), self.target.material.data.get("layers", [])
        free = {number.path: number for number in self.target.parameters}
        names: dict[str, None] = {}
        slots = []
        for i, layer in enumerate(layers):
            choice = free.get(f"layers[{i}].material")
            entries = list(choice.choices) if choice is not None else [layer["material"]]
            for entry in entries:
                self.entries[palette_name(entry)] = entry
            own = tuple(palette_name(entry) for entry in entries)
            names |= dict.fromkeys(own)
            low = high = film.layers[i].thickness_at()
            for unit, factor in LENGTH_UNITS_NM.items():
                number = free.get(f"layers[{i}].thickness_{unit}")
                if number is not None:
                    low, high = factor * number.low, factor * number.high
            slots.append(Slot(own, float(low), float(high)))
        choice = free.get("substrate")
        below = list(choice.choices) if choice is not None else [self.target.material.data["substrate"]]
        return tuple(slots), list(names), [self._below(entry) for entry in below]

    def _media(self, names: Sequence[str], grid: Array) -> list[Medium]:
        """Return the media, their indices built as the recipe builds them."""
        data = [{"material": self.entries[name], "thickness_nm": 1.0} for name in names]
        film = _film(self.target.material.vary({"layers": data}))
        return [Medium(name, layer.material.n_complex(grid)) for name, layer in zip(names, film.layers, strict=True)]

    def _spreads(self, slots: int | None) -> tuple[float | tuple[float, ...], float | tuple[float, ...]]:
        """Return the spread of thicknesses, relative and in nm: one number, or one a layer.

        Raises:
            RecipeError: a spread of something else than the layers' thicknesses.
        """
        table = by_path(self.target.spec.tolerance, {"deviation", "percent"}, self.target.context.source, "tolerance")
        relative, absolute = np.zeros(max(slots or 1, 1)), np.zeros(max(slots or 1, 1))
        # of an index last: it wins over every one
        for path, entry in sorted(table.items(), key=lambda pair: -pair[0].count(EVERY)):
            match = _SPREAD.match(path)
            if match is None or (slots is None and match[1] != "*"):
                raise RecipeError(
                    f'{self.target.context.source}: tolerance."{path}" is not of the layers that are sought; '
                    'write "layers[*].thickness_nm"'
                )
            share, size = _deviation(entry, LENGTH_UNITS_NM[match[2]])
            which: Any = slice(None) if match[1] == "*" else int(match[1])
            relative[which], absolute[which] = share, size
        if slots is None:
            return float(relative[0]), float(absolute[0])
        return tuple(map(float, relative)), tuple(map(float, absolute))


def _deviation(entry: Any, factor_nm: float) -> tuple[float, float]:
    """Return a spread as (share, nm), one of them 0; a uniform one by its standard deviation."""
    scale = 1.0
    if isinstance(entry, Mapping):
        scale = 1.0 / np.sqrt(3.0) if entry.get("distribution") == "uniform" else 1.0
        entry = entry["deviation"] if "deviation" in entry else f"{entry['percent']}%"
    text = str(entry).strip()
    number = scale * float(text.removesuffix("%"))
    return (number / 100.0, 0.0) if text.endswith("%") else (0.0, number * factor_nm)


def thin_film_search(target: DesignTask, seed: int) -> ThinFilmSearch | None:
    """Return the search of stacks for a target, or None where its numbers are not those of a stack.

    Raises:
        RecipeError: the stack is sought for looks that it does not decide alone.
    """
    others = [want for want in target.targets if want.geometry.kind not in ENGINE_KINDS]
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
    return ThinFilmSearch(target, seed) if is_stack and all(_SPREAD.match(path) for path in spreads) else None


def thin_film_search_many(
    target: DesignTask, targets: Sequence[DesignTask], which: Sequence[int], take: Callable[[int, dict[str, Any]], None]
) -> bool:
    """Find the best changes for some of many targets that differ in their colours only.

    Args:
        targets: all of them.
        which: numbers of those that are sought.
        take: called with the number of each and its changes, from threads.

    Returns:
        False, with nothing done, where the free numbers are not those of a stack.

    Raises:
        RecipeError: as of `film_search`.
    """
    one = thin_film_search(targets[0] if targets else target, target.spec.search.seed)
    if one is None:
        return False
    if which:
        goals = [one.goals(other.targets) for other in targets]
        many_stacks(
            one.problem,
            goals,
            target.spec.search.seed,
            which=which,
            on_progress=lambda number, solution: take(number, one.changes(solution)),
        )
    return True


def _check_plain(target: DesignTask) -> None:
    if not is_plain(target.material):
        raise RecipeError(
            f"{target.context.source}: layers: the stack of a film with ridges or a preset cannot be sought"
        )


def is_plain(material: Material) -> bool:
    """Whether a material is one stack, the same over the surface, all layers of which interfere."""
    film = material.model
    return (
        isinstance(film, Film)
        and film.ridges is None
        and "preset" not in material.data
        and not any(isinstance(layer.thickness_nm, Texture) or layer.incoherent for layer in film.layers)
    )


def _film(material: Material) -> Film:
    assert isinstance(material.model, Film)
    return material.model


def _is_of_stack(number: Parameter) -> bool:
    if number.path == "substrate" or number.path.endswith(".material"):
        return bool(number.choices)
    return bool(_LAYER.match(number.path)) and not number.choices


def engine_wavelengths(wants: Sequence[Target]) -> Array:
    """Return the grid on which stacks are compared: that of colours, or of the spectra where only those are wanted.

    A spectrum is judged on its own wavelengths (`judge._rms`), so they are the grid where it has enough of them.
    """
    spectra = [want.spectrum for want in wants if want.spectrum is not None]
    if not spectra:
        return default_wavelengths_nm()
    low, high = min(float(s[0, 0]) for s in spectra), max(float(s[0, -1]) for s in spectra)
    if len(spectra) < len(wants):
        grid = default_wavelengths_nm()
        return (
            np.union1d(grid, np.arange(np.floor(low), np.ceil(high) + STEP_NM, STEP_NM))
            if low < grid[0] or high > grid[-1]
            else grid
        )
    own = np.unique(np.concatenate([s[0] for s in spectra]))
    if OWN[0] <= len(own) <= OWN[1]:
        return own
    return np.linspace(low, high, max(int(np.ceil((high - low) / STEP_NM)) + 1, 4))


def stack_factors(
    material: Material, rows: Sequence[Geometry], wavelengths_nm: Array, thicknesses_nm: Array | None = None
) -> Array | None:
    """Return the factors of a stack `[..., row, wavelength]` at once, or None where the material is no plain one.

    Args:
        thicknesses_nm: `[..., layer]`, of stacks of the same materials; default: the material's own.
    """
    if not is_plain(material) or any(at.kind not in ENGINE_KINDS for at in rows):
        return None
    film = _film(material)
    d = np.array([layer.thickness_at() for layer in film.layers]) if thicknesses_nm is None else thicknesses_nm
    angles = np.unique([at.theta_deg for at in rows])
    found = powers(film.stack.indices(wavelengths_nm), d, wavelengths_nm, np.radians(angles))
    pick = {"specular": found.reflectance, "transmitted": found.transmittance}
    columns = [pick[at.kind][..., int(np.searchsorted(angles, at.theta_deg)), :] for at in rows]
    return np.stack(columns, axis=-2)


def drawn_factors(
    material: Material, paths: Sequence[str], values: Array, rows: Sequence[Geometry], wavelengths_nm: Array
) -> Array | None:
    """Return the factors `[draw, row, wavelength]` of draws of thicknesses, or None where the paths are of others.

    Args:
        paths: of the numbers that vary.
        values: `[draw, path]`.
    """
    if not is_plain(material):
        return None
    d = np.repeat([[layer.thickness_at() for layer in _film(material).layers]], len(values), axis=0)
    for path, column in zip(paths, values.T, strict=True):
        match = _SPREAD.match(path)
        if match is None or match[1] == "*":
            return None
        d[:, int(match[1])] = column * LENGTH_UNITS_NM[match[2]]
    return stack_factors(material, rows, wavelengths_nm, d)


@contextlib.contextmanager
def interrupt_flag() -> Iterator[Callable[[], bool]]:
    """Turn Ctrl-C into a flag that the search asks for, so that it ends with its best; a second one interrupts."""
    seen = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield seen.is_set
        return
    before = signal.getsignal(signal.SIGINT)

    def note(number: int, frame: Any) -> None:
        if seen.is_set():
            raise KeyboardInterrupt
        seen.set()

    signal.signal(signal.SIGINT, note)
    try:
        yield seen.is_set
    finally:
        signal.signal(signal.SIGINT, before)


__all__ = ["ThinFilmSearch", "drawn_factors", "is_plain", "stack_factors", "thin_film_search", "thin_film_search_many"]
