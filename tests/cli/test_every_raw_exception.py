"""What once ended in a traceback or in "this is a bug in nacre": each gets an answer or its one line."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.cli import run
from nacre.core.errors import NacreError
from nacre.core.files import check_writable, read_text
from nacre.readers.bsdf.databases import MAGIC, read_tensor

RECIPE = 'family = "film"\nsubstrate = "Si"\nlayers = [{material = "SiO2", thickness_nm = 300}]\n'
ROUGH = RECIPE + "[surface]\nroughness = 0.1\n"
FILM: dict[str, Any] = {
    "family": "film", "substrate": "Si", "layers": [{"material": "SiO2", "thickness_nm": 300}],
}  # fmt: skip
FEW, MANY = "9" * 400, "9" * 5000


@pytest.fixture
def film(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "film.toml").write_text(ROUGH)
    return tmp_path / "film.toml"


def refused(capsys: pytest.CaptureFixture[str], arguments: list[str], *words: str) -> None:
    assert run(arguments) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and len(said) < 1000, said
    assert all(word in said for word in words), said


@pytest.mark.parametrize("text", ["1:1e308:1e-300", "0:90:5e-324", f"1,{FEW}", MANY, ",".join(["0:90:0.001"] * 9)])
@pytest.mark.parametrize("option", ["--wavelengths-nm", "--angles-deg"])
def test_lists_of_numbers_have_an_end(film: Path, capsys: pytest.CaptureFixture[str], option: str, text: str) -> None:
    refused(capsys, ["spectrum", str(film), option, text], option)


@pytest.mark.parametrize("value", [FEW, MANY, "[" * 3000, "{a=" * 3000])
def test_endless_numbers_and_brackets_are_refused(film: Path, capsys: pytest.CaptureFixture[str], value: str) -> None:
    film.write_text(RECIPE.replace("300", value))
    refused(capsys, ["spectrum", str(film)], "film.toml")
    film.write_text(RECIPE)
    refused(capsys, ["spectrum", str(film), "--set", f"layers[0].thickness_nm={value}"])


@pytest.mark.parametrize("path", [f"layers[{MANY}].thickness_nm", "[" * 3000, 3, None, b"x"])
def test_a_path_that_is_none_is_refused(path: Any) -> None:
    with pytest.raises(NacreError, match="path"):
        nacre.material(FILM).vary({path: 1})
    with pytest.raises(NacreError, match="path"):
        nacre.material(FILM).get(path)


@pytest.mark.parametrize(
    "use",
    [
        nacre.load,
        check_writable,
        read_text,
        read_tensor,
        lambda name: nacre.load(f"{name}.nacre"),
        lambda name: nacre.material(FILM, name),
        lambda name: nacre.material({**FILM, "substrate": {"file": name}}),
        lambda name: nacre.material({"family": "measured", "file": f"{name}.nacre"}),
        lambda name: nacre.material({**FILM, "layers": [{"material": "SiO2", "thickness_nm": {
            "texture": name, "min": 1, "max": 2}}]}),
        lambda name: nacre.import_(name, "recipe.toml"),
        lambda name: nacre.fit(name, nacre.material(FILM)),
    ],
)  # fmt: skip
@pytest.mark.parametrize("name", ["a\0b.csv", "x" * 5000, "\ud800"])
def test_a_name_that_no_file_system_takes_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, use: Callable[[str], object], name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(NacreError):
        use(name)


@pytest.mark.parametrize(
    "arguments",
    [
        ["import", "PLACE.csv"], ["import", "PLACE.bsdf"], ["import", "PLACE.binary"], ["import", "PLACE.gltf"],
        ["import", "PLACE.mtlx"], ["fit", "PLACE.csv", "film.toml"], ["spectrum", "PLACE.nacre"],
        ["evaluate", "film.toml", "--directions", "PLACE.npz", "-o", "v.npz"],
        ["spectrum", "film.toml", "--set", 'substrate={file="PLACE.csv"}'],
        ["spectrum", "film.toml", "--set", 'layers[0].thickness_nm={texture="PLACE.png", min=1, max=2}'],
        ["render", "film.toml", "--shape", "PLACE.ply"], ["render", "film.toml", "--light", "PLACE.exr"],
        ["render", "film.toml", "--scene", "PLACE.xml"],
    ],
)  # fmt: skip
@pytest.mark.parametrize(("place", "reason"), [("folder", "folder"), ("pipe", "pipe"), ("device", "device")])
def test_what_is_no_file_is_named_for_what_it_is(
    film: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], place: str, reason: str
) -> None:
    name = next(word for word in arguments if "PLACE" in word).rpartition('="')[2].partition('"')[0]
    path = film.parent / name.replace("PLACE", place)
    if place == "folder":
        path.mkdir()
    elif place == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    filled = [word.replace("PLACE", place) for word in arguments]
    refused(capsys, filled, place if place != "device" else "device", reason)


@pytest.mark.parametrize("words", [["render"], ["plot", "--kind", "ribbon"], ["compile"], ["export", "--to", "csv"]])
def test_a_link_that_leads_to_itself_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "ring.toml").symlink_to("ring.toml")
    refused(capsys, [*words, "ring.toml"], "ring.toml", "symbolic links")


def test_a_named_file_that_is_a_link_to_itself_is_refused(
    film: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(film.parent)
    for name in ("ring.csv", "ring.xml", "ring.toml"):
        Path(name).symlink_to(name)
    for material in ('{file = "ring.csv"}', '{rii = "ring.csv"}'):
        Path("of-ring.toml").write_text(f'family = "film"\nsubstrate = {material}\n')
        refused(capsys, ["spectrum", "of-ring.toml"], "ring.csv", "")
    strata = "[[strata]]\nresin = 1.5\nthickness_um = 9\n"
    Path("on-ring.toml").write_text('family = "pearl"\nbase = {recipe = "ring.toml"}\n' + strata)
    refused(capsys, ["spectrum", "on-ring.toml"], "ring.toml", "")
    refused(capsys, ["render", str(film), "--scene", "ring.xml"], "ring.xml", "symbolic links")


def test_a_recipe_may_come_through_a_pipe(film: Path) -> None:
    command = f"{sys.executable} -m nacre spectrum <(cat {film}) --wavelengths-nm 550"
    found = subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=120, check=False)
    assert found.returncode == 0 and "550" in found.stdout, found.stderr


def test_a_pipe_that_nobody_fills_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nacre.core.files.PIPE_WAIT_S", 0.1)
    os.mkfifo(tmp_path / "pipe.toml")
    with pytest.raises(NacreError, match="into which nothing is written"):
        nacre.load(tmp_path / "pipe.toml")


def test_an_offset_beyond_the_file_is_damage(tmp_path: Path) -> None:
    import struct

    head = MAGIC + struct.pack("<BBI", 1, 0, 1) + struct.pack("<H", 1) + b"x"
    (tmp_path / "x.bsdf").write_bytes(head + struct.pack("<HBQ", 1, 10, 2**63) + struct.pack("<Q", 4))
    with pytest.raises(NacreError, match="damaged"):
        read_tensor(tmp_path / "x.bsdf")


def test_no_directions_give_no_values(film: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.savez(film.parent / "d.npz", wi=np.zeros((0, 3)), wo=np.zeros((0, 3)))
    assert run(["evaluate", str(film), "--directions", "d.npz", "-o", "v.npz", "--wavelengths-nm", "550"]) == 0
    with np.load(film.parent / "v.npz") as found:
        assert found["f"].shape == (0, 1)


UP = [0.0, 0.0, 1.0]


@pytest.mark.parametrize(
    ("wi", "wo", "uv"),
    [
        ("a", "b", None), ([], [], None), ([np.nan, 0, 1], UP, None), ([0, 0, 2], UP, None), ([0, 0, 1j], UP, None),
        ([UP] * 2, [UP] * 5, None), (UP, UP, [np.nan, 0]), (UP, UP, [0.5]), (UP, UP, [[0.5, 0.5]] * 3),
        ([[1], UP], UP, None),
    ],
)  # fmt: skip
def test_directions_and_places_that_are_none_are_refused(wi: Any, wo: Any, uv: Any) -> None:
    rough = nacre.material({**FILM, "surface": {"roughness": 0.2}}).bsdf([550.0])
    with pytest.raises(NacreError, match="wi|wo|uv"):
        nacre.evaluate(rough, wi, wo, uv=uv)


@pytest.mark.parametrize("grid", [[], [np.nan], [-5], [0.0], "b", [[400, 500]], [700, 400], [500, 500], [1j]])
def test_wavelengths_that_are_none_are_refused(grid: Any) -> None:
    material = nacre.material(FILM)
    for ask in (lambda: nacre.spectrum(material, 0, grid), lambda: material.bsdf(grid)):
        with pytest.raises(NacreError, match="wavelengths_nm"):
            ask()
    assert material.spectrum(0.0, 550.0).specular_reflectance is not None  # one number is a list of one


@pytest.mark.parametrize("angles", ["a", [[0, 1]], np.nan, -5, 100, None])
def test_angles_that_are_none_are_refused(angles: Any) -> None:
    with pytest.raises(NacreError, match="angles"):
        nacre.spectrum(nacre.material(FILM), angles)


@pytest.mark.parametrize("thing", [None, 5, b"film.toml", [], {}])
def test_what_is_no_material_is_refused(thing: Any) -> None:
    for ask in (nacre.load, nacre.report, nacre.spectrum, lambda t: nacre.evaluate(t, UP, UP)):
        with pytest.raises(NacreError):
            ask(thing)


def nested(depth: int, kind: type) -> Any:
    value: Any = "Si"
    for _ in range(depth):
        value = {"n": value} if kind is dict else [value]
    return value


@pytest.mark.parametrize("key", [1, None, (1, 2), b"a", 1.5])
@pytest.mark.parametrize("where", ["top", "table", "list"])
def test_a_key_that_is_not_text_is_named(key: Any, where: str) -> None:
    data = {"top": {key: 1}, "table": {"surface": {key: 1}}, "list": {"layers": [{key: 1}]}}[where]
    with pytest.raises(NacreError, match="is not text"):
        nacre.material({**FILM, **data})


@pytest.mark.parametrize("depth", [100, 900, 100_000])
@pytest.mark.parametrize("kind", [dict, list])
@pytest.mark.parametrize("key", ["substrate", "layers", "unknown"])
def test_deep_nesting_is_reported(depth: int, kind: type, key: str) -> None:
    with pytest.raises(NacreError, match="nested more than"):
        nacre.material({**FILM, key: nested(depth, kind)})


def test_a_recipe_that_holds_itself_is_reported() -> None:
    data = dict(FILM)
    data["layers"] = [data]
    with pytest.raises(NacreError, match="nested more than"):
        nacre.material(data)
    for other in (None, [1], "film", 3):
        with pytest.raises(NacreError, match="is not a recipe"):
            nacre.material(other)  # type: ignore[arg-type]  # the test is about wrong types


@pytest.mark.parametrize("number", [np.float32(300), np.int64(300), np.float64(300), 300])
def test_numpy_numbers_are_numbers(number: Any) -> None:
    made = nacre.material({**FILM, "layers": [{"material": "SiO2", "thickness_nm": number}]})
    expected = nacre.material(FILM).spectrum(0.0, 550.0).specular_reflectance
    np.testing.assert_array_equal(made.spectrum(0.0, 550.0).specular_reflectance, expected)


@pytest.mark.parametrize("n", [1e-300, 1e-100, 1e-12, 1e-7])
@pytest.mark.parametrize("where", ["substrate", "ambient", "layer"])
def test_an_index_too_near_zero_to_compute_with_is_refused(n: float, where: str) -> None:
    layers = [*FILM["layers"], {"material": {"n": n}, "thickness_nm": 100}]
    data = {**FILM, **({"layers": layers} if where == "layer" else {where: {"n": n}})}
    with pytest.raises(NacreError, match="must lie between 1e-06 and 100"):
        nacre.material(data)


def closed(film: Path, what: str, arguments: str) -> subprocess.CompletedProcess[str]:
    command = f"exec {sys.executable} -m nacre {arguments} {what}"
    return subprocess.run(
        ["bash", "-c", command], cwd=film.parent, capture_output=True, text=True, timeout=120, check=False
    )


def test_a_closed_or_full_stdout_is_reported_and_files_are_written_all_the_same(film: Path) -> None:
    for what in (">&-", ">/dev/full"):
        found = closed(film, what, "spectrum film.toml --wavelengths-nm 550")
        assert found.returncode == 2 and found.stderr.count("\n") == 1, found.stderr
        assert "Errno" not in found.stderr and "bug" not in found.stderr
    for what in (">&- 2>&- <&-", "2>/dev/full"):
        assert closed(film, what, "spectrum film.toml --wavelengths-nm 550 -o s.csv").returncode == 0
        lines = (film.parent / "s.csv").read_text().splitlines()
        assert len(lines) == 2 and lines[1].startswith("550,0,")
        assert closed(film, what, "spectrum none.toml").returncode == 2


def test_a_full_disk_is_reported_of_an_exr(film: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from nacre.formats.bsdf_tables import write_slice

    class Full:
        def __init__(self, *_: object) -> None: ...

        def write(self, path: str) -> None:
            raise RuntimeError(f'Failed to write pixel data to image file "{path}". No space left on device.')

    monkeypatch.setattr("OpenEXR.File", Full)
    with pytest.raises(NacreError, match="x.exr: cannot be written: .*No space left on device"):
        write_slice(film.parent / "x.exr", nacre.load(film).bsdf())
    assert [path.name for path in film.parent.iterdir()] == ["film.toml"]


def rewritten(source: Path, change: Callable[[dict[str, Any], dict[str, np.ndarray]], None], **packing: int) -> Path:
    """Write a .nacre file anew with something in it changed and all its checksums right."""
    import hashlib

    with zipfile.ZipFile(source) as old:
        header = json.loads(old.read("header.json"))
        arrays = {n[:-4]: np.load(io.BytesIO(old.read(n))) for n in old.namelist() if n != "header.json"}
    change(header, arrays)
    changed = source.with_name("changed.nacre")
    with zipfile.ZipFile(changed, "w", **packing) as new:  # type: ignore[call-overload]  # only `compression`
        for name, array in arrays.items():
            buffer = io.BytesIO()
            np.save(buffer, array)
            new.writestr(f"{name}.npy", buffer.getvalue())
            facts = {"shape": list(array.shape), "dtype": array.dtype.str}
            header["arrays"][name] = facts | {"sha256": hashlib.sha256(array.tobytes()).hexdigest()}
        new.writestr("header.json", json.dumps(header))
    return changed


def field(name: str, value: Any) -> Callable[[dict[str, Any], dict[str, np.ndarray]], None]:
    return lambda header, arrays: header["lobes"][0]["fields"].update({name: value})


def response(name: str, value: Any) -> Callable[[dict[str, Any], dict[str, np.ndarray]], None]:
    return lambda header, arrays: header["lobes"][0]["fields"]["response"]["fields"].update({name: value})


def table(name: str, change: Callable[[np.ndarray], Any]) -> Callable[[dict[str, Any], dict[str, np.ndarray]], None]:
    def apply(header: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
        key = f"lobe0.response.{name}"
        arrays[key] = np.ascontiguousarray(change(arrays[key]))

    return apply


@pytest.mark.parametrize(
    "change",
    [
        field("alpha_x", "rough"), field("alpha_x", None), field("alpha_x", True), field("alpha_x", 10**400),
        field("distribution", 3), field("response", {"tuple": []}), field("response", {"array": "lobe0.response.eta"}),
        field("loss", 5), response("parameters", {"array": "lobe0.response.reflectance"}), response("parameters", None),
        response("eta", "x"), response("eta", None), response("cos_outside", 1.0), response("flipped", "yes"),
        response("total", {"tuple": []}), table("reflectance", lambda a: -a), table("reflectance", lambda a: a + 1e300),
        table("cos_outside", lambda a: a[:, None]), table("wavelengths_nm", lambda a: a[::-1]),
        table("reflectance", lambda a: a.astype(complex)), table("total", lambda a: a[..., :0]),
    ],
)  # fmt: skip
def test_a_header_that_lies_is_found_on_loading(film: Path, change: Any) -> None:
    nacre.load(film).bsdf([450.0, 550.0, 650.0]).save(film.parent / "film.nacre")
    assert nacre.load(rewritten(film.parent / "film.nacre", lambda header, arrays: None)).bsdf().lobes
    with pytest.raises(NacreError, match=r"changed\.nacre"):
        nacre.load(rewritten(film.parent / "film.nacre", change))


@pytest.mark.parametrize("packing", [zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
def test_a_member_of_another_packing_is_refused(film: Path, packing: int) -> None:
    nacre.load(film).bsdf([550.0]).save(film.parent / "film.nacre")
    path = rewritten(film.parent / "film.nacre", lambda header, arrays: None, compression=packing)
    with pytest.raises(NacreError, match="compression"):
        nacre.load(path)


def test_a_member_of_a_bad_name_is_refused(film: Path) -> None:
    nacre.load(film).bsdf([550.0]).save(film.parent / "film.nacre")
    path = film.parent / "film.nacre"
    whole = path.read_bytes()
    # the directory at the file's end says that names are UTF-8, and one of them is not
    at = whole.rindex(b"header.json")
    flags = whole.rindex(b"PK\x01\x02", 0, at) + 8
    path.write_bytes(whole[:flags] + b"\x00\x08" + whole[flags + 2 : at] + b"\xff" + whole[at + 1 :])
    with pytest.raises(NacreError, match="is not a .nacre file"):
        nacre.load(path)


def test_what_is_said_stays_on_one_line_and_leaves_the_terminal_alone(
    film: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    refused(capsys, ["spectrum", "no\n\x1b[2Jsuch.toml"], "does not exist")
    refused(capsys, ["spectrum", "a\0b.toml"], "NUL")
    assert run(["spectrum", "x\x1b[31m.toml"]) == 2
    assert "\x1b" not in capsys.readouterr().err


def test_a_mesh_of_two_coordinates_is_refused(tmp_path: Path) -> None:
    from nacre.picture.subjects import read_mesh

    (tmp_path / "flat.obj").write_text("v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n")
    with pytest.raises(NacreError, match="flat.obj"):
        read_mesh(tmp_path / "flat.obj")


def test_a_broken_header_of_heights_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "h.npy", np.zeros((4, 4)))
    whole = (tmp_path / "h.npy").read_bytes()
    (tmp_path / "h.npy").write_bytes(whole.replace(b"(4, 4), }", b"(4, 4(, }"))
    relief = {"family": "relief", "heights": "h.npy", "feature_um": 1.5, "blur_um": 0.4, "coating": "Al",
              "coherence": {"sigma": 2.0}}  # fmt: skip
    with pytest.raises(NacreError, match="h.npy"):
        nacre.material(relief, tmp_path)


def test_a_broken_tag_of_a_texture_raises_no_warning(tmp_path: Path) -> None:
    from PIL import Image

    Image.fromarray(np.arange(35, dtype=np.uint8).reshape(5, 7)).save(tmp_path / "t.tif")
    whole = bytearray((tmp_path / "t.tif").read_bytes())
    first = int.from_bytes(whole[4:8], "little") + 2
    whole[first + 4 : first + 8] = (1 << 20).to_bytes(4, "little")  # the first tag says that it is a megabyte long
    (tmp_path / "t.tif").write_bytes(whole)
    texture = {"texture": "t.tif", "min": 1, "max": 2}
    with pytest.raises(NacreError, match="t.tif"):  # pytest makes an error of every warning
        nacre.material({**FILM, "layers": [{"material": "SiO2", "thickness_nm": texture}]}, tmp_path)


SCENE = """<scene version="3.0.0"><integrator type="path"/>
<sensor type="perspective"><transform name="to_world"><lookat origin="0,-5,1" target="0,0,0" up="0,0,1"/></transform>
<film type="hdrfilm"><integer name="width" value="SIDE"/><integer name="height" value="8"/></film></sensor>
<emitter type="constant"/><shape type="sphere">PLACE<bsdf type="diffuse" id="nacre"/></shape></scene>"""


@pytest.mark.render
@pytest.mark.parametrize(
    ("place", "side", "words"),
    [
        ('<float name="radius" value="nan"/>', 8, "no finite size"),
        ('<float name="radius" value="0"/>', 8, "no finite size"),
        ('<float name="radius" value="inf"/>', 8, "no finite size"),
        ('<point name="center" x="nan" y="0" z="0"/>', 8, "no finite size"),
        ('<transform name="to_world"><translate x="nan"/></transform>', 8, "no finite size"),
        ("", 0, "s.xml"),
        ("", 99_999_999, "size ="),
    ],
)
def test_a_scene_of_impossible_numbers_is_refused(
    film: Path, capfd: pytest.CaptureFixture[str], place: str, side: int, words: str
) -> None:
    (film.parent / "s.xml").write_text(SCENE.replace("PLACE", place).replace("SIDE", str(side)))
    assert run(["render", str(film), "--scene", "s.xml", "--spp", "1", "-o", "x.png"]) == 2
    said = capfd.readouterr().err
    assert words in said and said.count("\n") == 1, said


def test_an_obj_with_tabs_is_read(tmp_path: Path) -> None:
    from nacre.picture.subjects import read_mesh

    text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n"
    (tmp_path / "tabs.obj").write_text(text.replace(" ", "\t"))
    assert len(read_mesh(tmp_path / "tabs.obj").faces) == 2


def test_a_refused_file_is_shown_as_in_a_recipe() -> None:
    from nacre.readers.curves import FileSpec
    from nacre.recipe.model import show_value

    assert show_value(FileSpec(file="h.csv")) == '{file = "h.csv"}'
