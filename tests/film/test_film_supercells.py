"""Ridges by Maxwell's equations: the solver, the table, the recipe, and the Morpho wing against its supercells."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from validation.film_morpho_rcwa import BLUE, colours, read_cells, rigorous_fan, steady, vector_fan

import nacre
from nacre.bsdf.lobes.ridge import RidgeTable
from nacre.cli import run
from nacre.core.arrays import direction
from nacre.core.errors import NacreError, UnsupportedError
from nacre.families.film.supercells import SupercellFilm
from nacre.light import delta_e_2000
from nacre.matter.periodic.ridge_supercells import (
    ALONG,
    LEAST_DRAWS,
    RidgeCase,
    RidgeStatistics,
    array_factor,
    controlled,
    depth,
    drawn_ridges,
    levels,
    mean_array_factor,
    reflected_fan,
    ridge_table,
    solved_wavelengths,
)
from nacre.matter.periodic.solve import solve
from nacre.matter.periodic.structure import Cell, PatternLayer, PeriodicStack, Rectangle

CUTICLE = 1.56 + 0.06j
WING = RidgeStatistics(700.0, 300.0, 2, 120.0, 40.0, 60.0)
LAYERS, INDICES = np.array([70.0, 155.0, 70.0]), np.array([CUTICLE, 1.0, CUTICLE])
INCOHERENT = {"material": {"n": 1.5}, "thickness_nm": 1e5, "incoherent": True}
FEW_ORDERS = 2e-3  # of the light: truncated Fourier series against piecewise polynomials
LIMIT_DE00, LIMIT_DEG = 3.0, 1.5  # of the issue
MOST = 1.02  # a table holds energy to the error of its interpolation


def film(**ridges: Any) -> Any:
    return nacre.material({
        "family": "film", "preset": "morpho", "wavelengths": {"min_nm": 440, "max_nm": 640, "step_nm": 50},
        "ridges": {"optics": "vector", "count": 1, "draws": 2, **ridges},
    })  # fmt: skip


@pytest.mark.parametrize("along", [0.0, 0.6])
def test_a_supercell_is_the_grating_that_elements_give(along: float) -> None:
    """Two ridges of drawn heights, widths and places, by a solver that shares no step."""
    cell = drawn_ridges(WING, 3)
    lam, cover = 620.0, 1.0
    fan = reflected_fan(cell, LAYERS, INDICES, cover, CUTICLE, lam, along, 3.0)
    depths, filled = levels(cell, LAYERS)
    epsilon = np.append(np.append(INDICES, CUTICLE) ** 2, cover**2)
    half = 0.5 * cell.period_nm
    pattern = tuple(
        PatternLayer(
            float(depth), cover**2,
            tuple(
                (Rectangle(x - 0.5 * w - half, x + 0.5 * w - half), complex(epsilon[k]))
                for x, w, k in zip(cell.centres_nm, cell.widths_nm, layers, strict=True)
                if epsilon[k] != cover**2
            ),
        )
        for depth, layers in zip(depths[::-1], filled[::-1], strict=True)
    )  # fmt: skip
    stack = PeriodicStack(Cell(cell.period_nm), cover, pattern, CUTICLE)
    for into in (np.argmin(np.abs(fan.sines)), np.argmin(np.abs(fan.sines)) + 1):
        sine = float(np.hypot(fan.sines[into], along))
        found = solve(stack, lam, np.arcsin(sine), float(np.arctan2(along, fan.sines[into])), 1e-3)
        wanted = dict(zip(found.reflected.numbers[:, 0].tolist(), found.reflected.efficiency.mean(axis=1), strict=True))
        known = [m for m in range(-int(into), len(fan.sines) - int(into)) if m in wanted]
        ours = [float(fan.power[m + into, into]) for m in known]
        assert ours == pytest.approx([float(wanted[m]) for m in known], abs=FEW_ORDERS)
        assert len(ours) > 1 and max(ours) > 5 * FEW_ORDERS


def test_orders_are_reciprocal_and_absorb() -> None:
    fan = reflected_fan(drawn_ridges(WING, 0), LAYERS, INDICES, 1.0, CUTICLE, 500.0, 0.4)
    assert fan.power == pytest.approx(fan.power[::-1, ::-1].T, abs=1e-5)
    assert fan.power.min() >= 0.0 and 0.0 < fan.power.sum(axis=0).max() < 1.0


def test_lossless_ridges_on_a_mirror_return_all_light() -> None:
    mirror = reflected_fan(
        drawn_ridges(WING, 1), LAYERS, np.array([1.5, 1.0, 1.5]), 1.0, 1e-3 + 40j, 600.0, 0.0
    ).power.sum(axis=0)
    assert mirror == pytest.approx(1.0, abs=0.01)


def test_layers_stand_on_the_drawn_heights() -> None:
    cell = drawn_ridges(RidgeStatistics(700.0, 300.0, 5, 120.0), 4)
    depths, filled = levels(cell, LAYERS)
    assert depths.sum() == pytest.approx(cell.heights_nm.max() + LAYERS.sum())
    for layer, thickness in enumerate((*LAYERS, None)):
        expected = cell.heights_nm if thickness is None else np.full(5, thickness)
        assert depths @ (filled == layer) == pytest.approx(expected, abs=1e-4)
    assert np.all(cell.widths_nm == 300.0)


def test_ranges_share_their_solved_wavelengths() -> None:
    assert solved_wavelengths(np.linspace(365.0, 830.0, 400)).tolist() == [365.0, *range(380, 821, 20), 830.0]
    assert solved_wavelengths(np.linspace(380.0, 780.0, 400)).tolist() == list(range(380, 781, 20))
    assert solved_wavelengths(np.array([450.0, 600.0])).tolist() == [450.0, 600.0]


def test_a_table_keeps_what_was_solved() -> None:
    lam = np.array([450.0, 500.0, 550.0])
    solved = np.random.default_rng(0).uniform(0.0, 1.0, (len(ALONG), 5, 5, 3))
    table = ridge_table(solved, cases(lam, WING), 21)
    assert table[0] == pytest.approx(solved[0])
    assert table[10] == pytest.approx(solved[1])  # c = 0.5
    assert table.min() >= 0.0


def cases(lam: Any, wing: RidgeStatistics, draws: int = 1) -> list[RidgeCase]:
    return [RidgeCase(wing, tuple(LAYERS), tuple(INDICES), 1.0, CUTICLE, float(at), draws) for at in lam]


def test_inclined_light_has_the_band_at_equal_phases() -> None:
    """A response of the layers' phase alone is exact between the solved directions."""
    lam = np.arange(380.0, 741.0, 10.0)
    every = cases(lam, WING)
    paths = [70.0 * np.sqrt(1.56**2 - c**2) * 2.0 + 155.0 * np.sqrt(1.0 - c**2) for c in (0.0, 0.6)]
    assert depth(every[0], np.array([0.0, 0.6])) == pytest.approx([1.0, paths[1] / paths[0]])

    def band(c: float) -> Any:
        return 1.0 + np.cos(2.0 * np.pi * 500.0 * depth(every[0], np.array(c)) / lam)

    table = ridge_table(np.stack([band(c)[None, None] for c in ALONG]), every, 21)
    inner = (lam > 430.0) & (lam < 690.0)  # others need solutions beyond the ends
    for node in (4, 8, 12, 14):
        assert table[node, 0, 0, inner] == pytest.approx(band(0.05 * node)[inner], abs=0.01)


