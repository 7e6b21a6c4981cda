"""The `nacre` plugin as users of Mitsuba meet it: scene entries, errors, updates, both sides, many renders."""

from __future__ import annotations

import dataclasses
import gc
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.bsdf.bsdf import Bsdf
from nacre.core.errors import UnsupportedError

pytestmark = pytest.mark.render

SOAP = 'family = "film"\nsubstrate = "air"\nlayers = [{material = "water", thickness_nm = 300}]\n'
RECIPES: dict[str, dict[str, Any]] = {
    "smooth metal": {"substrate": "Al", "layers": [{"material": "SiO2", "thickness_nm": 200.0}]},
    "rough metal": {
        "substrate": "Al",
        "layers": [{"material": "SiO2", "thickness_nm": 200.0}],
        "surface": {"roughness": 0.2},
    },
    "rough glass": {
        "substrate": "BK7",
        "layers": [{"material": "TiO2", "thickness_nm": 90.0}],
        "surface": {"roughness": 0.2, "distribution": "beckmann"},
    },
    "film over a base": {
        "substrate": {"n": 1.5},
        "layers": [{"material": "TiO2", "thickness_nm": 90.0}],
        "base": {"albedo": 0.5},
    },
    "ridges": {"preset": "morpho"},
}


def bsdf_of(name: str, **changes: Any) -> Bsdf:
    """Build one of `RECIPES`, with recipe values changed by path."""
    return nacre.material({"family": "film", **RECIPES[name]}).vary(changes).bsdf()


def scene(mi: Any, bsdf: Any, size: int = 16) -> Any:
    """Put a BSDF on a sphere under a constant emitter."""
    film = {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}
    view = mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 6},
            "ball": {"type": "sphere", "bsdf": bsdf},
            "light": {"type": "constant"},
            "sensor": {"type": "perspective", "fov": 35, "to_world": view, "film": film},
        }
    )


def test_scene_entries_take_recipes_files_and_objects(mi: Any, tmp_path: Path) -> None:
    """{"type": "nacre", ...} by recipe, by compiled file, by an object handed over."""
    from nacre.render.scene_plugin import register_bsdf

    (tmp_path / "soap.toml").write_text(SOAP)
    bsdf = nacre.load(tmp_path / "soap.toml").bsdf()
    bsdf.save(tmp_path / "soap.nacre")
    entries = (
        {"recipe": str(tmp_path / "soap.toml")},
        {"file": str(tmp_path / "soap.nacre")},
        {"bsdf": register_bsdf(bsdf), "two_sided": True},
    )
    pictures = [np.array(mi.render(scene(mi, {"type": "nacre", **entry}), spp=4, seed=1)) for entry in entries]
    assert np.isfinite(pictures[0]).all() and pictures[0].max() > 0
    for picture in pictures[1:]:
        assert np.allclose(picture, pictures[0], rtol=1e-5)


def test_a_scene_file_finds_recipes_beside_itself(mi: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A relative path counts from the XML file when the working folder has no such file."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "inner").mkdir()
    (tmp_path / "inner" / "soap.toml").write_text(SOAP)
    (tmp_path / "inner" / "scene.xml").write_text(
        '<scene version="3.0.0"><shape type="sphere"><bsdf type="nacre"><string name="recipe" value="soap.toml"/>'
        "</bsdf></shape></scene>"
    )
    assert "NacreBSDF[specular]" in str(mi.load_file(str(tmp_path / "inner" / "scene.xml")))


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({}, "needs exactly one of recipe, file, bsdf; got none"),
        ({"recipe": "a.toml", "file": "a.nacre"}, "got recipe, file"),
        ({"recipe": "missing.toml"}, "missing.toml: does not exist"),
        ({"recipe": "bad.toml"}, 'substrate = "aar" is not known. Did you mean "air"?'),
        ({"bsdf": "nobody"}, 'bsdf = "nobody"'),
        ({"recipe": "good.toml", "colour": 3.0}, "unreferenced property"),
        ({"recipe": "good.toml", "two_sided": "false"}, "two_sided = 'false' of a \"nacre\" BSDF is not a boolean"),
    ],
)
def test_errors_in_a_scene_state_the_reason(
    mi: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, entry: dict[str, Any], message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "good.toml").write_text(SOAP)
    (tmp_path / "bad.toml").write_text(SOAP.replace("air", "aar"))
    with pytest.raises(RuntimeError) as caught:
        mi.load_dict({"type": "nacre", **entry})
    assert message in str(caught.value)


