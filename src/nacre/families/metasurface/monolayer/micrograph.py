"""Particle positions and sizes from a microscope picture.

The smoothed grey levels are split by Otsu's threshold (IEEE Trans. Syst. Man Cybern. 9, 62, 1979); the particles are
the rarer level, bright or dark. Touching blobs are separated at the distance transform maxima. Particles at the
border, annotations and a scale banner are left out.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.core.files import why_unreadable

SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp")
MOST_PIXELS = 60_000_000
SMOOTHING = 1.0  # pixels
LEAST_WIDTH = 4.0  # smallest usable particle diameter in pixels
SPECK = 0.25  # blobs below this share relative to the median area are noise
LEVELS = 256
SHADE = 0.1  # relative to the width: slower variation is uneven illumination
BANNER, IN_PICTURE = 0.5, 0.2  # one-level share per row: minimum in a banner, maximum in a picture
LEAST_BANNER = 0.02  # relative to the height
DRAWN = 0.1  # relative to the median noise within particles; less identifies an annotation
LEAST_NOISE = 1e-3  # a quarter of an 8-bit step
SURE = 0.7  # grey-level variance that two levels must explain; 0.64 for pure noise


@dataclass(frozen=True)
class Found:
    """Particles found in a picture.

    Attributes:
        xy_um: `[particle, 2]`, x to the right, y up, from the lower left corner.
        diameters_nm: `[particle]`, for discs with the blob areas.
        size_um: picture width and height.
        is_bright: whether the particles are the bright parts.
        left_out: banner or annotations, in words; "" without any.
    """

    xy_um: Array
    diameters_nm: Array
    size_um: tuple[float, float]
    is_bright: bool
    left_out: str = ""

    @property
    def summary(self) -> str:
        """Summary in words."""
        mean, spread = float(self.diameters_nm.mean()), float(self.diameters_nm.std())
        return (
            f"{len(self.xy_um)} {'bright' if self.is_bright else 'dark'} particles, {mean:.4g} nm wide (standard "
            f"deviation {spread:.3g} nm), in {self.size_um[0]:.4g} x {self.size_um[1]:.4g} um"
            + (f", without {self.left_out}" if self.left_out else "")
        )


def is_picture(name: str) -> bool:
    """Whether a file name has a picture suffix."""
    return Path(name).suffix.lower() in SUFFIXES


def grey_levels(path: str | Path) -> Array:
    """Return picture grey levels, `[row, column]`, 0 to 1.

    Raises:
        NacreError: unreadable or too large; the message ends a sentence that begins with the file.
    """
    from PIL import Image

    try:
        with Image.open(path) as image:
            if image.width * image.height > MOST_PIXELS:
                raise NacreError(f"has {image.width} x {image.height} pixels; at most {MOST_PIXELS:g} are read")
            levels = np.asarray(image if image.mode in ("I", "F", "I;16") else image.convert("L"), dtype=float)
    except NacreError:
        raise
    except OSError as error:
        raise NacreError(
            why_unreadable(error) if error.errno is not None else "is no picture that can be read"
        ) from None
    except (ValueError, SyntaxError, Image.DecompressionBombError):
        raise NacreError("is no picture that can be read") from None
    low, high = float(levels.min()), float(levels.max())
    if not np.isfinite(high - low) or high <= low:
        raise NacreError("is of one grey level: it shows nothing")
    return (levels - low) / (high - low)


def find_particles(levels: Array, width_um: float) -> Found:
    """Find the particles in grey levels, `[row, column]`, for picture width `width_um`.

    Raises:
        NacreError: no contrast, or too small particles; the message ends a sentence that begins with the file.
    """
    from scipy import ndimage

    above, below = _banner(levels), _banner(levels[::-1])
    levels = levels[above : len(levels) - below]
    rows, columns = levels.shape
    pixel_nm = 1e3 * width_um / columns
    smooth = ndimage.gaussian_filter(levels, SMOOTHING)
    threshold, explained = otsu(smooth)
    if explained < SURE:  # remove uneven illumination, as from charging or an off-axis detector
        smooth = smooth - ndimage.gaussian_filter(levels, SHADE * columns)
        threshold, explained = otsu(smooth)
    if explained < SURE:
        raise NacreError(
            f"has no two levels: they explain {100 * explained:.0f} % of its contrast, {100 * SURE:.0f} % are needed"
        )
    bright = smooth > threshold
    is_bright = bool(bright.mean() < 0.5)
    inside = bright if is_bright else ~bright
    blobs = _split(inside)
    labels = np.arange(1, int(blobs.max()) + 1)
    areas = ndimage.sum_labels(inside, blobs, labels)
    cut = np.unique(np.concatenate([blobs[0], blobs[-1], blobs[:, 0], blobs[:, -1]]))
    whole = ~np.isin(labels, cut)
    if not np.any(whole):
        raise NacreError("shows no particle that its border does not cut")
    whole &= areas >= SPECK * np.median(areas[whole])
    drawn = whole & _of_one_level(levels, np.where(ndimage.binary_erosion(inside, iterations=2), blobs, 0), whole)
    selected = labels[whole & ~drawn]
    diameters = 2 * np.sqrt(areas[selected - 1] / np.pi)
    if np.median(diameters) < LEAST_WIDTH:
        raise NacreError(
            f"shows particles {np.median(diameters):.2g} pixels wide; {LEAST_WIDTH:g} are needed to tell where they lie"
        )
    at = np.array(ndimage.center_of_mass(inside, blobs, selected)).reshape(-1, 2)
    xy = np.column_stack([at[:, 1] + 0.5, rows - 0.5 - at[:, 0]]) * pixel_nm * 1e-3
    notes = [f"a banner of {above + below} rows"] * (above + below > 0) + ["marks drawn in"] * bool(drawn.any())
    return Found(xy, diameters * pixel_nm, (width_um, rows * pixel_nm * 1e-3), is_bright, " and ".join(notes))


def _banner(levels: Array) -> int:
    """Return the count of banner rows at the top, each mostly one level."""
    alike = np.array([np.unique(row, return_counts=True)[1].max() for row in levels]) / levels.shape[1]
    ends = np.flatnonzero(alike < BANNER)
    count = int(ends[0]) if ends.size else 0
    is_one = count >= LEAST_BANNER * len(levels) and float(np.median(alike[count:])) < IN_PICTURE
    return count if is_one else 0


def _of_one_level(levels: Array, cores: NDArray[np.intp], whole: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which blobs have one level, `[blob]`: annotations lack noise.

    Args:
        cores: `[row, column]`, blob numbers from 1 away from outlines, else 0.
        whole: `[blob]`, the blobs that count.
    """
    count, first, second = (
        np.bincount(cores.ravel(), by, len(whole) + 1)[1:] for by in (None, levels.ravel(), levels.ravel() ** 2)
    )
    there = count > 1
    size = np.maximum(count, 1)
    noise = np.where(there, np.sqrt(np.maximum(second / size - (first / size) ** 2, 0.0)), np.inf)
    usual = noise[whole & there]
    if not usual.size or np.median(usual) < LEAST_NOISE:  # the picture is a drawing
        return np.zeros_like(there)
    return np.asarray(noise < DRAWN * np.median(usual))


