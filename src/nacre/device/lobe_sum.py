"""The Mitsuba BSDF around one or several lobes: mixing, two sides, component masks, updates.

It receives its lobes as plugins and imports no list of them: a lobe may contain such a sum itself.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from nacre.bsdf.lobe import Lobe
from nacre.bsdf.polarisation import InterfacePolarisation
from nacre.core.errors import UnsupportedError
from nacre.device.plugin import Facet, LobePlugin, UniformNodes, is_radiance, larger, negated, opaque, smaller, with_wi
from nacre.device.tables import DeviceTable, ObjectSpace, WavelengthAxis
from nacre.device.variant import depolarised


def update_lobes(target: Any, lobes: Sequence[Lobe]) -> None:
    """Replace the data of a lobe sum by other lobes with the same kinds and shapes.

    Raises:
        UnsupportedError: number, kinds or shapes of the lobes differ: build the scene again.
    """
    if [lobe.kind for lobe in lobes] != [plugin.kind for plugin in target.plugins]:
        raise UnsupportedError("the number or kind of the material's lobes changed; build the scene again")
    for plugin, lobe in zip(target.plugins, lobes, strict=True):
        plugin.update(lobe)


class LobeSum:
    """The methods of the Mitsuba BSDF, independent of the variant's base class.

    Attributes:
        plugins: the lobes.
        words: Mitsuba's flag word for each component of all lobes.
        delta: whether each lobe is a pure delta distribution.
        object_space: converts interactions for the textures; optional.
        polarisation: Mueller matrices of the facets in polarised variants; without it all lobes depolarise.
    """

    def __init__(
        self,
        plugins: Sequence[LobePlugin[Any]],
        mirrors_back: bool,
        object_space: ObjectSpace | None,
        polarisation: DevicePolarisation | None = None,
    ) -> None:
        self.plugins = list(plugins)
        self.polarisation = polarisation
        self.mirrors_back = mirrors_back
        self.object_space = object_space
        back = int(mi.BSDFFlags.BackSide) if mirrors_back else 0
        self.words = [word | back for plugin in self.plugins for word in plugin.components]
        self._all_flags = int(mi.BSDFFlags.All)
        self._delta_flags = int(mi.BSDFFlags.Delta | mi.BSDFFlags.Null)
        others = self._all_flags & ~self._delta_flags
        self.delta = [not any(word & others for word in plugin.components) for plugin in self.plugins]

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any) -> Any:
        front, turned = self._front(si)
        enabled = self._enabled(ctx)
        if len(self.plugins) == 1:
            bs, weight = self.plugins[0].sample(ctx, front, sample1, sample2, active, enabled[0])
        else:
            bs, weight = self._sample_sum(ctx, front, sample1, sample2, active, enabled)
        if turned is not None:
            bs.wo = mi.Vector3f(bs.wo.x, bs.wo.y, dr.select(turned, -bs.wo.z, bs.wo.z))
        if not mi.is_polarized:
            return bs, weight
        return bs, scaled(self._sampled_matrix(ctx, si, bs, active), weight)

    def eval(self, ctx: Any, si: Any, wo: Any, active: Any) -> Any:
        front, turned_wo = self._front_pair(si, wo)
        total = mi.Spectrum(0.0)
        for plugin, enabled, delta in zip(self.plugins, self._enabled(ctx), self.delta, strict=True):
            if not delta:
                value = plugin.eval(ctx, front, turned_wo, active, enabled)
                total = total + self._polarised(plugin, ctx, si, wo, value, active, enabled)
        return total

    def _polarised(
        self, plugin: LobePlugin[Any], ctx: Any, si: Any, wo: Any, value: Any, active: Any, enabled: tuple[bool, ...]
    ) -> Any:
        """Return a lobe's value; in polarised variants, as a Mueller matrix in the implicit frames."""
        if not mi.is_polarized:
            return value
        matrix = self._facet_matrix(plugin, ctx, si, wo, active)
        if matrix is None:
            return mi.mueller.depolarizer(value)
        rest = plugin.eval_depolarised(ctx, *self._front_pair(si, wo), active, enabled)
        if rest is None:
            return scaled(matrix, value)
        return scaled(matrix, value - rest) + mi.mueller.depolarizer(rest)

    def _facet_matrix(self, plugin: LobePlugin[Any], ctx: Any, si: Any, wo: Any, active: Any) -> Any:
        """Return the normalised Mueller matrix of a lobe's facet; None if the lobe depolarises."""
        front, turned = self._front(si)
        mirrored = wo if turned is None else mi.Vector3f(wo.x, wo.y, dr.select(turned, -wo.z, wo.z))
        facet = None if self.polarisation is None else plugin.facet(front, mirrored, active)
        if facet is None or self.polarisation is None:
            return None
        if turned is not None:
            n = facet.normal
            facet = facet._replace(normal=mi.Vector3f(n.x, n.y, dr.select(turned, -n.z, n.z)))
        return self.polarisation.matrix(ctx, self._placed(si), wo, facet, active)

    def _sampled_matrix(self, ctx: Any, si: Any, bs: Any, active: Any) -> Any:
        """Return the normalised Mueller matrix of a sample."""
        normalised = mi.mueller.depolarizer(mi.UnpolarizedSpectrum(1.0))
        if self.polarisation is None:
            return normalised
        is_delta = (bs.sampled_type & self._delta_flags) != 0
        if not all(self.delta):
            value = self.eval(ctx, si, bs.wo, active & negated(is_delta))
            total = value[0, 0]
            share = dr.select(total > 0.0, dr.rcp(larger(total, 1e-30)), 0.0)
            normalised = dr.select(is_delta, normalised, scaled(value, share))
        first = 0
        for plugin, delta in zip(self.plugins, self.delta, strict=True):
            last = first + len(plugin.components)
            if delta:
                matrix = self._facet_matrix(plugin, ctx, si, bs.wo, active)
                if matrix is not None:
                    is_own = (bs.sampled_component >= first) & (bs.sampled_component < last)
                    normalised = dr.select(is_own, matrix, normalised)
            first = last
        return normalised

    def pdf(self, ctx: Any, si: Any, wo: Any, active: Any) -> Any:
        si, wo = self._front_pair(si, wo)
        enabled = self._enabled(ctx)
        if len(self.plugins) == 1:
            return self.plugins[0].pdf(ctx, si, wo, active, enabled[0])
        return self._eval_pdf_sum(ctx, si, wo, active, enabled)[1]

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any) -> Any:
        enabled = self._enabled(ctx)
        if mi.is_polarized:
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)
        si, wo = self._front_pair(si, wo)
        if len(self.plugins) == 1:
            return self.plugins[0].eval_pdf(ctx, si, wo, active, enabled[0])
        return self._eval_pdf_sum(ctx, si, wo, active, enabled)

    def null_transmission(self, si: Any, active: Any) -> Any:
        total = mi.Spectrum(0.0)
        placed = self._placed(si)
        for plugin in self.plugins:
            null = getattr(plugin, "null_transmission", None)
            if null is not None:
                value = null(placed, active)
                matrix = self._facet_matrix(plugin, mi.BSDFContext(), si, -si.wi, active) if mi.is_polarized else None
                total = total + (depolarised(value) if matrix is None else scaled(matrix, value))
        return total

    def _placed(self, si: Any) -> Any:
        return si if self.object_space is None else self.object_space(si)

    def _front(self, si: Any) -> tuple[Any, Any]:
        si = self._placed(si)
        if not self.mirrors_back:
            return si, None
        turned = si.wi.z < 0
        return with_wi(si, mi.Vector3f(si.wi.x, si.wi.y, dr.abs(si.wi.z))), turned

    def _front_pair(self, si: Any, wo: Any) -> tuple[Any, Any]:
        si, turned = self._front(si)
        if turned is not None:
            wo = mi.Vector3f(wo.x, wo.y, dr.select(turned, -wo.z, wo.z))
        return si, wo

    def _enabled(self, ctx: Any) -> list[tuple[bool, ...]]:
        """Return which components of each lobe the context enables."""
        masks, index = [], 0
        for plugin in self.plugins:
            words = self.words[index : index + len(plugin.components)]
            masks.append(tuple(self._is_enabled(ctx, word, index + i) for i, word in enumerate(words)))
            index += len(words)
        return masks

    def _is_enabled(self, ctx: Any, word: int, index: int) -> bool:
        """Whether any type of a component is enabled: that of a random walk may be glossy and specular."""
        word &= self._all_flags
        types = [1 << bit for bit in range(word.bit_length()) if word >> bit & 1]
        return any(bool(ctx.is_enabled(mi.BSDFFlags(flag), index)) for flag in types)

    def _shares(self, si: Any, active: Any, enabled: list[tuple[bool, ...]]) -> list[Any]:
        """Return each lobe's share of the samples."""
        weights = [
            plugin.choice_weight(si, active) if any(mask) else mi.Float(0.0)
            for plugin, mask in zip(self.plugins, enabled, strict=True)
        ]
        total = sum(weights[1:], weights[0])
        inverse = dr.select(total > 0.0, 1.0 / larger(total, 1e-20), 0.0)
        return [weight * inverse for weight in weights]

    def _sample_sum(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any, enabled: Any) -> Any:
        shares = self._shares(si, active, enabled)
        bs, weight = dr.zeros(mi.BSDFSample3f), mi.UnpolarizedSpectrum(0.0)
        below, first = mi.Float(0.0), 0
        is_delta = mi.Bool(False)
        for k, (plugin, share) in enumerate(zip(self.plugins, shares, strict=True)):
            above = below + share
            chosen = active & (sample1 >= below) & (share > 0.0)
            if k + 1 < len(self.plugins):  # rounding may leave the last bound below 1
                chosen = chosen & (sample1 < above)
            rest = larger(smaller((sample1 - below) / larger(share, 1e-20), 0.99999994), 0.0)
            # a specular lobe repeats the look-up of its share; with an equal mask the compiler merges both reads
            mask = active if self.delta[k] else chosen
            one, value = plugin.sample(ctx, si, rest, sample2, mask, enabled[k])
            one.pdf = one.pdf * share
            one.sampled_component = one.sampled_component + first
            bs = dr.select(chosen, one, bs)
            weight = dr.select(chosen, value * dr.rcp(larger(share, 1e-20)), weight)
            is_delta = dr.select(chosen, (one.sampled_type & self._delta_flags) != 0, is_delta)
            below, first = above, first + len(plugin.components)
        if sum(not delta for delta in self.delta) > 1 and all(p.pdf_is_exact for p in self.plugins):
            # two broad lobes may overlap: use value and density of the sum, as in multiple importance sampling
            value, pdf = self._eval_pdf_sum(ctx, si, bs.wo, active & negated(is_delta), enabled, shares)
            broad = active & negated(is_delta) & (pdf > 0.0) & (bs.pdf > 0.0)
            weight = dr.select(broad, value / larger(pdf, 1e-20), weight)
            bs.pdf = dr.select(broad, pdf, bs.pdf)
        return bs, weight & active

    def _eval_pdf_sum(
        self, ctx: Any, si: Any, wo: Any, active: Any, enabled: Any, shares: list[Any] | None = None
    ) -> Any:
        shares = self._shares(si, active, enabled) if shares is None else shares
        total, density = mi.UnpolarizedSpectrum(0.0), mi.Float(0.0)
        for plugin, mask, share, delta in zip(self.plugins, enabled, shares, self.delta, strict=True):
            if delta:
                continue
            value, pdf = plugin.eval_pdf(ctx, si, wo, active, mask)
            total, density = total + value, density + share * pdf
        return total, density