def test_opaque_material_is_black_from_behind_unless_two_sided(mi: Any) -> None:
    """two_sided mirrors the whole lobe."""
    from lobe_trials import direction, draw, plugin_values

    from nacre.device.bsdf import make_bsdf

    bsdf = bsdf_of("rough metal")
    light, eye = direction(30, 10)[None], direction(40, 200)[None]
    down = np.array([1.0, 1.0, -1.0])
    nodes = bsdf.wavelengths_nm[::12]
    front = plugin_values(bsdf, light, eye, nodes)
    both = make_bsdf(bsdf, two_sided=True)
    assert front.max() > 0
    assert np.all(plugin_values(make_bsdf(bsdf), light * down, eye * down, nodes) == 0)
    assert np.allclose(plugin_values(both, light * down, eye * down, nodes), front, rtol=1e-6)
    assert np.all(plugin_values(both, light * down, eye, nodes) == 0)
    below = draw(both, direction(140, 5), 1000)
    assert np.all(below.wo[below.pdf > 0][:, 2] < 0)
    assert np.all(draw(make_bsdf(bsdf), direction(140, 5), 1000).weight == 0)


@pytest.mark.parametrize("name", list(RECIPES))
def test_another_material_needs_no_new_kernel(mi: Any, name: str) -> None:
    """Numbers are data: a second material of the same structure finds every kernel compiled."""
    import drjit as dr

    changes: dict[str, Any] = {"layers[0].thickness_nm": 333.0}
    if "rough" in name:
        changes["surface.roughness"] = 0.31
    if name == "ridges":
        changes = {"ridges.height_deviation_nm": 90.0}
    dr.eval(mi.render(scene(mi, _made(bsdf_of(name))), spp=1))
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        picture = mi.render(scene(mi, _made(bsdf_of(name, **changes))), spp=1)
        dr.eval(picture)
        history = dr.kernel_history([dr.KernelType.JIT])
    assert history and all(kernel["cache_hit"] for kernel in history)


def _made(bsdf: Bsdf) -> Any:
    from nacre.device.bsdf import make_bsdf

    return make_bsdf(bsdf)


@pytest.mark.parametrize("name", list(RECIPES))
def test_numbers_change_without_building_the_scene_again(mi: Any, name: str) -> None:
    """update_bsdf gives the picture that a new scene gives."""
    from nacre.device.bsdf import update_bsdf

    changes: dict[str, Any] = {"layers[0].thickness_nm": 350.0}
    if "rough" in name:
        changes["surface.roughness"] = 0.4
    if name == "ridges":
        changes = {"ridges.pitch_nm": 900.0}
    changed = bsdf_of(name, **changes)
    target = _made(bsdf_of(name))
    built = scene(mi, target)
    before = np.array(mi.render(built, spp=8, seed=3))
    handed_out = mi.traverse(built)
    update_bsdf(target, changed)
    for key in handed_out.keys():
        if key.startswith("ball.bsdf"):  # what was handed out before shows the new numbers
            assert np.array_equal(np.array(handed_out[key]), np.array(mi.traverse(built)[key]))
    after = np.array(mi.render(built, spp=8, seed=3))
    anew = np.array(mi.render(scene(mi, _made(changed)), spp=8, seed=3))
    assert np.allclose(after, anew, rtol=1e-4, atol=1e-6)
    assert not np.allclose(before, after, rtol=1e-3)


