"""Does the walk keep its promises? sample against eval, reciprocity, furnaces, limits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers_pearl import direction, dissolved_dye, layered_lobe, lossless_flakes, sphere_dye

import nacre

pytestmark = pytest.mark.render

ALBEDO_BAR = 0.005  # sample against eval
FURNACE_BAR = 0.003
MAX_Z = 3.5
PAIRS, STANDARD_ERROR_BAR = 30, 0.01  # of reciprocity
SIDAK_Z = 3.59  # 30 pairs at 1 % together, two-sided: 1 - 0.99^(1/30) = 3.35e-4
SIDAK_Z_OF_SIX = 3.14
RISEN_BAR = 81.0  # 8, and by one flake that takes a tenth on average
MOMENT_BAR = 1.3
EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "pearl"
COAT_BAR = 0.003  # a coat without flakes against Mitsuba's interface

CASES = {
    "one stratum": dict(),
    "rotated and anisotropic": dict(deviation=(0.1, 0.3), rotation_deg=(15, -5, 10)),
    "anisotropic interface": dict(alpha=(0.05, 0.3)),
    "Beckmann": dict(alpha=(0.2, 0.2), beckmann=True),
    "compensated": dict(alpha=(0.4, 0.4), compensate=True),
    "three kinds": dict(kinds=3),
    "smooth top": dict(alpha=(0, 0)),
    "two strata": dict(index=[1.575, 1.4], number=1.0, deviation=(0.3, 0.3)),
    "smooth between strata": dict(index=[1.3, 1.6], number=1.0, alpha=[(0.2, 0.2), (0, 0)]),
    "metal base": dict(base="specular", albedo=0.8, number=1.0, alpha=(0.2, 0.2)),
    "rough metal base": dict(base="specular", albedo=0.8, number=1.0, alpha=(0.2, 0.2), bottom=0.3),
    "dissolved dye": dict(dye=dissolved_dye(), number=2.0),
    "dye of spheres": dict(dye=sphere_dye(), number=2.0),
    "open, smooth": dict(base="none", alpha=(0, 0), number=2.0),
    "open, rough above": dict(base="none", alpha=(0.2, 0.2), number=1.0),
    "open, rough below": dict(base="none", alpha=(0, 0), bottom=0.2, number=1.0),
    "open, rough, two strata": dict(
        base="none", index=[1.5, 1.3], alpha=[(0.2, 0.2), (0.1, 0.1)], bottom=0.2, number=0.7, deviation=(0.3, 0.3)
    ),
}


@pytest.fixture(scope="module")
def mi():
    from tested_variant import use_tested_variant

    return use_tested_variant()


def draw(mi, lobe, wi, count, seed=5):
    """Exit directions, weights at one wavelength, and which are mirror images."""
    from nacre.device.walk.strata import Strata
    from nacre.device.walk.walk import sample_walk

    strata = Strata(lobe)
    where = strata.axis.locate(mi.Spectrum(450.0, 520.0, 580.0, 650.0))
    d, f, mirror = sample_walk(
        strata, mi.PCG32(size=count, initstate=seed), mi.Vector3f(*wi.tolist()), where, mi.Bool(True)
    )
    return np.array(d).T.astype(float), np.array(f[0]).astype(float), np.array(mirror | mi.Bool(mi.Float(f[0]) < 0))


def dr_where(mask, value):
    """The value where the mask holds, else 0."""
    import drjit as dr

    return dr.select(mask, value, 0.0)


def values(mi, lobe, wi, count, below, seed=6):
    """Directions drawn by their cosine and f cos / pdf there."""
    from nacre.device.walk.strata import Strata
    from nacre.device.walk.walk import eval_walk

    strata = Strata(lobe)
    where = strata.axis.locate(mi.Spectrum(450.0, 520.0, 580.0, 650.0))
    rng = mi.PCG32(size=count, initstate=seed)
    wo = mi.warp.square_to_cosine_hemisphere(mi.Point2f(rng.next_float32(), rng.next_float32()))
    pdf = wo.z / np.pi
    if below:
        wo = mi.Vector3f(wo.x, wo.y, -wo.z)
    f = eval_walk(strata, rng, mi.Vector3f(*wi.tolist()), wo, where, mi.Bool(True))
    return np.array(wo).T.astype(float), np.array(f[0] / pdf).astype(float)


def compare(mi, lobe, wi, count):
    """|z| of albedo and lobe, and relative difference of the albedo with its error, per side."""
    d, weight, mirror = draw(mi, lobe, wi, count)
    results = []
    for below in (False, True) if lobe.base == "none" else (False,):
        wo, estimate = values(mi, lobe, wi, count, below)
        axis = -wi if below else wi * np.array([-1, -1, 1])
        side = (d[:, 2] < 0) if below else (d[:, 2] > 0)
        for power in (0, 20):
            a = weight * side * ~mirror * np.clip(d @ axis, 0, 1) ** power
            b = estimate * np.clip(wo @ axis, 0, 1) ** power
            error = np.sqrt((a.var() + b.var()) / count)
            results.append((abs(a.mean() - b.mean()) / error, abs(a.mean() / b.mean() - 1), error / b.mean()))
    return results


def fly(monkeypatch, far):
    """Make all walks of flakes without dye take the far or the near form."""
    from nacre.device.walk import strata as layered_device

    monkeypatch.setattr(layered_device, "uses_delta_tracking", lambda lobe: far and lobe.kinds > 0 and lobe.dye is None)


@pytest.mark.parametrize(
    ("name", "far"), [(name, far) for name in CASES for far in (False, True) if not (far and "dye" in CASES[name])]
)
def test_sample_and_eval_agree(mi, monkeypatch, name, far):
    fly(monkeypatch, far)
    for z, _, _ in compare(mi, layered_lobe(**CASES[name]), direction(30, 17), 100_000):
        assert z < MAX_Z


@pytest.mark.parametrize("bottle", ["bottle1", "bottle9"])
def test_far_flights_bring_what_the_walk_from_flake_to_flake_brings(mi, monkeypatch, bottle):
    """Coloured flakes of the source: values at six exits, power and its second moment, at four wavelengths."""
    from nacre.device.walk.strata import Strata, uses_delta_tracking
    from nacre.device.walk.walk import eval_walk, sample_walk

    material = nacre.load(EXAMPLES / f"{bottle}.toml").vary({"quality": "reference"})
    (lobe,) = material.bsdf(np.arange(400.0, 701.0, 20.0)).lobes
    assert uses_delta_tracking(lobe)
    count, yes = 200_000, mi.Bool(True)
    exits = [(20, 180), (35, 180), (35, 170), (10, 40), (60, 250), (75, 0)]
    found = []
    for far in (False, True):
        fly(monkeypatch, far)
        strata = Strata(lobe)
        assert strata.uses_delta_tracking == far
        where = strata.axis.locate(mi.Spectrum(440.0, 510.0, 580.0, 670.0))  # two on nodes, two between
        wi = mi.Vector3f(*direction(35).tolist())
        parts = []
        for i, angles in enumerate(exits):
            rng = mi.PCG32(size=count, initstate=10 + i)
            parts.append(eval_walk(strata, rng, wi, mi.Vector3f(*direction(*angles).tolist()), where, yes))
        d, weight, _ = sample_walk(strata, mi.PCG32(size=count, initstate=9), wi, where, yes)
        parts += [weight, weight * d.z, weight * d.x]
        found.append(np.array([np.array(part) for part in parts], dtype=float))  # [part, wavelength, walk]
        assert weight_sums(weight).max() <= RISEN_BAR
    near, far_ = found
    error = np.sqrt((near.var(axis=-1) + far_.var(axis=-1)) / count)
    assert np.max(np.abs(near.mean(axis=-1) - far_.mean(axis=-1)) / error) < SIDAK_Z
    moments = [np.mean(weight_sums(part[len(exits)]) ** 2) for part in found]
    assert moments[1] <= MOMENT_BAR * moments[0]


def weight_sums(weight):
    """What four wavelengths carry together, 1 when they enter."""
    return np.array(weight, dtype=float).sum(axis=0) / 4


def test_wide_flakes_and_dye_are_met_one_by_one(mi):
    """Where normals reflect unlike, weights of far flights would rise over many flakes."""
    from nacre.device.walk.strata import uses_delta_tracking

    assert not uses_delta_tracking(layered_lobe(number=2.0, dye=dissolved_dye()))
    assert not uses_delta_tracking(layered_lobe(number=0.0))
    (lobe,) = nacre.load(EXAMPLES / "mcs2.toml").vary({"quality": "reference"}).bsdf().lobes
    assert not uses_delta_tracking(lobe)


@pytest.mark.full
@pytest.mark.parametrize("name", CASES)
def test_sample_and_eval_agree_within_half_a_percent(mi, name):
    for i, (z, difference, error) in enumerate(compare(mi, layered_lobe(**CASES[name]), direction(50, 80), 1_500_000)):
        assert z < MAX_Z
        if i % 2 == 0:
            assert difference < max(ALBEDO_BAR, 3 * error)


@pytest.mark.parametrize("name", ["smooth top", "compensated", "open, rough, two strata"])
def test_one_walk_for_both_gives_what_two_walks_give(mi, name):
    """A path tracer requests value and sample together; the joint walk must have the means of two separate walks."""
    from nacre.device.walk.strata import Strata
    from nacre.device.walk.walk import eval_walk, joint_walk, sample_walk

    strata, count, wi = Strata(layered_lobe(**CASES[name])), 200_000, mi.Vector3f(*direction(40, 30).tolist())
    where = strata.axis.locate(mi.Spectrum(450.0, 520.0, 580.0, 650.0))
    wo = mi.Vector3f(*direction(50, 190).tolist())
    yes = mi.Bool(True)
    value, d, weight, mirror = joint_walk(strata, mi.PCG32(size=count, initstate=1), wi, wo, where, yes, yes)
    alone = eval_walk(strata, mi.PCG32(size=count, initstate=2), wi, wo, where, yes)
    d_alone, weight_alone, mirror_alone = sample_walk(strata, mi.PCG32(size=count, initstate=3), wi, where, yes)
    pairs = [(value[0], alone[0])]
    for image in (False, True):  # mirror images, and the rest
        parts = ((d, weight, mirror), (d_alone, weight_alone, mirror_alone))
        pairs.append(tuple(dr_where(m if image else ~m, w[0] * (2 + x.z + x.x)) for x, w, m in parts))
    for one, two in pairs:
        a, b = np.array(one).astype(float), np.array(two).astype(float)
        error = np.sqrt((a.var() + b.var()) / count)
        assert abs(a.mean() - b.mean()) <= MAX_Z * error
        assert error <= 0.02 * max(abs(b.mean()), 1e-3)


def test_single_weights_stay_at_one_in_a_furnace(mi, monkeypatch):
    fly(monkeypatch, False)
    lobe = layered_lobe(20.0, (0.3, 0.3), (0.3, 0.3), lossless_flakes, albedo=1.0)
    _, weight, _ = draw(mi, lobe, direction(20), 50_000)
    assert weight.max() <= 4.0 + 1e-4  # grey light: 1; four colours may share at most four


@pytest.mark.parametrize("angle", [pytest.param(18.0, marks=pytest.mark.full), 60.0, 78.0])
def test_smooth_lossless_furnace_gives_all_light_back(mi, angle):
    lobe = layered_lobe(5.0, (0.2, 0.2), (0, 0), lossless_flakes, albedo=1.0)
    _, weight, mirror = draw(mi, lobe, direction(angle), 200_000)
    assert weight.mean() == pytest.approx(1, abs=FURNACE_BAR)
    _, estimate = values(mi, lobe, direction(angle), 200_000, False)
    error = estimate.std() / np.sqrt(len(estimate))
    assert estimate.mean() + (weight * mirror).mean() == pytest.approx(1, abs=FURNACE_BAR + 4 * error)


@pytest.mark.parametrize("alpha", [pytest.param(0.1, marks=pytest.mark.full), 0.3, 0.6])
@pytest.mark.parametrize("beckmann", [False, pytest.param(True, marks=pytest.mark.full)])
def test_a_compensated_rough_furnace_loses_nothing(mi, alpha, beckmann):
    lobe = layered_lobe(
        3.0, (0.2, 0.2), (alpha, alpha), lossless_flakes, albedo=1.0, compensate=True, beckmann=beckmann
    )
    for angle in (20.0, 70.0):
        _, weight, _ = draw(mi, lobe, direction(angle), 500_000)
        error = weight.std() / np.sqrt(len(weight))
        assert error < 0.001
        assert 0.98 <= weight.mean() <= 1.003 + 2 * error
        _, estimate = values(mi, lobe, direction(angle), 60_000, False)
        assert abs(estimate.mean() - weight.mean()) < 4 * estimate.std() / np.sqrt(len(estimate))


def reciprocity(lobe, pairs, seed=0):
    """z of f(a, b) - f(b, a), and the relative standard error of each, below 1 %: pairs that need more get more."""
    from nacre.device.walk.arrays import evaluate_layered

    rng = np.random.default_rng(seed)
    z = rng.uniform(0.25, 1.0, (pairs, 2)) * (rng.choice([-1, 1], (pairs, 2)) if lobe.base == "none" else 1)
    phi = rng.uniform(0, 2 * np.pi, (pairs, 2))
    s = np.sqrt(1 - z**2)
    w = np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=-1)
    mean, square = np.zeros((2, pairs)), np.zeros((2, pairs))
    walks, turn, open_ = np.zeros(pairs), 0, np.arange(pairs)
    while len(open_) and turn < 24:
        count = 16_000 * 2 ** min(turn // 4, 3)
        for way in (0, 1):
            value, error = evaluate_layered(lobe, w[open_, way], w[open_, 1 - way], count, 2 * turn + way + 1)
            mean[way, open_] += count * value[:, 0]
            square[way, open_] += (count * error[:, 0]) ** 2
        walks[open_] += count
        turn += 1
        error = np.sqrt(square) / mean
        open_ = np.flatnonzero((error > STANDARD_ERROR_BAR).any(axis=0))
    there, back = mean / walks
    return (there - back) / np.hypot(*(np.sqrt(square) / walks)), np.sqrt(square) / mean


def first_wavelengths(lobe, count=4):
    """The lobe with its first wavelengths only: one walk carries them all."""
    import dataclasses

    axes = {
        "wavelengths_nm": 0, "flake_response": 2, "flake_extinction": 3, "base_reflectance": 1, "dye": 1,
        "dye_phase": 2, "dye_quantile": 2,
    }  # fmt: skip
    found = {key: getattr(lobe, key) for key in axes}
    few = {k: np.take(v, np.arange(count), axis=axes[k]) for k, v in found.items() if v is not None}
    return dataclasses.replace(lobe, **few)


@pytest.mark.parametrize(
    ("name", "pairs"),
    [
        ("rotated and anisotropic", 6),
        *(
            pytest.param(n, PAIRS, marks=pytest.mark.full)
            for n in ("rotated and anisotropic", "open, rough, two strata", "compensated", "two strata")
        ),
        *(pytest.param(n, PAIRS, marks=pytest.mark.full) for n in ("rough metal base", "dye of spheres")),
    ],
)
def test_the_value_is_reciprocal(mi, name, pairs):
    z, error = reciprocity(first_wavelengths(layered_lobe(**CASES[name])), pairs)
    assert error.max() <= STANDARD_ERROR_BAR
    assert np.abs(z).max() < (SIDAK_Z if pairs == PAIRS else SIDAK_Z_OF_SIX)


@pytest.mark.parametrize(("alpha", "angle"), [(0.2, 40.0), pytest.param(0.5, 70.0, marks=pytest.mark.full)])
def test_without_flakes_it_is_mitsubas_rough_dielectric_over_its_base(mi, alpha, angle):
    """Light goes to and fro between Mitsuba's `roughdielectric` and a diffuse base, by its own draws and weights."""
    import drjit as dr

    albedo, count = 0.7, 3_500_000
    wi = direction(angle)
    _, weight, _ = draw(mi, layered_lobe(0.0, alpha=(alpha, alpha), albedo=albedo), wi, count)
    face = mi.load_dict(
        {"type": "roughdielectric", "distribution": "ggx", "alpha": alpha, "int_ior": 1.575, "ext_ior": 1.0}
    )
    context = mi.BSDFContext(mi.TransportMode.Importance)  # power: no (n_o/n_i)^2
    rng = mi.PCG32(size=count, initstate=9)
    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.wavelengths = mi.Spectrum(550.0)
    si.wi = mi.Vector3f(*wi.tolist())
    carried, left = mi.Float(1.0), dr.zeros(mi.Float, count)
    for _ in range(40):  # 0.7^40 is below 1e-6
        point = mi.Point2f(rng.next_float32(), rng.next_float32())
        bs, share = face.sample(context, si, rng.next_float32(), point, True)
        carried = carried * share[0]
        out = bs.wo.z > 0
        left += dr.select(out, carried, 0.0)
        carried = dr.select(out, 0.0, carried * albedo)
        up = mi.warp.square_to_cosine_hemisphere(mi.Point2f(rng.next_float32(), rng.next_float32()))
        si.wi = -up  # light that rises comes from below the interface
        dr.eval(carried, left, si.wi, rng)
    theirs = np.array(left).astype(float)
    error = np.hypot(weight.std(), theirs.std()) / np.sqrt(count) / theirs.mean()
    assert error < COAT_BAR / 3
    assert weight.mean() == pytest.approx(theirs.mean(), rel=COAT_BAR)


