"""Emitters in Python for Mitsuba: a spectral environment, mixtures, polarising filters, and lights by name.

Mitsuba's `envmap` up-samples RGB to smooth spectra, which falsify structural colours. Here the radiance along d is
sum_k w_k(d) S_k(lambda) with any tabulated S_k, including fluorescent lines. Directions are sampled
by luminance and by the cosine on a floor.

Mitsuba accepts one environment per scene. The mixture samples a direction from one part and uses the mixture
density, therefore every part is sampled, however small.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nacre.core.errors import NacreError, UnsupportedError, did_you_mean
from nacre.core.files import size_of
from nacre.device.variant import depolarised
from nacre.light import illuminant as light_illuminant
from nacre.picture import environments
from nacre.picture.paths import SOFT_LAMP_DEG, WITHIN_LAMP_DEG
from nacre.picture.plugins import Plugin, WrappedIntegrator, dr, make_plugin, mi

if TYPE_CHECKING:
    from nacre.picture.environments import Environment


# minimum density relative to its mean, because the density grid may round small values to zero
_DENSITY_FLOOR = 1e-4
# direction weights below and at the horizon: most pictures show mainly a floor, which receives light by its
# cosine (noise at 64 samples: street -29 %, interior -18 %, studio -5 to -12 %)
_SHARE_BELOW, _SHARE_LEVEL = 0.05, 0.1
FAR = 1e3  # default scene radius


def make_environment(environment: Environment, scale: float = 1.0, turn_deg: float = 0.0) -> Any:
    """Return a `mi.Emitter` with `environment`'s radiance times `scale`, turned about z."""
    emitter = make_plugin(NacreEnvironment, environment)
    emitter.set_state(scale, turn_deg)
    return emitter


def spectrum_texture(wavelengths_nm: Any, power: Any) -> Any:
    """Return a Mitsuba spectrum from a table on ascending wavelengths, resampled to 1 nm over 360-830."""
    values = np.interp(np.arange(360.0, 831.0), wavelengths_nm, power)
    limits = {"wavelength_min": 360.0, "wavelength_max": 830.0}
    return mi.load_dict({"type": "regular", **limits, "values": ",".join(f"{v:.7g}" for v in values)})


class DistantEmitter(Plugin):
    """Methods for emitters at infinity that define `sample_direction`, `eval` and densities."""

    BASE = "Emitter"
    eval: Any
    sample_direction: Any

    def set_up(self, *arguments: Any, **options: Any) -> None:
        self.m_flags = int(mi.EmitterFlags.Infinite | mi.EmitterFlags.SpatiallyVarying)
        self.m_needs_sample_3 = False
        self.centre, self.radius = mi.Point3f(0.0), mi.Float(FAR)

    def traverse(self, callback: Any) -> None:
        """Expose no values."""

    def sample_ray(self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True) -> Any:
        """Sample a ray into the scene, for light tracers, from a disc as wide as the bounding sphere."""
        it, si = dr.zeros(mi.Interaction3f), dr.zeros(mi.SurfaceInteraction3f)
        it.p = self.centre
        ds, _ = self.sample_direction(it, sample3, active)
        towards = -ds.d
        place = mi.warp.square_to_uniform_disk_concentric(sample2)
        start = self.centre + (mi.Frame3f(towards).to_world(mi.Vector3f(place.x, place.y, 0.0)) - towards) * self.radius
        si.wi = towards
        wavelengths, weight = self.sample_wavelengths(si, sample1, active)
        weight *= dr.select(ds.pdf > 0.0, dr.pi * dr.square(self.radius) / dr.maximum(ds.pdf, 1e-20), 0.0)
        return mi.Ray3f(start, towards, time, wavelengths), weight & active

    def sample_position(self, time: Any, sample: Any, active: Any = True) -> Any:
        # never used, but recorded for every emitter alive, also in other scenes
        position = mi.PositionSample3f
        return position() if self.is_scalar else dr.zeros(position), mi.Float(0.0)

    def sample_wavelengths(self, si: Any, sample: Any, active: Any = True) -> Any:
        wavelengths, weight = mi.sample_rgb_spectrum(mi.sample_shifted(sample))
        si.wavelengths = wavelengths
        return wavelengths, self.eval(si, active) * weight

    def bbox(self) -> Any:
        return mi.ScalarBoundingBox3f()

    def emitter_pointer(self) -> Any:
        return self if self.is_scalar else mi.EmitterPtr(self)


