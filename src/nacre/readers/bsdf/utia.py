"""UTIA BRDF files: float64 planes of RGB on a uniform grid, without a head (Filip and Vavra 2014).

288 incident by 288 exit directions: theta 0 to 75 in steps of 15 degrees, phi 0 to 352.5 in steps of 7.5. The order is
channel, theta_i, phi_i, theta_v, phi_v. Values are BRDF times pi or reflectance factors by the data set; they are read
as the BRDF that the data set's own viewer uses.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from nacre.core.errors import NacreError
from nacre.readers.bsdf.samples import measurement, pairs_of, read_bytes
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import LIKELY, FileHead

THETA = np.arange(6) * 15.0
PHI = np.arange(48) * 7.5
SIZE = 8 * 3 * (len(THETA) * len(PHI)) ** 2


def sniff(head: FileHead) -> float:
    """Recognise the file's size and numbers in its head; the format has no magic."""
    if head.size != SIZE or b"nacre" in head.data[:16]:
        return 0.0
    values = np.frombuffer(head.data[: len(head.data) // 8 * 8], "<f8")
    return LIKELY if np.all(np.isfinite(values)) and np.all(np.abs(values) < 1e6) else 0.0


def read(path: Path, options: ReadOptions) -> list[Measurement]:
    """Read all direction pairs.

    Raises:
        NacreError: the size or the numbers do not fit.
    """
    data = read_bytes(path, 8.0)
    if len(data) != SIZE:
        raise NacreError(f"{path}: has {len(data)} bytes; a UTIA file of 288 x 288 directions has {SIZE}")
    planes = np.frombuffer(data, "<f8").reshape(3, -1)
    if not np.all(np.isfinite(planes)):
        raise NacreError(f"{path}: holds values that are not finite")
    grids = np.meshgrid(THETA, PHI, THETA, PHI, indexing="ij")
    metadata = {"scatter": "brdf", "shape": (len(THETA), len(PHI), len(THETA), len(PHI))}
    assumed = ["the file has no head; the standard grid of the UTIA database is assumed"]
    return [
        measurement(path, "utia", pairs_of(*grids), None, planes.T, metadata, colour="rgb", assumed=assumed,
                    left_out=["nothing was measured above 75 degrees"])
    ]  # fmt: skip
