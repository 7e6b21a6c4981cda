"""The screen: the pattern that a flat tile in a beam projects on a white screen.

As in the capture of fabricated reliefs, a narrow beam meets the tile at 10 degrees, and the reflected pattern falls on
a white matt screen parallel to the tile. Each point of the screen sees the tile in one direction, therefore a pixel is
one
BSDF value without noise: the luminance is f cos(i) cos^4(o), by the inverse square and the two cosines, relative to a
white matt tile straight ahead.

The screen is translucent and seen from behind, facing the tile: +x runs down and +y to the right, as in the drawing of
a relief design, in its preview and in height maps (array rows run along x). On an opaque wall, seen from the side of
the tile, the pattern is mirrored.
"""

import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf import Bsdf
from nacre.core.errors import UnsupportedError
from nacre.light import illuminant as find_illuminant
from nacre.light import xyz_weights
from nacre.picture.images import AUTO_LEVEL, Exposure, RenderResult, develop, encode
from nacre.picture.plugin import dr, mi

BEAM_DEG = 10.0
STEEPEST_DEG = 60.0  # incidence on a tilted tile; beyond, the screen's edge is behind the tile
HALF_WIDTH = 0.42  # relative to the screen's distance: 23 degrees
DEFAULT_SIZE = (640, 640)
WAVELENGTH_STEP_NM = 5.0
_BRIGHT_PERCENTILE = 99.5
_ROOM = 0.004  # luminance of the dark room
_MARGIN = 0.03
_BLOCK = 4096  # directions per batch


