"""Wavelengths that pictures draw: no colour changes, and the noise of each falls."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import nacre
from nacre.light.tristimulus import observer, table_wavelengths_nm

pytestmark = pytest.mark.render


def drawn(response: Any) -> tuple[np.ndarray, np.ndarray]:
    """XYZ of light of equal energy, estimated by single wavelengths of paths, `[draw, 3]`; the wavelengths `[draw]`."""
    from nacre.device.variant import use_variant

    mi = use_variant()
    sensor = mi.load_dict({"type": "perspective", **({"srf": response} if response is not None else {})})
    places = (np.arange(1 << 14) + 0.5) / (1 << 14)
    ray, weight = sensor.sample_ray(0.0, mi.Float(places), mi.Point2f(0.5, 0.5), mi.Point2f(0.5, 0.5))
    if response is not None:
        si = mi.SurfaceInteraction3f()
        si.wavelengths = ray.wavelengths
        weight = weight / response.eval(si)
    wavelengths, weights = np.array(ray.wavelengths, dtype=float).ravel(), np.array(weight, dtype=float).ravel()
    matching = np.stack([np.interp(wavelengths, table_wavelengths_nm(), curve) for curve in observer("2deg").T], -1)
    return weights[:, None] * matching, wavelengths


def test_light_keeps_its_colour_and_each_part_of_it_has_less_noise() -> None:
    from nacre.picture.passes import wavelength_density

    ours, wavelengths = drawn(wavelength_density())
    theirs, _ = drawn(None)
    true = observer("2deg").sum(axis=0)
    # single precision over 16,384 even places: a thousandth is ten times what they leave
    assert np.abs(ours.mean(axis=0) / true - 1.0).max() < 1e-3
    assert wavelengths.min() >= 360.0 and wavelengths.max() <= 830.0
    assert (ours.var(axis=0) < theirs.var(axis=0)).all()
    # and so do the four wavelengths of a path together, of which those of light without colour nearly cancel
    paths = [draws.reshape(-1, 4, 3).mean(axis=1) for draws in (ours, theirs)]
    assert (paths[0].var(axis=0) < paths[1].var(axis=0)).all()


def test_pictures_keep_their_mean(monkeypatch: pytest.MonkeyPatch) -> None:
    from nacre.picture import passes

    blue = nacre.material({"family": "film", "substrate": "Ti", "layers": [{"material": "TiO2", "thickness_nm": 45}]})

    def mean() -> np.ndarray:
        made = nacre.render.render(blue, size=(48, 48), spp=64, exposure=0.0, denoise=False)
        return made.xyz.mean(axis=(0, 1))

    ours = mean()
    monkeypatch.setattr(passes, "_response", lambda scene: None)
    # 150,000 paths, each XYZ known to some 60 % by its wavelengths: 0.2 %, and as much for what it meets
    assert np.abs(ours / mean() - 1.0).max() < 0.01


def test_a_wavelength_that_rounding_puts_beyond_the_last_is_dark() -> None:
    """Light over a density of nothing is no number: a path in 60,000 left its pixel black."""
    from nacre.device.variant import use_variant
    from nacre.picture.passes import divided, wavelength_density

    mi = use_variant()

    class White:
        def sample(self, *_: Any) -> Any:
            return mi.Spectrum(1.0), mi.Bool(True), []

    ray = mi.Ray3f()
    ray.wavelengths = mi.Spectrum(550.0, 829.9, 830.0001, 359.9999)
    light = np.array(divided(White(), wavelength_density()).sample(None, None, ray)[0]).ravel()
    assert np.isfinite(light).all() and (light[:2] > 0.0).all() and (light[2:] == 0.0).all()
