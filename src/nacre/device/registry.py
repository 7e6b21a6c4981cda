"""Which plugin class renders which kind of lobe: the only list of Mitsuba plugins.

A new lobe joins with one line here and one in `nacre.bsdf.registry`; a lobe of another package names its plugin in
its entry point. No plugin imports this file: one that holds other lobes is passed `make_plugin`.
"""

from __future__ import annotations

import importlib
from typing import Any

from nacre.bsdf.contract import Lobe
from nacre.bsdf.registry import outside_lobe
from nacre.device.base import LobePlugin
from nacre.errors import NacreError, UnsupportedError

PLUGINS: dict[str, str] = {
    # lobe kind -> "module:class", imported when first needed
    "specular": "nacre.device.lobes.specular:SpecularPlugin",
    "microfacet": "nacre.device.lobes.microfacet:MicrofacetPlugin",
    "diffuse": "nacre.device.lobes.diffuse:DiffusePlugin",
    "ridge": "nacre.device.lobes.ridge:RidgePlugin",
    "table": "nacre.device.lobes.table:TablePlugin",
    "harmonic": "nacre.device.lobes.harmonic:HarmonicPlugin",
    "aligned": "nacre.device.lobes.aligned:AlignedPlugin",
    "aligned-specular": "nacre.device.lobes.aligned_specular:AlignedSpecularPlugin",
    "spectrum-map": "nacre.device.lobes.spectrum_map:SpectrumMapPlugin",
    "layered": "nacre.device.lobes.layered:LayeredPlugin",
    "flaked": "nacre.device.lobes.flaked:FlakedPlugin",
    "masked": "nacre.device.lobes.masked:MaskedPlugin",
}


def plugin_class(kind: str) -> type[LobePlugin[Any]]:
    """Return the class that renders a lobe kind, importing its module.

    Raises:
        UnsupportedError: no plugin renders this kind.
        NacreError: another package registers this kind, but not with a `LobePlugin`.
    """
    if kind in PLUGINS:
        module, name = PLUGINS[kind].split(":")
        cls: type[LobePlugin[Any]] = getattr(importlib.import_module(module), name)
        return cls
    try:
        outside = outside_lobe(kind).twin()
    except KeyError:
        known = ", ".join(PLUGINS)
        raise UnsupportedError(f'no Mitsuba plugin renders a lobe of kind "{kind}"; known: {known}') from None
    if not (isinstance(outside, type) and issubclass(outside, LobePlugin)):
        raise NacreError(f'the Mitsuba plugin of the lobe "{kind}" is not a LobePlugin')
    return outside


def make_plugin(lobe: Lobe) -> LobePlugin[Any]:
    """Put one lobe on the device of the current variant.

    Raises:
        UnsupportedError: no plugin renders this kind.
    """
    cls: Any = plugin_class(lobe.kind)
    plugin: LobePlugin[Any] = cls(lobe, make_plugin) if cls.holds_lobes else cls(lobe)
    return plugin
