"""Polarising filters before the camera and the lights, and Stokes images, in Mitsuba's polarised variants.

Angles are those of the transmission axis from the horizontal, counter-clockwise as seen against the light. "left" and
"right" name circularly polarised light as Mitsuba does (`mi.mueller.right_circular_polarizer`); see the page "Which
circular is right?".
"""

import math
from typing import Any

import numpy as np

from nacre.core.errors import NacreError
from nacre.picture.lights.emitter_plugins import DistantEmitter
from nacre.picture.plugin import WrappedIntegrator, dr, make_plugin, mi

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
