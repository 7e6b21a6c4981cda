"""Orders against references made by two independent methods each, and against known limits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers_grating import differences, recipe, reference

import nacre
from nacre.core.machine import single_threaded_blas
from nacre.matter.periodic.crossed_solver import RECTANGLE_STEPS, solve_rectangles
from nacre.matter.periodic.solve import total
from nacre.matter.periodic.structure import Cell, OrderSolution, PatternLayer, PeriodicStack, Rectangle

QUICK = (3, 8, 12, 18, 26, 39, 44, 53, 57, 90, 120)
BARS = {  # the issue's, by class: clear, metal
    "A": (3e-4, 1.5e-3), "B": (1e-4, 1.5e-3), "C": (4e-3, 4e-3), "D1": (3e-4, 1.5e-3), "D2": (4e-3, 4e-3),
    "D3": (3e-4, 1.5e-3),
}  # fmt: skip
REFERENCE_ERROR = {"A": 1e-4, "B": 1e-5, "C": 2e-3, "D1": 1e-4, "D2": 2e-3, "D3": 9e-4}  # of the reference itself


def solved(i: int) -> tuple[Any, float]:
    z = reference()
    found = nacre.orders(
        recipe(i), float(z["theta_deg"][i]), float(z["phi_deg"][i]) + 180.0, [1e3 * float(z["wavelength"][i])]
    )
    bar = BARS[str(z["case_class"][i])][int(z["is_metal"][i])]
    return found, bar


@pytest.mark.parametrize("i", QUICK)
def test_orders_are_those_of_the_reference(i: int) -> None:
    found, bar = solved(i)
    efficiency, jones = differences(i, found)
    assert efficiency <= bar
    assert jones <= 10 * bar  # of amplitudes; the smallest efficiencies are squares of them


@pytest.mark.full
def test_all_orders_are_those_of_the_reference_and_errors_are_estimated() -> None:
    z = reference()
    exceeded, crossed = 0, []
    for i in range(len(z["shape"])):
        found, bar = solved(i)
        efficiency, _ = differences(i, found)
        assert efficiency <= bar, (i, efficiency)
        exceeded += efficiency > float(found.error.max()) + REFERENCE_ERROR[str(z["case_class"][i])]
        if str(z["case_class"][i]) in ("C", "D2"):  # two periods, without a margin for the reference
            crossed.append(efficiency > float(found.error.max()))
    assert exceeded <= 0.05 * len(z["shape"])
    assert sum(crossed) <= 0.05 * len(crossed)


def test_a_published_metal_grating() -> None:
    # period = wavelength = depth = 1, p at 30 degrees (the reference's README); the Rayleigh anomaly is avoided
    metal = {"n": 0.22, "k": 6.71}
    lines = {"thickness_nm": 1000, "material": "air", "shapes": [{"shape": "line", "material": metal, "width_nm": 500}]}
    made = {"family": "grating", "substrate": metal, "layers": [lines], "lattice": {"period_nm": 1000}}
    found = nacre.orders(made, 30.0, 180.0, [1000.0 * (1 - 1e-9)])
    values = dict(zip(found.numbers[:, 0].tolist(), found.reflected[0, 0, :, 1], strict=True))
    assert values[0] == pytest.approx(0.84848, abs=2e-4) and values[-1] == pytest.approx(0.10156, abs=2e-4)


def random_lossless(g: np.random.Generator) -> tuple[dict[str, Any], float, float, float]:
    period = float(g.uniform(250, 1800))
    kind = g.integers(3)
    made: dict[str, Any] = {
        "family": "grating", "substrate": {"n": float(g.uniform(1.3, 3.5))}, "lattice": {"period_nm": period},
    }  # fmt: skip
    if kind == 0:
        shape = ["sinusoidal", "triangle"][g.integers(2)]
        made["profile"] = {"shape": shape, "depth_nm": float(g.uniform(0.05, 0.6)) * period}
        if shape == "triangle":
            made["profile"]["apex"] = float(g.uniform(0.2, 0.8))
    else:
        made["layers"] = [
            {"thickness_nm": float(g.uniform(20, 600)), "material": {"n": float(g.uniform(1.0, 2.0))},
             "shapes": [{"shape": "line", "material": {"n": float(g.uniform(1.3, 4.0))},
                         "width_nm": float(g.uniform(0.15, 0.85)) * period}]}
            for _ in range(g.integers(1, 4))
        ]  # fmt: skip
    return made, float(g.uniform(0, 75)), float(g.uniform(0, 360)), float(g.uniform(400, 800))


def energy_defect(seed: int) -> float:
    made, theta, azimuth, wavelength = random_lossless(np.random.default_rng(seed))
    found = nacre.orders(made, theta, azimuth, [wavelength])
    total = np.nansum(found.reflected, axis=2) + np.nansum(found.transmitted, axis=2)
    return float(np.abs(total - 1.0).max())


def test_lossless_gratings_keep_energy() -> None:
    assert max(energy_defect(seed) for seed in range(24)) <= 1e-8


@pytest.mark.full
def test_five_hundred_lossless_gratings_keep_energy() -> None:
    assert max(energy_defect(seed) for seed in range(24, 500)) <= 1e-8


def test_films_over_a_profile_keep_energy() -> None:
    made = {
        "family": "grating", "substrate": {"n": 2.04}, "lattice": {"period_nm": 1100},
        "profile": {"shape": "blazed", "depth_nm": 310, "apex": 0.9},
        "layers": [{"thickness_nm": 200, "material": {"n": 2.9}}, {"thickness_nm": 60, "material": {"n": 1.5}}],
    }  # fmt: skip
    found = nacre.orders(made, 42.0, 90.0, [444.0])
    total = np.nansum(found.reflected, axis=2) + np.nansum(found.transmitted, axis=2)
    assert np.abs(total - 1.0).max() <= 1e-8


def test_two_periods_keep_energy() -> None:
    layer = {"thickness_nm": 120, "material": "air"}
    for shape in ({"shape": "rectangle", "width_nm": 150}, {"shape": "disc", "diameter_nm": 200}):
        made = {
            "family": "grating", "substrate": {"n": 1.5}, "lattice": {"period_nm": 420}, "model": {"tolerance": 0.05},
            "layers": [layer | {"shapes": [shape | {"material": {"n": 2.2}}]}],
        }  # fmt: skip
        found = nacre.orders(made, 25.0, 33.0, [500.0])
        total = np.nansum(found.reflected, axis=2) + np.nansum(found.transmitted, axis=2)
        assert np.abs(total - 1.0).max() <= 1e-8


@pytest.mark.parametrize(("theta", "phi"), [(0.0, 0.3), (0.5, 0.0)])
def test_rectangles_at_their_smallest_size_keep_energy_and_are_reciprocal(theta: float, phi: float) -> None:
    """Light in mirror planes, where the functions split into parities."""
    box, k0 = Rectangle(-150.0, 150.0, -120.0, 120.0), 2.0 * np.pi / 450.0
    stack = PeriodicStack(Cell(700.0, 600.0), 1.0, (PatternLayer(130.0, 1.0, ((box, 9.0 + 0j),)),), 1.5 + 0j)

    def solved(theta: float, phi: float) -> OrderSolution:
        with single_threaded_blas():
            return solve_rectangles(stack, k0, theta, phi, RECTANGLE_STEPS[0])

    there = solved(theta, phi)
    assert total(there) == pytest.approx(np.ones(2), abs=1e-8)
    side = there.reflected
    at = max(np.flatnonzero(side.numbers.any(axis=1)), key=lambda k: side.efficiency[k].sum())
    x, y, z = -side.direction[at]
    back = solved(np.arccos(-z), np.arctan2(y, x)).reflected
    to = int(np.flatnonzero((back.numbers == side.numbers[at]).all(axis=1))[0])
    assert side.efficiency[at].sum() > 1e-3
    assert back.efficiency[to].sum() == pytest.approx(side.efficiency[at].sum(), abs=1e-8)


@pytest.mark.parametrize(("angle_deg", "wavelength_nm"), [(0.0, 500.0), (0.0, 750.0), (30.0, 750.0)])
def test_orders_along_the_surface_carry_no_energy(angle_deg: float, wavelength_nm: float) -> None:
    line = {"shape": "line", "material": {"n": 2.2}, "width_nm": 200}
    common = {"family": "grating", "substrate": {"n": 1.5}, "lattice": {"period_nm": 500}}
    for shape in (line, line | {"sidewall_deg": 80}):
        made = common | {"layers": [{"thickness_nm": 100, "material": "air", "shapes": [shape]}]}
        found = nacre.orders(made, angle_deg, 0.0, [wavelength_nm])
        sums = np.nansum(found.reflected, axis=2) + np.nansum(found.transmitted, axis=2)
        assert sums == pytest.approx(np.ones((1, 1, 2)), abs=1e-8)


@pytest.mark.parametrize("profile", [None, "sinusoidal"])
def test_orders_are_reciprocal(profile: str | None) -> None:
    made: dict[str, Any] = {"family": "grating", "substrate": "Al", "lattice": {"period_nm": 900}}
    if profile:
        made["profile"] = {"shape": profile, "depth_nm": 150}
    else:
        lines = {"shape": "line", "material": {"n": 1.6}, "width_nm": 400, "center_nm": [100, 0]}
        made["layers"] = [{"thickness_nm": 200, "material": "air", "shapes": [lines]}]
        made["layers"] += [{"thickness_nm": 90, "material": "air", "shapes": [lines | {"center_nm": [30, 0]}]}]
    theta, azimuth = 23.0, 40.0
    there = nacre.orders(made, theta, azimuth, [550.0])
    for k, number in enumerate(there.numbers[:, 0]):
        if np.isnan(there.reflected[0, 0, k, 0]):
            continue
        x, y, z = there.reflected_direction[0, 0, k]
        back = nacre.orders(made, np.degrees(np.arccos(z)), np.degrees(np.arctan2(y, x)), [550.0])
        at = int(np.flatnonzero(back.numbers[:, 0] == number)[0])
        assert back.reflected[0, 0, at].mean() == pytest.approx(there.reflected[0, 0, k].mean(), abs=1e-8)


def test_unpatterned_layers_are_a_stack() -> None:
    layers = [
        {"thickness_nm": d, "material": {"n": n, "k": k}} for d, n, k in ((80, 2.1, 0), (150, 1.46, 0), (20, 0.2, 3))
    ]
    common = {"substrate": {"n": 1.5}, "layers": layers}
    lam = np.array([450.0, 700.0])
    found = nacre.orders({"family": "grating", "lattice": {"period_nm": 500}} | common, [0.0, 55.0], 20.0, lam)
    zero = int(np.flatnonzero(np.all(found.numbers == 0, axis=1))[0])
    for k, name in enumerate("sp"):
        film = nacre.spectrum({"family": "film"} | common, [0.0, 55.0], lam, name)
        assert np.abs(found.reflected[:, :, zero, k] - film.specular_reflectance).max() <= 1e-10
        assert np.abs(found.transmitted[:, :, zero, k] - film.specular_transmittance).max() <= 1e-10


def test_deep_gold_stays_finite() -> None:
    # a deep opaque layer: gold at 700 nm of index 0.131 + 4.062i, R = 0.97... by Fresnel; lines of gold in gold as well
    gold = {"n": 0.131, "k": 4.062}
    fresnel = abs((1 - (0.131 + 4.062j)) / (1 + (0.131 + 4.062j))) ** 2
    for shapes in ([], [{"shape": "line", "material": gold, "width_nm": 200}]):
        layers = [{"thickness_nm": 1500, "material": gold, "shapes": shapes}]
        found = nacre.orders(
            {"family": "grating", "substrate": gold, "layers": layers, "lattice": {"period_nm": 400}}, 0, 0, [700.0]
        )
        assert found.reflected[0, 0, 0] == pytest.approx([fresnel] * 2, abs=1e-9)
