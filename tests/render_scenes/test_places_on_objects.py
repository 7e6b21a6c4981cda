"""Formulas of x, y and z: where on the object of a picture, in radii of its bounding ball, z up."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nacre
from nacre.bsdf import Bsdf
from nacre.bsdf.texture import TextureSpec
from nacre.core.errors import NacreError
from nacre.picture.mesh import bounding_ball, rotation
from nacre.picture.scenes import Part
from nacre.recipe.model import RecipeContext

pytestmark = pytest.mark.render

# enough to distinguish titanium from its blue oxide pixel by pixel, which differ by a factor in the share of blue
QUICK: dict[str, Any] = {"size": (24, 24), "spp": 9, "exposure": 0.0, "denoise": False, "progress": False}
LARGE, MIDDLE = 0.8, 0.1  # of the half that is to be coloured, and of the other
FAR = np.array([5e5, -3e5, 1e5])


def two_coloured(x: float, y: float, z: float, above: float = 0.0) -> nacre.Material:
    """Blue oxide where x, y and z along a direction exceed `above`; titanium elsewhere. One kernel serves all."""
    where = f"step({above!r}, {x!r}*x + {y!r}*y + {z!r}*z)"
    layer = {"material": "TiO2", "thickness_nm": {"formula": f"45*{where}", "min": 0, "max": 45}}
    return nacre.material(
        {
            "family": "film",
            "substrate": "Ti",
            "surface": {"roughness": 0.3},
            "layers": [layer],
            "wavelengths": {"step_nm": 20},
        }
    )


def blue(material: Any, **options: Any) -> np.ndarray:
    """Where the object's own blue is seen: `[row, column]`, NaN beside the object."""
    result = nacre.render(material, background="transparent", **{**QUICK, **options})
    red, high = result.rgb[..., 0], result.rgb[..., 2]
    assert result.alpha is not None
    return np.where(result.alpha > 0.99, high > 1.5 * red, np.nan)


def halves(seen: np.ndarray, axis: int) -> tuple[float, float]:
    """Share of blue in the upper or left, and in the lower or right half of what is seen of the object."""
    places = np.argwhere(np.isfinite(seen))[:, axis]
    middle = 0.5 * (places.min() + places.max())
    at = np.arange(seen.shape[axis])
    first, second = (float(np.nanmean(np.compress(half, seen, axis))) for half in (at < middle - 1, at > middle + 1))
    return first, second


def block(path: Path, scale: float = 1.0, offset: Any = 0.0) -> Path:
    """An upright block without uv, twice as high as wide, in a unit of one's own."""
    import trimesh

    body = trimesh.creation.box((1.0, 0.8, 2.0))
    body.vertices = body.vertices * scale + offset
    body.export(path)
    return path


def check_sides(**shape: Any) -> None:
    left, right = halves(blue(two_coloured(1, 0, 0), **shape), axis=1)
    assert left < MIDDLE and right > LARGE
    assert np.nanmean(blue(two_coloured(0, 1, 0, 0.1), **shape)) < MIDDLE  # y runs away from the camera
    upper, lower = halves(blue(two_coloured(0, 0, 1), **shape), axis=0)
    assert upper > LARGE and lower < MIDDLE


def test_formulas_of_x_y_and_z_are_seen_on_their_sides_and_turn_with_a_mesh(tmp_path: Path) -> None:
    """Turned by 90 degrees, counter-clockwise seen from above, what was right is behind, and what was behind left."""
    shape = block(tmp_path / "block.ply")
    check_sides(shape=shape)
    assert np.nanmean(blue(two_coloured(1, 0, 0, 0.15), shape=shape, turn=90.0)) < MIDDLE
    left, right = halves(blue(two_coloured(0, 1, 0), shape=shape, turn=90.0), axis=1)
    assert left > LARGE and right < MIDDLE


@pytest.mark.full
def test_formulas_of_x_y_and_z_are_seen_on_their_sides_of_the_sphere() -> None:
    # straight from the front: the scene's own camera looks down, and sees some of the upper half below the middle
    check_sides(scene="sphere", view=(0.0, 0.0))


@pytest.mark.full
def test_the_unit_and_the_place_of_a_mesh_do_not_matter(tmp_path: Path) -> None:
    """The position comes from the mesh itself: kilometres, and far from the origin, it is the same picture."""
    material = two_coloured(0.7, 0.2, 0.5, 0.1)
    near = nacre.render(material, shape=block(tmp_path / "near.ply"), **QUICK)
    far = nacre.render(material, shape=block(tmp_path / "far.ply", 1000.0, FAR), **QUICK)
    # single precision of the file leaves 1e-4 of the block; a seam may then fall on the other side of a sample
    assert np.mean(np.abs(near.rgb - far.rgb).max(axis=-1) > 0.02) < 0.02


@pytest.mark.full
def test_an_animation_moves_a_pattern_in_the_object(tmp_path: Path) -> None:
    data = dict(two_coloured(1, 0, 0).data)
    layer = {"material": "TiO2", "thickness_nm": {"formula": "45*step(0, (1-2*t)*x)", "min": 0, "max": 45}}
    settings = {name: QUICK[name] for name in ("size", "spp", "denoise")}
    frames = nacre.render.animate(  # type: ignore[attr-defined]
        nacre.material({**data, "layers": [layer]}), "time", tmp_path / "a.gif", frames=2, progress=False, **settings
    ).frames
    from PIL import Image

    first, last = (np.asarray(Image.open(name).convert("RGB"), dtype=float) for name in frames)
    assert np.corrcoef(first.ravel(), last[:, ::-1].ravel())[0, 1] > np.corrcoef(first.ravel(), last.ravel())[0, 1]


