"""Manufacturing tolerances: reading, sampling, and yield confidence interval."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError, RecipeError
from nacre.material.material import Material
from nacre.recipe.model import show_value
from nacre.recipe.path_tables import ToleranceSpec, by_path, known_only
from nacre.recipe.paths import expand_table

DISTRIBUTIONS = ("gaussian", "uniform")


TIED, INDEPENDENT = "tied", "independent"  # default sources of deviations
LEAST_EIGENVALUE = -1e-9  # rounding of a correlation matrix that is singular
FAR, SMALL = 10.0, 1e-3  # in deviations: larger than any draw; step below 0 to test whether the recipe allows it
BY_MATERIAL = "material"  # group: all layers of one material deviate together


@dataclass(frozen=True)
class Tolerance:
    """Manufacturing tolerance for a recipe number.

    Attributes:
        path: in the recipe.
        nominal: recipe value.
        deviation: standard deviation (gaussian) or half width (uniform), in the number's unit.
        distribution: "gaussian" or "uniform".
        group: numbers of one group deviate together, by one random factor; "": independent of all others.
        source: manufacturing cause, by which contributions are summed; "": `TIED` or `INDEPENDENT`.
        is_signed: whether the recipe allows values below 0, such as angles; other values end at 0.
    """

    path: str
    nominal: float
    deviation: float
    distribution: str = "gaussian"
    group: str = ""
    source: str = ""
    is_signed: bool = False

    @property
    def standard_deviation(self) -> float:
        """Standard deviation, either distribution."""
        return self.deviation / np.sqrt(3) if self.distribution == "uniform" else self.deviation


@dataclass(frozen=True)
class Component:
    """An independent cause of variation: one number, or the common factor of a group.

    Attributes:
        name: path, or group name.
        tolerances: tolerances of the affected numbers.
    """

    name: str
    tolerances: tuple[Tolerance, ...]

    @property
    def distribution(self) -> str:
        """Distribution of the factor."""
        return self.tolerances[0].distribution

    @property
    def source(self) -> str:
        """Manufacturing cause."""
        return self.tolerances[0].source or (TIED if self.tolerances[0].group else INDEPENDENT)

    def values(self, factor: float) -> dict[str, float]:
        """Return recipe values at a factor in standard deviations; numbers that are never negative end at 0."""
        moved = {t.path: t.nominal + factor * t.standard_deviation for t in self.tolerances}
        return {t.path: moved[t.path] if t.is_signed else max(moved[t.path], 0.0) for t in self.tolerances}


def components(tolerances: Sequence[Tolerance]) -> tuple[Component, ...]:
    """Return the independent causes of variation in order of their first tolerance."""
    groups: dict[tuple[str, str], list[Tolerance]] = {}
    for each in tolerances:
        groups.setdefault(("group", each.group) if each.group else ("path", each.path), []).append(each)
    return tuple(Component(name, tuple(members)) for (_, name), members in groups.items())


def values_at(causes: Sequence[Component], factors: Array) -> dict[str, Array]:
    """Return path -> values `[point]` of causes at factors `[point, cause]` in standard deviations, added and cut."""
    moved: dict[str, Array] = {}
    numbers = {each.path: each for cause in causes for each in cause.tolerances}
    for cause, column in zip(causes, np.asarray(factors, dtype=float).T, strict=True):
        for each in cause.tolerances:
            change = each.standard_deviation * column
            if not each.is_signed:
                change = np.maximum(change, -each.nominal)
            moved[each.path] = moved.get(each.path, 0.0) + change
    return {
        path: np.maximum(numbers[path].nominal + change, -np.inf if numbers[path].is_signed else 0.0)
        for path, change in moved.items()
    }


@dataclass(frozen=True)
class Draws:
    """Random values: path -> `[draw]`, and the share of draws of each path that were cut off at 0."""

    values: dict[str, Array]
    clipped: dict[str, float]


def draw(tolerances: Sequence[Tolerance], generator: np.random.Generator, count: int) -> Draws:
    """Draw values; the deviations of a number's tolerances add. Numbers that are not signed are clipped at 0."""
    values: dict[str, Array] = {}
    signed = {each.path for each in tolerances if each.is_signed}
    for component in components(tolerances):
        is_uniform = component.distribution == "uniform"
        unit = generator.uniform(-1, 1, count) if is_uniform else generator.standard_normal(count)
        for each in component.tolerances:
            values[each.path] = values.get(each.path, each.nominal) + each.deviation * unit
    negative = {path: value < 0.0 for path, value in values.items() if path not in signed}
    clipped = {path: float(np.mean(rows)) for path, rows in negative.items() if rows.any()}
    return Draws({path: np.where(negative.get(path, False), 0.0, v) for path, v in values.items()}, clipped)


