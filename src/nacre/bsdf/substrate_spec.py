"""Recipe keys of a base below strata, and of interface roughness."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pydantic

from nacre.bsdf.facet_distributions import SMOOTH_BELOW, Roughness, check_widths
from nacre.bsdf.substrate import Strata, Substrate
from nacre.core.errors import RecipeError
from nacre.matter.indices.constant import OpticalConstant
from nacre.matter.indices.spec import IndexSpec
from nacre.readers.curves import FileSpec, recipe_spectrum
from nacre.recipe.model import RecipeContext, RecipeModel, show_value

Share = Annotated[float, pydantic.Field(ge=0.0, le=1.0)]


OF_OTHER_FAMILY: Mapping[str, Any] = {
    "type": "object",
    "required": ["family"],
    "properties": {"family": {"type": "string", "description": "a stratum of another family, with that one's keys"}},
}


def _widths(value: Any) -> Any:
    check_widths(value, "alpha or [alpha_x, alpha_y]", show_value(value))
    return value


Widths = Annotated[
    Share | Annotated[tuple[Share, ...], pydantic.Field(min_length=1, max_length=2)], pydantic.BeforeValidator(_widths)
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

    albedo: Share | AlbedoSpec | None = pydantic.Field(
        default=None,
        description="albedo of a diffuse base, or a file with the albedo over wavelength",
        examples=[0.05, {"file": "albedo.csv"}],
    )
    material: IndexSpec | None = pydantic.Field(default=None, description="a metal base instead of a diffuse one")
    recipe: str | dict[str, Any] | None = pydantic.Field(
        default=None,
        description="another opaque recipe of any family as the base, by its file or as a table; without an ambient "
        "of its own it is built in the resin. Its strata (pearl, glass) continue below these, with their own base",
        examples=["film.toml"],
    )
    none: bool = pydantic.Field(default=False, description="open lower side: light passes", examples=[True])
    roughness: Widths = pydantic.Field(
        default=0.0, description="alpha of the metal, or [alpha_x, alpha_y]; 0 is smooth", examples=[0.2, [0.05, 0.2]]
    )
    distribution: Literal["ggx", "beckmann"] = pydantic.Field(
        default="ggx", description="distribution of the metal's facet normals"
    )
    compensate: bool = pydantic.Field(
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

    @pydantic.model_validator(mode="after")
    def _one_kind(self) -> SubstrateSpec:
        given = [k for k in ("albedo", "material", "recipe") if getattr(self, k) is not None] + ["none"] * self.none
        if len(given) > 1:
            raise ValueError(f"gives {' and '.join(given)}; give one of albedo, material, recipe, none = true")
        if isinstance(self.recipe, Mapping) and "family" not in self.recipe:
            raise ValueError("recipe has no family; it should be a file's name, or a table with the keys of a recipe")
        if self.recipe is not None and self.roughness != 0.0:
            raise ValueError("roughness of a base recipe belongs in that recipe")
        return self

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
    said = message.removeprefix(f"{source}: ")
    if first is None:
        return f"{source}: base.recipe: {said}"
    if said.startswith("key strata is not known"):
        family = show_value(table["family"])
        return f"{source}: strata[{first}].family = {family} is not allowed; it should be a family made of strata"
    if said.startswith("family = "):
        return f"{source}: strata[{first}].{said}"
    moved = re.sub(r"^((?:key )?strata\[)(\d+)\]", lambda found: f"{found[1]}{int(found[2]) + first}]", said)
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
