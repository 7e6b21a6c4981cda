"""A user's own meshes and scenes; animations; the screen."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import nacre
from nacre.cli import run
from nacre.core.errors import NacreError
from nacre.picture.images import read_provenance
from nacre.picture.mesh import Mesh, merge, revolve
from nacre.picture.picture import BEAM_DEG, screen_directions
from nacre.picture.scenes import SCENES, SHAPES
from nacre.picture.subjects import read_mesh, stand_on_floor, subject_parts
from nacre.render import pictures

SMALL: dict[str, Any] = {"size": (16, 14), "spp": 1}

pytestmark = pytest.mark.render

SCENE = """<scene version="3.0.0"><integrator type="path"/>
<sensor type="perspective"><float name="fov" value="30"/>
<transform name="to_world"><lookat origin="0,-6,0" target="0,0,0" up="0,0,1"/></transform>
<film type="hdrfilm"><integer name="width" value="20"/><integer name="height" value="10"/></film></sensor>
<emitter type="constant"/>
<shape type="sphere"><bsdf type="diffuse" id="{name}"/></shape></scene>"""


@pytest.fixture(scope="module")
def grey() -> Any:
    from nacre.device.variant import use_variant

    return use_variant().load_dict({"type": "diffuse", "reflectance": 0.5})


def test_a_mesh_of_several_materials_says_that_one_recipe_covers_them(tmp_path: Path, caplog: Any) -> None:
    corners = "".join(f"v {x} {y} 0\n" for y in (0, 1) for x in (0, 1))
    for name, second in (("one", "back"), ("two", "camera")):
        (tmp_path / f"{name}.mtl").write_text("newmtl back\nKd 1 0 0\nnewmtl camera\nKd 0 0 1\n")
        faces = f"usemtl back\nf 1 2 3\nusemtl {second}\nf 2 4 3\n"
        (tmp_path / f"{name}.obj").write_text(f"mtllib {name}.mtl\n" + corners + faces)
    read_mesh(tmp_path / "one.obj")
    assert not caplog.records
    read_mesh(tmp_path / "two.obj")
    assert len(caplog.records) == 1 and "camera" in caplog.records[0].getMessage()


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl", ".glb", ".off"])
def test_a_mesh_of_any_format_becomes_a_subject(tmp_path: Path, suffix: str, grey: Any) -> None:
    import trimesh

    path = tmp_path / f"mesh{suffix}"
    trimesh.creation.box(extents=(1.0, 2.0, 3.0)).export(path)
    surface = stand_on_floor(read_mesh(path), SCENES["sphere"])
    low, high = surface.bounds
    height = high[2] - low[2]
    assert low[2] == pytest.approx(0.0, abs=1e-6)
    assert max(height, *(high - low)[:2]) == pytest.approx(2.0, rel=0.8)
    assert nacre.render(grey, shape=path, **SMALL).xyz[..., 1].mean() > 0


@pytest.mark.parametrize(
    ("suffix", "content"), [(".ply", b"ply\nnonsense"), (".stl", b""), (".obj", b"# nothing\n"), (".glb", b"\0" * 64)]
)
def test_a_broken_mesh_is_one_line(tmp_path: Path, suffix: str, content: bytes) -> None:
    path = tmp_path / f"broken{suffix}"
    path.write_bytes(content)
    with pytest.raises(NacreError) as caught:
        subject_parts(path, SCENES["sphere"])
    assert path.name in str(caught.value) and "\n" not in str(caught.value)


def _volume(surface: Mesh) -> float:
    a, b, c = (surface.vertices[surface.faces[:, corner]] for corner in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


@pytest.mark.parametrize("file_normals", [None, 1.0, -1.0])
@pytest.mark.parametrize("uv", [True, False])
@pytest.mark.parametrize("is_turned", [True, False])
def test_a_closed_mesh_looks_outward_however_its_file_winds_it(
    tmp_path: Path, is_turned: bool, uv: bool, file_normals: float | None
) -> None:
    """Glass would be the air about it. Of a hollow ball the inner skin looks into the hollow."""
    ball = revolve([(math.sin(t), -math.cos(t)) for t in np.linspace(0.0, math.pi, 17)], 24, 16)
    hollow = merge([ball, ball.moved(0.5 * np.eye(3)).turned()])
    words = [f"v {x} {y} {z}" for x, y, z in hollow.vertices]
    words += [f"vt {u} {v}" for u, v in hollow.uv] if uv else []
    words += [] if file_normals is None else [f"vn {x} {y} {z}" for x, y, z in file_normals * hollow.normals]
    mark = {(True, False): "{0}/{0}", (True, True): "{0}/{0}/{0}", (False, True): "{0}//{0}", (False, False): "{0}"}
    corner = mark[uv, file_normals is not None]
    for face in (hollow.faces[:, ::-1] if is_turned else hollow.faces) + 1:
        words.append("f " + " ".join(corner.format(index) for index in face))
    (tmp_path / "hollow.obj").write_text("\n".join(words) + "\n")
    read = read_mesh(tmp_path / "hollow.obj", "z")
    assert _volume(read) == pytest.approx(_volume(hollow), rel=1e-6)
    radius = np.linalg.norm(read.vertices, axis=1)
    outside = np.einsum("ij,ij->i", read.vertices, read.normals)[radius > 0.75]
    inside = np.einsum("ij,ij->i", read.vertices, read.normals)[radius < 0.75]
    assert outside.min() > 0.0 > inside.max()


def test_an_open_mesh_stays_as_its_file_winds_it(tmp_path: Path) -> None:
    """It has no outside; a bowl would be turned if its volume alone were asked."""
    bowl = revolve([(math.sin(t), -math.cos(t)) for t in np.linspace(0.0, 0.5 * math.pi, 17)], 24, 16)
    for surface in (bowl, bowl.turned()):
        words = [f"v {x} {y} {z}" for x, y, z in surface.vertices]
        words += [f"f {a} {b} {c}" for a, b, c in surface.faces + 1]
        (tmp_path / "bowl.obj").write_text("\n".join(words) + "\n")
        read = read_mesh(tmp_path / "bowl.obj", "z")
        assert _volume(read) == pytest.approx(_volume(surface), rel=1e-6)


@pytest.mark.parametrize("part", [0, *(pytest.param(part, marks=pytest.mark.full) for part in (1, 2, 3))])
@pytest.mark.parametrize("shape", [name for name in SHAPES if name != "body"])  # quick to build
def test_every_shape_stands_whole_in_the_frame_of_every_scene(
    shape: str, part: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The quick part holds every fourth scene, and another one for each shape."""
    from nacre.device.variant import use_variant

    mi = use_variant()

    built = SHAPES[shape]()
    monkeypatch.setitem(SHAPES, shape, lambda: built)
    first = (part + list(SHAPES).index(shape)) % 4
    for place, scene in list(SCENES.items())[first::4]:
        view, (width, height) = scene.view, scene.size
        sensor = mi.ScalarTransform4f().look_at(list(view.origin), list(view.target), list(view.up))
        points = np.concatenate([part.points() for part in subject_parts(shape, scene)])
        seen = np.c_[points, np.ones(len(points))] @ np.linalg.inv(np.array(sensor.matrix, dtype=float)).T
        across = np.abs(seen[:, 0] / seen[:, 2]) / np.tan(np.radians(0.5 * view.fov_deg))
        along = np.abs(seen[:, 1] / seen[:, 2]) / np.tan(np.radians(0.5 * view.fov_deg)) * width / height
        assert (seen[:, 2] > 0).all() and across.max() <= 1.0 and along.max() <= 1.0, place
        assert max(across.max(), along.max()) > 0.4, place  # and not lost in it
        assert points[:, 2].min() == pytest.approx(0.0, abs=0.07), place


