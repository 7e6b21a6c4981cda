"""The registration of the `nacre` BSDF with Mitsuba, in every variant that carries spectra, whoever sets it."""

from __future__ import annotations

import contextlib
import importlib.util
import itertools
import os
import weakref
from collections.abc import Iterator
from typing import Any, NoReturn

from nacre.bsdf import Bsdf
from nacre.core.errors import NacreError, RecipeError, UnsupportedError
from nacre.device.bsdf import make_bsdf
from nacre.device.variant import VARIANTS, check_set_variant, import_mitsuba
from nacre.material.material import load

_installed = False


def install() -> None:
    """Register `nacre` now if a variant is set, and again whenever one is chosen; without mitsuba do nothing.

    Mitsuba keeps plugins by variant, and a user may set one before or after `import nacre.render`.
    """
    global _installed
    if _installed or importlib.util.find_spec("mitsuba") is None:
        return
    mi = import_mitsuba()
    mi.detail.add_variant_callback(lambda _old, _new: register())
    _installed = True
    register()


def _refuse(properties: Any) -> NoReturn:
    """Say why an RGB, mono or polarised scene holds no `nacre`, where Mitsuba would say "not found"."""
    import mitsuba as mi

    variant = str(mi.variant())
    if "spectral" in variant and "polarized" in variant:
        why = "nacre's BSDFs are for unpolarised light"
    else:
        why = "nacre needs a spectral variant, for a structural colour is a spectrum"
    raise UnsupportedError(f"{why}; this is {variant}. Use {', '.join(VARIANTS)}")


def register() -> None:
    """Register the `nacre` BSDF with the current variant, or what refuses it where values are not plain spectra."""
    import mitsuba as mi

    if mi.variant() not in VARIANTS:
        if mi.variant() is not None:
            mi.register_bsdf("nacre", _refuse)
        return
    mi.register_bsdf("nacre", from_properties)


# From a scene's `{"type": "nacre", ...}` to a BSDF: how recipes enter Mitsuba's scenes.

_handed_over: weakref.WeakValueDictionary[str, Bsdf] = weakref.WeakValueDictionary()
_numbers = itertools.count()
_failures: list[NacreError] = []


def load_bsdf(path: str) -> Bsdf:
    """Load a recipe, a compiled file or a design folder.

    Raises:
        NacreError: the file cannot be read or is not valid.
    """
    return Bsdf.load(path) if path.endswith(".nacre") else load(path).bsdf()


def register_bsdf(bsdf: Bsdf) -> str:
    """Return a key under which a scene dictionary may name a Bsdf object: `{"type": "nacre", "bsdf": key}`.

    The table holds the object weakly: it lives as long as the caller keeps it.
    """
    key = f"bsdf-{next(_numbers)}"
    _handed_over[key] = bsdf
    return key


@contextlib.contextmanager
def clear_errors() -> Iterator[None]:
    """Turn what Mitsuba makes of an error while loading a scene back into one line.

    Mitsuba wraps an error of a plugin into a RuntimeError that holds the whole traceback.

    Raises:
        NacreError: the error of our own plugin, else the first line of what Mitsuba said.
    """
    _failures.clear()
    try:
        yield
    except RuntimeError as error:
        if _failures:
            raise _failures[0] from None
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        raise RecipeError(f"scene: {' '.join(lines[:2]) or 'cannot be loaded'}") from None


def from_properties(properties: Any) -> Any:
    """Build the BSDF of a scene entry; keys: one of recipe, file, bsdf; two_sided (default false), v_up (default true).

    Raises:
        RecipeError: none or several sources are given, the key of a handed-over Bsdf is not known, or a switch is no
            boolean.
        NacreError: the file cannot be read or is not valid.
        MachineError: the variant that is set does not work on this machine.
    """
    try:
        import mitsuba as mi

        check_set_variant(str(mi.variant()))
        return _from_properties(properties)
    except NacreError as error:
        _failures.append(error)
        raise


def _from_properties(properties: Any) -> Any:
    given = [key for key in ("recipe", "file", "bsdf") if key in properties]
    if len(given) != 1:
        got = f"got {', '.join(given)}" if given else "got none"
        raise RecipeError(f'scene: a "nacre" BSDF needs exactly one of recipe, file, bsdf; {got}')
    value = str(properties[given[0]])
    two_sided, v_up = _switch(properties, "two_sided", False), _switch(properties, "v_up", True)
    if given[0] == "bsdf":
        if value not in _handed_over:
            raise RecipeError(f'scene: bsdf = "{value}" was not handed over, or its Bsdf object is gone')
        bsdf = _handed_over[value]
    else:
        bsdf = load_bsdf(_resolved(value))
    return make_bsdf(bsdf, two_sided=two_sided, properties=properties, v_up=v_up)


def _switch(properties: Any, key: str, default: bool) -> bool:
    """Read a boolean that may be left out; the text "false" would count as true."""
    value = properties.get(key, default)
    if not isinstance(value, bool):
        raise RecipeError(f'scene: {key} = {value!r} of a "nacre" BSDF is no boolean; write true or false')
    return value


def _resolved(path: str) -> str:
    """Find a relative path from the working folder, else as Mitsuba finds textures: beside the scene's file."""
    if os.path.isabs(path) or os.path.exists(path):
        return path
    import mitsuba as mi

    found = str(mi.file_resolver().resolve(path))
    return found if os.path.exists(found) else path
