"""Shapes: closed, outward, smooth, with usable uv."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
import pytest

from nacre.picture import insects, mesh, objects, printed
from nacre.picture.mesh import (
    Mesh,
    bspline,
    curve,
    merge,
    open_seam,
    parametric,
    revolve,
    rotation,
    smooth_max,
    smooth_min,
    split,
    surface_net,
)
from nacre.picture.objects import car, speedshape

# a coarser car, to keep the test short; the closedness does not depend on the spacing
CAR_SPACING = 0.03
# angle between a vertex normal and the mesh's own faces: what a fine mesh of a smooth body leaves
MAX_MEAN_TILT_DEG = 3.0

CLOSED: dict[str, Callable[[], Mesh]] = {
    "speedshape": speedshape,
    "bottle": objects.bottle,
    "bottle cap": objects.bottle_cap,
    "knob": objects.knob,
    "knob core": objects.knob_core,
    "knob foot": objects.knob_foot,
    "sheet": lambda: mesh.sheet(1.7, 1.9),
    "lens elements": objects.elements,
    "balls": objects.balls,
}


@functools.cache
def _car_hull() -> Mesh:
    built = car(CAR_SPACING)
    return merge([built[name] for name in ("paint", "glass", "trim", "lamps")])


OPEN: dict[str, Callable[[], Mesh]] = {
    "wings": insects.butterfly_wings,
    "margins": insects.butterfly_margins,
    "veins": insects.butterfly_veins,
    "butterfly body": insects.butterfly_body,
    "sweep": lambda: mesh.sweep(5, 4, 3, 2, 3),
    "bowl": lambda: mesh.bowl(1.4, 9.0, 4.2),
    "rolled": lambda: mesh.rolled(1.7, 0.8, 170.0),
    "tile": lambda: mesh.tile(1, 1),
    "seal": printed.seal,
    "card": printed.card_face,
    "name ring": objects.name_ring,
    "label": lambda: insects.label(1.0, -1.0),
    "pin": lambda: insects.pin(0.0, 0.0, 1.0),
}
ALL = {**CLOSED, **OPEN, "car hull": _car_hull}


def _face_normals(surface: Mesh) -> tuple[np.ndarray, np.ndarray]:
    a, b, c = (surface.vertices[surface.faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1)
    return normal / np.maximum(area, 1e-300)[:, None], area


def welded_faces(surface: Mesh) -> np.ndarray:
    """Return the faces with vertices at one place joined and faces without area dropped."""
    scale = np.ptp(surface.vertices, axis=0).max()
    keys = np.round(surface.vertices / (scale * 1e-7)).astype(np.int64)
    _, inverse = np.unique(keys, axis=0, return_inverse=True)
    faces = inverse.reshape(-1)[surface.faces]
    distinct = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return np.asarray(faces[distinct])


def volume(surface: Mesh) -> float:
    """Enclosed volume; positive where the faces look outward."""
    a, b, c = (surface.vertices[surface.faces[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def is_closed(surface: Mesh) -> bool:
    """Whether every edge, after welding, is traversed as often forward as backward: watertight and oriented."""
    faces = welded_faces(surface)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    size = int(faces.max()) + 1
    return bool(np.array_equal(np.sort(edges[:, 0] * size + edges[:, 1]), np.sort(edges[:, 1] * size + edges[:, 0])))


@pytest.mark.parametrize("name", [*CLOSED, "car hull"])
def test_a_body_is_closed_and_looks_outward(name: str) -> None:
    surface = ALL[name]()
    assert is_closed(surface)
    assert volume(surface) > 0


@pytest.mark.parametrize("name", ALL)
def test_a_shape_is_finite_with_unit_normals_that_agree_with_its_faces(name: str) -> None:
    surface = ALL[name]()
    assert np.isfinite(surface.vertices).all() and np.isfinite(surface.uv).all()
    assert np.allclose(np.linalg.norm(surface.normals, axis=1), 1.0, atol=1e-9)
    assert surface.faces.min() == 0 and surface.faces.max() < len(surface.vertices)
    normal, area = _face_normals(surface)
    mean = surface.normals[surface.faces].mean(axis=1)
    mean /= np.linalg.norm(mean, axis=1, keepdims=True)
    cosine = np.einsum("ij,ij->i", normal, mean)
    tilt = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    assert np.average(tilt, weights=area) < MAX_MEAN_TILT_DEG


@pytest.mark.parametrize("name", ["speedshape", "bottle", "wings", "knob", "car hull"])
def test_tangents_are_defined_nearly_everywhere(name: str) -> None:
    surface = ALL[name]()
    uv = surface.uv[surface.faces]
    d1, d2 = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    area_uv = np.abs(d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0])
    _, area = _face_normals(surface)
    assert area[area_uv > 1e-14].sum() > 0.98 * area.sum()


def test_wing_tangents_run_along_the_veins() -> None:
    wings = insects.butterfly_wings()
    right = wings.vertices[:, 0] > 0.3
    mask = right[wings.faces].all(axis=1) & (wings.vertices[wings.faces][:, :, 1].min(axis=1) > 0.4)  # fore wing
    faces = wings.faces[mask]
    p, uv = wings.vertices[faces], wings.uv[faces]
    e1, e2, d1, d2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0], uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    along_v = (e2 * d1[:, :1] - e1 * d2[:, :1]) / (d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0])[:, None]
    along_v /= np.linalg.norm(along_v, axis=1, keepdims=True)
    from_root = p.mean(axis=1) - np.array([0.09, 0.16, 0.1])
    from_root /= np.linalg.norm(from_root, axis=1, keepdims=True)
    assert np.einsum("ij,ij->i", along_v, from_root).mean() > 0.97


def test_a_revolved_circle_has_the_sphere_s_normals() -> None:
    angle = np.linspace(0, np.pi, 65)
    ball = revolve(np.stack([np.sin(angle), -np.cos(angle)], axis=1), 64, 64)
    radial = ball.vertices / np.linalg.norm(ball.vertices, axis=1, keepdims=True)
    assert np.einsum("ij,ij->i", radial, ball.normals).min() > np.cos(np.radians(2.0))
    assert volume(ball) == pytest.approx(4 / 3 * np.pi, rel=5e-3)


def test_a_surface_net_of_a_ball_lies_on_the_ball() -> None:
    def ball(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        return np.sqrt(x * x + y * y + z * z) - 1.0

    surface = surface_net(ball, np.full(3, -1.2), np.full(3, 1.2), 0.1, lambda p: p[:, :2])
    assert is_closed(surface)
    assert np.abs(np.linalg.norm(surface.vertices, axis=1) - 1).max() < 1e-9
    assert np.allclose(surface.normals, surface.vertices, atol=1e-5)


def test_a_split_keeps_every_area_and_closes_again() -> None:
    body = objects.knob_core()
    above, below = split(body, body.vertices[:, 2] - body.vertices[:, 2].mean() - 0.013)
    areas = [_face_normals(s)[1].sum() for s in (above, below, body)]
    assert areas[0] + areas[1] == pytest.approx(areas[2], rel=1e-12)
    assert is_closed(merge([above, below])) and not is_closed(above)


def test_smooth_unions_contain_their_parts() -> None:
    a, b = np.meshgrid(np.linspace(-1, 1, 41), np.linspace(-1, 1, 41))
    assert (smooth_min(a, b, 0.3) <= np.minimum(a, b)).all()
    assert (smooth_max(a, b, 0.3) >= np.maximum(a, b)).all()
    assert np.abs(smooth_min(a, b, 0.3) - np.minimum(a, b)).max() <= 0.05 + 1e-12


def test_a_mirrored_copy_stays_outward() -> None:
    core = objects.knob_core()
    mirrored = core.moved(np.diag([-1.0, 1.0, 1.0]))
    assert volume(mirrored) == pytest.approx(volume(core))
    assert volume(core.moved(rotation("x", 40.0), (1, 2, 3))) == pytest.approx(volume(core))


def test_splines_start_and_end_at_their_points_and_reproduce_lines() -> None:
    points = [(0.0, 1.0), (1.0, 3.0), (2.0, 5.0), (3.0, 7.0)]
    assert np.allclose(bspline(points, np.array([0.0, 1.0])), [points[0], points[-1]])
    assert np.allclose(curve(points, np.array([0.5, 2.25])), [2.0, 5.5], atol=1e-6)


def test_an_opened_seam_has_no_jump_in_u() -> None:
    def tube(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.stack([np.cos(2 * np.pi * u), np.sin(2 * np.pi * u), v], axis=-1)

    surface = parametric(tube, 24, 3)
    wrapped = Mesh(surface.vertices, surface.normals, np.mod(surface.uv, [0.9999999, 2.0]), surface.faces)
    opened = open_seam(wrapped)
    assert np.ptp(opened.uv[opened.faces][..., 0], axis=1).max() < 0.5


def test_hairs_start_on_the_surface_and_lean_as_stated() -> None:
    ball = objects.balls()
    lean = np.array([0.0, 0.0, 2.0])
    coat = insects.fur(ball, 50, (0.1, 0.2), 0.002, lean, seed=1)
    path = coat.vertices.reshape(50, -1, 3)  # rings from root to tip, three corners each
    root, tip = path[:, :3].mean(axis=1), path[:, -3:].mean(axis=1)
    near = np.array([np.linalg.norm(ball.vertices - one, axis=1).min() for one in root])
    assert near.max() < 0.02
    length = np.linalg.norm(tip - root, axis=1)
    assert 0.1 < length.min() and length.max() < 0.5
    assert (tip - root)[:, 2].min() > 0.0


def test_ten_millimetres_on_a_label_have_the_stated_length() -> None:
    drawn = insects.label_print(("A", "B", "C"), 0.5) < 0.3
    runs = np.diff(np.flatnonzero(~np.pad(drawn, ((0, 0), (1, 1))).ravel()))  # the bar is the longest of ink
    assert (runs.max() - 1) / drawn.shape[1] * insects.LABEL_WIDTH == pytest.approx(0.5, abs=0.02)
