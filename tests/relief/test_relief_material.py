"""Reliefs as materials: recipe, stored lobe, spectrum, spatial response, bad input."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import nacre
from nacre.bsdf.bsdf import Bsdf
from nacre.core.arrays import direction
from nacre.core.errors import NacreError, UnsupportedError
from nacre.families.relief.diffraction_orders import Coherence, coating_reflectance, fresnel_reflectance
from nacre.families.relief.material import DRAFT_ERROR, Relief
from nacre.families.relief.plane_cut import CutGeometry, local_response, plan_cut
from nacre.families.relief.spectrum_map import spectrum_map
from nacre.families.relief.surface import Tile
from nacre.matter.indices.library import index

WAVELENGTHS = np.array([450.0, 550.0, 650.0])
STATED = 3e-3  # the default accuracy: relative L2 of the stored lobe against the exact slice
GUARDED = 1.002  # the bar, over Fresnel
EXACT = 1e-12
FEW_PAIRS = 1e-5  # of the largest value: sums of some hundred terms in single precision, taken in another order
RECIPE = {
    "family": "relief",
    "heights": "h.npy",
    "feature_um": 1.0,
    "blur_um": 0.3,
    "coating": "Al",
    "coherence": {"sigma": 0.8},
}


def tile(height_nm: float = 500.0, seed: int = 1, features: int = 8) -> Tile:
    return Tile(height_nm * np.random.default_rng(seed).random((features, features)), 1000.0, 300.0)


def perfect(cosines: Any) -> np.ndarray:
    return np.ones((*np.shape(cosines), len(WAVELENGTHS)))


def directions(n: int, seed: int) -> np.ndarray:
    generator = np.random.default_rng(seed)
    cosine, phi = generator.uniform(0.05, 1, n), generator.uniform(0, 2 * np.pi, n)
    sine = np.sqrt(1 - cosine**2)
    return np.stack([sine * np.cos(phi), sine * np.sin(phi), cosine], axis=-1)


@pytest.fixture(scope="module")
def steep() -> Any:
    """A strong relief, whose raw albedo passes 1 at grazing light."""
    return spectrum_map(tile(900.0), Coherence.from_sigma(0.8), WAVELENGTHS, perfect)


def stored_error(relief: Tile, theta_deg: float, error: float, prefactor: Any = "kirchhoff") -> float:
    """Return the relative L2 distance of a stored lobe from the slice at eight times the sampling, nodes to 1e-8."""
    coherence = Coherence.from_sigma(0.8)
    lobe, report = spectrum_map(relief, coherence, WAVELENGTHS, perfect, prefactor, error, bounded=False)
    wi = np.array([np.sin(np.radians(theta_deg)), 0.0, np.cos(np.radians(theta_deg))])
    # shifted from the mirror direction towards the normal, so that all exits are above the surface
    axis_x, axis_y = np.linspace(-0.4, 0.4, 13) + 0.5 * wi[0], np.linspace(-0.4, 0.4, 13)
    upsampling = 2 * report.sampling.samples_per_feature
    plan = plan_cut(
        CutGeometry(axis_x, axis_y, wi[None], WAVELENGTHS),
        samples=relief.features * upsampling,
        period_nm=relief.period_nm,
        height_range_nm=relief.height_range_nm,
        coherence=coherence,
        prefactor=prefactor,
        node_error=1e-8,
    )
    exact = np.moveaxis(plan.forward(relief.surface_nm(upsampling))[0][0], 0, -1)
    u, v = np.broadcast_arrays(axis_x[:, None], axis_y[None, :])
    lateral = np.stack([u - wi[0], v - wi[1]], axis=-1)
    wo = np.concatenate([lateral, np.sqrt(1 - (lateral**2).sum(-1, keepdims=True))], axis=-1)
    return float(np.linalg.norm(lobe.evaluate(wi, wo) - exact) / np.linalg.norm(exact))


@pytest.mark.parametrize("theta_deg", [0.0, 40.0, 70.0])
@pytest.mark.parametrize("prefactor", ["kirchhoff", "published"])
def test_stored_lobe_agrees_with_the_exact_slice(theta_deg: float, prefactor: Any) -> None:
    assert stored_error(tile(), theta_deg, STATED, prefactor) <= STATED


@pytest.mark.full
@pytest.mark.parametrize("error", [1e-2, 3e-3, 1e-3])
def test_stored_lobe_keeps_its_stated_error_on_100_random_maps(error: float) -> None:
    """All that is chosen by itself - sampling, kappa nodes, the grids in psi and xi - together."""
    missed = 0
    for seed in range(100):
        generator = np.random.default_rng(seed)
        height, blur, theta = generator.uniform(50, 1200), generator.uniform(150, 400), generator.uniform(0, 70)
        heights = height * generator.random((6, 6))
        missed += stored_error(Tile(heights, 1000.0, blur), theta, error) > error
    assert missed <= 1


def test_stored_lobe_is_reciprocal_and_never_negative_or_nan(steep: Any) -> None:
    a, b = directions(500, 1), directions(500, 2)
    forth, back = steep[0].evaluate(a, b), steep[0].evaluate(b, a)
    assert np.abs(forth - back).max() <= EXACT * forth.max()
    edge = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 1e-9], [0.0, 0.0, -1.0], [0.6, 0.0, 0.8]])
    values = steep[0].evaluate(edge[:, None], edge[None, :])
    assert np.isfinite(values).all() and values.min() >= 0 and values[2].max() == 0


def test_albedo_stays_within_fresnel_at_every_incidence(steep: Any) -> None:
    lobe, report = steep
    assert max(report.excess) > 1.02  # else there is nothing to bound
    for theta in (0, 20, 45, 60, 70, 78, 84, 87, 89, 89.7):
        for phi in (0.0, 0.4, 1.3, 3.0):
            sine = np.sin(np.radians(theta))
            w = np.array([sine * np.cos(phi), sine * np.sin(phi), np.cos(np.radians(theta))])
            assert lobe.hemispherical(w)[0].max() <= GUARDED


def test_gentle_relief_gives_back_what_arrives() -> None:
    """The stored lobe too conserves energy within the issue's 0.1 %."""
    heights = 2500.0 * np.random.default_rng(1).random((16, 16))
    lobe, _ = spectrum_map(Tile(heights, 2000.0, 3000.0), Coherence.from_sigma(2.6), WAVELENGTHS, perfect)
    assert np.abs(lobe.hemispherical(np.array([0.0, 0.0, 1.0]))[0] - 1.0).max() <= 1e-3


