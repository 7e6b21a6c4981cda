"""Picture design: colour matching, hue, dithering, maps, refusals."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import nacre
from nacre.core.arrays import Array
from nacre.core.errors import NacreError, RecipeError
from nacre.formats.number_maps import read_process
from nacre.light import delta_e_2000, lab_to_lch, lab_to_xyz, white_xyz, xyz_to_lab
from nacre.optimise.image.files import read_picture, srgb_lab
from nacre.optimise.image.matching import HUE_COST, dither, has_same_hue, map_into_solid, match_colours
from nacre.optimise.task import read_task

WHITE = white_xyz("D65", "10deg")
HALF_A_STEP = 0.5 / 65535  # of a 16-bit map's range
SHEET_STEP = 0.25  # dE00: what the neighbours of a sheet of 200 x 200 colours differ by
JUDGED = 0.05  # dE00 between the search's grid with a spline and 1 nm


def bent_sheet(side: int = 200) -> Array:
    """A curved surface through the greys and some hues, as two thicknesses make one."""
    u, v = np.meshgrid(np.linspace(0.0, 1.0, side), np.linspace(0.0, 1.0, side), indexing="ij")
    chroma, hue = 45.0 * np.sin(np.pi * v), 2.0 + 4.0 * u
    return np.stack([20.0 + 70.0 * u * (1.0 - 0.3 * v), chroma * np.cos(hue), chroma * np.sin(hue)], axis=-1)


def some_colours(count: int, seed: int = 3) -> Array:
    return np.random.default_rng(seed).uniform((15.0, -40.0, -40.0), (95.0, 40.0, 40.0), (count, 3))


def test_the_match_is_the_nearest_colour_of_the_grid() -> None:
    sheet, wanted = bent_sheet(), some_colours(60)
    every = sheet.reshape(-1, 3)
    brute = np.array([delta_e_2000(one, every).min() for one in wanted])
    found = match_colours(wanted, sheet, tolerance=1.0, keep_hue=False)
    assert found.distance == pytest.approx(delta_e_2000(wanted, every[found.points]), abs=1e-9)
    assert np.all(found.distance <= brute + SHEET_STEP)
    assert np.median(found.distance - brute) <= 0.01


def test_unreachable_colours_are_clipped_at_constant_hue() -> None:
    sheet, wanted = bent_sheet(), some_colours(300)
    plain, kept = (match_colours(wanted, sheet, 1.0, keep) for keep in (False, True))
    moved = kept.points != plain.points
    assert moved.sum() > 20
    assert kept.is_mapped[moved].all() and kept.keeps_hue[moved].all() and not plain.keeps_hue[moved].any()
    assert np.all(kept.distance <= kept.nearest + HUE_COST + 1e-9)
    # of what is colourful on both sides, less than a just visible turn: 1 dE00 of hue, here some degrees
    one, other = lab_to_lch(wanted[moved]), lab_to_lch(sheet.reshape(-1, 3)[kept.points[moved]])
    turn = np.abs((one[:, 2] - other[:, 2] + 180.0) % 360.0 - 180.0)
    assert np.all(turn[np.minimum(one[:, 1], other[:, 1]) > 10.0] < 8.0)


def test_greys_match_any_hue() -> None:
    red = np.array([[50.0, 20.0, 0.0]] * 3)
    assert has_same_hue(red, np.array([[70.0, 5.0, 0.0], [50.0, 0.0, 20.0], [50.0, 0.0, 0.0]])).tolist() == [1, 0, 1]


def corners() -> Array:
    """Eight colours that span a solid about the greys."""
    labs = [(20, 0, 0), (90, 0, 0), (50, 50, 0), (50, -50, 0), (55, 0, 50), (45, 0, -50), (60, 30, 30), (40, -30, -30)]
    return np.asarray(lab_to_xyz(np.array(labs, dtype=float), WHITE))


def test_a_dithered_field_has_the_colour_in_the_mean() -> None:
    levels = corners()
    for lab in ([55.0, 10.0, -5.0], [60.0, -15.0, 12.0]):
        xyz = np.asarray(lab_to_xyz(np.array(lab), WHITE))
        chosen = dither(np.broadcast_to(xyz, (64, 64, 3)), levels, WHITE)
        assert len(np.unique(chosen)) >= 3
        mean = levels[chosen].mean(axis=(0, 1))
        assert delta_e_2000(xyz_to_lab(mean, WHITE), lab) < 0.5


def test_colours_are_mapped_into_the_hull_of_the_levels() -> None:
    from scipy.spatial import ConvexHull

    levels, wanted = corners(), np.concatenate([some_colours(100), [[55.0, 10.0, -5.0]]])
    found, moved = map_into_solid(wanted, levels, WHITE, tolerance=1.0)
    planes = ConvexHull(levels).equations
    assert np.all(lab_to_xyz(found, WHITE) @ planes[:, :3].T + planes[:, 3] <= 1e-6)
    assert np.array_equal(found[-1], wanted[-1]) and not moved[-1]  # inside already
    assert 30 < moved.sum() < 101


def test_two_levels_mix_along_their_line() -> None:
    levels = np.asarray(lab_to_xyz(np.array([[20.0, 0.0, 0.0], [90.0, 0.0, 0.0]]), WHITE))
    wanted = np.array([[60.0, 0.0, 0.0], [60.0, 40.0, 0.0], [98.0, 0.0, 0.0]])
    found, moved = map_into_solid(wanted, levels, WHITE, tolerance=2.0)
    assert moved.tolist() == [False, True, True]
    assert np.abs(found[:, 1:]).max() < 1e-6 and found[2, 0] == pytest.approx(90.0)
    chosen = dither(np.broadcast_to(lab_to_xyz(found[0], WHITE), (32, 32, 3)), levels, WHITE)
    assert delta_e_2000(xyz_to_lab(levels[chosen].mean(axis=(0, 1)), WHITE), found[0]) < 0.5


def write_picture(path: Path, pixels: Array) -> Path:
    Image.fromarray(np.round(255.0 * pixels).astype(np.uint8)).save(path)
    return path


def ramp(rows: int = 12, columns: int = 16) -> Array:
    """Blues on the left, golds on the right, brighter at the top."""
    u, v = np.meshgrid(np.linspace(0.0, 1.0, columns), np.linspace(1.0, 0.5, rows))
    return np.stack([v * (0.25 + 0.6 * u), v * (0.35 + 0.35 * u), v * (0.8 - 0.5 * u)], axis=-1)


def anodised(picture: Path, **more: Any) -> dict[str, Any]:
    return {
        "recipe": {"family": "film", "substrate": "Ti", "layers": [{"material": "TiO2-film", "thickness_nm": 100}]},
        "parameters": {"layers[0].thickness_nm": [5, 245]},
        "target": [{"geometry": "specular 0", "image": str(picture)}],
        **more,
    }


@pytest.fixture(scope="module")
def designed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the picture of a ramp, and the design of it in `out`."""
    folder = tmp_path_factory.mktemp("ramp")
    design = nacre.design(anodised(write_picture(folder / "p.png", ramp())), folder / "out")
    assert design.status == json.loads((folder / "out/design.json").read_text())["status"]
    return folder