@pytest.mark.parametrize(("reflect", "deviation"), [(0.5, 0.01), (0.8, 0.01), (0.95, 0.001)])
def test_flat_opaque_flakes_are_kubelka_and_munks_limit_under_a_coat(mi, reflect, deviation):
    """A pile of flat opaque flakes reflects r = 1 + a - sqrt(a^2 + 2a), a = (1 - R)/R, not R: light that a flake
    throws back meets the backs of others. The smooth coat adds F + (1 - F)^2 r / (1 - F r). (At R = 0.95 so many
    events follow each other that the tails of deviation 0.01 tilt the light by a percent: hence 0.001.)"""
    from nacre.bsdf.facet_distributions import fresnel

    lobe = layered_lobe(60.0, (deviation, deviation), (0, 0), lambda c: (reflect + 0 * c, 0 * c), albedo=0.0)
    a = (1 - reflect) / reflect
    pile = 1 + a - np.sqrt(a * a + 2 * a)
    for angle in (10.0, 45.0):
        wi = direction(angle)
        _, weight, _ = draw(mi, lobe, wi, 200_000)
        f = float(fresnel(wi[2], 1.575))
        expected = f + (1 - f) ** 2 * pile / (1 - f * pile)
        error = weight.std() / np.sqrt(len(weight))
        assert abs(weight.mean() - expected) < 0.01 * expected + 2 * error


