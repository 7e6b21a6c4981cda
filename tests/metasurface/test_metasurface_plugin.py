"""The harmonic lobe on the device: the questions that every lobe is asked."""

import dataclasses
from functools import cache

import numpy as np
import pytest

from nacre.bsdf import Bsdf
from nacre.bsdf.lobes.monolayer import ROUNDING, PolarGrid, encode
from nacre.material.material import material

pytestmark = pytest.mark.render

ARRAY_BAR = 1e-4
CHI_SQUARE_LEVEL = 0.01
FURNACE_TOP = 1.002
CASES = {
    "opaque": ({"substrate": "Si", "layers": [{"material": "SiO2", "thickness_nm": 200}]}, {}, 1.0),
    "on glass": ({"substrate": "glass"}, {}, 1.5),
    "free, spread radii": ({"substrate": "air"}, {"deviation_nm": 6}, 1.0),
}


def rounded(tables):
    """Return tables with the numbers that their words on the device can hold; empty ones stay empty."""
    if not any(table.shape[0] for table in tables):
        return tables
    rows = np.concatenate(tables)
    for _ in range(6):
        before, rows = rows, encode(rows).numbers()[:, : rows.shape[1]].astype(np.float32)
        if np.allclose(before, rows, rtol=1e-6, atol=1e-7 * np.abs(rows).max()):
            break  # rounding a row may bring it below the next power, or a largest number below the next size
    return [np.ascontiguousarray(t) for t in np.split(rows, np.cumsum([len(t) for t in tables])[:-1])]


@cache
def lobe(name):
    """As the device holds it: so what it reads should be what the arrays say."""
    made = exact_lobe(name)
    return Bsdf((dataclasses.replace(made, **_rounded_tables(made)),))


def _rounded_tables(made, wavelengths=slice(None)):
    names = ("above", "below", "across", "above_free", "below_free", "across_free")
    groups = [rounded([getattr(made, n)[..., wavelengths] for n in group]) for group in (names[:3], names[3:])]
    return dict(zip(names, groups[0] + groups[1], strict=True))


@cache
def exact_lobe(name):
    stack, particle, _ = CASES[name]
    data = {
        "family": "metasurface",
        **stack,
        "particle": {"material": {"n": 3.5, "k": 0.02}, "radius_nm": 65, **particle},
        "monolayer": {"coverage": 0.1, "packing": 0.4},
        "model": {"multipole_order": 4, "correction": "qca-balanced"},
    }
    made = material(data).bsdf(np.array([400.0, 480.0, 560.0, 640.0, 720.0]))
    return made.lobes[1]


@pytest.fixture(scope="module")
def trials():
    from tested_variant import use_tested_variant

    use_tested_variant()
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


def test_the_device_interpolates_on_tetrahedra_of_both_angles_and_the_wavelength(trials):
    """H at the corners as the arrays have it, S exact: so with one S for all, f is the sum over four corners."""
    made = lobe("free, spread radii").lobes[0]
    flat = dataclasses.replace(made, structure=np.ones_like(made.structure))
    at, grid = np.array([400.0, 433.0, 541.5, 715.0]), made.wavelengths_nm
    nodes = PolarGrid(made.count_above).nodes
    a, b = (trials.directions(500, seed, True) for seed in (1, 2))
    inside = np.minimum(np.abs(a[:, 2]), np.abs(b[:, 2])) > np.cos(nodes[-1])  # beyond, f falls as the cosine
    a, b = a[inside].astype(np.float32), b[inside].astype(np.float32)
    place = np.stack([np.interp(np.arccos(np.abs(w[:, 2])), nodes, np.arange(len(nodes))) for w in (a, b)], axis=1)

    def at_nodes(w, node):
        up = np.where(w[:, 2] > 0.0, 1.0, -1.0)
        flat_part = w[:, :2] / np.hypot(w[:, 0], w[:, 1])[:, None] * np.sin(nodes[node])[:, None]
        return np.column_stack([flat_part, up * np.cos(nodes[node])])

    expected = []
    for wavelength in at:
        x = np.column_stack([place, np.full(len(a), np.interp(wavelength, grid, np.arange(len(grid))))])
        corner = np.minimum(np.floor(x).astype(int), [len(nodes) - 2, len(nodes) - 2, len(grid) - 2])
        part = x - corner
        order = np.argsort(-part, axis=1)
        falling = np.column_stack([np.ones(len(a)), np.take_along_axis(part, order, axis=1), np.zeros(len(a))])
        total = np.zeros(len(a))
        for step in range(4):
            values = flat.evaluate(at_nodes(a, corner[:, 0]), at_nodes(b, corner[:, 1]))
            total += (falling[:, step] - falling[:, step + 1]) * values[np.arange(len(a)), corner[:, 2]]
            if step < 3:
                corner[np.arange(len(a)), order[:, step]] += 1
        expected.append(total)
    got = trials.plugin_values(Bsdf((flat,)), a, b, at)
    assert np.max(np.abs(got - np.stack(expected, axis=1))) <= ARRAY_BAR * np.max(expected)


