"""Another material below the strata: its own plugins, sampled by the walk at the base.

The lobes were computed with the last resin as their ambient, so directions inside that resin are their own. Their
mirror part is treated like the mirrors between the strata; the rest is a vertex of the walk.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from nacre.bsdf.contract import Lobe
from nacre.device.base import MIN_COS, MakePlugin, with_wi
from nacre.device.lobe_sum import bsdf_class, update_lobes
from nacre.device.tables import Located


class BaseLobes:
    """The lobes of a base on the device.

    Attributes:
        has_mirror: whether a part is a mirror.
        scatters: whether a part is none.
    """

    def __init__(self, lobes: tuple[Lobe, ...], make_plugin: MakePlugin) -> None:
        self.bsdf = bsdf_class(mi.variant())(mi.Properties(), [make_plugin(lobe) for lobe in lobes], False)
        self._mirrors = [plugin for plugin, delta in zip(self.bsdf.plugins, self.bsdf.delta, strict=True) if delta]
        self.has_mirror = bool(self._mirrors)
        self.scatters = len(self._mirrors) < len(self.bsdf.plugins)
        self._context = mi.BSDFContext()

    def update(self, lobes: tuple[Lobe, ...]) -> None:
        """Take over the numbers of other lobes of the same kinds and shapes.

        Raises:
            UnsupportedError: the structure differs.
        """
        update_lobes(self.bsdf, lobes)

    def sample(self, v: Any, rng: Any, where: Located, active: Any) -> tuple[Any, Any, Any]:
        """Draw a direction for light from `v`; return it, its weight a wavelength, and whether a mirror gave it."""
        first = rng.next_float32(active)
        point = mi.Point2f(rng.next_float32(active), rng.next_float32(active))
        bs, weight = self.bsdf.sample(self._context, with_wi(where.site, v), first, point, active)
        up = active & (bs.wo.z > MIN_COS) & (bs.pdf > 0.0)
        mirror = (bs.sampled_type & int(mi.BSDFFlags.Delta)) != 0
        direction = dr.select(up, bs.wo, mi.Vector3f(0.0, 0.0, 1.0))
        return direction, _finite(weight, up), mirror

    def eval(self, v: Any, to: Any, where: Located, active: Any) -> Any:
        """Return value * |cos to| of the part that is no mirror, for light from `v` that leaves along `to`."""
        if not self.scatters:
            return mi.Spectrum(0.0)
        value = self.bsdf.eval(self._context, with_wi(where.site, v), to, active & (to.z > MIN_COS))
        return _finite(value, active)

    def pdf(self, v: Any, to: Any, where: Located, active: Any) -> Any:
        """Return the density of `to` among what `sample` draws and no mirror gives."""
        density = self.bsdf.pdf(self._context, with_wi(where.site, v), to, active)
        return dr.select(dr.isfinite(density), density, 0.0)

    def mirror(self, cos: Any, where: Located, active: Any) -> Any:
        """Return the reflectance of the mirror part at a cosine."""
        si = with_wi(where.site, mi.Vector3f(dr.safe_sqrt(1.0 - cos * cos), 0.0, cos))
        total = mi.Spectrum(0.0)
        for plugin in self._mirrors:
            every = tuple(True for _ in plugin.components)
            total += plugin.sample(self._context, si, mi.Float(0.0), mi.Point2f(0.0), active, every)[1]
        return _finite(total, active)


def _finite(value: Any, active: Any) -> Any:
    """Return a Spectrum whose numbers are all finite."""
    return mi.Spectrum(dr.select(mi.Bool(active) & dr.all(dr.isfinite(value)), mi.Spectrum(value), 0.0))
