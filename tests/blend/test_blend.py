"""Blends: each material where the mask says, between them the weighted sum, on the device as on arrays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nacre
from nacre.cli import run
from nacre.core.errors import RecipeError

GOLD = 'family = "film"\nsubstrate = "Au"\n[surface]\nroughness = 0.3\n'
OXIDE = GOLD.replace('"Au"', '"Si"\nlayers = [{material = "SiO2", thickness_nm = 300}]')


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "gold.toml").write_text(GOLD)
    (tmp_path / "oxide.toml").write_text(OXIDE)
    return tmp_path


def blend(folder: Path, mask: str) -> nacre.Material:
    path = folder / "blend.toml"
    path.write_text(
        f'family = "blend"\nmask = {mask}\nfirst = {{recipe = "gold.toml"}}\nsecond = {{recipe = "oxide.toml"}}\n'
    )
    return nacre.load(path)


def pairs(count: int = 50) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    generator = np.random.default_rng(0)
    z, phi = generator.uniform(0.3, 1, (2, count)), generator.uniform(0, 6, (2, count))
    r = np.sqrt(1 - z**2)
    wi, wo = np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=-1)
    return wi, wo, generator.random((count, 2))


def test_each_material_stands_where_the_mask_says(folder: Path) -> None:
    material = blend(folder, '{formula = "step(0.5, u)"}')
    gold, oxide = nacre.load(folder / "gold.toml").bsdf(), nacre.load(folder / "oxide.toml").bsdf()
    wi, wo, uv = pairs()
    expected = np.where(uv[:, :1] < 0.5, oxide.evaluate(wi, wo), gold.evaluate(wi, wo))
    np.testing.assert_allclose(material.bsdf().evaluate(wi, wo, uv), expected, rtol=1e-12)


def test_a_constant_mask_is_the_weighted_sum(folder: Path) -> None:
    material = blend(folder, "0.25")
    gold, oxide = nacre.load(folder / "gold.toml"), nacre.load(folder / "oxide.toml")
    wi, wo, _ = pairs()
    expected = 0.25 * nacre.evaluate(gold, wi, wo) + 0.75 * nacre.evaluate(oxide, wi, wo)
    np.testing.assert_allclose(nacre.evaluate(material, wi, wo), expected, rtol=1e-12)
    spectra = [m.spectrum([0.3]).specular_reflectance for m in (material, gold, oxide)]
    np.testing.assert_allclose(spectra[0], 0.25 * spectra[1] + 0.75 * spectra[2], rtol=1e-12)


def test_a_blend_is_stored_and_read(folder: Path) -> None:
    material = blend(folder, '{formula = "u*v"}')
    stored = folder / "b.nacre"
    material.bsdf().save(stored)
    wi, wo, uv = pairs()
    np.testing.assert_allclose(nacre.Bsdf.load(stored).evaluate(wi, wo, uv), material.bsdf().evaluate(wi, wo, uv))


@pytest.mark.render
def test_the_plugin_gives_the_arrays_values(folder: Path) -> None:
    import nacre.render
    from nacre.device.bsdf import make_bsdf

    nacre.render.use_variant()
    import mitsuba as mi

    bsdf = blend(folder, '{formula = "clip(1.3*u*v, 0, 1)"}').bsdf()
    wi, wo, uv = pairs()
    plugin = make_bsdf(bsdf)
    si = mi.SurfaceInteraction3f()
    si.wi, si.uv = mi.Vector3f(wi.T.astype(np.float32)), mi.Point2f(uv.T.astype(np.float32))
    waves = bsdf.wavelengths_nm[[5, 15, 25, 35]]
    si.wavelengths = mi.Spectrum(*(mi.Float(float(w)) for w in waves))
    theirs = np.array(plugin.eval(mi.BSDFContext(), si, mi.Vector3f(wo.T.astype(np.float32)))).T
    ours = bsdf.evaluate(wi, wo, uv)[:, [5, 15, 25, 35]] * wo[:, 2:]
    assert np.max(abs(theirs - ours)) <= 1e-4 * ours.max()
    assert (
        run(["render", str(folder / "blend.toml"), "--size", "24x24", "--spp", "4", "-o", str(folder / "x.png")]) == 0
    )


@pytest.mark.parametrize(
    "mask", ["1.5", "-0.1", '{formula = "2*u"}', '{texture = "none.png", min = 0, max = 1}', '"half"']
)
def test_a_mask_outside_the_unit_interval_is_refused(folder: Path, mask: str) -> None:
    with pytest.raises(RecipeError, match="mask"):
        blend(folder, mask)


def test_a_blend_of_itself_ends(folder: Path) -> None:
    (folder / "gold.toml").write_text((folder / "oxide.toml").read_text())
    path = folder / "blend.toml"
    path.write_text('family = "blend"\nmask = 0.5\nfirst = {recipe = "blend.toml"}\nsecond = {recipe = "gold.toml"}\n')
    with pytest.raises(RecipeError, match="deep|circle"):
        nacre.load(path)


def test_parts_of_an_even_gradient_keep_98_per_cent_of_its_variance(folder: Path) -> None:
    """N equal parts of an even gradient lose 1 / N² of its variance."""
    parts = blend(folder, '{formula = "u"}').model.mixture
    share = np.array([share for share, _ in parts])
    mask = np.array([materials[0][0] for _, materials in parts])
    assert [share.sum(), share @ mask] == pytest.approx([1.0, 0.5])
    assert 0.98 / 12 <= share @ (mask - 0.5) ** 2 <= 1 / 12


def test_the_energy_defect_of_a_blend_is_that_of_its_part() -> None:
    """A quarter is a paint with the published energy balance, the rest a film, which conserves energy."""
    pigment = {"volume_fraction": 0.05, "substrate": {"material": "mica", "thickness_nm": 400}}
    pigment["energy_balance"] = "published"
    strata = [{"resin": {"n": 1.5}, "thickness_um": 10, "platelets": [pigment]}]
    paint = {"family": "pearl", "strata": strata, "base": {"albedo": 0.0}}
    made = {"family": "blend", "mask": 0.25, "first": paint, "second": {"family": "film", "substrate": "Si"}}
    alone, mixed = (
        nacre.material(data).model.energy_defect(np.array([0.3]), np.array([500.0, 600.0])) for data in (paint, made)
    )
    assert alone.shape == (1, 2) and np.all(alone > 0.0)
    np.testing.assert_allclose(mixed, 0.25 * alone, rtol=1e-12)
