"""Fabrication files: reading back gives the heights, large wafers stream, bad input is refused."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from read_back import depth_of, heights_from_grey, read_grey16, read_levels, read_stl_heights

from nacre.api import fabricate as fabricate_all
from nacre.cli import run
from nacre.core.errors import NacreError, UnsupportedError
from nacre.families.relief.diffraction_orders import Coherence
from nacre.families.relief.material import Relief
from nacre.families.relief.surface import Tile
from nacre.formats.layouts import PUBLISHED_CALIBRATION, read_calibration, write_levels
from nacre.formats.number_maps import check_size, write_png16, write_tiff16
from nacre.matter.indices.library import index


def fabricate(*arguments: object, **options: object) -> Path:
    path, beside = fabricate_all(*arguments, **options)
    assert beside.is_file()
    return path


def relief(features: int = 12, levels: int = 0, height_nm: float = 700.0, feature_nm: float = 1600.0) -> Relief:
    x = np.random.default_rng(1).random((features, features))
    x[0, 0], x[0, 1] = 0.0, 1.0
    if levels:
        x = np.round(x * (levels - 1)) / (levels - 1)
    return Relief(Tile(height_nm * x, feature_nm, 400.0), Coherence.from_sigma(2.6), index("Al"))


@pytest.mark.parametrize("to", ["png16", "tiff16"])
def test_a_grey_image_read_back_gives_the_heights_within_one_level(tmp_path: Path, to: str) -> None:
    material = relief()
    path = fabricate(material, to, tmp_path / f"map.{to[:3]}")
    grey, inside = read_grey16(path)
    facts = json.loads(path.with_name(path.name + ".json").read_text())
    assert inside == facts
    error_nm = np.abs(
        heights_from_grey(grey, facts) * 1e3 - (material.tile.heights_nm - material.tile.heights_nm.min())
    )
    assert error_nm.max() <= facts["nm_per_level"]
    assert facts["pitch_um"] == 1.6


@pytest.mark.parametrize("to", ["png16", "tiff16"])
def test_a_grey_image_is_linear_over_all_levels_unless_a_curve_is_named(tmp_path: Path, to: str) -> None:
    grey, facts = read_grey16(fabricate(relief(), to, tmp_path / f"map.{to[:3]}"))
    assert grey.min() == 0 and grey.max() == 65535
    assert facts["calibration"] == "linear" and facts["nm_per_level"] == pytest.approx(700.0 / 65535)
    flat, _ = read_grey16(fabricate(relief(height_nm=0.0), to, tmp_path / f"flat.{to[:3]}"))
    assert np.all(flat == 65535)


def test_the_published_curve_is_there_by_its_name_only(tmp_path: Path) -> None:
    grey, facts = read_grey16(fabricate(relief(), "png16", tmp_path / "x.png", calibration="published"))
    assert grey.min() >= 201 and grey.max() <= 989
    assert facts["calibration"] == "published" and facts["calibration_range_um"] == pytest.approx(0.809)


def test_an_8_bit_curve_keeps_its_depth_in_16_bits(tmp_path: Path) -> None:
    curve = tmp_path / "machine.csv"
    curve.write_text("grey,depth_um\n0,0\n255,1.4\n")
    material = relief()
    grey, facts = read_grey16(fabricate(material, "png16", tmp_path / "x.png", calibration=curve))
    # half of the process's depth is half of the grey values, on 16 bits as on 8
    assert grey.max() == pytest.approx(65535 / 2, abs=1)
    error = np.abs(heights_from_grey(grey, facts) * 1e3 - material.tile.heights_nm + material.tile.heights_nm.min())
    assert error.max() <= facts["nm_per_level"] == pytest.approx(1400.0 / 65535)
    assert facts["stretched_from_8_bit"] and facts["calibration"] == "machine.csv"


@pytest.mark.parametrize(("write", "name"), [(write_png16, "t.png"), (write_tiff16, "t.tif")])
def test_a_tile_is_written_once_as_it_is_whatever_its_sides(tmp_path: Path, write: Any, name: str) -> None:
    for shape in ((3, 20), (20, 3)):
        tile = np.arange(60, dtype=np.uint16).reshape(shape) * 1000
        write(tmp_path / name, tile, {"a": 1}, 1.6)
        grey, facts = read_grey16(tmp_path / name)
        np.testing.assert_array_equal(grey, tile)
        assert facts == {"a": 1}


@pytest.mark.parametrize("to", ["png16", "tiff16"])
def test_a_wafer_repeats_the_tile_also_over_a_broken_edge(tmp_path: Path, to: str) -> None:
    one, _ = read_grey16(fabricate(relief(), to, tmp_path / f"one.{to[:3]}"))
    many, facts = read_grey16(fabricate(relief(), to, tmp_path / f"many.{to[:3]}", size_mm=(0.16, 0.24)))
    assert many.shape == (100, 150) == tuple(facts["pixels"])
    rows, columns = np.arange(100) % 12, np.arange(150) % 12
    assert np.array_equal(many, one[np.ix_(rows, columns)])


@pytest.mark.full
def test_a_50_mm_wafer_at_1600_nm_streams(tmp_path: Path) -> None:
    """31 250 x 31 250 pixels are 1.95 GB; the process must stay far below."""
    code = (
        "import re, sys; sys.path.insert(0, sys.argv[2])\n"
        "import numpy as np\n"
        "from nacre.formats.number_maps import write_tiff16, write_png16\n"
        "tile = np.random.default_rng(0).integers(201, 989, (32, 32)).astype(np.uint16)\n"
        "write_png16(sys.argv[1] + '/wafer.png', tile, {}, 1.6, 31250, 31250)\n"
        "write_tiff16(sys.argv[1] + '/wafer.tif', tile, {}, 1.6, 31250, 31250)\n"
        # the peak of this program alone: getrusage would count the test process that it was forked from
        "print(int(re.search(r'VmHWM:\\s+(\\d+)', open('/proc/self/status').read())[1]) // 1024)\n"
    )
    source = str(Path(__file__).resolve().parents[2] / "src")
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path), source], capture_output=True, text=True, timeout=500, check=True
    )
    assert int(done.stdout) < 400, "peak memory in MB"


@pytest.mark.parametrize("to", ["gds", "oas"])
@pytest.mark.parametrize("levels", [2, 4, 8, 16])
def test_a_mask_read_back_gives_the_levels(tmp_path: Path, to: str, levels: int) -> None:
    material = relief(levels=levels)
    path = fabricate(material, to, tmp_path / f"mask.{to}", size_mm=(0.1, 0.05))
    facts = json.loads(path.with_name(path.name + ".json").read_text())
    index_map, tiles = read_levels(path, 1.6)
    assert tiles == tuple(facts["tiles"]) == (6, 3)
    heights = np.array(facts["level_heights_um"])[index_map]
    truth = (material.tile.heights_nm - material.tile.heights_nm.min()) / 1e3
    assert len(facts["level_heights_um"]) == levels and np.abs(heights - truth).max() < 1e-6


def test_heights_that_differ_by_rounding_only_share_a_level_of_the_mask(tmp_path: Path) -> None:
    """A nanometre is a thousandth of a um; what differs by a millionth of that was written as one height."""
    noise_nm = 2e-7 * np.random.default_rng(2).choice([-1.0, 1.0], (12, 12))
    heights = 350.0 * (np.add.outer(np.arange(12), np.arange(12)) % 2) + 100.0 + noise_nm
    material = Relief(Tile(heights, 1600.0, 400.0), Coherence.from_sigma(2.6), index("Al"))
    path = fabricate(material, "gds", tmp_path / "mask.gds")
    levels = json.loads(path.with_name(path.name + ".json").read_text())["level_heights_um"]
    np.testing.assert_allclose(levels, [0.0, 0.35], atol=1e-8)


def test_a_mask_of_a_continuous_relief_stays_within_half_a_level(tmp_path: Path) -> None:
    path = fabricate(relief(), "gds", tmp_path / "mask.gds", levels=8)
    facts = json.loads(path.with_name(path.name + ".json").read_text())
    assert facts["largest_rounding_um"] <= 0.5 * 0.7 / 7 + 1e-9


def test_an_stl_is_watertight_and_holds_the_heights(tmp_path: Path) -> None:
    import trimesh

    material = relief(features=5)
    path = fabricate(material, "stl", tmp_path / "relief_um.stl", base_um=2.0)
    mesh = trimesh.load(path)
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0
    heights = read_stl_heights(path, 1.6, 5) - 2.0
    assert np.abs(heights - (material.tile.heights_nm - material.tile.heights_nm.min()) / 1e3).max() < 1e-5
    repeated = trimesh.load(fabricate(material, "stl", tmp_path / "many_um.stl", size_mm=(0.016, 0.016)))
    assert np.allclose(repeated.extents[:2], 16.0)
    oblong = trimesh.load(fabricate(material, "stl", tmp_path / "oblong_um.stl", size_mm=(0.024, 0.008)))
    assert np.allclose(oblong.extents[:2], [24.0, 8.0]) and oblong.is_watertight


def test_a_csv_holds_the_heights(tmp_path: Path) -> None:
    material = relief()
    heights = np.loadtxt(fabricate(material, "csv", tmp_path / "h.csv"), delimiter=",")
    assert np.abs(heights * 1e3 - (material.tile.heights_nm - material.tile.heights_nm.min())).max() < 1e-3


def test_a_falling_calibration_works_too(tmp_path: Path) -> None:
    curve = tmp_path / "curve.csv"
    curve.write_text("grey,depth_um\n0,2.0\n1000,1.0\n4000,0.1\n")
    material = relief()
    grey, facts = read_grey16(fabricate(material, "png16", tmp_path / "x.png", calibration=curve))
    error = np.abs(heights_from_grey(grey, facts) * 1e3 - material.tile.heights_nm + material.tile.heights_nm.min())
    assert error.max() <= facts["nm_per_level"]


@pytest.mark.parametrize(
    "text",
    [
        "grey,depth_um\n0,2.0\n1000,1.0\n4000,0.1\n",
        "depth_um,grey\n2.0,0\n1.0,1000\n0.1,4000\n",
        "% the laser of hall 3\nGrey;Depth (nm)\n0;2000,0\n1000;1000\n4000;100\n",
        "depth_nm\tgrey value\n100\t4000\n1000\t1000\n2000\t0\n",
        "0 2.0\n1000 1.0\n4000 0.1\n",
    ],
)
def test_a_calibration_is_read_as_its_heading_says(tmp_path: Path, text: str) -> None:
    """A table with depth before grey used to be read as a curve from 0 to 4000 um."""
    (tmp_path / "curve.csv").write_text(text)
    curve = read_calibration(tmp_path / "curve.csv")
    assert curve.grey.tolist() == [0.0, 1000.0, 4000.0] and curve.depth_um == pytest.approx([2.0, 1.0, 0.1])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("volts,oxide_nm\n0,2\n10,30\n50,120\n", ("volts", "oxide_nm")),
        ("Oxide (um);U (V)\n0,002;0\n0,03;10\n0,12;50\n", ("U (V)", "Oxide (um)")),
    ],
)
def test_a_process_curve_is_read_as_its_heading_says(tmp_path: Path, text: str, words: tuple[str, str]) -> None:
    from nacre.formats.number_maps import read_process

    (tmp_path / "volts.csv").write_text(text)
    curve = read_process(tmp_path / "volts.csv")
    assert curve.settings.tolist() == [0.0, 10.0, 50.0] and curve.words == words
    assert curve.values == pytest.approx([2.0, 30.0, 120.0])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("1,0.1\n2,0.3\n3,0.2\n", "not monotonic"),
        ("1,0.1\n1,0.3\n", "not monotonic"),
        ("1,0.1\n", "at least two"),
        ("1,0.1\n99999,0.3\n", "0 to 65535"),
        ("1,0.1\n3,x\n", "line 2"),
        ("1,0.1\nzwei,0.3\n3,0.5\n", "line 2"),
        ("1,nan\n2,1\n", "finite"),
    ],
)
def test_a_bad_calibration_is_refused(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "curve.csv"
    path.write_text(text)
    with pytest.raises(NacreError, match=says):
        read_calibration(path)


def test_a_calibration_that_does_not_cover_the_heights_is_refused(tmp_path: Path) -> None:
    with pytest.raises(NacreError, match="covers depths"):
        fabricate(relief(height_nm=900.0), "png16", tmp_path / "x.png", calibration="published")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("to", "options", "says"),
    [
        ("png8", {}, "Did you mean"),
        ("png16", {"size_mm": (1e7, 1.0)}, "pixels"),
        ("png16", {"pixels_per_feature": 0}, "1 or more"),
        ("gds", {"levels": 1000}, "levels"),
        ("stl", {"size_mm": (100.0, 100.0)}, "triangles"),
        ("png16", {"levels": 8}, "--to png16 takes no --levels"),
        ("gds", {"seed": 3}, "--to gds takes no --seed"),
        ("stl", {"calibration": "published"}, "--to stl takes no --calibration"),
        ("csv", {"size_mm": (1.0, 1.0)}, "--to csv takes no --size-mm"),
    ],
)
def test_impossible_requests_are_refused(tmp_path: Path, to: str, options: dict, says: str) -> None:
    with pytest.raises(UnsupportedError, match=says):
        fabricate(relief(), to, tmp_path / "x.gds", **options)
    assert list(tmp_path.iterdir()) == []


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(NacreError, match="does not exist"):
        fabricate(relief(), "png16", tmp_path / "nowhere" / "x.png")


def test_a_full_disk_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import nacre.formats.number_maps as module

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(module, "_chunk", full)
    with pytest.raises(NacreError, match="No space left"):
        fabricate(relief(), "png16", tmp_path / "x.png")
    assert list(tmp_path.iterdir()) == []


def test_published_calibration_is_the_published_range() -> None:
    assert depth_of(PUBLISHED_CALIBRATION, np.array([201, 989], dtype=np.uint16)).tolist() == [0.376, 1.185]


def test_each_of_several_maps_is_reported_with_its_own_grey_values(tmp_path: Path, capfd: Any) -> None:
    """The last one's range was stated as that of all."""
    Image.fromarray(np.arange(0, 256, 16, dtype=np.uint8).reshape(4, 4)).save(tmp_path / "ramp.png")
    layers = ", ".join(
        f'{{material = "{name}", thickness_nm = {{texture = "ramp.png", min = 10, max = {high}}}}}'
        for name, high in (("TiO2", 150), ("SiO2", 300))
    )
    (tmp_path / "two.toml").write_text(f'family = "film"\nsubstrate = "Al"\nlayers = [{layers}]\n', encoding="utf-8")
    assert run(["fabricate", str(tmp_path / "two.toml"), "--to", "png16", "-o", str(tmp_path / "x.png")]) == 0
    said = capfd.readouterr().err
    assert "grey values of layers[0].thickness_nm: 0 is 10, 65535 is 150 nm" in said
    assert "grey values of layers[1].thickness_nm: 0 is 10, 65535 is 300 nm" in said