def screen_directions(size: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Unit vectors `[row, column, 3]` from the tile to the pixels, and a mask of pixels on the screen.

    The screen is centred on the mirror direction of the beam; rows run along +x and columns along +y.
    """
    width, height = size
    pixel = 2 * (1 + 2 * _MARGIN) * HALF_WIDTH / min(width, height)
    x = (np.arange(height) + 0.5 - 0.5 * height) * pixel
    y = (np.arange(width) + 0.5 - 0.5 * width) * pixel
    on_screen = (np.abs(x) <= HALF_WIDTH)[:, None] & (np.abs(y) <= HALF_WIDTH)[None, :]
    x_grid, y_grid = np.meshgrid(x - np.tan(np.radians(BEAM_DEG)), y, indexing="ij")
    d = np.stack([x_grid, y_grid, np.ones_like(x_grid)], axis=-1)
    return d / np.linalg.norm(d, axis=-1, keepdims=True), on_screen


def beam_direction(incidence_deg: float = BEAM_DEG) -> NDArray[np.float64]:
    """Unit vector from the tile to the light source."""
    return np.array([np.sin(np.radians(incidence_deg)), 0.0, np.cos(np.radians(incidence_deg))])


def turned_directions(
    size: tuple[int, int], light_turn_deg: float, view_turn_deg: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.float64]]:
    """Return directions to the pixels, the screen's mask, and the beam's direction, in the tile's frame.

    The turn of the light rotates beam and screen about the tile's normal; the pattern turns on the screen. The
    turn of the view tilts the tile, which adds to the incidence of 10 degrees; the screen stays in the mirror
    direction.

    Raises:
        UnsupportedError: the incidence is too steep.
    """
    d, on_screen = screen_directions(size)
    incidence_deg = BEAM_DEG + view_turn_deg
    if abs(incidence_deg) > STEEPEST_DEG:
        raise UnsupportedError(
            f"scene screen: a turn of {view_turn_deg:g} degrees leaves a beam at {incidence_deg:g}; "
            f"up to {STEEPEST_DEG:g} degrees are shown"
        )
    tip, turn = np.radians(-view_turn_deg), np.radians(light_turn_deg)
    about_y = np.array([[np.cos(tip), 0.0, np.sin(tip)], [0.0, 1.0, 0.0], [-np.sin(tip), 0.0, np.cos(tip)]])
    about_z = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    return d @ (about_z @ about_y).T, on_screen, about_z @ beam_direction(incidence_deg)


def render_screen(
    material: Any,
    *,
    illuminant: str = "D65",
    size: tuple[int, int] | None = None,
    exposure: Exposure = "auto",
    tone: str = "srgb",
    notes: Mapping[str, Any] | None = None,
    light_turn_deg: float = 0.0,
    view_turn_deg: float = 0.0,
) -> RenderResult:
    """Render the pattern that a material projects.

    Delta lobes, a point on the screen, are omitted, as `stats` states. "auto" exposure moves the 99.5th percentile of
    the screen just below white without limits, because the eye adapts in a dark room.

    Args:
        material: a `Bsdf` or a `mi.BSDF`.
        light_turn_deg, view_turn_deg: see `turned_directions`.
    """
    started = time.perf_counter()
    size = size or DEFAULT_SIZE
    light = find_illuminant(illuminant)
    d, on_screen, lamp = turned_directions(size, light_turn_deg, view_turn_deg)
    eye = d[on_screen]
    slant = screen_directions(size)[0][on_screen][:, 2]  # the screen does not tilt
    wavelengths = np.arange(360.0, 830.0 + WAVELENGTH_STEP_NM, WAVELENGTH_STEP_NM)
    if mi.variant().startswith("scalar"):
        values = evaluate_arrays(material, eye, lamp, wavelengths)
    else:
        if isinstance(material, Bsdf):
            from nacre.device.bsdf import make_bsdf

            material = make_bsdf(material, two_sided=True)
        values = evaluate_plugin(mi, material, eye, lamp, wavelengths)
    luminous = values @ xyz_weights(wavelengths, light)
    thrown = np.pi * luminous * (np.maximum(eye[:, 2], 0.0) * slant**3)[:, None]
    xyz = np.full((*on_screen.shape, 3), _ROOM) * (np.ones(len(wavelengths)) @ xyz_weights(wavelengths, light))
    if exposure == "auto":
        bright = float(np.percentile(thrown[:, 1], _BRIGHT_PERCENTILE))
        exposure = float(np.clip(np.log2(AUTO_LEVEL / bright), -30, 30)) if bright > 0 else 0.0
    xyz *= 2.0 ** -float(exposure)  # constant after exposure
    xyz[on_screen] = thrown
    rgb, stops = develop(xyz, light.name, exposure)
    stats = {
        **(notes or {}),
        "scene": "screen",
        "light": f"beam at {BEAM_DEG + view_turn_deg:g} degrees, {light.name}",
        "light_turn_deg": light_turn_deg % 360.0,
        "illuminant": light.name,
        "size": list(size),
        "spp": 1,
        "exposure_stops": stops,
        "tone": tone,
        "clipped_pixels": encode(rgb, tone)[1],
        "delta_lobes": "left out: a point on the screen",
        "interrupted": False,
        "seconds": time.perf_counter() - started,
    }
    return RenderResult(xyz, rgb, None, stats, tone=tone)


def evaluate_plugin(
    mi: Any, bsdf: Any, eye: NDArray[np.float64], light: NDArray[np.float64], wavelengths_nm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Evaluate f cos(i) of a Mitsuba BSDF: `[direction, wavelength]` for view directions `[direction, 3]`."""
    si = dr.zeros(mi.SurfaceInteraction3f, len(eye))
    si.wi = mi.Vector3f(*(np.ascontiguousarray(eye[:, i], dtype=np.float32) for i in range(3)))
    si.uv = mi.Point2f(0.5, 0.5)
    si.sh_frame, si.n = mi.Frame3f(mi.Normal3f(0, 0, 1)), mi.Normal3f(0, 0, 1)
    si.dp_du, si.dp_dv = mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0)
    context = mi.BSDFContext()
    result = np.empty((len(eye), len(wavelengths_nm)))
    for start in range(0, len(wavelengths_nm), 4):
        four = np.resize(wavelengths_nm[start : start + 4], 4)
        si.wavelengths = mi.Spectrum(*(dr.opaque(mi.Float, float(w)) for w in four))
        value = bsdf.eval(context, si, mi.Vector3f(*(float(c) for c in light)), True)
        part = np.array(value).reshape(4, -1).T
        count = min(4, len(wavelengths_nm) - start)
        result[:, start : start + count] = part[:, :count]
    return np.where(np.isfinite(result), result, 0.0)


def evaluate_arrays(
    material: Any, eye: NDArray[np.float64], light: NDArray[np.float64], wavelengths_nm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Evaluate f cos(i) of a `Bsdf` by its arrays, for scalar variants.

    Raises:
        UnsupportedError: a Mitsuba BSDF, or a lobe that only its plugin evaluates.
    """
    if not isinstance(material, Bsdf):
        raise UnsupportedError("scene screen: without LLVM only nacre's own materials can be shown")
    result = np.empty((len(eye), len(wavelengths_nm)))
    for start in range(0, len(eye), _BLOCK):
        block = slice(start, start + _BLOCK)
        values = material.evaluate(light, eye[block])
        for row, spectrum in enumerate(values):
            result[start + row] = np.interp(wavelengths_nm, material.wavelengths_nm, spectrum)
    return result * light[2]
