"""Glints: single flakes that are seen leave the mean as it was, are alike on both routes, and stay where they lie."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.bsdf import Bsdf
from nacre.bsdf.glints import COVERAGE, SEED, WIDTH, factors, glint_species, mean_ratio
from nacre.bsdf.lobes.layered import Layered
from nacre.bsdf.lobes.platelet_layer import PlateletLayer
from nacre.core.errors import RecipeError
from nacre.families.pearl import tables as pearl_tables
from nacre.families.pearl.flake_texture import Glints, glint_arrays
from nacre.material.material import material

LAM = np.array([450.0, 550.0, 650.0, 700.0])
FLAKE = {
    "volume_fraction": 0.02,
    "substrate": {"material": "Al", "thickness_nm": 300},
    "coatings": [{"material": "SiO2", "thickness_nm": 380}],
    "normal_deviation": 0.12,
    "diameter_um": 40,
}
PAINT = {
    "family": "pearl",
    "strata": [{"resin": {"n": 1.5}, "thickness_um": 40, "platelets": [FLAKE]}],
    "base": {"albedo": 0.03},
    "glints": {"surface_mm": 60, "flatness_deg": 2.0},
}
WI = np.array([0.3, 0.1, np.sqrt(1 - 0.1)])
WO = np.array([-0.25, -0.05, np.sqrt(1 - 0.065)])


def pair(count: int) -> tuple[np.ndarray, np.ndarray]:
    """The two directions, once a place."""
    return np.tile(WI, (count, 1)), np.tile(WO, (count, 1))


def tables_of(recipe: dict[str, Any]) -> PlateletLayer:
    """Return the tables of a third of the walks, which suffices for glints."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("WALKS", "BASE_WALKS", "SINGLES", "PRODUCTS", "CHECK_WALKS", "CHECK_SINGLES"):
            patch.setattr(pearl_tables, name, getattr(pearl_tables, name) // 3)
        found = material({**recipe, "quality": "fast"}).bsdf(LAM).lobes[0]
    assert isinstance(found, PlateletLayer)
    return found


@pytest.fixture(scope="module")
def fast() -> PlateletLayer:
    return tables_of(PAINT)


@pytest.fixture(scope="module")
def walk() -> Layered:
    found = material(PAINT).bsdf(LAM).lobes[0]
    assert isinstance(found, Layered)
    return found


# -- the factor ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("width", "slope"), [(0.05, (0.6, -0.3)), (0.2, (0.0, 0.0)), (1.0, (0.6, -0.3))])
def test_the_mean_over_the_surface_is_one(width: float, slope: tuple[float, float]) -> None:
    """Ten layings of many points: within 3.5 standard errors, and 1 %, which those are below."""
    points = int(8_000 / width)
    means = []
    for seed in range(10):
        made = glint_species((100.0, 100.0), 40.0, 0.3, 1.2, width, seed)
        uv = np.random.default_rng(seed).random((points, 2))
        means.append(factors(*made, uv, np.tile(slope, (points, 1))).mean())
    error = np.std(means, ddof=1) / np.sqrt(len(means))
    assert abs(np.mean(means) - 1) < 3.5 * error
    assert abs(np.mean(means) - 1) < 0.01 + 2 * error


def test_the_variance_is_that_of_the_flakes_that_answer() -> None:
    """Place and slope are independent, flakes at a point about Poisson: var g = E[k^2] / (E[k]^2 seen)."""
    points, width, seen = 2_000_000, 0.3, 0.8
    numbers, radii, ratio = glint_species((300.0, 300.0), 40.0, 0.0, seen, width, 5)
    g = factors(numbers, radii, ratio, np.random.default_rng(1).random((points, 2)), np.zeros((points, 2)))
    # moments of the kernel over the flakes' slopes, by quadrature over the share u = t^2 / (1 + t^2)
    t2 = (np.arange(200_000) + 0.5) / 200_000
    t2 = t2 / (1 - t2)
    first, second = np.mean(np.exp(-0.5 * t2 / width**2)), np.mean(np.exp(-t2 / width**2))
    expected = second / (first**2 * seen)
    assert g.var() == pytest.approx(expected, rel=0.15)


def test_the_grain_falls_with_the_footprint_and_grows_with_the_flakes() -> None:
    rng = np.random.default_rng(2)

    def grain(diameter_um: float, footprint_mm: float) -> float:
        made = glint_species((100.0, 100.0), diameter_um, 0.2, 1.0, 0.2, 3)
        grid = np.stack(np.meshgrid(*[np.arange(40) / 40] * 2), axis=-1).reshape(-1, 2)
        uv = rng.random((800, 1, 2)) + grid * footprint_mm / 100.0
        g = factors(*made, uv.reshape(-1, 2), np.zeros((uv.shape[0] * uv.shape[1], 2))).reshape(800, -1)
        return float(g.mean(axis=1).var())

    small, large = grain(30.0, 0.3), grain(30.0, 0.6)
    assert 2.5 < small / large < 5.5  # four times the area, one quarter of the variance
    assert 2.5 < grain(60.0, 0.6) / large < 5.5
    assert grain(60.0, 0.6) == pytest.approx(small, rel=0.35)  # only the ratio of the two lengths matters


def test_the_mean_of_a_narrow_kernel_is_the_density_and_of_a_wide_one_is_flatter() -> None:
    np.testing.assert_allclose(mean_ratio(0.01), 1.0, atol=1e-3)
    wide = mean_ratio(0.5)
    assert wide[0] < 0.7 and wide[40] > 1.0 and wide[-1] == 1.0


# -- in a material -------------------------------------------------------------------------------------------


def test_without_a_place_the_answer_is_the_mean(fast: PlateletLayer) -> None:
    smooth = dataclasses.replace(fast, glint_numbers=None)
    np.testing.assert_array_equal(fast.evaluate(WI, WO), smooth.evaluate(WI, WO, uv=np.array([0.3, 0.3])))
    uv = np.random.default_rng(4).random((200_000, 2))
    values = fast.evaluate(*pair(len(uv)), uv)
    error = values.std(axis=0) / np.sqrt(len(uv))
    assert np.all(np.abs(values.mean(axis=0) - fast.evaluate(WI, WO)) < 4 * error)
    assert np.all(values.std(axis=0) > 0.5 * values.mean(axis=0))


def test_glints_are_reciprocal_and_leave_no_value_below_zero(fast: PlateletLayer) -> None:
    rng = np.random.default_rng(6)
    directions = rng.normal(size=(2, 4000, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    directions[..., 2] = np.abs(directions[..., 2])
    uv = rng.random((4000, 2))
    there, back = fast.evaluate(*directions, uv), fast.evaluate(*directions[::-1], uv)
    assert np.all(there >= 0)
    np.testing.assert_allclose(there, back, rtol=1e-9)


def test_a_flake_is_the_same_from_whichever_cell_it_is_looked_for() -> None:
    """Cells are looked up four at a time; where the four change, no flake appears or goes."""
    numbers, radii, ratio = glint_species((10.0, 10.0), 40.0, 0.3, 2.5, 0.4, 7)
    rng = np.random.default_rng(11)
    cells = numbers[:2]
    for axis in (0, 1):
        at = rng.random((4000, 2))
        at[:, axis] = (np.round(at[:, axis] * cells[axis]) + 0.5) / cells[axis]
        ends = [at + side * 1e-10 * np.eye(2)[axis] for side in (-1, 1)]
        seen = [factors(numbers, radii, ratio, np.ascontiguousarray(uv), np.zeros_like(uv)) for uv in ends]
        assert seen[0].std() > 0.1
        assert np.mean(np.abs(seen[0] - seen[1]) > 1e-9) < 1e-3


def test_seed_and_place_alone_decide(fast: PlateletLayer) -> None:
    uv = np.random.default_rng(7).random((500, 2))
    other = material({**PAINT, "glints": {**PAINT["glints"], "seed": 9}}).bsdf(LAM).lobes[0]
    again = dataclasses.replace(fast, glint_numbers=other.glint_numbers)
    assert np.array_equal(fast.evaluate(*pair(len(uv)), uv), fast.evaluate(*pair(len(uv)), uv))
    assert not np.array_equal(fast.evaluate(*pair(len(uv)), uv), again.evaluate(*pair(len(uv)), uv))


def test_each_seed_and_each_pigment_has_flakes_of_its_own() -> None:
    strata = [{**PAINT["strata"][0], "platelets": [FLAKE, {**FLAKE, "diameter_um": 60}]}]
    stratum = material({**PAINT, "strata": strata}).model.strata[0]
    seeds = [
        glint_arrays(Glints((60.0, 60.0), seed=seed), stratum, 1.5, np.ones(2), np.ones(2))[0][:, SEED]
        for seed in (0, 1, 25, 1000, 2**24 - 1)
    ]
    assert np.unique(seeds).size == 10


def test_more_of_a_thin_layer_is_seen_and_roughness_widens_a_flake() -> None:
    def numbers(**stratum: object) -> np.ndarray:
        made = material({**PAINT, "strata": [{**PAINT["strata"][0], **stratum}]}).bsdf(LAM).lobes[0]
        assert made.glint_numbers is not None
        return made.glint_numbers[0]

    thin, thick = numbers(thickness_um=5), numbers(thickness_um=200)
    # of opaque flakes half a layer at most returns light both ways
    assert thin[COVERAGE] < thick[COVERAGE] < 0.75
    assert numbers(roughness=0.2)[WIDTH] > 1.5 * numbers()[WIDTH]


def test_a_stored_material_keeps_its_glints(fast: PlateletLayer, tmp_path: Path) -> None:
    Bsdf((fast,)).save(tmp_path / "paint.nacre")
    stored = Bsdf.load(tmp_path / "paint.nacre").lobes[0]
    uv = np.random.default_rng(8).random((50, 2))
    np.testing.assert_allclose(stored.evaluate(*pair(len(uv)), uv), fast.evaluate(*pair(len(uv)), uv), rtol=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"glints": {"surface_mm": 0}}, "surface_mm"),
        ({"glints": {"surface_mm": [10, -1]}}, "surface_mm"),
        ({"glints": {"surface_mm": 10, "diameter_spread": 2}}, "diameter_spread"),
        ({"glints": {"surface_mm": 10, "flatness_deg": 0}}, "flatness_deg"),
        ({"glints": {"surface_mm": 10, "seed": -1}}, "seed"),
        ({"glints": {}}, "surface_mm"),
        ({"strata": [{"resin": {"n": 1.5}, "thickness_um": 40}]}, "no platelets"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(change: dict[str, object], message: str) -> None:
    with pytest.raises(RecipeError, match=message) as caught:
        material({**PAINT, **change})
    assert "\n" not in str(caught.value)


def test_a_lobe_of_glints_whose_tables_do_not_fit_is_refused(fast: PlateletLayer) -> None:
    fast.check()
    for single in (None, np.zeros((2, 2, 2, len(LAM)))):
        with pytest.raises(ValueError, match="single does not fit"):
            dataclasses.replace(fast, single=single).check()
    few = np.ones((2, len(LAM)))
    dataclasses.replace(fast, base=few).check()  # two nodes are a table
    with pytest.raises(ValueError, match="base has the shape"):
        dataclasses.replace(fast, base=few[:1]).check()


def test_a_lobe_has_a_roughness_from_zero_to_one(fast: PlateletLayer) -> None:
    for alpha in (0.0, 1.0):
        dataclasses.replace(fast, alpha=alpha).check()
    for alpha in (-1e-9, 1.0 + 1e-9):
        with pytest.raises(ValueError, match="out of range"):
            dataclasses.replace(fast, alpha=alpha).check()


def test_the_lobe_of_one_flake_is_stated_relative_to_the_deviation_of_all_flakes(fast: PlateletLayer) -> None:
    """Flatness of 2 degrees and diffraction at a disc of 40 um in a resin of 1.5, over a deviation of 0.12."""
    # half of the half width, 0.51 lambda / diameter, of a disc's diffraction, as a deviation of a Gaussian
    diffraction = 0.51 / 2 / np.sqrt(2 * np.log(2)) * 0.55 / (1.5 * 40.0)
    own = np.hypot(np.tan(np.radians(2.0)), diffraction)
    assert fast.glint_numbers is not None
    assert fast.glint_numbers[0, WIDTH] == pytest.approx(own / 0.12, rel=1e-4)


def test_a_flake_without_a_diameter_is_named() -> None:
    bare = {k: v for k, v in FLAKE.items() if k != "diameter_um"}
    strata = [{**PAINT["strata"][0], "platelets": [FLAKE, bare]}]
    with pytest.raises(RecipeError, match=r"strata\[0\].platelets\[1\].diameter_um is missing"):
        material({**PAINT, "strata": strata})


# -- on the device -------------------------------------------------------------------------------------------


@pytest.mark.render
def test_the_device_lays_the_same_flakes(fast: PlateletLayer, mi) -> None:  # type: ignore[no-untyped-def]
    import drjit as dr

    from nacre.device.bsdf import make_plugin

    count = 20_000
    uv = np.random.default_rng(9).random((count, 2)) * 2.0 - 0.5
    plugin = make_plugin(fast)
    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.wi, si.wavelengths = mi.Vector3f(*WI.tolist()), mi.Spectrum(550.0)
    si.uv = mi.Point2f(uv.T.astype(np.float32))
    value, _ = plugin.eval_pdf(mi.BSDFContext(), si, mi.Vector3f(*WO.tolist()), mi.Bool(True), (True, True))
    exact = fast.evaluate(*pair(count), uv.astype(np.float32))[:, 1] * WO[2]
    found = np.array(value)[0]
    # in single precision a point may lie on the other side of a disc's rim
    off = np.abs(found - exact) > 1e-3 * exact.max()
    assert off.mean() < 1e-3
    np.testing.assert_allclose(found[~off], exact[~off], atol=1e-3 * exact.max())


@pytest.mark.render
def test_where_flakes_are_not_seen_apart_a_lobe_is_the_one_without_glints(fast: PlateletLayer, mi) -> None:  # type: ignore[no-untyped-def]
    """Values, densities and draws of what falls by way of a matt ground, beside those of a lobe that has no glints."""
    import drjit as dr

    from nacre.device.bsdf import make_plugin
    from nacre.device.facet_distributions import without_glints

    count, generator = 4_000, np.random.default_rng(15)
    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.wi, si.wavelengths = mi.Vector3f(*WI.tolist()), mi.Spectrum(550.0)
    si.uv = mi.Point2f(generator.random((2, count)).astype(np.float32))
    one, two = mi.Float(generator.random(count)), mi.Point2f(generator.random((2, count)).astype(np.float32))
    found = []
    for glints, asked in ((True, True), (False, False), (True, False)):
        none = {} if glints else {"glint_numbers": None, "glint_radii": None, "glint_ratio": None}
        plugin, enabled = make_plugin(dataclasses.replace(fast, **none)), (True, True)
        here = without_glints(si, mi.Bool(asked))
        value, pdf = plugin.eval_pdf(mi.BSDFContext(), here, mi.Vector3f(*WO.tolist()), mi.Bool(True), enabled)
        bs, weight = plugin.sample(mi.BSDFContext(), here, one, two, mi.Bool(True), enabled)
        found.append([np.array(a + dr.zeros(mi.Float, count)) for a in (value[0], pdf, bs.wo.x, weight[0])])
    for name, mean, plain, sparkling in zip(("value", "pdf", "wo", "weight"), *found, strict=True):
        np.testing.assert_allclose(mean, plain, rtol=1e-4, atol=1e-5 * np.abs(plain).max(), err_msg=name)
        assert np.abs(sparkling - plain).max() > 0.1 * np.abs(plain).max()  # else it is no test


@pytest.mark.render
def test_the_walk_sees_the_same_flakes_as_the_fast_route(fast: PlateletLayer, walk: Layered) -> None:
    from nacre.device.walk.arrays import evaluate_layered

    uv = np.random.default_rng(10).random((600, 2))
    exact = fast.evaluate(*pair(len(uv)), uv)
    order = np.argsort(exact[:, 1])
    pick = order[[0, 200, 400, 500, 560, 590, 599]]
    value, error = evaluate_layered(walk, *pair(len(pick)), samples=40_000, uv=uv[pick])
    assert np.all(np.abs(value - exact[pick]) < 4 * error + 0.002 * exact.mean(axis=0))
    mean, mean_error = evaluate_layered(walk, WI, WO, samples=40_000)
    np.testing.assert_array_less(np.abs(mean - fast.evaluate(WI, WO)), 4 * mean_error + 0.005 * mean)


@pytest.mark.render
def test_the_walk_samples_what_it_evaluates(walk: Layered, fast: PlateletLayer) -> None:
    """Power of all samples at a place against the integral of the values there."""
    from nacre.device.walk.arrays import hemispherical_layered

    side = 500
    edge = (np.arange(side) + 0.5) / side * 2.0 - 1.0
    x, y = (a.ravel() for a in np.meshgrid(edge, edge))
    keep = x**2 + y**2 < 0.999
    wo = np.stack([x[keep], y[keep], np.sqrt(1 - x[keep] ** 2 - y[keep] ** 2)], axis=-1)
    powers = []
    for uv in np.random.default_rng(11).random((6, 2)):
        # in the plane of the directions' sines an area is a solid angle times its cosine
        exact = fast.evaluate(WI, wo, np.broadcast_to(uv, (len(wo), 2))).sum(axis=0) * (2.0 / side) ** 2
        found, _ = hemispherical_layered(walk, WI, samples=100_000, seed=3, uv=uv)
        np.testing.assert_allclose(found, exact, rtol=0.03, atol=0.004)
        powers.append(exact[1])
    assert np.std(powers) > 0.1 * np.mean(powers)


@pytest.mark.render
@pytest.mark.parametrize("roughness", [0.0, 0.1])
def test_the_fast_route_draws_by_the_density_that_it_states(roughness: float, mi) -> None:  # type: ignore[no-untyped-def]
    """At places with a flake, with several, and with none: draws in cells of directions, and their power."""
    import drjit as dr

    from nacre.device.bsdf import make_plugin

    # a second kind of flake, in an interface that spreads light or does not
    kinds = [FLAKE, {**FLAKE, "diameter_um": 60, "normal_deviation": 0.3}]
    stratum = {**PAINT["strata"][0], "roughness": roughness, "platelets": kinds}
    lobe = tables_of({**PAINT, "strata": [stratum]})
    plugin = make_plugin(lobe)
    side, cells, draws = 800, 8, 400_000
    edge = (np.arange(side) + 0.5) / side * 2.0 - 1.0
    x, y = np.meshgrid(edge, edge)
    inside = x**2 + y**2 < 0.9999
    z = np.sqrt(np.where(inside, 1.0 - x**2 - y**2, 1.0))
    enabled = (True,) * len(plugin.components)
    assert plugin.glints is not None
    places = np.random.default_rng(12).random((4000, 2)).astype(np.float32)
    held = np.array(plugin.glints.one_of(mi.Point2f(places.T), mi.Float([0.5] * len(places)), mi.Bool(True))[3])
    for uv in (places[held == 0][0], *places[held == 1][:2], places[held >= 2][0]):
        si = dr.zeros(mi.SurfaceInteraction3f, side * side)
        si.wi, si.wavelengths = mi.Vector3f(*WI.tolist()), mi.Spectrum(550.0)
        si.uv = mi.Point2f(*uv.tolist())
        wo = mi.Vector3f(*(mi.Float(a.ravel().astype(np.float32)) for a in (x, y, z)))
        value, pdf = plugin.eval_pdf(mi.BSDFContext(), si, wo, mi.Bool(inside.ravel()), enabled)
        # in the plane of the directions' sines an area is a solid angle times its cosine
        area = np.where(inside, (2.0 / side) ** 2 / z, 0.0)
        chance = np.array(pdf).reshape(side, side) * area
        power = (np.array(value)[0].reshape(side, side) * area).sum()
        expected = chance.reshape(cells, side // cells, cells, side // cells).sum(axis=(1, 3))

        rng = np.random.default_rng(13)
        si = dr.zeros(mi.SurfaceInteraction3f, draws)
        si.wi, si.wavelengths = mi.Vector3f(*WI.tolist()), mi.Spectrum(550.0)
        si.uv = mi.Point2f(*uv.tolist())
        one = mi.Float(rng.random(draws, dtype=np.float32))
        two = mi.Point2f(*(mi.Float(rng.random(draws, dtype=np.float32)) for _ in range(2)))
        bs, weight = plugin.sample(mi.BSDFContext(), si, one, two, mi.Bool(True), enabled)
        is_spread = np.array(bs.sampled_type) == int(mi.BSDFFlags.GlossyReflection)
        ok = is_spread & (np.array(bs.pdf) > 0) & (np.array(bs.wo.z) > 0)
        at = [np.clip((np.array(a)[ok] + 1.0) * 0.5 * cells, 0, cells - 1).astype(int) for a in (bs.wo.x, bs.wo.y)]
        counts = np.zeros((cells, cells))
        np.add.at(counts, (at[1], at[0]), 1.0)
        # five standard errors of 64 cells, and what the grid of directions misses of narrow lobes
        room = 5.0 * np.sqrt(draws * expected + 1.0) + 0.003 * draws * expected
        assert np.all(np.abs(counts - draws * expected) < room)
        weights = np.where(ok, np.array(weight)[0], 0.0)
        assert abs(weights.mean() - power) < 5.0 * weights.std() / np.sqrt(draws) + 0.003 * power


@pytest.mark.render
def test_two_seeds_of_a_default_picture_show_the_same_glints() -> None:
    """The shipped paint on the car, as large as in a picture of 256 pixels: what stands out of its neighbourhood."""
    from scipy.ndimage import median_filter

    from nacre.material.examples import examples_folder

    paint = nacre.load(examples_folder() / "pearl" / "car_paint_glints.toml")
    asked = {"scene": "body", "zoom": 256 / 48, "size": (48, 48), "progress": False}
    on_it = nacre.render(paint, background="transparent", spp=16, **asked).alpha > 0.99
    assert on_it.mean() > 0.3
    luminance = [nacre.render(paint, seed=seed, **asked).xyz[..., 1] for seed in (1, 2)]
    grain = [(y - median_filter(y, 9))[on_it] for y in luminance]
    assert np.corrcoef(*grain)[0, 1] >= 0.95  # the bar of the issue


@pytest.mark.render
def test_a_picture_keeps_its_mean_and_gains_grain(fast: PlateletLayer) -> None:
    assert fast.glint_numbers is not None
    large = fast.glint_numbers * np.array([0.1, 0.1, 1.0, 1.0, 1.0, 1.0])  # flakes of 0.4 mm on the same ball
    pictures = [
        nacre.render(Bsdf((lobe,)), size=(96, 96), spp=64, seed=1, exposure=0.0).xyz[..., 1]
        for lobe in (dataclasses.replace(fast, glint_numbers=large), dataclasses.replace(fast, glint_numbers=None))
    ]
    centre = [picture[28:68, 28:68] for picture in pictures]
    assert centre[0].mean() == pytest.approx(centre[1].mean(), rel=0.1)
    grain = [np.diff(part, axis=1).std() for part in centre]
    assert grain[0] > 2.0 * grain[1]