def test_fresnel_is_that_of_aluminium() -> None:
    n = index("Al").n_complex(np.array([550.0]))
    values = fresnel_reflectance(np.cos(np.radians([0, 30, 45, 60, 75])), n)[:, 0]
    assert 0.90 < values[0] < 0.93
    # relative changes with the angle, computed from another table of n and k
    assert np.allclose(100 * (values[1:] / values[0] - 1), [-0.1, -0.4, -1.6, -4.7], atol=0.3)
    glass = fresnel_reflectance(np.array([1.0]), np.array([1.5 + 0j]))
    assert abs(glass[0, 0] - 0.04) < EXACT


def test_the_stored_lobe_reflects_at_the_angle_between_the_light_and_the_half_vector() -> None:
    n = np.array([1.4 + 0.2j, 0.4 + 2.5j, 2.0 + 0.0j])
    maps = [
        spectrum_map(tile(), Coherence.from_sigma(0.8), WAVELENGTHS, r, bounded=False)[0]
        for r in (perfect, coating_reflectance(n))
    ]
    wi, wo = directions(40, 7), directions(40, 8)
    half = (wi + wo) / np.linalg.norm(wi + wo, axis=-1, keepdims=True)
    expected = fresnel_reflectance((wi * half).sum(axis=-1), n) * maps[0].evaluate(wi, wo)
    # Fresnel is stored on nodes of the cosine
    assert np.abs(maps[1].evaluate(wi, wo) - expected).max() <= 1e-3 * expected.max()


def test_mean_of_the_local_response_is_the_slice() -> None:
    coherence = Coherence.from_sigma(0.8)
    wi, wo = directions(1, 3)[0], directions(1, 4)[0]
    wi, wo = (np.array([*w[:2] * 0.3, np.sqrt(1 - (w[:2] ** 2).sum() * 0.09)]) for w in (wi, wo))
    local = local_response(tile(), coherence, wi, wo[None], WAVELENGTHS, 6)
    psi = wi + wo
    plan = plan_cut(
        CutGeometry(psi[:1], psi[1:2], wi[None], WAVELENGTHS),
        samples=48,
        period_nm=8000.0,
        height_range_nm=500.0,
        coherence=coherence,
        node_error=1e-13,
    )
    exact = plan.forward(tile().surface_nm(6))[0].ravel()
    assert np.abs(local.mean(axis=(0, 1)) / exact - 1).max() < 1e-9


