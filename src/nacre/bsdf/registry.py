"""Which class is which kind of lobe: the only list of lobes.

A new lobe joins with one line here and one in `nacre.device.bsdf`, or from another package by an entry point of
the group `nacre.lobes`. No lobe and no Mitsuba plugin imports this file.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from nacre.bsdf.lobe import Lobe
from nacre.core.errors import NacreError
from nacre.core.lazy import entry_points

GROUP = "nacre.lobes"
LOBES: dict[str, str] = {
    # kind -> "module:class", imported when first needed
    "specular": "nacre.bsdf.lobes.specular:Specular",
    "microfacet": "nacre.bsdf.lobes.microfacet:Microfacet",
    "diffuse": "nacre.bsdf.lobes.diffuse:Diffuse",
    "ridge": "nacre.bsdf.lobes.ridge:Ridge",
    "table": "nacre.bsdf.lobes.table:TableLobe",
    "harmonic": "nacre.bsdf.lobes.monolayer:Harmonic",
    "aligned": "nacre.bsdf.lobes.monolayer:Aligned",
    "aligned-specular": "nacre.bsdf.lobes.specular:AlignedSpecular",
    "spectrum-map": "nacre.bsdf.lobes.spectrum_map:SpectrumMap",
    "layered": "nacre.bsdf.lobes.layered:Layered",
    "flaked": "nacre.bsdf.lobes.platelet_layer:Flaked",
    "masked": "nacre.bsdf.lobes.masked:MaskedLobe",
}


@dataclass(frozen=True)
class LobeEntry:
    """What an entry point of `nacre.lobes` leads to; the entry point's name is the lobe's kind.

    Attributes:
        lobe: the class of its arrays.
        twin: returns the `LobePlugin` class of its Mitsuba plugin; imports Mitsuba, so it is called late.
        sample: returns a small lobe of this kind, for the tests that every lobe has to pass.
    """

    lobe: type[Lobe]
    twin: Callable[[], type[Any]]
    sample: Callable[[], Lobe]


def lobe_kinds() -> tuple[str, ...]:
    """Return all kinds, those of other packages last."""
    return (*LOBES, *entry_points(GROUP, LOBES))


def lobe_class(kind: str) -> type[Lobe]:
    """Return the class of a lobe kind, importing its module.

    Raises:
        KeyError: no such kind.
        NacreError: two packages register a lobe of this kind, or one registers something else.
    """
    if kind in LOBES:
        module, name = LOBES[kind].split(":")
        cls: type[Lobe] = getattr(import_module(module), name)
        return cls
    return outside_lobe(kind).lobe


def outside_lobe(kind: str) -> LobeEntry:
    """Return what another package says of its lobe.

    Raises:
        KeyError: no package registers this kind.
        NacreError: its entry point cannot be loaded, or is no `LobeEntry`.
    """
    found = entry_points(GROUP, LOBES)[kind].load()
    if not isinstance(found, LobeEntry) or found.lobe.kind != kind:
        raise NacreError(f'entry point "{kind}" of {GROUP} is not a LobeEntry of a lobe of kind "{kind}"')
    return found
