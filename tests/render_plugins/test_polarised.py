"""Mueller matrices of films in polarised variants, against Mitsuba's own polarised BSDFs and the amplitudes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tested_variant import TESTED

import nacre
import nacre.render

mi = pytest.importorskip("mitsuba")
GRID_NM = np.arange(400.0, 701.0, 20.0)
WAVELENGTHS_NM = [460.0, 500.0, 560.0, 600.0]  # nodes of the grid
METAL = {"n": 0.2, "k": 3.0}
MITSUBA_METAL = {"eta": {"type": "uniform", "value": 0.2}, "k": {"type": "uniform", "value": 3.0}}
GLASS_INSIDE = {"type": "dielectric", "int_ior": 1.0, "ext_ior": 1.5}


@pytest.fixture
def polarised() -> Any:
    before = mi.variant()
    mi.set_variant("scalar_spectral_polarized")
    yield mi
    mi.set_variant(before or "scalar_spectral")


def interaction(direction: np.ndarray) -> Any:
    import drjit as dr

    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wi = mi.Vector3f(*[float(x) for x in direction])
    si.wavelengths = WAVELENGTHS_NM
    return si


def directions(rng: np.random.Generator, count: int, both_sides: bool = False) -> np.ndarray:
    theta, phi = rng.uniform(0.02, 1.45, count), rng.uniform(0.0, 2 * np.pi, count)
    sign = rng.choice([-1.0, 1.0], count) if both_sides else 1.0
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), sign * np.cos(theta)], axis=1)


def film(recipe: dict[str, Any]) -> Any:
    from nacre.device.bsdf import make_bsdf

    return make_bsdf(nacre.material({"family": "film"} | recipe).bsdf(GRID_NM))


def samples(bsdf: Any, si: Any, draws: list[float], mode: Any) -> tuple[np.ndarray, np.ndarray]:
    bs, weight = bsdf.sample(mi.BSDFContext(mode), si, draws[0], mi.Point2f(*draws[1:]))
    return np.array(bs.wo), np.array(weight)


@pytest.mark.parametrize(
    ("recipe", "reference", "both_sides"),
    [
        ({"substrate": METAL}, {"type": "conductor"} | MITSUBA_METAL, False),
        ({"substrate": {"n": 1.5}}, {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}, True),
        ({"ambient": {"n": 1.5}, "substrate": "air"}, GLASS_INSIDE, True),
    ],
)
def test_without_layers_a_film_is_mitsubas_own_interface(
    polarised: Any, recipe: dict[str, Any], reference: dict[str, Any], both_sides: bool
) -> None:
    """To 1e-5: above the error of linear interpolation between 1025 cosines and that of single precision."""
    ours, theirs = film(recipe), mi.load_dict(reference)
    rng = np.random.default_rng(1)
    compared = 0
    for wi in directions(rng, 30, both_sides):
        draws = [float(x) for x in rng.random(3)]
        for mode in (mi.TransportMode.Radiance, mi.TransportMode.Importance):
            (wo, weight), (their_wo, their_weight) = (samples(b, interaction(wi), draws, mode) for b in (ours, theirs))
            if np.allclose(wo, their_wo, atol=1e-4):
                np.testing.assert_allclose(weight, their_weight, atol=1e-5)
                compared += 1
    assert compared > 40


def test_a_rough_metal_is_mitsubas_own_rough_conductor(polarised: Any) -> None:
    ours = film({"substrate": METAL, "surface": {"roughness": 0.3}})
    theirs = mi.load_dict({"type": "roughconductor", "distribution": "ggx", "alpha": 0.3} | MITSUBA_METAL)
    rng = np.random.default_rng(2)
    context = mi.BSDFContext()
    for wi, wo in zip(directions(rng, 30), directions(rng, 30), strict=True):
        pair = interaction(wi), mi.Vector3f(*[float(x) for x in wo])
        found, expected = (np.array(b.eval(context, *pair)) for b in (ours, theirs))
        np.testing.assert_allclose(found, expected, atol=1e-5 * max(1.0, expected[0, 0].max()))


LEVEL = 0.01  # of the chi-square tests, shared among them
HELIX = {
    "material": {"ordinary": {"n": 1.5}, "extraordinary": {"n": 1.7}, "axis_polar_deg": 90},
    "thickness_nm": 1400,
    "pitch_nm": 350,
}
ROUGH = [
    ({"substrate": METAL, "layers": [{"material": {"n": 1.7}, "thickness_nm": 200}]}, 30.0),
    ({"substrate": {"n": 1.5}, "layers": [{"material": {"n": 2.0}, "thickness_nm": 120}]}, 120.0),
    ({"substrate": {"n": 1.5}, "layers": [HELIX]}, 30.0),
]


@pytest.mark.parametrize(("recipe", "theta_deg"), ROUGH)
def test_rough_films_draw_by_their_density_in_polarised_variants(recipe: dict[str, Any], theta_deg: float) -> None:
    from lobe_trials import chi_square
    from tested_variant import use_tested_variant

    from nacre.device.variant import polarised_variant

    use_tested_variant()
    bsdf = nacre.material({"family": "film", "surface": {"roughness": 0.4}} | recipe).bsdf(GRID_NM)
    with polarised_variant():
        outcome = chi_square(bsdf, theta_deg, 40.0, samples=300_000, resolution=60, steps=8)
    assert outcome.passes(LEVEL, len(ROUGH))


def test_stokes_vectors_of_random_films_are_those_of_their_amplitudes(polarised: Any) -> None:
    """20 stacks, 3 angles each; Mueller elements from s and p by their definition (Azzam and Bashara 1977, 2.12)."""
    from nacre.matter.stack.solve import solve

    rng = np.random.default_rng(3)
    for _ in range(20):
        count = int(rng.integers(1, 5))
        index = rng.uniform(1.3, 2.5, count)
        thickness = rng.uniform(20.0, 300.0, count)
        layers = [{"material": {"n": float(n)}, "thickness_nm": float(d)} for n, d in zip(index, thickness)]
        bsdf = film({"substrate": METAL, "layers": layers})
        for angle in rng.uniform(5.0, 80.0, 3):
            wi = np.array([np.sin(np.radians(angle)), 0.0, np.cos(np.radians(angle))])
            _, matrix = samples(bsdf, interaction(wi), [0.5] * 3, mi.TransportMode.Radiance)
            n = np.concatenate([[1.0], index, [0.2 + 3.0j]])[:, None]
            found = solve(n, thickness, [500.0], np.radians(angle))
            r_s, r_p = found.r_s.item(), found.r_p.item()
            half_sum, half_difference = 0.5 * (abs(r_s) ** 2 + abs(r_p) ** 2), 0.5 * (abs(r_s) ** 2 - abs(r_p) ** 2)
            cross = r_s * np.conj(r_p)
            np.testing.assert_allclose(matrix[0, 0, 1], half_sum, atol=1e-4)
            # in the plane y = 0 the Stokes frames are s and p up to a turn by 90 degrees, which flips two signs
            assert abs(abs(matrix[0, 1, 1]) - abs(half_difference)) < 1e-4
            assert abs(np.hypot(matrix[2, 2, 1], matrix[2, 3, 1]) - abs(cross)) < 1e-4


def test_a_diffuse_lobe_depolarises_and_says_so_once(polarised: Any, caplog: pytest.LogCaptureFixture) -> None:
    from nacre.device.bsdf import _say_unpolarised

    _say_unpolarised.cache_clear()
    for _ in range(2):
        bsdf = film({"substrate": {"n": 1.5}, "base": {"albedo": 0.5}})
    assert [record.levelname for record in caplog.records] == ["WARNING"]
    wi, wo = directions(np.random.default_rng(4), 2)
    found = np.array(bsdf.eval(mi.BSDFContext(), interaction(wi), mi.Vector3f(*[float(x) for x in wo])))
    assert found[0, 0].min() > 0.0
    found[0, 0] = 0.0
    np.testing.assert_array_equal(found, 0.0)


def test_a_grating_depolarises(polarised: Any) -> None:
    from nacre.device.bsdf import make_bsdf

    lines = {"thickness_nm": 60, "material": "air", "shapes": [{"shape": "line", "material": METAL, "width_nm": 300}]}
    recipe = {"family": "grating", "substrate": {"n": 1.5}, "layers": [lines], "lattice": {"period_nm": 700}}
    bsdf = make_bsdf(nacre.material(recipe).bsdf(np.array([460.0, 500.0, 560.0, 600.0])))
    si = interaction(np.array([0.1, 0.0, 0.995]))
    sine = 560.0 / 700.0 - 0.1  # of the first order at 560 nm
    value = np.array(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(sine, 0.0, float(np.sqrt(1.0 - sine**2)))))
    assert value[0, 0].max() > 0.0
    value[0, 0] = 0.0
    np.testing.assert_array_equal(value, 0.0)


FLAKES = {
    "volume_fraction": 0.05,
    "substrate": {"material": "mica", "thickness_nm": 400.0},
    "coatings": [{"material": "TiO2", "thickness_nm": 100.0}],
    "normal_deviation": 0.15,
}
LINES = {"thickness_nm": 60, "material": "air", "shapes": [{"shape": "line", "material": METAL, "width_nm": 300}]}
DEPOLARISING: dict[str, dict[str, Any]] = {
    "pearl": {"strata": [{"resin": "PET", "thickness_um": 20.0, "platelets": [FLAKES]}], "base": {"albedo": 0.3}},
    "glass": {
        "thickness_um": 20, "matrix": "air", "base": {"albedo": 0.0},
        "spheres": {"material": {"n": 1.6}, "radius_nm": 112, "volume_fraction": 0.5},
    },
    "metasurface": {
        "substrate": "glass", "particle": {"material": "Ag", "radius_nm": 55.0},
        "monolayer": {"density_per_um2": 6.0, "packing": 0.3},
    },
    "relief": {"feature_um": 0.8, "coating": "Al", "blur_um": 0.2, "coherence": {"sigma": 2.6}},
    "grating": {"substrate": {"n": 1.5}, "layers": [LINES], "lattice": {"period_nm": 700}},
}  # fmt: skip


@pytest.mark.full
@pytest.mark.parametrize("family", DEPOLARISING)
def test_families_without_mueller_matrices_render_as_depolarising_and_say_so_once(
    family: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """The Stokes layers of a sphere under circular light hold power only; random walks have no scalar variant."""
    from nacre.device.bsdf import _say_unpolarised, make_bsdf
    from nacre.picture.emitters import polarised_light

    _say_unpolarised.cache_clear()
    recipe: dict[str, Any] = {"family": family} | DEPOLARISING[family]
    if family == "relief":
        recipe["heights"] = str(tmp_path / "heights.npy")
        np.save(recipe["heights"], 0.5 * np.random.default_rng(0).random((8, 8)))
    bsdf, before = nacre.material(recipe).bsdf(np.array([400.0, 500.0, 600.0, 700.0])), mi.variant()
    film = {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}}
    camera = {"type": "orthographic", "film": film}
    caplog.clear()
    try:
        walks = family in ("pearl", "glass")
        for variant in (TESTED,) if walks else ("scalar_spectral", TESTED):
            mi.set_variant(f"{variant}_polarized")
            light = polarised_light(mi.load_dict({"type": "constant"}), "right")
            camera["to_world"] = mi.ScalarTransform4f().look_at([0, -5, 1], [0, 0, 0], [0, 0, 1])
            ball = {"type": "sphere", "bsdf": make_bsdf(bsdf)}
            scene = mi.load_dict({"type": "scene", "camera": camera, "ball": ball, "light": light})
            integrator = mi.load_dict({"type": "stokes", "nested": {"type": "path", "max_depth": 2}})
            stokes = np.array(mi.render(scene, integrator=integrator, spp=4))[1:3, 1:3]
            assert np.abs(stokes[..., 3:6]).max() > 0.0  # RGB of S0; those of S1, S2 and S3 follow
            np.testing.assert_array_equal(stokes[..., 6:], 0.0)
    finally:
        mi.set_variant(before or "scalar_spectral")
    assert [record.funcName for record in caplog.records].count("_say_unpolarised") == 1


PLATE = {
    "material": {"ordinary": {"n": 1.5}, "extraordinary": {"n": 1.7}, "axis_polar_deg": 70, "axis_azimuth_deg": 25},
    "thickness_nm": 250,
}


@pytest.mark.parametrize(("layers", "substrate"), [([PLATE], METAL), ([PLATE], {"n": 1.33})])
def test_matrices_of_a_birefringent_plate_are_those_of_its_stack(
    polarised: Any, layers: list, substrate: dict[str, float]
) -> None:
    """Elements that no choice of linear frames changes: intensity, circular part, and degrees of linear polarisation.

    Linear interpolation of cos(2 phi) between 32 azimuths is wrong by up to (4 pi / 32)^2 / 8 = 0.02 of the amplitude;
    the other 0.02 are for the 65 cosines.
    """
    recipe = {"family": "film", "substrate": substrate, "layers": layers}
    material = nacre.material(recipe)
    bsdf = film({"substrate": substrate, "layers": layers})
    rng = np.random.default_rng(7)
    for wi in directions(rng, 12):
        light = np.array([-wi[0], -wi[1], wi[2]])
        theta, azimuth = np.degrees(np.arccos(wi[2])), np.degrees(np.arctan2(light[1], light[0]))
        _, matrix = samples(bsdf, interaction(wi), [0.0, 0.5, 0.5], mi.TransportMode.Radiance)
        exact = nacre.spectrum(material, [theta], WAVELENGTHS_NM, "mueller", azimuth_deg=float(azimuth))
        expected = exact.mueller_reflected[0]
        chance = matrix[0, 0] / expected[:, 0, 0]  # of reflection, for a plate that transmits
        chance = 1.0 if substrate is METAL else chance.mean()
        limit = 0.04 * max(0.1, expected[:, 0, 0].max())
        found = np.moveaxis(matrix, -1, 0) / chance
        for row, column in ((0, 0), (0, 3), (3, 0), (3, 3)):
            np.testing.assert_allclose(found[:, row, column], expected[:, row, column], atol=limit)
        np.testing.assert_allclose(
            np.hypot(found[:, 0, 1], found[:, 0, 2]), np.hypot(expected[:, 0, 1], expected[:, 0, 2]), atol=limit
        )


def test_a_compiled_film_has_the_matrices_of_its_recipe(polarised: Any, tmp_path: Path) -> None:
    from nacre.device.bsdf import make_bsdf

    for layers in ([PLATE], [{"material": {"n": 2.0}, "thickness_nm": 90}]):
        made = nacre.material({"family": "film", "substrate": METAL, "layers": layers}).bsdf(GRID_NM)
        made.save(tmp_path / "film.nacre")
        stored = make_bsdf(nacre.load(tmp_path / "film.nacre").bsdf())
        si = interaction(np.array([0.5, 0.3, np.sqrt(0.66)]))
        found, expected = (samples(b, si, [0.5] * 3, mi.TransportMode.Radiance)[1] for b in (stored, make_bsdf(made)))
        # 1e-4: the file has the table of R of the unpolarised lobe
        np.testing.assert_allclose(found, expected, atol=1e-4)
        assert abs(found[1:, 1:]).max() > 0.1


def test_a_right_handed_helix_reflects_right_circular_light(polarised: Any) -> None:
    helix = {
        "material": {"ordinary": {"n": 1.5}, "extraordinary": {"n": 1.7}, "axis_polar_deg": 90},
        "thickness_nm": 3500,
        "pitch_nm": 350,
        "handedness": "right",
    }
    bsdf = film({"substrate": {"n": 1.6, "k": 0.2}, "layers": [helix]})
    _, matrix = samples(bsdf, interaction(np.array([0.05, 0.0, 1.0])), [0.0, 0.5, 0.5], mi.TransportMode.Radiance)
    filters = {name: getattr(mi.mueller, f"{name}_circular_polarizer")() for name in ("left", "right")}
    # 560 nm lies in the middle of the band from 1.5 to 1.7 times the pitch
    passed = {name: float(2.0 * np.array(row)[0] @ matrix[:, 0, 2]) for name, row in filters.items()}
    entering = {name: float(matrix[0, :, 2] @ (2.0 * np.array(row)[0])) for name, row in filters.items()}
    assert entering["right"] > 0.85 and entering["left"] < 0.1
    assert passed["right"] > 10 * passed["left"]


def test_matrices_beyond_the_critical_angle_follow_the_stack() -> None:
    """Total reflection in glass below an anisotropic plate: all light returns, its phase depends on the angle."""
    made = nacre.material({"family": "film", "substrate": {"n": 1.5}, "layers": [PLATE]}).bsdf(GRID_NM)
    total = made.polarisation().total
    np.testing.assert_allclose(total[..., 0], 1.0, atol=1e-5)
    assert np.ptp(total, axis=1).max() > 0.1