def otsu(levels: Array) -> tuple[float, float]:
    """Return Otsu's threshold for levels in 0 to 1, and the explained variance share."""
    counts, edges = np.histogram(levels, LEVELS)
    middle = (edges[1:] + edges[:-1]) / 2
    weight = np.cumsum(counts) / counts.sum()
    moment = np.cumsum(counts * middle) / counts.sum()
    with np.errstate(invalid="ignore", divide="ignore"):
        between = (moment[-1] * weight - moment) ** 2 / (weight * (1 - weight))
    between = np.nan_to_num(between)
    best = int(np.argmax(between))
    variance = float(np.sum(counts * (middle - moment[-1]) ** 2) / counts.sum())
    return float(edges[best + 1]), float(between[best]) / max(variance, 1e-300)


def _split(inside: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Label blobs, `[row, column]`, 0 outside; touching blobs are split at their necks."""
    from scipy import ndimage

    depth = ndimage.gaussian_filter(ndimage.distance_transform_edt(inside), SMOOTHING)
    together, count = ndimage.label(inside)
    if count == 0:
        return np.asarray(together)
    deepest = ndimage.maximum(depth, together, np.arange(1, count + 1))
    radius = max(1.0, float(np.median(deepest)))
    around = ndimage.maximum_filter(depth, size=2 * int(np.ceil(0.7 * radius)) + 1)
    # seeds are at least half as deep as a full particle, unlike outline bumps
    seeds, seeded = ndimage.label((depth == around) & (depth > 0.5 * radius) & inside)
    if seeded == 0:
        return np.asarray(together)
    nearest = ndimage.distance_transform_edt(seeds == 0, return_distances=False, return_indices=True)
    parted = np.where(inside, seeds[tuple(nearest)], 0)
    lost = inside & ~np.isin(together, np.unique(together[seeds > 0]))  # blobs without a seed are specks
    return np.where(lost, 0, parted)