def test_an_update_of_another_structure_is_refused(mi: Any) -> None:
    """What needs another kernel or other shapes says so."""
    from nacre.device.bsdf import update_bsdf

    rough = _made(bsdf_of("rough metal"))
    with pytest.raises(UnsupportedError, match="number or kind"):
        update_bsdf(rough, bsdf_of("smooth metal"))
    with pytest.raises(UnsupportedError, match="structure of the roughness"):
        update_bsdf(rough, bsdf_of("rough metal", **{"surface.roughness": [0.1, 0.3]}))
    with pytest.raises(UnsupportedError, match="absorption, transmission"):
        update_bsdf(_made(bsdf_of("rough glass")), bsdf_of("rough glass", substrate="Si"))


def test_roughness_and_tables_are_scene_parameters_with_gradients(mi: Any) -> None:
    """mi.traverse exposes them; a gradient with respect to roughness agrees with finite differences."""
    import drjit as dr

    built = scene(mi, _made(bsdf_of("rough metal")), size=8)
    parameters = mi.traverse(built)
    assert {"ball.bsdf.alpha_x", "ball.bsdf.response"} <= set(parameters.keys())

    def brightness(alpha: Any) -> Any:
        from lobe_trials import direction, interaction

        parameters["ball.bsdf.alpha_x"] = alpha
        parameters.update()
        bsdf = built.shapes()[0].bsdf()
        si = interaction(direction(30.0, 0.0)[None])
        wo = mi.Vector3f(*(float(c) for c in direction(45.0, 170.0)))
        return dr.sum(bsdf.eval(mi.BSDFContext(), si, wo))

    alpha = mi.Float(0.3)
    dr.enable_grad(alpha)
    value = brightness(alpha)
    dr.backward(value)
    slope = float(dr.grad(alpha)[0])
    step = 1e-2
    numeric = (float(brightness(mi.Float(0.3 + step))[0]) - float(brightness(mi.Float(0.3 - step))[0])) / (2 * step)
    assert abs(slope - numeric) <= 5e-3 * abs(numeric)


def test_a_changed_table_changes_the_picture(mi: Any) -> None:
    """The exposed response is the one that is read."""
    built = scene(mi, _made(bsdf_of("smooth metal")), size=8)
    parameters = mi.traverse(built)
    before = np.array(mi.render(built, spp=4, seed=1))
    parameters["ball.bsdf.response"] = parameters["ball.bsdf.response"] * 0.5
    parameters.update()
    after = np.array(mi.render(built, spp=4, seed=1))
    centre = (4, 4)
    assert np.allclose(after[centre], 0.5 * before[centre], rtol=1e-3)


@pytest.mark.full
def test_a_hundred_renders_take_no_more_memory_than_ten(mi: Any) -> None:
    """Reusing the scene stays flat (mitsuba3 issue 563 grew with each render)."""
    import drjit as dr

    target = _made(bsdf_of("rough glass"))
    built = scene(mi, target)
    bsdfs = [bsdf_of("rough glass", **{"layers[0].thickness_nm": t}) for t in (90.0, 120.0)]
    from nacre.device.bsdf import update_bsdf

    def run(n: int) -> None:
        for k in range(n):
            update_bsdf(target, bsdfs[k % 2])
            dr.eval(mi.render(built, spp=2, seed=k))
        dr.sync_thread()
        gc.collect()

    run(10)
    registered = len(dr.kernel_history()) if dr.flag(dr.JitFlag.KernelHistory) else 0
    memory = _resident()
    run(90)
    assert registered == 0
    assert _resident() - memory <= 20e6