class NacreEnvironment(DistantEmitter):
    """Radiance over directions as weights times spectra; z is up."""

    def set_up(self, environment: Environment) -> None:
        DistantEmitter.set_up(self)
        weights = np.ascontiguousarray(np.moveaxis(environment.weights, 0, -1), dtype=np.float32)
        self.rows, self.columns, self.count = weights.shape
        self.texture = mi.Texture2f(
            mi.TensorXf(weights), wrap_mode=dr.WrapMode.Repeat, filter_mode=dr.FilterMode.Linear
        )
        self.spectra = [spectrum_texture(s.wavelengths_nm, s.power) for s in environment.spectra]
        self.density = mi.Hierarchical2D0(_density(environment))
        self.turn, self.scale = mi.Float(0.0), mi.Float(1.0)

    def set_state(self, scale: float, turn_deg: float) -> None:
        """Change brightness and turn without a new kernel."""
        self.scale = dr.opaque(mi.Float, scale)
        self.turn = dr.opaque(mi.Float, turn_deg / 360.0)

    def traverse(self, callback: Any) -> None:
        callback.put("scale", self.scale, mi.ParamFlags.Differentiable)
        callback.put("turn", self.turn, mi.ParamFlags.NonDifferentiable)

    def parameters_changed(self, keys: Any = ()) -> None:
        """No value is derived from the parameters."""

    def set_scene(self, scene: Any) -> None:
        box = scene.bbox()
        if box.valid():
            sphere = box.bounding_sphere()
            self.centre = mi.Point3f(sphere.center)
            self.radius = mi.Float(max(1e-3, float(np.asarray(sphere.radius).reshape(-1)[0]) * 1.01))

    def eval(self, si: Any, active: Any = True) -> Any:
        return depolarised(self._shine(self._uv(-si.wi)[0], si.wavelengths, active))

    def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
        uv, density = self.density.sample(sample, active=active)
        phi, theta = 2.0 * dr.pi * (uv.x + self.turn), dr.pi * uv.y
        sin_theta = dr.sin(theta)
        d = mi.Vector3f(sin_theta * dr.cos(phi), sin_theta * dr.sin(phi), dr.cos(theta))
        active = active & (density > 0.0)
        distance = 2.0 * (self.radius + dr.norm(it.p - self.centre))
        ds = mi.DirectionSample3f()
        ds.p, ds.n, ds.uv, ds.time = it.p + d * distance, -d, uv, it.time
        ds.pdf = dr.select(active, _per_solid_angle(density, sin_theta), 0.0)
        ds.delta, ds.emitter = mi.Bool(False), self.emitter_pointer()
        ds.d, ds.dist = d, distance
        weight = self._shine(uv, it.wavelengths, active) / dr.maximum(ds.pdf, 1e-12)
        return ds, depolarised(weight & active)

    def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        uv, sin_theta = self._uv(ds.d)
        return dr.select(active, _per_solid_angle(self.density.eval(uv, active=active), sin_theta), 0.0)

    def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        return depolarised(self._shine(self._uv(ds.d)[0], it.wavelengths, active))

    def to_string(self) -> str:
        return f"NacreEnvironment[{self.count} spectra, {self.columns} x {self.rows}]"

    def _uv(self, d: Any) -> tuple[Any, Any]:
        """Place in the map, and the polar angle's sine."""
        u = dr.atan2(d.y, d.x) / (2.0 * dr.pi) - self.turn
        v = dr.safe_acos(d.z) / dr.pi
        return mi.Point2f(u - dr.floor(u), v), dr.safe_sqrt(1.0 - dr.square(d.z))

    def _shine(self, uv: Any, wavelengths: Any, active: Any) -> Any:
        """Radiance at a map place."""
        # half a texel away from the poles, because the map repeats sideways only
        half = 0.5 / self.rows
        weights = self.texture.eval(mi.Point2f(uv.x, dr.clip(uv.y, half, 1.0 - half)), active)
        here = mi.SurfaceInteraction3f()
        here.wavelengths = wavelengths
        total = mi.UnpolarizedSpectrum(0.0)
        for weight, spectrum in zip(weights, self.spectra, strict=True):
            total = total + weight * spectrum.eval(here, active)
        return (total * self.scale) & active


