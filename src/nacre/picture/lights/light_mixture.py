"""Several lights at once: what a user writes, and the environments of all of them as one.

Mitsuba takes one environment per scene; here one emitter is the sum of several, each with its own strength. A direction
is drawn from one of them, by their powers, and its density is that of the mixture, so that every one of them can be
found however small it is.
"""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from nacre.core.errors import NacreError
from nacre.device.variant import use_variant
from nacre.picture.lights.environment_plugin import FAR, thrown_ray

MAX_STRENGTH = 1e4
MAX_TURN_DEG = 36_000.0
BELOW_ONE = 1.0 - 2.0**-24  # the largest single-precision number below 1
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_MARKS = re.compile(rf"(?P<name>.+?)(?P<marks>(?:[:@]{_NUMBER})*)\Z")


@dataclass(frozen=True)
class Lamp:
    """One light of a picture: its name or environment map, how strong it is, and how far it is turned (degrees)."""

    name: str
    strength: float = 1.0
    turn_deg: float = 0.0

    def __str__(self) -> str:
        strength = "" if self.strength == 1.0 else f":{self.strength:g}"
        return f"{self.name}{strength}" + (f"@{self.turn_deg:g}" if self.turn_deg else "")


def read_lamps(light: str | Sequence[str]) -> tuple[Lamp, ...]:
    """Read "studio:0.5,sun@120": lights with their strengths (`:`) and turns about the vertical axis (`@`, degrees).

    Raises:
        NacreError: no name, a strength that is not above 0, a turn that is no usable angle, a light named twice.
    """
    parts = light.split(",") if isinstance(light, str) else list(light)
    lamps = tuple(_lamp(str(part).strip()) for part in parts)
    for index, lamp in enumerate(lamps):
        if lamp in lamps[:index]:
            raise NacreError(f'light "{lamp}" is named twice; give it once, with a strength such as {lamp.name}:2')
    if not lamps:
        raise NacreError("light: none is named; give one or several, such as studio:0.5,sun@120")
    return lamps


def _lamp(text: str) -> Lamp:
    found = _MARKS.match(text)
    if found is None:
        raise NacreError(f'light "{text}" has no name; write lights like studio:0.5,sun@120')
    marks = re.findall(rf"([:@])({_NUMBER})", found["marks"])
    if len({sign for sign, _ in marks}) < len(marks):
        raise NacreError(f'light "{text}" has two strengths or two turns; write it like studio:0.5@120')
    values = {sign: float(number) for sign, number in marks}
    strength, turn = values.get(":", 1.0), values.get("@", 0.0)
    if not 0.0 < strength <= MAX_STRENGTH:
        raise NacreError(f'light "{text}": a strength is a number above 0, up to {MAX_STRENGTH:g}')
    if not math.isfinite(turn) or abs(turn) > MAX_TURN_DEG:
        raise NacreError(f'light "{text}": a turn is an angle in degrees, up to {MAX_TURN_DEG:g}')
    return Lamp(found["name"], strength, turn)


def sum_of_environments(parts: Sequence[tuple[Any, float]]) -> Any:
    """Return one environment `mi.Emitter` that shines as all of these, each times its strength."""
    if len(parts) == 1 and parts[0][1] == 1.0:
        return parts[0][0]
    mi = use_variant()
    return _sum_class(mi.variant())(mi.Properties(), [emitter for emitter, _ in parts], [s for _, s in parts])


@functools.cache
def _sum_class(variant: str) -> type:
    """Define the class for a variant: Mitsuba's base class differs from variant to variant."""
    import drjit as dr

    mi: Any = use_variant()
    is_scalar = variant.startswith("scalar")

    class NacreEnvironments(mi.Emitter):
        """The sum of several environments."""

        def __init__(self, properties: Any, parts: Sequence[Any], strengths: Sequence[float]) -> None:
            super().__init__(properties)
            self.parts, self.strengths = list(parts), [float(s) for s in strengths]
            # one or two strong lights must not starve the others: equal shares are never far from the best ones
            self.share = 1.0 / len(self.parts)
            self.m_flags = int(mi.EmitterFlags.Infinite | mi.EmitterFlags.SpatiallyVarying)
            self.m_needs_sample_3 = False

        def traverse(self, callback: Any) -> None:
            """Nothing of the sum itself can be changed."""

        def set_scene(self, scene: Any) -> None:
            for part in self.parts:
                part.set_scene(scene)

        def eval(self, si: Any, active: Any = True) -> Any:
            total = mi.Spectrum(0.0)
            for part, strength in zip(self.parts, self.strengths, strict=True):
                total = total + strength * part.eval(si, active)
            return total & active

        def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
            # which part: by the first number, which is stretched again over its own share
            slot = sample.x / self.share
            chosen = dr.minimum(mi.UInt32(slot), len(self.parts) - 1)
            sample = mi.Point2f(dr.clip(slot - mi.Float(chosen), 0.0, BELOW_ONE), sample.y)
            ds = mi.DirectionSample3f() if is_scalar else dr.zeros(mi.DirectionSample3f)
            for index, part in enumerate(self.parts):
                here, _ = part.sample_direction(it, sample, active & (chosen == index))
                ds = dr.select(chosen == index, here, ds)
            is_drawn = active & (ds.pdf > 0.0)
            # a part of Mitsuba's that is no light of the scene itself does not know how wide the scene is: what stands
            # farther away than its guess would throw no shadow
            ds.dist = 2.0 * (FAR + dr.norm(it.p))
            ds.p, ds.n = it.p + ds.d * ds.dist, -ds.d
            ds.delta = mi.Bool(False)
            ds.emitter = self if is_scalar else mi.EmitterPtr(self)
            ds.pdf = dr.select(is_drawn, self.pdf_direction(it, ds, is_drawn), 0.0)
            weight = self.eval_direction(it, ds, is_drawn) / dr.maximum(ds.pdf, 1e-12)
            return ds, weight & is_drawn & (ds.pdf > 0.0)

        def sample_ray(self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True) -> Any:
            return thrown_ray(self, mi.Point3f(0.0), mi.Float(FAR), time, (sample1, sample2, sample3), active)

        def sample_position(self, time: Any, sample: Any, active: Any = True) -> Any:
            # never used, but recorded for every lamp that lives, those of other scenes too
            return mi.PositionSample3f() if is_scalar else dr.zeros(mi.PositionSample3f), mi.Float(0.0)

        def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            total = mi.Float(0.0)
            for part in self.parts:
                total = total + self.share * part.pdf_direction(it, ds, active)
            return dr.select(active, total, 0.0)

        def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            total = mi.Spectrum(0.0)
            for part, strength in zip(self.parts, self.strengths, strict=True):
                total = total + strength * part.eval_direction(it, ds, active)
            return total & active

        def sample_wavelengths(self, si: Any, sample: Any, active: Any = True) -> Any:
            wavelengths, weight = mi.sample_rgb_spectrum(mi.sample_shifted(sample))
            si.wavelengths = wavelengths
            return wavelengths, self.eval(si, active) * weight

        def bbox(self) -> Any:
            return mi.ScalarBoundingBox3f()

        def to_string(self) -> str:
            return f"NacreEnvironments[{len(self.parts)}]"

    return NacreEnvironments
