"""A masked lobe on the device: another lobe's plugin, multiplied by a texture."""

from __future__ import annotations

import math
import weakref
from typing import Any

import drjit as dr
import mitsuba as mi

from nacre.bsdf.lobes.masked import MaskedLobe
from nacre.bsdf.texture import Texture
from nacre.core.errors import UnsupportedError
from nacre.device.plugin import LobePlugin, MakePlugin, opaque
from nacre.device.tables import DeviceTexture

# The nodes of a varying parameter share one texture: one device copy, read once.
_TEXTURES: weakref.WeakValueDictionary[tuple[str, int], _Shared] = weakref.WeakValueDictionary()


class _Shared(DeviceTexture):
    """A device texture with a reference to its source, which keeps the source's id unique."""

    def __init__(self, texture: Texture) -> None:
        super().__init__(texture)
        self.source = texture


def _shared(texture: Texture) -> _Shared:
    key = (mi.variant(), id(texture))
    shared = _TEXTURES.get(key)
    if shared is None or shared.source is not texture:
        shared = _TEXTURES[key] = _Shared(texture)
    return shared


class MaskedPlugin(LobePlugin[MaskedLobe]):
    """The inner lobe's sampling; its weight, value and sample share are multiplied by the mask."""

    kind = "masked"
    holds_lobes = True

    def __init__(self, lobe: MaskedLobe, make_plugin: MakePlugin) -> None:
        self._inner = make_plugin(lobe.inner)
        self._inverted = lobe.inverted
        self._has_nodes = lobe.nodes is not None
        self._take(lobe)
        self.components = self._inner.components
        self.pdf_is_exact = self._inner.pdf_is_exact

    def _take(self, lobe: MaskedLobe) -> None:
        self._mask = _shared(lobe.mask)
        if lobe.nodes is not None:
            at, nodes = float(lobe.nodes[lobe.node]), lobe.nodes
            # beyond the end nodes the weight is 1: an infinitely distant flank
            below = at - float(nodes[lobe.node - 1]) if lobe.node > 0 else math.inf
            above = float(nodes[lobe.node + 1]) - at if lobe.node + 1 < len(nodes) else math.inf
            self._at, self._rise, self._fall = opaque(at), opaque(1.0 / below), opaque(1.0 / above)

    def _share(self, si: Any) -> Any:
        value = self._mask(si)
        if self._has_nodes:
            away = value - self._at
            return dr.clip(1.0 - dr.maximum(-away * self._rise, away * self._fall), 0.0, 1.0)
        return 1.0 - value if self._inverted else value

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        share = self._share(si)  # lanes with zero weight skip the random walk
        bs, weight = self._inner.sample(ctx, si, sample1, sample2, active & (share > 0.0), enabled)
        return bs, weight * share

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        share = self._share(si)
        value, pdf = self._inner.eval_pdf(ctx, si, wo, active & (share > 0.0), enabled)
        return value * share, pdf

    def eval(self, ctx: Any, si: Any, wo: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        share = self._share(si)
        return self._inner.eval(ctx, si, wo, active & (share > 0.0), enabled) * share

    def pdf(self, ctx: Any, si: Any, wo: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        return self._inner.pdf(ctx, si, wo, active, enabled)

    def choice_weight(self, si: Any, active: Any) -> Any:
        return self._inner.choice_weight(si, active) * self._share(si)

    def null_transmission(self, si: Any, active: Any) -> Any:
        """Return the inner lobe's undeviated transmission times the mask."""
        null = getattr(self._inner, "null_transmission", None)
        return mi.UnpolarizedSpectrum(0.0) if null is None else null(si, active) * self._share(si)

    def update(self, lobe: MaskedLobe) -> None:
        same_kind = lobe.inverted == self._inverted and (lobe.nodes is not None) == self._has_nodes
        if not same_kind or not self._mask.fits(lobe.mask):
            raise UnsupportedError("the mask changed its structure; build the scene again")
        self._inner.update(lobe.inner)
        self._take(lobe)

    def traverse(self, callback: Any, prefix: str) -> None:
        self._inner.traverse(callback, prefix)

    def parameters_changed(self) -> None:
        self._inner.parameters_changed()
