"""Samples of pictures: even in all dimensions, the same however they are divided, and honest of their noise."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.stats import kstest

import nacre
from nacre.device.variant import use_variant
from nacre.picture import passes
from nacre.picture.plugins import TILE, begin, continued_sampler

PIXELS = 512
GREY: dict[str, Any] = {"type": "diffuse", "reflectance": 0.5}


def drawn(parts: list[tuple[int, int]], seed: int = 3, skip: int = 0) -> np.ndarray:
    """`[pixel, sample, 3]`: a pair and a single number, of passes (first, samples a pixel)."""
    use_variant()
    found = []
    for first, spp in parts:
        sampler = continued_sampler()
        begin(sampler, seed, first, spp)
        sampler.seed(0, PIXELS * spp)
        for _ in range(skip):
            sampler.next_2d()
        pair, one = sampler.next_2d(), sampler.next_1d()
        found.append(np.stack([pair.x, pair.y, one], axis=-1).reshape(PIXELS, spp, 3))
    return np.concatenate(found, axis=1)


@pytest.mark.parametrize("first", [0, 64, 4096 - 64])
def test_every_elementary_interval_holds_its_share(first: int) -> None:
    """Sobol's defining property, kept by Owen's scrambling: 64 points, one in each box of 2^-a by 2^-(6-a)."""
    points = drawn([(first, 64)])
    for a in range(7):
        columns, rows = 2**a, 2 ** (6 - a)
        box = np.floor(points[..., 0] * columns) * rows + np.floor(points[..., 1] * rows)
        assert np.array_equal(np.sort(box, axis=1), np.tile(np.arange(64.0), (PIXELS, 1)))
    assert np.array_equal(np.sort(np.floor(points[..., 2] * 64), axis=1), np.tile(np.arange(64.0), (PIXELS, 1)))


def test_passes_of_any_size_take_the_same_samples() -> None:
    whole = drawn([(0, 48)])
    np.testing.assert_array_equal(drawn([(0, 1), (1, 7), (8, 32), (40, 8)]), whole)


def test_neighbours_share_a_sequence_where_its_length_is_known() -> None:
    """512 pixels of two whole tiles: each pixel's samples are even, those of a tile together far more so."""
    use_variant()
    found = []
    for first, spp in ((0, 5), (5, 11)):
        sampler = continued_sampler()
        begin(sampler, 3, first, spp, total=16, width=32)
        sampler.seed(0, PIXELS * spp)
        pair = sampler.next_2d()
        found.append(np.stack([pair.x, pair.y], axis=-1).reshape(16, 32, spp, 2))
    points = np.concatenate(found, axis=2)
    for a in range(5):  # of a pixel: 16 points, one in each box of 2^-a by 2^-(4-a)
        box = np.floor(points[..., 0] * 2**a) * 2 ** (4 - a) + np.floor(points[..., 1] * 2 ** (4 - a))
        assert np.array_equal(np.sort(box, axis=-1), np.broadcast_to(np.arange(16.0), (16, 32, 16)))
    for tile in (points[:, :16], points[:, 16:]):  # 4,096 points
        for a in range(13):
            box = np.floor(tile[..., 0] * 2**a) * 2 ** (12 - a) + np.floor(tile[..., 1] * 2 ** (12 - a))
            assert np.array_equal(np.sort(box.ravel()), np.arange(4096.0))
    assert not np.array_equal(points[:, :16], points[:, 16:])


def test_several_points_of_each_sample_are_even_among_those_of_all_samples() -> None:
    """16 samples of four points: 64, one in each box of 2^-a by 2^-(6-a), also where they are drawn in two passes."""
    use_variant()
    found = []
    for first, spp in ((0, 5), (5, 11)):
        sampler = continued_sampler()
        begin(sampler, 3, first, spp)
        sampler.seed(0, PIXELS * spp)
        point = sampler.several_2d(use_variant().UInt32(4))
        drawn_here = [point(number) for number in range(4)]
        found.append(np.stack([np.stack([each.x, each.y], -1).reshape(PIXELS, spp, 2) for each in drawn_here], 2))
    points = np.concatenate(found, axis=1).reshape(PIXELS, 64, 2)
    for a in range(7):
        box = np.floor(points[..., 0] * 2**a) * 2 ** (6 - a) + np.floor(points[..., 1] * 2 ** (6 - a))
        assert np.array_equal(np.sort(box, axis=1), np.tile(np.arange(64.0), (PIXELS, 1)))


def test_one_sample_of_many_pixels_is_uniform_and_pixels_seeds_and_dimensions_are_strangers() -> None:
    points = drawn([(5, 1)])[:, 0]
    others = [drawn([(5, 1)], seed=4)[:, 0], drawn([(5, 1)], skip=1)[:, 0], np.roll(points, 1, axis=0), points[:, ::-1]]
    for column in range(3):
        assert kstest(points[:, column], "uniform").pvalue > 1e-3
        for other in others:
            if other[0, column] != points[0, column]:
                assert abs(np.corrcoef(points[:, column], other[:, column])[0, 1]) < 4 / np.sqrt(PIXELS)
    assert (points >= 0).all() and (points < 1).all()


def test_a_picture_is_the_same_however_many_samples_a_pass_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NACRE_DENOISE", raising=False)
    asked: dict[str, Any] = {"size": (24, 24), "spp": 24, "denoise": True}  # whose raw pixels share no samples
    at_once = nacre.render(GREY, **asked).raw
    monkeypatch.setattr(passes, "PASS_SAMPLES", 5 * 24 * 24)
    np.testing.assert_allclose(nacre.render(GREY, **asked).raw, at_once, rtol=1e-4, atol=1e-6)


