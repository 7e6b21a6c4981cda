"""Do averages over thickness give the right R, T, A? Against brute quadrature, limits and energy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from nacre.core.errors import NacreError
from nacre.families.pearl.platelet import Coating, Platelet, platelet_response
from nacre.families.pearl.thickness import Thickness
from nacre.matter.indices.library import index
from nacre.matter.indices.spec import IndexSpec
from nacre.matter.stack.solve import powers

PET = 1.575
AWAY_FROM_GRAZING = 1e-8  # the bar, cos >= 0.1
EVERYWHERE = 1e-4  # the bar
ENERGY = 1e-12  # the bar
COS = np.array([0.01, 0.03, 0.1, 0.2, 0.3, 0.38, 0.55, 0.8, 1.0])
LAM = np.array([410.0, 555.0, 700.0])


def constant(n: float, k: float = 0.0):
    return IndexSpec.model_validate({"n": n, "k": k}).build()


MICA, TIO2, SIO2 = constant(1.6137), constant(2.6142), constant(1.4585)
ALUMINIUM, WEAK_MICA, IRON = constant(1.1978, 7.0488), constant(1.6137, 1e-3), constant(3.3206, 0.2192)


def coating(material, nm, deviation=0.0):
    return Coating(material, Thickness(nm, deviation))


CASES = {
    "mica, a third spread": Platelet(MICA, Thickness(560.44, 179.32), (coating(TIO2, 140),)),
    "mica, narrow": Platelet(MICA, Thickness(560.44, 22.41), (coating(TIO2, 140),)),
    "silica beyond its critical angle": Platelet(SIO2, Thickness(80, 5), (coating(TIO2, 85),)),
    "absorbing mica": Platelet(WEAK_MICA, Thickness(560.44, 179.32), (coating(TIO2, 140),)),
    "metal": Platelet(ALUMINIUM, Thickness(80, 10), (coating(TIO2, 70), coating(IRON, 115))),
    "lognormal": Platelet(MICA, Thickness(400, 80, "lognormal"), (coating(TIO2, 70),)),
    "truncated": Platelet(MICA, Thickness(400, 80, "truncated", 300, 520), (coating(TIO2, 70),)),
    "histogram": Platelet(
        MICA, Thickness.from_histogram(np.array([300.0, 400, 500]), np.array([0.2, 0.5, 0.3])), (coating(TIO2, 70),)
    ),
    "asymmetric": Platelet(MICA, Thickness(400, 80), (coating(TIO2, 70),), (coating(IRON, 20),)),
    "free": Platelet(TIO2, Thickness(100, 10)),
    "one thickness": Platelet(MICA, Thickness(400), (coating(TIO2, 60),)),
}


def brute(platelet: Platelet, cos, lam, panels=600):
    """Average whole stacks, solved one thickness at a time, by Gauss rules on fine panels; both faces."""
    nodes, weights = platelet.thickness.nodes(panels)
    lower = platelet.upper if platelet.lower is None else platelet.lower
    total = 0.0
    for above, below in ((platelet.upper, lower), (lower, platelet.upper)):
        layers = [*above, None, *below[::-1]]
        n = [c.material.n_complex(lam) if c else platelet.substrate.n_complex(lam) for c in layers]
        resin = np.full(len(lam), PET, dtype=complex)
        d = np.array([[c.thickness.mean_nm if c else t for c in layers] for t in nodes])
        solved = powers(np.stack([resin, *n, resin]), d, lam, cos_i=cos)
        both = np.stack([solved.R_s, solved.R_p, solved.T_s, solved.T_p])
        total = total + np.einsum("q,xqal->xal", weights, both) / 2
    return total[:2], total[2:]


@pytest.mark.parametrize("name", CASES)
def test_average_equals_brute_quadrature(name):
    platelet = CASES[name]
    lam = LAM[1:2] if "absorbing" in name else LAM
    found = platelet_response(platelet, np.full(len(lam), PET), COS, lam)
    r, t = brute(platelet, COS, lam)
    error = np.maximum(np.abs(found.reflectance - r), np.abs(found.transmittance - t)).max(axis=(0, 2))
    assert error[COS >= 0.1].max() <= AWAY_FROM_GRAZING
    assert error.max() <= EVERYWHERE


@pytest.mark.parametrize("name", CASES)
def test_energy_is_conserved_by_every_average(name):
    cos = np.linspace(0, 1, 65)
    found = platelet_response(CASES[name], np.full(len(LAM), PET), cos, LAM)
    assert np.all(np.isfinite(found.reflectance)) and np.all(np.isfinite(found.transmittance))
    if name in ("absorbing mica", "metal", "asymmetric"):
        assert found.absorptance.min() >= -ENERGY
        assert found.absorptance[:, 1:].max() > 1e-3
    else:
        assert np.abs(found.absorptance).max() <= ENERGY


def test_absorption_of_a_metal_flake_equals_the_poynting_loss_of_its_layers():
    from nacre.matter.stack.solve import solve

    platelet = Platelet(ALUMINIUM, Thickness(15), (coating(TIO2, 70),))
    found = platelet_response(platelet, np.full(3, PET), COS, LAM)
    resin = np.full(3, PET, dtype=complex)
    n = np.stack([resin, np.full(3, 2.6142), np.full(3, 1.1978 + 7.0488j), np.full(3, 2.6142), resin])
    solved = solve(n, np.array([70.0, 15.0, 70.0]), LAM, cos_i=COS, absorption=True)
    assert np.abs(found.absorptance[0] - solved.A_s.sum(axis=0)).max() < 1e-10
    assert np.abs(found.absorptance[1] - solved.A_p.sum(axis=0)).max() < 1e-10


def test_a_coating_that_varies_is_averaged_too():
    found = platelet_response(
        Platelet(MICA, Thickness(400, 40), (coating(TIO2, 80, 8.0),)), np.full(1, PET), COS[2:], LAM[:1]
    )
    nodes, weights = Thickness(80, 8.0).nodes(32)
    total = sum(
        w
        * platelet_response(
            Platelet(MICA, Thickness(400, 40), (coating(TIO2, t),)), np.full(1, PET), COS[2:], LAM[:1]
        ).reflectance
        for t, w in zip(nodes, weights, strict=True)
    )
    error = np.abs(found.reflectance - total).max(axis=(0, 2))
    assert error.max() < AWAY_FROM_GRAZING


@pytest.mark.parametrize("deviation", [40.0, 250.0])
def test_a_lognormal_thickness_has_the_mean_and_the_deviation_that_are_asked_for(deviation):
    """Not the median: at a deviation of 250 nm the median of a mean of 500 nm is 447 nm."""
    spread = Thickness(500.0, deviation, "lognormal")
    nodes, weights = spread.nodes(60)
    assert weights.sum() == pytest.approx(1, abs=1e-12)
    assert weights @ nodes == pytest.approx(500.0, rel=1e-9)
    assert np.sqrt(weights @ (nodes - 500.0) ** 2) == pytest.approx(deviation, rel=1e-6)
    # half of the flakes are thinner than the median, mean / sqrt(1 + (deviation/mean)^2)
    median = 500.0 / np.sqrt(1 + (deviation / 500.0) ** 2)
    assert np.interp(median, nodes, np.cumsum(weights) - weights / 2) == pytest.approx(0.5, abs=1e-3)


def test_a_narrow_distribution_tends_to_one_thickness():
    one = platelet_response(CASES["one thickness"], np.full(3, PET), COS, LAM).reflectance
    narrow = Platelet(MICA, Thickness(400, 1e-3), (coating(TIO2, 60),))
    assert np.abs(platelet_response(narrow, np.full(3, PET), COS, LAM).reflectance - one).max() < 1e-6


def test_a_gaussian_that_is_hardly_cut_may_count_as_whole():
    thickness = Thickness(425, 106)
    assert thickness.cut_share == pytest.approx(norm.cdf(-425 / 106), rel=1e-9)
    assert Thickness(425, 106, "truncated", 300, 500).cut_share == pytest.approx(
        1 - norm.cdf(75 / 106) + norm.cdf(-125 / 106), rel=1e-9
    )
    resin, platelet = np.full(len(LAM), PET), Platelet(MICA, thickness, (coating(TIO2, 60),))
    exact = platelet_response(platelet, resin, COS, LAM)
    whole, no_more = (platelet_response(platelet, resin, COS, LAM, uncut) for uncut in (1e-3, 1e-6))
    off = np.abs(whole.reflectance - exact.reflectance)[:, COS > 0.1].max()
    assert 0.0 < off < 1e-3
    assert np.array_equal(no_more.reflectance, exact.reflectance)  # 3e-5 are cut


def test_a_matched_flake_is_invisible():
    found = platelet_response(Platelet(constant(PET), Thickness(300, 50)), np.full(3, PET), np.linspace(0, 1, 9), LAM)
    assert np.abs(found.reflectance).max() < 1e-12
    assert np.abs(found.transmittance - 1).max() < 1e-12


def test_the_closed_form_is_right_on_both_sides_of_the_critical_angle():
    critical = np.sqrt(1 - (1.4585 / PET) ** 2)
    cos = critical + np.array([-1e-3, -1e-6, 0.0, 1e-6, 1e-3])
    platelet = CASES["silica beyond its critical angle"]
    found = platelet_response(platelet, np.full(1, PET), cos, LAM[:1])
    r, _ = brute(platelet, cos, LAM[:1], 200)
    assert np.abs(found.reflectance - r).max() < 1e-8


def test_named_materials_reflect_as_the_docstring_says():
    platelet = Platelet(index("mica"), Thickness(560.44, 179.32), (Coating(index("TiO2"), Thickness(140)),))
    found = platelet_response(platelet, np.full(1, PET), np.array([1.0]), np.array([550.0])).unpolarised()
    assert found[0][0, 0] == pytest.approx(0.31, abs=0.005)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (dict(mean_nm=100, deviation_nm=-1), "deviation_nm"),
        (dict(mean_nm=-1), "thickness_nm"),
        (dict(mean_nm=100, deviation_nm=1, distribution="truncated", low_nm=500, high_nm=600), "hold no flake"),
        (dict(mean_nm=0, deviation_nm=1, distribution="lognormal"), "lognormal"),
        (dict(mean_nm=100, distribution="weibull"), "not known"),
    ],
)
def test_impossible_distributions_are_refused(arguments, words):
    with pytest.raises(NacreError, match=words):
        Thickness(**arguments)


def test_a_histogram_that_does_not_sum_to_one_is_refused():
    with pytest.raises(NacreError, match="sum to 0.9"):
        Thickness.from_histogram(np.array([100.0, 200.0]), np.array([0.5, 0.4]))
