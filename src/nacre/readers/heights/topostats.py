"""TopoStats files (.topostats): HDF5 with the flattened image in nm."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from nacre.readers.hdf5 import HDF5_MAGIC, dataset, opened
from nacre.readers.heights.surface import height_map, reads
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import CERTAIN, FileHead

IMAGES = ("image", "image_original")
KEY, MAX_BYTES = b"pixel_to_nm_scaling", 64 << 20


def sniff(head: FileHead) -> float:
    """Return 1 for HDF5 with `topostats_file_version` or an image and a scale from pixels to nm."""
    if not head.data.startswith(HDF5_MAGIC):
        return 0.0
    # names of later groups stand behind the traces of grains
    data = head.data if KEY in head.data or head.size > MAX_BYTES else head.path.read_bytes()
    return CERTAIN if KEY in data else 0.0


@reads
def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read the flattened image, or the original one if there is no other."""
    with opened(path) as file:
        scale: Any = dataset(file, "pixel_to_nm_scaling")
        name, image = next(((n, d) for n in IMAGES if (d := dataset(file, n)) is not None), ("", None))
        if scale is None or image is None or image.ndim != 2:
            raise ValueError("it holds no image with pixel_to_nm_scaling")
        pitch = float(np.ravel(scale[()])[0]) * 1e-3
        heights = np.asarray(image[()], dtype=float) * 1e-3
    left = [other for other in IMAGES if other != name]
    return [height_map(path, "topostats", heights, (pitch, pitch), name, left_out=left)]
