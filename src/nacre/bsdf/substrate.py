"""The substrate below strata, its recipe keys, and strata of one material on strata of another.

Depths are in units of each stratum and indices are relative to the ambient, so strata are concatenated; tables on
different nodes are resampled to the finer nodes.
"""

from __future__ import annotations

import abc
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pydantic
from numpy.typing import NDArray
from pydantic import Field

from nacre.bsdf.compensation import interface_losses
from nacre.bsdf.facet_distributions import SMOOTH_BELOW, Roughness, check_widths
from nacre.bsdf.lobe import Lobe
from nacre.bsdf.lobes.layered import Layered
from nacre.core.arrays import Array, ComplexArray
from nacre.core.errors import NacreError, RecipeError, UnsupportedError
from nacre.matter.indices.constant import OpticalConstant
from nacre.matter.indices.spec import IndexSpec
from nacre.matter.stack.solve import powers
from nacre.readers.curves import FileSpec, recipe_spectrum
from nacre.recipe.model import RecipeContext, RecipeModel, UnitNumber, show_value


class Strata(abc.ABC):
    """A material solved by random walks in strata, on which strata of any family can lie."""

    @abc.abstractmethod
    def strata_at(self, wavelengths_nm: Array) -> Layered:
        """Return the strata and the base, also if the material's Bsdf has a noise-free form."""


def join_strata(upper: Layered, lower: Layered) -> Layered:
    """Place strata on other strata; the interface between them is the lower strata's upper interface.

    Args:
        upper: its own substrate is discarded.
        lower: the lower strata on the same wavelengths, with their substrate.

    Raises:
        UnsupportedError: the lower strata have glints.
    """
    if lower.glint_numbers is not None:
        raise UnsupportedError("has glints; only the uppermost stratum may have glints: leave them out")
    index = np.concatenate([upper.index, lower.index])
    alpha = np.concatenate([upper.alpha[:-1], lower.alpha])
    beckmann = np.concatenate([upper.is_beckmann[:-1], lower.is_beckmann])
    phase, quantile = _dye_tables(upper, lower)
    dye = None
    if upper.dye is not None or lower.dye is not None:
        dye = np.concatenate([_zeros_unless(part) for part in (upper, lower)])
    joined = replace(
        upper,
        index=index,
        alpha=alpha,
        is_beckmann=beckmann,
        flake_stratum=np.concatenate([upper.flake_stratum, lower.flake_stratum + upper.strata]),
        flake_number=np.concatenate([upper.flake_number, lower.flake_number]),
        flake_axes=np.concatenate([upper.flake_axes, lower.flake_axes]),
        flake_frame=np.concatenate([upper.flake_frame, lower.flake_frame]),
        flake_response=_joined(upper.flake_response, lower.flake_response, (1,)),
        flake_extinction=_joined(upper.flake_extinction, lower.flake_extinction, (1, 2)),
        base=lower.base,
        base_reflectance=lower.base_reflectance,
        base_lobes=lower.base_lobes,
        loss=interface_losses(_faces(upper, lower, alpha, beckmann), index, lower.base == "none"),
        dye=dye,
        dye_phase=phase,
        dye_quantile=quantile,
    )
    joined.check()
    return joined


def _faces(upper: Layered, lower: Layered, alpha: Array, beckmann: NDArray[np.int64]) -> list[Roughness]:
    """Return the interfaces with their compensation flags; only compensated interfaces have a loss."""
    flags: list[bool] = []
    for lobe in (upper, lower):
        known = np.zeros(lobe.strata + 1, dtype=bool) if lobe.loss is None else np.any(lobe.loss > 0, axis=(1, 2))
        flags.extend(bool(flag) for flag in (known[:-1] if lobe is upper else known))
    return [
        Roughness("beckmann" if beckmann[i] else "ggx", float(alpha[i, 0]), float(alpha[i, 1]), compensate=flag)
        for i, flag in enumerate(flags)
    ]


