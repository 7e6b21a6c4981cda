"""The trade's report: geometry, gloss and dE00 against hand-checked cases and colour-science."""

from __future__ import annotations

import base64
import io
import json
import re
from pathlib import Path

import colour
import numpy as np
import pytest
from PIL import Image

import nacre
from nacre.analysis.html_report import dump_json, report_html, report_text, travel_figure
from nacre.analysis.report import compare, flop_index, gloss, make_report, transmission_haze
from nacre.core.errors import NacreError
from nacre.light import spectrum_to_xyz
from nacre.measure import geometry

GLASS = {"family": "film", "substrate": {"n": geometry.GLOSS_BLACK_GLASS_INDEX, "k": 1e-6}}
GRID_NM = np.arange(400.0, 701.0, 50.0)
GOLD = {"family": "film", "substrate": "Au", "surface": {"roughness": 0.2}}


@pytest.mark.parametrize(
    ("aspecular", "theta", "side"), [(45, 0, 0), (15, 30, -1), (-15, 60, -1), (110, 65, 1), (75, 30, 1)]
)
def test_aspecular_angles_are_counted_from_the_mirror_towards_the_light(
    aspecular: float, theta: float, side: int
) -> None:
    wo = geometry.aspecular_direction(45.0, aspecular)
    assert np.degrees(np.arccos(wo[2])) == pytest.approx(theta, abs=1e-9)
    assert np.sign(np.round(wo[0], 12)) == side


def test_black_glass_has_the_reflectances_of_the_gloss_standard() -> None:
    # Fresnel by hand for n = 1.567: 4.91 % at 20 degrees, 10.01 % at 60, 61.9 % at 85 (ISO 2813 quotes the same)
    expected = {20.0: 0.0491, 60.0: 0.1001, 85.0: 0.6191}
    for angle, value in expected.items():
        assert geometry.black_glass_reflectance(angle) == pytest.approx(value, abs=2e-4)


@pytest.mark.parametrize("angle", [20.0, 60.0, 85.0])
def test_black_glass_has_one_hundred_gloss_units(angle: float) -> None:
    assert gloss(nacre.material(GLASS).bsdf(), angle) == pytest.approx(100.0, abs=0.2)


def test_a_very_slightly_rough_surface_keeps_its_gloss() -> None:
    nearly = GLASS | {"surface": {"roughness": 0.0005}}
    assert gloss(nacre.material(nearly).bsdf(), 20.0) == pytest.approx(100.0, abs=1.0)


def test_reflection_haze_is_taken_two_degrees_beside_the_mirror_direction() -> None:
    """ASTM E430, method B: receptors of 0.4 by 3 degrees at 28, 30 and 32 degrees, here summed on an even grid."""
    bsdf = nacre.material(GOLD | {"surface": {"roughness": 0.03}}).bsdf()
    light = bsdf.wavelengths_nm
    wi = np.array([np.sin(np.radians(30.0)), 0.0, np.cos(np.radians(30.0))])
    along, across = (np.radians((np.arange(30) + 0.5) / 30 - 0.5) * width for width in (0.4, 3.0))
    flux = {}
    for centre in (28.0, 30.0, 32.0):
        polar, side = (grid.ravel() for grid in np.meshgrid(np.radians(centre) + along, across))
        wo = np.stack([-np.sin(polar) * np.cos(side), np.sin(side), np.cos(polar) * np.cos(side)], axis=-1)
        seen = (wo[:, 2] * np.cos(side)) @ bsdf.evaluate(np.broadcast_to(wi, wo.shape), wo)
        flux[centre] = float(spectrum_to_xyz(seen, light, "C", "2deg")[1])
    expected = 100 * (flux[28.0] + flux[32.0]) / 2 / flux[30.0]
    assert 10 < expected < 90  # the angle decides
    report = make_report(nacre.material(GOLD | {"surface": {"roughness": 0.03}}))
    assert report.reflection_haze == pytest.approx(expected, rel=2e-3)


