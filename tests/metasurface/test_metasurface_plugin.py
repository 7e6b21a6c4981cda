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


@pytest.mark.parametrize(("fall", "words"), [(0.1, 2), (0.8, 4)])
def test_numbers_that_share_a_word_are_rounded_to_half_of_their_last_bit(trials, fall, words):
    """Also those with others below them in their word, which are a part of what is read."""
    import mitsuba as mi

    from nacre.device import packed_series

    generator = np.random.default_rng(3)
    sizes = fall ** np.arange(8.0)
    rows = (sizes[:, None] * generator.uniform(-1.0, 1.0, (200, 8, 3))).astype(np.float32)
    rows[0] = sizes[:, None] * [1.0, 0.5, 2.0]
    made = packed_series.PackedSeries([rows], 1)
    assert made.words == words
    bits = {n: count for word in packed_series._fields(sizes, words) for n, _, count in word}
    assert sum(bits.values()) == 32 * words
    largest = np.abs(rows).max(axis=0)[0]
    for node in range(3):
        numbers = made.read(mi.UInt32(3 * np.arange(200) + node), 0, True)
        for k, number in enumerate(numbers):
            got = np.array(number) * np.array(made.units[k]) * largest[node]
            last = sizes[k] * largest[node] / (2.0 ** (bits[k] - 1) - 1.0)
            reach = np.abs(rows[:, k, node]) <= sizes[k] * largest[node]  # the scale is that of the first number
            assert np.abs(got - rows[:, k, node])[reach].max() <= 0.51 * last + 3e-7 * largest[node]


def test_a_density_of_tents_is_linear_between_its_nodes_and_its_draws_follow_it(trials):
    import mitsuba as mi

    from nacre.device.tents import Tents

    generator = np.random.default_rng(4)
    weights = generator.uniform(0.2, 2.0, (2, 2, 4, 5))
    tents, part, count = Tents(weights), 0.3, 400_000
    u = [mi.Float(generator.random(count).astype(np.float32)) for _ in range(3)]
    row = mi.UInt32(np.zeros(count, dtype=np.uint32))
    face, x, y, rest = (np.array(v) for v in tents.sample(row, mi.Float(part), u[0], mi.Point2f(u[1], u[2]), True))
    # the middle of each of 2 x 12 x 12 boxes of the two faces: the density is bilinear within each
    at = (np.arange(12) + 0.5) / 12
    f, v, w = (g.ravel() for g in np.meshgrid(np.arange(2), at, at, indexing="ij"))
    low, faces = mi.UInt32(np.zeros(288, np.uint32)), mi.UInt32(f.astype(np.uint32))
    places = (mi.Float(g.astype(np.float32)) for g in (w, v))
    density = np.array(tents.density(low, mi.Float(part), faces, *places, True))
    assert density.mean() * 2 == pytest.approx(1.0, abs=1e-5)
    box = (face.astype(int) * 12 + np.minimum(y * 12, 11).astype(int)) * 12 + np.minimum(x * 12, 11).astype(int)
    expected = density / density.sum() * count
    chi = np.sum((np.bincount(box, minlength=288) - expected) ** 2 / expected)
    assert chi < 287 + 5 * np.sqrt(2 * 287)
    assert abs(rest.mean() - 0.5) < 5 / np.sqrt(12 * count)