def test_the_maps_reproduce_the_picture(designed: Path) -> None:
    tmp_path = designed
    entry = json.loads((tmp_path / "out/design.json").read_text())["solutions"][0]
    assert entry["targets"][0]["asked"] == {"image": str(tmp_path / "p.png")}
    values = np.load(tmp_path / "out/layers-0-thickness_nm.npy")
    grey = np.asarray(Image.open(tmp_path / "out/layers-0-thickness_nm.png"), dtype=float) / 65535.0
    tiff = np.asarray(Image.open(tmp_path / "out/layers-0-thickness_nm.tif"), dtype=float) / 65535.0
    assert values.shape == (12, 16) and np.array_equal(grey, tiff)
    assert 5.0 + 240.0 * grey == pytest.approx(values, abs=240.0 * HALF_A_STEP)
    # the recipe stands as the picture does: u to the right, v up, the first row on top
    made = nacre.load(tmp_path / "out")
    row, column = 2, 13
    uv = np.array([(column + 0.5) / 16, 1.0 - (row + 0.5) / 12])
    here = made.model.stack_at(uv).thicknesses_nm[0]  # type: ignore[attr-defined]  # a film
    assert here == pytest.approx(values[row, column], abs=240.0 * HALF_A_STEP)
    # the colours, computed anew: no thickness that the bounds allow is nearer
    thin = nacre.material(anodised(tmp_path)["recipe"])
    pixel = read_picture(tmp_path / "p.png", "p.png")[row, column]
    asked = xyz_to_lab(srgb_xyz(pixel), srgb_xyz(np.ones(3)))
    off = [float(delta_e_2000(asked, seen(thin, d))) for d in np.arange(5.0, 245.1, 2.0)]
    assert float(delta_e_2000(asked, seen(thin, float(values[row, column])))) <= min(off) + HUE_COST + JUDGED
    assert entry["checked"]["de00_largest"] < JUDGED


def srgb_xyz(rgb: Array) -> Array:
    from nacre.light import srgb_decode, srgb_linear_to_xyz

    return np.asarray(srgb_linear_to_xyz(srgb_decode(rgb)))