def test_what_belongs_to_a_subject_is_not_left_with_another() -> None:
    """The pin and the label of the beetle stand neither by another shape nor in a street."""
    from nacre.picture.built_scene import BuiltScene, with_subject
    from nacre.picture.emitters import make_light

    scene = SCENES["beetle"]
    other = with_subject(scene, SCENES["cuff"].parts)
    counts = [
        sum(name.startswith("prop") for name in BuiltScene(one, make_light(light), see_through=False).content)
        for one, light in ((scene, "studio"), (other, "studio"), (scene, "garden"))
    ]
    assert counts == [2, 0, 0]


def test_an_open_lens_blurs_what_is_not_in_focus() -> None:
    """A view keeps its lens however it is moved, and the camera that is built has it."""
    from nacre.picture.built_scene import BuiltScene
    from nacre.picture.emitters import make_light

    view = SCENES["cuff"].view
    assert view.placed(30.0, 40.0).lens == view.turned(10.0).lens == view.zoomed(2.0).lens == view.lens > 0
    assert view.placed(30.0, 40.0).focus == pytest.approx(view.focus)
    built = BuiltScene(SCENES["cuff"], make_light("directional"), see_through=False)
    import mitsuba as mi

    sensor = built.sensor(view, (32, 32), {"type": "hdrfilm"})
    ends = []
    for place in ((0.1, 0.2), (0.9, 0.7)):
        ray, _ = sensor.sample_ray(0.0, 0.5, mi.Point2f(0.5, 0.5), mi.Point2f(*place))
        ends.append([np.array(ray(t)).ravel() for t in (0.0, view.focus, 2.0 * view.focus)])
    apart = [float(np.linalg.norm(a - b)) for a, b in zip(*ends, strict=True)]
    assert apart[1] < 1e-3 and apart[0] > 0.3 * view.lens and apart[2] > 0.3 * view.lens


