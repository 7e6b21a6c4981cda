"""The harmonic lobe on the device: the questions that every lobe is asked."""

import dataclasses
from functools import cache

import numpy as np
import pytest

from nacre.bsdf import Bsdf
from nacre.materials.material import material

pytestmark = pytest.mark.render

ARRAY_BAR = 1e-4
CHI_SQUARE_LEVEL = 0.01
FURNACE_TOP = 1.002
CASES = {
    "opaque": ({"substrate": "Si", "layers": [{"material": "SiO2", "thickness_nm": 200}]}, {}, 1.0),
    "on glass": ({"substrate": "glass"}, {}, 1.5),
    "free, spread radii": ({"substrate": "air"}, {"deviation_nm": 6}, 1.0),
}


@cache
def lobe(name):
    stack, particle, _ = CASES[name]
    data = {
        "family": "metasurface",
        **stack,
        "particle": {"material": {"n": 3.5, "k": 0.02}, "radius_nm": 65, **particle},
        "monolayer": {"coverage": 0.1, "packing": 0.4},
        "model": {"multipole_order": 4, "correction": "qca-balanced"},
    }
    made = material(data).bsdf(np.array([400.0, 480.0, 560.0, 640.0, 720.0]))
    return Bsdf((made.lobes[1],))


@pytest.fixture(scope="module")
def trials():
    from nacre.render import use_variant

    use_variant("llvm_ad_spectral")
    import lobe_trials as testing

    return testing


@pytest.mark.parametrize("name", CASES)
def test_device_and_arrays_agree(trials, name):
    both = lobe(name).transmits
    a, b = trials.directions(3000, 1, both), trials.directions(3000, 2, both)
    assert trials.array_mismatch(lobe(name), a, b) <= ARRAY_BAR
    assert trials.reciprocity_mismatch(lobe(name), a, b, CASES[name][2]) <= ARRAY_BAR


@pytest.mark.parametrize("name", CASES)
def test_directions_are_drawn_as_their_density_says(trials, name):
    views = [(25.0, 40.0), (72.0, 200.0)]
    if lobe(name).transmits:
        views += [(160.0, 10.0), (118.0, 100.0)]
    for view in views:
        assert trials.chi_square(lobe(name), *view, samples=400_000).passes(CHI_SQUARE_LEVEL, 10), view
        draws = trials.draw(lobe(name), trials.direction(*view), 20_000)
        assert trials.weight_mismatch(draws) <= 2e-3
        mean, error = trials.furnace(lobe(name), view[0], n=50_000)
        assert np.all(mean - 3 * error <= FURNACE_TOP) and np.all(mean > 0)


def test_the_device_is_linear_between_wavelengths(trials):
    """H is interpolated as the arrays would be, S is exact: so with one S for all, f is linear too."""
    made = lobe("free, spread radii").lobes[0]
    flat = dataclasses.replace(made, structure=np.ones_like(made.structure))
    a, b = trials.directions(500, 1, True), trials.directions(500, 2, True)
    at, grid = np.array([400.0, 433.0, 541.5, 715.0]), made.wavelengths_nm
    nodes = flat.evaluate(a.astype(np.float32), b.astype(np.float32))
    expected = np.stack([[np.interp(w, grid, row) for w in at] for row in nodes])
    got = trials.plugin_values(Bsdf((flat,)), a, b, at)
    assert np.max(np.abs(got - expected)) <= ARRAY_BAR * expected.max()


def test_the_device_takes_one_wavelength_and_more_than_eight_harmonics(trials):
    made = lobe("opaque").lobes[0]
    widened = np.concatenate([made.above, 0.03 * made.above[:, ::-1]], axis=1)
    for changed in (
        dataclasses.replace(made, above=widened, below=widened[:0], across=widened[:0], above_free=widened[:0]),
        _at_one_wavelength(made),
    ):
        a, b = trials.directions(300, 1, False), trials.directions(300, 2, False)
        assert trials.array_mismatch(Bsdf((changed,)), a, b) <= ARRAY_BAR


def _at_one_wavelength(made):
    tables = {n: getattr(made, n)[..., 2:3] for n in ("above", "below", "across", "above_free", "below_free")}
    numbers = {n: getattr(made, n)[2:3] for n in ("wavelengths_nm", "wavenumbers", "index_below")}
    return dataclasses.replace(made, across_free=made.across_free[..., 2:3], **tables, **numbers)


def test_a_matt_lobe_is_drawn_by_the_cosine_and_all_its_draws_weigh_the_same(trials):
    made = lobe("opaque").lobes[0]
    matt = np.zeros_like(made.above)
    matt[:, 0] = 0.1
    flat = Bsdf((dataclasses.replace(made, above=matt, structure=np.ones_like(made.structure)),))
    draws = trials.draw(flat, trials.direction(50.0, 20.0), 5000)
    weights = draws.weight[draws.pdf > 0]
    assert np.ptp(weights) <= 1e-3 * weights.mean()
    assert trials.chi_square(flat, 50.0, 20.0, samples=200_000).passes(CHI_SQUARE_LEVEL, 1)
