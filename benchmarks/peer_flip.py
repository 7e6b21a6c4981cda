"""Worker of bench_pictures: NVIDIA's FLIP in its own environment. Started by `common.Worker`."""

from __future__ import annotations

import flip_evaluator
import numpy as np
from common import serve

PIXELS_A_DEGREE = 67.0


def flip(path: str) -> float:
    """Return the mean LDR-FLIP of `test` against `reference`, both 8-bit sRGB, of a file of arrays."""
    with np.load(path) as file:
        pair = [np.ascontiguousarray(file[name] / 255.0, dtype=np.float32) for name in ("reference", "test")]
    return float(flip_evaluator.evaluate(*pair, "LDR", parameters={"ppd": PIXELS_A_DEGREE})[1])


if __name__ == "__main__":
    serve({"flip": flip})