def test_lines_between_fitted_nodes_follow_a_smooth_table_better_than_through_it():
    """And leave next to nothing in the mean: the second differences are those of the angles, not of something else."""
    from nacre.families.metasurface.monolayer.evaluation import Grids, fit_linear

    def table(count):
        theta = PolarGrid(count).nodes
        first = (
            np.cos(theta)[:, None] * np.cos(theta) * (1.0 + 0.5 * np.cos(6.0 * theta[:, None]) * np.cos(6.0 * theta))
        )
        second = 0.4 * np.sin(2 * theta)[:, None] * np.sin(2 * theta)
        return np.stack([first, second], axis=-1)

    coarse, grids = table(25), Grids(PolarGrid(25), None)
    fitted = fit_linear(coarse, grids)
    assert np.array_equal(fitted[0, :, 1], coarse[0, :, 1])  # at the normal nothing depends on the azimuth
    generator = np.random.default_rng(6)
    x = generator.uniform(0.0, 23.0, (2, 4000))
    angle = x / 24.5 * np.pi / 2
    exact = [
        np.cos(angle[0]) * np.cos(angle[1]) * (1.0 + 0.5 * np.cos(6.0 * angle[0]) * np.cos(6.0 * angle[1])),
        0.4 * np.sin(2 * angle[0]) * np.sin(2 * angle[1]),
    ]
    low = np.floor(x).astype(int)
    part = x - low
    step = np.where(part[0] > part[1], [[1], [0]], [[0], [1]])

    def error(values):
        corners = ((low, 1 - part.max(axis=0)), (low + step, np.ptp(part, axis=0)), (low + 1, part.min(axis=0)))
        found = sum(values[tuple(at)] * weight[:, None] for at, weight in corners)
        wrong = found - np.stack(exact, axis=-1)
        return np.sqrt(np.mean(wrong**2, axis=0)), np.abs(wrong.mean(axis=0))

    through, along = error(coarse), error(fitted)
    assert np.all(along[0] <= 0.5 * through[0]), (along, through)  # 0.4 for a parabola, and two edges
    assert np.all(along[1] <= 0.1 * through[1] + 0.01 * through[0]), (along, through)


def test_the_device_takes_one_wavelength_and_more_than_eight_harmonics(trials):
    made = lobe("opaque").lobes[0]
    (widened,) = rounded([np.concatenate([made.above, 0.03 * made.above[:, ::-1]], axis=1)])
    for changed in (
        dataclasses.replace(made, above=widened, below=widened[:0], across=widened[:0], above_free=widened[:0]),
        _at_one_wavelength(made),
    ):
        a, b = trials.directions(300, 1, False), trials.directions(300, 2, False)
        assert trials.array_mismatch(Bsdf((changed,)), a, b) <= ARRAY_BAR


def _at_one_wavelength(made):
    numbers = {n: getattr(made, n)[2:3] for n in ("wavelengths_nm", "wavenumbers", "index_below")}
    return dataclasses.replace(made, **_rounded_tables(made, slice(2, 3)), **numbers)


@pytest.mark.parametrize("name", CASES)
def test_what_a_render_reads_is_rounded_by_no_more_than_its_words_promise(trials, name):
    made = Bsdf((exact_lobe(name),))
    a, b = trials.directions(3000, 3, made.transmits), trials.directions(3000, 4, made.transmits)
    a, b = a.astype(np.float32).astype(float), b.astype(np.float32).astype(float)
    expected = made.evaluate(a, b)
    wrong = trials.plugin_values(made, a, b, made.wavelengths_nm) - expected
    assert np.all(np.sqrt(np.mean(wrong**2, axis=0)) <= ROUNDING * np.sqrt(np.mean(expected**2, axis=0)))