def test_nine_kinds_alike_are_one_of_nine_times_the_number(mi):
    means, errors = [], []
    for kinds in (1, 9):
        lobe = first_wavelengths(layered_lobe(number=3.0, kinds=kinds))
        wo, estimate = values(mi, lobe, direction(40), 100_000, False)
        means.append([estimate.mean(), (estimate * wo[:, 2] ** 4).mean()])
        errors.append([estimate.std(), (estimate * wo[:, 2] ** 4).std()])
    error = np.hypot(*errors) / np.sqrt(100_000)
    assert np.all(error < 0.02 * np.array(means[0]))
    assert np.all(np.abs(np.subtract(*means)) < MAX_Z * error)


def test_flakes_on_edge_let_light_pass_and_stay_finite(mi):
    """Turned by 90 degrees the flakes show their edges to light from above: little of it is turned back."""
    flat, edge = (
        layered_lobe(6.0, (0.05, 0.05), (0, 0), albedo=0.0, base="none", rotation_deg=(turn, 0, 0)) for turn in (0, 90)
    )
    passed = []
    for lobe in (flat, edge):
        d, weight, _ = draw(mi, lobe, direction(0.0), 100_000)
        _, estimate = values(mi, lobe, direction(0.0), 100_000, False)
        assert np.all(np.isfinite(weight)) and np.all(np.isfinite(estimate))
        passed.append((weight * (d[:, 2] < 0)).mean())
    assert passed[1] > passed[0] + 0.1


