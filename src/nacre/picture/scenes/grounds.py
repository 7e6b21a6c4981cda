"""What the objects stand on: graded and chequered boards, a desk of wood, a plate of black acrylic.

Grounds of two or more colours are mixed by masks from spectra of reflectance, never from RGB. Each mask is a drawing of
our own that repeats without a seam.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.picture.filters import noise

PLANK = 1.5  # width of a plank of the desk
_TILE = (12.0, 6.0)  # of the desk's drawing: along and across the grain, in the scene's units
_ROWS = 1024  # of that drawing
_SEED = 11


def chessboard(square: float, dark: float = 0.035, bright: float = 0.6) -> dict[str, Any]:
    """A diffuse chessboard for uv in lengths, with squares of side `square`."""
    import mitsuba as mi

    return {
        "type": "diffuse",
        "reflectance": {
            "type": "checkerboard",
            "color0": {"type": "uniform", "value": dark},
            "color1": {"type": "uniform", "value": bright},
            "to_uv": mi.ScalarTransform4f().scale([0.5 / square, 0.5 / square, 1.0]),
        },
    }


def grey_bitmap(values: Array, **options: Any) -> dict[str, Any]:
    """A texture of numbers `[row, column]`, equal at all wavelengths; what `options` are, see Mitsuba's bitmap."""
    import mitsuba as mi

    data = np.ascontiguousarray(values[..., None], dtype=np.float32)
    return {"type": "bitmap", "data": mi.TensorXf(data), "raw": True, "wrap_mode": "clamp", **options}


def graded(across: float, along: float, centre: float) -> dict[str, Any]:
    """A matt backdrop for uv in lengths, lightest under the subject and darker towards its edges and up the wall."""
    import mitsuba as mi

    u, v = np.meshgrid((np.arange(128) + 0.5) / 128 * across, (np.arange(128) + 0.5) / 128 * along)
    distance = np.hypot((u - 0.5 * across) / 1.5, v - centre)
    reflectance = 0.035 + 0.14 * np.exp(-((distance / 5.5) ** 2))
    over = mi.ScalarTransform4f().scale([1 / across, 1 / along, 1.0])
    return {"type": "diffuse", "reflectance": grey_bitmap(reflectance, to_uv=over)}


def halo(across: float, along: float, centre: float) -> dict[str, Any]:
    """A black backdrop for uv in lengths with a soft glow on its wall, black again where it meets the floor."""
    import mitsuba as mi

    u, v = np.meshgrid((np.arange(128) + 0.5) / 128 * across, (np.arange(256) + 0.5) / 256 * along)
    glow = np.exp(-(((u - 0.5 * across) / 6.0) ** 2) - ((v - centre) / 2.6) ** 2)
    over = mi.ScalarTransform4f().scale([1 / across, 1 / along, 1.0])
    return {"type": "diffuse", "reflectance": grey_bitmap(0.004 + 0.06 * glow, to_uv=over)}


def matt(reflectance: Array) -> dict[str, Any]:
    """A matt surface of a spectrum of reflectance on the grid of the light tables."""
    from nacre.light import table_wavelengths_nm
    from nacre.picture.lights.environment_plugin import spectrum_texture

    return {"type": "diffuse", "reflectance": spectrum_texture(table_wavelengths_nm(), reflectance)}


def mixed(first: dict[str, Any], second: dict[str, Any], share: Array, **options: Any) -> dict[str, Any]:
    """Two surfaces by a mask `[row, column]`: where it is 1 the second."""
    weight = grey_bitmap(np.clip(share, 0.0, 1.0), **options)
    return {"type": "blendbsdf", "weight": weight, "first": first, "second": second}


def edge(low: float, high: float, middle_nm: float, width_nm: float) -> Array:
    """A smooth spectrum of reflectance that rises from `low` to `high` about `middle_nm`, on the grid of the light."""
    from nacre.light import table_wavelengths_nm

    return np.asarray(low + (high - low) / (1 + np.exp(-(table_wavelengths_nm() - middle_nm) / width_nm)))


