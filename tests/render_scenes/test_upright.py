"""Which way is up: u runs to the right and v upward on every scene, and meshes of any format stand in the frame."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image, ImageDraw

import nacre
from nacre.core.errors import NacreError
from nacre.picture.scenes import SCENES, Scene
from nacre.picture.subjects import read_mesh, stand_on_floor, subject_parts

pytestmark = pytest.mark.render

# a wing's v runs along its veins, from the root outward, since ridges lie so; every other scene must agree
UPRIGHT = [name for name in SCENES if name != "butterfly"]
# of the visible surface; what bends away over a rim may differ
MOST = 0.97
MIRROR = {"family": "film", "substrate": "Al"}


def seen(scene: Scene, count: int = 96) -> tuple[np.ndarray, np.ndarray]:
    """uv `[row, column, 2]` of the subject before its own camera, NaN elsewhere, and the points hit."""
    from nacre.picture.built_scene import BuiltScene
    from nacre.picture.emitters import make_light

    built = BuiltScene(scene, make_light("directional", "D65", 0.0), see_through=False)
    from nacre.device.variant import use_variant

    mi = use_variant()
    sensor = built.sensor(scene.view, (count, count), {"type": "hdrfilm"})
    across, down = np.meshgrid(*2 * [(np.arange(count) + 0.5) / count])
    place = mi.Point2f(across.ravel(), down.ravel())
    ray, _ = sensor.sample_ray(0.0, 0.5, place, mi.Point2f(0.5))
    hit = built.mitsuba_scene.ray_intersect(ray)
    subject = np.zeros(count * count, dtype=bool)
    for shape in built.subjects:
        subject |= np.array(hit.shape == mi.ShapePtr(shape))
    uv, point = np.array(hit.uv).T, np.array(hit.p).T
    uv[~subject] = np.nan
    return uv.reshape(count, count, 2), point.reshape(count, count, 3)


def share(positive: np.ndarray) -> float:
    return float(np.mean(positive[np.isfinite(positive)] > 0))


@pytest.mark.parametrize("name", UPRIGHT)
def test_u_runs_to_the_right_and_v_upward_on(name: str) -> None:
    uv, _ = seen(SCENES[name])
    assert np.isfinite(uv).any(axis=-1).mean() > 0.05
    assert share(np.diff(uv[..., 0], axis=1)) > MOST
    assert share(-np.diff(uv[..., 1], axis=0)) > MOST


def test_on_wings_v_runs_from_the_root_outward_and_nothing_is_mirrored() -> None:
    uv, point = seen(SCENES["butterfly"])
    radius = np.hypot(point[..., 0], point[..., 1] - 0.12)
    du, dv = np.diff(uv, axis=1), -np.diff(uv, axis=0)
    turn = du[:-1, :, 0] * dv[:, :-1, 1] - dv[:, :-1, 0] * du[:-1, :, 1]
    assert share(turn) > 0.95
    inner, outer = (np.nanmean(uv[..., 1][(radius > a) & (radius < b)]) for a, b in ((0.4, 0.7), (1.3, 1.6)))
    assert outer > inner + 0.3


def letter(path: Path) -> np.ndarray:
    """Write an R, white on black; return it, top row first."""
    image = Image.new("L", (64, 64), 0)
    draw = ImageDraw.Draw(image)
    draw.rectangle((18, 10, 25, 54), fill=255)
    draw.rectangle((18, 10, 44, 17), fill=255)
    draw.rectangle((18, 28, 44, 35), fill=255)
    draw.rectangle((38, 10, 45, 35), fill=255)
    draw.line((26, 34, 44, 54), fill=255, width=8)
    image.save(path)
    return np.asarray(image, dtype=float)


def turnings(image: np.ndarray) -> list[np.ndarray]:
    """The eight ways to lay a square picture down; as drawn first."""
    quarter = [np.rot90(image, k) for k in range(4)]
    return quarter + [np.fliplr(q) for q in quarter]


def brightness(material: Any, **options: Any) -> np.ndarray:
    result = nacre.render.render(material, spp=16, exposure=0.0, **options)
    return np.asarray(result.xyz[..., 1])


def tile_scene(path: Path) -> Scene:
    """A square that stands in the plane x-y of a y-up file and faces +z, where the camera is."""
    from nacre.picture.built_scene import with_subject

    path.write_text(
        "v -1 0 0\nv 1 0 0\nv 1 2 0\nv -1 2 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0 1\n"
        "f 1/1/1 2/2/1 3/3/1\nf 1/1/1 3/3/1 4/4/1\n"
    )
    scene = SCENES["sphere"]
    return with_subject(scene, lambda: subject_parts(path, scene))


@pytest.mark.parametrize("name", ["sphere", "panel", "knob", "ring", "card", "tile.obj"])
def test_a_letter_r_reads_as_drawn_on(tmp_path: Path, name: str) -> None:
    """Of the eight ways to lay the letter on what the camera sees of u and v, as drawn is the picture."""
    drawn = letter(tmp_path / "r.png")
    mesh = tmp_path / name if name.endswith(".obj") else None
    scene = tile_scene(mesh) if mesh else SCENES[name]
    count = 64
    uv, _ = seen(scene, count)
    inside = np.isfinite(uv[..., 0])
    column, row = (np.clip((t * 64).astype(int), 0, 63) for t in (uv[inside][:, 0], 1 - uv[inside][:, 1]))
    # an absorbing layer of germanium darkens the silver where the letter is bright
    pictures = []
    for thickness in ({"texture": str(tmp_path / "r.png"), "min": 0, "max": 40}, 0):
        layer = {"material": "Ge", "thickness_nm": thickness}
        recipe = {"family": "film", "substrate": "Ag", "layers": [layer], "surface": {"roughness": 0.5}}
        where = {"scene": "sphere", "shape": mesh} if mesh else {"scene": name}
        pictures.append(brightness(nacre.material(recipe), **where, size=(count, count), light="sky"))
    darkening = 1 - pictures[0][inside] / pictures[1][inside]
    likeness = [np.corrcoef(way[row, column], darkening)[0, 1] for way in turnings(drawn)]
    assert np.argmax(likeness) == 0, likeness
    assert likeness[0] > 0.8


OWN = """<scene version="3.0.0"><integrator type="path"/><emitter type="constant"/>{shape}
<sensor type="perspective"><float name="fov" value="28.07"/><transform name="to_world">
<lookat origin="0,-0.001,4" target="0,0,0" up="0,1,0"/></transform><film type="hdrfilm">
<integer name="width" value="64"/><integer name="height" value="64"/></film></sensor></scene>"""
QUAD = "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3 4/4\n"
BALL = '<transform name="to_world"><rotate x="1" angle="-90"/></transform>'  # its pole up in the picture


@pytest.mark.parametrize(
    ("kind", "inside"),
    [
        ("obj", '<string name="filename" value="quad.obj"/>'),
        ("obj", '<string name="filename" value="quad.obj"/><boolean name="flip_tex_coords" value="false"/>'),
        ("rectangle", ""),
        ("sphere", BALL),
    ],
    ids=["obj", "obj as it is", "rectangle", "sphere"],
)
def test_a_letter_r_stands_upright_in_a_mitsuba_scene_of_ones_own(tmp_path: Path, kind: str, inside: str) -> None:
    """Mitsuba's OBJ reader turns v about, and its sphere counts it from the top: the R stood on its head."""
    (tmp_path / "quad.obj").write_text(QUAD)
    shape = f'<shape type="{kind}">{inside}<bsdf type="diffuse" id="nacre"/></shape>'
    (tmp_path / "own.xml").write_text(OWN.format(shape=shape))
    drawn = letter(tmp_path / "r.png")
    seen_at = np.s_[8:56, 8:56]
    if kind == "sphere":  # u = 0.75 and v = 0.5 in its middle, where the letter is half as wide as the ball
        canvas = np.zeros((268, 536), dtype=np.uint8)
        canvas[102:166, 370:434] = drawn
        Image.fromarray(canvas).save(tmp_path / "r.png")
        drawn, seen_at = drawn[::2, ::2], np.s_[16:48, 16:48]
    pictures = []
    for thickness in ({"texture": str(tmp_path / "r.png"), "min": 0, "max": 40}, 0):
        layer = {"material": "Ge", "thickness_nm": thickness}
        recipe = {"family": "film", "substrate": "Ag", "layers": [layer], "surface": {"roughness": 0.5}}
        pictures.append(brightness(nacre.material(recipe), scene=str(tmp_path / "own.xml")))
    darkening = 1 - pictures[0][seen_at] / pictures[1][seen_at]
    ways = [way if kind == "sphere" else way[seen_at] for way in turnings(drawn)]
    likeness = [np.corrcoef(way.ravel(), darkening.ravel())[0, 1] for way in ways]
    assert np.argmax(likeness) == 0 and likeness[0] > 0.7, likeness