def test_gloss_haze_and_flop_are_those_of_their_standards_whatever_the_colours_are_seen_by() -> None:
    """ISO 2813, ASTM E430 and D1003: illuminant C, 2 degrees; Alman's index at ASTM E2194's D65 and 10 degrees."""
    gold, copper = nacre.material(GOLD), nacre.material(GOLD | {"substrate": "Cu"})
    for material in (gold, copper):
        first, other = make_report(material, "A", "2deg"), make_report(material, "F11", "10deg")
        # F11 has its own wavelengths, so the quadrature differs a little
        assert first.gloss == pytest.approx(other.gloss, rel=1e-3)
        assert first.reflection_haze == pytest.approx(other.reflection_haze, rel=1e-3)
        assert first.flop_index == pytest.approx(other.flop_index, rel=1e-3)
    # gold under C: the luminous reflectance by colour-science's own tables, no lobe in between
    mirror = nacre.material({"family": "film", "substrate": "Au"})
    lam = np.arange(380.0, 781.0, 5.0)
    reflectance = mirror.spectrum(np.radians([20.0]), lam).specular_reflectance
    assert reflectance is not None
    shape = colour.SpectralShape(380, 780, 5)
    seen = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(shape).values[:, 1]
    seen = seen * colour.SDS_ILLUMINANTS["C"].copy().align(shape).values
    luminous = 100.0 * float(reflectance[0] @ seen / seen.sum())
    expected = luminous / geometry.black_glass_reflectance(20.0)
    assert gloss(mirror.bsdf(), 20.0) == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("roughness", [0.005, 0.02, 0.1, 0.4])
def test_haze_of_a_rough_pane_is_the_share_beyond_two_and_a_half_degrees(roughness: float) -> None:
    """Against the share of refracted rays by brute force: facets drawn from Beckmann's slopes, Snell's law."""
    glass = {"family": "film", "substrate": {"n": 1.5}}
    pane = nacre.material({**glass, "surface": {"roughness": roughness, "distribution": "beckmann"}})
    g = np.random.default_rng(0)
    slope = roughness * np.sqrt(-np.log(g.random(400_000)))  # Beckmann: tan^2 / alpha^2 is exponential
    tilt = np.arctan(slope)
    weight = 1.0 - ((1 - 1.5) / 2.5) ** 2  # nearly constant for the tilts that matter; cancels in the share
    turned = tilt - np.arcsin(np.sin(tilt) / 1.5)
    expected = 100.0 * float(np.mean(weight * (turned > np.radians(2.5))) / weight)
    assert transmission_haze(pane.bsdf(GRID_NM)) == pytest.approx(expected, abs=2.0)


def test_a_clear_pane_has_no_haze_and_flop_index_is_the_published_formula() -> None:
    clear = nacre.material({"family": "film", "substrate": {"n": 1.5}})
    assert transmission_haze(clear.bsdf()) == 0.0
    assert flop_index(120.0, 60.0, 30.0) == pytest.approx(2.69 * 90**1.11 / 60**0.86)
    assert flop_index(10.0, 0.0, 5.0) is None


def test_differences_are_ciede2000_as_colour_science_gives_it() -> None:
    first = make_report(nacre.material(GOLD))
    second = make_report(nacre.material(GOLD | {"substrate": "Cu"}))
    ours = compare(second, first).tables["aspecular"]
    theirs = colour.delta_E(first.aspecular.lab, second.aspecular.lab, method="CIE 2000")
    np.testing.assert_allclose(ours, theirs, rtol=1e-6)


def test_a_mirror_shows_in_the_specular_table_only() -> None:
    report = make_report(nacre.material({"family": "film", "substrate": "Ag"}))
    assert report.specular is not None and report.specular.lab[0, 0] > 95
    assert np.all(report.aspecular.xyz == 0)