def read_tolerances(table: Any, material: Material, source: str, name: str = "tolerance") -> tuple[Tolerance, ...]:
    """Read a `[tolerance]` table; percentages refer to the material's numbers.

    Args:
        table: path -> tolerance, or list of tolerances that add; `[*]` in a path means every index without own path.
        source: file name, for messages; name: table name.

    Raises:
        RecipeError: with the path and the allowed values.
    """
    entries = by_path(table, {"deviation", "percent"}, source, name)
    material = material.with_parts_loaded(entries)
    expanded = expand_table(material.data, entries, f'{source}: {name}: recipe "{material.name}"')
    read = []
    for path, (_, entry) in expanded.items():
        where = f'{source}: {name}."{path}"'
        rows = entry if isinstance(entry, list) else [entry]
        if not rows:
            raise RecipeError(f"{where} is an empty list")
        read += [_read(material, path, row, where) for row in rows]
    read = _correlated(read, material, source)
    for component in components(read):
        if len({each.source for each in component.tolerances}) > 1:
            raise RecipeError(f'{source}: {name}: group "{component.name}" has two sources; use one')
        if len({each.distribution for each in component.tolerances}) > 1:
            raise RecipeError(f'{source}: {name}: group "{component.name}" has two distributions; use one')
    return tuple(read)


def _correlated(read: list[Tolerance], material: Material, source: str) -> list[Tolerance]:
    """Replace deviations with a correlation matrix by their independent modes, each one group.

    The modes are the matrix's eigenvectors: x_i = sigma_i sum_j V_ij sqrt(e_j) z_j has the correlation V e V^T.

    Raises:
        RecipeError: a path has no single gaussian tolerance, or the matrix is not a correlation matrix.
    """
    entries = material.data.get("correlation", ())
    if not isinstance(entries, list | tuple):
        raise RecipeError(f"{source}: correlation = {show_value(entries)} should be a list of tables")
    independent = list(read)
    for number, entry in enumerate(entries):
        where = f"{source}: correlation[{number}]"
        if (
            not isinstance(entry, Mapping)
            or set(entry) != {"of", "matrix"}
            or not isinstance(entry["of"], list | tuple)
        ):
            raise RecipeError(f'{where} should be {{of = ["PATH", ...], matrix = [[1, 0.8], [0.8, 1]]}}')
        paths = list(expand_table(material.data, {str(p): p for p in entry["of"]}, f"{where}.of"))
        if len(paths) < 2 or len(set(map(str, entry["of"]))) < len(entry["of"]):
            raise RecipeError(f"{where}.of = {show_value(entry['of'])} should name two numbers or more, each once")
        members = [[each for each in independent if each.path == path] for path in paths]
        for path, own in zip(paths, members, strict=True):
            if len(own) != 1 or own[0].group or own[0].distribution != "gaussian":
                raise RecipeError(f'{where}.of: "{path}" needs one gaussian tolerance without a group')
        ordered = [own[0] for own in members]
        modes = _modes(entry["matrix"], len(ordered), f"{where}.matrix")
        independent = [each for each in independent if each.path not in paths]
        for mode, column in enumerate(modes.T, start=1):
            cause = ordered[0].source if len({each.source for each in ordered}) == 1 else ""
            group = f"mode {mode} of correlation[{number}]"
            independent += [
                replace(each, deviation=float(each.deviation * share), group=group, source=cause)
                for each, share in zip(ordered, column, strict=True)
                if share != 0.0
            ]
    return independent


