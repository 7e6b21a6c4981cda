"""The lights by name: soft boxes, a line of tubes, sun, sky, a beam, rooms and streets, a user's environment map.

Emission is scaled so that a matt white sheet lying on the floor has a luminance of about 0.6: pictures of
different materials under one light compare at one exposure.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from nacre.device.variant import use_variant
from nacre.errors import NacreError, did_you_mean
from nacre.files import plain, why_unreadable
from nacre.light import illuminant as light_illuminant
from nacre.picture.lights.environment_plugin import make_environment, spectrum_texture
from nacre.picture.lights.environments import studio, unit_spectrum

LIGHTS = ("studio", "line", "sun", "sky", "directional", "interior", "street")
TURNING_LIGHTS = ("studio", "interior", "street")
MAP_SUFFIXES = (".exr", ".hdr", ".pfm")
MAX_MAP_BYTES = 1 << 30
_WHITE = 0.6
PLACE_FLOORS = {"street": "ground", "interior": "boards"}


@dataclass(frozen=True)
class Light:
    """The light of a picture.

    Attributes:
        emitters: Mitsuba objects or dicts by name.
        illuminant: the white that the picture is balanced to.
        is_surrounding: whether the light is a place that should be seen behind the subject.
        note: how outputs state it.
        floor: material of the floor where it is a place (`nacre.picture.scenes.catalogue.MATERIALS`).
    """

    emitters: dict[str, Any]
    illuminant: str
    is_surrounding: bool
    note: str
    floor: str = "ground"


def check_light(name: str) -> str:
    """Return the name, or the path of an environment map, if it is one.

    Raises:
        NacreError: neither a light nor a readable environment map.
    """
    if name in LIGHTS:
        return name
    path = Path(name)
    if path.suffix.lower() in MAP_SUFFIXES:
        try:
            plain(path)
        except OSError as error:
            raise NacreError(f"light {name}: {why_unreadable(error)}") from None
        if path.stat().st_size > MAX_MAP_BYTES:
            raise NacreError(
                f"light {name}: {path.stat().st_size} bytes; an environment map has at most {MAX_MAP_BYTES}"
            )
        return name
    raise NacreError(
        f'light "{name}" is not known.{did_you_mean(name, LIGHTS)} '
        f"Choose from {', '.join(LIGHTS)} or an environment map (.exr, .hdr)"
    )


def make_light(name: str, illuminant: str = "D65", turn_deg: float = 0.0) -> Light:
    """Build a light of the current variant.

    Args:
        name: one of `LIGHTS` or the path of an environment map.
        illuminant: spectrum of the light sources; `sun`, `sky`, `street` and maps bring their own light and are
            balanced to D65, `interior` mixes daylight and its lamps.
        turn_deg: how far the light has turned about the object.

    Raises:
        NacreError: unknown light or illuminant, unreadable map.
    """
    check_light(name)
    white = light_illuminant(illuminant).name
    if name == "studio":
        emitters = {"studio": make_environment(studio(white), 1.0, turn_deg)}
        return Light(emitters, white, False, f"studio soft boxes, {white}")
    if name == "line":
        return Light(_tubes(white, turn_deg), white, False, f"line of tubes, {white}")
    if name == "directional":
        return Light(_directional(white, turn_deg), white, False, f"directional, {white}")
    if name in ("sun", "sky"):
        note = f"{name}, Mitsuba sunsky, turbidity 3"
        return Light({"sky": _sunsky(name == "sun", turn_deg)}, "D65", True, note, "plain")
    if name in ("interior", "street"):
        from nacre.picture.lights import places

        place = places.interior() if name == "interior" else places.street()
        return Light({name: make_environment(place, 1.0, turn_deg)}, "D65", True, place.name, PLACE_FLOORS[name])
    return Light({"map": _map(Path(name), turn_deg)}, "D65", True, f"environment map {Path(name).name}, RGB up-sampled")


def _turn(turn_deg: float) -> Any:
    return use_variant().ScalarTransform4f().rotate([0, 0, 1], turn_deg)


def _emission(white: str, level: float) -> Any:
    spectrum = unit_spectrum(white)
    return spectrum_texture(spectrum.wavelengths_nm, level * spectrum.power)


def _tubes(white: str, turn_deg: float) -> dict[str, Any]:
    """A row of seven broad tubes above and behind the samples, parallel to x, and a weak fill."""
    mi = use_variant()
    parts: dict[str, Any] = {}
    for k in range(7):
        y = -4.2 + 1.6 * k
        place = mi.ScalarTransform4f().translate([0, y, 4.4]).rotate([1, 0, 0], 180.0).scale([4.2, 0.38, 1.0])
        parts[f"tube{k}"] = {
            "type": "rectangle",
            "to_world": _turn(turn_deg) @ place,
            "emitter": {"type": "area", "radiance": _emission(white, 1.7)},
        }
    parts["fill"] = {"type": "constant", "radiance": _emission(white, 0.10)}
    return parts


def _directional(white: str, turn_deg: float) -> dict[str, Any]:
    """A parallel beam from the upper left front, with a weak fill that keeps shadows readable."""
    down = np.array([0.5, 0.62, -0.95])
    down /= np.linalg.norm(down)
    turn = np.radians(turn_deg)
    x, y = down[0] * np.cos(turn) - down[1] * np.sin(turn), down[0] * np.sin(turn) + down[1] * np.cos(turn)
    level = np.pi * _WHITE / float(-down[2])
    return {
        "beam": {"type": "directional", "direction": [x, y, down[2]], "irradiance": _emission(white, level)},
        "fill": {"type": "constant", "radiance": _emission(white, 0.04)},
    }


def _sunsky(has_sun: bool, turn_deg: float) -> dict[str, Any]:
    sun = np.array([-0.55, -0.55, 0.75])
    sky: dict[str, Any] = {
        "type": "sunsky",
        "turbidity": 3.0,
        "albedo": 0.2,
        "sun_direction": list(sun / np.linalg.norm(sun)),
        "to_world": _turn(turn_deg),
        # measured: a white floor has Y = 0.38 with the sun and 0.075 without it
        "sky_scale": 1.6 if has_sun else 8.0,
        "sun_scale": 1.6 if has_sun else 0.0,
    }
    if has_sun:
        sky["sun_aperture"] = 1.5  # softens the glint of a mirror; the energy is kept
    return sky


def _map(path: Path, turn_deg: float) -> Any:
    mi = use_variant()
    # Mitsuba's maps have y up
    upright = _turn(turn_deg) @ mi.ScalarTransform4f().rotate([1, 0, 0], 90.0)
    try:
        return mi.load_dict({"type": "envmap", "filename": str(path), "to_world": upright})
    except (RuntimeError, OSError, ValueError) as error:
        raise NacreError(f"light {path}: cannot be read: {' '.join(str(error).split())[-160:]}") from None
