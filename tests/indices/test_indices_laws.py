"""Dispersion laws and effective media: Kramers-Kronig, closed forms, limits, other entries of the database."""

from __future__ import annotations

import re
import tomllib
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.core.errors import NacreError
from nacre.matter.indices.constant import constant
from nacre.matter.indices.laws import (
    BrendelBormann,
    BSpline,
    CodyLorentz,
    Gaussian,
    TaucLorentz,
    effective_permittivity,
    kramers_kronig,
)
from nacre.matter.indices.library import index, lone_axes, pair_remark, pairs_among, partners
from nacre.matter.indices.models import EV_NM, Oscillators

ENERGIES = np.array([0.8, 1.3, 1.9, 2.5, 3.7])
KRAMERS_KRONIG = 1e-3  # of the trapezoid below, whose step is two thousandths of an electronvolt
SPLINE = BSpline((1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5), (0.0, 0.2, 1.5, 4.0, 3.0, 1.0, 0.0))


@pytest.mark.parametrize(
    "term",
    [
        TaucLorentz(100.0, 4.0, 1.5, 1.6),
        TaucLorentz(10.0, 2.0, 5.0, 1.0),  # overdamped: by quadrature
        CodyLorentz(80.0, 4.0, 1.8, 1.6, 0.9, 1.9, 0.08),
        CodyLorentz(80.0, 4.0, 1.8, 1.6, 0.9, 0.0, 0.05),
        Gaussian(3.0, 2.4, 0.5),
        SPLINE,
    ],
)
def test_laws_obey_kramers_kronig(term: Any) -> None:
    """Maclaurin's rule: the sum over every second point avoids the pole (Ohta & Ishida 1988)."""
    step = 2e-3
    places = np.round(ENERGIES / step).astype(int)
    x = step * np.arange(1, 75_000)
    absorbed = getattr(term, "absorption", lambda e: term(e).imag)(x)
    for place, value in zip(places, term(places * step).real, strict=True):
        others = slice(place % 2, None, 2)
        chosen, eps2 = x[others], absorbed[others]
        expected = 2 / np.pi * 2 * step * np.sum(chosen * eps2 / (chosen**2 - (place * step) ** 2))
        assert value == pytest.approx(expected, abs=KRAMERS_KRONIG * np.abs(absorbed).max())


def test_a_narrow_brendel_bormann_oscillator_is_a_lorentz_oscillator() -> None:
    lorentz = Oscillators(1.0, 0.0, 0.0, ((1.5, 2.5, 0.2),)).permittivity(ENERGIES) - 1.0
    np.testing.assert_allclose(BrendelBormann(1.5, 2.5, 0.2, 1e-4)(ENERGIES), lorentz, rtol=1e-5)


def test_brendel_bormann_gives_the_platinum_of_rakic() -> None:
    """Rakic et al. 1998, table 2, against the entry of the database."""
    plasma = 9.59
    terms = [
        BrendelBormann(f * plasma**2 / w**2, w, g, s)
        for f, g, w, s in (
            (0.186, 0.498, 0.782, 0.031),
            (0.665, 1.851, 1.317, 0.096),
            (0.551, 2.604, 3.189, 0.766),
            (2.214, 2.891, 8.236, 1.146),
        )  # fmt: skip
    ]
    waves = np.array([400.0, 550.0, 700.0])
    free = Oscillators(1.0, np.sqrt(0.333) * plasma, 0.080).permittivity(EV_NM / waves)
    n = np.sqrt(free + sum(term(EV_NM / waves) for term in terms))
    np.testing.assert_allclose(n, index("main/Pt/Rakic-BB").n_complex(waves), rtol=2e-3)


def test_the_kramers_kronig_quadrature_gives_the_closed_form() -> None:
    term = TaucLorentz(100.0, 4.0, 1.5, 1.6)
    np.testing.assert_allclose(kramers_kronig(term.absorption, ENERGIES, (1.6, 4.0)), term(ENERGIES).real, rtol=1e-9)


@pytest.mark.parametrize("share", [0.1, 1 / 3, 0.5, 0.9])
@pytest.mark.parametrize("pair", [(6.25, 1.0), (-20 + 1j, 2.25), (-20.0, 2.25), (12 + 0.1j, 1.0)])
def test_bruggeman_is_the_physical_root_of_the_quadratic(pair: tuple[complex, complex], share: float) -> None:
    """The other root has gain as soon as the components have losses."""
    one, two = (eps + 1e-9j * abs(eps) for eps in pair)
    h = (3 * share - 1) * one + (2 - 3 * share) * two
    root = np.sqrt(h * h + 8 * one * two + 0j)
    expected = max((h + root) / 4, (h - root) / 4, key=lambda e: e.imag)
    found = effective_permittivity(np.array([[pair[0]], [pair[1]]]), (share, 1 - share), "bruggeman")[0]
    assert found == pytest.approx(expected, abs=1e-5)  # the losses of the test


@pytest.mark.parametrize("model", ["bruggeman", "maxwell-garnett"])
def test_aligned_ellipsoids_reach_wieners_bounds(model: str) -> None:
    """Needles along the field: the mean of the permittivity; plates across it: of its inverse (Wiener 1912)."""
    eps = np.array([[6.25], [1.0]])
    along = effective_permittivity(eps, (0.3, 0.7), model, (0.0,))[0]
    across = effective_permittivity(eps, (0.3, 0.7), model, (1.0,))[0]
    assert along == pytest.approx(0.3 * 6.25 + 0.7) and across == pytest.approx(1 / (0.3 / 6.25 + 0.7))