def test_the_lobe_is_reciprocal_and_keeps_energy() -> None:
    model = film(width_deviation_nm=30, shift_deviation_nm=40, rotation_deg=20).model
    assert isinstance(model, SupercellFilm)
    bsdf = model.bsdf()
    (lobe,) = bsdf.lobes
    assert isinstance(lobe, RidgeTable) and bsdf.provenance["supercells"] == 2
    random = np.random.default_rng(2).normal(size=(2, 500, 3))
    wi, wo = random / np.linalg.norm(random, axis=-1, keepdims=True) * [1, 1, 1]
    wi[:, 2], wo[:, 2] = np.abs(wi[:, 2]), np.abs(wo[:, 2])
    assert bsdf.evaluate(wi, wo) == pytest.approx(bsdf.evaluate(wo, wi), rel=1e-9)
    for theta, phi in ((0.0, 0.0), (0.6, 0.3), (1.2, 2.0)):
        assert np.all(lobe.hemispherical(direction(theta, phi))[0] < MOST)
    # the integral over exits is the sum over the table's row
    row = np.trapezoid(lobe.power[0, lobe.power.shape[1] // 2], dx=2.0 / (lobe.power.shape[2] - 1), axis=0)
    assert lobe.hemispherical(direction(0.0))[0] == pytest.approx(lobe.fill * row, rel=0.02)


@pytest.mark.parametrize(
    "changes, key",
    [
        ({"ridges": {"draws": 10}}, "draws"),
        ({"ridges": {"shift_deviation_nm": 10}}, "shift_deviation_nm"),
        ({"ridges": {"optics": "vector", "count": 60}}, "count"),
        ({"ridges": {"optics": "maxwell"}}, "optics"),
        ({"ridges": {"optics": "vector"}, "layers": [INCOHERENT]}, "incoherent"),
    ],
)  # fmt: skip
def test_bad_ridges_are_refused(changes: dict[str, Any], key: str) -> None:
    with pytest.raises(NacreError) as caught:
        nacre.material({"family": "film", "preset": "morpho", **changes})
    assert key in str(caught.value) and len(str(caught.value).splitlines()) == 1


def test_ridges_that_need_more_orders_are_not_called_solved() -> None:
    mirror = {"n": 1.0, "k": 40.0}
    recipe = {"family": "film", "substrate": mirror, "layers": [{"material": mirror, "thickness_nm": 100}]}
    ridges = {"pitch_nm": 700, "width_nm": 300, "height_deviation_nm": 0, "optics": "vector", "count": 1, "draws": 1}
    with pytest.raises(NacreError):
        nacre.material({**recipe, "ridges": ridges}).bsdf(np.array([500.0, 600.0]))


def test_the_command_reports_the_fan(tmp_path: Any, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "wing.toml"
    path.write_text(
        'family = "film"\npreset = "morpho"\nwavelengths = {min_nm = 440, max_nm = 640, step_nm = 50}\n'
        'ridges = {optics = "vector", count = 1, draws = 2}\n'
    )
    assert run(["spectrum", str(path), "--angles-deg", "0", "--json"]) == 0
    assert "diffuse" in capsys.readouterr().out


@pytest.mark.full
def test_the_wing_is_that_of_its_supercells() -> None:
    """Light along the normal: each colour and the half width, against independent supercells of other draws."""
    fan = steady(rigorous_fan("meant", read_cells()), "meant")
    ours = vector_fan(fan.sines)
    views, found = fan.views(), ours.views()
    away = delta_e_2000(colours(views, views[0]), colours(found, views[0]))
    assert np.all(away <= LIMIT_DE00), away
    assert ours.half_deg(BLUE) == pytest.approx(fan.half_deg(BLUE), abs=LIMIT_DEG)


@pytest.mark.parametrize("shift", [0.0, 50.0])
def test_the_mean_interference_is_that_of_many_supercells(shift: float) -> None:
    wing, count = RidgeStatistics(700.0, 300.0, 3, 60.0, 0.0, shift), 2000
    sines, wave = np.arange(-3, 4) * 600.0 / wing.period_nm, 2.0 * np.pi / 600.0
    found = np.array([array_factor(drawn_ridges(wing, draw), sines, 0.3, wave) for draw in range(count)])
    error = found.std(axis=0) / np.sqrt(count)
    wanted = mean_array_factor(wing, sines, 0.3, wave)
    assert np.all(np.abs(found.mean(axis=0) - wanted) < 5.0 * error + 0.005)  # the latter of 4000 sampled ridges
    assert wanted == pytest.approx(wanted.T)


def test_known_interference_steadies_the_mean_of_few_supercells() -> None:
    """Light along the normal of two sets of supercells differs less than without the control variate."""
    wing = RidgeStatistics(700.0, 300.0, 2, 120.0)
    wave, draws = 2.0 * np.pi / 600.0, 24
    powers, factors = [], []
    for draw in range(draws):
        cell = drawn_ridges(wing, draw)
        fan = reflected_fan(cell, LAYERS, INDICES, 1.0, CUTICLE, 600.0, 0.0)
        powers.append(fan.power)
        factors.append(array_factor(cell, fan.sines, 0.0, wave))
    expected = mean_array_factor(wing, fan.sines, 0.0, wave)
    plain, steadied = np.array(powers), controlled(np.array(powers), np.array(factors), expected)
    weak = plain.var(axis=0).sum()
    assert steadied.var(axis=0).sum() < 0.5 * weak
    few = plain[: LEAST_DRAWS - 1]
    assert controlled(few, np.array(factors)[: LEAST_DRAWS - 1], expected) is few


def test_a_base_below_an_opaque_substrate_is_refused() -> None:
    film = {"family": "film", "preset": "morpho", "substrate": "Ag", "base": {"albedo": 0.3}}
    for optics in ("scalar", "vector"):
        with pytest.raises(UnsupportedError, match="base.albedo"):
            nacre.material({**film, "ridges": {"optics": optics}}).bsdf(np.array([550.0]))