def _joined(first: Array, second: Array, axes: tuple[int, ...]) -> Array:
    """Concatenate flake tables on the finer nodes of the two."""
    if not len(first) or not len(second):
        return second if not len(first) else first
    for axis in axes:
        most = max(first.shape[axis], second.shape[axis])
        first, second = _resampled(first, axis, most), _resampled(second, axis, most)
    return np.concatenate([first, second])


def _resampled(table: Array, axis: int, count: int) -> Array:
    """Resample an axis of uniform nodes to `count` nodes."""
    have = table.shape[axis]
    if have == count:
        return table
    if have == 1:
        return np.repeat(table, count, axis=axis)
    place = np.linspace(0.0, have - 1.0, count)
    low = np.minimum(place.astype(int), have - 2)
    part = (place - low).reshape(-1, *([1] * (table.ndim - axis - 1)))
    below, above = np.take(table, low, axis=axis), np.take(table, low + 1, axis=axis)
    return np.asarray(below * (1 - part) + above * part)


def _zeros_unless(lobe: Layered) -> Array:
    return np.zeros((lobe.strata, len(lobe.wavelengths_nm), 2)) if lobe.dye is None else lobe.dye


def _dye_tables(upper: Layered, lower: Layered) -> tuple[Array | None, Array | None]:
    """Return phase functions and quantiles for all strata; a stratum without scattering gets isotropic, unused ones."""
    known = [lobe for lobe in (upper, lower) if lobe.dye_phase is not None and lobe.dye_quantile is not None]
    if not known:
        return None, None
    nodes = max(lobe.dye_phase.shape[1] for lobe in known if lobe.dye_phase is not None)
    draws = max(lobe.dye_quantile.shape[1] for lobe in known if lobe.dye_quantile is not None)
    phases, quantiles = [], []
    for lobe in (upper, lower):
        if lobe.dye_phase is None or lobe.dye_quantile is None:
            count = len(lobe.wavelengths_nm)
            phases.append(np.full((lobe.strata, nodes, count), 0.25 / np.pi))
            flat = np.linspace(-1.0, 1.0, draws)[None, :, None]
            quantiles.append(np.broadcast_to(flat, (lobe.strata, draws, count)))
            continue
        phase = _resampled(lobe.dye_phase, 1, nodes)
        # normalised as the random walk reads it: linear between nodes
        total = (phase.sum(axis=1) - 0.5 * (phase[:, 0] + phase[:, -1])) * 4 * np.pi / (nodes - 1)
        phases.append(phase / np.maximum(total, 1e-300)[:, None])
        quantiles.append(_resampled(lobe.dye_quantile, 1, draws))
    return np.concatenate(phases), np.concatenate(quantiles)


BASE_NODES = 129


