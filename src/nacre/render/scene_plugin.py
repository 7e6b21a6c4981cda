"""The registration of the `nacre` BSDF with Mitsuba, in every variant that carries spectra, whoever sets it."""

from __future__ import annotations

import importlib.util
from typing import Any, NoReturn

from nacre.device.variant import VARIANTS, import_mitsuba
from nacre.errors import UnsupportedError
from nacre.render.loader import from_properties

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