def test_a_matt_lobe_is_drawn_by_the_cosine_and_all_its_draws_weigh_the_same(trials):
    made = lobe("opaque").lobes[0]
    matt = np.zeros_like(made.above)
    matt[:, 0] = 0.1
    flat = Bsdf((dataclasses.replace(made, above=matt, structure=np.ones_like(made.structure)),))
    draws = trials.draw(flat, trials.direction(50.0, 20.0), 5000)
    weights = draws.weight[draws.pdf > 0]
    assert np.ptp(weights) <= 1e-3 * weights.mean()
    assert trials.chi_square(flat, 50.0, 20.0, samples=200_000).passes(CHI_SQUARE_LEVEL, 1)


@pytest.mark.parametrize(("fall", "words"), [(0.3, 2), (0.95, 4)])
def test_numbers_that_share_a_word_are_rounded_to_half_of_their_last_bit(trials, fall, words):
    """Also those with others below them in their word, which are a part of what is read; dark rows as finely."""
    import mitsuba as mi

    from nacre.device.lobes.monolayer import PackedSeries

    generator = np.random.default_rng(3)
    sizes = fall ** np.arange(8.0)
    light = 2.0 ** -generator.integers(0, 8, (200, 1, 3))
    rows = (sizes[:, None] * light * generator.uniform(-1.0, 1.0, (200, 8, 3))).astype(np.float32)
    wanted = encode(rows)
    made = PackedSeries(rows, 1)
    assert made.words == words == wanted.words.shape[3]
    bits = np.array([count for _, _, count in wanted.fields])
    assert bits.sum() == 32 * words - 4  # a power of two takes the others
    scaled = np.abs(rows) / 2.0 ** np.ceil(np.log2(np.abs(rows).max(axis=1, keepdims=True)))
    for node in range(3):
        numbers, factor = made.read(mi.UInt32(3 * np.arange(200) + node), 0, True)
        for k, number in enumerate(numbers):
            last = made.units[k][0] * 2.0 ** (32 - bits[k])
            top = 2.0 ** (bits[k] - 1) - 1.0
            # a field is as long as the largest of its numbers needs, to the next eighth of a factor of two
            assert scaled[:, k].max() <= last * top * (1 + 1e-6) <= scaled[:, k].max() * 2.0**0.125 * (1 + 1e-6)
            wrong = np.abs(np.array(number) * np.array(made.units[k]) - rows[:, k, node] / np.array(factor)) / last
            full = np.abs(rows[:, k, node]) / np.array(factor) > last * (top - 1.0)
            rounding = 2e-6 * np.abs(rows[:, k, node]).max() / last  # of single precision
            assert np.all(wrong[~full] <= 0.5 + rounding), k
            assert np.all(wrong <= 1.0 + rounding), k  # at its top, a field has no way up
            got = np.array(number) * np.array(factor) * np.array(made.units[k])
            assert np.allclose(got, wanted.numbers()[:, k, node], rtol=1e-6, atol=1e-9)


def test_what_was_rounded_for_its_words_is_rounded_no_more():
    """So the arrays say what the device reads, and a root mean square of the error is what the words promise."""
    generator = np.random.default_rng(8)
    sizes = 0.4 ** np.arange(8.0)
    light = 10.0 ** generator.uniform(-3.0, 0.0, (300, 1, 5))
    tables = [
        (sizes[:, None] * light * generator.uniform(-1.0, 1.0, (300, 8, 5))).astype(np.float32),
        np.zeros((0, 8, 5)),
    ]
    once = rounded(tables)
    twice = rounded(once)
    assert once[1].shape == (0, 8, 5)
    assert np.abs(twice[0] - once[0]).max() <= 1e-6 * np.abs(once[0]).max()
    wrong = np.sqrt(np.sum((once[0] - tables[0]) ** 2, axis=(1,)) / np.sum(tables[0] ** 2, axis=1))
    assert 1e-5 < np.sqrt(np.mean(wrong**2)) <= 3e-3  # a dark row as a bright one


def test_a_density_of_tents_is_linear_between_its_nodes_and_its_draws_follow_it(trials):
    import mitsuba as mi

    from nacre.device.lobes.monolayer import BilinearDensity

    generator = np.random.default_rng(4)
    weights = generator.uniform(0.2, 2.0, (2, 2, 4, 5))
    tents, part, count = BilinearDensity(weights), 0.3, 400_000
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
