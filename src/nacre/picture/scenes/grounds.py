"""Ground and printed materials: graded and chequered boards, wood, black acrylic, paper.

Grounds with two or more colours blend reflectance spectra by seamless masks, never RGB.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.light import table_wavelengths_nm
from nacre.picture.filters import noise
from nacre.picture.lights.environment_plugin import spectrum_texture
from nacre.picture.lights.environments import WOOD, edge, peak
from nacre.picture.plugin import mi

PLANK = 1.5  # plank width on the desk
_TILE = (12.0, 6.0)  # desk period along and across the grain, in scene units
_ROWS = 1024  # drawing resolution
_SEED = 11


def _diffuse(reflectance: dict[str, Any]) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": reflectance}


def _per_length(x: float, y: float) -> dict[str, Any]:
    """Texture scale for uv in lengths: one period over x by y."""
    return {"to_uv": mi.ScalarTransform4f().scale([1 / x, 1 / y, 1.0])}


def chessboard(square: float, dark: float = 0.035, bright: float = 0.6) -> dict[str, Any]:
    """A diffuse chessboard for uv in lengths."""
    colours = {f"color{i}": {"type": "uniform", "value": value} for i, value in enumerate((dark, bright))}
    return _diffuse({"type": "checkerboard", **colours, **_per_length(2 * square, 2 * square)})


def grey_bitmap(values: Array, **options: Any) -> dict[str, Any]:
    """A spectrally flat texture from numbers `[row, column]`; `options` as for Mitsuba's bitmap."""
    data = np.ascontiguousarray(values[..., None], dtype=np.float32)
    return {"type": "bitmap", "data": mi.TensorXf(data), "raw": True, "wrap_mode": "clamp", **options}


def graded(across: float, along: float, centre: float) -> dict[str, Any]:
    """A matt backdrop for uv in lengths, lightest below the subject."""
    u, v = np.meshgrid((np.arange(128) + 0.5) / 128 * across, (np.arange(128) + 0.5) / 128 * along)
    distance = np.hypot((u - 0.5 * across) / 1.5, v - centre)
    return _diffuse(grey_bitmap(0.035 + 0.14 * np.exp(-((distance / 5.5) ** 2)), **_per_length(across, along)))


def halo(across: float, along: float, centre: float) -> dict[str, Any]:
    """A black backdrop for uv in lengths with a soft glow on its wall."""
    u, v = np.meshgrid((np.arange(128) + 0.5) / 128 * across, (np.arange(256) + 0.5) / 256 * along)
    glow = np.exp(-(((u - 0.5 * across) / 6.0) ** 2) - ((v - centre) / 2.6) ** 2)
    return _diffuse(grey_bitmap(0.004 + 0.06 * glow, **_per_length(across, along)))


def matt(reflectance: Array) -> dict[str, Any]:
    """A matt surface with a reflectance spectrum on the light tables' wavelength grid."""
    return _diffuse(spectrum_texture(table_wavelengths_nm(), reflectance))


def mixed(first: dict[str, Any], second: dict[str, Any], share: Array, **options: Any) -> dict[str, Any]:
    """Blend two surfaces; the mask `[row, column]` is the share of the second."""
    weight = grey_bitmap(np.clip(share, 0.0, 1.0), **options)
    return {"type": "blendbsdf", "weight": weight, "first": first, "second": second}


@functools.cache
def _grain() -> tuple[Array, Array]:
    """Brightness of the desk's wood, and its dark pores and gaps; `[row, column]`, grain along rows."""
    shape = (_ROWS, int(_ROWS * _TILE[0] / _TILE[1]))
    unit = _ROWS / _TILE[1]  # pixels

    def grain(across: float, along: float, seed: int) -> Array:
        return noise(shape, (across * unit, along * unit), _SEED + seed)

    y = (np.arange(shape[0]) + 0.5)[:, None] / unit
    plank = np.floor(y / PLANK).astype(int)
    light = np.zeros(shape)
    rng = np.random.default_rng(_SEED)
    for number in range(int(round(_TILE[1] / PLANK))):
        rows = np.flatnonzero(plank[:, 0] == number)
        # growth rings cut nearly along the trunk: long flames in the middle, close lines at the sides
        warp = 0.22 * grain(0.35, 1.6, 7 * number)[rows]
        warp += 0.03 * grain(0.05, 0.5, 7 * number + 1)[rows]
        across = y[rows] - (number + rng.uniform(0.2, 0.8)) * PLANK
        rings = 3.2 * np.sqrt(across**2 + 0.12) + warp
        phase = np.mod(3.0 * rings, 1.0)
        late = np.where(phase < 0.82, phase / 0.82, (1.0 - phase) / 0.18)  # slow spring wood, sharp autumn wood
        light[rows] = 0.62 - 0.42 * late**2 + rng.uniform(-0.07, 0.07)
    light += 0.045 * grain(0.006, 0.5, 100)
    light += 0.05 * grain(0.4, 1.5, 101)
    pores = np.clip(grain(0.004, 0.09, 102) - 1.75, 0.0, 1.0)
    gap = np.abs(np.mod(y / PLANK + 0.5, 1.0) - 0.5) * PLANK
    dark = np.maximum(0.75 * pores, np.exp(-((gap / 0.012) ** 2)) * np.ones(shape))
    return np.clip(light, 0.0, 1.0), np.clip(dark, 0.0, 1.0)


