"""Several lights in one picture: their notation, and one emitter for several environments.

Mitsuba accepts one environment per scene. The mixture samples a direction from one part and uses the mixture
density, therefore every part is sampled, however small.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from nacre.core.errors import NacreError
from nacre.picture.lights.environment_plugin import FAR, DistantEmitter
from nacre.picture.plugin import dr, make_plugin, mi

MAX_STRENGTH = 1e4
MAX_TURN_DEG = 36_000.0
BELOW_ONE = 1.0 - 2.0**-24  # largest single-precision number below 1
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_MARKS = re.compile(rf"(?P<name>.+?)(?P<marks>(?:[:@]{_NUMBER})*)\Z")


@dataclass(frozen=True)
class Lamp:
    """One light: name or environment map, strength, and turn in degrees."""

    name: str
    strength: float = 1.0
    turn_deg: float = 0.0

    def __str__(self) -> str:
        strength = "" if self.strength == 1.0 else f":{self.strength:g}"
        return f"{self.name}{strength}" + (f"@{self.turn_deg:g}" if self.turn_deg else "")


def read_lamps(light: str | Sequence[str]) -> tuple[Lamp, ...]:
    """Read "studio:0.5,sun@120": lights with strengths (`:`) and turns about the vertical axis (`@`, degrees).

    Raises:
        NacreError: a missing name, a bad strength or turn, a light named twice.
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
    """Return one environment `mi.Emitter` for the given emitters and strengths."""
    if len(parts) == 1 and parts[0][1] == 1.0:
        return parts[0][0]
    return make_plugin(NacreEnvironments, parts)


class NacreEnvironments(DistantEmitter):
    """Several environments, summed."""

    def set_up(self, parts: Sequence[tuple[Any, float]]) -> None:
        DistantEmitter.set_up(self)
        self.parts, self.strengths = [part for part, _ in parts], [float(strength) for _, strength in parts]
        self.share = 1.0 / len(self.parts)  # equal shares, because a strong part must not starve the others

    def set_scene(self, scene: Any) -> None:
        for part in self.parts:
            part.set_scene(scene)

    def _sum(self, values: Sequence[Any], active: Any) -> Any:
        total = mi.Spectrum(0.0)
        for value, strength in zip(values, self.strengths, strict=True):
            total = total + strength * value
        return total & active

    def eval(self, si: Any, active: Any = True) -> Any:
        return self._sum([part.eval(si, active) for part in self.parts], active)

    def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
        # the first number selects the part and is then stretched to [0, 1)
        slot = sample.x / self.share
        chosen = dr.minimum(mi.UInt32(slot), len(self.parts) - 1)
        sample = mi.Point2f(dr.clip(slot - mi.Float(chosen), 0.0, BELOW_ONE), sample.y)
        ds = mi.DirectionSample3f() if self.is_scalar else dr.zeros(mi.DirectionSample3f)
        for index, part in enumerate(self.parts):
            here, _ = part.sample_direction(it, sample, active & (chosen == index))
            ds = dr.select(chosen == index, here, ds)
        is_drawn = active & (ds.pdf > 0.0)
        # Mitsuba's own emitters outside a scene do not know its size; objects beyond their guess would cast no shadow
        ds.dist = 2.0 * (FAR + dr.norm(it.p))
        ds.p, ds.n = it.p + ds.d * ds.dist, -ds.d
        ds.delta, ds.emitter = mi.Bool(False), self.emitter_pointer()
        ds.pdf = dr.select(is_drawn, self.pdf_direction(it, ds, is_drawn), 0.0)
        weight = self.eval_direction(it, ds, is_drawn) / dr.maximum(ds.pdf, 1e-12)
        return ds, weight & is_drawn & (ds.pdf > 0.0)

    def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        total = mi.Float(0.0)
        for part in self.parts:
            total = total + self.share * part.pdf_direction(it, ds, active)
        return dr.select(active, total, 0.0)

    def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        return self._sum([part.eval_direction(it, ds, active) for part in self.parts], active)

    def to_string(self) -> str:
        return f"NacreEnvironments[{len(self.parts)}]"