def test_a_formula_of_v_darkens_the_top_of_the_sphere() -> None:
    pictures = []
    for thickness in ({"formula": "40*clip((v - 0.5)*100, 0, 1)"}, 0):
        layer = {"material": "Ge", "thickness_nm": thickness}
        material = nacre.material({"family": "film", "substrate": "Ag", "layers": [layer]})
        pictures.append(brightness(material, scene="sphere", size=(48, 48), light="sky"))
    ratio = pictures[0] / pictures[1]
    assert ratio[12:20, 20:28].max() < 0.9 < ratio[34:38, 20:28].min()


@pytest.mark.parametrize(("suffix", "axis"), [(".obj", 1), (".glb", 1), (".stl", 2), (".ply", 2), (".off", 2)])
def test_each_format_is_read_with_its_own_axis_up(tmp_path: Path, suffix: str, axis: int) -> None:
    """A cone whose tip points along one axis: the tip ends on top where that axis is up."""
    import trimesh

    for tip, up in ((axis, None), (0, "x"), (1, "y"), (2, "z")):
        cone = trimesh.creation.cone(radius=0.3, height=2.0)  # along z
        vertices = np.roll(cone.vertices, tip - 2, axis=1)  # cyclic, so that the faces keep looking outward
        path = tmp_path / f"cone{tip}{suffix}"
        trimesh.Trimesh(vertices, cone.faces).export(path)
        surface = stand_on_floor(read_mesh(path, up), SCENES["sphere"])
        top = surface.vertices[np.argmax(surface.vertices[:, 2])]
        assert np.hypot(*top[:2]) < 1e-3 * top[2]
        assert (surface.normals[:, 2] < -0.5).any()  # the base looks down