def test_our_shapes_go_by_name_in_any_scene(grey: Any) -> None:
    assert nacre.render(grey, "probe", shape="knob", **SMALL).stats["shape"] == "knob"


def test_a_mitsuba_scene_takes_the_material(tmp_path: Path) -> None:
    path = tmp_path / "mine.xml"
    path.write_text(SCENE.format(name="nacre"))
    dark, bright = (
        nacre.render({"type": "diffuse", "reflectance": r}, str(path), spp=16, exposure=0.0).xyz for r in (0.1, 0.8)
    )
    assert dark.shape == (10, 20, 3)
    assert bright[5, 10, 1] == pytest.approx(8 * dark[5, 10, 1], rel=0.1)
    assert bright[0, 0, 1] == pytest.approx(dark[0, 0, 1])


def test_a_file_that_a_scene_names_is_read_anew_once_it_has_changed(tmp_path: Path, grey: Any) -> None:
    """A built scene is cached: the mesh of an XML scene and the buffer of a glTF are part of it."""
    import trimesh

    mesh, options = tmp_path / "m.ply", {"spp": 1, "exposure": 0.0, "progress": False, "denoise": False}
    worn = '<shape type="ply"><string name="filename" value="m.ply"/><ref id="nacre"/></shape></scene>'
    (tmp_path / "mine.xml").write_text(SCENE.format(name="nacre").replace("</scene>", worn))
    seen = []
    for shape in (trimesh.creation.box((0.1, 0.1, 3.0)), trimesh.creation.box((4.0, 4.0, 4.0))):
        shape.export(mesh)
        for name, content in trimesh.Scene(shape).export(file_type="gltf").items():
            (tmp_path / name).write_bytes(content)
        scenes = ({"scene": str(tmp_path / "mine.xml")}, {"shape": tmp_path / "model.gltf", "size": (16, 16)})
        seen.append([nacre.render(grey, **scene, **options).xyz for scene in scenes])
    for before, after in zip(*seen, strict=True):
        assert np.abs(before - after).max() > 0.01


LENS = '<float name="aperture_radius" value="0.5"/><float name="focus_distance" value="3"/>'
SHIFT = '<float name="principal_point_offset_x" value="0.2"/><float name="principal_point_offset_y" value="-0.3"/>'
FOG = (
    '<shape type="cube"><bsdf type="dielectric"><float name="int_ior" value="1.2"/></bsdf><medium name="interior" '
    'type="homogeneous"><float name="sigma_t" value="2"/><float name="albedo" value="0.3"/></medium></shape></scene>'
)


# beside a shape whose BSDF can be exchanged, one where it cannot
NESTED = '<shape type="cube"><bsdf type="twosided"><ref id="nacre"/></bsdf></shape></scene>'
GROUPED = (
    '<shape type="shapegroup" id="g"><shape type="cube"><ref id="nacre"/></shape></shape>'
    '<shape type="instance"><ref id="g"/></shape></scene>'
)


