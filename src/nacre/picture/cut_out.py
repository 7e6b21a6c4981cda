"""Objects cut out of their scene: camera rays that meet anything else are clear, while the scene lights on."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

from nacre.device.variant import use_variant


def cut_out(integrator: Any, shapes: Sequence[Any]) -> Any:
    """Return an integrator that sees these shapes alone, as `integrator` sees them, and is clear elsewhere.

    What the shapes mirror and what shines on them stays. With a film that has an alpha channel the picture is
    premultiplied by it.
    """
    mi = use_variant()
    return _class(mi.variant())(mi.Properties(), integrator, shapes)


@functools.cache
def _class(variant: str) -> type:
    """Define the class for a variant: Mitsuba's base class differs from variant to variant."""
    import drjit as dr

    mi: Any = use_variant()
    is_scalar = variant.startswith("scalar")

    class CutOut(mi.SamplingIntegrator):
        """An integrator that is told which shapes to see."""

        def __init__(self, properties: Any, inner: Any, shapes: Sequence[Any]) -> None:
            super().__init__(properties)
            self.inner, self.shapes = inner, list(shapes)

        def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
            first = scene.ray_intersect_preliminary(ray, True, active)
            is_seen = mi.Bool(False)
            for shape in self.shapes:
                is_seen = is_seen | (first.shape == (shape if is_scalar else mi.ShapePtr(shape)))
            light, is_valid, rest = self.inner.sample(scene, sampler, ray, medium, active & is_seen)
            is_seen = is_seen & is_valid & active
            return dr.select(is_seen, light, 0.0), is_seen, rest

        def aov_names(self) -> list[str]:
            return list(self.inner.aov_names())

    return CutOut
