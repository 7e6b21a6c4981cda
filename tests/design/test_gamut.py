"""Gamut: points agree with their structures, shares are plausible, MacAdam limits hold."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.cli import run
from nacre.core.errors import NacreError
from nacre.light import lab_to_xyz, spectrum_to_xyz, table_wavelengths_nm, white_xyz, xyz_to_lab
from nacre.optimise.gamut import applicable_geometry, optimal_colours, parse_parameters, share_within, srgb_colours

OXIDE = {"family": "film", "substrate": "Si", "layers": [{"material": "SiO2", "thickness_nm": 100}]}
FREE = ["layers[0].thickness_nm=0:400"]


def test_each_point_is_the_colour_of_its_structure() -> None:
    material = nacre.material(OXIDE)
    found = nacre.gamut(material, FREE, "specular 30", points=12, illuminant="A")
    nm = material.model.wavelengths_nm
    for lab, structure in zip(found.lab, found.structures):
        seen = material.vary(structure).spectrum(np.radians([30.0]), nm).specular_reflectance
        own = xyz_to_lab(spectrum_to_xyz(seen[0], nm, "A", "10deg"), white_xyz("A", "10deg"))
        np.testing.assert_allclose(lab, own, atol=0.3)  # of the grid, which is that of the thickest
    assert 0.0 <= found.share_of_srgb < 0.2 and found.failed == 0


def test_reflectances_lie_within_the_optimal_colours_and_fill_them_only_as_edges() -> None:
    from scipy.spatial import ConvexHull, Delaunay

    inside = optimal_colours("D65", "10deg")
    nm, white = table_wavelengths_nm(), white_xyz("D65", "10deg")
    solid = Delaunay(lab_to_xyz(inside, white)[ConvexHull(lab_to_xyz(inside, white)).vertices])
    generator = np.random.default_rng(1)
    smooth = np.array([np.interp(nm, np.linspace(360, 830, 8), row) for row in generator.uniform(0.02, 0.98, (200, 8))])
    assert (solid.find_simplex(spectrum_to_xyz(smooth, nm, "D65", "10deg")) >= 0).mean() > 0.99
    # twice what is possible is outside
    assert (solid.find_simplex(spectrum_to_xyz(2.0 + smooth, nm, "D65", "10deg")) >= 0).sum() == 0


def test_share_within_is_one_for_the_solid_itself() -> None:
    solid = srgb_colours("D65", "10deg")
    assert share_within(solid, solid, 0.01) == 1.0
    assert share_within(np.array([[50.0, 300.0, 0.0]]), solid, 2.0) == 0.0


def test_a_slow_machine_computes_every_point_unless_the_time_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = itertools.count(step=100.0)
    monkeypatch.setattr("nacre.optimise.gamut.clock", lambda: next(clock))
    assert len(nacre.gamut(nacre.material(OXIDE), FREE, points=12).lab) == 12
    assert len(nacre.gamut(nacre.material(OXIDE), FREE, points=12, seconds=60.0).lab) == 8


def test_more_parameters_enlarge_the_gamut() -> None:
    double = {**OXIDE, "layers": [{"material": "TiO2", "thickness_nm": 50}, *OXIDE["layers"]]}
    one = nacre.gamut(nacre.material(double), ["layers[1].thickness_nm=0:400"], points=150)
    two = nacre.gamut(
        nacre.material(double), ["layers[0].thickness_nm=10:200", "layers[1].thickness_nm=0:400"], points=150
    )
    assert two.share_of_optimal > one.share_of_optimal


@pytest.mark.parametrize("suffix", [".png", ".json", ".html"])
def test_the_command_writes_the_chart_and_the_structures(
    tmp_path: Path, suffix: str, capsys: pytest.CaptureFixture[str]
) -> None:
    from nacre.recipe.toml import dump_toml

    (tmp_path / "oxide.toml").write_text(dump_toml(OXIDE))
    path = tmp_path / f"x{suffix}"
    arguments = [
        "gamut",
        str(tmp_path / "oxide.toml"),
        "--parameter",
        FREE[0],
        "--points",
        "16",
        "-o",
        str(path),
        "--json",
    ]
    assert run(arguments) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["count"] == 16 and "layers[0].thickness_nm" in document["points"][0]["structure"]
    if suffix == ".json":
        assert json.loads(path.read_text()) == document
    elif suffix == ".html":
        assert path.read_text().count("<title>Lab") == 16 and "http" not in path.read_text()
    assert path.stat().st_size > 1000


@pytest.mark.parametrize(
    ("option", "word"),
    [
        ("layers[0].thickness_nm", "50:400"),
        ("layers[0].thickness_nm=400:50", "cross"),
        ("layers[3].x=1:2", "layers[3]"),
    ],
)
def test_bad_options_give_one_line(option: str, word: str) -> None:
    with pytest.raises(NacreError) as caught:
        nacre.gamut(nacre.material(OXIDE), [option])
    assert word in str(caught.value) and "\n" not in str(caught.value)


def test_choices_and_bounds_are_distinguished() -> None:
    table = parse_parameters(["substrate=Al,Ag", "layers[0].thickness_nm=10:20"])
    assert table == {"substrate": {"choices": ["Al", "Ag"]}, "layers[0].thickness_nm": [10.0, 20.0]}


def test_the_default_geometry_of_a_pearl_is_near_its_mirror_direction() -> None:
    """Its mirror is the face of the resin: one grey for all pigments."""
    flakes = {
        "volume_fraction": 0.02,
        "substrate": {"material": "mica", "thickness_nm": 400, "deviation_nm": 50},
        "coatings": [{"material": "TiO2", "thickness_nm": 90}],
    }
    pearl = {"family": "pearl", "strata": [{"resin": {"n": 1.5}, "thickness_um": 25, "platelets": [flakes]}]}
    free = ["strata[0].platelets[0].coatings[0].thickness_nm=40:160"]
    found = nacre.gamut(nacre.material(pearl), free, points=8, samples=64)
    assert found.geometry == "45as15" and np.ptp(found.lab[:, 1:], axis=0).min() > 20.0


def test_discrete_parameters_are_enumerated(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    found = nacre.gamut(nacre.material(OXIDE), ["substrate=Si,Al,Ag"], points=30)
    assert [s["substrate"] for s in found.structures] == ["Si", "Al", "Ag"] and found.possible == 3
    (tmp_path / "o.toml").write_text(nacre.material(OXIDE).text)
    assert (
        run(["gamut", str(tmp_path / "o.toml"), "--parameter", "substrate=Si,Al", "-o", str(tmp_path / "g.json")]) == 0
    )
    said = capsys.readouterr().out
    assert "2 points" in said and "stopped" not in said


def _relief(folder: Path) -> dict[str, Any]:
    np.save(folder / "h.npy", np.random.default_rng(3).uniform(0.0, 0.2, (8, 8)))
    return {"family": "relief", "heights": str(folder / "h.npy"), "feature_um": 1, "blur_um": 0.3,
            "coherence": {"sigma": 0.8}, "bounded": False, "accuracy": 0.1}  # fmt: skip


def test_the_default_geometry_of_a_relief_is_aspecular(tmp_path: Path) -> None:
    """It has no part that is a mirror's alone."""
    relief = nacre.material(_relief(tmp_path))
    assert str(applicable_geometry([relief], None, "r: geometry")) == "45as15"
    with pytest.raises(NacreError, match="specular 0"):
        applicable_geometry([relief], "specular 0", "r: geometry")


def test_a_blend_without_specular_part_uses_another_geometry(tmp_path: Path) -> None:
    """The usual look of blends is that of films, and both reliefs of this one only scatter."""
    relief = _relief(tmp_path)
    blend = nacre.material({"family": "blend", "first": relief, "second": {**relief, "coating": "Cu"}, "mask": 0.5})
    assert (
        blend.model.traits.default_geometry == "specular 0"
        and str(applicable_geometry([blend], None, "r: geometry")) == "45as15"
    )