def _modes(matrix: Any, size: int, where: str) -> Array:
    """Return `V sqrt(e)`, `[number, mode]`, of a correlation matrix, largest mode first.

    Raises:
        RecipeError: it is not square, symmetric, positive semidefinite or has another diagonal than 1.
    """
    try:
        values = np.array(matrix, dtype=float)
    except (ValueError, TypeError):
        values = np.zeros(0)
    rules = (
        ("should be numbers, {0} rows of {0}", lambda: values.shape == (size, size) and np.isfinite(values).all()),
        ("should be symmetric", lambda: np.allclose(values, values.T)),
        ("should have 1 on its diagonal", lambda: np.allclose(np.diag(values), 1.0)),
        ("should be positive semidefinite", lambda: np.linalg.eigvalsh(values).min() >= LEAST_EIGENVALUE),
    )
    for rule, holds in rules:
        if not holds():
            raise RecipeError(f"{where} = {show_value(matrix)} {rule.format(size)}")
    eigenvalues, vectors = np.linalg.eigh(values)
    modes: Array = (vectors * np.sqrt(np.maximum(eigenvalues, 0.0)))[:, ::-1]
    return modes[:, eigenvalues[::-1] > -LEAST_EIGENVALUE]


def _read(material: Material, path: str, value: Any, where: str) -> Tolerance:
    """Read a number (standard deviation), a percentage ("2%"), or a table as in `ToleranceSpec`."""
    try:
        nominal = material.get(path)
    except (RecipeError, KeyError, IndexError, TypeError):
        nominal = None
    if nominal is None:
        raise RecipeError(f"{where} does not exist in the recipe")
    if isinstance(nominal, bool) or not isinstance(nominal, int | float):
        raise RecipeError(f"{where}: the recipe's value {show_value(nominal)} is not a number")
    distribution, group, cause = "gaussian", "", ""
    if isinstance(value, Mapping):
        known_only(value, ToleranceSpec, where)
        distribution = value.get("distribution", "gaussian")
        if distribution not in DISTRIBUTIONS:
            allowed = ", ".join(DISTRIBUTIONS)
            raise RecipeError(f"{where}.distribution = {show_value(distribution)}; known: {allowed}")
        cause = value.get("source", "")
        if not isinstance(cause, str):
            raise RecipeError(f"{where}.source = {show_value(cause)} should be a word")
        group = _group(material, path, value.get("group", ""), where)
        value = value["deviation"] if "deviation" in value else f"{value['percent']}%"
    text = str(value).strip()
    try:
        number = float(text.removesuffix("%"))
    except ValueError:
        number = np.nan
    if not (np.isfinite(number) and number >= 0):
        raise RecipeError(f"{where} = {show_value(value)} should be a number >= 0 or a percentage")
    deviation = abs(nominal) * number / 100 if text.endswith("%") else number
    is_signed = nominal < 0 or nominal < FAR * deviation and allows(material, path, -SMALL * deviation)
    if isinstance(nominal, int) and not allows(material, path, nominal + 0.5) and allows(material, path, nominal + 1):
        raise RecipeError(f"{where}: a whole number has no tolerance; sweep it instead")
    return Tolerance(path, float(nominal), deviation, str(distribution), group, cause, is_signed)


def allows(material: Material, path: str, value: float) -> bool:
    """Whether a recipe may have a value at a path."""
    try:
        material.vary({path: value})
    except NacreError:
        return False
    return True


def _group(material: Material, path: str, group: Any, where: str) -> str:
    """Return the name of a number's group; "material" stands for the material of the layer that holds the number."""
    if not isinstance(group, str):
        raise RecipeError(f"{where}.group = {show_value(group)} should be a name")
    if group != BY_MATERIAL:
        return group
    layer = path.rpartition(".")[0]
    try:
        return f"material {show_value(material.get(layer + '.material'))}"
    except (RecipeError, KeyError, IndexError, TypeError):
        raise RecipeError(f'{where}.group = "{BY_MATERIAL}": {path} belongs to no layer with a material') from None


def wilson_interval(good: int, count: int, z: float = 1.96) -> tuple[float, float]:
    """Return Wilson's 95 % confidence interval for a share; unlike the normal one it is valid at 0 and 1."""
    share = good / count
    centre = (share + z**2 / (2 * count)) / (1 + z**2 / count)
    half = z / (1 + z**2 / count) * np.sqrt(share * (1 - share) / count + z**2 / (4 * count**2))
    return max(0.0, float(centre - half)), min(1.0, float(centre + half))
