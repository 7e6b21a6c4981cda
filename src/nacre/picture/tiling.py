"""A large picture in bands of rows, so that a pass takes the memory of one band and not of the whole picture.

Each band is a picture of its own by the same camera, looked at off its axis, and its pixels have the random numbers
that they would have in the whole: what is put together is the picture that one pass would have given, without seams.
All bands have the same height, so that one kernel renders them all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.device.variant import use_variant
from nacre.picture.samples import begin

BAND_PIXELS = 1 << 20  # of one band; a picture of up to twice as many is rendered whole
OFFSET = "principal_point_offset_y"
MARGIN = 3  # rows beyond a band whose samples a filter wider than a pixel spreads into it


@dataclass(frozen=True)
class Band:
    """Rows that are rendered together.

    Attributes:
        first: the first of them in the picture.
        kept: those that this band decides, counted in the picture.
    """

    first: int
    kept: slice

    @property
    def inner(self) -> slice:
        """The rows that it decides, counted in the band."""
        return slice(self.kept.start - self.first, self.kept.stop - self.first)


class Banded:
    """A camera that renders a picture in bands.

    Args:
        make_sensor: gives the camera with a film of a size (width, height), which sees the width of the whole picture.
        size: width and height of the picture.
        sampler: of the sensor, from `nacre.picture.samples.going_on`.
        is_boxed: whether no sample counts for two pixels.
        pixels: of one band.
    """

    def __init__(
        self, make_sensor: Callable[[tuple[int, int]], Any], size: tuple[int, int], sampler: Any, is_boxed: bool,
        pixels: int = BAND_PIXELS,
    ) -> None:  # fmt: skip
        self.size, self.sampler = size, sampler
        # Mitsuba's own samplers, of the scalar variants, know no place in a larger picture
        can_divide = hasattr(sampler, "first_pixel") and size[0] * size[1] > 2 * pixels
        margin = 0 if is_boxed else MARGIN
        self.rows, self.bands = divide(size, pixels if can_divide else size[0] * size[1], margin)
        self.sensor = make_sensor((size[0], self.rows))
        values = use_variant().traverse(self.sensor)
        if len(self.bands) > 1 and OFFSET not in values:  # a camera with a lens cannot be turned to a band
            self.rows, self.bands = divide(size, size[0] * size[1], margin)
            self.sensor = make_sensor(size)
        self.own_offset = float(np.ravel(values[OFFSET])[0]) if OFFSET in values else 0.0

    def look_at(self, band: Band) -> None:
        """Turn camera and random numbers to a band."""
        if len(self.bands) == 1:
            return
        mi = use_variant()
        values = mi.traverse(self.sensor)
        # in heights of the band: where its middle lies below the picture's
        below = (band.first - 0.5 * self.size[1]) / self.rows + 0.5
        values[OFFSET] = mi.Float(below + self.own_offset)
        values.update()
        self.sampler.first_pixel = band.first * self.size[0]

    def render(
        self, scene: Any, integrator: Any, seed: int, first: int, spp: int, total: int = 0,
        is_over: Callable[[], bool] | None = None,
    ) -> NDArray[np.float32] | None:  # fmt: skip
        """Return a pass `[row, column, channel]` of the whole picture; None if `is_over` said so between two bands.

        Args:
            scene, integrator: of Mitsuba.
            seed, first, spp, total: see `nacre.picture.samples.begin`.
        """
        whole: Any = None
        for index, band in enumerate(self.bands):
            if index and is_over is not None and is_over():
                return None
            made = self.band(band, scene, integrator, seed, first, spp, total)
            if len(self.bands) == 1:
                return made
            if whole is None:
                whole = np.empty((self.size[1], *made.shape[1:]), dtype=np.float32)
            whole[band.kept] = made[band.inner]
        return np.asarray(whole, dtype=np.float32)

    def band(
        self,
        band: Band,
        scene: Any,
        integrator: Any,
        seed: int,
        first: int,
        spp: int,
        total: int = 0,
        alike: bool = False,
    ) -> NDArray[np.float32]:
        """Return a pass `[row, column, channel]` of one band, its margins included; see `render`."""
        self.look_at(band)
        begun = begin(self.sampler, seed, first, spp, total, self.size[0], alike)
        made = use_variant().render(scene, sensor=self.sensor, integrator=integrator, spp=spp, seed=begun)
        return np.asarray(made, dtype=np.float32)

    def let_go(self) -> None:
        """Give back the memory that the renderer keeps for another pass, where bands were made to spare it."""
        if len(self.bands) > 1:
            import drjit as dr

            dr.flush_malloc_cache()


def divide(size: tuple[int, int], pixels: int, margin: int) -> tuple[int, list[Band]]:
    """Divide a picture of (width, height) into bands; return how many rows each has, and the bands.

    Args:
        pixels: of one band, at most, but that it has some rows.
        margin: rows that it sees above and below those that it decides, where the picture has any.
    """
    width, height = size
    rows = min(max(pixels // width, 4 * margin, 1), height)
    bands, start = [], 0
    while start < height:
        first = min(max(start - margin, 0), height - rows)
        stop = height if first + rows == height else first + rows - margin
        bands.append(Band(first, slice(start, stop)))
        start = stop
    return rows, bands