def test_the_microscope_sees_the_mean_over_its_aperture() -> None:
    """The middle and six exits round it, on the ring that halves the aperture's area, times the coating's Fresnel."""
    relief = Relief(tile(features=4), Coherence.from_sigma(0.8), index("Al"))
    seen = relief.figures["microscope"](aperture_deg=6.0, wavelengths_nm=WAVELENGTHS)["brdf"]
    turn = np.arange(6) * np.pi / 3
    ring = np.radians(6.0) / np.sqrt(2) * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    lateral = np.concatenate([np.zeros((1, 2)), ring])
    wo = np.concatenate([lateral, np.sqrt(1 - (lateral**2).sum(axis=-1, keepdims=True))], axis=-1)
    up = np.array([0.0, 0.0, 1.0])
    bare = local_response(relief.tile, relief.coherence, up, wo, WAVELENGTHS, len(seen) // 4, relief.prefactor)
    coated = bare * fresnel_reflectance(np.array(1.0), index("Al").n_complex(WAVELENGTHS))
    np.testing.assert_allclose(seen, coated, rtol=1e-12)


def test_recipe_to_spectrum_and_back_from_a_file(tmp_path: Path) -> None:
    np.save(tmp_path / "h.npy", tile().heights_nm / 1e3)
    material = nacre.material(RECIPE, tmp_path)
    bsdf = material.bsdf(WAVELENGTHS)
    assert bsdf.provenance["relief"]["samples_per_feature"] >= 2
    assert len(bsdf.provenance["relief"]["excess"]) == 5
    reflectance = material.spectrum([0.0], WAVELENGTHS).diffuse_reflectance
    assert reflectance is not None and np.all((reflectance > 0.6) & (reflectance < 0.93))
    bsdf.save(tmp_path / "relief.nacre")
    a, b = directions(50, 5), directions(50, 6)
    assert np.array_equal(Bsdf.load(tmp_path / "relief.nacre").evaluate(a, b), bsdf.evaluate(a, b))
    picture = material.figure_data("microscope", wavelengths_nm=WAVELENGTHS, exits=3)
    assert picture["brdf"].shape[2] == 3 and np.isfinite(picture["brdf"]).all()
    assert material.figure_data("structure")["heights_nm"].shape == (64, 64)
    with pytest.raises(UnsupportedError, match="polarisation"):
        material.spectrum([0.0], WAVELENGTHS, "s")
    with pytest.raises(UnsupportedError, match="no figure"):
        material.figure_data("field")


def test_heights_from_an_image_are_those_from_an_array(tmp_path: Path) -> None:
    grey = np.random.default_rng(1).integers(0, 65535, (6, 6)).astype(np.uint16)
    Image.fromarray(grey).save(tmp_path / "h.png")
    material = nacre.material({**RECIPE, "heights": "h.png", "height_scale_um": 0.5}, tmp_path)
    assert np.abs(material.model.tile.heights_nm - grey / 65535 * 500.0).max() < 1e-9


def test_source_angle_is_accepted(tmp_path: Path) -> None:
    np.save(tmp_path / "h.npy", tile().heights_nm / 1e3)
    material = nacre.material({**RECIPE, "coherence": {"source_angle_deg": 5.0}}, tmp_path)
    assert abs(material.model.coherence.sigma_um - 2.6) < 0.05


@pytest.mark.parametrize(
    ("heights", "changes", "says"),
    [
        (np.zeros((4, 5)), {}, "square"),
        (np.full((4, 4), np.nan), {}, "not finite"),
        (np.zeros(4), {}, "square"),
        (np.zeros((600, 600)), {}, "at most 512"),
        (np.eye(4) * 1e6, {}, "spans"),
        (np.array([["a"]]), {}, "heights"),
        (np.zeros((4, 4)), {"feature_um": 0.0}, "feature_um"),
        (np.zeros((4, 4)), {"blur_um": -0.1}, "blur_um"),
        (np.zeros((4, 4)), {"blur_um": 0.0}, "blur_um"),
        (np.zeros((4, 4)), {"heights": "other.npy"}, "does not exist"),
        (np.zeros((4, 4)), {"coherence": {}}, "exactly one"),
        (np.zeros((4, 4)), {"prefactor": "kirchoff"}, "prefactor"),
        (np.zeros((4, 4)), {"coating": "Alu"}, "coating"),
        (np.zeros((4, 4)), {"bluur_um": 0.1}, "Did you mean"),
    ],
)
def test_a_bad_recipe_is_one_clear_line(tmp_path: Path, heights: np.ndarray, changes: dict, says: str) -> None:
    np.save(tmp_path / "h.npy", heights)
    with pytest.raises(NacreError, match=says) as caught:
        nacre.material({**RECIPE, **changes}, tmp_path)
    assert "\n" not in str(caught.value)


def test_a_window_too_fine_to_store_is_refused_before_memory_is_taken() -> None:
    sharp = Relief(tile(), Coherence.from_source_angle(1e-4), index("Al"))
    with pytest.raises(UnsupportedError, match="GiB.*source angle of .* degrees or more, fewer wavelengths") as caught:
        sharp.bsdf()
    # it names the least angle that fits; half of it is refused too
    named = float(str(caught.value).partition("source angle of ")[2].split()[0])
    with pytest.raises(UnsupportedError, match="GiB"):
        Relief(tile(), Coherence.from_source_angle(np.radians(named / 2)), index("Al")).bsdf()


def test_a_small_lamp_gets_a_coarser_map_and_the_report_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    import nacre.families.relief.spectrum_map as module

    monkeypatch.setattr(module, "MAX_TABLE_BYTES", 2 << 20)
    lobe, report = spectrum_map(tile(), Coherence.from_sigma(0.8), WAVELENGTHS, perfect, bounded=False)
    assert lobe.power.nbytes <= 2 << 20
    assert STATED < report.psi_error < 0.02


@pytest.mark.parametrize("kind", ["structure", "microscope"])
def test_the_figures_of_a_relief_are_drawn(tmp_path: Path, kind: str) -> None:
    from nacre.cli import run

    recipe = Path(__file__).resolve().parents[2] / "examples" / "relief" / "star.toml"
    output = tmp_path / "figure.png"
    assert run(["plot", str(recipe), "--kind", kind, "-o", str(output)]) == 0
    assert output.stat().st_size > 5000


@pytest.mark.parametrize("bounded", [True, False])
def test_a_few_pairs_have_the_values_of_the_whole_table(tmp_path: Path, bounded: bool) -> None:
    height = np.random.default_rng(2).uniform(0.0, 0.5, (8, 8))
    np.save(tmp_path / "h.npy", height)
    recipe = {"family": "relief", "heights": "h.npy", "feature_um": 1.0, "blur_um": 0.3, "coating": "Al",
              "coherence": {"sigma": 1.0}, "accuracy": 0.01, "bounded": bounded}  # fmt: skip
    relief = nacre.material(recipe, tmp_path).model
    angles = np.radians([-75.0, -30.0, 0.0, 12.0, 65.0, 85.0])
    wo = np.stack([direction(a, 0.3 * k) for k, a in enumerate(angles)])
    wi = np.stack([direction(np.radians(a)) for a in (45.0, 45.0, 0.0, 88.0, 20.0, 45.0)])
    grid = np.array([420.0, 500.0, 560.0, 610.0])
    whole = relief.bsdf(grid).lobes[0].evaluate(wi, wo)
    assert whole.max() > 0
    found = relief.values_at(wi, wo, grid)
    np.testing.assert_allclose(found, whole, rtol=0.0, atol=FEW_PAIRS * whole.max())


def test_a_draft_is_the_relief_within_its_coarser_accuracy_where_the_bound_is_idle(tmp_path: Path) -> None:
    """Away from grazing light a gentle relief keeps within Fresnel by itself, so nothing but the nodes differs."""
    np.save(tmp_path / "h.npy", tile(300.0).heights_nm / 1e3)
    model = nacre.material(RECIPE, tmp_path).model
    assert isinstance(model, Relief)
    polar, azimuth = np.random.default_rng(3).uniform(0.0, [[0.6], [2.0 * np.pi]], (2, 60))
    wi = direction(polar, azimuth)
    wo = direction(polar[::-1], azimuth)
    own, drafted = (one.values_at(wi, wo, WAVELENGTHS) for one in (model, model.draft))
    assert np.linalg.norm(drafted - own) < DRAFT_ERROR * np.linalg.norm(own)
    assert not model.draft.bounded and model.draft.tile is model.tile