def _resident() -> float:
    """Return the bytes of memory in use now."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return float(line.split()[1]) * 1024
    pytest.skip("the memory in use cannot be read on this system")


def test_irregular_wavelengths_are_interpolated_between_their_nodes(mi: Any) -> None:
    """A grid of measured wavelengths need not be uniform; between nodes the values are linear."""
    from lobe_trials import direction, plugin_values

    bsdf = bsdf_of("rough metal")
    keep = np.sort(np.random.default_rng(1).choice(len(bsdf.wavelengths_nm), 17, replace=False))
    (lobe,) = bsdf.lobes
    response = lobe.response  # type: ignore[attr-defined]  # a rough metal is one Microfacet
    fewer = dataclasses.replace(
        response,
        wavelengths_nm=response.wavelengths_nm[keep],
        **{
            name: getattr(response, name)[..., keep]
            for name in ("reflectance", "transmittance", "reflectance_inside", "total")
        },
    )
    irregular = Bsdf((dataclasses.replace(lobe, response=fewer),))
    light, eye = direction(30, 10)[None], direction(40, 200)[None]
    expected = irregular.evaluate(light, eye)[0]
    grid = irregular.wavelengths_nm
    asked = np.linspace(350.0, 840.0, 40)
    got = plugin_values(irregular, light, eye, asked)[0]
    assert np.allclose(got, np.interp(asked, grid, expected), rtol=1e-4)


def test_a_narrow_range_of_wavelengths_is_announced(mi: Any, caplog: pytest.LogCaptureFixture) -> None:
    """Beyond a material's range its ends go on, which is not done in silence."""
    bsdf = nacre.material({"family": "film", "substrate": "Si"}).bsdf(np.arange(450.0, 651.0, 10.0))
    with caplog.at_level("WARNING", logger="nacre"):
        _made(bsdf)
    assert "known only from 450 to 650 nm" in caplog.text


def test_where_v_runs_down_an_image_lies_as_mitsubas_own_bitmap_does(mi: Any, tmp_path: Path) -> None:
    """On Mitsuba's sphere and in its OBJ reader v runs down an image; elsewhere, and at first, it runs up."""
    from PIL import Image

    levels = (np.random.default_rng(3).random((5, 7)) > 0.5).astype(np.uint8) * 255
    Image.fromarray(levels).save(tmp_path / "map.png")
    (tmp_path / "f.toml").write_text(
        'family = "film"\nsubstrate = "Ag"\nsurface = {roughness = 0.5}\nlayers = [{material = "Ge", thickness_nm = '
        '{texture = "map.png", min = 0, max = 40, interpolation = "nearest"}}]\n'
    )
    bitmap = {"type": "bitmap", "filename": str(tmp_path / "map.png"), "filter_type": "nearest"}
    theirs = mi.load_dict({"type": "diffuse", "reflectance": bitmap})
    column, row = (t.ravel() for t in np.meshgrid((np.arange(7) + 0.5) / 7, (np.arange(5) + 0.5) / 5))

    def is_bright(bsdf: Any, v: np.ndarray) -> np.ndarray:
        si = mi.SurfaceInteraction3f()
        si.uv, si.wi = mi.Point2f(column, v), mi.Vector3f(0.0, 0.0, 1.0)
        si.wavelengths = mi.Spectrum(550.0)
        values = np.array(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(0.0, 0.0, 1.0)))[0]
        return np.asarray(values > 0.5 * (values.min() + values.max()))

    drawn = is_bright(theirs, row)
    assert drawn.tolist() == (levels.ravel() > 0).tolist()
    recipe = {"type": "nacre", "recipe": str(tmp_path / "f.toml")}
    down = {**recipe, "v_up": False}
    made = nacre.render.make_bsdf(nacre.load(tmp_path / "f.toml").bsdf(), v_up=False)
    for bsdf in (mi.load_dict(down), made, mi.load_dict({"type": "twosided", "a": down})):
        assert is_bright(bsdf, row).tolist() == (~drawn).tolist()  # germanium makes the silver dark
    assert is_bright(mi.load_dict(recipe), 1.0 - row).tolist() == (~drawn).tolist()