@dataclass(frozen=True)
class Substrate:
    """The substrate below strata: diffuse, specular, lobes of another material, further strata, or open.

    Attributes:
        kind: "none", "diffuse", "specular", "lobes" or "strata".
        albedo: for "diffuse": a number, or (wavelengths_nm, albedo).
        metal: material for "specular".
        film: a solved opaque film for "specular": (wavelengths_nm, cos, reflectance[cos, wavelength]).
        surface: roughness of a specular substrate, or of the lower interface of an open stack.
        other: for "lobes", an opaque material of any family, built with the last resin as its ambient; for "strata", a
            material whose strata and substrate continue below.
        refuse: converts the reason why `other` is unusable to an error.
    """

    kind: str = "diffuse"
    albedo: float | tuple[Array, Array] = 0.0
    metal: OpticalConstant | None = None
    film: tuple[Array, Array, Array] | None = None
    surface: Roughness = Roughness()
    other: Any = None
    refuse: Callable[[str], NacreError] = UnsupportedError

    @cached_property
    def default_lobes(self) -> tuple[Lobe, ...]:
        """The other material's lobes on its own wavelengths."""
        return self.lobes(None)

    def known_in(self, grid: Array) -> Array:
        """Return a wavelength grid clipped to the other material's range."""
        if self.other is None:
            return grid
        known = self.other.model.wavelengths_nm if self.kind == "strata" else self.default_lobes[0].wavelengths_nm
        low, high = max(float(known[0]), grid[0]), min(float(known[-1]), grid[-1])
        return np.concatenate([[low], grid[(grid > low + 1e-6) & (grid < high - 1e-6)], [high]])

    def reflectance(self, wavelengths_nm: Array, medium: Callable[[Array], ComplexArray]) -> Array:
        """Return `Layered.base_reflectance`, `[cos, wavelength]`: one row of a diffuse albedo, or R.

        Args:
            wavelengths_nm: ascending.
            medium: index of the medium above as a function of wavelength; its absorption is ignored.
        """
        lam = wavelengths_nm
        if self.kind in ("none", "lobes", "strata"):
            return np.zeros((1, len(lam)))
        if self.kind == "diffuse":
            if isinstance(self.albedo, tuple):
                return np.interp(lam, *self.albedo)[None]
            return np.full((1, len(lam)), float(self.albedo))
        cos = np.linspace(0.0, 1.0, BASE_NODES)
        if self.film is not None:
            wavelengths, nodes, reflectance = self.film
            rows = np.stack([np.interp(lam, wavelengths, row) for row in reflectance])
            return np.stack([np.interp(cos, nodes, rows[:, i]) for i in range(len(lam))], axis=1)
        assert self.metal is not None
        n = np.stack([medium(lam).real + 0j, self.metal.n_complex(lam)])
        return powers(n, np.zeros(0), lam, cos_i=cos).reflectance

    @property
    def walk_kind(self) -> str:
        """The `Layered.base` value; strata count as open until `continued` adds them."""
        return "none" if self.kind == "strata" else self.kind

    def continued(self, strata: Layered) -> Layered:
        """Return the strata, followed by the other material's strata if the substrate is "strata".

        Raises:
            NacreError: the other strata are unusable below these.
        """
        if self.kind != "strata":
            return strata
        below = self.other.model.strata_at(strata.wavelengths_nm)
        try:
            return join_strata(strata, below)
        except UnsupportedError as error:
            raise self.refuse(str(error)) from None

    def lobes(self, wavelengths_nm: Array | None) -> tuple[Lobe, ...]:
        """Return the other material's lobes at given wavelengths.

        Raises:
            NacreError: the material transmits, or is itself solved by a random walk.
        """
        if self.other is None or self.kind == "strata":
            return ()
        lobes: tuple[Lobe, ...] = self.other.bsdf(wavelengths_nm).lobes
        if any(is_strata(lobe) for lobe in lobes):
            raise self.refuse(
                "contains a pearl or another walk, which cannot be a base: write its strata below these instead"
            )
        if any(lobe.transmits for lobe in lobes):
            raise self.refuse("lets light through; a base should be opaque, on a metal or with a base of its own")
        return lobes


def is_strata(lobe: Lobe) -> bool:
    """Whether a lobe, masked or not, consists of strata (a pearl, a photonic glass)."""
    inner = getattr(lobe, "inner", None)
    return lobe.kind in ("layered", "platelet-layer") or (inner is not None and is_strata(inner))


OF_OTHER_FAMILY: Mapping[str, Any] = {
    "type": "object",
    "required": ["family"],
    "properties": {"family": {"type": "string", "description": "a stratum of another family, with that one's keys"}},
}


def _widths(value: Any) -> Any:
    check_widths(value, "alpha or [alpha_x, alpha_y]", show_value(value))
    return value


Widths = Annotated[
    UnitNumber | Annotated[tuple[UnitNumber, ...], Field(min_length=1, max_length=2)],
    pydantic.BeforeValidator(_widths),
]


class AlbedoSpec(FileSpec):
    """A coloured base: a file with two columns, wavelength in nm and albedo."""

    noun: ClassVar[str] = ""  # used in one place
    shorthands: ClassVar[tuple[Mapping[str, Any], ...]] = ()
    forms: ClassVar[tuple[str, ...]] = ('{file = "albedo.csv"}',)


def _albedo_may_name_a_recipe(schema: dict[str, Any]) -> None:
    schema["properties"]["albedo"]["anyOf"].append({"type": "object", "required": ["recipe"]})


