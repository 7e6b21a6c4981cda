"""Lights by name: soft boxes, a line of tubes, sun, sky, beam, room, street, garden, and environment maps.

Emission gives matt white paper on the floor a luminance near 0.6; pictures with different materials
under one light therefore compare at one exposure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.errors import NacreError, UnsupportedError, did_you_mean
from nacre.core.files import plain, why_unreadable
from nacre.light import illuminant as light_illuminant
from nacre.picture.lights import environments
from nacre.picture.lights.emitter_plugins import Lamp, make_environment, spectrum_texture, sum_of_environments
from nacre.picture.paths import SOFT_LAMP_DEG, WITHIN_LAMP_DEG
from nacre.picture.plugin import mi

LIGHTS = ("studio", "line", "sun", "sky", "directional", "interior", "street", "garden")
TURNING_LIGHTS = ("studio", "interior", "street", "garden", "directional")
MAP_SUFFIXES = (".exr", ".hdr", ".pfm")
MAX_MAP_BYTES = 1 << 30
SUN_DEG = 1.5  # wider than the sun at equal power, which softens its mirror image
BLACK = {"type": "diffuse", "reflectance": 0.0}
PLACE_FLOORS = {"street": "ground", "interior": "boards", "garden": "deck"}


@dataclass(frozen=True)
class Light:
    """A picture's light.

    Attributes:
        emitters: Mitsuba objects or dicts by name.
        illuminant: white point.
        is_surrounding: whether the light is a visible place behind the subject.
        note: description for outputs.
        floor: floor material in a place (`nacre.picture.scenes.catalogue.MATERIALS`).
        turning: emitters that turn in place (`turn`), each with its own turn in degrees.
        soft: the environment with its small lamps widened to `SOFT_LAMP_DEG`, see `nacre.picture.paths`.
        soft_within: the environment widened to `WITHIN_LAMP_DEG`, for light that the object has scattered.
    """

    emitters: dict[str, Any]
    illuminant: str
    is_surrounding: bool
    note: str
    floor: str = "ground"
    turning: tuple[tuple[Any, float], ...] = ()
    soft: Any = None
    soft_within: Any = None

    def turn(self, angle_deg: float) -> None:
        """Turn our own environments about the vertical axis; other lights are built at their angle."""
        for emitter, own_deg in self.turning:
            emitter.set_state(1.0, own_deg + angle_deg)

    def polarised(self, kind: str | float) -> Light:
        """Return the light behind a polarising filter, with unchanged radiance.

        Raises:
            UnsupportedError: a lamp has a body; only environments are polarised.
        """
        from nacre.picture.lights.emitter_plugins import polarised_light

        made = {}
        for name, emitter in self.emitters.items():
            if _is_body(emitter):
                raise UnsupportedError("light_polarisation: this lamp has a body; choose studio, sun, sky or a place")
            made[name] = polarised_light(mi.load_dict(emitter) if isinstance(emitter, dict) else emitter, kind)
        return replace(self, emitters=made)

    def among(self, others: Light) -> Light:
        """Return this light with the unlit lamp bodies of other lights, and with their surroundings."""
        own = [emitter["to_world"] for emitter in self.emitters.values() if _is_body(emitter)]
        bodies = {
            f"off_{name}": {**{k: v for k, v in emitter.items() if k != "emitter"}, "bsdf": BLACK}
            for name, emitter in others.emitters.items()
            if _is_body(emitter) and not any(np.allclose(emitter["to_world"].matrix, to.matrix) for to in own)
        }
        emitters = {**self.emitters, **bodies}
        return replace(self, emitters=emitters, is_surrounding=others.is_surrounding, floor=others.floor)


def _is_body(emitter: Any) -> bool:
    return isinstance(emitter, dict) and "emitter" in emitter


def check_light(name: str) -> str:
    """Return a light's name or an environment map's path.

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


