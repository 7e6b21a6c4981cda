"""Reliefs of lines by Maxwell's equations."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from validation._relief_cases import read_groups, read_orders
from validation.relief_rcwa import spectra_of, strong_errors, vector_efficiencies

import nacre
from nacre.cli import run
from nacre.core.errors import NacreError, UnsupportedError
from nacre.families.relief.material import Relief
from nacre.families.relief.structures import blocks_of, lines_of
from nacre.families.relief.surface import Tile
from nacre.families.relief.vector import VectorRelief

RECIPE = {"family": "relief", "heights": "heights.npy", "coherence": {"source_angle_deg": 0.5}, "coating": "Al"}
PILLAR = np.zeros((8, 8))
PILLAR[3:7, 3:7] = 0.12
ROUGH = {"optics": "vector", "tolerance": 0.1}
MANY = np.random.default_rng(4).integers(0, 3, (8, 8)) * 0.06
LINES = np.tile(np.repeat([0.0, 0.12], [5, 3])[:, None], (1, 8))


def relief(folder: Path, heights: Any = LINES, feature_um: float = 0.1, blur_um: float = 0.001, **changes: Any) -> Any:
    np.save(folder / "heights.npy", heights)
    recipe = {**RECIPE, "feature_um": feature_um, "blur_um": blur_um, "model": {"optics": "vector"}, **changes}
    return nacre.material(recipe, folder=folder)


def test_vertical_walls_are_those_of_a_grating(tmp_path: Path) -> None:
    line = {"shape": "line", "material": "Al", "width_nm": 300, "center_nm": [250, 0]}
    grating = {
        "family": "grating", "substrate": "Al", "lattice": {"period_nm": 800},
        "layers": [{"thickness_nm": 120, "material": "air", "shapes": [line]}],
    }  # fmt: skip
    ours, other = (nacre.orders(each, 20.0, 30.0, [500.0, 650.0]) for each in (relief(tmp_path), grating))
    assert np.array_equal(ours.numbers, other.numbers)
    assert ours.reflected == pytest.approx(other.reflected, abs=5e-4, nan_ok=True)
    # lines along x seen from 90 degrees further
    turned = nacre.orders(relief(tmp_path, LINES.T), 20.0, 120.0, [500.0, 650.0])
    assert turned.reflected == pytest.approx(ours.reflected, abs=1e-9, nan_ok=True)
    assert np.array_equal(turned.numbers, ours.numbers[:, ::-1])
    x, y = ours.reflected_direction[..., 0], ours.reflected_direction[..., 1]
    assert turned.reflected_direction[..., :2] == pytest.approx(np.stack([-y, x], axis=-1), abs=1e-9, nan_ok=True)


def test_spectra_depend_on_azimuth_and_hand(tmp_path: Path) -> None:
    across = relief(tmp_path).spectrum(0.4, [500.0], "s", azimuth_deg=20)
    along = relief(tmp_path, LINES.T).spectrum(0.4, [500.0], "s", azimuth_deg=110)
    assert along.diffuse_reflectance == pytest.approx(across.diffuse_reflectance, abs=1e-9)
    left, right, mean = (
        relief(tmp_path).spectrum(0.4, [500.0], kind, azimuth_deg=20).diffuse_reflectance
        for kind in ("left", "right", "both")
    )
    assert 0.5 * (left + right) == pytest.approx(mean, rel=1e-9)
    with pytest.raises(UnsupportedError):
        relief(tmp_path).spectrum(0.4, [500.0], "mueller")


def test_blur_rounds_the_walls_continuously(tmp_path: Path) -> None:
    """The solver of profiles tends to that of vertical walls."""
    values = [
        nacre.orders(relief(tmp_path, blur_um=blur), 20.0, 0.0, [650.0]).reflected for blur in (0.001, 0.003, 0.012)
    ]
    first, second = (float(np.nanmax(np.abs(each - values[0]))) for each in values[1:])
    assert 1e-5 < first < 0.5 * second < 0.3


def test_samples_of_a_sinusoid_are_a_sinusoid(tmp_path: Path) -> None:
    wave = 0.1 * np.cos(2 * np.pi * (np.arange(64) + 0.5) / 64)
    ours = relief(tmp_path, np.tile(wave[:, None], (1, 64)), 1.0 / 64, 1e-4)
    profile = {"shape": "sinusoidal", "depth_nm": 200}
    grating = {"family": "grating", "substrate": "Al", "profile": profile, "lattice": {"period_nm": 1000}}
    found, other = (nacre.orders(each, 30.0, 0.0, [600.0]) for each in (ours, grating))
    assert found.reflected == pytest.approx(other.reflected, abs=4e-3, nan_ok=True)


def test_the_smallest_period_is_solved() -> None:
    stripes = np.tile(np.repeat([0.0, 120.0], [5, 3]), 4)
    found = lines_of(Tile(np.tile(stripes, (32, 1)), 100.0, 1.0))
    assert found is not None and not found.along_x and found.period_nm == pytest.approx(800.0)
    assert lines_of(Tile(np.eye(8), 100.0, 1.0)) is None
    tile = np.kron([[0.0, 120.0], [120.0, 0.0]], np.ones((2, 2)))
    blocks = blocks_of(Tile(np.tile(tile, (2, 2)), 100.0, 1.0))
    assert blocks.periods_nm == pytest.approx((400.0, 400.0)) and blocks.walls == (2, 2)


def test_blocks_are_those_of_a_grating(tmp_path: Path) -> None:
    """A pedestal with a tower on its left half, across the seam of the tile."""
    heights = np.zeros((4, 4))
    heights[1:3, 1:3] = 0.08
    heights[1, 1:3] = 0.14
    tower, pedestal = (
        {"shape": "rectangle", "material": "Al", "size_nm": size, "center_nm": centre}
        for size, centre in (([150, 300], [0, 0]), ([300, 300], [75, 0]))
    )
    layers = [
        {"thickness_nm": 60, "material": "air", "shapes": [tower]},
        {"thickness_nm": 80, "material": "air", "shapes": [pedestal]},
    ]
    grating = {
        "family": "grating", "substrate": "Al", "lattice": {"period_nm": [600, 600]}, "layers": layers,
        "model": {"tolerance": 0.1},
    }  # fmt: skip
    shifted = relief(tmp_path, np.roll(heights, 2, axis=(0, 1)), 0.15, model=ROUGH)
    ours, other = (nacre.orders(each, 10.0, 0.0, [550.0]) for each in (shifted, grating))
    assert np.array_equal(ours.numbers, other.numbers)
    assert ours.reflected == pytest.approx(other.reflected, abs=1e-6, nan_ok=True)
    assert np.nanmax(ours.reflected) > 0.2 and float(ours.error.max()) <= 0.1


def test_a_chequered_relief_sends_light_into_its_diagonals(tmp_path: Path) -> None:
    chequered = np.kron([[0.0, 0.1], [0.1, 0.0]], np.ones((2, 2)))
    material = relief(tmp_path, chequered, 0.2, model=ROUGH)
    found = nacre.orders(material, 0.0, 0.0, [500.0])
    values = np.nan_to_num(found.reflected.mean(axis=-1))[0, 0]
    share = dict(zip(map(tuple, found.numbers.tolist()), values, strict=True))
    # equal halves: only orders of odd m and n are lit in the limit of flat steps
    assert share[1, 1] == pytest.approx(share[-1, 1], abs=1e-6)
    assert share[1, 1] > 0.05 > 5.0 * share.get((1, 0), 0.0)
    total = sum(share.values())
    assert 0.5 < total < 1.0


@pytest.mark.parametrize("name", ["lamellar-4", "lamellar-18", "lamellar-25", "sinusoidal-31"])
def test_colours_of_orders_are_those_of_two_other_solvers(name: str, tmp_path: Path) -> None:
    """The relief's recipe, on gratings of the validation that scalar diffraction misses."""
    group = next(each for each in read_groups() if each["name"] == name)
    cases = read_orders()[name]
    spectra = spectra_of(group, cases, vector_efficiencies(group, cases, tmp_path))
    assert strong_errors(group, cases, spectra).max() <= 2.0


