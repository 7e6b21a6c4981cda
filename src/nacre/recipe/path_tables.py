"""Tables whose keys are recipe paths: `[fit]`, `[tolerance]` and a sweep's axes."""

import re
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from nacre.core.errors import RecipeError, did_you_mean
from nacre.recipe.keys import ByPath
from nacre.recipe.model import RecipeModel, renamed_hint, show_value
from nacre.recipe.paths import EVERY


class BoundsSpec(RecipeModel):
    """The bounds of a parameter of `nacre fit`."""

    forms: ClassVar[tuple[str, ...]] = ("{min = 100, max = 600}",)

    min: float = Field(description="lower bound", examples=[100])
    max: float = Field(description="upper bound", examples=[600])


class ParameterSpec(RecipeModel):
    """A design parameter: a number with bounds, or choices."""

    one_of: ClassVar[tuple[str, ...]] = ("min|max", "choices")
    forms: ClassVar[tuple[str, ...]] = ("{min = 3, max = 15}", '{choices = ["SiO2", "MgF2"]}')

    min: float | None = Field(default=None, description="lower bound", examples=[3])
    max: float | None = Field(default=None, description="upper bound", examples=[15])
    choices: list[Any] | None = Field(default=None, description="values to choose from", examples=[["SiO2", "MgF2"]])


class ToleranceSpec(RecipeModel):
    """The manufacturing tolerance of a number, for `nacre tolerance`."""

    one_of: ClassVar[tuple[str, ...]] = ("deviation", "percent")

    deviation: float | None = Field(
        default=None,
        ge=0.0,
        description="standard deviation, or half width of a uniform distribution, in the number's unit",
        examples=[5],
    )
    percent: float | None = Field(
        default=None, ge=0.0, description="in place of deviation: the same in per cent of the number", examples=[2]
    )
    distribution: Literal["gaussian", "uniform"] = Field(
        default="gaussian", description="distribution of the number", examples=["uniform"]
    )
    group: str = Field(
        default="",
        description='numbers of one group deviate together (a run, a tooling factor); "material": all layers of one '
        "material",
        examples=["run", "material"],
    )
    source: str = Field(
        default="",
        description="cause of the deviation in the machine, by which the report of `nacre tolerance` sums the "
        "contributions: a word such as run to run, within a run, uniformity, index drift",
        examples=["run to run", "uniformity"],
    )


class CorrelationSpec(RecipeModel):
    """Correlated deviations of several numbers."""

    of: list[str] = Field(
        description="paths of numbers with a tolerance, with [*] for any index", examples=[["layers[*].thickness_nm"]]
    )
    matrix: list[list[float]] = Field(
        description="correlation matrix of their deviations, in this order", examples=[[[1, 0.8], [0.8, 1]]]
    )


class InstrumentSpec(RecipeModel):
    """What an instrument averages over, and its offset; the numbers may be parameters of a fit."""

    forms: ClassVar[tuple[str, ...]] = ("{bandwidth_nm = 4, cone_deg = 1.5}",)

    bandwidth_nm: float = Field(
        default=0.0, ge=0.0, le=100.0, description="spectral bandwidth, full width at half maximum", examples=[4]
    )
    cone_deg: float = Field(
        default=0.0, ge=0.0, le=30.0, description="half angle of the cone of light that is averaged", examples=[1.5]
    )
    thickness_spread_percent: float = Field(
        default=0.0, ge=0.0, le=50.0,
        description="standard deviation of the thicknesses under the spot, all layers in proportion", examples=[1]
    )  # fmt: skip
    angle_offset_deg: float = Field(
        default=0.0, ge=-10.0, le=10.0, description="true angle of incidence minus the stated one", examples=[0.05]
    )
    azimuth_deg: float = Field(default=0.0, description="azimuth of the direction to the light, from u", examples=[45])


class GeometrySpec(RecipeModel):
    """A geometry with a name, for reports, targets, fits, tolerances and sweeps."""

    forms: ClassVar[tuple[str, ...]] = ('{name = "door", at = "45as60az125.3"}',)

    name: str = Field(min_length=1, max_length=80, description="name", examples=["door"])
    at: str = Field(
        description="geometry as in targets: IasA or IasAazZ (light from I, viewer A degrees from the mirror "
        "direction, turned about it by Z), specular T, transmitted T, diffuse T or hemispherical T",
        examples=["45as60az125.3"],
    )


