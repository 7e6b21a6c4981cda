"""The denoiser: grain goes, colours and fine lines stay, glints and spectra are left alone."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.light import delta_e_2000, white_xyz, xyz_to_lab
from nacre.material.examples import examples_folder
from nacre.picture import denoise, passes

pytestmark = pytest.mark.render

GOLD = {"family": "film", "substrate": "Au", "surface": {"roughness": 0.25}}
LARGEST_BIAS = 0.5  # dE00 of a patch's mean colour
SIZE = (96, 96)


@pytest.fixture(autouse=True)
def allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NACRE_DENOISE", raising=False)


def render(material: Any, **options: Any) -> Any:
    return nacre.render.render(material, size=SIZE, exposure=0.0, **options)


def test_grain_goes_and_colours_stay() -> None:
    material = nacre.material(GOLD)
    reference = render(material, spp=256, denoise=False, seed=9).xyz
    result = render(material, spp=16)
    assert result.stats["denoised"] and result.raw is not None
    scale = reference + 0.01
    clean, raw = (np.mean(((picture - reference) / scale) ** 2) for picture in (result.xyz, result.raw))
    assert clean < 0.25 * raw
    patches = [np.s_[r : r + 12, c : c + 12] for r in (20, 36, 52) for c in (24, 42, 60)] + [np.s_[82:94, 10:80]]
    white = white_xyz("D65")
    lab = [np.stack([xyz_to_lab(picture[patch].mean(axis=(0, 1)) / 0.6, white) for patch in patches])
           for picture in (result.xyz, result.raw)]  # fmt: skip
    # against the same samples, whose own error is not the denoiser's
    assert float(np.mean(delta_e_2000(*lab))) <= LARGEST_BIAS


def test_skewed_noise_keeps_its_mean() -> None:
    """Few wavelengths a path: most pixels hold too little blue, one in twenty six times as much as the mean."""
    from nacre.picture.denoise import denoised

    generator, size, share, spike = np.random.default_rng(3), (96, 96), 0.05, 6.0
    xyz = np.full((*size, 3), 0.2) * generator.normal(1.0, 0.05, (*size, 3))
    xyz[..., 2] *= np.where(generator.random(size) < share, spike, (1.0 - share * spike) / (1.0 - share))
    albedo, normal = np.full((*size, 3), 0.5, np.float32), np.tile(np.float32([0.0, 0.0, 1.0]), (*size, 1))
    kept = denoised(xyz, albedo, normal).mean(axis=(0, 1)) / xyz.mean(axis=(0, 1))
    # 2 % of the blue of a grey are dE00 0.5, the bar of mean colours
    assert np.abs(kept - 1.0).max() < 0.02


def test_means_that_grain_explains_leave_no_blotches() -> None:
    """Paint of flakes, traced: one pixel in twenty holds nearly all light, and halves do not show that it is grain."""
    from nacre.picture.denoise import KEPT_MEANS, denoised
    from nacre.picture.plugins import smooth

    size = (128, 128)
    grain = np.random.default_rng(3).gamma(0.3, 1.0 / 0.3, (*size, 1))
    xyz = 0.3 * grain * np.array([0.95, 1.0, 1.09])
    albedo, normal = np.full((*size, 3), 0.5, np.float32), np.tile(np.float32([0.0, 0.0, 1.0]), (*size, 1))
    pictures = (xyz, denoised(xyz, albedo, normal))
    blotches = [smooth(y[..., 1], KEPT_MEANS)[16:-16, 16:-16].std() for y in pictures]
    assert blotches[1] < 0.5 * blotches[0]  # a quarter of their power; two thirds of the amplitude came back


@pytest.mark.parametrize("shape", [(96, 64), (33, 129, 3), (1, 5)])
@pytest.mark.parametrize("sigma", [1.0, 2.5, 10.0])
def test_smoothing_is_a_gaussian_whose_picture_goes_on_beyond_its_edges(shape: tuple[int, ...], sigma: float) -> None:
    from scipy.ndimage import gaussian_filter

    from nacre.picture.plugins import smooth

    picture = np.random.default_rng(5).random(shape)
    widths = (sigma, sigma, 0.0)[: len(shape)]
    expected = gaussian_filter(picture, widths, mode="nearest", truncate=3.0)
    assert np.abs(smooth(picture, sigma) - expected).max() < 1e-13


def noisy_pair(truth: np.ndarray, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """A picture with grain of a relative strength, and a sample of it as two halves."""
    generator = np.random.default_rng(7)
    halves = [truth * generator.normal(1.0, noise * 2**0.5, truth.shape) for _ in range(2)]
    return 0.5 * (halves[0] + halves[1]), np.asarray(0.5 * (halves[0] - halves[1]), dtype=np.float32)


def flat_aovs() -> tuple[np.ndarray, np.ndarray]:
    return np.full((*SIZE, 3), 0.5, np.float32), np.tile(np.float32([0.0, 0.0, 1.0]), (*SIZE, 1))


def test_texture_stronger_than_the_noise_is_given_back() -> None:
    """A pattern as fine as the pixels, without an order that the denoiser could see, and uninformative AOVs."""
    from nacre.picture.denoise import denoised

    texture = np.random.default_rng(5).uniform(0.85, 1.15, (*SIZE, 1))
    truth = 0.3 * texture * [0.95, 1.0, 1.09]
    noisy, difference = noisy_pair(truth, 0.02)

    def error(xyz: np.ndarray) -> float:
        return float(np.sqrt(np.mean((xyz - truth) ** 2)))

    raw, smooth, found = (error(xyz) for xyz in (
        noisy, denoised(noisy, *flat_aovs()), denoised(noisy, *flat_aovs(), difference)))  # fmt: skip
    assert smooth > 1.5 * raw  # else it is no test
    assert found < 1.05 * raw  # Wiener's share of texture so strong is nearly 1


def test_no_grain_comes_back_where_there_is_no_texture() -> None:
    from nacre.picture.denoise import denoised

    truth = np.full((*SIZE, 3), 0.3) * [0.95, 1.0, 1.09]
    noisy, difference = noisy_pair(truth, 0.2)
    grain = [np.std(xyz[..., 1]) for xyz in (noisy, denoised(noisy, *flat_aovs(), difference))]
    # a tenth of the mean square error is the bar of whole pictures
    assert grain[1] < grain[0] / 10**0.5


def test_fireflies_do_not_come_back_as_texture(monkeypatch: pytest.MonkeyPatch) -> None:
    """One path in a hundred pixels brings as much as all others: halves that meet two nearby seem to agree on them."""
    from nacre.picture.denoise import denoised

    generator = np.random.default_rng(11)
    truth = np.full((*SIZE, 3), 0.3) * [0.95, 1.0, 1.09]
    halves = []
    for _ in range(2):
        met = generator.random((*SIZE, 1)) < 0.01
        halves.append(truth * (generator.normal(1.0, 0.1, truth.shape) + met * generator.uniform(2.0, 8.0, met.shape)))
    noisy, difference = 0.5 * (halves[0] + halves[1]), np.asarray(0.5 * (halves[0] - halves[1]), dtype=np.float32)
    # all means come back in both
    monkeypatch.setattr(denoise, "beyond_chance", lambda mean, lost: np.ones_like(mean))
    without, found = (denoised(noisy, *flat_aovs(), *each)[..., 1] for each in ((), (difference,)))
    spots = [float(np.abs(each / np.median(each) - 1.0).max()) for each in (without, found)]
    assert spots[1] < 1.25 * spots[0]


def test_light_thrown_by_few_paths_does_not_come_back_as_specks() -> None:
    """A tenth of the pixels of each half met the lamp by way of a mirror: by chance both met it in some of them."""
    bright = specks = 0
    for seed in range(5):
        generator = np.random.default_rng(seed)
        halves = [
            np.where(generator.random((128, 128, 1)) < 0.1, generator.exponential(1.0, (128, 128, 1)), 0.0) * np.ones(3)
            for _ in range(2)
        ]
        met = 0.5 * (halves[0] + halves[1]) - 0.1
        back = denoise.beyond_noise(met, 0.5 * (halves[0] - halves[1]))
        bright, specks = bright + np.sum(met[..., 1] > 0.5), specks + np.sum(back[..., 1] > 0.5)
    assert specks < 0.01 * bright  # of a hundred bright ones not one; two did


@pytest.mark.parametrize("shape", [0.1, 0.35])
def test_light_of_few_wavelengths_does_not_come_back_as_coloured_specks(shape: float) -> None:
    """Narrow orders of a grating: each sample has a few wavelengths, whose colours both halves share by chance."""
    specks = []
    for seed in range(3):
        generator = np.random.default_rng(seed)
        halves = [generator.gamma(shape, 1.0 / shape, (96, 96, 3, 16)).mean(axis=-1) - 1.0 for _ in range(2)]
        met = 0.5 * (halves[0] + halves[1])
        back = denoise.beyond_noise(met, 0.5 * (halves[0] - halves[1]))
        noise = np.std(met[..., 0] - met[..., 1])
        specks.append(np.mean(np.abs(back[..., 0] - back[..., 1]) > 0.5 * noise))
    assert np.mean(specks) < 0.006  # 0.011 to 0.016 without the bound on a pixel's texture


def test_highlights_that_both_halves_hold_stay_as_bright_and_as_small() -> None:
    """Lamps mirrored in a wheel: spots of two pixels, thirty times as bright as what is about them."""
    from nacre.picture.denoise import denoised

    truth = np.full((*SIZE, 3), 0.1) * [0.95, 1.0, 1.09]
    places = np.random.default_rng(13).integers(8, 88, (24, 2))
    for row, column in places:
        truth[row : row + 2, column] = 3.0
    noisy, difference = noisy_pair(truth, 0.03)
    is_spot = truth[..., 1] > 1.0
    alone, found = (
        [float(np.mean((xyz / truth - 1.0)[where] ** 2)) for where in (is_spot, ~is_spot)]
        for xyz in (denoised(noisy, *flat_aovs()), denoised(noisy, *flat_aovs(), difference))
    )
    # a tenth of the mean square error is the bar of whole pictures; against the denoiser that knows no halves
    assert found[0] < alone[0] / 10
    assert found[1] < alone[1]  # no glow about them


def test_light_does_not_leave_an_object_with_the_means_of_its_colours() -> None:
    """A rim that the denoiser dims gives its light back to itself, not to the dark beside it."""
    from nacre.picture.denoise import beyond_noise, means

    lost = np.zeros((*SIZE, 3))
    lost[:, 40:42] = 0.2
    # an even noise would leave its own rounding alone, and the result to the processor
    noise = np.random.default_rng(17).normal(0.0, 1e-4, (*SIZE, 3))
    texture = beyond_noise(lost, noise)
    assert np.abs((texture + means(lost)) - lost).max() < 0.01 * lost.max()


def test_what_a_highlight_lost_is_not_taken_from_the_dark_beside_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """The denoiser is off by some per cent in a mirrored sun, which is more than all the light of what lies beside."""
    rows, columns = np.mgrid[:96, :96]
    sun = np.hypot(rows - 48, columns - 48) < 20
    truth = np.where(sun, 100.0, 0.1)[..., None] * np.array([0.95, 1.0, 1.09])
    made = np.where(sun[..., None], 1.04, 1.0) * truth

    def filtered(rgb: np.ndarray, aovs: object = None, **options: object) -> np.ndarray:
        return (made @ denoise.TO_RGB.T).astype(np.float32)

    monkeypatch.setattr(denoise, "_filtered", filtered)
    flat = np.zeros((96, 96, 3), dtype=np.float32)
    found = denoise.denoised(truth, flat, flat, 1e-3 * truth.astype(np.float32))
    np.testing.assert_allclose(found[~sun], truth[~sun], rtol=0.05)  # LARGEST_TEXTURE let it glow twice as bright
    assert found[sun].mean() == pytest.approx(truth[sun].mean(), rel=0.02)  # and its own comes back


def test_what_a_red_body_lost_leaves_no_seam_around_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures of walks have no halves; a car of a red pearl had a green seam along its roof."""
    body = np.mgrid[:96, :96][1] < 48
    truth = np.where(body[..., None], [0.5, 0.3, 0.3], 0.03 * np.array([0.95, 1.0, 1.09]))
    made = np.where(body[..., None], truth * np.array([1.2, 1.0, 0.9]), truth)
    monkeypatch.setattr(denoise, "_filtered", lambda *seen, **options: (made @ denoise.TO_RGB.T).astype(np.float32))
    flat = np.zeros((96, 96, 3), dtype=np.float32)
    found = denoise.denoised(truth, flat, flat)
    np.testing.assert_allclose(found[~body], truth[~body], rtol=0.05)  # the means of both took all but a tenth of X
    np.testing.assert_allclose(found[body].mean(axis=0), truth[body].mean(axis=0), rtol=0.02)