@pytest.mark.parametrize("radius_um", [0.0005, 0.002, 0.0073, 0.05, 0.1234, 1.0, 37.0, 1000.0])
def test_circles_have_their_area_and_symmetry_at_any_size(tmp_path: Path, radius_um: float) -> None:
    import gdstk

    from nacre.formats.layouts import write_layout

    path = tmp_path / "x.gds"
    write_layout(path, np.zeros((1, 2)), radius_um)
    corners = next(c for c in gdstk.read_gds(str(path)).cells if c.polygons).polygons[0].points
    x, y = corners.T
    area = 0.5 * abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    assert area == pytest.approx(np.pi * radius_um**2, rel=0.01)
    places = {(round(a / radius_um, 6), round(b / radius_um, 6)) for a, b in corners}
    for turn in (lambda a, b: (-a, b), lambda a, b: (a, -b), lambda a, b: (b, a)):
        assert {tuple(v + 0.0 for v in turn(a, b)) for a, b in places} == places


def test_klayout_counts_the_particles_of_split_arrays(tmp_path: Path) -> None:
    database = pytest.importorskip("klayout.db")
    from nacre.formats.layouts import write_layout

    for name in ("x.gds", "x.oas"):
        write_layout(tmp_path / name, np.zeros((1, 2)), 0.05, 0.2, periods=(40_000, 2))
        layout = database.Layout()
        layout.read(str(tmp_path / name))
        arrays = [each.na * each.nb for cell in layout.each_cell() for each in cell.each_inst() if each.na]
        assert sum(arrays) == 80_000


def test_a_tiff_of_several_tiles_holds_the_pattern(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from nacre.formats import number_maps

    monkeypatch.setattr(number_maps, "TIFF_TILE", 16)
    grey = np.random.default_rng(3).integers(0, 1 << 16, (37, 50)).astype(np.uint16)
    write_tiff16(tmp_path / "a.tif", grey, {}, 0.5)
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "a.tif")), grey)


def test_a_side_of_an_image_has_one_to_a_million_pixels() -> None:
    check_size(1_000_000, 1)
    check_size(1, 1_000_000)
    for rows, columns in ((1_000_001, 1), (1, 1_000_001), (0, 1), (1, 0)):
        with pytest.raises(UnsupportedError):
            check_size(rows, columns)


def test_levels_count_from_zero(tmp_path: Path) -> None:
    with pytest.raises(UnsupportedError):
        write_levels(tmp_path / "levels.gds", np.array([[0, -1], [1, 2]]), 0.5)
    assert not (tmp_path / "levels.gds").exists()