def test_the_bsdf_holds_the_orders(tmp_path: Path) -> None:
    material = relief(tmp_path, np.tile(np.repeat([0.0, 0.12], 4)[:, None], (1, 8)), 0.06)
    lam = np.array([450.0, 600.0])
    bsdf = material.bsdf(lam)
    wi = np.array([np.sin(0.4), 0.0, np.cos(0.4)])
    sent = sum(lobe.hemispherical(wi)[0] for lobe in bsdf.lobes)
    orders = nacre.orders(material, np.degrees(0.4), 0.0, lam)
    assert sent == pytest.approx(np.nansum(orders.reflected.mean(axis=-1), axis=2)[0], abs=0.03)
    # the zero order leaves the mirror direction with the width of the light
    away = np.sin(0.4 + np.radians([0.0, 0.125, 0.25]))
    wo = np.stack([-away, 0 * away, np.sqrt(1 - away**2)], axis=-1)
    value = bsdf.evaluate(wi, wo)[:, 0]
    assert value[0] > value[1] > value[2] > 0.0
    assert bsdf.evaluate(wi, wo) == pytest.approx(bsdf.evaluate(wo, wi), rel=1e-9)
    spectrum = nacre.spectrum(material, [0.0, 40.0], wavelengths_nm=lam, polarisation="s")
    assert spectrum.diffuse_reflectance is not None and np.all(spectrum.diffuse_reflectance < 1.0)