def test_the_report_says_the_same_as_text_json_and_html() -> None:
    reports = [make_report(nacre.material(GOLD)), make_report(nacre.material(GOLD | {"substrate": "Cu"}))]
    document = json.loads(dump_json(reports, [compare(reports[1], reports[0])]))
    lightness = document["reports"][0]["aspecular"]["lab"][2][0]
    assert f"{lightness:7.2f}" in report_text(reports)
    assert f"{lightness:.2f}" in report_html(reports)
    assert len(document["differences_to_first"][0]["aspecular"]) == len(geometry.ASPECULAR_DEG)


def test_the_page_is_one_file_with_its_pictures_inside(tmp_path: Path) -> None:
    from nacre.cli import run
    from nacre.recipe.toml import dump_toml

    for name, data in (("gold", GOLD), ("copper", GOLD | {"substrate": "Cu"})):
        (tmp_path / f"{name}.toml").write_text(dump_toml(data))
    page = tmp_path / "page.html"
    assert run(["report", str(tmp_path / "gold.toml"), str(tmp_path / "copper.toml"), "-o", str(page)]) == 0
    text = page.read_text()
    pictures = re.findall(r'src="data:image/png;base64,([^"]+)"', text)
    assert len(pictures) == 5  # spectra and ribbon of each, the travel of both
    for picture in pictures:
        with Image.open(io.BytesIO(base64.b64decode(picture))) as image:
            assert np.asarray(image.convert("RGB")).std() > 5
    assert "http" not in re.sub(r"base64,[^\"]+", "", text)


def test_a_mirror_travels_by_its_mirror_direction() -> None:
    report = make_report(nacre.material({"family": "film", "substrate": "Cu"}))
    assert report.specular is not None
    drawn = np.asarray(travel_figure([report]).axes[0].collections[-1].get_offsets())
    np.testing.assert_allclose(drawn, report.specular.lab[:, 1:], atol=1e-9)


def test_the_report_of_an_answer_is_titled_by_the_designs_folder(tmp_path: Path) -> None:
    (tmp_path / "sign" / "2").mkdir(parents=True)
    for folder in ("sign", "sign/2"):
        (tmp_path / folder / "recipe.toml").write_text('family = "film"\nsubstrate = "Si"\n')
    reports = [make_report(nacre.load(tmp_path / folder)) for folder in ("sign", "sign/2")]
    assert [report.name for report in reports] == ["sign", "sign-2"]
    with pytest.raises(NacreError, match=re.escape(str(tmp_path / "sign" / "2" / "recipe.toml") + ": --to gds")):
        nacre.fabricate(tmp_path / "sign" / "2", "gds", tmp_path / "x.gds")


def test_named_and_out_of_plane_geometries_have_the_colours_of_their_directions() -> None:
    material = nacre.material(GOLD)
    found = make_report(material, geometries=["side=45as60az125.26438968275465", "45as15", "45as25az-90"])
    assert found.geometries is not None and found.geometries.labels == ("side", "45as15", "45as25az-90")
    np.testing.assert_allclose(found.geometries.lab[1], found.aspecular.lab[1], rtol=1e-12)
    # 60 degrees from the mirror direction and 45 from the normal is across the plane of incidence
    assert found.geometries.angles_deg[0] == pytest.approx(45.0, abs=1e-9)
    half = np.sqrt(0.5)
    bsdf = material.bsdf()
    across = bsdf.evaluate(np.array([half, 0.0, half]), np.array([0.0, half, half]))
    xyz = spectrum_to_xyz(np.pi * across, bsdf.wavelengths_nm, "D65", "10deg")
    np.testing.assert_allclose(found.geometries.xyz[0], xyz, rtol=1e-3)


def test_a_comparison_passes_by_geometry() -> None:
    first, second = (make_report(nacre.material(GOLD | {"substrate": name})) for name in ("Au", "Cu"))
    own = compare(first, first, limits={"": 0.1})
    assert all(own.passes.values()) and len(own.passes) == len(geometry.ASPECULAR_DEG)
    found = compare(second, first, "cmc(2:1)", {"45as15": 1e3, "": 1e-6})
    assert found.passes["45as15"] and not found.passes["45as25"]
    with pytest.raises(NacreError):
        compare(second, first, limits={"45as16": 1.0})