def test_pictures_on_the_way_have_twice_the_samples_and_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NACRE_DENOISE", raising=False)
    asked: dict[str, Any] = {"size": (24, 24), "noise": 0.03}
    better: list[Any] = []
    last = nacre.render(GREY, **asked, on_better=better.append)
    taken = [each.stats["spp"] for each in better]
    assert len(taken) > 1 and all(b >= 2 * a for a, b in zip(taken, taken[1:])) and taken[-1] < last.stats["spp"]
    np.testing.assert_allclose(last.xyz, nacre.render(GREY, **asked).xyz, rtol=1e-4, atol=1e-6)
    assert all(each.stats["denoised"] and each.rgb.shape == last.rgb.shape for each in better)


def test_small_passes_are_quieter_than_mitsubas_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """64 samples in passes of 4, as a picture of 1024 x 1024 takes them: Mitsuba's start afresh each time."""
    monkeypatch.setattr(passes, "PASS_SAMPLES", 4 * 24 * 24)

    def variance() -> float:
        made = [nacre.render(GREY, size=(24, 24), spp=64, seed=seed, denoise=False).xyz[..., 1] for seed in range(8)]
        return float(np.median(np.var(made, axis=0) / np.mean(made, axis=0) ** 2))

    ours = variance()
    monkeypatch.setattr(passes, "continued_sampler", lambda: use_variant().load_dict({"type": "multijitter"}))
    assert ours < variance()  # of 24 seeds .85 times as much; of 8, over so many pixels, known to .04


def test_the_noise_that_a_picture_states_is_that_of_its_pixels() -> None:
    asked: dict[str, Any] = {"size": (32, 32), "zoom": 3.0, "denoise": False}  # so near that all of them see the ball
    made = [nacre.render(GREY, **asked, noise=0.04, seed=seed) for seed in range(12)]
    luminance = np.array([each.xyz[..., 1] for each in made])
    found = float(np.median(np.std(luminance, axis=0, ddof=1) / np.mean(luminance, axis=0)))
    stated = float(np.median([each.stats["noise"] for each in made]))
    # 12 pictures give a standard deviation to 21 % a pixel, and the median of a thousand pixels to far less
    assert found == pytest.approx(stated, rel=0.1)


def test_the_measured_noise_is_that_of_the_object() -> None:
    """A car in a street is small in its picture; the houses, seen directly, have hardly any noise."""
    asked: dict[str, Any] = {"scene": "sphere", "light": "street", "zoom": 0.4, "size": (32, 32), "exposure": 0.0}
    is_object = nacre.render(GREY, **asked, background="transparent", spp=16).alpha > 0.5  # in its middle, as evaluated
    assert 0.02 < is_object.mean() < 0.3
    made = [nacre.render(GREY, **asked, noise=0.05, seed=seed, denoise=False) for seed in range(12)]
    luminance = np.array([each.xyz[..., 1] for each in made])
    of_pixels = np.std(luminance, axis=0, ddof=1) / np.mean(luminance, axis=0)
    stated = float(np.median([each.stats["noise"] for each in made]))
    assert float(np.median(of_pixels)) < 0.85 * stated  # that of all pixels would have ended it far earlier
    # 12 pictures give a standard deviation to 21 % a pixel, and the median of a hundred pixels to 4 %
    assert float(np.median(of_pixels[is_object])) == pytest.approx(stated, rel=0.15)


def test_without_a_pixel_that_sees_the_object_all_of_them_count() -> None:
    part = passes.pass_plan(2, 1, True)
    found = []
    for evaluated in (None, np.zeros((4, 4), dtype=bool), np.eye(4, dtype=bool)):
        spread = passes.Spread(evaluated)
        spread.add(np.full((4, 4), 1.0), part[0])
        spread.add(1.0 + 0.2 * (1.0 - np.eye(4)), part[1])
        found.append(spread.noise())
    assert found[0] is not None and found[0] > 0.05
    assert found[1] == found[0] and found[2] == 0.0


@pytest.mark.parametrize("at_once", [5, 1 << 20])
def test_the_pixels_that_see_the_object_are_those_that_it_covers(at_once: int) -> None:
    from nacre.picture.paths import sees_objects
    from nacre.picture.picture import scene_dict

    mi = use_variant()
    content = scene_dict(None, "knob", size=(24, 16))
    scene = mi.load_dict({key: value for key, value in content.items() if key != "integrator"})
    shapes = [value for key, value in content.items() if key.startswith("part")]
    seen = sees_objects(scene, content["sensor"], shapes, (24, 16), at_once)
    cover = nacre.render(GREY, scene="knob", size=(24, 16), background="transparent", spp=64, denoise=False).alpha
    assert seen.shape == (16, 24) and seen.any()
    # the film's filter is wider than a pixel
    assert seen[cover > 0.95].all() and not seen[cover < 0.05].any()


def test_the_pixels_of_a_tile_take_one_run_of_a_sequence() -> None:
    """Gaps between their shares would leave the tile's mean as noisy as samples that know nothing of each other."""
    use_variant()
    sampler, spp = continued_sampler(), 5
    begin(sampler, 3, 0, spp, spp, TILE)
    sampler.seed(0, spp * TILE * TILE)
    assert np.array_equal(np.sort(np.array(sampler.index)), np.arange(spp * TILE * TILE))