@functools.cache
def bsdf_class(variant: str) -> type:
    """Define the BSDF class for a variant, since Mitsuba's base class depends on the variant."""

    class NacreBSDF(mi.BSDF):
        """A lobe sum."""

        def __init__(
            self,
            properties: Any,
            plugins: Sequence[LobePlugin[Any]],
            mirrors_back: bool,
            object_space: ObjectSpace | None = None,
            polarisation: DevicePolarisation | None = None,
        ) -> None:
            super().__init__(properties)
            self.sum = LobeSum(plugins, mirrors_back, object_space, polarisation)
            self.plugins, self.delta, self.object_space = self.sum.plugins, self.sum.delta, object_space
            self.m_components = self.sum.words
            self.m_flags = functools.reduce(lambda a, b: a | b, self.sum.words)

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            return self.sum.sample(ctx, si, sample1, sample2, active)

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.sum.eval(ctx, si, wo, active)

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.sum.pdf(ctx, si, wo, active)

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.sum.eval_pdf(ctx, si, wo, active)

        def eval_null_transmission(self, si: Any, active: Any = True) -> Any:
            return self.sum.null_transmission(si, active)

        def traverse(self, callback: Any) -> None:
            for i, plugin in enumerate(self.plugins):
                plugin.traverse(callback, "" if len(self.plugins) == 1 else f"lobe_{i}_")

        def parameters_changed(self, keys: Any) -> None:
            for plugin in self.plugins:
                plugin.parameters_changed()

        def to_string(self) -> str:
            return f"NacreBSDF[{', '.join(plugin.kind for plugin in self.plugins)}]"

    return NacreBSDF