def seen(film: Any, thickness_nm: float) -> Array:
    from nacre.light import spectrum_to_xyz

    made = film.vary({"layers[0].thickness_nm": thickness_nm}).spectrum([0.0], np.arange(360.0, 831.0))
    return np.asarray(
        xyz_to_lab(spectrum_to_xyz(made.specular_reflectance[0], made.wavelengths_nm, "D65", "10deg"), WHITE)
    )


def test_without_dithering_each_pixel_has_the_nearest_level(tmp_path: Path) -> None:
    picture = write_picture(tmp_path / "p.png", np.random.default_rng(8).uniform(0.0, 1.0, (16, 20, 3)))
    target = anodised(picture, limits={"height_levels": 9, "dither": False})
    made = nacre.design(target, tmp_path / "out")
    values = np.load(tmp_path / "out/layers-0-thickness_nm.npy")
    levels = np.linspace(5.0, 245.0, 9)
    palette = np.array([seen(nacre.material(target["recipe"]), level) for level in levels])
    asked = srgb_lab(read_picture(picture, "p"))
    distance = delta_e_2000(asked[:, :, None], palette)
    chosen = np.abs(values[..., None] - levels).argmin(axis=-1)
    found = np.take_along_axis(distance, chosen[..., None], axis=-1)[..., 0]
    assert np.all(found <= distance.min(axis=-1) + 2 * JUDGED)
    assert made.best.facts["de00_mean"] == pytest.approx(distance.min(axis=-1).mean(), abs=JUDGED)
    assert made.best.facts["seen_from_afar"] is False


def test_levels_are_those_of_the_process_and_a_mask_has_a_layer_for_each(tmp_path: Path) -> None:
    import gdstk

    picture = write_picture(tmp_path / "p.png", ramp(20, 24))
    nacre.design(anodised(picture, limits={"height_levels": 5}), tmp_path / "out")
    values = np.load(tmp_path / "out/layers-0-thickness_nm.npy")
    assert set(np.unique(values)) <= set(np.linspace(5.0, 245.0, 5)) and len(np.unique(values)) >= 3
    written = nacre.fabricate(tmp_path / "out", "gds", tmp_path / "mask.gds", size_mm=(2.4, 2.0))
    facts = json.loads(written[1].read_text())
    assert facts["pixel_um"] == 100.0
    top = gdstk.read_gds(str(written[0])).top_level()[0]
    for k, level in enumerate(facts["level_values"]):
        held = np.isclose(values, level, atol=0.01)
        polygons = top.get_polygons(layer=k, datatype=0)
        assert sum(p.area() for p in polygons) == pytest.approx(1e4 * held.sum())
        low = min(p.bounding_box()[0][1] for p in polygons)  # y runs up: the last row lies at 0
        assert low == pytest.approx(100.0 * (19 - np.flatnonzero(held.any(axis=1)).max()))


@pytest.mark.parametrize(
    "text",
    [
        "volts,thickness_nm\n0,2\n20,42\n60,126\n",
        "thickness_nm,volts\n2,0\n42,20\n126,60\n",
        "volts,thickness (um)\n0,0.002\n20,0.042\n60,0.126\n",
        "nm;V\n126;60\n2;0\n42;20\n",
        "0,2\n20,42\n60,126\n",
    ],
)
def test_a_process_curve_is_read_by_its_headings(tmp_path: Path, text: str) -> None:
    (tmp_path / "volts.csv").write_text(text)
    curve = read_process(tmp_path / "volts.csv")
    np.testing.assert_allclose(curve.settings, [0, 20, 60])
    np.testing.assert_allclose(curve.values, [2, 42, 126])


def test_a_calibration_turns_thickness_into_volts(designed: Path, tmp_path: Path) -> None:
    source = designed / "out"
    values = np.load(source / "layers-0-thickness_nm.npy")
    curve = tmp_path / "volts.csv"
    curve.write_text("volts,thickness_nm\n0,2\n20,42\n110,250\n")
    for to, suffix in (("png16", ".png"), ("tiff16", ".tif"), ("npy", ".npy"), ("csv", ".csv")):
        path, beside = nacre.fabricate(source, to, tmp_path / f"volts{suffix}", calibration=curve)
        facts = json.loads(beside.read_text())
        if to in ("npy", "csv"):
            volts = np.load(path) if to == "npy" else np.loadtxt(path, delimiter=",")
        else:
            grey = np.asarray(Image.open(path), dtype=float) / 65535.0
            volts = facts["black"] + (facts["white"] - facts["black"]) * grey
        assert facts["setting"] == "volts"
        assert np.interp(volts, [0.0, 20.0, 110.0], [2.0, 42.0, 250.0]) == pytest.approx(values, abs=0.01)
    curve.write_text("0,2\n20,42\n")
    with pytest.raises(NacreError, match="covers 2 to 42 nm; layers\\[0\\].thickness_nm needs"):
        nacre.fabricate(source, "png16", tmp_path / "x.png", calibration=curve)
    assert not (tmp_path / "x.png").exists()