@pytest.mark.parametrize(
    ("old", "new", "integrator"),
    [
        ('"perspective">', '"thinlens">' + LENS, "path"),
        ('"perspective">', '"perspective">' + SHIFT, "path"),
        ('"perspective">', '"perspective"><float name="near_clip" value="5.3"/>', "path"),
        ("</scene>", FOG, "volpath"),
    ],
    ids=["lens", "shift", "clip", "medium"],
)
def test_a_mitsuba_scene_is_seen_as_mitsuba_sees_it(
    tmp_path: Path, grey: Any, old: str, new: str, integrator: str
) -> None:
    """Its camera with all its numbers, and its media, behind which `path` would be blind."""
    from nacre.device.variant import use_variant

    mi = use_variant()
    text = SCENE.format(name="nacre").replace(old, new)
    (tmp_path / "mine.xml").write_text(text)
    ours = nacre.render(grey, str(tmp_path / "mine.xml"), spp=512, denoise=False, seed=1, progress=False).xyz
    theirs = mi.load_string(text.replace('"hdrfilm">', '"hdrfilm"><string name="pixel_format" value="xyz"/>'))
    tracer = mi.load_dict({"type": integrator, "max_depth": 16})
    for shape in theirs.shapes():
        if shape.bsdf().id() == "nacre":
            shape.set_bsdf(grey)
    runs = [np.array(mi.render(theirs, integrator=tracer, spp=512, seed=seed)) for seed in range(2, 8)]
    error = np.std(runs, axis=0, ddof=1) + 0.01 * np.mean(runs)
    assert np.all(np.abs(ours - np.mean(runs, axis=0)) < 6.0 * error)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (SCENE.format(name="other"), 'id "nacre"'),
        ("<scene", "cannot load"),
        ("<scene version='3.0.0'/>", "no camera"),
        (SCENE.format(name="nacre").replace("</scene>", NESTED), "inside a BSDF of type twosided"),
        (SCENE.format(name="nacre").replace("</scene>", GROUPED), "on a shape of a shapegroup"),
    ],
)
def test_a_useless_scene_is_one_line(tmp_path: Path, text: str, words: str, grey: Any) -> None:
    path = tmp_path / "bad.xml"
    path.write_text(text)
    with pytest.raises(NacreError) as caught:
        nacre.render(grey, str(path), **SMALL)
    assert words in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(("pixel", "words"), [(np.inf, "1 of its 128 pixels"), (np.nan, "1 of its"), (None, "black")])
def test_a_map_whose_light_cannot_be_drawn_is_refused(tmp_path: Path, pixel: float | None, words: str) -> None:
    """The whole picture came out as no number; suns beyond a half float are written as infinite."""
    import OpenEXR

    pixels = np.full((8, 16), 0.0 if pixel is None else 0.5, dtype=np.float16)
    pixels[2, 3] = 0.0 if pixel is None else pixel
    OpenEXR.File({}, dict.fromkeys("RGB", pixels)).write(str(tmp_path / "sky.exr"))
    with pytest.raises(NacreError, match=words):
        nacre.render({"type": "diffuse"}, light=f"studio,{tmp_path / 'sky.exr'}", **SMALL)


def test_an_environment_map_lights_and_a_broken_one_is_one_line(tmp_path: Path, grey: Any) -> None:
    import OpenEXR

    path = tmp_path / "sky.exr"
    pixels = np.full((8, 16), 0.5, dtype=np.float32)
    OpenEXR.File({}, {name: pixels for name in "RGB"}).write(str(path))
    assert nacre.render(grey, light=str(path), **SMALL).xyz[..., 1].mean() > 0.01
    broken = tmp_path / "broken.exr"
    broken.write_bytes(b"not an image")
    with pytest.raises(NacreError) as caught:
        nacre.render(grey, light=str(broken), **SMALL)
    assert "broken.exr" in str(caught.value) and "\n" not in str(caught.value)


