"""A spectral environment light for Mitsuba: a few spectra, each with its own weight in every direction.

Mitsuba's `envmap` holds RGB and up-samples it to smooth spectra, under which a structural colour comes out
wrong. Here the radiance along d is sum_k w_k(d) S_k(lambda), with w_k painted over the sphere and S_k
any table, lines of a fluorescent lamp included. Sampling follows the luminance, and what of it a floor sees.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any

import numpy as np

from nacre.device.variant import use_variant

if TYPE_CHECKING:
    from nacre.picture.lights.environments import Environment

# keeps every direction possible, so that no light is lost where the density's own grid rounds to zero
_DENSITY_FLOOR = 1e-4
# most of a picture is a floor that sees light by its height, and that hides what shines from below; the rest of the
# directions keep this share of the samples (noise at 64 of them: street -29 %, interior -18 %, studio -5 to -12 %)
_SHARE_BELOW, _SHARE_LEVEL = 0.05, 0.1
FAR = 1e3  # radius within which a scene lies that does not tell its own


def make_environment(environment: Environment, scale: float = 1.0, turn_deg: float = 0.0) -> Any:
    """Return a `mi.Emitter` that shines as `environment`, times `scale`, turned about z by `turn_deg`."""
    mi = use_variant()
    emitter = _emitter_class(mi.variant())(mi.Properties(), environment)
    emitter.set_state(scale, turn_deg)
    return emitter


def spectrum_texture(wavelengths_nm: Any, power: Any) -> Any:
    """Return a Mitsuba spectrum of a table on any ascending wavelengths, resampled to 1 nm over 360-830."""
    mi = use_variant()
    grid = np.arange(360.0, 831.0)
    values = np.interp(grid, wavelengths_nm, power)
    return mi.load_dict(
        {
            "type": "regular",
            "wavelength_min": 360.0,
            "wavelength_max": 830.0,
            "values": ",".join(f"{v:.7g}" for v in values),
        }
    )


def thrown_ray(
    lamp: Any, centre: Any, radius: Any, time: Any, samples: tuple[Any, Any, Any], active: Any
) -> tuple[Any, Any]:
    """Return a ray that an environment throws on the scene, and its weight, as a light tracer asks for it.

    It starts on a disc as wide as the scene's bounding sphere, which faces the direction that it comes from.

    Args:
        samples: one number for the wavelengths, two for the place on the disc, two for the direction.
    """
    import drjit as dr

    mi = use_variant()
    it, si = dr.zeros(mi.Interaction3f), dr.zeros(mi.SurfaceInteraction3f)
    it.p = centre
    ds, _ = lamp.sample_direction(it, samples[2], active)
    towards = -ds.d
    place = mi.warp.square_to_uniform_disk_concentric(samples[1])
    start = centre + (mi.Frame3f(towards).to_world(mi.Vector3f(place.x, place.y, 0.0)) - towards) * radius
    si.wi = towards
    wavelengths, weight = lamp.sample_wavelengths(si, samples[0], active)
    weight *= dr.select(ds.pdf > 0.0, dr.pi * dr.square(radius) / dr.maximum(ds.pdf, 1e-20), 0.0)
    return mi.Ray3f(start, towards, time, wavelengths), weight & active


@functools.cache
def _emitter_class(variant: str) -> type:
    """Define the class for a variant: Mitsuba's base class differs from variant to variant."""
    import drjit as dr

    mi: Any = use_variant()

    class NacreEnvironment(mi.Emitter):
        """Radiance over directions as weights times spectra; z is up."""

        def __init__(self, properties: Any, environment: Environment) -> None:
            super().__init__(properties)
            weights = np.ascontiguousarray(np.moveaxis(environment.weights, 0, -1), dtype=np.float32)
            self.rows, self.columns, self.count = weights.shape
            self.texture = mi.Texture2f(
                mi.TensorXf(weights), wrap_mode=dr.WrapMode.Repeat, filter_mode=dr.FilterMode.Linear
            )
            self.spectra = [spectrum_texture(s.wavelengths_nm, s.power) for s in environment.spectra]
            self.density = mi.Hierarchical2D0(_density(environment))
            self.turn, self.scale = mi.Float(0.0), mi.Float(1.0)
            self.centre, self.radius = mi.Point3f(0.0), mi.Float(FAR)
            flags = mi.EmitterFlags.Infinite | mi.EmitterFlags.SpatiallyVarying
            self.m_flags = int(flags)
            self.m_needs_sample_3 = False

        def set_state(self, scale: float, turn_deg: float) -> None:
            """Change brightness and turn without a new kernel."""
            self.scale = dr.opaque(mi.Float, scale)
            self.turn = dr.opaque(mi.Float, turn_deg / 360.0)

        def traverse(self, callback: Any) -> None:
            callback.put("scale", self.scale, mi.ParamFlags.Differentiable)
            callback.put("turn", self.turn, mi.ParamFlags.NonDifferentiable)

        def parameters_changed(self, keys: Any = ()) -> None:
            """Nothing is derived from the parameters."""

        def set_scene(self, scene: Any) -> None:
            box = scene.bbox()
            if box.valid():
                sphere = box.bounding_sphere()
                self.centre = mi.Point3f(sphere.center)
                self.radius = mi.Float(max(1e-3, float(np.asarray(sphere.radius).reshape(-1)[0]) * 1.01))

        def eval(self, si: Any, active: Any = True) -> Any:
            return self._radiance(-si.wi, si.wavelengths, active)

        def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
            uv, density = self.density.sample(sample, active=active)
            phi = 2.0 * dr.pi * (uv.x + self.turn)
            theta = dr.pi * uv.y
            sin_theta = dr.sin(theta)
            d = mi.Vector3f(sin_theta * dr.cos(phi), sin_theta * dr.sin(phi), dr.cos(theta))
            pdf = density / (2.0 * dr.square(dr.pi) * dr.maximum(sin_theta, 1e-6))
            active = active & (density > 0.0)
            distance = 2.0 * (self.radius + dr.norm(it.p - self.centre))
            ds = mi.DirectionSample3f()
            ds.p = it.p + d * distance
            ds.n = -d
            ds.uv = uv
            ds.time = it.time
            ds.pdf = dr.select(active, pdf, 0.0)
            ds.delta = mi.Bool(False)
            ds.emitter = self if variant.startswith("scalar") else mi.EmitterPtr(self)
            ds.d = d
            ds.dist = distance
            weight = self._shine(uv, it.wavelengths, active) / dr.maximum(ds.pdf, 1e-12)
            return ds, weight & active

        def sample_ray(self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True) -> Any:
            return thrown_ray(self, self.centre, self.radius, time, (sample1, sample2, sample3), active)

        def sample_position(self, time: Any, sample: Any, active: Any = True) -> Any:
            # never used, but recorded for every lamp that lives, those of other scenes too
            return dr.zeros(mi.PositionSample3f), mi.Float(0.0)

        def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            uv, sin_theta = self._uv(ds.d, self.turn)
            density = self.density.eval(uv, active=active)
            return dr.select(active, density / (2.0 * dr.square(dr.pi) * dr.maximum(sin_theta, 1e-6)), 0.0)

        def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            return self._radiance(ds.d, it.wavelengths, active)

        def sample_wavelengths(self, si: Any, sample: Any, active: Any = True) -> Any:
            wavelengths, weight = mi.sample_rgb_spectrum(mi.sample_shifted(sample))
            si.wavelengths = wavelengths
            return wavelengths, self.eval(si, active) * weight

        def bbox(self) -> Any:
            return mi.ScalarBoundingBox3f()

        def to_string(self) -> str:
            return f"NacreEnvironment[{self.count} spectra, {self.columns} x {self.rows}]"

        def _uv(self, d: Any, turn: Any) -> tuple[Any, Any]:
            u = dr.atan2(d.y, d.x) / (2.0 * dr.pi) - turn
            v = dr.safe_acos(d.z) / dr.pi
            return mi.Point2f(u - dr.floor(u), v), dr.safe_sqrt(1.0 - dr.square(d.z))

        def _radiance(self, d: Any, wavelengths: Any, active: Any) -> Any:
            return self._shine(self._uv(d, self.turn)[0], wavelengths, active)

        def _shine(self, uv: Any, wavelengths: Any, active: Any) -> Any:
            """Radiance from a place of the map, which a draw knows without asking for its direction's angles."""
            # stay half a texel off the poles: the map repeats sideways only
            half = 0.5 / self.rows
            uv = mi.Point2f(uv.x, dr.clip(uv.y, half, 1.0 - half))
            weights = self.texture.eval(uv, active)
            here = mi.SurfaceInteraction3f()
            here.wavelengths = wavelengths
            total = mi.Spectrum(0.0)
            for weight, spectrum in zip(weights, self.spectra, strict=True):
                total = total + weight * spectrum.eval(here, active)
            return (total * self.scale) & active

    return NacreEnvironment


def _density(environment: Environment) -> np.ndarray:
    """Luminance times sin(theta) at the corners of the map's texels, the largest of the neighbours; more from above."""
    luminance = environment.luminance
    padded = np.pad(np.concatenate([luminance[:, -1:], luminance, luminance[:, :1]], axis=1), ((1, 1), (0, 0)), "edge")
    corner = np.maximum(np.maximum(padded[:-1, :-1], padded[:-1, 1:]), np.maximum(padded[1:, :-1], padded[1:, 1:]))
    theta = np.linspace(0, np.pi, corner.shape[0])[:, None]
    corner = np.maximum(corner, _DENSITY_FLOOR * corner.mean()) * np.maximum(np.sin(theta), 1e-3)
    height = np.cos(theta)
    corner *= np.where(height > 0, _SHARE_LEVEL + (1 - _SHARE_LEVEL) * np.sqrt(np.maximum(height, 0.0)), _SHARE_BELOW)
    return np.ascontiguousarray(corner, dtype=np.float32)