def test_the_plugin_needs_an_llvm_variant(mi):
    from nacre.core.errors import UnsupportedError
    from nacre.device.bsdf import make_plugin
    from nacre.device.lobes.layered import LayeredPlugin

    before = mi.variant()
    mi.set_variant("scalar_spectral")
    try:
        with pytest.raises(UnsupportedError, match="LLVM"):
            LayeredPlugin(layered_lobe(), make_plugin)
    finally:
        mi.set_variant(before)


def test_a_scene_of_strata_renders(mi):
    from nacre.bsdf import Bsdf
    from nacre.device.bsdf import make_bsdf

    lobe = layered_lobe(index=[1.575, 1.4], number=1.0)
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 4},
            "light": {"type": "constant", "radiance": {"type": "uniform", "value": 1.0}},
            "ball": {"type": "sphere", "bsdf": make_bsdf(Bsdf((lobe,)))},
            "sensor": {
                "type": "perspective", "to_world": mi.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]),
                "fov": 20, "film": {"type": "hdrfilm", "width": 16, "height": 16},
            },
        }
    )  # fmt: skip
    picture = np.array(mi.render(scene, spp=16))
    assert np.all(np.isfinite(picture)) and 0.1 < picture[8, 8].mean() < 1.0


def test_the_proxy_density_divides_no_value(mi):
    """Two lobes together draw one of them with its own weight: twice the light of one."""
    from lobe_trials import draw as draw_bsdf

    from nacre.bsdf import Bsdf

    lobe = layered_lobe()
    one, two = (draw_bsdf(Bsdf((lobe,) * n), direction(40.0), 100_000).weight for n in (1, 2))
    error = np.hypot(2 * one.std(axis=0), two.std(axis=0)) / np.sqrt(len(one))
    assert np.all(np.abs(two.mean(axis=0) - 2 * one.mean(axis=0)) < MAX_Z * error)
    assert np.all(error < 0.02)