def quad_with(material: Any, shift: float) -> Any:
    import trimesh

    vertices = np.array([[-1, 0, 0], [1, 0, 0], [1, 2, 0], [-1, 2, 0]], float) + [shift, 0, 0]
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    return trimesh.Trimesh(vertices, [[0, 1, 2], [0, 2, 3]], process=False, visual=visual)


@pytest.mark.parametrize("suffix", [".obj", ".glb"])
def test_uv_of_a_mesh_of_several_materials_is_that_of_its_file(tmp_path: Path, suffix: str) -> None:
    """Joined by trimesh, their images were packed into one, and uv shrank to 0.02 ... 0.5 of it."""
    import trimesh

    kind = trimesh.visual.material.PBRMaterial
    first = kind(name="a", baseColorTexture=Image.new("RGB", (64, 64), "red"))
    second = kind(name="b", baseColorFactor=[0, 0, 255, 255])
    trimesh.Scene([quad_with(first, 0.0), quad_with(second, 3.0)]).export(tmp_path / f"two{suffix}")
    uv = read_mesh(tmp_path / f"two{suffix}").uv
    assert sorted(map(tuple, uv.round(6))) == sorted(2 * [(0, 0), (1, 0), (1, 1), (0, 1)])


GLTF_CORNERS = np.array([[-1, 0, 0], [1, 0, 0], [1, 2, 0], [-1, 2, 0]], "<f4")
GLTF_UV = np.array([[0.1, 0.9], [0.8, 0.9], [0.8, 0.3], [0.1, 0.3]])


