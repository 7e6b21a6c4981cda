"""What the preview is drawn from: the stage and its light, where spread light goes, how coarse a draft is."""

from __future__ import annotations

import numpy as np
import pytest

import nacre
from nacre.core.arrays import direction
from nacre.formats.lut import lobe_directions, lobe_weight
from nacre.light import spectrum_to_rgb_linear, spectrum_to_xyz
from nacre.picture.environments import studio
from nacre.recipe.toml import parse_toml
from nacre.studio import appearance, surroundings
from nacre.studio.appearance import (
    DRAFTS,
    LOBE_NM,
    LOBE_SHAPE,
    SLOW_DRAFT_S,
    AdaptiveQuality,
    appearances,
    lobe_image,
)
from nacre.studio.edit import edited

ROWS = 64
HARDLY_SEEN = 0.2  # of the tristimulus values of a ground of 2 %: a step of 2 in lightness or chroma
QUADRATURE = 0.02  # of the room's light: a direction stands for a patch of 5.6 degrees


def test_a_balls_shade_in_an_even_room_is_its_form_factor() -> None:
    """Of a sphere from a plane element below it that faces up: cos / d^2, here (r^2 + 1)^(-3/2)."""
    left = surroundings.ball_shade(np.ones((ROWS, 2 * ROWS)))
    share = (np.arange(ROWS) + 0.5) / ROWS
    far = surroundings.MEDIAN_DISTANCE * share / (1.0 - share)
    known = 1.0 - (far**2 + 1.0) ** -1.5
    inner = slice(1, ROWS - 1)  # the outermost rows hold the values of the middle of larger cells
    np.testing.assert_allclose(left[inner].mean(axis=1), known[inner], atol=QUADRATURE)
    assert np.ptp(left, axis=1).max() < 2 * QUADRATURE  # the same all round


