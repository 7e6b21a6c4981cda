"""Target files: every published family is accepted, everything bad is refused in one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from nacre.core.errors import RecipeError
from nacre.optimise.relief import target
from nacre.optimise.run import read_target

BASE = """
family = "relief"
features = 16
feature_um = 0.8
blur_um = 0.13
height_max_um = 0.8
coating = "Al"
coherence = {sigma = 0.9}
[target]
"""
EXAMPLES = sorted((Path(__file__).resolve().parents[2] / "examples" / "targets").glob("*.toml"))
EXAMPLES = [path for path in EXAMPLES if "[target]" in path.read_text().splitlines()]


def built(folder: Path, target: str, search: str = "", base: str = BASE) -> np.ndarray:
    path = folder / "t.toml"
    path.write_text(f"{base}{target}\n[search]\n{search}\n")
    return read_target(path).problem.views[0].target


@pytest.mark.parametrize("path", EXAMPLES, ids=[p.stem for p in EXAMPLES])
def test_example_targets_are_valid(path: Path) -> None:
    assert read_target(path).problem.target.max() > 0.3


def test_every_published_kind_has_an_example() -> None:
    kinds = {read_target(path).spec.target.kind for path in EXAMPLES}
    assert {"anti-mirror", "anisotropic-anti-mirror", "gaussian", "uniform", "image", "inverted-image"} <= kinds


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        ("anti-mirror", "anti_mirror"),
        ("anisotropic-anti-mirror", "aniso_anti_mirror"),
        ("gaussian", "diffuse"),
        ("uniform", "uniform"),
    ],
)
def test_published_names_mean_the_same(tmp_path: Path, ours: str, theirs: str) -> None:
    a, b = (built(tmp_path, f'kind = "{kind}"\nrange = 0.3') for kind in (ours, theirs))
    assert np.array_equal(a, b)


def test_published_colours_are_not_css() -> None:
    assert target.parse_colour("green", "x").tolist() == [0, 1, 0]
    assert target.parse_colour("purple", "x").tolist() == [0.5, 0, 1]
    assert np.allclose(target.parse_colour("#ff8000", "x"), [1, 128 / 255, 0])
    assert np.allclose(target.parse_colour("#f80", "x"), [1, 136 / 255, 0])


def test_iridescent_colours_change_with_direction(tmp_path: Path) -> None:
    half = built(tmp_path, 'kind = "uniform"\ncolour = "iridescent-half"\nrange = 0.3')[0]
    assert half[0, -1].tolist() == [0, 0, 1] and half[0, 0].tolist() == [1, 0, 0]
    disk = built(tmp_path, 'kind = "uniform"\ncolour = "iridescent-disk"\niridescent_range = 0.1\nrange = 0.3')[0]
    inverted = built(
        tmp_path, 'kind = "uniform"\ncolour = "inverted-iridescent-disk"\niridescent_range = 0.1\nrange = 0.3'
    )[0]
    assert disk[32, 32].tolist() == [1, 0, 0] and disk[0, 0].tolist() == [0, 0, 1]
    assert np.allclose(disk + inverted, [1, 0, 1])


def test_image_rows_run_along_x(tmp_path: Path) -> None:
    pixels = np.zeros((512, 512, 3), dtype=np.uint8)
    pixels[:256] = [255, 0, 0]
    Image.fromarray(pixels).save(tmp_path / "half.png")
    target = built(tmp_path, 'kind = "image"\nimage = "half.png"\nimage_scale = 2.0\nrange = 0.2')[0]
    assert target[20, 20].tolist() == [1, 0, 0] and target[44, 20].max() == 0


def test_an_array_target_is_used_unchanged(tmp_path: Path) -> None:
    wanted = np.random.default_rng(1).random((16, 16, 3))
    np.save(tmp_path / "wanted.npy", wanted)
    target = built(tmp_path, 'kind = "array"\nfile = "wanted.npy"\nrange = 0.2\nresolution = 16')
    assert np.array_equal(target[0], wanted)


def test_a_spectrum_is_a_colour(tmp_path: Path) -> None:
    nm = np.arange(380, 781, 5)
    np.savetxt(tmp_path / "red.csv", np.stack([nm, (nm > 600) * 1.0], axis=1), delimiter=",")
    target = built(tmp_path, 'kind = "uniform"\ncolour = {spectrum = "red.csv"}\nrange = 0.2')[0]
    rows = np.stack([nm * 1e-3, (nm > 600) * 1.0, nm], axis=1)
    np.savetxt(tmp_path / "red.txt", rows)
    stated = '{file = "red.txt", unit = "um", columns = ["wavelength", "reflectance", "-"]}'
    same = built(tmp_path, f'kind = "uniform"\ncolour = {{spectrum = {stated}}}\nrange = 0.2')[0]
    np.testing.assert_allclose(same, target, atol=1e-6)
    assert target[0, 0, 0] > 0.7 > target[0, 0, 1]


def test_several_incidences_get_a_target_each(tmp_path: Path) -> None:
    target = built(tmp_path, 'kind = "anti-mirror"\nrange = 0.2', "incidence_deg = [[0, 0], [30, 90]]")
    assert target.shape == (2, 64, 64, 3) and not np.allclose(target[0], target[1])


def test_a_free_scale_has_a_brightness_floor_of_its_own(tmp_path: Path) -> None:
    def floor(more: str) -> float:
        path = tmp_path / "t.toml"
        path.write_text(f'{BASE}kind = "uniform"\nrange = 0.25\n{more}\n')
        return read_target(path).problem.brightness_floor

    # a white slice of 0.5 x 0.5 that holds 5 % of the light has a BRDF of 0.05 / 0.25
    assert floor("") == pytest.approx(0.2)
    assert floor("brightness_floor = 0.7") == 0.7 and floor("brightness_floor = 0.0") == 0.0


def test_a_length_may_carry_any_unit(tmp_path: Path) -> None:
    base = BASE.replace("feature_um = 0.8", "feature_nm = 800")
    path = tmp_path / "t.toml"
    path.write_text(base + 'kind = "uniform"\nrange = 0.2\n')
    assert read_target(path).spec.feature_um == pytest.approx(0.8)


def stroke(size: tuple[int, int]) -> np.ndarray:
    """A bright bar in the upper left quarter of a drawing of (width, height)."""
    drawing = np.zeros((size[1], size[0]), dtype=np.uint8)
    drawing[size[1] // 8 : size[1] // 4, size[0] // 8 : size[0] // 2] = 255
    return drawing


def test_grey_levels_do_not_depend_on_the_bit_depth(tmp_path: Path) -> None:
    ramp = np.tile(np.linspace(0, 255, 64).astype(np.uint8), (64, 1))
    Image.fromarray(ramp).save(tmp_path / "8.png")
    Image.fromarray(ramp.astype(np.uint16) * 257).save(tmp_path / "16.png")
    shallow, deep = (target.load_picture(tmp_path / name, "t") for name in ("8.png", "16.png"))
    np.testing.assert_allclose(deep, shallow, atol=1.0 / 255)  # 8 bits round


def test_transparent_areas_are_dark(tmp_path: Path) -> None:
    drawing = stroke((64, 64))
    Image.fromarray(drawing).save(tmp_path / "opaque.png")
    white = np.full_like(drawing, 255)
    Image.fromarray(np.dstack([white, white, white, drawing])).save(tmp_path / "white.png")
    opaque, white_on_clear = (target.load_picture(tmp_path / name, "t") for name in ("opaque.png", "white.png"))
    np.testing.assert_allclose(white_on_clear, opaque, atol=1.0 / 255)
    black = np.zeros_like(drawing)
    Image.fromarray(np.dstack([black, black, black, drawing])).save(tmp_path / "black.png")
    with pytest.raises(RecipeError, match="is blank"):
        target.load_picture(tmp_path / "black.png", "t")


@pytest.mark.parametrize("size", [(96, 48), (48, 96)])
def test_a_rectangular_drawing_is_padded(tmp_path: Path, size: tuple[int, int]) -> None:
    Image.fromarray(stroke(size)).save(tmp_path / "wide.png")
    shown = target.load_picture(tmp_path / "wide.png", "t")[..., 0] > 0.5
    rows, columns = np.flatnonzero(shown.any(axis=1)), np.flatnonzero(shown.any(axis=0))
    drawn = stroke(size) > 0
    wanted = drawn.any(axis=0).sum() / drawn.any(axis=1).sum()
    # the bar is 32 of the 512 rows high at least; bilinear edges blur by less than three
    assert len(columns) / len(rows) == pytest.approx(wanted, rel=0.1)


def test_the_camera_orientation_is_applied(tmp_path: Path) -> None:
    drawing = stroke((64, 64))
    exif = Image.Exif()
    exif[0x0112] = 6  # the camera was turned by a quarter: viewers turn the picture clockwise
    Image.fromarray(np.rot90(drawing)).save(tmp_path / "turned.png", exif=exif)
    Image.fromarray(drawing).save(tmp_path / "upright.png")
    turned, upright = (target.load_picture(tmp_path / name, "t") for name in ("turned.png", "upright.png"))
    np.testing.assert_array_equal(turned, upright)


@pytest.mark.parametrize(
    ("target", "says"),
    [
        ('kind = "imaeg"\nrange = 0.3', "Did you mean"),
        ('kind = "image"\nrange = 0.3', "target.image is missing"),
        ('kind = "image"\nimage = "none.png"\nrange = 0.3', "does not exist"),
        ('kind = "image"\nimage = "broken.png"\nrange = 0.3', "is not a readable image"),
        ('kind = "image"\nimage = "blank.png"\nrange = 0.3', "blank"),
        ('kind = "array"\nfile = "text.npy"\nrange = 0.3', "not a .npy array"),
        ('kind = "uniform"\ncolour = "mauve-ish"\nrange = 0.3', "target.colour"),
        ('kind = "uniform"\ncolour = {spectrum = "percent.csv"}\nrange = 0.3', "head a column in per cent"),
        ('kind = "uniform"\ncolour = "#12345"\nrange = 0.3', "target.colour"),
        ('kind = "uniform"\nrange = 1.2', "outside the hemisphere"),
        ('kind = "uniform"\nrange = -0.1', "target.range"),
        ('kind = "uniform"\nrange = 0.3\nresolution = 2', "target.resolution"),
        ('kind = "uniform"\nrange = 0.3\nintensity_scale = 0.0', "target.intensity_scale"),
        ('kind = "uniform"\nrange = 0.3\ncolor = "red"', "color is not known. Did you mean"),
    ],
)
def test_a_bad_target_is_one_clear_line(tmp_path: Path, target: str, says: str) -> None:
    (tmp_path / "broken.png").write_bytes(b"\x89PNG nothing")
    (tmp_path / "text.npy").write_text("hello")
    (tmp_path / "percent.csv").write_text("nm,R\n400,20\n700,60\n")
    Image.fromarray(np.full((9, 9, 3), 77, dtype=np.uint8)).save(tmp_path / "blank.png")
    with pytest.raises(RecipeError, match=says) as caught:
        built(tmp_path, target)
    assert "\n" not in str(caught.value) and "t.toml" in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("feature_um = 0.8", "feature_um = 0.0", "feature_um"),
        ("blur_um = 0.13", "blur_um = -0.1", "blur_um"),
        ("blur_um = 0.13", "blur_um = nan", "blur_um"),
        ("features = 16", "features = 100000", "features"),
        ("coherence = {sigma = 0.9}", "coherence = {sigma = 9.0}", "half the tile"),
        ("coherence = {sigma = 0.9}", "coherence = {sigma = 0.9, source_angle_deg = 3}", "exactly one"),
        ('coating = "Al"', 'coating = "Alu"', "coating"),
        ('family = "relief"', 'family = "film"', "family"),
    ],
)
def test_a_bad_process_is_one_clear_line(tmp_path: Path, old: str, new: str, says: str) -> None:
    with pytest.raises(RecipeError, match=says) as caught:
        built(tmp_path, 'kind = "uniform"\nrange = 0.3', base=BASE.replace(old, new))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "search", ["levels = 1", "starts = 0", "incidence_deg = [[95, 0]]", "noise = 2.0", "speed = 1"]
)
def test_a_bad_search_is_one_clear_line(tmp_path: Path, search: str) -> None:
    with pytest.raises(RecipeError):
        built(tmp_path, 'kind = "uniform"\nrange = 0.3', search)


def test_a_design_deeper_than_its_process_is_refused_before_it_is_searched(tmp_path: Path) -> None:
    def ask(curve: str) -> None:
        base = BASE.replace("height_max_um", f'calibration = "{curve}"\nheight_max_um')
        built(tmp_path, 'kind = "gaussian"\nrange = 0.3', base=base)

    (tmp_path / "machine.csv").write_text("0,0\n255,0.5\n")
    with pytest.raises(RecipeError, match=r"height_max_um = 0.8 is deeper than .*machine.csv.* 0.5 um") as found:
        ask("machine.csv")
    assert "\n" not in str(found.value)
    with pytest.raises(RecipeError, match="calibration = .*cannot be used"):
        ask("none.csv")
    ask("published")


def test_an_unknown_picture_type_lists_the_known_ones(tmp_path: Path) -> None:
    with pytest.raises(RecipeError, match="formula") as found:
        built(tmp_path, 'kind = "formula"\nformula = "u"\nrange = 0.3')
    assert "blend" not in str(found.value) and "vary" not in str(found.value)