class SubstrateSpec(RecipeModel):
    """The base: a diffuse albedo, a metal, another recipe of any family, or an open lower side."""

    model_config = pydantic.ConfigDict(json_schema_extra=_albedo_may_name_a_recipe)

    albedo: UnitNumber | AlbedoSpec | None = Field(
        default=None,
        description="albedo of a diffuse base, or a file with the albedo over wavelength",
        examples=[0.05, {"file": "albedo.csv"}],
    )
    material: IndexSpec | None = Field(default=None, description="a metal base instead of a diffuse one")
    recipe: str | dict[str, Any] | None = Field(
        default=None,
        description="another opaque recipe of any family as the base, by its file or as a table; without an ambient "
        "of its own it is built in the resin. Its strata (pearl, glass) continue below these, with their own base",
        examples=["film.toml"],
    )
    none: bool = Field(default=False, description="open lower side: light passes", examples=[True])
    roughness: Widths = Field(
        default=0.0, description="alpha of the metal, or [alpha_x, alpha_y]; 0 is smooth", examples=[0.2, [0.05, 0.2]]
    )
    distribution: Literal["ggx", "beckmann"] = Field(
        default="ggx", description="distribution of the metal's facet normals"
    )
    compensate: bool = Field(
        default=False, description="restore the light scattered between the metal's facets", examples=[True]
    )

    @pydantic.model_validator(mode="before")
    @classmethod
    def _accept_nested(cls, data: Any) -> Any:
        # also accept albedo = {recipe = "..."}
        albedo = data.get("albedo") if isinstance(data, Mapping) else None
        if isinstance(albedo, Mapping) and "recipe" in albedo:
            data = {**{k: v for k, v in data.items() if k != "albedo"}, **albedo}
        return data

    def model_post_init(self, _: Any) -> None:
        keys = [k for k in ("albedo", "material", "recipe") if getattr(self, k) is not None] + ["none"] * self.none
        if len(keys) > 1:
            raise ValueError(f"gives {' and '.join(keys)}; give one of albedo, material, recipe, none = true")
        if isinstance(self.recipe, Mapping) and "family" not in self.recipe:
            raise ValueError("recipe has no family; it should be a file's name, or a table with the keys of a recipe")
        if self.recipe is not None and self.roughness != 0.0:
            raise ValueError("roughness of a base recipe belongs in that recipe")

    def build(self, context: RecipeContext, medium: OpticalConstant) -> Substrate:
        """Return the substrate below a medium, the last resin.

        Raises:
            RecipeError: an unusable albedo file or base recipe.
        """
        surface = interface_roughness(self.roughness, self.distribution, self.compensate)
        if self.none:
            return Substrate("none", surface=surface)
        if self.material is not None:
            return Substrate("specular", metal=self.material.build(context), surface=surface)
        if self.recipe is not None:
            return _recipe_base(self.recipe, medium, context)
        if isinstance(self.albedo, AlbedoSpec):
            table = recipe_spectrum(context, "base.albedo.file", self.albedo, ("albedo", "reflectance"))
            if not (np.all(np.diff(table[:, 0]) > 0) and np.all((table[:, 1] >= 0) & (table[:, 1] <= 1))):
                rule = "must hold ascending nm and albedos in [0, 1]; head a column in per cent '%'"
                raise context.fail("base.albedo.file", self.albedo.file, rule)
            return Substrate("diffuse", (table[:, 0], table[:, 1]))
        return Substrate("diffuse", 0.0 if self.albedo is None else self.albedo)


def interface_roughness(roughness: float | tuple[float, ...], distribution: str, compensate: bool) -> Roughness:
    """Return an interface's roughness from one or two widths; both are positive if one is."""
    widths = roughness if isinstance(roughness, tuple) else (roughness,)
    x, y = (0.0 if w < SMOOTH_BELOW else float(w) for w in (widths[0], widths[-1]))
    if (x == 0) != (y == 0):
        x, y = max(x, SMOOTH_BELOW), max(y, SMOOTH_BELOW)
    return Roughness(distribution, x, y, compensate=compensate)


class Below(list[Any]):
    """Strata listed below strata of another family.

    Attributes:
        first: index of the uppermost one in the recipe's list.
    """

    first: int = 0


