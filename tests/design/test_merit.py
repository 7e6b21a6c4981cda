"""Merit function: distances against colour-science and brute force."""

from __future__ import annotations

import colour
import numpy as np
import pytest

from nacre.core.errors import NacreError
from nacre.light import delta_e_2000, lch_to_lab, xyz_weights
from nacre.optimise.merit import MeritFunction, Operand, default_wavelengths_nm, smooth_weights

ROUNDING = 1e-9
# colour-science cuts off at 380 and 780 nm, where nacre's tables go on to 360 and 830 nm
CUT_OFF = 0.02


def fringes(wavelengths_nm: np.ndarray, thickness_nm: float) -> np.ndarray:
    """A spectrum like that of a film: fringes of an optical thickness."""
    return 0.5 + 0.45 * np.cos(4.0 * np.pi * thickness_nm / wavelengths_nm)


def test_distances_agree_with_colour_science_under_two_lamps() -> None:
    fine = np.arange(380.0, 781.0)
    coarse = default_wavelengths_nm()
    wanted = (45.0, 30.0, -12.0)
    found = MeritFunction([Operand(0, "colour", lab=wanted)], ("D65", "A")).distances(fringes(coarse, 900.0)[None])
    for lamp, ours in zip(("D65", "A"), found):
        cmfs = colour.MSDS_CMFS["CIE 1964 10 Degree Standard Observer"]
        sd = colour.SpectralDistribution(fringes(fine, 900.0), fine)
        light = colour.SDS_ILLUMINANTS[lamp]
        shape = colour.SpectralShape(380, 780, 1)
        seen, white = (
            colour.sd_to_XYZ(s, cmfs.copy().align(shape), light.copy().align(shape), method="Integration") / 100.0
            for s in (sd, colour.sd_ones(shape))
        )
        lab = colour.XYZ_to_Lab(seen, colour.XYZ_to_xy(white))
        assert abs(ours - colour.delta_E(lab, np.array(wanted), method="CIE 2000")) < CUT_OFF


def test_splines_need_a_fifth_of_the_samples_of_straight_lines() -> None:
    fine, coarse = np.arange(380.0, 781.0), np.linspace(380.0, 780.0, 41)
    exact = fringes(fine, 1500.0) @ xyz_weights(fine, "D65", "10deg")
    lines = fringes(coarse, 1500.0) @ xyz_weights(coarse, "D65", "10deg")
    splines = fringes(coarse, 1500.0) @ smooth_weights(coarse, "D65", "10deg")
    assert abs(splines - exact).max() < 0.2 * abs(lines - exact).max()


def test_residuals_have_the_length_of_the_scaled_distances() -> None:
    grid = default_wavelengths_nm()
    goals = MeritFunction(
        [
            Operand(0, "colour", lab=(40, 30, -20), tolerance=0.5),
            Operand(1, "colour", xyz=(0.3, 0.2, 0.1), weight=2.0),
            Operand(1, "spectrum", reflectance=fringes(grid, 300.0), tolerance=3.0),
        ],
        ("D65", "F11"),
    )
    spectra = np.stack([fringes(grid, 500.0), fringes(grid, 700.0)])
    d = goals.distances(spectra)
    assert goals.terms == [(0, 0), (0, 1), (1, 0), (2, 0)]
    assert abs((goals.residuals(spectra) ** 2).sum() - ((d * goals.scale) ** 2).sum()) < 1e-6
    assert goals.objective(d) == pytest.approx((d * goals.scale).max() + 1e-3 * (d * goals.scale).mean())


@pytest.mark.parametrize(
    ("goal", "inside", "outside"),
    [
        (Operand(0, "hue", low=350, high=10), (50, 30, 2), (50, 20, 25)),
        (Operand(0, "hue", low=10, high=350), (50, -30, 2), (50, 40, 2)),
        (Operand(0, "chroma", low=40), (50, 30, 30), (40, 5, -20)),
        (Operand(0, "chroma", low=10, high=20), (50, 10, 10), (40, 5, -60)),
        (Operand(0, "lightness", high=20), (15, 30, 30), (40, 5, -20)),
    ],
)
def test_the_distance_to_a_range_is_that_of_its_nearest_colour(goal: Operand, inside: tuple, outside: tuple) -> None:
    """The nearest of a dense sample of the colours that satisfy the range."""
    goals = MeritFunction([goal])
    near = goals._distance(np.zeros((1, 201)), np.array([inside], dtype=float)[None], 0)
    far = goals._distance(np.zeros((1, 201)), np.array([outside], dtype=float)[None], 0)
    lightness, chroma, hue = (
        v.ravel() for v in np.meshgrid(np.arange(0.0, 81.0, 1.0), np.arange(0.0, 90.0, 0.5), np.arange(0.0, 360.0, 2.0))
    )
    low, high = goal.low if goal.low is not None else -np.inf, goal.high if goal.high is not None else np.inf
    if goal.kind == "hue":
        allowed = (hue - low) % 360.0 <= (high - low) % 360.0
    else:
        value = chroma if goal.kind == "chroma" else lightness
        allowed = (value >= low) & (value <= high)
    lab = lch_to_lab(np.stack([lightness, chroma, hue], axis=-1)[allowed])
    least = delta_e_2000(lab, np.array(outside, dtype=float)).min()
    assert near == 0.0
    assert far == pytest.approx(least, abs=0.03)  # the sample's own spacing
    assert far <= least + ROUNDING


@pytest.mark.parametrize(
    ("goal", "words"),
    [
        (Operand(0, "colour"), "lab or xyz"),
        (Operand(0, "hue", low=3), "both ends"),
        (Operand(0, "chroma"), "lower or an upper"),
        (Operand(0, "lightness", low=30, high=20), "cross"),
        (Operand(0, "spectrum", reflectance=np.ones(3)), "201 values"),
        (Operand(0, "colour", lab=(1, 2, 3), tolerance=0.0), "tolerance > 0"),
    ],
)
def test_an_invalid_operand_is_refused(goal: Operand, words: str) -> None:
    with pytest.raises(NacreError, match=words):
        MeritFunction([goal])
