"""The model against Maxwell's equations: the solvers of `validation`, and gratings that both should agree on."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from validation._crossed import by_coordinates, by_plane_waves
from validation._gratings import lamellar, sliced, smooth
from validation.relief_rcwa import scalar_orders

from nacre.families.relief.diffraction_orders import fresnel_reflectance

SILVER, GLASS = 0.06 + 3.6j, 1.5 + 0.0j
SAMPLES = 1024
X = (np.arange(SAMPLES) + 0.5) / SAMPLES


def wave(depth: float, period: float) -> tuple[Any, Any]:
    return 0.5 * depth * np.cos(2 * np.pi * X), -np.pi * depth / period * np.sin(2 * np.pi * X)


@pytest.mark.parametrize("is_p", [False, True])
def test_a_flat_grating_is_a_mirror(is_p: bool) -> None:
    cosine, sine = np.cos(0.5), np.sin(0.5)
    inside = np.sqrt(SILVER**2 - sine**2)
    above, below = (SILVER**2 * cosine, inside) if is_p else (cosine, inside)
    wanted = abs((above - below) / (above + below)) ** 2
    flat = np.zeros(SAMPLES)
    for orders, found in (
        smooth(2.0, flat, flat, SILVER, 0.55, np.degrees(0.5), is_p, 8),
        sliced(2.0, 1e-9 * np.cos(2 * np.pi * X), flat, SILVER, 0.55, np.degrees(0.5), is_p, 4, 1),
        lamellar(2.0, 1e-9, 0.5, SILVER, 0.55, np.degrees(0.5), is_p, 8),
    ):
        assert found[orders == 0] == pytest.approx(wanted, rel=1e-6)
        assert found[orders != 0].max() < 1e-12


@pytest.mark.parametrize("is_p", [False, True])
def test_a_lossless_perfect_mirror_keeps_all_light(is_p: bool) -> None:
    _, found = smooth(2.0, *wave(0.3, 2.0), 1e4j, 0.55, 20.0, is_p, 14)
    assert found.sum() == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("n", [SILVER, GLASS])
@pytest.mark.parametrize("is_p", [False, True])
def test_two_methods_that_share_no_step_agree(n: complex, is_p: bool) -> None:
    orders, by_coordinates = smooth(1.5, *wave(0.06, 1.5), n, 0.55, 30.0, is_p, 12)
    _, by_slices = sliced(1.5, *wave(0.06, 1.5), n, 0.55, 30.0, is_p, 20, 48)
    strong = by_coordinates > 0.05 * by_coordinates.max()
    np.testing.assert_allclose(by_slices[strong], by_coordinates[strong], rtol=0.01)


@pytest.mark.parametrize("is_p", [False, True])
def test_orders_are_reciprocal(is_p: bool) -> None:
    """Light sent back along order m leaves along where it came from, with the same efficiency."""
    orders, there = smooth(2.0, *wave(0.2, 2.0), SILVER, 0.55, 20.0, is_p, 12)
    sine = np.sin(np.radians(20.0)) - 0.55 / 2.0
    back_orders, back = smooth(2.0, *wave(0.2, 2.0), SILVER, 0.55, np.degrees(np.arcsin(-sine)), is_p, 12)
    assert back[back_orders == -1] == pytest.approx(there[orders == -1], rel=1e-6)


@pytest.mark.parametrize("angle_deg", [0.0, 30.0])
def test_a_gentle_relief_is_as_maxwell_has_it(angle_deg: float) -> None:
    """Features of seven wavelengths and slopes of .03: nothing is left for shadows, second bounces or polarisation."""
    group = {
        "kind": "sinusoidal", "period_um": 8.0, "depth_um": 0.12, "angle_deg": angle_deg,
        "wavelengths_um": [0.55], "n": [SILVER],
    }  # fmt: skip
    heights, slopes = wave(0.12, 8.0)
    found = []
    for is_p in (False, True):
        orders, efficiencies = smooth(8.0, heights, slopes, SILVER, 0.55, angle_deg, is_p, 12)
        found.append(efficiencies)
    rigorous = np.mean(found, axis=0)
    ours = scalar_orders(group, 0, orders.tolist())
    strong = rigorous > 0.05 * rigorous.max()
    assert strong.sum() >= 3
    np.testing.assert_allclose(ours[strong], rigorous[strong], rtol=0.03)
    flat = fresnel_reflectance(np.cos(np.radians([angle_deg])), np.array([SILVER]))[0, 0]
    assert ours.sum() == pytest.approx(flat, rel=0.01)


CROSSED = np.arange(32) / 32


@pytest.mark.parametrize("method", [by_coordinates, by_plane_waves])
def test_a_relief_that_varies_along_x_alone_is_the_grating(method: Any) -> None:
    phase = 2 * np.pi * CROSSED[:, None] * np.ones(32)
    slopes = np.stack([-np.pi * 0.06 / 0.9 * np.sin(phase), 0 * phase])
    orders, found = method(0.9, 0.03 * np.cos(phase), slopes, SILVER, 0.55, 20.0, 4.6)
    in_plane = orders[:, 1] == 0
    for which in "sp":
        numbers, wanted = smooth(0.9, *wave(0.06, 0.9), SILVER, 0.55, 20.0, which == "p", 12)
        rank = np.argsort(orders[in_plane, 0])
        assert orders[in_plane, 0][rank].tolist() == numbers.tolist()
        np.testing.assert_allclose(found[which][in_plane][rank], wanted, rtol=0.01)
        assert found[which][~in_plane].max() < 1e-9


@pytest.mark.parametrize("n", [SILVER, GLASS])
def test_two_methods_that_share_no_step_agree_on_a_hill(n: complex) -> None:
    cosine, sine = np.cos(2 * np.pi * CROSSED), np.sin(2 * np.pi * CROSSED)
    depth, period = 0.06, 0.9
    heights = 0.25 * depth * np.outer(1 + cosine, 1 + cosine)
    slope = -0.5 * np.pi * depth / period * np.outer(sine, 1 + cosine)
    args = period, heights, np.stack([slope, slope.T]), n, 0.55, 20.0
    orders, first = by_coordinates(*args, 4.6)
    others, second = by_plane_waves(*args, 4.6)
    assert orders.tolist() == others.tolist()
    for which in "sp":
        strong = first[which] > 0.05 * first[which].max()
        np.testing.assert_allclose(second[which][strong], first[which][strong], rtol=0.01)