def make_lights(lamps: Sequence[Lamp], illuminant: str = "D65", turn_deg: float = 0.0) -> Light:
    """Build lights in the current variant; the first one sets the white point.

    Args:
        lamps: see `nacre.picture.lights.emitter_plugins.read_lamps`.
        illuminant: lamp spectrum. `sun`, `sky`, places and maps have their own spectra and the white
            point D65.
        turn_deg: common turn about the object.

    Raises:
        NacreError: unknown light or illuminant, unreadable map.
    """
    lights = [make_light(lamp.name, illuminant, turn_deg + lamp.turn_deg, lamp.strength) for lamp in lamps]
    both = list(zip(lamps, lights, strict=True))
    turning = tuple((emitter, own + lamp.turn_deg) for lamp, light in both for emitter, own in light.turning)
    if len(lamps) == 1 and lamps[0].strength == 1.0:
        return replace(lights[0], turning=turning)
    found = [(_environment_of(light), light, lamp.strength) for lamp, light in both]
    surroundings = [each for each in found if each[0] is not None]
    emitters = {
        f"{name}{index}": emitter
        for index, (environment, light, _) in enumerate(found)
        for name, emitter in light.emitters.items()
        if emitter is not environment
    }
    emitters["environments"] = sum_of_environments([(emitter, strength) for emitter, _, strength in surroundings])
    soft = within = None
    if any(light.soft is not None for light in lights):
        soft = sum_of_environments([(light.soft or emitter, strength) for emitter, light, strength in surroundings])
    if any(light.soft_within is not None for light in lights):
        within = sum_of_environments(
            [(light.soft_within or light.soft or emitter, strength) for emitter, light, strength in surroundings]
        )
    note = " + ".join(light.note + ("" if lamp.strength == 1.0 else f" at {lamp.strength:g}") for lamp, light in both)
    place = next((light for light in lights if light.is_surrounding), lights[0])
    return Light(emitters, lights[0].illuminant, place.is_surrounding, note, place.floor, turning, soft, within)


def _environment_of(light: Light) -> Any:
    """Return a light's environment emitter, or None."""
    found = (each for each in light.emitters.values() if isinstance(each, mi.Emitter) and each.is_environment())
    return next(found, None)


def make_light(name: str, illuminant: str = "D65", turn_deg: float = 0.0, strength: float = 1.0) -> Light:
    """Build one light in the current variant.

    Args:
        name: in `LIGHTS`, or an environment map's path.
        illuminant, turn_deg: see `make_lights`.
        strength: factor for lamps; `make_lights` scales environments.

    Raises:
        NacreError: unknown light or illuminant, unreadable map.
    """
    white = light_illuminant(illuminant).name
    if name in TURNING_LIGHTS:
        return _surrounding(name, white, turn_deg)
    if name == "line":
        return Light(_tubes(white, turn_deg, strength), white, False, f"line of tubes, {white}")
    if name in ("sun", "sky"):
        sky = mi.load_dict(_sunsky(SUN_DEG if name == "sun" else 0.0, turn_deg))
        soft = mi.load_dict(_sunsky(SOFT_LAMP_DEG, turn_deg)) if name == "sun" else None
        return Light({"sky": sky}, "D65", True, f"{name}, Mitsuba sunsky, turbidity 3", "plain", soft=soft)
    return Light({"map": _map(Path(name), turn_deg)}, "D65", True, f"environment map {Path(name).name}, RGB up-sampled")


