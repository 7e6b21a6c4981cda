"""Registry of material families.

A family joins with a line here, or from another package by an entry point in the group `nacre.families` to its recipe
model. Families do not import this file.
"""

from importlib import import_module

from nacre.core.errors import NacreError, RecipeError, did_you_mean
from nacre.core.lazy import entry_points
from nacre.recipe.model import RecipeModel, show_value

GROUP = "nacre.families"
FAMILIES: dict[str, str] = {
    # family name -> "module:class" of its recipe model, imported on first use
    "film": "nacre.families.film.spec:FilmSpec",
    "pearl": "nacre.families.pearl.spec:PearlSpec",
    "metasurface": "nacre.families.metasurface.spec:MetasurfaceSpec",
    "glass": "nacre.families.glass.spec:GlassSpec",
    "relief": "nacre.families.relief.spec:ReliefSpec",
    "grating": "nacre.families.grating.spec:GratingSpec",
    "measured": "nacre.families.measured:MeasuredSpec",
    "blend": "nacre.families.blend:BlendSpec",
}


def family_names() -> tuple[str, ...]:
    """Return all families, with other packages last."""
    return (*FAMILIES, *entry_points(GROUP, FAMILIES))


def family_spec(family: object, source: str) -> type[RecipeModel]:
    """Import and return a family's recipe model, with a method `build(context)` for its material.

    Raises:
        RecipeError: the family is missing or unknown.
        NacreError: two packages register this family, or the entry point is not a recipe model.
    """
    known = ", ".join(FAMILIES)
    if family is None:
        raise RecipeError(f"{source}: family is missing; give one of {known}")
    if isinstance(family, str) and family in FAMILIES:
        module, name = FAMILIES[family].split(":")
        spec: type[RecipeModel] = getattr(import_module(module), name)
        return spec
    names = family_names()
    if not isinstance(family, str) or family not in names:
        hint = did_you_mean(family, names) if isinstance(family, str) else ""
        raise RecipeError(f"{source}: family = {show_value(family)} is not known.{hint} Families: {', '.join(names)}")
    entry = entry_points(GROUP, FAMILIES)[family].load()
    if not (isinstance(entry, type) and issubclass(entry, RecipeModel)):
        raise NacreError(f'entry point "{family}" of {GROUP} is not a RecipeModel')
    return entry
