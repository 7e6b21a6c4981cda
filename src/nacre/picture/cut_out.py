"""Objects apart from their scene: cut out, so that camera rays that meet anything else are clear while the scene
lights on; and which pixels see them."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.device.variant import use_variant

RAYS_AT_ONCE = 1 << 20  # bounds memory


def cut_out(integrator: Any, shapes: Sequence[Any]) -> Any:
    """Return an integrator that sees these shapes alone, as `integrator` sees them, and is clear elsewhere.

    What the shapes mirror and what shines on them stays. With a film that has an alpha channel the picture is
    premultiplied by it.
    """
    mi = use_variant()
    return _class(mi.variant())(mi.Properties(), integrator, shapes)


def sees_objects(
    scene: Any, sensor: Any, shapes: Sequence[Any], size: tuple[int, int], at_once: int = RAYS_AT_ONCE
) -> NDArray[np.bool_]:
    """Return which pixels `[row, column]` see one of the shapes in their middle.

    Args:
        scene, sensor: of Mitsuba.
        shapes: of the scene.
        size: width and height.
        at_once: rays that are traced together.
    """
    import drjit as dr

    mi = use_variant()
    width, height = size
    found = np.zeros(width * height, dtype=bool)
    # a scalar variant knows one ray at a time
    step = 1 if mi.variant().startswith("scalar") else at_once
    for begun in range(0, width * height, step):
        index = np.arange(begun, min(begun + step, width * height))
        x, y = (index % width + 0.5) / width, (index // width + 0.5) / height
        place = mi.Point2f(float(x[0]), float(y[0])) if step == 1 else mi.Point2f(mi.Float(x), mi.Float(y))
        ray, _ = sensor.sample_ray(0.0, 0.5, place, mi.Point2f(0.5, 0.5))
        first = scene.ray_intersect_preliminary(ray, True)
        is_seen = is_one_of(first, shapes)
        found[index] = np.asarray(is_seen) if step == 1 else np.asarray(is_seen & dr.full(mi.Bool, True, len(index)))
    return found.reshape(height, width)


def is_one_of(met: Any, shapes: Sequence[Any]) -> Any:
    """Whether what rays met, an interaction of Mitsuba, belongs to one of the shapes."""
    mi = use_variant()
    is_scalar = mi.variant().startswith("scalar")
    is_seen = mi.Bool(False)
    for shape in shapes:
        is_seen = is_seen | (met.shape == (shape if is_scalar else mi.ShapePtr(shape)))
    return is_seen


@functools.cache
def _class(variant: str) -> type:
    """Define the class for a variant: Mitsuba's base class differs from variant to variant."""
    import drjit as dr

    mi: Any = use_variant()

    class CutOut(mi.SamplingIntegrator):
        """An integrator that is told which shapes to see."""

        def __init__(self, properties: Any, inner: Any, shapes: Sequence[Any]) -> None:
            super().__init__(properties)
            self.inner, self.shapes = inner, list(shapes)

        def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
            is_seen = is_one_of(scene.ray_intersect_preliminary(ray, True, active), self.shapes)
            light, is_valid, rest = self.inner.sample(scene, sampler, ray, medium, active & is_seen)
            is_seen = is_seen & is_valid & active
            return dr.select(is_seen, light, 0.0), is_seen, rest

        def aov_names(self) -> list[str]:
            return list(self.inner.aov_names())

    return CutOut