def _surrounding(name: str, white: str, turn_deg: float) -> Light:
    """Build one of our environments, with the variants that have a wider lamp."""
    wide: environments.Environment | None = None
    within: environments.Environment | None = None
    note = ""
    if name == "studio":
        place, note = environments.studio(white), f"studio soft boxes, {white}"
    elif name == "directional":
        place, within = environments.beam(white), environments.beam(white, width_deg=WITHIN_LAMP_DEG)
        note = f"beam of {environments.BEAM_DEG:g} degrees, {white}"
    elif name == "interior":
        place = environments.interior()
    else:
        build = environments.garden if name == "garden" else environments.street
        place, wide = build(), build(sun_deg=SOFT_LAMP_DEG)
    made = [None if each is None else make_environment(each, 1.0, turn_deg) for each in (place, wide, within)]
    turning = tuple((each, 0.0) for each in made if each is not None)
    emitters, floor, is_place = {"surround": made[0]}, PLACE_FLOORS.get(name, "ground"), name in PLACE_FLOORS
    return Light(emitters, "D65" if is_place else white, is_place, note or place.name, floor, turning, *made[1:])


def _turn(turn_deg: float) -> Any:
    return mi.ScalarTransform4f().rotate([0, 0, 1], turn_deg)


def _emission(white: str, level: float) -> Any:
    spectrum = environments.unit_spectrum(white)
    return spectrum_texture(spectrum.wavelengths_nm, level * spectrum.power)


def _tubes(white: str, turn_deg: float, strength: float) -> dict[str, Any]:
    """Seven broad tubes above and behind the object, parallel to x, and a weak fill light."""
    parts: dict[str, Any] = {}
    for k in range(7):
        y = -4.2 + 1.6 * k
        place = mi.ScalarTransform4f().translate([0, y, 4.4]).rotate([1, 0, 0], 180.0).scale([4.2, 0.38, 1.0])
        parts[f"tube{k}"] = {
            "type": "rectangle",
            "to_world": _turn(turn_deg) @ place,
            "emitter": {"type": "area", "radiance": _emission(white, 1.7 * strength)},
        }
    parts["fill"] = mi.load_dict({"type": "constant", "radiance": _emission(white, 0.10)})
    return parts


def _sunsky(sun_deg: float, turn_deg: float) -> dict[str, Any]:
    """A clear sky and a sun with this width and constant power; 0: no sun."""
    # in world coordinates: Mitsuba does not apply `to_world` to it
    sun = np.array(_turn(turn_deg) @ mi.ScalarVector3f(-0.55, -0.55, 0.75))
    sky: dict[str, Any] = {
        "type": "sunsky",
        "turbidity": 3.0,
        "albedo": 0.2,
        "sun_direction": list(sun / np.linalg.norm(sun)),
        # unscaled, a white floor has Y = 0.38 with the sun and 0.075 without
        "sky_scale": 1.6 if sun_deg else 8.0,
        "sun_scale": 1.6 if sun_deg else 0.0,
    }
    if sun_deg:
        sky["sun_aperture"] = sun_deg
    return sky


def _map(path: Path, turn_deg: float) -> Any:
    # Mitsuba's maps have y up
    upright = _turn(turn_deg) @ mi.ScalarTransform4f().rotate([1, 0, 0], 90.0)
    try:
        bitmap = mi.Bitmap(str(path))
        _check_pixels(np.asarray(bitmap), path)
        return mi.load_dict({"type": "envmap", "bitmap": bitmap, "to_world": upright})
    except (RuntimeError, OSError, ValueError) as error:
        raise NacreError(f"light {path}: cannot be read: {' '.join(str(error).split())[-160:]}") from None


def _check_pixels(pixels: NDArray[Any], path: Path) -> None:
    """Check that a map can be sampled; otherwise the whole picture would be NaN.

    Raises:
        NacreError: infinite pixels, such as suns above the half-float range, or only black pixels.
    """
    bad = int(np.count_nonzero(~np.isfinite(pixels).reshape(*pixels.shape[:2], -1).all(axis=-1)))
    if bad:
        raise NacreError(
            f"light {path}: {bad} of its {pixels.shape[0] * pixels.shape[1]} pixels are infinite or no number; write "
            "the map anew with finite ones (a half float holds up to 65504)"
        )
    if not (pixels[..., :3] if pixels.ndim == 3 else pixels).max() > 0:
        raise NacreError(f"light {path}: is black everywhere; no pixel of it is above 0")