# Mueller matrices in Mitsuba's polarised variants.
#
# Mitsuba multiplies Stokes vectors of light that travels along `-L` before and along `V` after the surface, `L` and `V`
# being the directions to the light and to the viewer. Each wave has the implicit Stokes frame
# `mi.mueller.stokes_basis`.

DARKEST = 1e-12  # power below which a matrix is taken as depolarising


def scaled(matrix: Any, value: Any) -> Any:
    """Return a Mueller matrix times a spectrum (`*` would be the product of a matrix and a vector)."""
    return mi.Spectrum([[matrix[i, j] * value for j in range(4)] for i in range(4)])


class DevicePolarisation:
    """Normalised Mueller matrices of an interface, from its tables.

    Args:
        tables: the tables.
        is_of_azimuth: whether the lobes' values depend on the azimuth; otherwise they are means over it.
    """

    def __init__(self, tables: InterfacePolarisation, is_of_azimuth: bool = False) -> None:
        self.is_of_azimuth = is_of_azimuth
        regions = [tables.reflected]
        starts = [0]
        for region in (tables.reflected_inside, tables.total, tables.transmitted, tables.transmitted_inside):
            starts.append(sum(each.shape[1] for each in regions))
            if region is not None:
                regions.append(region)
        stacked = np.concatenate(regions, axis=1)
        self.transmits = tables.transmitted is not None
        self.has_total = tables.total is not None
        self.is_isotropic = len(stacked) == 1
        self.axis = WavelengthAxis(tables.wavelengths_nm)
        stacked = stacked[0] if self.is_isotropic else stacked
        self.pairs = [DeviceTable(stacked[..., k : k + 2]) for k in range(0, stacked.shape[-1], 2)]
        self.azimuths = None if self.is_isotropic else UniformNodes(len(stacked))
        nodes = tables.reflected.shape[1]
        self.top, self.max_low = opaque(nodes - 1), opaque(nodes - 2)
        self.inside_row, self.total_row, self.transmitted_row, self.returned_row = (opaque(s) for s in starts[1:])
        total = 2 if tables.total is None else tables.total.shape[1]
        self.total_scale, self.total_max_low = opaque((total - 1) * 2.0 / math.pi), opaque(total - 2)
        self.eta = opaque(tables.eta)
        critical = math.sqrt(max(0.0, 1.0 - 1.0 / tables.eta**2))
        self.critical, self.inv_critical = opaque(critical), opaque(1.0 / max(critical, 1e-6))

    def matrix(self, ctx: Any, si: Any, wo: Any, facet: Facet, active: Any) -> Any:
        """Return the Mueller matrix in the implicit Stokes frames, relative to the unpolarised value.

        If the value is a mean over the azimuth, an anisotropic interface is brighter at some azimuths.
        """
        light, view = (wo, si.wi) if is_radiance(ctx) else (si.wi, wo)
        is_crossed = negated(facet.reflects) if is_radiance(ctx) else mi.Bool(False)
        row, fraction = self._row(facet, facet.inside ^ is_crossed)
        where = self.axis.locate(si.wavelengths, active)
        corners = None if self.azimuths is None else self._corners(light, facet.normal)
        elements = [value for table in self.pairs for value in table.look_up(row, fraction, where, corners, active)]
        if self.is_isotropic:
            matrix = _without_conversion(*elements)
        else:
            if self.is_of_azimuth:
                first = elements[0]
                scale = dr.select(first > DARKEST, dr.rcp(larger(first, DARKEST)), 0.0)
                elements = [element * scale for element in elements]
            matrix = mi.Spectrum([elements[k : k + 4] for k in range(0, 16, 4)])
        return in_implicit_frames(matrix, light, view, facet.normal)

    def _corners(self, light: Any, normal: Any) -> list[tuple[Any, Any]]:
        """Return the two nodes around the light's azimuth in the facet's frame, with their weights."""
        assert self.azimuths is not None
        up = dr.select(normal.z < 0.0, -normal, normal)
        shear = dr.rcp(1.0 + up.z)
        x = light.x - up.x * (light.z + (light.x * up.x + light.y * up.y) * shear)
        y = light.y - up.y * (light.z + (light.x * up.x + light.y * up.y) * shear)
        turns = dr.atan2(y, x) * (0.5 * dr.inv_pi)
        last = self.azimuths.last
        low, part = self.azimuths.cell(smaller((turns - dr.floor(turns)) * last, last))
        return [(low, 1.0 - part), (low + 1, part)]

    def _row(self, facet: Facet, lit_inside: Any) -> tuple[Any, Any]:
        """Return the tables' row and the fraction above it; `lit_inside`: the light comes from the denser side."""
        cos = smaller(facet.cos, 1.0)
        if not self.transmits:
            position = cos * self.top
            low = smaller(dr.floor(position), self.max_low)
            return mi.UInt32(low), position - low
        outside2 = 1.0 - dr.square(self.eta) * (1.0 - cos * cos)
        position = dr.select(facet.inside, dr.sqrt(larger(outside2, 0.0)), cos) * self.top
        low = smaller(dr.floor(position), self.max_low)
        through = dr.select(lit_inside, self.returned_row, self.transmitted_row)
        start = dr.select(facet.reflects, dr.select(facet.inside, self.inside_row, 0.0), through)
        if self.has_total:
            is_total = facet.inside & (cos < self.critical)
            x = dr.acos(larger(smaller(cos * self.inv_critical, 1.0), 0.0)) * self.total_scale
            position = dr.select(is_total, x, position)
            low = dr.select(is_total, smaller(dr.floor(x), self.total_max_low), low)
            start = dr.select(is_total, self.total_row, start)
        return mi.UInt32(low + start), position - low


