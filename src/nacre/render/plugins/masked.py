"""A masked lobe on the device: another lobe's plugin, dimmed by a texture."""

from __future__ import annotations

from typing import Any

import mitsuba as mi

from nacre.bsdf.masked import MaskedLobe
from nacre.errors import UnsupportedError
from nacre.render.plugins.base import LobePlugin
from nacre.render.plugins.textures import DeviceTexture


class MaskedPlugin(LobePlugin[MaskedLobe]):
    """The inner lobe samples as ever; its weight, value and share of samples carry the mask."""

    kind = "masked"

    def __init__(self, lobe: MaskedLobe) -> None:
        from nacre.render.plugins.registry import make_plugin

        self._inner = make_plugin(lobe.inner)
        self._mask = DeviceTexture(lobe.mask)
        self._inverted = lobe.inverted
        self.components = self._inner.components
        self.pdf_is_exact = self._inner.pdf_is_exact

    def _share(self, si: Any) -> Any:
        value = self._mask(si.uv)
        return 1.0 - value if self._inverted else value

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        bs, weight = self._inner.sample(ctx, si, sample1, sample2, active, enabled)
        return bs, weight * self._share(si)

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        value, pdf = self._inner.eval_pdf(ctx, si, wo, active, enabled)
        return value * self._share(si), pdf

    def eval(self, ctx: Any, si: Any, wo: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        return self._inner.eval(ctx, si, wo, active, enabled) * self._share(si)

    def pdf(self, ctx: Any, si: Any, wo: Any, active: Any, enabled: tuple[bool, ...]) -> Any:
        return self._inner.pdf(ctx, si, wo, active, enabled)

    def choice_weight(self, si: Any, active: Any) -> Any:
        return self._inner.choice_weight(si, active) * self._share(si)

    def null_transmission(self, si: Any, active: Any) -> Any:
        """Return what passes straight through the inner lobe, dimmed by the mask."""
        null = getattr(self._inner, "null_transmission", None)
        return mi.Spectrum(0.0) if null is None else null(si, active) * self._share(si)

    def update(self, lobe: MaskedLobe) -> None:
        if lobe.inverted != self._inverted or lobe.mask.formula != self._mask.formula:
            raise UnsupportedError("the mask changed in kind; build the scene again")
        self._inner.update(lobe.inner)
        self._mask = DeviceTexture(lobe.mask)

    def traverse(self, callback: Any, prefix: str) -> None:
        self._inner.traverse(callback, prefix)

    def parameters_changed(self) -> None:
        self._inner.parameters_changed()
