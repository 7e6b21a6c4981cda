"""Tiled rendering of large pictures: the memory of a pass is that of one tile, a band of rows.

Each tile is rendered by the same camera off its axis, with the random numbers that its pixels have in the whole
picture; the result has no seams. All tiles have one height, therefore one kernel renders them all.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.picture.plugin import dr, mi
from nacre.picture.samples import begin

TILE_PIXELS = 1 << 20  # per tile; a picture with up to twice as many is rendered whole
OFFSET = "principal_point_offset_y"
MARGIN = 3  # rows beyond a tile from which a filter wider than a pixel collects samples


@dataclass(frozen=True)
class Tile:
    """Rows that are rendered together.

    Attributes:
        first: the first row, in the picture.
        kept: rows that this tile contributes, in the picture.
    """

    first: int
    kept: slice

    @property
    def inner(self) -> slice:
        """Rows that it contributes, in the tile."""
        return slice(self.kept.start - self.first, self.kept.stop - self.first)


@dataclass(frozen=True)
class Pass:
    """Samples of one pass; arguments of `nacre.picture.samples.begin`."""

    seed: int
    first: int
    spp: int
    total: int = 0
    alike: bool = False


class TiledCamera:
    """A camera that renders a picture in tiles.

    Args:
        make_sensor: gives the camera with a film size (width, height), for the width of the whole picture.
        size: width and height of the picture.
        sampler: sampler of the sensor, from `nacre.picture.samples.continued_sampler`.
        is_boxed: whether each sample counts for one pixel.
        pixels: pixels per tile.
    """

    def __init__(
        self,
        make_sensor: Callable[[tuple[int, int]], Any],
        size: tuple[int, int],
        sampler: Any,
        is_boxed: bool,
        pixels: int = TILE_PIXELS,
    ) -> None:
        self.size, self.sampler = size, sampler
        whole = size[0] * size[1]
        # Mitsuba's samplers, of the scalar variants, do not know their place in a larger picture
        can_divide = hasattr(sampler, "first_pixel") and whole > 2 * pixels
        margin = 0 if is_boxed else MARGIN
        self.rows, self.tiles = divide(size, pixels if can_divide else whole, margin)
        self.sensor = make_sensor((size[0], self.rows))
        values = mi.traverse(self.sensor)
        if len(self.tiles) > 1 and OFFSET not in values:  # a camera with a lens has no offset
            self.rows, self.tiles = divide(size, whole, margin)
            self.sensor = make_sensor(size)
        self.own_offset = float(np.ravel(values[OFFSET])[0]) if OFFSET in values else 0.0

    def look_at(self, tile: Tile) -> None:
        """Direct camera and random numbers to a tile."""
        if len(self.tiles) == 1:
            return
        values = mi.traverse(self.sensor)
        below = (tile.first - 0.5 * self.size[1]) / self.rows + 0.5  # in heights of the tile, below the centre
        values[OFFSET] = mi.Float(below + self.own_offset)
        values.update()
        self.sampler.first_pixel = tile.first * self.size[0]

    def render(
        self, scene: Any, integrator: Any, samples: Pass, is_over: Callable[[], bool] | None = None
    ) -> NDArray[np.float32] | None:
        """Return a pass `[row, column, channel]` of the whole picture; None if `is_over` stopped it between tiles.

        Args:
            scene, integrator: Mitsuba objects.
            samples: samples of the pass.
            is_over: asked between tiles.
        """
        whole: Any = None
        for index, tile in enumerate(self.tiles):
            if index and is_over is not None and is_over():
                return None
            made = self.render_tile(tile, scene, integrator, samples)
            if len(self.tiles) == 1:
                return made
            if whole is None:
                whole = np.empty((self.size[1], *made.shape[1:]), dtype=np.float32)
            whole[tile.kept] = made[tile.inner]
        return np.asarray(whole, dtype=np.float32)

    def render_tile(self, tile: Tile, scene: Any, integrator: Any, samples: Pass) -> NDArray[np.float32]:
        """Return a pass `[row, column, channel]` of one tile with its margins; see `render`."""
        self.look_at(tile)
        seed = begin(self.sampler, samples.seed, samples.first, samples.spp, samples.total, self.size[0], samples.alike)
        made = mi.render(scene, sensor=self.sensor, integrator=integrator, spp=samples.spp, seed=seed)
        return np.asarray(made, dtype=np.float32)

    def free_memory(self) -> None:
        """Return the renderer's memory of a tiled picture to the system."""
        if len(self.tiles) > 1:
            dr.flush_malloc_cache()


def divide(size: tuple[int, int], pixels: int, margin: int) -> tuple[int, list[Tile]]:
    """Divide a picture of (width, height) into tiles; return their row count, and the tiles.

    Args:
        pixels: maximum per tile, except for a minimum of rows.
        margin: rows above and below the contributed ones, within the picture.
    """
    width, height = size
    rows = min(max(pixels // width, 4 * margin, 1), height)
    tiles, start = [], 0
    while start < height:
        first = min(max(start - margin, 0), height - rows)
        stop = height if first + rows == height else first + rows - margin
        tiles.append(Tile(first, slice(start, stop)))
        start = stop
    return rows, tiles
