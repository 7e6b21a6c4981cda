"""The `nacre` BSDF in Mitsuba scenes: registration in spectral variants, and loading from `{"type": "nacre", ...}`."""

import importlib.util
import itertools
import os
import weakref
from typing import Any, NoReturn

from nacre.bsdf import Bsdf
from nacre.core.errors import RecipeError, UnsupportedError
from nacre.device.bsdf import make_bsdf
from nacre.device.variant import RGB, VARIANTS, check_set_variant, import_mitsuba
from nacre.material.material import load

_installed = False
_registered: weakref.WeakValueDictionary[str, Bsdf] = weakref.WeakValueDictionary()
_numbers = itertools.count()


def install() -> None:
    """Register `nacre` in the current variant and whenever one is set; do nothing without mitsuba.

    Mitsuba registers plugins per variant, which may be set before or after `import nacre.render`.
    """
    global _installed
    if _installed or importlib.util.find_spec("mitsuba") is None:
        return
    mi = import_mitsuba()
    mi.detail.add_variant_callback(lambda _old, _new: register())
    _installed = True
    register()


def _refuse(properties: Any) -> NoReturn:
    """Explain why mono variants do not support `nacre`; Mitsuba would report "not found"."""
    import mitsuba as mi

    why = "nacre needs a spectral or an RGB variant, for a structural colour is a spectrum"
    raise UnsupportedError(f"{why}; this is {mi.variant()}. Use {', '.join(VARIANTS)}")


def register() -> None:
    """Register the `nacre` BSDF, or its refusal, in the current variant."""
    import mitsuba as mi

    if mi.variant() is not None:
        mi.register_bsdf("nacre", from_properties if mi.variant() in VARIANTS + RGB else _refuse)


def load_bsdf(path: str) -> Bsdf:
    """Load a recipe, a compiled file or a design folder.

    Raises:
        NacreError: unreadable or invalid file.
    """
    return Bsdf.load(path) if path.endswith(".nacre") else load(path).bsdf()


def register_bsdf(bsdf: Bsdf) -> str:
    """Register a Bsdf object and return its key for a scene dictionary: `{"type": "nacre", "bsdf": key}`.

    The reference is weak: the caller owns the object.
    """
    key = f"bsdf-{next(_numbers)}"
    _registered[key] = bsdf
    return key


def from_properties(properties: Any) -> Any:
    """Build a scene entry's BSDF; keys: recipe, file or bsdf; two_sided (default false), v_up (default true).

    A material that varies over the surface without `v_up` gives a warning, because v runs downward on some shapes.

    Raises:
        RecipeError: not exactly one source, an unregistered key, or a switch that is not a boolean.
        NacreError: unreadable or invalid file.
        MachineError: the current variant does not work on this machine.
    """
    import mitsuba as mi

    check_set_variant(str(mi.variant()))
    bsdf = _source(properties)
    two_sided, v_up = _switch(properties, "two_sided", False), _switch(properties, "v_up", True)
    if "v_up" not in properties and any(lobe.varying for lobe in bsdf.lobes):
        name = next((str(properties[key]) for key in ("recipe", "file", "bsdf") if key in properties), "nacre")
        mi.Log(
            mi.LogLevel.Warn,
            f"{name} varies over the surface, and v is taken to run upward. On shapes of type obj and sphere "
            "v runs downward: give the bsdf v_up = false there, or v_up = true to end this message",
        )
    return make_bsdf(bsdf, two_sided=two_sided, properties=properties, v_up=v_up)


def _source(properties: Any) -> Bsdf:
    stated = [key for key in ("recipe", "file", "bsdf") if key in properties]
    if len(stated) != 1:
        got = f"got {', '.join(stated)}" if stated else "got none"
        raise RecipeError(f'scene: a "nacre" BSDF needs exactly one of recipe, file, bsdf; {got}')
    value = str(properties[stated[0]])
    if stated[0] != "bsdf":
        return load_bsdf(_resolved(value))
    if value not in _registered:
        raise RecipeError(f'scene: bsdf = "{value}" is not registered; register the Bsdf and hold a reference to it')
    return _registered[value]


def _switch(properties: Any, key: str, default: bool) -> bool:
    """Read an optional boolean; the text "false" would count as true."""
    value = properties.get(key, default)
    if not isinstance(value, bool):
        raise RecipeError(f'scene: {key} = {value!r} of a "nacre" BSDF is not a boolean; write true or false')
    return value


def _resolved(path: str) -> str:
    """Resolve a relative path against the working folder, then against the folder of the scene file."""
    if os.path.isabs(path) or os.path.exists(path):
        return path
    import mitsuba as mi

    resolved = str(mi.file_resolver().resolve(path))
    return resolved if os.path.exists(resolved) else path
