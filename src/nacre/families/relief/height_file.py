"""Heights of a recipe from arrays, images and instrument files: units, orientation, holes, tilt, periodicity."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from tokenize import TokenError

import numpy as np
from scipy.ndimage import gaussian_filter, zoom

from nacre.bsdf.texture import read_grey
from nacre.core.arrays import Array
from nacre.core.errors import NacreError, RecipeError
from nacre.core.files import plain, why_unreadable
from nacre.core.machine import check_memory
from nacre.families.relief.scan import Scan, Statistics
from nacre.families.relief.surface import Tile
from nacre.readers.heights.surface import MOST_HOLES, filled, length_um, plane, roughness, without_plane
from nacre.readers.measurement import AmbiguousFileError, ReadOptions
from nacre.recipe.model import RecipeContext

MAX_FEATURES = 512  # a side of a period
MAX_HEIGHT_UM = 1000.0
MAX_SCAN_UM = 50.0  # peak to valley without the plane, from which geometry, not diffraction, decides
BYTES_PER_POINT = 60
IMAGE_SUFFIXES = (".png", ".tif", ".tiff")
NPY_MAGIC = b"\x93NUMPY"
# a seam without a counterpart inside: its mean step over the largest mean step of neighbouring rows
OPEN_SEAM = 8.0
OPEN_SEAM_OF_MANY = 2.0  # limit for arrays with more samples than a period may have
TINY_UM, ROUNDING_UM = 1e-3, 1e-12  # range from which heights in um are rather mm or m
# range over feature from which heights in um are rather nm
NANOMETRES_ASPECT, NANOMETRES_UM = 20.0, 10.0
KEYS = {"unit": "height_unit", "pitch_um": "feature_um", "channel": "channel"}


@dataclass(frozen=True)
class Heights:
    """Heights as a recipe gives them.

    Attributes:
        heights_um: `[x, y]`; holes are NaN.
        pitch_um: point distance along x and y.
        is_periodic: whether they are one period.
        is_instrument: whether an instrument wrote them.
        remarks: assumptions.
    """

    heights_um: Array
    pitch_um: tuple[float, float]
    is_periodic: bool
    is_instrument: bool
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class HeightOptions:
    """Recipe keys about its heights; see `ReliefSpec`."""

    name: str
    feature_um: float | None
    blur_um: float | None
    height_scale_um: float | None
    periodic: bool | None
    level: str | None
    statistics: Statistics | None
    height_unit: str | None
    channel: str | None

    def read(self, context: RecipeContext) -> Heights:
        """Read the file.

        Raises:
            RecipeError: it holds no usable heights, or a unit or the pitch is missing.
        """
        path = context.path(self.name)
        try:
            with plain(path).open("rb") as file:
                magic = file.read(len(NPY_MAGIC))
        except OSError as error:
            raise context.fail("heights", self.name, why_unreadable(error)) from None
        is_array = magic == NPY_MAGIC or path.suffix.lower() == ".npy"
        is_image = path.suffix.lower() in IMAGE_SUFFIXES and not _is_scan_image(path)
        if not is_array and not is_image:
            return self._instrument(path, context)
        if self.feature_um is None:
            raise RecipeError(f"{context.source}: feature_um is missing; the heights state no pitch")
        if is_image:
            if self.height_scale_um is None:
                raise RecipeError(f"{context.source}: height_scale_um is missing; heights from an image need it")
            grey = read_grey(path, f"{context.source}: heights", MAX_FEATURES if self.periodic is not False else 65536)
            heights = grey * float(self.height_scale_um)
        else:
            factor = length_um(self.height_unit or "um")
            heights = _array(path, self.name, context) * float(factor or 1.0)
            self._check_unit(heights, context)
        pitch = (self.feature_um, self.feature_um)
        is_periodic, remarks = self._periodic(heights)
        return Heights(heights, pitch, is_periodic, False, remarks)

    def _instrument(self, path: Path, context: RecipeContext) -> Heights:
        from nacre.readers.heights.surface import read_map

        pitch = None if self.feature_um is None else (self.feature_um, self.feature_um)
        try:
            measured = read_map(path, ReadOptions(unit=self.height_unit, pitch_um=pitch, channel=self.channel))
        except AmbiguousFileError as error:
            choices = f"; allowed: {', '.join(error.choices)}" if error.choices else ""
            key = KEYS.get(error.option, error.option)
            raise RecipeError(f"{context.source}: {key} is missing; {path.name} does not state it{choices}") from None
        except NacreError as error:
            reason = str(error).removeprefix(f"{path}: ")
            reason = f"height_{reason}" if reason.startswith("unit = ") else reason
            raise context.fail("heights", self.name, reason) from None
        own = measured.metadata["pitch_um"]
        if pitch is not None and not np.allclose(pitch, own, rtol=1e-3):
            raise context.fail(
                "feature_um", self.feature_um, f"contradicts {path.name}, whose points are {own[0]:.4g} x {own[1]:.4g} "
                "um apart; leave it out",
            )  # fmt: skip
        # x along the picture's rows, y upward
        heights = measured.data["height_um"].T[:, ::-1]
        is_periodic = measured.metadata.get("is_period", False) if self.periodic is None else self.periodic
        return Heights(heights, own, is_periodic, True, tuple(measured.assumed))

    def _check_unit(self, heights: Array, context: RecipeContext) -> None:
        """Refuse numbers of which another unit is far more likely."""
        assert self.feature_um is not None
        span = float(np.ptp(heights)) if heights.size and np.isfinite(heights).all() else 0.0
        if self.height_unit is not None:
            return
        if ROUNDING_UM < span < TINY_UM:
            raise context.fail(
                "heights", self.name, f"spans {span:.3g} um, less than a nanometre: if these are "
                'metres or millimetres, add height_unit = "m" or "mm"; if not, height_unit = "um"',
            )  # fmt: skip
        if span > NANOMETRES_UM and span > NANOMETRES_ASPECT * self.feature_um and span < 1e3 * MAX_HEIGHT_UM:
            raise context.fail(
                "heights", self.name, f"spans {span:.4g} um with features of {self.feature_um:.3g} um: if these are "
                'nm, add height_unit = "nm"; if not, height_unit = "um"',
            )  # fmt: skip

    def _periodic(self, heights: Array) -> tuple[bool, tuple[str, ...]]:
        """Return whether an array is one period, and the assumptions made."""
        if self.periodic is not None or heights.ndim != 2 or not np.isfinite(heights).all():
            return self.periodic is not False, ()
        if heights.shape[0] != heights.shape[1]:
            return False, (f"{self.name} is not square and is taken as a scan",)
        if _is_open(heights, OPEN_SEAM if max(heights.shape) <= MAX_FEATURES else OPEN_SEAM_OF_MANY):
            text = (
                f"{self.name} does not close at its edges and is taken as a scan; periodic = true takes it as a period"
            )
            return False, (text,)
        return True, ()


def _is_scan_image(path: Path) -> bool:
    from nacre.readers.heights import scanning_probe
    from nacre.readers.registry import head_of

    return path.suffix.lower() != ".png" and scanning_probe.sniff_jpk(head_of(path)) > 0


def _array(path: Path, name: str, context: RecipeContext) -> Array:
    """Read a .npy array of numbers.

    Raises:
        RecipeError: not a numeric array, or too large.
    """
    try:
        mapped = np.load(plain(path), mmap_mode="r", allow_pickle=False)
        shape, kind = mapped.shape, mapped.dtype.kind
    except (OSError, ValueError, EOFError, AttributeError, SyntaxError, TokenError, TypeError) as error:
        reason = "holds Python objects" if "pickle" in str(error) else str(error)
        raise context.fail("heights", name, f"is not a .npy array of numbers: {reason}") from None
    if kind not in "fiub" or len(shape) != 2 or max(shape, default=0) > 65536:
        raise context.fail(
            "heights", name, f"holds {mapped.dtype}{list(shape)}; it should be numbers [x, y], square for a period"
        )
    check_memory(float(BYTES_PER_POINT) * shape[0] * shape[1], f"heights of {shape[0]} x {shape[1]} points")
    return np.array(mapped, dtype=float)


def _is_open(heights: Array, least: float) -> bool:
    """Return whether the step across the edges, along x or y, has no counterpart inside."""
    for axis in (0, 1):
        if heights.shape[axis] < 4:
            continue
        inside = float(np.abs(np.diff(heights, axis=axis)).mean(axis=1 - axis).max())
        seam = float(np.abs(np.take(heights, 0, axis) - np.take(heights, -1, axis)).mean())
        if seam > least * inside:
            return True
    return False


def tile_of(heights: Heights, options: HeightOptions, context: RecipeContext) -> Tile:
    """Return one period.

    Raises:
        RecipeError: not square, not finite, too many features, or far too high.
    """
    values, pitch = heights.heights_um, heights.pitch_um
    if options.blur_um is None:
        raise RecipeError(f"{context.source}: blur_um is missing; a period with sharp edges needs the process blur")
    if values.ndim != 2 or values.shape[0] != values.shape[1] or values.shape[0] < 1:
        raise context.fail("heights", options.name, f"has shape {list(values.shape)}; it should be square, n x n")
    if values.shape[0] > MAX_FEATURES:
        raise context.fail(
            "heights", options.name, f"has {values.shape[0]} features a side; a period has at most {MAX_FEATURES}; "
            "periodic = false takes it as a scan",
        )  # fmt: skip
    if not np.isfinite(values).all():
        raise context.fail("heights", options.name, "holds values that are not finite")
    if not np.isclose(pitch[0], pitch[1], rtol=1e-3):
        raise context.fail("heights", options.name, "has points that are not on a square lattice; a period needs it")
    if np.ptp(values) > MAX_HEIGHT_UM:
        raise context.fail("heights", options.name, f"spans {np.ptp(values):.3g} um; at most {MAX_HEIGHT_UM:g}")
    return Tile(1e3 * values, 1e3 * pitch[0], 1e3 * options.blur_um)


def scan_of(heights: Heights, options: HeightOptions, context: RecipeContext) -> Scan:
    """Return a scan: holes filled, on a square lattice, without its plane.

    Raises:
        RecipeError: too small, too many holes, or mountains.
    """
    values, pitch = heights.heights_um, heights.pitch_um
    if values.ndim != 2 or min(values.shape) < 8:
        raise context.fail(
            "heights",
            options.name,
            f"has shape {list(values.shape)}; it should be square, or a scan of 8 points a side or more",
        )
    remarks = list(heights.remarks)
    holes = float(np.mean(~np.isfinite(values)))
    if holes > MOST_HOLES:
        raise context.fail("heights", options.name, f"has holes in {100 * holes:.3g} % of its points; at most 10 %")
    if holes > 0:
        remarks.append(f"{100 * holes:.2g} % of the points of {options.name} are holes, filled from their neighbours")
    measured = roughness(values.T, pitch)
    fitted = plane(values)
    flat = filled(without_plane(values, fitted))
    tilt = (fitted[1] / pitch[0], fitted[2] / pitch[1])
    is_levelled = options.level == "plane" or (options.level is None and heights.is_instrument)
    if is_levelled and measured.tilt_deg > 0.01:
        remarks.append(f'a tilt of {measured.tilt_deg:.3g} degrees was removed; level = "none" keeps it')
    if np.ptp(flat) > MAX_SCAN_UM:
        raise context.fail(
            "heights", options.name, f"spans {np.ptp(flat):.4g} um without its plane; at most {MAX_SCAN_UM:g} um: "
            "mountains reflect by geometry, not by diffraction; export a flat part of the scan",
        )  # fmt: skip
    step = min(pitch)
    factors = [pitch[0] / step, pitch[1] / step]
    if max(factors) > 1.001:
        check_memory(BYTES_PER_POINT * values.size * factors[0] * factors[1], f"{options.name} on a square lattice")
        flat = zoom(flat, factors, order=3, mode="grid-mirror", grid_mode=True)
    if options.blur_um is not None:
        flat = gaussian_filter(flat, options.blur_um / step, mode="mirror")
    figures = {
        "points_x": float(values.shape[0]), "points_y": float(values.shape[1]), "pitch_x_um": pitch[0],
        "pitch_y_um": pitch[1], "sq_um": measured.sq_um, "sdq": measured.sdq, "tilt_deg": measured.tilt_deg,
        "peak_to_valley_um": measured.peak_to_valley_um,
    }  # fmt: skip
    if measured.correlation_length_um is not None:
        figures["correlation_length_um"] = measured.correlation_length_um
    residual_tilt = (0.0, 0.0) if is_levelled else tilt
    return Scan(1e3 * flat, 1e3 * step, residual_tilt, options.statistics, tuple(figures.items()), tuple(remarks))