def wood() -> dict[str, Any]:
    """An oiled walnut desk for uv in lengths, planks across the picture."""
    light, dark = _grain()
    repeated = {"wrap_mode": "repeat", **_per_length(*_TILE)}
    heart, sap = edge(0.025, 0.13, 615.0, 50.0), edge(0.07, 0.36, 585.0, 55.0)
    body = mixed(matt(heart), matt(sap), light, **repeated)
    return mixed(body, matt(edge(0.012, 0.03, 620.0, 60.0)), dark, **repeated)


def boards() -> dict[str, Any]:
    """The wooden floor of the room."""
    return matt(WOOD)


def acrylic() -> dict[str, Any]:
    """Polished black acrylic, which mirrors objects on it."""
    return {"type": "plastic", "int_ior": 1.49, "diffuse_reflectance": 0.004}


def museum_board() -> dict[str, Any]:
    """White paper-covered foam board on which insects are pinned, for uv in lengths."""
    shape, side = (512, 512), 3.0
    pulp = 0.6 * noise(shape, (1.0, 1.0), _SEED + 60) + 0.5 * noise(shape, (6.0, 6.0), _SEED + 61)
    pulp += 0.5 * noise(shape, (40.0, 40.0), _SEED + 62)
    white = edge(0.56, 0.72, 440.0, 34.0)
    options = {"wrap_mode": "repeat", **_per_length(side, side)}
    return mixed(matt(0.86 * white), matt(white), 0.6 + 0.22 * pulp, **options)


def printed_note(rows: int = 1024) -> dict[str, Any]:
    """The paper of the banknote with its inks, one over the other."""
    from nacre.picture.shapes.printed import NOTE_HEIGHT, NOTE_WIDTH, note_drawing

    light, inks = note_drawing(rows, NOTE_WIDTH / NOTE_HEIGHT)
    spectra = {
        "ochre": edge(0.12, 0.62, 545.0, 28.0),
        "teal": peak(0.06, 0.42, 505.0, 55.0),
        "violet": peak(0.04, 0.22, 430.0, 40.0) + edge(0.0, 0.12, 630.0, 20.0),
        "blue": peak(0.02, 0.13, 455.0, 45.0),
        "red": edge(0.05, 0.6, 605.0, 14.0),
    }
    paper = edge(0.56, 0.8, 430.0, 30.0)
    note = mixed(matt(0.82 * paper), matt(1.0 * paper), 0.5 + 5.0 * (light - 0.95)[::-1])  # v upward
    for name, share in inks.items():
        note = mixed(note, matt(spectra[name]), share[::-1])
    return note


def printed_pass() -> dict[str, Any]:
    """The laminated face of the plastic card: blue that changes to teal, with white ink."""
    from nacre.picture.shapes.printed import pass_print

    light, ink = pass_print()
    ground = mixed(_glossy(peak(0.01, 0.10, 455.0, 42.0)), _glossy(peak(0.02, 0.3, 495.0, 50.0)), light[::-1])
    return mixed(ground, _glossy(edge(0.6, 0.8, 430.0, 30.0)), ink[::-1])


def _glossy(reflectance: Array) -> dict[str, Any]:
    """A diffuse spectrum below a smooth clear coat."""
    colour = matt(reflectance)["reflectance"]
    return {"type": "roughplastic", "int_ior": 1.5, "alpha": 0.06, "nonlinear": False, "diffuse_reflectance": colour}
