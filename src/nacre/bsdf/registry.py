"""The registry of lobe classes.

A new lobe needs one line here and one in `nacre.device.bsdf`, or an entry point in the group `nacre.lobes` of another
package. Lobes and Mitsuba plugins do not import this file.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from nacre.bsdf.lobe import Lobe
from nacre.core.errors import NacreError
from nacre.core.lazy import entry_points

GROUP = "nacre.lobes"
LOBES: dict[str, str] = {
    # kind -> "module:class", imported on first use
    "specular": "nacre.bsdf.lobes.interface:Specular",
    "microfacet": "nacre.bsdf.lobes.interface:Microfacet",
    "aligned-microfacet": "nacre.bsdf.lobes.interface:AlignedMicrofacet",
    "diffuse": "nacre.bsdf.lobes.interface:Diffuse",
    "ridge": "nacre.bsdf.lobes.ridge:Ridge",
    "ridge-table": "nacre.bsdf.lobes.ridge:RidgeTable",
    "table": "nacre.bsdf.lobes.table:TableLobe",
    "harmonic": "nacre.bsdf.lobes.monolayer:Harmonic",
    "aligned": "nacre.bsdf.lobes.monolayer:Aligned",
    "aligned-specular": "nacre.bsdf.lobes.interface:AlignedSpecular",
    "spectrum-map": "nacre.bsdf.lobes.spectrum_map:SpectrumMap",
    "layered": "nacre.bsdf.lobes.layered:Layered",
    "platelet-layer": "nacre.bsdf.lobes.platelet_layer:PlateletLayer",
    "orders": "nacre.bsdf.lobes.orders:OrdersLobe",
    "masked": "nacre.bsdf.lobes.masked:MaskedLobe",
}


@dataclass(frozen=True)
class LobeEntry:
    """The object behind an entry point in `nacre.lobes`, whose name is the lobe's kind.

    Attributes:
        lobe: the lobe class.
        twin: returns the `LobePlugin` class of its Mitsuba plugin; imports Mitsuba, so it is called late.
        sample: returns a small lobe of this kind for the common lobe tests.
    """

    lobe: type[Lobe]
    twin: Callable[[], type[Any]]
    sample: Callable[[], Lobe]


def lobe_class(kind: str) -> type[Lobe]:
    """Return the class of a lobe kind, importing its module.

    Raises:
        KeyError: unknown kind.
        NacreError: two packages register this kind, or one registers an invalid object.
    """
    if kind in LOBES:
        module, name = LOBES[kind].split(":")
        cls: type[Lobe] = getattr(import_module(module), name)
        return cls
    return outside_lobe(kind).lobe


def outside_lobe(kind: str) -> LobeEntry:
    """Return another package's entry for a lobe kind.

    Raises:
        KeyError: unregistered kind.
        NacreError: the entry point cannot be loaded, or is not a `LobeEntry`.
    """
    entry = entry_points(GROUP, LOBES)[kind].load()
    if not isinstance(entry, LobeEntry) or entry.lobe.kind != kind:
        raise NacreError(f'entry point "{kind}" of {GROUP} is not a LobeEntry of a lobe of kind "{kind}"')
    return entry