REFUSERS: dict[str, Any] = {
    "evaluate": lambda m: nacre.evaluate(m, [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]),
    "spectrum": lambda m: nacre.spectrum(m),
    "report": lambda m: nacre.report(m),
    "export": lambda m: nacre.export(m, "merl", "out.binary"),
    "scene screen": lambda m: nacre.render(m, scene="screen"),
    "structure": lambda m: m.figure_data("structure"),
}


@pytest.mark.parametrize("verb", REFUSERS)
def test_where_no_object_is_one_line_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, verb: str) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(NacreError) as caught:
        REFUSERS[verb](two_coloured(0, 0, 1))
    words = str(caught.value)
    assert "x, y, z" in words and "do not exist here" in words and verb in words and "\n" not in words
    assert not list(tmp_path.iterdir())


def test_an_own_mitsuba_scene_names_no_object() -> None:
    """But `make_bsdf` takes it; a point on the ball's surface is at distance 1."""
    from nacre.device.bsdf import make_bsdf
    from nacre.device.tables import ObjectFrame, ObjectSpace
    from nacre.device.variant import use_variant

    mi = use_variant()
    bsdf = two_coloured(0, 0, 1).bsdf()
    with pytest.raises(NacreError, match="unknown in your own Mitsuba scene"):
        make_bsdf(bsdf)
    make_bsdf(bsdf, object_frame=ObjectFrame((0.0, 0.0, 1.0), 2.0))
    si = mi.SurfaceInteraction3f()
    si.p = mi.Point3f(1.0, 4.0, 3.0)
    own = ObjectSpace(ObjectFrame((2.0, 1.0, 3.0), 2.0, turn_deg=90.0))(si)
    assert np.allclose(np.array(own.p).ravel(), [1.0, -1.0, 0.0], atol=1e-6)


def test_a_compiled_file_keeps_the_formula(tmp_path: Path) -> None:
    two_coloured(0, 0, 1).bsdf().save(tmp_path / "a.nacre")
    (lobe,) = Bsdf.load(tmp_path / "a.nacre").lobes
    assert lobe.response.parameters[0].texture.formula.uses_place  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("formula", "low", "high"),
    [("300 + 200*z", 100.0, 500.0), ("x + y + z", -np.sqrt(3.0), np.sqrt(3.0)), ("x*x + y*y + z*z", 0.0, 1.0),
     ("u*z", -1.0, 1.0)],
)  # fmt: skip
def test_the_range_of_a_formula_is_that_in_the_ball(formula: str, low: float, high: float) -> None:
    texture = TextureSpec(formula=formula).build(RecipeContext("recipe"), "key")
    assert texture.low == pytest.approx(low, abs=1e-9) and texture.high == pytest.approx(high, abs=1e-9)


def test_the_bounding_ball_is_the_smallest() -> None:
    generator = np.random.default_rng(7)
    cube = np.stack(np.meshgrid(*3 * [[-1.0, 1.0]]), axis=-1).reshape(-1, 3) + FAR
    shapes = {
        "cube": (cube, FAR, np.sqrt(3.0)),
        "line": (np.outer(np.linspace(-2, 3, 9), [1.0, 0.0, 0.0]), [0.5, 0.0, 0.0], 2.5),
        "ring": (np.array([rotation("z", a) @ [2.0, 0.0, 1.0] for a in range(0, 360, 7)]), [0.0, 0.0, 1.0], 2.0),
        # an obtuse triangle: its long side is the diameter
        "triangle": (np.array([[-3.0, 0, 0], [3, 0, 0], [0, 1, 0]]), [0.0, 0.0, 0.0], 3.0),
        "point": (np.ones((5, 3)), [1.0, 1.0, 1.0], 0.0),
    }
    for name, (points, centre, radius) in shapes.items():
        got_centre, got_radius = bounding_ball(points)
        assert np.allclose(got_centre, centre, atol=5e-3), name  # 1e-9 of a circle's points leave it to rounding
        assert got_radius == pytest.approx(radius, abs=5e-3), name
    cloud = generator.normal(size=(2000, 3))
    centre, radius = bounding_ball(cloud)
    away = np.linalg.norm(cloud - centre, axis=1)
    assert away.max() <= radius * (1 + 1e-6)
    for step in 1e-3 * np.concatenate([np.eye(3), -np.eye(3)]):  # no ball about another centre is smaller
        assert np.linalg.norm(cloud - centre - step, axis=1).max() > radius


@pytest.mark.parametrize(
    ("shape", "centre", "radius"),
    [
        ({"type": "sphere"}, (0, 0, 0), 1.0),
        ({"type": "sphere", "center": [1.0, 2.0, 3.0], "radius": 0.5}, (1, 2, 3), 0.5),
        ({"type": "rectangle"}, (0, 0, 0), 2**0.5),
    ],
)
def test_mitsubas_own_shapes_have_a_place_without_a_transform(
    shape: dict[str, Any], centre: tuple[float, float, float], radius: float
) -> None:
    """As scenes of one's own in Python name them; turned by half a turn, they lie on the other side."""
    part = Part(shape)
    for piece, sign in ((part, 1.0), (part.turned(180.0), -1.0)):
        got_centre, got_radius = bounding_ball(piece.points())
        assert np.allclose(got_centre, np.array(centre) * (sign, sign, 1.0), atol=1e-6)
        assert got_radius == pytest.approx(radius, abs=1e-6)