def test_an_interrupt_in_a_frames_last_pass_ends_the_animation(
    tmp_path: Path, grey: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The frame is whole, so nothing of it is ended; the animation went on as if nobody had asked it to stop."""
    made: list[int] = []
    real = pictures.render

    def stop(done: int, total: int, seconds_left: float) -> None:
        if len(made) == 2 and done == total:
            raise KeyboardInterrupt

    def counting(*arguments: Any, **settings: Any) -> Any:
        made.append(1)
        return real(*arguments, **{**settings, "progress": stop})

    monkeypatch.setattr(pictures, "render", counting)
    first = nacre.render.animate(grey, "light", tmp_path / "turn.gif", frames=4, **SMALL)
    assert first.interrupted and first.path is None and len(made) == len(first.frames) == 2
    assert all(read_provenance(name)["frame"] == index for index, name in enumerate(first.frames))
    assert not (tmp_path / "turn.gif").exists()


def test_the_command_reports_that_an_animation_was_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It had named the movie that is not there, with exit status 0."""

    def stopped(*arguments: Any, **settings: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr(pictures, "render", stopped)
    status = run(["render", "gold", "--animate", "light", "--frames", "2", "-o", str(tmp_path / "turn.gif")])
    assert status == 130 and "turn.gif" not in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_an_animation_resumes_where_it_was_stopped(tmp_path: Path, grey: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[int] = []
    real = pictures.render

    def counting(*arguments: Any, **settings: Any) -> Any:
        if len(made) == 2:
            raise KeyboardInterrupt
        made.append(1)
        return real(*arguments, **settings)

    monkeypatch.setattr(pictures, "render", counting)
    first = nacre.render.animate(grey, "light", tmp_path / "turn.gif", frames=4, **SMALL)
    assert first.interrupted and first.path is None and len(first.frames) == 2
    assert not (tmp_path / "turn.gif").exists()
    monkeypatch.setattr(pictures, "render", real)
    done = nacre.render.animate(grey, "light", tmp_path / "turn.gif", frames=4, **SMALL)
    assert done.reused == 2 and not done.interrupted
    exposures = {read_provenance(name)["exposure_stops"] for name in done.frames}
    assert len(exposures) == 1
    again = nacre.render.animate(grey, "light", tmp_path / "turn.gif", frames=4, **{**SMALL, "seed": 9})
    assert again.reused == 0

    from PIL import Image

    with Image.open(tmp_path / "turn.gif") as movie:
        assert getattr(movie, "n_frames", 1) == 4


def test_a_parameter_moves_from_its_first_to_its_last_value(tmp_path: Path) -> None:
    seen: list[float] = []

    def material(value: float) -> dict[str, Any]:
        seen.append(value)
        return {"type": "diffuse", "reflectance": value}

    result = nacre.render.animate(material, (0.1, 0.9), tmp_path / "grey.mp4", frames=3, **SMALL)
    assert seen == pytest.approx([0.1, 0.5, 0.9])
    assert result.path is not None and result.path.stat().st_size > 500


@pytest.mark.parametrize("text", ["lihgt", "x=", "x=1", "x=a:b", "=1:2", "x=1:inf"])
def test_a_bad_motion_is_one_line(tmp_path: Path, text: str, grey: Any) -> None:
    with pytest.raises(NacreError) as caught:
        nacre.render.animate(grey, text, tmp_path / "a.gif", frames=2, **SMALL)
    assert text in str(caught.value) and "\n" not in str(caught.value)


def test_a_fixed_material_cannot_move_a_parameter(tmp_path: Path) -> None:
    with pytest.raises(NacreError, match="cannot move"):
        nacre.render.animate(nacre.Bsdf(()), "thickness=1:2", tmp_path / "a.gif", frames=2, **SMALL)


def test_the_screen_is_centred_on_the_mirror_direction() -> None:
    d, on_screen = screen_directions((101, 101))
    assert d[50, 50] == pytest.approx([-np.sin(np.radians(BEAM_DEG)), 0.0, np.cos(np.radians(BEAM_DEG))], abs=1e-6)
    assert on_screen[50, 50] and not on_screen[0, 0]


def test_a_matt_tile_throws_the_fourth_power_of_the_cosine(grey: Any) -> None:
    result = nacre.render(grey, "screen", size=(41, 41), exposure=0.0)
    d, on_screen = screen_directions((41, 41))
    cos_i = np.cos(np.radians(BEAM_DEG))
    assert result.xyz[on_screen][:, 1] == pytest.approx(0.5 * cos_i * d[on_screen][:, 2] ** 4, rel=1e-4)


def test_the_pattern_turns_on_the_screen_and_tips_with_the_tile() -> None:
    from nacre.picture.picture import beam_direction, turned_directions

    for turn, tip in ((0.0, 0.0), (90.0, 0.0), (30.0, 20.0)):
        d, _, lamp = turned_directions((51, 51), turn, tip)
        # the middle of the screen stays in the mirror direction
        assert d[25, 25] == pytest.approx([-lamp[0], -lamp[1], lamp[2]], abs=1e-12)
        assert lamp[2] == pytest.approx(np.cos(np.radians(BEAM_DEG + tip)))
    turned = turned_directions((51, 51), 90.0, 0.0)[0]
    plain = screen_directions((51, 51))[0]
    assert turned[..., 0] == pytest.approx(-plain[..., 1]) and turned[..., 1] == pytest.approx(plain[..., 0])
    assert beam_direction() == pytest.approx(turned_directions((9, 9), 0.0, 0.0)[2])
    with pytest.raises(NacreError, match="up to 60 degrees"):
        turned_directions((9, 9), 0.0, 70.0)


def test_a_relief_moves_on_the_screen(tmp_path: Path) -> None:
    star = nacre.load(Path(__file__).resolve().parents[2] / "examples" / "relief" / "star.toml").bsdf(
        np.array([420.0, 550.0, 680.0])
    )
    frames = nacre.render.animate(star, "light", tmp_path / "a.gif", frames=4, scene="screen", size=(64, 64)).frames
    seen = [np.asarray(Image.open(name).convert("RGB"), dtype=float) for name in frames]
    # a quarter turn of the beam turns the pattern, up to the beam's 10 degrees
    assert np.abs(seen[0] - seen[1]).mean() > 2.0
    turned = min(np.abs(np.rot90(seen[0], k) - seen[1]).mean() for k in (1, 3))
    assert turned < 0.6 * np.abs(seen[0] - seen[1]).mean()


def test_the_screen_by_arrays_equals_the_screen_by_plugin() -> None:
    from nacre.device.variant import use_variant
    from nacre.picture.picture import beam_direction, evaluate_arrays, evaluate_plugin

    recipe = {
        "family": "film",
        "substrate": {"n": 1.5, "k": 2.0},
        "layers": [{"material": {"n": 2.0}, "thickness_nm": 300}],
        "surface": {"roughness": 0.3},
    }
    bsdf = nacre.material(recipe).bsdf()
    eye = screen_directions((9, 9))[0].reshape(-1, 3)
    grid = np.arange(400.0, 701.0, 20.0)
    arrays = evaluate_arrays(bsdf, eye, beam_direction(), grid)
    plugin = evaluate_plugin(use_variant(), nacre.render.make_bsdf(bsdf), eye, beam_direction(), grid)
    assert np.abs(arrays - plugin).max() < 1e-3 * plugin.max()


def test_without_llvm_small_previews_still_render(tmp_path: Path) -> None:
    """scalar_spectral in a separate process, since this one has a variant; also user scenes and several lights."""
    import os
    import subprocess
    import sys

    code = (
        "import nacre\n"
        "r = nacre.render({'type': 'diffuse', 'reflectance': 0.5}, size=(6, 6), spp=1, output='p.png')\n"
        "assert r.stats['variant'] == 'scalar_spectral' and r.xyz.mean() > 0.01\n"
        "assert r.raw is not None\n"  # denoised
        "nacre.render({'type': 'diffuse'}, 'mine.xml', size=(4, 4), spp=1, output='own.png')\n"
        "nacre.render({'type': 'diffuse'}, light='studio,sun', size=(4, 4), spp=1, output='two.png')\n"
    )
    (tmp_path / "mine.xml").write_text(SCENE.format(name="nacre"))
    environment = {**os.environ, "NACRE_VARIANT": "scalar_spectral", "NACRE_DENOISE": "1"}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert {name.name for name in tmp_path.glob("*.png")} == {"p.png", "own.png", "two.png"}


def test_a_frame_keeps_its_exposure_when_threads_sum_it_in_another_order() -> None:
    from nacre.picture.images import auto_stops

    xyz = np.random.default_rng(4).uniform(0.1, 0.9, (64, 64, 3))
    assert auto_stops(xyz) == auto_stops(xyz * (1.0 + 1e-7)) == auto_stops(xyz * (1.0 - 1e-7))


CORNERS = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
PLY = (
    "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n"
)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.obj", CORNERS + "f 1 2 9\n"), ("b.obj", CORNERS + "f 1 2 -9\n"), ("c.obj", CORNERS + "f 1 2 3\nf 0 1 2\n"),
        ("d.obj", CORNERS + "f 1 2 4000000000\n"), ("e.ply", PLY + "3 0 1 5\n"), ("f.ply", PLY + "3 0 1 -1\n"),
        ("n.obj", CORNERS.replace("v 0 0 0", "v nan 0 0") + "f 1 2 3\n"),
        ("g.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n"),
    ],
)  # fmt: skip
def test_an_impossible_corner_is_refused(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(NacreError, match=name):
        read_mesh(tmp_path / name)


def test_edges_stay_sharp_above_the_crease_only_without_normals(tmp_path: Path) -> None:
    # two quads folded by 30 and by 60 degrees along the y axis
    for fold, count in ((30.0, 3), (60.0, 2)):
        x, z = np.cos(np.radians(fold)), np.sin(np.radians(fold))
        lines = [f"v {a} {b} {c}" for b in (0, 1) for a, c in ((-1.0, 0.0), (0.0, 0.0), (x, z))]
        (tmp_path / "fold.obj").write_text("\n".join([*lines, "f 1 2 5 4", "f 2 3 6 5"]) + "\n")
        assert len(np.unique(np.round(read_mesh(tmp_path / "fold.obj", "z").normals, 6), axis=0)) == count
        (tmp_path / "fold.obj").write_text("\n".join([*lines, "s off", "f 1 2 5 4", "f 2 3 6 5"]) + "\n")
        assert len(np.unique(np.round(read_mesh(tmp_path / "fold.obj", "z").normals, 6), axis=0)) == 2


def test_the_border_of_two_materials_has_one_normal_without_normals_in_the_file(tmp_path: Path) -> None:
    (tmp_path / "m.mtl").write_text("newmtl a\nKd 1 0 0\nnewmtl b\nKd 0 1 0\n")
    x, z = np.cos(np.radians(30.0)), np.sin(np.radians(30.0))
    lines = [f"v {a} {b} {c}" for b in (0, 1) for a, c in ((-1.0, 0.0), (0.0, 0.0), (x, z))]
    lines = ["mtllib m.mtl", *lines, "usemtl a", "f 1 2 5 4", "usemtl b", "f 2 3 6 5"]
    (tmp_path / "fold.obj").write_text("\n".join(lines) + "\n")
    surface = read_mesh(tmp_path / "fold.obj", "z")
    at_border = surface.normals[np.abs(surface.vertices[:, 0]) < 1e-9]
    mean = [-np.sin(np.radians(15.0)), 0.0, np.cos(np.radians(15.0))]
    assert len(at_border) >= 4 and np.abs(at_border - mean).max() < 1e-9


def test_obj_files_of_several_materials_keep_their_normals(tmp_path: Path) -> None:
    (tmp_path / "m.mtl").write_text("newmtl a\nKd 1 0 0\nnewmtl b\nKd 0 1 0\n")
    lines = ["mtllib m.mtl", *(f"v {x} {y} 0" for y in (0, 1) for x in (0, 1, 2))]
    # normals that no geometry of a plane has
    lines += ["vn 0.6 0 0.8", "vn 0 0.6 0.8", "usemtl a", "f 1//1 2//1 5//1 4//1", "usemtl b", "f 2//2 3//2 6//2 5//2"]
    (tmp_path / "two.obj").write_text("\n".join(lines) + "\n")
    normals = read_mesh(tmp_path / "two.obj", "z").normals
    assert {tuple(row) for row in np.round(normals, 6).tolist()} == {(0.6, 0.0, 0.8), (0.0, 0.6, 0.8)}


def test_gltf_files_keep_their_normals_under_a_transform(tmp_path: Path) -> None:
    import trimesh

    corners, faces = [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]
    part = trimesh.Trimesh(corners, faces, vertex_normals=[[0.6, 0.0, 0.8]] * 3, process=False)
    scene = trimesh.Scene()
    stretch = np.diag([2.0, 1.0, 1.0, 1.0])
    scene.add_geometry(part, transform=stretch)
    (tmp_path / "one.glb").write_bytes(scene.export(file_type="glb", include_normals=True))
    mesh = read_mesh(tmp_path / "one.glb", "z")
    expected = np.array([0.3, 0.0, 0.8]) / np.hypot(0.3, 0.8)  # normals follow the inverse transpose
    np.testing.assert_allclose(mesh.normals, np.tile(expected, (len(mesh.normals), 1)), atol=1e-6)
    assert np.ptp(mesh.vertices[:, 0]) == pytest.approx(2.0)