def _without_conversion(a: Any, b: Any, c: Any, d: Any) -> Any:
    """Return the matrix of an interface without polarisation conversion, relative to its first element."""
    is_lit = a > DARKEST
    scale = dr.select(is_lit, dr.rcp(larger(a, DARKEST)), 0.0)
    one, zero = mi.UnpolarizedSpectrum(1.0), mi.UnpolarizedSpectrum(0.0)
    b, c, d, lit = b * scale, c * scale, d * scale, dr.select(is_lit, one, zero)
    return mi.Spectrum([[one, b, zero, zero], [b, lit, zero, zero], [zero, zero, c, -d], [zero, zero, d, c]])


def in_implicit_frames(matrix: Any, light: Any, view: Any, normal: Any) -> Any:
    """Return a matrix given in the frames (s, k x s) of a facet in Mitsuba's implicit frames.

    Args:
        matrix: Mueller matrix.
        light, view: local directions to the light and to the viewer.
        normal: the facet's normal.
    """
    incoming = -light
    s_in, s_out = _perpendicular(normal, incoming), _perpendicular(normal, view)
    return mi.mueller.rotate_mueller_basis(
        matrix, incoming, s_in, mi.mueller.stokes_basis(incoming), view, s_out, mi.mueller.stokes_basis(view)
    )


def _perpendicular(normal: Any, k: Any) -> Any:
    """Return the unit vector along `normal x k`, or any vector perpendicular to a parallel normal."""
    s = dr.cross(normal, k)
    length2 = dr.dot(s, s)
    other = mi.Frame3f(normal).s
    return dr.select(length2 > 1e-12, s * dr.rsqrt(larger(length2, 1e-20)), other)