def gltf(uv: NDArray[Any], component: int = 5126) -> tuple[dict[str, Any], bytes]:
    """Return the tree and the buffer of a square; `component` is the kind of the numbers of its uv."""
    rows = np.zeros((4, 8 // uv.itemsize), uv.dtype)  # 8 bytes a row, whatever the kind
    rows[:, :2] = uv
    data = GLTF_CORNERS.tobytes() + rows.tobytes() + np.array([0, 1, 2, 0, 2, 3], "<u2").tobytes()
    views = [{"buffer": 0, "byteOffset": a, "byteLength": b} for a, b in ((0, 48), (48, 32), (80, 12))]
    views[1]["byteStride"] = 8
    tree = {
        "asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "buffers": [{"byteLength": len(data)}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2}]}],
        "bufferViews": views,
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [-1, 0, 0], "max": [1, 2, 0]},
            {"bufferView": 1, "componentType": component, "normalized": component != 5126, "count": 4, "type": "VEC2"},
            {"bufferView": 2, "componentType": 5123, "count": 6, "type": "SCALAR"},
        ],
    }  # fmt: skip
    return tree, data


def write_gltf(path: Path, tree: dict[str, Any], data: bytes) -> None:
    """Write a tree with its buffer within: as a data URI, or as the second chunk of a GLB."""
    if path.suffix == ".gltf":
        tree["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
        path.write_text(json.dumps(tree))
        return
    text = json.dumps(tree).encode()
    text, data = text + b" " * (-len(text) % 4), data + b"\0" * (-len(data) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


@pytest.mark.parametrize("suffix", [".gltf", ".glb"])
@pytest.mark.parametrize(("kind", "component"), [("<f4", 5126), ("<u2", 5123), ("u1", 5121)])
def test_a_gltf_without_materials_keeps_its_uv(tmp_path: Path, suffix: str, kind: str, component: int) -> None:
    """trimesh reads uv only of primitives with a material, and does not scale integers; in glTF v runs down."""
    white = 1 if kind == "<f4" else np.iinfo(kind).max
    stored = (GLTF_UV * white).astype(kind) if white == 1 else np.rint(GLTF_UV * white).astype(kind)
    write_gltf(tmp_path / f"bare{suffix}", *gltf(stored, component))
    read = read_mesh(tmp_path / f"bare{suffix}")
    np.testing.assert_allclose(read.uv, GLTF_UV * [1, -1] + [0, 1], atol=1e-6 if white == 1 else 0.5 / white)
    assert len(read_mesh(tmp_path / f"bare{suffix}", is_alone=True).uv) == 4


def test_a_gltf_finds_the_buffer_that_its_uri_names(tmp_path: Path) -> None:
    """Modelling programs write %20 for a space; what is missing is named."""
    tree, data = gltf(GLTF_UV.astype("<f4"))
    (tmp_path / "my tile é.bin").write_bytes(data)
    for uri in ("my%20tile%20%C3%A9.bin", "my tile é.bin"):
        tree["buffers"][0]["uri"] = uri
        (tmp_path / "a.gltf").write_text(json.dumps(tree))
        np.testing.assert_array_equal(read_mesh(tmp_path / "a.gltf").vertices[:, 2], GLTF_CORNERS[:, 1])
    tree["buffers"][0]["uri"] = "gone.bin"
    (tmp_path / "a.gltf").write_text(json.dumps(tree))
    with pytest.raises(NacreError, match='names "gone.bin", which is not beside it'):
        read_mesh(tmp_path / "a.gltf")


def test_what_a_gltf_packs_is_refused(tmp_path: Path) -> None:
    """trimesh reads such numbers as zeros, or as they are."""
    for packing in ("EXT_meshopt_compression", "sparse accessors", "normalized positions", "signed numbers"):
        tree, data = gltf(GLTF_UV.astype("<f4"))
        position, uv, _ = tree["accessors"]
        if packing.startswith("EXT"):
            tree["extensionsRequired"] = [packing]
        elif packing.startswith("sparse"):
            position["sparse"] = {"count": 1}
        elif packing.startswith("normal"):
            position["normalized"] = True
        else:
            uv |= {"componentType": 5122, "normalized": True}
        write_gltf(tmp_path / "a.glb", tree, data)
        with pytest.raises(NacreError, match=packing):
            read_mesh(tmp_path / "a.glb")


@pytest.mark.parametrize("seen_along", ["x", "y", "z"])
@pytest.mark.parametrize("is_turned", [False, True])
def test_a_polygon_with_notches_is_cut_within_its_outline(tmp_path: Path, seen_along: str, is_turned: bool) -> None:
    """A polygon in the form of an E has the area of its strokes for any first corner; a fan would cover its gaps."""
    outline = [(0, 0), (3, 0), (3, 1), (1, 1), (1, 2), (2, 2), (2, 3), (1, 3), (1, 4), (3, 4), (3, 5), (0, 5)]
    area = 5.0 + 2.0 + 1.0 + 2.0
    around = outline[::-1] if is_turned else outline
    place = {"x": "v 7 {} {}", "y": "v {1} 7 {0}", "z": "v {} {} 7"}[seen_along]
    for first in range(len(outline)):
        corners = around[first:] + around[:first]
        text = [*(place.format(*corner) for corner in corners), *(f"vt {u / 3} {v / 5}" for u, v in corners)]
        numbers = (f"{k + 1}/{k + 1}" if first % 2 else f"{k - 12}/{k - 12}" for k in range(12))
        (tmp_path / "e.obj").write_text("\n".join([*text, "f " + " ".join(numbers), ""]))
        mesh = read_mesh(tmp_path / "e.obj")
        a, b, c = mesh.vertices[mesh.faces].transpose(1, 0, 2)
        across = 0.5 * np.cross(b - a, c - a)
        np.testing.assert_allclose(np.linalg.norm(across, axis=1).sum(), area)
        around_it = mesh.vertices[:12] - mesh.vertices[0]  # one after the other, as they go round the polygon
        outward = 0.5 * np.cross(around_it, np.roll(around_it, -1, axis=0)).sum(axis=0)
        np.testing.assert_allclose(across.sum(axis=0), outward, atol=1e-9)  # all face one way, and the right one
        assert len(mesh.faces) == 10 and np.ptp(mesh.uv, axis=0).tolist() == [1.0, 1.0]


def test_an_upward_axis_without_a_mesh_is_refused(tmp_path: Path) -> None:
    for options, what in (({"up": "y"}, "shape"), ({"up": "w", "shape": tmp_path / "a.obj"}, "x, y, z"),
                          ({"up": "y", "shape": "knob"}, "mesh files")):  # fmt: skip
        with pytest.raises(NacreError, match=what):
            nacre.render.render({"type": "diffuse"}, size=(8, 8), spp=1, **options)


def bodies() -> dict[str, Any]:
    import trimesh

    far = trimesh.creation.icosphere(radius=0.5)
    far.apply_translation([300.0, -200.0, 100.0])
    kilometres = trimesh.creation.box(extents=(2e6, 1e6, 1.5e6))
    return {
        "rod": trimesh.creation.cylinder(radius=0.5, height=20.0),
        "lying rod": trimesh.creation.box(extents=(20.0, 1.0, 1.0)),
        "flat ring": trimesh.creation.annulus(r_min=1.0, r_max=2.0, height=1e-3),
        "far off": far,
        "kilometres": kilometres,
    }


@pytest.mark.parametrize("name", ["rod", "lying rod", "flat ring", "far off", "kilometres"])
@pytest.mark.parametrize("scene", ["sphere", "body"])
def test_any_mesh_fits_the_frame(tmp_path: Path, name: str, scene: str) -> None:
    from nacre.picture.built_scene import with_subject

    path = tmp_path / "mesh.stl"
    bodies()[name].export(path)
    chosen = SCENES[scene]
    uv, _ = seen(with_subject(chosen, lambda: subject_parts(path, chosen)))
    inside = np.isfinite(uv[..., 0])
    assert inside.sum() >= 50
    border = np.concatenate([inside[0], inside[-1], inside[:, 0], inside[:, -1]])
    assert not border.any()
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    assert max(np.ptp(rows), np.ptp(columns)) >= 0.33 * len(inside)  # and is not lost in it


def test_a_drawing_stands_on_the_screen_as_a_design_aims_at_it(tmp_path: Path) -> None:
    """The picture that a target asks for, looked up in the directions of the screen's pixels, is the drawing."""
    from nacre.optimise.relief.target import load_picture, picture_on_directions
    from nacre.picture.picture import beam_direction, screen_directions

    drawn = letter(tmp_path / "r.png")
    d, on_screen = screen_directions((64, 64))
    u, v = np.moveaxis((d + beam_direction())[..., :2], -1, 0)
    asked = picture_on_directions(load_picture(tmp_path / "r.png", "t"), u, v, image_scale=3.0)[..., 0]
    assert on_screen[32, 32]
    likeness = [np.corrcoef(asked.ravel(), way.ravel())[0, 1] for way in turnings(drawn)]
    assert np.argmax(likeness) == 0 and likeness[0] > 0.8, likeness


@pytest.mark.full
def test_a_designed_letter_reads_as_drawn_on_the_screen_and_in_the_preview(tmp_path: Path) -> None:
    from nacre.picture.picture import HALF_WIDTH

    drawn = letter(tmp_path / "r.png")
    (tmp_path / "r.toml").write_text(
        'family = "relief"\nfeatures = 32\nfeature_um = 2.0\nblur_um = 0.4\nheight_max_um = 0.6\ncoating = "Al"\n'
        '[coherence]\nsigma = 2.0\n[target]\nkind = "image"\nimage = "r.png"\nrange = 0.25\nresolution = 24\n'
        "image_scale = 2.0\n[search]\nstarts = 1\nseconds = 40\nseed = 1\n"
    )
    nacre.design(tmp_path / "r.toml", tmp_path / "out")
    screen = nacre.render.render(nacre.load(tmp_path / "out"), scene="screen", size=(128, 128)).xyz[..., 1]
    # the letter reaches u = 2 x 0.0625 x image_scale, the picture's edge the screen's half width and its margin
    half = 2 * 0.0625 * 2.0 / (HALF_WIDTH * 1.06)
    cut = round(64 * half)
    screen = screen[64 - cut : 64 + cut, 64 - cut : 64 + cut]
    preview = np.asarray(Image.open(tmp_path / "out" / "preview.png").convert("L"), dtype=float)
    side = preview.shape[0]
    for picture in (screen, preview[:, :side]):
        likeness = []
        for way in turnings(drawn):
            sized = np.asarray(Image.fromarray(way).resize(picture.shape[::-1], Image.Resampling.BILINEAR))
            likeness.append(np.corrcoef(sized.ravel(), picture.ravel())[0, 1])
        assert np.argmax(likeness) == 0, likeness


def test_a_map_is_not_mirrored_and_turns_counter_clockwise(tmp_path: Path) -> None:
    """A mirror ball shows a lamp of the map's middle in its middle, one of the map's right half on its left."""
    from nacre.device.variant import use_variant

    mi = use_variant()
    rows, columns = 32, 64
    levels = np.full((rows, columns, 3), 0.02, dtype=np.float32)
    levels[10:20, 30:34, 1] = 8.0  # green in the middle
    levels[10:20, 45:50, 0] = 8.0  # red right of it, by some 87 degrees
    mi.Bitmap(levels).write(str(tmp_path / "map.exr"))

    def column(turn_deg: float, channel: int) -> float:
        light = f"{tmp_path / 'map.exr'}@{turn_deg:g}"
        seen = nacre.render(MIRROR, scene="sphere", size=64, spp=16, light=light, denoise=False, progress=False)
        levels = seen.srgb8[16:38].astype(int)  # the ball, above the grain of the floor
        rest = [other for other in range(3) if other != channel]
        lit = (levels[..., channel : channel + 1] - levels[..., rest]).min(axis=-1) > 80
        return float(np.argwhere(lit)[:, 1].mean()) / 64

    assert column(0.0, channel=1) == pytest.approx(0.5, abs=0.05)
    assert column(0.0, channel=0) < 0.35
    # from above the viewer stands at 6 o'clock and the red lamp at 9: a quarter turn brings it before the viewer
    assert column(90.0, channel=0) == pytest.approx(0.5, abs=0.05)