def test_halves_of_the_samples_give_the_noise_of_a_picture() -> None:
    from nacre.picture import passes
    from nacre.picture import picture as pictures

    material, found = nacre.material(GOLD), []
    real = passes.render_passes

    def noting(*arguments: Any) -> Any:
        found.append(real(*arguments))
        return found[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pictures, "render_passes", noting)
        for options in ({"spp": 16}, {"spp": 16}, {"noise": 0.5}, {"spp": 1}):
            render(material, seed=len(found), **options)
    first, second, by_noise, single = found
    spread = np.mean((first.xyz - second.xyz) ** 2) / 2.0
    stated = np.mean(first.difference**2)
    # halves of a sequence that evens itself out lie further apart than independent ones, never nearer; twice the
    # variance would be as if half of the samples did nothing
    assert 0.7 * spread < stated < 3.0 * spread
    assert by_noise.difference is not None and single.difference is None


def test_random_walks_have_no_halves_to_compare() -> None:
    """Their noise has such tails that spots of it would come back as texture."""
    from nacre.picture import passes

    flakes = [{"volume_fraction": 0.02, "substrate": {"material": "mica", "thickness_nm": 400.0}}]
    stratum = {"resin": {"n": 1.5}, "thickness_um": 30.0, "platelets": flakes}
    pearl = nacre.material({"family": "pearl", "strata": [stratum]})
    found = []

    def noting(*arguments: Any) -> Any:
        found.append(passes.render_passes(*arguments))
        return found[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("nacre.picture.picture.render_passes", noting)
        nacre.render.render(pearl, size=(16, 16), spp=2)
    assert found[0].difference is None and found[0].aovs


def test_fine_lines_keep_their_contrast() -> None:
    """Stripes of some four pixels on the sphere: a thickness that makes silver dark and bright by turns."""
    layer = {"material": "Ge", "thickness_nm": {"formula": "20 + 20*sin(2*pi*90*u)"}}
    material = nacre.material({"family": "film", "substrate": "Ag", "layers": [layer], "surface": {"roughness": 0.3}})
    long, short = (render(material, spp=spp, denoise=short, light="sky") for spp, short in ((256, False), (36, True)))

    def contrast(xyz: np.ndarray, pattern: np.ndarray) -> float:
        rows = xyz[40:60, 40:56, 1]
        return float(np.sum((rows - rows.mean()) * pattern) / np.sum(pattern**2))

    pattern = long.xyz[40:60, 40:56, 1] - long.xyz[40:60, 40:56, 1].mean()
    assert pattern.std() > 0.1 * long.xyz[40:60, 40:56, 1].mean()
    assert contrast(short.xyz, pattern) >= 0.9


def test_aovs_are_rendered_in_passes_with_bounded_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    from nacre.device.variant import use_variant
    from nacre.picture import passes

    mi, asked = use_variant(), []
    real = mi.render

    def noting(*arguments: Any, **options: Any) -> Any:
        asked.append(options["spp"])
        return real(*arguments, **options)

    monkeypatch.setattr(mi, "render", noting)
    monkeypatch.setattr(passes, "PASS_SAMPLES", 4 * SIZE[0] * SIZE[1])
    assert render(nacre.material(GOLD), spp=16).stats["denoised"]
    assert max(asked) <= 4 and sum(asked) == 16 + denoise.EVEN_AOV_SPP
    asked.clear()
    assert render(nacre.material(GOLD), spp=1).stats["denoised"]
    assert sum(asked) == 1 + 4  # AOVs do not take longer than the picture


def test_the_albedo_of_an_even_colour_has_no_grain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four wavelengths a path would leave 6 % between neighbours, which the denoiser takes for texture of the ball."""
    from nacre.picture import picture

    found: list[np.ndarray] = []
    real = picture.denoised
    monkeypatch.setattr(picture, "denoised", lambda xyz, *g: found.append(g[0]) or real(xyz, *g))
    blue = {"family": "film", "substrate": "Si", "layers": [{"material": "TiO2", "thickness_nm": 45.0}]}
    render(nacre.material({**blue, "surface": {"roughness": 0.3}}), spp=4, light="sky")
    middle = found[0][40:56, 40:56, 2]
    assert np.abs(np.diff(middle, axis=1)).mean() < 0.01 * middle.mean()


@pytest.mark.parametrize(("recipe", "is_alike"), [("gold", True), ("soap", True), ("pearl/bottle3", False)])
def test_aovs_use_individual_numbers_if_paths_are_random(
    recipe: str, is_alike: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A share of one in twenty would be met by no sample here, by all there: patterns of random walks."""
    from nacre.picture import passes as tiling

    asked: list[bool] = []
    real = tiling.begin
    monkeypatch.setattr(tiling, "begin", lambda *given: asked.append(given[-1]) or real(*given))
    nacre.render.render(nacre.load(examples_folder() / f"{recipe}.toml"), size=(16, 16), spp=1)
    assert asked[-1] is is_alike and not any(asked[:-1])


def test_the_albedo_of_a_clear_film_shows_mirror_images_and_background_without_grain(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A way drawn in each pixel, as one in four are mirrored here, left grain, and with it mirrored edges went."""
    from nacre.picture import picture

    found: list[np.ndarray] = []
    real = picture.denoised
    monkeypatch.setattr(picture, "denoised", lambda xyz, *g: found.append(g[0]) or real(xyz, *g))
    film = {"family": "film", "substrate": "air", "layers": [{"material": "TiO2", "thickness_nm": 60.0}]}
    for spp in (4, 64):
        render(nacre.material(film), spp=spp)
    few, many = (albedo[..., 1] for albedo in found)
    # edges, of few places in a pixel, are uneven; grain would be everywhere (.06, with the ways drawn in each pixel)
    assert np.median(np.abs(np.diff(few / many, axis=1))) < 0.01


def test_frames_without_the_denoiser_are_not_kept_beside_frames_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def kept() -> int:
        made = nacre.render.animate(
            nacre.material(GOLD), "light", tmp_path / "a.gif", frames=2, size=(16, 16), spp=1, progress=False
        )
        return made.reused

    monkeypatch.setenv("NACRE_DENOISE", "0")
    assert [kept(), kept()] == [0, 2]
    monkeypatch.delenv("NACRE_DENOISE")
    assert kept() == 0


def test_a_large_picture_is_denoised_in_bands_without_seams(monkeypatch: pytest.MonkeyPatch) -> None:
    from nacre.picture import denoise

    rng = np.random.default_rng(1)
    x, y = np.meshgrid(np.linspace(0, 1, 64), np.linspace(0, 1, 700))
    truth = np.stack([0.2 + 0.5 * y + 0.1 * x] * 3, axis=-1) * [0.95, 1.0, 1.09]
    noisy = truth * rng.gamma(20.0, 0.05, truth.shape)
    albedo, normal = np.full(truth.shape, 0.5, np.float32), np.zeros(truth.shape, np.float32)
    whole = denoise.denoised(noisy, albedo, normal)
    monkeypatch.setattr(denoise, "STRIP_PIXELS", 1)
    parts = denoise.strips(700, 64)
    assert [kept for _, kept, _ in parts] == [slice(0, 256), slice(256, 512), slice(512, 700)]
    split = denoise.denoised(noisy, albedo, normal)
    assert np.abs(noisy - truth).mean() > 10 * np.abs(whole - truth).mean()
    # far below what grain is left, at the seams as anywhere
    assert np.abs(split - whole).max() < 0.25 * np.abs(whole - truth).max()
    clean = denoise.clean_albedo(np.clip(noisy, 0, 1).astype(np.float32))
    assert clean.shape == albedo.shape and np.isfinite(clean).all()


def test_a_bound_on_the_denoisers_memory_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    from nacre.picture import denoise

    rng = np.random.default_rng(2)
    picture = rng.gamma(2.0, 0.2, (400, 640, 3))
    albedo, normal = rng.random((400, 640, 3)).astype(np.float32), np.zeros((400, 640, 3), np.float32)
    asked: list[int] = []

    def both() -> list[Any]:
        return [denoise.denoised(picture, albedo, normal), denoise.clean_albedo(albedo)]

    whole = both()
    import mitsuba_oidn

    real = mitsuba_oidn.Device
    monkeypatch.setattr(mitsuba_oidn, "Device", lambda: asked.append(1) or real())
    monkeypatch.setattr(denoise, "TILED_FROM", 0)
    monkeypatch.setattr(denoise, "TILED_MB", 64)
    for tiled, expected in zip(both(), whole, strict=True):
        np.testing.assert_allclose(tiled, expected, rtol=1e-4, atol=1e-5)
    assert len(asked) == 2


def test_glints_and_spectra_stay_as_rendered(tmp_path: Path) -> None:
    from nacre.picture.denoise import inapplicable_reason

    flakes = {
        "volume_fraction": 0.01, "coatings": [{"material": "TiO2", "thickness_nm": 60}],
        "substrate": {"material": "mica", "thickness_nm": 400}, "diameter_um": 200, "normal_deviation": 0.15,
    }  # fmt: skip
    stratum = {"resin": {"n": 1.5}, "thickness_um": 50, "roughness": 0.05, "platelets": [flakes]}
    pearl = {"family": "pearl", "strata": [stratum], "base": {"albedo": 0.5}}
    grid = np.array([450.0, 550.0, 650.0])
    for quality in ("reference", "fast"):
        plain = nacre.material({**pearl, "quality": quality}).bsdf(grid)
        sparkling = nacre.material({**pearl, "quality": quality, "glints": {"surface_mm": 100}}).bsdf(grid)
        assert inapplicable_reason(plain) == "" and "glints" in inapplicable_reason(sparkling)
    result = render(nacre.material(GOLD), spp=1, spectral=True)
    assert not result.stats["denoised"] and result.raw is None


def test_a_picture_of_one_pixel_is_denoised(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of it nothing is lost, and its noise is not given in units of that."""
    monkeypatch.delenv("NACRE_DENOISE", raising=False)
    made = nacre.render("oil-slick", size=(1, 1), spp=16)
    assert made.stats["denoised"] and np.isfinite(made.xyz).all() and (made.xyz > 0.0).all()


def test_without_the_package_the_picture_is_raw_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mitsuba_oidn", None)
    result = render(nacre.material(GOLD), spp=1)
    assert not result.stats["denoised"] and "cannot be imported" in result.stats["raw_because"]


def test_an_exr_shows_the_same_picture_with_layers_of_more_samples(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[int, int]] = []
    real = passes._aov_counts

    def noting(*arguments: Any) -> Any:
        asked.append(real(*arguments))
        return asked[-1]

    monkeypatch.setattr(passes, "_aov_counts", noting)
    shown, layered = (render(nacre.material(GOLD), spp=16, output=tmp_path / name) for name in ("a.png", "a.exr"))
    few, many = denoise.EVEN_AOV_SPP, denoise.AOV_SPP
    assert asked == [(few, few), (few, many)]
    # threads add the samples of a pixel in any order, so single precision is all that can be had
    np.testing.assert_allclose(layered.xyz, shown.xyz, rtol=1e-3, atol=1e-4)
    difference = np.abs(layered.layers["albedo"][1] - shown.layers["albedo"][1])
    assert 0.0 < difference.mean() < 0.02  # another draw of the same


def test_an_exr_holds_the_raw_picture_as_a_layer(tmp_path: Path) -> None:
    import OpenEXR

    result = render(nacre.material(GOLD), spp=2, output=tmp_path / "a.exr")
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        channels = file.channels()
        assert {"R", "G", "B", "raw.R", "raw.G", "raw.B"} <= set(channels)
        difference = np.abs(channels["R"].pixels - channels["raw.R"].pixels)
    assert difference.max() > 0
    plain = render(nacre.material(GOLD), spp=2, denoise=False)
    assert plain.raw is None and not plain.stats["denoised"] and result.raw is not None