@pytest.mark.parametrize("model", ["bruggeman", "maxwell-garnett", "looyenga", "lichtenecker"])
def test_all_models_lie_between_the_bounds_and_meet_at_the_ends(model: str) -> None:
    eps = np.array([[2.25], [4.0]])
    inner = effective_permittivity(eps, (0.4, 0.6), model)[0].real
    assert 1 / (0.4 / 2.25 + 0.6 / 4.0) < inner < 0.4 * 2.25 + 0.6 * 4.0
    assert effective_permittivity(eps, (1.0, 0.0), model)[0] == pytest.approx(2.25)


def test_mixtures_nest_and_take_the_rest() -> None:
    inner = {"mix": ["SiO2", "air"], "volume_fractions": [0.5]}
    found = index({"mix": ["TiO2", inner], "volume_fractions": [0.2, 0.8], "model": "looyenga"}).n_complex([550.0])
    air, silica, titania = (index(name).n_complex([550.0]) ** 2 for name in ("air", "SiO2", "TiO2"))
    porous = effective_permittivity(np.stack([silica, air]), (0.5, 0.5), "bruggeman")
    expected = (0.2 * titania ** (1 / 3) + 0.8 * porous ** (1 / 3)) ** 3
    np.testing.assert_allclose(found**2, expected, rtol=1e-12)


def test_an_urbach_edge_stands_beside_a_formula() -> None:
    urbach = {"amplitude": 0.1, "energy_ev": 0.2, "edge_ev": 3.0}
    found = index({"cauchy": [1.5], "urbach": urbach}).n_complex([EV_NM / 3.0, EV_NM / 2.8])
    np.testing.assert_allclose(found, [1.5 + 0.1j, 1.5 + 0.1j / np.e], rtol=1e-12)


def test_a_cody_lorentz_band_absorbs_above_its_gap_alone() -> None:
    band = {"amplitude_ev": 60.0, "resonance_ev": 4.0, "damping_ev": 1.8}
    keys = {"gap_ev": 2.0, "transition_ev": 1.0, "oscillators": [band], "eps_inf": 1.5}
    found = index({"cody_lorentz": keys}).n_complex(EV_NM / np.array([3.5, 2.5, 1.9, 1.6])).imag
    assert found[0] > found[1] > 0.0
    np.testing.assert_allclose(found[2:], 0.0, atol=1e-12)


def test_terms_add_to_one_permittivity() -> None:
    peak = {"oscillators": [{"amplitude": 0.5, "resonance_ev": 2.2, "width_ev": 0.3}]}
    found = index({"gaussian": peak, "drude": {"plasma_ev": 2.0, "eps_inf": 3.0}}).n_complex([550.0]) ** 2
    energy = np.array([EV_NM / 550.0])
    expected = Oscillators(3.0, 2.0).permittivity(energy) + Gaussian(0.5, 2.2, 0.3)(energy)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize(
    "table",
    [
        {"n": 1.5, "model": "bruggeman"},
        {"mix": ["SiO2", "air"], "volume_fractions": [0.5, 0.5], "depolarisation": [0.2, 0.2, 0.2]},
        {"mix": ["SiO2", "air"], "volume_fractions": [0.5, 0.5], "model": "looyenga", "depolarisation": 0.5},
        {"file": "x.csv", "urbach": {"amplitude": 0.1, "energy_ev": 0.2, "edge_ev": 3.0}},
        {"b_spline": {"knots_ev": [1.5, 1.4, 2.0, 3.0], "values": [0, 1, 1, 0]}},
        {"b_spline": {"knots_ev": [0.5, 1.5, 2.0, 3.0], "values": [0, 1, 1, 0]}},
        {"gaussian": {"eps_inf": 2, "oscillators": [{"amplitude": 1, "resonance_ev": 2, "width_ev": 1}]},
         "drude": {"plasma_ev": 2.0, "eps_inf": 3.0}},
    ],
)  # fmt: skip
def test_impossible_laws_are_refused(table: dict[str, Any]) -> None:
    with pytest.raises(NacreError):
        index(table)


def test_axes_of_crystals_find_their_partners() -> None:
    assert partners("main/CaCO3/Ghosh-o") == {"o": "main/CaCO3/Ghosh-o", "e": "main/CaCO3/Ghosh-e"}
    assert partners("5CB-e") == {"o": "5CB-o", "e": "5CB-e"}
    assert not partners("TiO2") and not partners("main/Ag/Johnson")
    assert len(pairs_among(["calcite-o", "calcite-e", "Ag"])) == 1
    pair = {"ordinary": "calcite-o", "extraordinary": "calcite-e"}
    assert not lone_axes({"layers": [{"material": pair}]})
    assert len(lone_axes({"layers": [{"material": "calcite-o"}]})) == 1


@pytest.mark.parametrize("name", ["calcite-o", "main/CaCO3/Ghosh-e"])
def test_remarks_state_crystals_that_can_be_read(name: str) -> None:
    (table,) = re.findall(r"\{.*\}", pair_remark(name))
    made = tomllib.loads(f"material = {table}")["material"]
    assert name in made.values()
    layer = {"material": made, "thickness_nm": 100}
    assert nacre.material({"family": "film", "substrate": "Si", "layers": [layer]}).model.is_anisotropic


def test_a_constant_has_no_pair() -> None:
    assert constant(1.5).name and not partners("glass")