def _per_solid_angle(density: Any, sin_theta: Any) -> Any:
    return density / (2.0 * dr.square(dr.pi) * dr.maximum(sin_theta, 1e-6))


def _density(environment: Environment) -> np.ndarray:
    """Sampling density at texel corners: the largest adjacent luminance times sin(theta), more from above."""
    luminance = environment.luminance
    padded = np.pad(np.concatenate([luminance[:, -1:], luminance, luminance[:, :1]], axis=1), ((1, 1), (0, 0)), "edge")
    corner = np.maximum(np.maximum(padded[:-1, :-1], padded[:-1, 1:]), np.maximum(padded[1:, :-1], padded[1:, 1:]))
    theta = np.linspace(0, np.pi, corner.shape[0])[:, None]
    corner = np.maximum(corner, _DENSITY_FLOOR * corner.mean()) * np.maximum(np.sin(theta), 1e-3)
    height = np.cos(theta)
    corner *= np.where(height > 0, _SHARE_LEVEL + (1 - _SHARE_LEVEL) * np.sqrt(np.maximum(height, 0.0)), _SHARE_BELOW)
    return np.ascontiguousarray(corner, dtype=np.float32)


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
    match = _MARKS.match(text)
    if match is None:
        raise NacreError(f'light "{text}" has no name; write lights like studio:0.5,sun@120')
    marks = re.findall(rf"([:@])({_NUMBER})", match["marks"])
    if len({sign for sign, _ in marks}) < len(marks):
        raise NacreError(f'light "{text}" has two strengths or two turns; write it like studio:0.5@120')
    values = {sign: float(number) for sign, number in marks}
    strength, turn = values.get(":", 1.0), values.get("@", 0.0)
    if not 0.0 < strength <= MAX_STRENGTH:
        raise NacreError(f'light "{text}": a strength is a number above 0, up to {MAX_STRENGTH:g}')
    if not math.isfinite(turn) or abs(turn) > MAX_TURN_DEG:
        raise NacreError(f'light "{text}": a turn is an angle in degrees, up to {MAX_TURN_DEG:g}')
    return Lamp(match["name"], strength, turn)


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


# Polarising filters before the camera and the lights, and Stokes images, in Mitsuba's polarised variants.
#
# Angles are those of the transmission axis from the horizontal, counter-clockwise as seen against the light. "left" and
# "right" name circularly polarised light as Mitsuba does (`mi.mueller.right_circular_polarizer`); see the page "Which
# circular is right?".

CIRCULAR = ("left", "right")
STOKES = ("S0", "S1", "S2", "S3")


def read_polariser(value: str | float | None, name: str) -> str | float | None:
    """Return "left", "right" or an angle in degrees; None: no filter.

    Raises:
        NacreError: another value.
    """
    if value is None or value in CIRCULAR:
        return value
    try:
        angle = float(value)
    except (TypeError, ValueError):
        angle = math.nan
    if isinstance(value, bool) or not abs(angle) <= 360.0:
        raise NacreError(f"{name} = {value!r} is not left, right or an angle in degrees (-360 to 360)")
    return angle


def analyser(kind: str | float) -> tuple[float, float, float, float]:
    """Return the weights of S0 to S3 that a filter transmits, or that make a Stokes image ("S0" to "S3")."""
    if kind in STOKES:
        row = np.eye(4)[STOKES.index(str(kind))]
    elif kind in CIRCULAR:
        row = np.array([0.5, 0.0, 0.0, 0.5 if kind == "right" else -0.5])
    else:
        angle = 2.0 * math.radians(float(kind))
        row = 0.5 * np.array([1.0, math.cos(angle), math.sin(angle), 0.0])
    return tuple(row.tolist())


def analysed(integrator: Any, kind: str | float, up: Any) -> Any:
    """Return an integrator whose light passes a filter before the camera, or that returns one Stokes component.

    Args:
        kind: as for `analyser`.
        up: upward direction of the picture.
    """
    return make_plugin(Analysed, integrator, analyser(kind), up)