def nested_strata(data: Any, family: str) -> Any:
    """Rewrite a recipe that lists strata of several families: from the first foreign stratum on they become the base.

    Args:
        data: the recipe's data.
        family: the recipe's family, and the default family of its strata.

    Raises:
        ValueError: the uppermost stratum belongs to another family.
    """
    strata = data.get("strata") if isinstance(data, Mapping) else None
    if not isinstance(strata, list | tuple) or not any(isinstance(s, Mapping) and "family" in s for s in strata):
        return data
    families = [s.get("family", family) if isinstance(s, Mapping) else family for s in strata]
    plain = [{k: v for k, v in s.items() if k != "family"} if isinstance(s, Mapping) else s for s in strata]
    other = next((i for i, name in enumerate(families) if name != family), None)
    if other is None:
        return {**data, "strata": plain}
    if other == 0:
        raise ValueError(
            f"strata[0].family = {show_value(families[0])} is not allowed; write that family at the top of the recipe, "
            f'and family = "{family}" into the strata of this family'
        )
    below = Below({**stratum, "family": name} for stratum, name in zip(plain[other:], families[other:], strict=True))
    below.first = other
    rest = {"family": families[other], "strata": below, **({"base": data["base"]} if "base" in data else {})}
    return {**data, "strata": plain[:other], "base": {"recipe": rest}}


def _placed(message: str, table: Mapping[str, Any], first: int | None, source: str) -> str:
    """Return a nested recipe's error message with its position in the outer recipe.

    Args:
        message: the inner recipe's message, with strata counted from 0.
        table: the inner recipe.
        first: index of its uppermost stratum in the outer list; unset for a base table.
        source: the outer recipe's name, the start of the message.
    """
    text = message.removeprefix(f"{source}: ")
    if first is None:
        return f"{source}: base.recipe: {text}"
    if text.startswith("key strata is not known"):
        family = show_value(table["family"])
        return f"{source}: strata[{first}].family = {family} is not allowed; it should be a family made of strata"
    if text.startswith("family = "):
        return f"{source}: strata[{first}].{text}"
    moved = re.sub(r"^((?:key )?strata\[)(\d+)\]", lambda match: f"{match[1]}{int(match[2]) + first}]", text)
    return f"{source}: {moved}"


def _recipe_base(name: str | dict[str, Any], medium: OpticalConstant, context: RecipeContext) -> Substrate:
    """Return another recipe as substrate in the last medium: a uniform film by its reflectance, others by lobes."""
    if context.load_recipe is None:
        raise context.fail("base.recipe", name, "cannot be loaded here; load the recipe from its file")
    strata = name.get("strata") if isinstance(name, dict) else None
    number = strata.first if isinstance(strata, Below) else None
    try:
        other = context.recipe(name, ambient=medium.without_absorption())
    except RecipeError as error:
        if isinstance(name, str):
            raise
        raise RecipeError(_placed(str(error), name, number, context.source)) from None
    if isinstance(other.model, Strata):
        if number is not None:
            return Substrate(
                "strata", other=other, refuse=lambda why: RecipeError(f"{context.source}: strata[{number}] {why}")
            )
        return Substrate("strata", other=other, refuse=lambda why: context.fail("base.recipe", name, why))
    if not other.model.traits.takes_ambient:
        raise context.fail("base.recipe", name, "is compiled for an unknown medium; give its recipe")
    base = Substrate("lobes", other=other, refuse=lambda why: context.fail("base.recipe", name, why))
    if not other.model.traits.is_quick:  # slow models are solved on demand
        return base
    first: Any = base.default_lobes[0]
    if len(base.default_lobes) > 1 or first.kind not in ("specular", "microfacet") or first.varying:
        return base
    film = (first.wavelengths_nm, first.response.cos_outside, first.response.reflectance)
    if first.kind == "specular":
        return Substrate("specular", film=film)
    is_plain = first.alpha_texture is None and first.rotation is None and first.loss is None
    if not is_plain or first.distribution not in ("ggx", "beckmann"):
        return base
    return Substrate("specular", film=film, surface=Roughness(first.distribution, first.alpha_x, first.alpha_y))
