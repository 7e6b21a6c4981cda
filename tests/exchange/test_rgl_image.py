"""Exported tensor files in the stock renderer: `measured` draws what our own plugin draws."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.bsdf import Bsdf
from nacre.formats.bsdf_tables import write_rgl

SIZE, BLOCK = 128, 8
SPP = 128
FEW, MANY = 3, 16  # passes; the sky on silver spheres is the noisiest
BAND_NM = 80.0
CENTRES = np.arange(440.0, 700.0, BAND_NM)
BLOCK_BAR = 0.02  # relative L2 of 8 x 8 pixel blocks
NOISE_BAR = 0.003  # noise of a block, of the rms of all
GRAZING_DEG = 10.0  # the last degrees, of the eye and of the lamp, are left out

FILM = {
    "family": "film",
    "substrate": "Si",
    "layers": [{"material": "SiO2", "thickness_nm": 300}],
    "surface": {"roughness": 0.15},
}
COATED = {
    "family": "film",
    "substrate": "Au",
    "layers": [{"material": "TiO2", "thickness_nm": 180}],
    "surface": {"roughness": 0.3, "distribution": "beckmann"},
}
METASURFACE = {
    "family": "metasurface",
    "substrate": "glass",
    "particle": {"material": "Ag", "radius_nm": 55.0, "gap_nm": 2.0},
    "monolayer": {"coverage": 0.1, "packing": 0.3},
}
LAMP_DEG = 35.0


def scene(bsdf: Any, lamp: bool) -> dict[str, Any]:
    """Return a sphere before the eye, so far away that it is seen in parallel; a lamp at the side or a bright sky."""
    import mitsuba as mi

    from nacre.picture.passes import band_film

    towards = np.radians(LAMP_DEG)
    light: dict[str, Any] = {"type": "constant", "radiance": 1.0}
    if lamp:
        light = {"type": "directional", "direction": [-np.sin(towards), 0, -np.cos(towards)], "irradiance": 1.0}
    film = band_film(CENTRES, BAND_NM) | {"width": SIZE, "height": SIZE, "rfilter": {"type": "box"}}
    view = mi.ScalarTransform4f().look_at(origin=[0, 0, 5], target=[0, 0, 0], up=[0, 1, 0])
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2, "hide_emitters": True},
        "sensor": {
            "type": "orthographic",
            "to_world": view @ mi.ScalarTransform4f().scale([1.02, 1.02, 1]),
            "film": film,
            "sampler": {"type": "independent"},
        },
        "sphere": {"type": "sphere", "bsdf": bsdf},
        "light": light,
    }


def seen_blocks(lamp: bool) -> np.ndarray:
    """Return which blocks lie whole on the sphere and away from grazing, `[row, column]`."""
    fine = (np.arange(SIZE * 4) + 0.5) / (SIZE * 4) * 2 - 1
    x, y = np.meshgrid(1.02 * fine, -1.02 * fine)
    cos_eye = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    inside = cos_eye > np.sin(np.radians(GRAZING_DEG))
    if lamp:
        towards = np.radians(LAMP_DEG)
        inside &= np.sin(towards) * x + np.cos(towards) * cos_eye > np.sin(np.radians(GRAZING_DEG))
    count = SIZE // BLOCK
    return inside.reshape(count, BLOCK * 4, count, BLOCK * 4).all(axis=(1, 3))


def blocks(bsdf: Any, lamp: bool, count_passes: int) -> tuple[np.ndarray, float]:
    """Return the means of the blocks that count, `[block, band]`, and their noise as a share of their rms."""
    import mitsuba as mi

    loaded = mi.load_dict(scene(bsdf, lamp))
    count = SIZE // BLOCK
    passes = []
    for seed in range(count_passes):
        image = np.array(mi.render(loaded, spp=SPP, seed=seed))[..., : len(CENTRES)]
        passes.append(image.reshape(count, BLOCK, count, BLOCK, -1).mean(axis=(1, 3))[seen_blocks(lamp)])
    mean = np.mean(passes, axis=0)
    noise = np.std(passes, axis=0, ddof=1) / np.sqrt(count_passes)
    return mean, float(np.sqrt(np.mean(noise**2) / np.mean(mean**2)))


@pytest.mark.full
@pytest.mark.render
@pytest.mark.parametrize("recipe", [FILM, COATED, METASURFACE], ids=["rough film", "coated gold", "metasurface"])
@pytest.mark.parametrize("lamp", [True, False], ids=["lamp", "sky"])
def test_stock_measured_draws_what_our_plugin_draws(tmp_path: Path, recipe: dict[str, Any], lamp: bool) -> None:
    from nacre.device.variant import use_variant

    use_variant()
    import mitsuba as mi

    from nacre.device.bsdf import make_bsdf

    whole = nacre.material(recipe).bsdf()
    held = Bsdf(tuple(lobe for lobe in whole.lobes if not lobe.is_delta))
    lost = write_rgl(tmp_path / "m.bsdf", whole)
    assert bool(lost) == (recipe is METASURFACE)  # its mirror and its transmission are reported
    theirs = mi.load_dict({"type": "measured", "filename": str(tmp_path / "m.bsdf")})
    ours, noise = blocks(make_bsdf(held), lamp, MANY if recipe is METASURFACE and not lamp else FEW)
    stock, other_noise = blocks(theirs, lamp, FEW)
    error = float(np.sqrt(np.sum((stock - ours) ** 2) / np.sum(ours**2)))
    print(f"{recipe['family']} {'lamp' if lamp else 'sky'}: error {error:.4f}, noise {noise:.4f}, {other_noise:.4f}")
    assert max(noise, other_noise) <= NOISE_BAR
    assert error <= BLOCK_BAR