class StudySpec(RecipeModel):
    """Tables that a recipe of any family may hold."""

    geometry: list[GeometrySpec] = Field(
        default=[],
        description="geometries by name, for reports, targets, fits, tolerances and sweeps",
        examples=[[{"name": "door", "at": "45as60az125.3"}]],
    )

    numbers: dict[str, float] = Field(
        default={},
        description="named numbers for formulas; these also use `t`, the time of an animation: 0 at its start and in "
        "stills, 1 at its end",
        examples=[{"drain": 0.4}],
    )
    fit: Annotated[dict[str, Any], ByPath(BoundsSpec)] = Field(
        default={},
        description="parameters of `nacre fit`: path of the number -> its bounds",
        examples=[{"layers[0].thickness_nm": {"min": 100, "max": 600}}],
    )
    ties: dict[str, str] = Field(
        default={},
        description="numbers that a fit computes from others: path -> an expression with + - * / and paths",
        examples=[{"layers[2].thickness_nm": "layers[0].thickness_nm"}, {"layers[1].thickness_nm": "2*numbers.d + 5"}],
    )
    instrument: InstrumentSpec = Field(
        default=InstrumentSpec(),
        description="averages and offset of the ellipsometer, for fits and `nacre ellipsometry`",
    )
    correlation: list[CorrelationSpec] = Field(
        default=[],
        description="correlation matrices of the deviations in [tolerance]",
        examples=[[{"of": ["layers[*].thickness_nm"], "matrix": [[1, 0.8], [0.8, 1]]}]],
    )
    tolerance: Annotated[
        dict[str, Any],
        ByPath(
            ToleranceSpec, ({"type": "number", "minimum": 0}, {"type": "string", "pattern": "%?$"}, {"type": "array"})
        ),
    ] = Field(
        default={},
        description="manufacturing tolerances for `nacre tolerance`: path of the number -> a deviation, a percentage, "
        "a table, or a list of tables whose deviations add",
        examples=[{"layers[0].thickness_nm": {"percent": 2}}, {"layers[0].thickness_nm": 5}],
    )


def known_only(entry: Any, model: type[RecipeModel], where: str) -> None:
    """Refuse a key that an entry's table does not have.

    Raises:
        RecipeError: naming the key, with a suggestion.
    """
    for key in entry if isinstance(entry, Mapping) else ():
        if key not in model.model_fields:
            known = ", ".join(model.model_fields)
            hint = renamed_hint(str(key), model.model_fields) or did_you_mean(str(key), model.model_fields)
            raise RecipeError(f"{where}.{key} is not known.{hint} Keys: {known}")


def with_options(table: Mapping[str, Any], options: Iterable[tuple[str, Any]], name: str) -> dict[str, Any]:
    """Return path -> entry of a table, overridden by a command's options, also by those with `[*]`.

    Args:
        name: option name, for messages.

    Raises:
        RecipeError: a path is given twice.
    """
    from_options: dict[str, Any] = {}
    for path, entry in options:
        if path in from_options:
            raise RecipeError(f"{name} {path} is given twice; keep one")
        from_options[path] = entry
    named = [re.compile(r"\[(?:\d+|\*)\]".join(map(re.escape, path.split(EVERY))) + "$") for path in from_options]
    return {p: e for p, e in table.items() if not any(one.match(p) for one in named)} | from_options


def by_path(table: Any, own_keys: frozenset[str] | set[str], source: str, name: str) -> dict[str, Any]:
    """Return path -> entry; an unquoted path such as `surface.roughness` is a nested table in TOML.

    Args:
        table: the recipe's table.
        own_keys: a table with one of these keys is an entry, not a part of a path.
        source, name: names of file and table, for messages.

    Raises:
        RecipeError: it is not a table, or a part of it is empty.
    """
    if not isinstance(table, Mapping):
        raise RecipeError(f"{source}: {name} = {show_value(table)} should be a table")
    expanded: dict[str, Any] = {}
    for key, value in table.items():
        if not isinstance(value, Mapping) or set(value) & own_keys:
            expanded[str(key)] = value
        elif not value:
            raise RecipeError(f"{source}: {name}.{key} is empty")
        else:
            inner = by_path(value, own_keys, source, f"{name}.{key}")
            expanded |= {f"{key}.{path}": entry for path, entry in inner.items()}
    return expanded