def polarised_light(emitter: Any, kind: str | float) -> Any:
    """Return an environment whose light is fully polarised, with unchanged radiance; horizontal is across z."""
    _, *state = analyser(kind)
    return make_plugin(PolarisedEnvironment, emitter, [1.0, *(2.0 * part for part in state)])


def _horizontal(k: Any, up: Any) -> Any:
    """Return the horizontal unit vector across light that travels along `k`."""
    across = dr.cross(up, k)
    length2 = dr.dot(across, across)
    return dr.select(length2 > 1e-10, across * dr.rsqrt(dr.maximum(length2, 1e-20)), mi.Vector3f(1.0, 0.0, 0.0))


class Analysed(WrappedIntegrator):
    """An integrator behind a polarising filter."""

    def set_up(self, inner: Any, weights: tuple[float, ...], up: Any) -> None:
        self.inner, self.weights, self.up = inner, weights, up

    def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
        light, is_valid, rest = self.inner.sample(scene, sampler, ray, medium, active)
        k = -ray.d
        turn = mi.mueller.rotate_stokes_basis(k, mi.mueller.stokes_basis(k), _horizontal(k, mi.Vector3f(*self.up)))
        light = turn @ light
        total = mi.UnpolarizedSpectrum(0.0)
        for row, weight in enumerate(self.weights):
            if weight:
                total = total + weight * light[row, 0]
        return mi.mueller.depolarizer(total), is_valid, rest


class PolarisedEnvironment(DistantEmitter):
    """Another environment behind a polarising filter."""

    def set_up(self, inner: Any, state: list[float]) -> None:
        DistantEmitter.set_up(self)
        self.inner, self.state = inner, state

    def set_scene(self, scene: Any) -> None:
        self.inner.set_scene(scene)

    def _filtered(self, value: Any, k: Any) -> Any:
        """Return unpolarised emission along `k` as polarised light in its implicit Stokes frame."""
        horizontal = _horizontal(k, mi.Vector3f(0.0, 0.0, 1.0))
        turn = mi.mueller.rotate_stokes_basis(k, horizontal, mi.mueller.stokes_basis(k))
        power, zero = value[0, 0], mi.UnpolarizedSpectrum(0.0)
        emitted = mi.Spectrum([[power * part, zero, zero, zero] for part in self.state])
        return turn @ emitted

    def eval(self, si: Any, active: Any = True) -> Any:
        return self._filtered(self.inner.eval(si, active), si.wi)

    def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
        ds, weight = self.inner.sample_direction(it, sample, active)
        ds.emitter = self.emitter_pointer()
        return ds, self._filtered(weight, -ds.d)

    def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        return self.inner.pdf_direction(it, ds, active)

    def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        return self._filtered(self.inner.eval_direction(it, ds, active), -ds.d)

    def to_string(self) -> str:
        return f"PolarisedEnvironment[{self.inner}]"


# Lights by name: soft boxes, a line of tubes, sun, sky, beam, room, street, garden, and environment maps.
#
# Emission gives matt white paper on the floor a luminance near 0.6; pictures with different materials under one light
# therefore compare at one exposure.

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
        floor: floor material in a place (`nacre.picture.scenes.MATERIALS`).
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
        size_of(path, f"light {name}", MAX_MAP_BYTES)  # refuses a missing file
        return name
    raise NacreError(
        f'light "{name}" is not known.{did_you_mean(name, LIGHTS)} '
        f"Choose from {', '.join(LIGHTS)} or an environment map (.exr, .hdr)"
    )


def make_lights(lamps: Sequence[Lamp], illuminant: str = "D65", turn_deg: float = 0.0) -> Light:
    """Build lights in the current variant; the first one sets the white point.

    Args:
        lamps: see `nacre.picture.emitters.read_lamps`.
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
    environments = [(_environment_of(light), light, lamp.strength) for lamp, light in both]
    surroundings = [each for each in environments if each[0] is not None]
    emitters = {
        f"{name}{index}": emitter
        for index, (environment, light, _) in enumerate(environments)
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
    environments = (each for each in light.emitters.values() if isinstance(each, mi.Emitter) and each.is_environment())
    return next(environments, None)


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
    """Build a built-in environment, with its variants for a wider lamp."""
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