def refused(target: dict[str, Any]) -> str:
    with pytest.raises(RecipeError) as caught:
        read_task(target)
    said = str(caught.value)
    assert "\n" not in said
    return said


def test_unsuitable_parameters_are_refused_in_one_line(tmp_path: Path) -> None:
    picture = write_picture(tmp_path / "p.png", ramp())
    good = anodised(picture)
    read_task(good)
    layer = {"material": "SiO2", "thickness_nm": 50}
    three = {
        **good,
        "recipe": {**good["recipe"], "layers": [layer] * 3},
        "parameters": {"layers[*].thickness_nm": [5, 90]},
    }
    assert "3 numbers" in refused(three)
    assert "not choices" in refused({**good, "parameters": {"substrate": {"choices": ["Ti", "Al"]}}})
    cannot = {**good, "recipe": {**good["recipe"], "ambient": {"n": 1.2}}, "parameters": {"ambient.n": [1.1, 1.4]}}
    assert "cannot vary" in refused(cannot) and "layers[].thickness_nm" in refused(cannot)
    for levels in (1, 0, 257, 2.5):
        assert "levels" in refused({**good, "limits": {"height_levels": levels}})
    assert "dither" in refused({**good, "limits": {"dither": False}})
    assert "only target" in refused(
        {**good, "target": [*good["target"], {"geometry": "specular 30", "hue_deg": [0, 90]}]}
    )
    assert "single lamp" in refused({**good, "light": {"illuminants": ["D65", "A"]}})
    assert "tolerance" in refused({**good, "tolerance": {"layers[0].thickness_nm": "2%"}})
    stack = {key: value for key, value in good.items() if key != "parameters"} | {"layers": {"palette": ["SiO2"]}}
    assert "layers" in refused(stack)
    plain = {**good, "target": [{"geometry": "specular 0", "colour": "#888888"}], "limits": {"height_levels": 4}}
    assert "only for pictures" in refused(plain)


@pytest.mark.parametrize("kind", ["text", "missing", "clear", "moving", "cmyk", "thin", "folder", "cut"])
def test_an_image_of_the_wrong_kind_is_refused_in_one_line(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "p.png"
    said = {
        "text": "not a readable image",
        "missing": "does not exist",
        "clear": "transparent",
        "moving": "2 frames",
        "cmyk": "CMYK",
        "thin": "1 x 40",
        "folder": "folder",
        "cut": "not a readable image",
    }
    if kind == "text":
        path.write_text("no picture")
    elif kind == "clear":
        Image.fromarray(np.zeros((8, 8, 4), np.uint8)).save(path)
    elif kind == "moving":
        path = path.with_suffix(".gif")
        frames = [Image.fromarray(np.full((8, 8), v, np.uint8)) for v in (0, 255)]
        frames[0].save(path, save_all=True, append_images=frames[1:])
    elif kind == "cmyk":
        path = path.with_suffix(".tif")
        Image.new("CMYK", (8, 8)).save(path)
    elif kind == "thin":
        Image.new("RGB", (1, 40)).save(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "cut":
        write_picture(path, np.random.default_rng(1).uniform(size=(60, 60, 3)))
        path.write_bytes(path.read_bytes()[:500])
    assert said[kind] in refused(anodised(path))


def test_many_and_a_folder_that_holds_the_picture_are_refused(tmp_path: Path) -> None:
    picture = write_picture(tmp_path / "reached.png", ramp())
    before = picture.read_bytes()
    with pytest.raises(RecipeError, match="would be overwritten"):
        nacre.design(anodised(picture), tmp_path)
    assert picture.read_bytes() == before
    with pytest.raises(NacreError, match="not a single colour"):
        nacre.design.many(anodised(picture), [(50, 0, 0)])


def test_greys_of_16_bits_are_read_as_they_are(tmp_path: Path) -> None:
    values = np.array([[0, 1000, 65535], [32768, 77, 5]], dtype=np.uint16)
    Image.fromarray(values).save(tmp_path / "grey.png")
    assert read_picture(tmp_path / "grey.png", "x")[..., 1] == pytest.approx(values / 65535.0)


@pytest.mark.parametrize("heading", ["thickness_kg", "dose (s)", "roughness"])
def test_a_process_curve_of_no_length_is_refused_for_a_thickness(designed: Path, tmp_path: Path, heading: str) -> None:
    (tmp_path / "volts.csv").write_text(f"volts,{heading}\n0,0\n200,2000\n")
    with pytest.raises(NacreError, match="is not a length"):
        nacre.fabricate(designed / "out", "csv", tmp_path / "v.csv", calibration=tmp_path / "volts.csv")
