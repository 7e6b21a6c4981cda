"""The objects of the page: triangles from pictures' shapes and from own meshes, and what of those is refused."""

from __future__ import annotations

import base64
import io
import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from PIL import Image
from starlette.testclient import TestClient

import nacre
from nacre.core.errors import NacreError
from nacre.picture.environments import directions
from nacre.picture.mesh import Mesh, parametric
from nacre.picture.subjects import read_mesh
from nacre.recipe.toml import parse_toml
from nacre.studio import objects, server
from nacre.studio.folder import OpenedFolder
from nacre.studio.objects import OBJECTS, MeshStore, computed_psi_delta, simplified
from nacre.studio.server import HEADER, make_app
from nacre.studio.surroundings import ALPHAS, GREY, LAYERS, ROWS, without_lamp

PORT, TOKEN = 8125, "a-token-for-the-tests"
FILM = 'family = "film"\nsubstrate = "Si"\nlayers = [{material = "SiO2", thickness_nm = 300}]\n'
# a roof, 1 wide, 2 deep and 3 high, with y up
ROOF = """v 0 0 0\nv 1 0 0\nv 0.5 3 0\nv 0 0 2\nv 1 0 2\nv 0.5 3 2
f 1 2 3\nf 4 6 5\nf 1 3 6\nf 1 6 4\nf 2 5 6\nf 2 6 3\nf 1 4 5\nf 1 5 2
"""


@pytest.fixture
def client(tmp_path: Path) -> Iterator[TestClient]:
    (tmp_path / "film.toml").write_text(FILM)
    app = make_app(OpenedFolder.of(str(tmp_path)), TOKEN, PORT)
    with TestClient(app, base_url=f"http://127.0.0.1:{PORT}", headers={HEADER: TOKEN}) as client:
        yield client


def last_png(lines: str) -> bytes:
    """The picture that a stream of passes ends with."""
    event = [json.loads(line) for line in lines.splitlines()][-2]
    assert event["kind"] == "picture" and event["is_last"]
    return base64.b64decode(event["png"].partition(",")[2])


def unpack(data: bytes) -> dict[str, Any]:
    (length,) = struct.unpack_from("<I", data)
    reported: dict[str, Any] = json.loads(data[4 : 4 + length])
    corners = np.frombuffer(data, "<f4", 8 * reported["vertices"], 4 + length).reshape(-1, 8)
    order = np.frombuffer(data, "<u4", reported["indices"], 4 + length + corners.nbytes)
    sheet = np.frombuffer(data, "u1", int(np.prod(reported["print"])), 4 + length + corners.nbytes + order.nbytes)
    assert 4 + length + corners.nbytes + order.nbytes + sheet.nbytes == len(data)
    return {**reported, "corners": corners, "order": order, "sheet": sheet.reshape(reported["print"])}