def test_a_balls_shade_falls_away_from_the_light() -> None:
    left = surroundings.ball_shade(studio("D65", ROWS).weights[0])
    row, columns = ROWS // 3, 2 * ROWS
    key = round(216 / 360 * columns)  # azimuth of the largest soft box
    assert left[row, (key + columns // 2) % columns] < left[row, key] - 0.02


@pytest.mark.parametrize("name", ["studio", "street"])
def test_a_place_that_is_kept_between_runs_is_the_place_that_was_made(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    surroundings._blurred_surroundings.cache_clear()
    made = surroundings.blurred_surroundings(name)
    surroundings._blurred_surroundings.cache_clear()  # as in the next run
    monkeypatch.setattr(surroundings, "_computed", lambda name: pytest.fail("it was made anew"))
    kept = surroundings.blurred_surroundings(name)
    assert kept.layers.dtype == np.float32
    assert kept.packed() == made.packed()


def test_the_stage_is_darker_the_less_sky_it_sees() -> None:
    lit = surroundings.stage_light(np.ones((ROWS, 2 * ROWS)))
    assert lit.max() <= 1.0 + QUADRATURE and lit.min() > 0.0
    along = lit.mean(axis=1)
    assert along[0] > 0.97  # its front edge sees all of an even sky but the far wall
    # the wall looks into a quarter of the sky above, and below on the stage, but for what is seen past its edges
    assert 0.5 - QUADRATURE < along[-1] < 0.75


def test_rays_meet_the_floor_the_bend_and_the_wall() -> None:
    start = np.array([0.0, 0.0, 1.0])
    d = np.array([[0.0, 0.6, -0.8], [0.0, 1.0, 0.0], [0.0, 0.925, 0.38], [0.0, 0.5, 0.866], [0.0, -1.0, 0.0]])
    hits, where = surroundings.stage_hit(start, d)
    assert hits.tolist() == [True, True, True, False, False]
    assert where[0, 0] == pytest.approx(surroundings.FRONT + 0.75)
    # at height 1 the bend, a quarter circle of radius r, has turned by acos(1 - 1/r)
    assert where[1, 0] == pytest.approx(
        surroundings.FLOOR + surroundings.RADIUS * np.arccos(1.0 - 1.0 / surroundings.RADIUS)
    )
    assert surroundings.FLOOR < where[2, 0] < surroundings.LENGTH


def test_a_picture_of_where_light_goes_holds_the_materials_own_values() -> None:
    material = nacre.load("metasurface/silver_on_oxide").at_low_fidelity()
    same = lambda values, wavelengths: values[:, :3]  # three wavelengths in place of colours
    made = lobe_image(material, None, same)
    assert made is not None and made.shape == (*LOBE_SHAPE, 3)
    wi, wo = lobe_directions(*LOBE_SHAPE)
    row, column = LOBE_SHAPE[1] // 2, LOBE_SHAPE[2] // 2
    pair = wi[1, row, column], wo[1, row, column]
    own = material.bsdf(LOBE_NM[:3]).evaluate(*pair)
    np.testing.assert_allclose(made[1, row, column], np.pi * own * lobe_weight(*pair), rtol=0.02)


def test_a_pearls_picture_is_made_of_the_colours_that_its_walk_sends_there() -> None:
    """In the mirror direction, beside it, and far from it, where the base shows that dark parts are seen by."""
    model = nacre.load("pearl/bottle3").model
    for eye_deg in (0.0, 40.0):
        light_rad = np.radians(np.array([-60.0, -eye_deg - 5.0, -eye_deg, 0.5, 50.0]))
        wi = np.stack([np.sin(light_rad), 0.0 * light_rad, np.cos(light_rad)], axis=-1)
        eye = np.broadcast_to(direction(np.radians(eye_deg)), wi.shape).copy()
        sure, guessed = model.surrogate_radiance(eye, wi, LOBE_NM)
        traced, _ = model.estimate_radiance(eye, wi, LOBE_NM, 20_000, 1)
        own, known = (spectrum_to_xyz(values, LOBE_NM) for values in (sure + guessed, traced))
        np.testing.assert_allclose(own, known, rtol=HARDLY_SEEN)


def test_a_film_has_no_such_picture_and_needs_no_draft() -> None:
    found = list(appearances(nacre.load("blue-oxide"), "D65", lambda: False))
    assert [one.is_draft for one in found] == [False] and found[0].lobe is None
    assert found[0].facets["distribution"] == "ggx" and not found[0].is_clear
    assert next(appearances(nacre.load("gold"), "D65", lambda: False)).is_clear  # its glass is, as pictures count it


def test_only_a_free_film_is_seen_through_in_the_preview() -> None:
    """Light goes on straight; what it leaves is what it does not mirror, as a soap film takes up nothing."""
    bubble = next(appearances(nacre.load("soap"), "D65", lambda: False))
    assert bubble.transmitted_rgb is not None
    white = spectrum_to_rgb_linear(np.ones((1, 471)), np.arange(360.0, 831.0))
    np.testing.assert_allclose(bubble.transmitted_rgb + bubble.mirror_rgb, white * np.ones((91, 1)), atol=2e-3)
    glass = nacre.load("coated-glass-400")  # bends what passes
    found = next(appearances(glass, "D65", lambda: False))
    assert found.transmitted_rgb is None and any("through the substrate" in note for note in found.notes)


def test_a_film_that_was_quick_once_needs_no_draft_on_a_busy_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    layers = [{"material": "SiO2", "thickness_nm": 130}, {"material": "Ag", "thickness_nm": 7}]
    film = nacre.material({"family": "film", "substrate": "Si", "layers": layers})
    next(appearances(film, "D65", lambda: False))
    monkeypatch.setattr(appearance, "QUICK_S", 0.0)  # no clock is that fast
    varied = film.vary({"layers[0].thickness_nm": 140.0})
    assert [found.is_draft for found in appearances(varied, "D65", lambda: False)] == [False]
    other = nacre.material({"family": "film", "substrate": "Ge", "layers": layers})
    assert next(appearances(other, "D65", lambda: False)).is_draft


def test_drafts_grow_coarser_where_they_are_slow_and_finer_where_they_are_swift() -> None:
    drafts = AdaptiveQuality()
    for _ in range(2):
        drafts.update("pearl", 2 * SLOW_DRAFT_S)
    assert drafts.of("pearl") is DRAFTS[1] and drafts.of("relief") is DRAFTS[0]
    for _ in range(9):
        drafts.update("pearl", 2 * SLOW_DRAFT_S)
    assert drafts.of("pearl") is DRAFTS[-1]
    for _ in range(9):
        drafts.update("pearl", 0.0)
    assert drafts.of("pearl") is DRAFTS[0]
    counts = [(len(care.angles_deg), len(care.wavelengths_nm), care.nodes) for care in DRAFTS]  # type: ignore[arg-type]
    assert counts == sorted(counts, reverse=True)


COMMENTED = """family = "film"  # thickness_nm = 5
substrate = "Si"
layers = [
  {thickness_nm = 60, material = "SiO2"},  # oxide
  {material = "TiO2", thickness_nm = 6e1},
]
[surface]
roughness = 0.1
"""


@pytest.mark.parametrize("path", ["layers[0].thickness_nm", "layers[1].thickness_nm", "surface.roughness"])
@pytest.mark.parametrize("value", [7, 0.25, 1e-5])
def test_a_number_is_exchanged_where_it_stands(path: str, value: float) -> None:
    """Also where a comment or another layer has a number of the same name."""
    made = edited(COMMENTED, [{"path": path, "op": "set", "value": value}], "film.toml")
    wanted = parse_toml(COMMENTED, "film.toml")
    holder = wanted["surface"] if path.startswith("surface") else wanted["layers"][int(path[7])]
    holder[path.rpartition(".")[2]] = value
    assert parse_toml(made, "film.toml") == wanted
    assert "# oxide" in made and "# thickness_nm = 5" in made


@pytest.mark.full
def test_aligned_particles_are_drawn_in_the_plane_of_u_and_say_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(appearance, "lobe_image", lambda *_: pytest.fail("its picture would hold no azimuth"))
    rods = nacre.load("silver_rods")
    seen = {
        turn: list(appearances(rods.vary({"particle.turn_deg": turn}), "D65", lambda: False)) for turn in (0.0, 90.0)
    }
    for one in (each for both in seen.values() for each in both):
        assert appearance.ALIGNED_NOTE in one.notes and one.lobe is None
    mirrors = [both[-1].mirror_rgb for both in seen.values()]
    assert np.abs(mirrors[0] - mirrors[1]).max() > 0.1 * mirrors[0].max()


def test_a_graded_film_is_drawn_with_the_colours_of_its_places() -> None:
    text = {
        "family": "film", "substrate": "Si",
        "layers": [{"material": "SiO2", "thickness_nm": {"formula": "100 + 300*u"}},
                   {"material": "TiO2", "thickness_nm": {"formula": "20 + 60*v"}}],
    }  # fmt: skip
    (found,) = appearances(nacre.material(text), "D65", lambda: False)
    assert found.grades is not None
    tables, place = found.grades["tables"], found.grades["map"]
    second, first = tables.shape[1:3]
    row, column = 200, 40  # v, u at centres of texels of the map
    u, v = (column + 0.5) / place.shape[1], (row + 0.5) / place.shape[0]
    layers = [{"material": "SiO2", "thickness_nm": 100 + 300 * u}, {"material": "TiO2", "thickness_nm": 20 + 60 * v}]
    (uniform,) = appearances(nacre.material({**text, "layers": layers}), "D65", lambda: False)
    x, y = place[row, column] * [first - 1, second - 1]
    i, j = int(x), int(y)
    rows = [(1 - x + i) * tables[0, k, i] + (x - i) * tables[0, k, i + 1] for k in (j, j + 1)]
    drawn = (1 - y + j) * rows[0] + (y - j) * rows[1]
    # linear interpolation over 12 nm of each layer: a hundredth of a white
    np.testing.assert_allclose(drawn[:80], uniform.mirror_rgb[:80], atol=0.012)
    rough = {**text, "layers": [], "surface": {"roughness": {"formula": "0.1 + 0.1*u"}}}
    (uneven,) = appearances(nacre.material(rough), "D65", lambda: False)
    assert uneven.grades is None and len(uneven.notes) == 1


def test_a_mask_is_drawn_over_the_surface() -> None:
    part = {"family": "film", "substrate": "Au"}
    blend = {
        "family": "blend",
        "first": part,
        "second": {"family": "film", "substrate": "Ag"},
        "mask": {"formula": "u"},
    }
    *_, found = appearances(nacre.material(blend), "D65", lambda: False)
    assert found.grades is not None and not found.is_draft
    tables = found.grades["tables"][:3].sum(axis=0)[0]
    for node, substrate in ((0, "Ag"), (-1, "Au")):
        *_, pure = appearances(nacre.material({**part, "substrate": substrate}), "D65", lambda: False)
        np.testing.assert_allclose(tables[node, 0], pure.mirror_rgb[0], atol=0.02)
