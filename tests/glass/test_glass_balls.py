"""Photonic balls in a binder: one ball, its limits, and paint of them against balls traced one by one in a box."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from two_scale import place_balls, trace

import nacre
from nacre.core.errors import RecipeError
from nacre.families.glass.composite import Balls, ball_light
from nacre.families.glass.radiative_transfer import Slab

LAM = np.array([430.0, 600.0])
RADIUS_NM = 4000.0
WALK_BAR = 0.004  # of the issue, for reflectances by walks


def paint(fraction: float = 0.2, thickness_um: float = 80.0, **changes: Any) -> dict[str, Any]:
    return {
        "family": "glass",
        "thickness_um": thickness_um,
        "spheres": {"material": {"n": 1.59}, "radius_nm": 125, "volume_fraction": 0.55},
        "absorber": {"k": 0.001},
        "balls": {"binder": {"n": 1.5}, "radius_um": RADIUS_NM / 1e3, "volume_fraction": fraction},
        **changes,
    }


def balls(data: dict[str, Any]) -> Balls:
    found = nacre.material(data).model.composite
    assert isinstance(found, Balls)
    return found


def traced(fraction: float, side: float, depth: float, boxes: int, walks: int, n_binder: float) -> tuple[Any, Any]:
    """R and T of balls in boxes, and their standard errors, at the first wavelength; the ratio of indices is kept."""
    glass = balls(paint(fraction)).glass.medium(LAM)
    rng = np.random.default_rng(3)
    found = np.array(
        [
            trace(
                7 * i, walks, place_balls(fraction, side, depth, rng), side, depth, 1.0, n_binder,
                float(glass.index[0]) * n_binder / 1.5, glass.scattering[0] * RADIUS_NM,
                glass.absorption[0] * RADIUS_NM, glass.quantiles()[0],
            )
            for i in range(boxes)
        ]
    )  # fmt: skip
    share = found.mean(axis=0)
    return share, np.sqrt(share * (1 - share) / (boxes * walks))


def slab(fraction: float, depth: float, n_binder: float, met: float | None = None) -> Any:
    medium = balls(paint(fraction)).medium(LAM)
    if met is not None:
        medium = replace(medium, scattering=medium.scattering * met, absorption=medium.absorption * met)
    solved = Slab.solve(replace(medium, index=np.full(2, n_binder)), 0, depth * RADIUS_NM, None)
    parts = np.array(solved.powers(np.ones(1)))[:, 0]
    return parts[[0, 1]] + parts[[2, 3]]


@pytest.mark.full
def test_one_ball_sends_back_and_absorbs_what_one_traced_in_a_box_does() -> None:
    """An opaque ball of glass, whose light is turned many times, in a box so wide that its images are far."""
    inside, ratio, _ = _ball_of(0.2)
    dense = replace(inside, scattering=inside.scattering * 8).at(np.array([0]))
    light = ball_light(dense, ratio[:1], RADIUS_NM, 400_000)
    turns = np.linspace(0.0, 1.0, 20_001)
    density = np.interp(turns, np.linspace(0.0, 1.0, light.density.shape[1]), light.density[0])
    back = np.trapezoid(np.where(turns**2 > 0.5, 8 * np.pi * turns * density, 0.0), turns)
    side, walks = 16.0, 4_000_000
    up, down = trace(
        5, walks, np.array([[8.0, 8.0, 1.001]]), side, 2.002, 1.0, 1.0, float(ratio[0]),
        dense.scattering[0] * RADIUS_NM, dense.absorption[0] * RADIUS_NM, dense.quantiles()[0],
    )  # fmt: skip
    shadow = np.pi / side**2
    for ours, theirs in ((back, up / shadow), (light.absorbed[0], (1 - up - down) / shadow)):
        assert abs(ours - theirs) < 4 * np.sqrt(theirs / shadow / walks) + 1e-3


def test_a_thin_paint_is_what_balls_traced_one_by_one_are() -> None:
    """Both scales at once, in space, where balls stand so far apart that no order among them counts."""
    found, error = traced(0.03, 40.0, 33.0, 5, 4000, 1.0)
    assert np.all(np.abs(slab(0.03, 33.0, 1.0) - found) < WALK_BAR + 3.0 * error)


def test_what_a_ball_carries_on_is_counted_where_they_stand_close() -> None:
    """Independent point-like shadows transmit too much; the path inside a ball explains most of the difference."""
    found, error = traced(0.2, 24.0, 20.0, 5, 4000, 1.0)
    light = ball_light(*_ball_of(0.2))
    points = (4 / 3 * 4 + light.carried[0]) / (4 / 3 / 0.2)
    plain, ours = slab(0.2, 20.0, 1.0, points)[1], slab(0.2, 20.0, 1.0)[1]
    assert plain - found[1] > 6 * error[1]
    assert abs(ours - found[1]) < 0.5 * (plain - found[1])


def _ball_of(fraction: float) -> tuple[Any, Any, float]:
    made = balls(paint(fraction))
    inside = made.glass.medium(LAM)
    return inside, inside.index / made.effective_index(LAM).real, made.radius_nm


def test_dense_balls_state_how_much_a_gap_at_the_faces_reflects() -> None:
    """The relative errors of the reflectance against traced balls, `python -m validation glass_balls`, in per cent."""
    thin, dense = (nacre.material(paint(fraction)).model.warnings for fraction in (0.05, 0.3))
    assert not thin and len(dense) == 1 and "10 %" in dense[0] and "30 %" in dense[0]


def test_a_ball_without_contrast_is_not_there() -> None:
    same = {"material": {"n": 1.5}, "radius_nm": 125, "volume_fraction": 0.55}
    made = balls(paint(spheres=same, matrix={"n": 1.5}, absorber={"k": 0.0}))
    assert np.all(made.medium(LAM).extinction < 1e-9 / RADIUS_NM)
    light = ball_light(made.glass.medium(LAM), np.ones(2), RADIUS_NM)
    np.testing.assert_allclose(light.carried, 4 / 3, rtol=0.01)  # the mean chord


def test_a_black_ball_sends_back_what_its_face_does() -> None:
    """Diffuse Fresnel reflectance from outside, n = 1.28402, of the note: .058535; and that of a ray turned by it."""
    inside, _, radius = _ball_of(0.2)
    light = ball_light(replace(inside, absorption=np.full(2, 1.0)), np.full(2, 1.28402244), radius, 400_000)
    assert np.all(np.abs(1 - light.absorbed - 0.058535) < 4 * np.sqrt(0.0585 / 400_000))
    # light that grazes the face is turned by less than the half cell: 2 cos^2 < 1/360, of a shadow's 1/720
    assert np.all(light.passed < 1 / 720)


def test_no_light_is_lost_where_nothing_absorbs() -> None:
    found = nacre.material(paint(0.3, absorber={"k": 0.0}, base={"none": True})).spectrum([0.0, 1.0], LAM)
    total = sum(
        part
        for part in (
            found.specular_reflectance, found.diffuse_reflectance, found.specular_transmittance,
            found.diffuse_transmittance,
        )
        if part is not None
    )  # fmt: skip
    np.testing.assert_allclose(total, 1.0, atol=1e-3)


def test_lossless_paint_on_white_is_white() -> None:
    found = nacre.material(paint(0.3, absorber={"k": 0.0}, base={"albedo": 1.0})).spectrum([0.0, 1.0], LAM)
    assert found.specular_reflectance is not None and found.diffuse_reflectance is not None
    np.testing.assert_allclose(found.specular_reflectance + found.diffuse_reflectance, 1.0, atol=3e-3)


def test_a_binder_that_absorbs_does_so_between_the_balls() -> None:
    clear = balls(paint(0.25)).medium(LAM)
    black = {"binder": {"n": 1.5, "k": 0.001}, "radius_um": RADIUS_NM / 1e3, "volume_fraction": 0.25}
    found = balls(paint(balls=black)).medium(LAM)
    np.testing.assert_allclose(found.absorption - clear.absorption, 0.75 * 4 * np.pi * 0.001 / LAM, rtol=1e-9)


@pytest.mark.render
def test_the_walk_of_the_renderer_agrees_with_transfer() -> None:
    from nacre.core.arrays import direction
    from nacre.measure.evaluate import evaluate_with_error

    material = nacre.material(paint(0.3))
    wi, wo = direction(np.radians([10.0, 50.0])), direction(np.radians([40.0, 20.0]), np.radians([0.0, 120.0]))
    known = material.model.surrogate_radiance(wi, wo, LAM)
    values, error = evaluate_with_error(material.bsdf(LAM), wi, wo, samples=20_000, seed=3)
    assert known is not None and error is not None
    assert np.max(np.abs(values - known[0]) / error) < 3.6


REFUSED = {
    "denser than random packing": ({"volume_fraction": 0.7}, "balls.volume_fraction|volume_fraction = 0.7 .*0.64"),
    "a ball of too few spheres": ({"radius_um": 0.3}, "balls.radius_um = 0.3 .*0.375"),
    "balls larger than the layer": ({"radius_um": 20}, "thickness_um = 80 .*3 balls, at least 120"),
    "a binder of metal": ({"binder": {"n": 0.2, "k": 3.0}}, "balls.binder .*at least 1"),
    "a black binder": ({"binder": {"n": 1.5, "k": 0.5}}, "balls.binder .*k at most 0.1"),
    "no binder": ({"binder": None}, "balls.binder"),
    "gain": ({"binder": {"n": 1.5, "k": -0.1}}, "balls.binder"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_is_refused_in_one_line(case: str) -> None:
    changes, message = REFUSED[case]
    data = paint()
    data["balls"] = {key: value for key, value in {**data["balls"], **changes}.items() if value is not None}
    with pytest.raises(RecipeError, match=message) as caught:
        nacre.material(data)
    assert "\n" not in str(caught.value)