def test_orders_below_a_dense_medium_leave_where_they_propagate(tmp_path: Path) -> None:
    model: Any = relief(tmp_path, np.tile(np.repeat([0.0, 0.12], 4)[:, None], (1, 8)), 0.06).model
    above = nacre.material(
        {"family": "grating", "ambient": {"n": 1.4}, "substrate": "Al", "lattice": {"period_nm": 300}}
    )
    ambient: Any = above.model
    made = replace(model, scalar=replace(model.scalar, ambient=ambient.ambient))
    theta, azimuth, lam = 0.6, 0.3, np.array([450.0])
    lobe, found = made.bsdf(lam).lobes[0], made.diffraction_orders(np.array([theta]), azimuth, lam)
    wi = np.array([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)])
    assert len(found.numbers) > 2
    for power, way in zip(found.reflected[0, 0].mean(axis=-1), found.reflected_direction[0, 0], strict=True):
        value = lobe.evaluate(wi, way / np.linalg.norm(way))[0] * 2.0 * np.pi * lobe.width**2
        assert value == pytest.approx(power, abs=0.03)


def test_auto_says_which_optics_it_took(tmp_path: Path) -> None:
    auto = {"model": {"optics": "auto"}}
    steep = relief(tmp_path, **auto).model
    assert isinstance(steep, VectorRelief) and any("vector" in line for line in steep.warnings)
    flat = relief(tmp_path, 0.02 * LINES, 1.0, 0.3, **auto).model
    assert isinstance(flat, Relief) and any("scalar" in line for line in flat.warnings)
    crossed = relief(tmp_path, PILLAR, 0.06, **auto).model
    assert isinstance(crossed, VectorRelief) and any("vector" in line for line in crossed.warnings)
    many = relief(tmp_path, MANY, **auto).model
    assert isinstance(many, Relief) and any("scalar" in line and "walls" in line for line in many.warnings)
    # the warning of scalar theory names the other
    assert any("model.optics" in line for line in relief(tmp_path, model={}).model.warnings)


@pytest.mark.parametrize(
    "heights, changes",
    [
        (MANY, {}),
        (LINES + LINES.T, {"blur_um": 0.02}),
        (np.kron([[0.0, 0.12], [0.12, 0.0]], np.ones((4, 4))), {"feature_um": 0.9}),
        (LINES, {"periodic": False, "blur_um": None}),
        (LINES, {"prefactor": "published"}),
        (LINES, {"feature_um": 2.0}),
        (LINES, {"model": {"tolerance": 1e-3}}),
        (LINES, {"model": {"optics": "maxwell"}}),
    ],
)
def test_what_vector_optics_cannot_solve_is_refused(
    heights: Any, changes: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    changes = {"feature_um": 0.1, "blur_um": 0.001, **changes}
    with pytest.raises(NacreError) as caught:
        relief(tmp_path, heights, **{key: value for key, value in changes.items() if value is not None})
    assert len(str(caught.value).splitlines()) == 1


def test_a_scalar_relief_has_no_orders(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(UnsupportedError):
        nacre.orders(relief(tmp_path, model={}), 0.0)
    path = tmp_path / "relief.toml"
    path.write_text(
        'family = "relief"\nheights = "heights.npy"\nfeature_um = 0.1\nblur_um = 0.001\n'
        'coherence = {sigma = 5}\nmodel = {optics = "vector"}\n'
    )
    assert run(["orders", str(path), "--angles-deg", "0", "--wavelengths-nm", "600", "--json"]) == 0
    assert '"reflected"' in capsys.readouterr().out