def unpack_place(data: bytes) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Layers of a place, and what its lamp adds to a matt white floor."""
    (length,) = struct.unpack_from("<I", data)
    reported = json.loads(data[4 : 4 + length])
    ((name, shape),) = reported["arrays"]
    assert name == "room" and shape == [LAYERS, ROWS, 2 * ROWS, 3]
    lamp = reported["lamp"]
    added = np.zeros(3) if lamp is None else np.array(lamp["irradiance"]) * lamp["towards"][2] / np.pi
    return np.frombuffer(data, "<f4", offset=4 + length).reshape(shape), added


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name == "panel" else pytest.mark.full) for name in OBJECTS]
)
def test_an_object_is_whole_and_small_enough(client: TestClient, name: str) -> None:
    found = unpack(client.get(f"/api/object?name={name}").content)
    assert found["indices"] <= 3 * objects.MAX_FACES and found["order"].max() < found["vertices"]
    assert sum(part["count"] for part in found["parts"]) == found["indices"]
    assert any("plain" not in part for part in found["parts"])
    np.testing.assert_allclose(np.linalg.norm(found["corners"][:, 3:6], axis=1), 1.0, atol=1e-4)
    assert found["corners"][:, 2].min() > -0.05 and np.isfinite(found["corners"]).all()


def test_what_is_printed_on_a_note_comes_with_it(client: TestClient) -> None:
    found = unpack(client.get("/api/object?name=banknote").content)
    assert [part.get("printed", False) for part in found["parts"]] == [False, True]
    sheet = found["sheet"] / 255.0
    assert sheet[:, -3:].mean() == pytest.approx(0.74, abs=0.02) and sheet.min() < 0.3  # blank paper, and ink
    rows, columns = sheet.shape
    # the large number stands on the right, in the middle: rows run from below
    number = sheet[int(0.4 * rows) : int(0.6 * rows), int(0.78 * columns) : int(0.97 * columns)]
    assert number.mean() < sheet.mean() - 0.05
    assert unpack(client.get("/api/object?name=panel").content)["sheet"].size == 0


@pytest.mark.parametrize("name", ["", "sphere", "../knob"])
def test_an_unknown_object_is_one_line(client: TestClient, name: str) -> None:
    answer = client.get(f"/api/object?name={name}")
    assert answer.status_code == 422 and "\n" not in answer.json()["error"]


def ball(cells: int, v_most: float = 1.0) -> Mesh:
    """A sphere of radius 1, or its part up to a share of the way from pole to pole."""

    def position(u: Any, v: Any) -> Any:
        theta, phi = np.pi * v * v_most, 2 * np.pi * u
        return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), -np.cos(theta)], axis=-1)

    return parametric(position, cells, cells)


def test_fewer_triangles_keep_the_form_and_open_edges() -> None:
    most = 4000
    made = simplified(ball(120), most)
    assert most / 4 < len(made.faces) <= most
    # as far inside as the chord of a cell: about 20 cells a radius
    assert np.abs(np.linalg.norm(made.vertices, axis=1) - 1.0).max() < 0.01
    assert np.sum(made.vertices * made.normals, axis=1).min() > 0.99
    bowl = ball(120, 0.5)
    rim = bowl.vertices[np.abs(bowl.vertices[:, 2]) < 1e-9]
    found = simplified(bowl, most).vertices
    assert len(rim) > 100
    assert max(np.abs(found - corner).sum(axis=1).min() for corner in rim) < 1e-12


def test_an_own_mesh_stands_as_in_pictures(client: TestClient) -> None:
    found = unpack(client.post("/api/mesh?name=my roof.obj", content=ROOF.encode()).content)
    assert found["name"] == "my roof.obj" and found["faces"] == 8
    extent = np.ptp(found["corners"][:, :3], axis=0)
    np.testing.assert_allclose(extent / extent[2], [1 / 3, 2 / 3, 1], atol=1e-5)  # an OBJ has y up
    assert found["corners"][:, 2].min() == pytest.approx(0.0, abs=1e-6)
    lying = unpack(client.post("/api/mesh?name=roof.obj&up=z", content=ROOF.encode()).content)
    extent = np.ptp(lying["corners"][:, :3], axis=0)
    np.testing.assert_allclose(extent / extent[1], [1 / 3, 1, 2 / 3], atol=1e-5)


BROKEN = [
    ("roof.obj", b"", "roof.obj"),
    ("roof.stl", b"no mesh at all", "roof.stl"),
    ("roof.ply", b"ply\nformat ascii 1.0\nelement vertex 3\n", "roof.ply"),
    ("line.obj", b"v 0 0 0\nv 1 1 1\nv 2 2 2\nv 3 3 3\nf 1 2 3\nf 2 3 4\n", "no triangle of it has an area"),
    ("roof.txt", ROOF.encode(), "is not a mesh"),
    ("../../x.obj", b"junk", "x.obj"),
]


@pytest.mark.parametrize("name, content, words", BROKEN)
def test_a_mesh_that_cannot_be_read_is_one_line(client: TestClient, name: str, content: bytes, words: str) -> None:
    answer = client.post("/api/mesh", params={"name": name}, content=content)
    reported = answer.json()["error"]
    assert answer.status_code == 422 and words in reported and "\n" not in reported and "/tmp" not in reported


def test_a_large_mesh_is_refused(client: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "MAX_UPLOAD", 100)
    answer = client.post("/api/mesh?name=roof.obj", content=ROOF.encode())
    assert answer.status_code == 422 and "MiB" in answer.json()["error"]
    assert client.post("/api/mesh?name=roof.obj&up=w", content=b"v 0 0 0").status_code == 422


def test_a_mesh_alone_reads_no_other_file(tmp_path: Path) -> None:
    scene = trimesh.Scene(trimesh.creation.box())
    for name, content in trimesh.exchange.gltf.export_gltf(scene).items():
        (tmp_path / name).write_bytes(content)
    path = next(tmp_path.glob("*.gltf"))
    assert len(read_mesh(path).faces) == 12
    with pytest.raises(NacreError, match="cannot be read as a mesh"):
        read_mesh(path, is_alone=True)


def test_only_the_last_few_own_meshes_are_kept() -> None:
    meshes = MeshStore(capacity=2)
    names = []
    for _ in range(3):
        name, _, keep = meshes.place(".obj")
        keep.write_bytes(b"ply")
        names.append(name)
    assert meshes.path(names[2]).is_file() and meshes.path(names[1]).is_file()
    for gone in (names[0], "../film", "own-9", ""):
        with pytest.raises(NacreError, match="no longer has"):
            meshes.path(gone)


@pytest.mark.full
@pytest.mark.render
def test_a_picture_shows_the_own_mesh(client: TestClient) -> None:
    identity = unpack(client.post("/api/mesh?name=roof.obj", content=ROOF.encode()).content)["id"]
    asked = {"text": FILM, "name": "film.toml", "size": 128, "seconds": 1}
    pictures = [
        np.asarray(Image.open(io.BytesIO(last_png(client.post("/api/picture", json=body).text))), dtype=float)
        for body in (asked, {**asked, "mesh": identity})
    ]
    assert np.abs(pictures[0] - pictures[1]).mean() > 5  # a roof is no sphere
    gone = client.post("/api/picture", json={**asked, "mesh": "own-77"})
    assert gone.status_code == 422 and "drop it" in gone.json()["error"]


@pytest.mark.full
@pytest.mark.render
@pytest.mark.parametrize("name", ["sun", "sky"])
def test_a_sky_lights_the_floor_as_mitsuba_says(name: str) -> None:
    """Compare a rendered matt white sheet under the picture's light with the table that the page uses."""
    from nacre.device.variant import use_variant
    from nacre.light import xyz_to_srgb_linear
    from nacre.picture.emitters import make_light
    from nacre.studio.surroundings import sky_job

    mi = use_variant()
    above = mi.ScalarTransform4f().look_at([0, 0, 3], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 8, "height": 8, "pixel_format": "xyz"}
    sheet = {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": 1.0}}
    scene = mi.load_dict({
        "type": "scene", "light": make_light(name).emitters["sky"], "sheet": sheet,
        "sensor": {"type": "orthographic", "to_world": above, "film": film},
    })  # fmt: skip
    shown = mi.render(scene, spp=2048, integrator=mi.load_dict({"type": "path", "max_depth": 2}))
    rooms, lamp = unpack_place(sky_job({"name": name}))
    assert (lamp.max() > 0) == (name == "sun")
    wanted = xyz_to_srgb_linear(np.array(shown).mean(axis=(0, 1)))
    # rows of 1.4 degrees, wavelengths of 10 nm, and the noise of what is rendered
    on_floor = rooms[len(ALPHAS), 0].mean(axis=0) + lamp
    np.testing.assert_allclose(on_floor, wanted, rtol=0.03, atol=0.01)
    ground = rooms[0, 3 * ROWS // 4].mean(axis=0)
    np.testing.assert_allclose(ground, GREY * on_floor, rtol=0.03)


@pytest.mark.parametrize("name", ["interior", "street"])
def test_a_place_lights_the_floor_as_in_pictures_and_has_colours(client: TestClient, name: str) -> None:
    answer = client.get(f"/api/surroundings?name={name}")
    rooms, lamp = unpack_place(answer.content)
    on_floor = rooms[len(ALPHAS), 0].mean(axis=0) + lamp  # a matt white floor, by the layer's row at the zenith
    # its luminance as pictures balance every place, `_Canvas.finish`; the rows are 1.4 degrees wide
    assert on_floor @ [0.2126, 0.7152, 0.0722] == pytest.approx(0.6, rel=0.03)
    assert np.ptp(rooms[0], axis=2).max() > 0.1 and rooms.min() >= -1e-3
    assert (lamp.max() > 0) == (name == "street")
    unknown = client.get("/api/surroundings?name=moon")
    assert unknown.status_code == 422 and "moon" in unknown.json()["error"]


def test_a_lamp_is_taken_out_of_its_place_whole() -> None:
    """A disc of 4 degrees in an even room: its direction, its light on a surface that faces it, its width."""
    rows, level, sun = 512, 0.5, np.array([900.0, 800.0, 600.0])
    d = directions(rows)
    middle = np.array([0.3, -0.5, 0.8]) / np.linalg.norm([0.3, -0.5, 0.8])
    radius = np.radians(2.0)
    disc = np.arccos(np.clip(d @ middle, -1.0, 1.0)) < radius
    rgb = np.full((*disc.shape, 3), level) + disc[..., None] * sun
    rest, lamp = without_lamp(rgb)
    assert lamp is not None
    np.testing.assert_allclose(rest, level, rtol=1e-9)
    np.testing.assert_allclose(lamp.towards, middle, atol=1e-3)
    # rows of 0.35 degrees in a disc of 4: a fiftieth of its area
    np.testing.assert_allclose(lamp.irradiance, sun * np.pi * np.sin(radius) ** 2, rtol=0.02)
    assert lamp.radius_rad == pytest.approx(radius, rel=0.02)
    even, none = without_lamp(np.full((32, 64, 3), level))
    assert none is None and np.all(even == level)


SCOPE = "Dark Spectrum Present: Yes\nReference Spectrum Present: Yes\n>>>>>Begin Processed Spectral Data<<<<<\n"


def test_a_dropped_spectrum_is_answered_as_a_curve(client: TestClient) -> None:
    rows = "".join(f"{nm}\t{20 + nm / 100}\n" for nm in range(300, 900))
    found = client.post("/api/measurement?name=wing.txt", content=(SCOPE + rows).encode()).json()
    (curve,) = found["curves"]
    assert curve["nm"][0] == 380.0 and curve["nm"][-1] <= 780.0
    assert curve["values"][0] == pytest.approx(0.238)
    assert found["colours"] == [] and len(found["summary"]) == 1


def test_a_dropped_colour_list_is_answered_as_colours(client: TestClient) -> None:
    found = client.post("/api/measurement?name=x.gpl", content=b"GIMP Palette\n255 0 0 red\n0 0 255 blue\n").json()
    assert found["colours"] == [{"name": "red", "hex": "#ff0000"}, {"name": "blue", "hex": "#0000ff"}]


PSI = "Wavelength (nm)\tAngle (deg)\tPsi (deg)\tDelta (deg)\n"


def test_dropped_psi_and_delta_are_answered_by_angle_and_computed_beside(client: TestClient) -> None:
    wafer = 'family = "film"\nsubstrate = "Si"\nlayers = [{material = "SiO2", thickness_nm = 10}]\n'
    data = nacre.material(parse_toml(wafer, "wafer"))
    known = nacre.ellipsometry(data, [60.0, 70.0], np.arange(400.0, 700.0, 5.0))
    rows = [
        f"{nm}\t{angle}\t{known.psi_deg[i, j]:.5f}\t{known.delta_deg[i, j]:.5f}\n"
        for i, angle in enumerate((60, 70))
        for j, nm in enumerate(known.wavelengths_nm)
    ]
    found = client.post("/api/measurement?name=wafer.txt", content=(PSI + "".join(rows)).encode()).json()
    assert [curve["angle_deg"] for curve in found["ellipsometry"]] == [60.0, 70.0] and not found["is_scan"]
    asked = {"angles_deg": [60.0, 70.0], "range_nm": [400.0, 695.0]}
    computed = computed_psi_delta(data, asked)
    assert computed is not None
    for i, curve in enumerate(found["ellipsometry"]):
        np.testing.assert_allclose(curve["psi"], known.psi_deg[i], atol=1e-4)
        np.testing.assert_allclose(np.interp(curve["nm"], computed["nm"], computed["psi"][i]), curve["psi"], atol=0.02)
    for wrong in (None, {}, {"angles_deg": [95.0], "range_nm": [400, 700]}, {"angles_deg": [60], "range_nm": "all"}):
        assert computed_psi_delta(data, wrong) is None
    rest = computed_psi_delta(nacre.load("pearl/bottle3"), asked)
    assert rest is not None and set(rest) == {"note"}


def test_a_dropped_scan_is_stored_beside_the_recipes_and_becomes_a_relief(client: TestClient, tmp_path: Path) -> None:
    heights = 1e-8 * np.random.default_rng(1).normal(size=(32, 32))
    head = "# Channel: Topography\n# Width: 8 µm\n# Height: 8 µm\n# Value units: m\n"
    text = head + "".join("\t".join(f"{z:.4e}" for z in row) + "\n" for row in heights)
    for _ in range(2):  # the same file may be dropped again
        made = client.post("/api/scan?name=scan.txt", content=text.encode()).json()
        assert (tmp_path / "scan.txt").read_bytes() == text.encode()
    material = OpenedFolder.of(str(tmp_path)).material(made["text"], made["name"])
    assert material.family == "relief" and made["version"] == "" and not (tmp_path / made["name"]).exists()
    for name, content in (
        ("scan.txt", text + "\n"),
        ("small.txt", head + "1e-9\t2e-9\n3e-9\t1e-9\n"),
        ("wing.txt", SCOPE),
    ):
        before = sorted(path.name for path in tmp_path.iterdir())
        answer = client.post("/api/scan", params={"name": name}, content=content.encode())
        assert answer.status_code == 422 and name in answer.json()["error"] and "upload" not in answer.json()["error"]
        assert sorted(path.name for path in tmp_path.iterdir()) == before
    assert client.post("/api/scan?name=.hidden", content=text.encode()).status_code == 422


@pytest.mark.parametrize("name, content", [("a.bin", b"\0\1\2\3"), ("../../x.dpt", b"1,2\n2,3\n3,4\n"), ("e.txt", b"")])
def test_a_dropped_file_that_cannot_be_read_is_one_line(client: TestClient, name: str, content: bytes) -> None:
    answer = client.post("/api/measurement", params={"name": name}, content=content)
    reported = answer.json()["error"]
    assert answer.status_code == 422 and "\n" not in reported and "/tmp" not in reported
    assert name.rpartition("/")[2] in reported