@pytest.mark.full
def test_the_trust_in_sample_moves_noise_but_no_light(mi):
    """A ball of flakes so dense that the trust is capped, with and without multiple importance sampling."""
    from nacre.bsdf import Bsdf
    from nacre.device.bsdf import make_bsdf

    bsdf = make_bsdf(Bsdf((layered_lobe(number=25.0, deviation=(0.05, 0.05), alpha=(0.2, 0.2)),)))
    lamp = mi.ScalarTransform4f().look_at([3, 0, 4], [0, 0, 0], [0, 1, 0]).scale(1.5)
    parts = {
        "type": "scene",
        "light": {"type": "rectangle", "to_world": lamp, "emitter": {"type": "area"}},
        "ball": {"type": "sphere", "bsdf": bsdf},
        "sensor": {
            "type": "perspective", "to_world": mi.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]),
            "fov": 16, "film": {"type": "hdrfilm", "width": 4, "height": 4, "pixel_format": "luminance"},
        },
    }  # fmt: skip
    means, variances = [], []
    for integrator in ({"type": "path", "max_depth": 2}, {"type": "direct", "emitter_samples": 0, "bsdf_samples": 1}):
        scene = mi.load_dict({**parts, "integrator": integrator})
        totals = [float(np.array(mi.render(scene, spp=1024, seed=s)).mean()) for s in range(16)]
        means.append(np.mean(totals))
        variances.append(np.var(totals, ddof=1) / len(totals))
    assert abs(means[0] - means[1]) < MAX_Z * np.sqrt(sum(variances))
    assert np.sqrt(sum(variances)) < 0.02 * means[0]


def test_one_walk_serves_all_wavelengths_and_their_squares(mi) -> None:
    """An evaluation that walks anew for each sum is slow and yet right."""
    import drjit as dr

    from nacre.device.walk.arrays import evaluate_layered

    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history()
        evaluate_layered(layered_lobe(), direction(0.5), np.array([[0.0, 0.0, 1.0]]), samples=256)
        made = [one["operation_count"] for one in dr.kernel_history() if one["type"] == dr.KernelType.JIT]
    assert sum(count > max(made) / 2 for count in made) == 1