@functools.cache
def _grain() -> tuple[Array, Array]:
    """The desk: how light the wood is, and where its pores and gaps are dark; `[row, column]`, the grain along rows."""
    shape = (_ROWS, int(_ROWS * _TILE[0] / _TILE[1]))
    unit = _ROWS / _TILE[1]  # pixels
    y = (np.arange(shape[0]) + 0.5)[:, None] / unit
    plank = np.floor(y / PLANK).astype(int)
    count = int(round(_TILE[1] / PLANK))
    light = np.zeros(shape)
    rng = np.random.default_rng(_SEED)
    for number in range(count):
        rows = np.flatnonzero(plank[:, 0] == number)
        # growth rings, cut nearly along the trunk: a few long flames in the middle, close lines at the sides
        warp = 0.22 * noise(shape, (0.35 * unit, 1.6 * unit), _SEED + 7 * number)[rows]
        warp += 0.03 * noise(shape, (0.05 * unit, 0.5 * unit), _SEED + 7 * number + 1)[rows]
        across = y[rows] - (number + rng.uniform(0.2, 0.8)) * PLANK
        rings = 3.2 * np.sqrt(across**2 + 0.12) + warp
        phase = np.mod(3.0 * rings, 1.0)
        late = np.where(phase < 0.82, phase / 0.82, (1.0 - phase) / 0.18)  # slow spring wood, a sharp line of autumn
        light[rows] = 0.62 - 0.42 * late**2 + rng.uniform(-0.07, 0.07)
    light += 0.045 * noise(shape, (0.006 * unit, 0.5 * unit), _SEED + 100)
    light += 0.05 * noise(shape, (0.4 * unit, 1.5 * unit), _SEED + 101)
    pores = np.clip(noise(shape, (0.004 * unit, 0.09 * unit), _SEED + 102) - 1.75, 0.0, 1.0)
    gap = np.abs(np.mod(y / PLANK + 0.5, 1.0) - 0.5) * PLANK
    dark = np.maximum(0.75 * pores, np.exp(-((gap / 0.012) ** 2)) * np.ones(shape))
    return np.clip(light, 0.0, 1.0), np.clip(dark, 0.0, 1.0)


def wood() -> dict[str, Any]:
    """An oiled desk of walnut for uv in lengths, its planks across the picture."""
    import mitsuba as mi

    light, dark = _grain()
    repeated = {
        "wrap_mode": "repeat",
        "to_uv": mi.ScalarTransform4f().scale([1 / _TILE[0], 1 / _TILE[1], 1.0]),
    }
    # walnut's heart: brown, rising all through the visible and beyond
    heart, sap = edge(0.025, 0.13, 615.0, 50.0), edge(0.07, 0.36, 585.0, 55.0)
    body = mixed(matt(heart), matt(sap), light, **repeated)
    return mixed(body, matt(edge(0.012, 0.03, 620.0, 60.0)), dark, **repeated)


def acrylic() -> dict[str, Any]:
    """Black acrylic, polished: it mirrors what stands on it."""
    return {"type": "plastic", "int_ior": 1.49, "diffuse_reflectance": 0.004}


def museum_board() -> dict[str, Any]:
    """White foam board under paper, as insects are pinned on, for uv in lengths."""
    import mitsuba as mi

    shape, side = (512, 512), 3.0
    pulp = 0.6 * noise(shape, (1.0, 1.0), _SEED + 60) + 0.5 * noise(shape, (6.0, 6.0), _SEED + 61)
    pulp += 0.5 * noise(shape, (40.0, 40.0), _SEED + 62)
    repeated = {"wrap_mode": "repeat", "to_uv": mi.ScalarTransform4f().scale([1 / side, 1 / side, 1.0])}
    white = edge(0.56, 0.72, 440.0, 34.0)
    return mixed(matt(0.86 * white), matt(white), 0.6 + 0.22 * pulp, **repeated)


def printed_note(rows: int = 1024) -> dict[str, Any]:
    """The banknote's paper with its inks, one over the other."""
    from nacre.picture.shapes.printed import NOTE_HEIGHT, NOTE_WIDTH, note_drawing

    light, inks = note_drawing(rows, NOTE_WIDTH / NOTE_HEIGHT)
    spectra = {
        "ochre": edge(0.12, 0.62, 545.0, 28.0), "teal": _band(0.06, 0.42, 505.0, 55.0),
        "violet": _band(0.04, 0.22, 430.0, 40.0) + edge(0.0, 0.12, 630.0, 20.0),
        "blue": _band(0.02, 0.13, 455.0, 45.0), "red": edge(0.05, 0.6, 605.0, 14.0),
    }  # fmt: skip
    paper = edge(0.56, 0.8, 430.0, 30.0)
    note = mixed(matt(0.82 * paper), matt(1.0 * paper), 0.5 + 5.0 * (light - 0.95)[::-1])  # v upward
    for name, share in inks.items():
        note = mixed(note, matt(spectra[name]), share[::-1])
    return note


def printed_card() -> dict[str, Any]:
    """The pass card's face under its laminate: blue that runs into teal, with white ink."""
    from nacre.picture.shapes.printed import card_print_pass_card as card_print

    light, ink = card_print()
    ground = mixed(_glossy(_band(0.01, 0.10, 455.0, 42.0)), _glossy(_band(0.02, 0.3, 495.0, 50.0)), light[::-1])
    return mixed(ground, _glossy(edge(0.6, 0.8, 430.0, 30.0)), ink[::-1])


def _glossy(reflectance: Array) -> dict[str, Any]:
    """The same spectrum as `matt` under a smooth clear coat."""
    return {
        "type": "roughplastic", "int_ior": 1.5, "alpha": 0.06, "nonlinear": False,
        "diffuse_reflectance": matt(reflectance)["reflectance"],
    }  # fmt: skip


def _band(low: float, high: float, middle_nm: float, width_nm: float) -> Array:
    """A spectrum of reflectance with one hill."""
    from nacre.light import table_wavelengths_nm

    return np.asarray(low + (high - low) * np.exp(-(((table_wavelengths_nm() - middle_nm) / width_nm) ** 2)))
