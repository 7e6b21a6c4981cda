"""Picture pixels: sRGB to CIELAB and back, and the mask for pixels whose structures differ."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import UnsupportedError
from nacre.core.files import write_text
from nacre.families.contract import Pixels
from nacre.formats.layouts import write_pixel_field
from nacre.light import (
    SRGB_WHITE_XYZ,
    clip_to_srgb,
    lab_to_xyz,
    srgb_decode,
    srgb_encode,
    srgb_linear_to_xyz,
    xyz_to_lab,
    xyz_to_srgb_linear,
)
from nacre.material.material import Material
from nacre.optimise.image.files import ParameterMap

FIELD = "pixels"
STEP_NM = 1.0  # sizes are rounded to the mask grid
REPEATS = 4  # periods along each pixel side
MAX_KINDS = 20_000


def write_pixels(folder: Path, material: Material, maps: Sequence[ParameterMap]) -> list[str]:
    """Write the field as GDSII and OASIS, with a table of its kinds of pixels; return the file names.

    Raises:
        UnsupportedError: a shape has no outline, the period varies, or there are too many kinds.
    """
    values = np.stack([np.round(m.values / STEP_NM) * STEP_NM for m in maps], axis=-1)
    values = np.clip(values, [m.low for m in maps], [m.high for m in maps])
    kinds, index = np.unique(values.reshape(-1, len(maps)), axis=0, return_inverse=True)
    if len(kinds) > MAX_KINDS:
        raise UnsupportedError(f"the picture needs {len(kinds)} different pixels; a layout holds at most {MAX_KINDS}")
    cells, pitches = [], set()
    for row in kinds:
        model = material.vary({m.path: float(v) for m, v in zip(maps, row, strict=True)}).model
        assert isinstance(model, Pixels)
        cells.append(model.pixel_polygons())
        pitches.add(model.pitch_nm)
    table = {
        "parameters": [m.path for m in maps],
        "kinds": kinds.tolist(),
        "periods_per_pixel": REPEATS,
        "pitch_nm": [list(pitch) for pitch in sorted(pitches)],
        "map": "kind of each pixel, first row on top, is the index of its values in kinds",
    }
    write_text(folder / f"{FIELD}.json", json.dumps(table) + "\n")
    if len(pitches) > 1:
        return [f"{FIELD}.json"]  # pixels of several periods do not fill a field
    for suffix in (".gds", ".oas"):
        write_pixel_field(
            folder / f"{FIELD}{suffix}",
            index.reshape(values.shape[:2]).astype(np.int64),
            cells,
            pitches.copy().pop(),
            REPEATS,
        )
    return [f"{FIELD}.json", f"{FIELD}.gds", f"{FIELD}.oas"]


def srgb_lab(rgb: Array) -> Array:
    """Return CIELAB for encoded sRGB `[..., 3]` under its white (D65, 2 degree observer)."""
    return np.asarray(xyz_to_lab(srgb_linear_to_xyz(srgb_decode(rgb)), SRGB_WHITE_XYZ))


def screen_rgb(xyz: Array, white: Array) -> Array:
    """Return the encoded sRGB with the same CIELAB values as XYZ `[..., 3]` under `white`, clipped to sRGB."""
    shown = np.clip(lab_to_xyz(xyz_to_lab(xyz, white), SRGB_WHITE_XYZ), 0.0, None)
    return np.asarray(srgb_encode(clip_to_srgb(xyz_to_srgb_linear(shown)).rgb))
