"""Illuminants, observers, and tristimulus values of spectra on any wavelength samples.

A spectrum is piecewise linear between its samples and constant beyond them, and is integrated against the 1 nm
tables. The integral is linear in the samples, so it reduces to one weight for each sample and tristimulus value, and
a million spectra cost one matrix product. `smooth_weights` does the same for cubic splines.

The tables ship with the package (`tools/make_light_tables.py` writes them from colour-science) and are read on first
use.
"""

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import resources

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array
from nacre.core.errors import NacreError, did_you_mean

ILLUMINANTS = ("A", "C", "D50", "D65", "E", "F2", "F11", "LED-B3")
OBSERVERS = ("2deg", "10deg")


@dataclass(frozen=True, eq=False)
class Illuminant:
    """A light's relative spectral power; unpacks as `wavelengths_nm, power = illuminant("D65")`.

    Attributes:
        wavelengths_nm: `[wavelength]`, ascending.
        power: `[wavelength]`, relative power per nanometre, >= 0; its scale cancels in every colour.
        name: label in outputs.
    """

    wavelengths_nm: Array
    power: Array
    name: str = "custom"

    def __post_init__(self) -> None:
        wavelengths = np.asarray(self.wavelengths_nm, dtype=float)
        power = np.asarray(self.power, dtype=float)
        if wavelengths.ndim != 1 or wavelengths.shape != power.shape or len(wavelengths) < 2:
            raise NacreError(
                f"illuminant {self.name}: wavelengths_nm and power must be lists of one length, at least 2; "
                f"got shapes {wavelengths.shape} and {power.shape}"
            )
        if not (np.isfinite(wavelengths).all() and (np.diff(wavelengths) > 0).all()):
            raise NacreError(f"illuminant {self.name}: wavelengths_nm must ascend")
        if not (np.isfinite(power).all() and (power >= 0).all() and power.max() > 0):
            raise NacreError(f"illuminant {self.name}: power must be finite, never negative and somewhere positive")
        object.__setattr__(self, "wavelengths_nm", wavelengths)
        object.__setattr__(self, "power", power)

    def __iter__(self) -> Iterator[Array]:
        return iter((self.wavelengths_nm, self.power))

    def at(self, wavelengths_nm: Array) -> Array:
        """Return the power at any wavelengths: linear between samples, constant beyond the ends."""
        return np.interp(wavelengths_nm, self.wavelengths_nm, self.power)


@functools.cache
def _tables() -> dict[str, Array]:
    with resources.files("nacre.light").joinpath("data/cie_1nm.npz").open("rb") as file, np.load(file) as arrays:
        tables = {name: arrays[name] for name in arrays.files}
    for table in tables.values():
        table.setflags(write=False)  # shared by every caller
    return tables


def table_wavelengths_nm() -> Array:
    """Return the wavelengths of the tables: 360, 361, ..., 830."""
    return _tables()["wavelengths_nm"]


@functools.cache
def _standard_illuminant(name: str) -> Illuminant:
    return Illuminant(table_wavelengths_nm(), _tables()[f"illuminant {name}"], name)


def illuminant(name: str | Illuminant = "D65") -> Illuminant:
    """Return a standard illuminant on 360-830 nm in steps of 1 nm; an `Illuminant` passes through.

    Source: CIE 15:2018 (A, C, D50, D65, E, the fluorescent F2 and F11, the white LED-B3); interpolated to 1 nm
    with Sprague's formula, the last published value continued to 830 nm.

    Raises:
        NacreError: unknown illuminant.

    Example:
        >>> float(illuminant("D65").at(560.0))
        100.0
    """
    if isinstance(name, Illuminant):
        return name
    by_lower = {known.lower(): known for known in ILLUMINANTS}
    key = by_lower.get(str(name).lower())
    if key is None:
        raise NacreError(
            f'illuminant "{name}" is not known.{did_you_mean(str(name), ILLUMINANTS)} '
            f"Choose from {', '.join(ILLUMINANTS)}"
        )
    return _standard_illuminant(key)


def observer(name: str = "2deg") -> Array:
    """Return the colour matching functions `[wavelength, 3]` (x, y, z) on 360-830 nm in steps of 1 nm.

    Source: CIE 1931 standard observer ("2deg") and CIE 1964 standard observer ("10deg"), CIE 15:2018.

    Raises:
        NacreError: unknown observer.

    Example:
        >>> round(float(observer("2deg")[555 - 360, 1]), 3)
        1.0
    """
    if name not in OBSERVERS:
        raise NacreError(
            f'observer "{name}" is not known.{did_you_mean(str(name), OBSERVERS)} Choose from {", ".join(OBSERVERS)}'
        )
    return _tables()[f"observer {name}"]


WAVELENGTH_RANGE_NM = (360.0, 830.0)
# all of these divide 470 nm, so both ends are always on the grid
STEPS_NM = (10.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01)
REFERENCE_NM = 550.0


def colour_step_nm(optical_thickness_nm: float = 0.0, finesse: float = 1.0) -> float:
    """Return the wavelength step at which a stack's colour is within 0.5 dE00 of a 1 nm or finer grid.

    Film fringes repeat every lambda^2 / (2 n d). The step samples each fringe 20 times at 550 nm, or 40 times if high
    finesse sharpens it.

    Args:
        optical_thickness_nm: sum of n d over the interfering layers.
        finesse: fringe spacing over fringe width; 1 for a plain film, above 2 for metal cavities and mirrors.

    Raises:
        NacreError: a negative or non-finite thickness, or one that needs a step below 0.01 nm.

    Example:
        >>> colour_step_nm(1.33 * 300), colour_step_nm(1.5 * 2000)  # a soap film, 2 um of glass
        (10.0, 2.0)
    """
    thickness, sharpness = float(optical_thickness_nm), float(finesse)
    if not (np.isfinite(thickness) and thickness >= 0.0 and np.isfinite(sharpness) and sharpness >= 0.0):
        raise NacreError(
            f"optical_thickness_nm and finesse must be finite and not negative; got {thickness:g} and {sharpness:g}"
        )
    if thickness == 0.0:
        return STEPS_NM[0]
    needed = REFERENCE_NM**2 / (40.0 * thickness) / (2.0 if sharpness > 2.0 else 1.0)
    for step in STEPS_NM:
        if step <= needed:
            return step
    raise NacreError(
        f"an optical thickness of {thickness / 1e6:g} mm needs a wavelength step of {needed:.2g} nm; "
        f"layers thicker than about {REFERENCE_NM**2 / 40 / STEPS_NM[-1] / 1e6:.1f} mm should be incoherent"
    )


def default_wavelengths(optical_thickness_nm: float = 0.0, finesse: float = 1.0, step_nm: float | None = None) -> Array:
    """Return ascending wavelengths from 360 to 830 nm, both included, with a given step or that of `colour_step_nm`.

    Raises:
        NacreError: an unusable thickness, or a step outside (0, 10].

    Example:
        >>> default_wavelengths().size, default_wavelengths(3000).size
        (48, 236)
    """
    low, high = WAVELENGTH_RANGE_NM
    step = colour_step_nm(optical_thickness_nm, finesse) if step_nm is None else float(step_nm)
    if not 0.001 <= step <= 10.0:
        raise NacreError(f"step_nm = {step:g} is not allowed; it should be from 0.001 to 10")
    return np.linspace(low, high, int(np.ceil((high - low) / step - 1e-9)) + 1)


# Beyond 400-700 nm less than 1 % of any tristimulus value of a white remains: constant continuation is safe there.
NEEDED_RANGE_NM = (400.0, 700.0)
GRID_TOLERANCE_NM = 1e-9
MOST_NODES = 1000  # spline nodes; denser samples are fine enough for linear interpolation
FINE_STEP_NM = 1.0
LINE_PROMINENCE = 1.2
LINE_FLANK_NM = 3.0  # half width of a lamp line, a triangle in tables with a 5 nm step


def check_wavelengths(wavelengths_nm: ArrayLike) -> Array:
    """Return the wavelengths as a checked array.

    Raises:
        NacreError: the wavelengths are not ascending, finite and positive, or do not span 400-700 nm.
    """
    wavelengths = np.asarray(wavelengths_nm, dtype=float)
    if wavelengths.ndim != 1 or len(wavelengths) < 2 or not np.isfinite(wavelengths).all():
        raise NacreError(f"wavelengths_nm must be a list of at least 2 finite numbers; got shape {wavelengths.shape}")
    if not (np.diff(wavelengths) > 0).all():
        raise NacreError("wavelengths_nm must ascend")
    low, high = NEEDED_RANGE_NM
    if wavelengths[0] > low or wavelengths[-1] < high:
        raise NacreError(
            f"a colour needs samples over {low:g}-{high:g} nm at least; got {wavelengths[0]:g}-{wavelengths[-1]:g} nm"
        )
    return wavelengths


def spans_colour(wavelengths_nm: ArrayLike) -> bool:
    """Whether samples span 400-700 nm, as a colour computation requires."""
    wavelengths = np.asarray(wavelengths_nm, dtype=float)
    return len(wavelengths) > 1 and wavelengths[0] <= NEEDED_RANGE_NM[0] and wavelengths[-1] >= NEEDED_RANGE_NM[1]


def _quadrature(wavelengths: Array) -> tuple[Array, Array]:
    """Return quadrature nodes and widths: the table's own 1 nm points, and the samples too if they are finer.

    Samples 1 nm apart or wider add no nodes, so the sum equals the CIE's 1 nm summation. Finer samples (thick films)
    become nodes of a trapezoidal rule.
    """
    table = table_wavelengths_nm()
    if np.diff(wavelengths).min() >= 1.0 - GRID_TOLERANCE_NM:
        return table, np.ones_like(table)
    inside = wavelengths[(wavelengths > table[0]) & (wavelengths < table[-1])]
    nodes = np.union1d(table, inside)
    gaps = np.diff(nodes)
    # half a nanometre beyond each end, as in the 1 nm summation
    widths = 0.5 * (np.concatenate([[1.0], gaps]) + np.concatenate([gaps, [1.0]]))
    return nodes, widths


def lamp_lines_nm(light: str | Illuminant) -> Array:
    """Return the wavelengths of a lamp's narrow lines: daylight has none, F11 six to eight.

    A line is a local maximum above `LINE_PROMINENCE` times the mean over the surrounding 40 nm.

    Example:
        >>> lamp_lines_nm("F2").tolist()  # mercury
        [405.0, 435.0, 545.0]
    """
    lamp = illuminant(light)
    table = table_wavelengths_nm()
    power = lamp.at(table)
    about = np.convolve(np.pad(power, 20, mode="edge"), np.ones(41) / 41.0, "valid")
    inner = slice(1, -1)
    peaks = (power[inner] >= power[:-2]) & (power[inner] > power[2:]) & (power[inner] > LINE_PROMINENCE * about[inner])
    return np.asarray(table[inner][peaks])


def with_lamp_lines(wavelengths_nm: ArrayLike, light: str | Illuminant) -> Array:
    """Return a grid that also samples a narrow-band lamp's lines and both flanks, within the grid's ends.

    Daylight averages over the interpolation error of samples 10 nm apart; a line lamp does not. Films with an error
    of 0.2 dE00 under D65 have 0.61 dE00 under F11, and 0.31 with the lines' flanks added.
    """
    wavelengths = np.asarray(wavelengths_nm, dtype=float)
    lines = lamp_lines_nm(light)
    flanks = (lines[:, None] + np.array([-LINE_FLANK_NM, LINE_FLANK_NM])).ravel()
    every = np.union1d(wavelengths, np.concatenate([lines, flanks]))
    return np.asarray(every[(every >= wavelengths[0]) & (every <= wavelengths[-1])])


def _interpolation_sum(nodes: Array, weights: Array, wavelengths: Array) -> Array:
    """Distribute weights `[node, 3]` over the samples: the transpose of linear interpolation with constant ends."""
    right = np.clip(np.searchsorted(wavelengths, nodes, side="right"), 1, len(wavelengths) - 1)
    left = right - 1
    share = np.clip((nodes - wavelengths[left]) / (wavelengths[right] - wavelengths[left]), 0.0, 1.0)
    spread = np.zeros((len(wavelengths), weights.shape[1]))
    np.add.at(spread, left, weights * (1.0 - share)[:, None])
    np.add.at(spread, right, weights * share[:, None])
    return spread


@functools.lru_cache(maxsize=64)
def _cached_weights(samples: bytes, name: str, observer_name: str, is_smooth: bool = False) -> Array:
    compute = _spline_sum if is_smooth else _weights
    weights = compute(np.frombuffer(samples), illuminant(name), observer_name)
    weights.setflags(write=False)  # shared by every caller
    return weights


def _spline_sum(wavelengths: Array, light: Illuminant, observer_name: str) -> Array:
    steps = int(np.ceil((wavelengths[-1] - wavelengths[0]) / FINE_STEP_NM))
    fine = np.linspace(wavelengths[0], wavelengths[-1], steps + 1)
    return np.asarray(spline_matrix(wavelengths, fine).T @ _weights(fine, light, observer_name))


def _weights(wavelengths: Array, light: Illuminant, observer_name: str) -> Array:
    nodes, widths = _quadrature(wavelengths)
    functions = observer(observer_name)
    table = table_wavelengths_nm()
    matching = np.stack([np.interp(nodes, table, functions[:, i]) for i in range(3)], axis=-1)
    density = (light.at(nodes) * widths)[:, None] * matching
    return _interpolation_sum(nodes, density / density[:, 1].sum(), wavelengths)


def xyz_weights(wavelengths_nm: ArrayLike, illuminant: str | Illuminant = "D65", observer: str = "2deg") -> Array:
    """Return `[wavelength, 3]` weights with `xyz = values @ weights`; Y is 1 for a perfect white.

    Integrates the linearly interpolated samples against the 1 nm products of illuminant and colour matching functions
    over 360-830 nm. With samples 1 nm apart this is the CIE's own summation. Samples beyond 360-830 nm have zero
    weight; if the samples end earlier, the end value continues (CIE 15:2018, 7.2.3).

    Args:
        wavelengths_nm: `[wavelength]`, ascending, any spacing, spanning 400-700 nm at least.
        illuminant: a name in `nacre.light.ILLUMINANTS` or an `Illuminant`.
        observer: "2deg" or "10deg".

    Raises:
        NacreError: unusable wavelengths, unknown illuminant or observer.

    Example:
        >>> xyz_weights(np.arange(380, 781, 5)).sum(axis=0).round(4).tolist()  # the white of D65
        [0.9505, 1.0, 1.0888]
    """
    wavelengths = check_wavelengths(wavelengths_nm)
    if isinstance(illuminant, Illuminant):
        return _weights(wavelengths, illuminant, observer)
    return _cached_weights(np.ascontiguousarray(wavelengths).tobytes(), illuminant, observer)


def smooth_weights(wavelengths_nm: ArrayLike, illuminant: str, observer: str) -> Array:
    """Return `[wavelength, 3]` weights for the XYZ of spectra that are cubic splines between their samples.

    With the linear interpolation of `xyz_weights`, micrometre-thick films need steps of a few nanometres. The spline
    reaches the same 1 nm sum and reduces the error of 10 nm steps by a factor of 100, for smooth, computed spectra.
    Grids of 1 nm and finer, or with more than 1,000 samples, use `xyz_weights`.

    Raises:
        NacreError: as `xyz_weights`.
    """
    grid = check_wavelengths(wavelengths_nm)
    if not 4 <= len(grid) <= MOST_NODES or np.diff(grid).max() <= FINE_STEP_NM:
        return np.array(xyz_weights(grid, illuminant, observer))
    return _cached_weights(np.ascontiguousarray(grid).tobytes(), illuminant, observer, True)


def white_xyz(illuminant: str | Illuminant = "D65", observer: str = "2deg") -> Array:
    """Return a perfect white's tristimulus values `[3]` under an illuminant, with Y = 1.

    Example:
        >>> white_xyz("A").round(4).tolist()
        [1.0985, 1.0, 0.3559]
    """
    return xyz_weights(table_wavelengths_nm(), illuminant, observer).sum(axis=0)


def spectrum_to_xyz(
    values: ArrayLike, wavelengths_nm: ArrayLike, illuminant: str | Illuminant = "D65", observer: str = "2deg"
) -> Array:
    """Return the tristimulus values `[..., 3]` for reflectances or transmittances `[..., wavelength]`.

    Y is 1 for a perfect white. A radiance already contains its light's spectrum: use illuminant "E" for it.
    Linear in `values`; `xyz_weights` describes the integration.

    Raises:
        NacreError: unusable wavelengths, unknown illuminant or observer, or different lengths.

    Example:
        >>> spectrum_to_xyz(np.full(81, 0.5), np.arange(380.0, 781.0, 5.0)).round(4).tolist()
        [0.4752, 0.5, 0.5444]
    """
    return weighted_sum(values, xyz_weights(wavelengths_nm, illuminant, observer))


def weighted_sum(values: ArrayLike, matrix: Array) -> Array:
    """Return `values @ matrix`, spectra `[..., wavelength]` by weights `[wavelength, 3]`.

    Raises:
        NacreError: the last axis of the values is not the wavelength.
    """
    spectra = np.asarray(values, dtype=float)
    if spectra.ndim == 0 or spectra.shape[-1] != len(matrix):
        raise NacreError(
            f"the last axis of values must be the wavelength: {len(matrix)} samples, got shape {spectra.shape}"
        )
    return spectra @ matrix


def spline_matrix(nodes: Array, points: Array) -> Array:
    """Return the matrix `[point, node]` of natural cubic spline interpolation, for points between the nodes."""
    count = len(nodes)
    h = np.diff(nodes)
    second = np.zeros((count, count))  # left side of the equations for the second derivatives
    rhs = np.zeros((count, count))
    second[0, 0] = second[-1, -1] = 1.0
    for i in range(1, count - 1):
        second[i, i - 1], second[i, i], second[i, i + 1] = h[i - 1] / 6.0, (h[i - 1] + h[i]) / 3.0, h[i] / 6.0
        rhs[i, i - 1], rhs[i, i], rhs[i, i + 1] = 1.0 / h[i - 1], -1.0 / h[i - 1] - 1.0 / h[i], 1.0 / h[i]
    curvature = np.linalg.solve(second, rhs)
    left = np.clip(np.searchsorted(nodes, points, side="right") - 1, 0, count - 2)
    b = (points - nodes[left]) / h[left]
    a = 1.0 - b
    square = (h[left] ** 2 / 6.0)[:, None]
    matrix = ((a**3 - a)[:, None] * curvature[left] + (b**3 - b)[:, None] * curvature[left + 1]) * square
    rows = np.arange(len(points))
    matrix[rows, left] += a
    matrix[rows, left + 1] += b
    return matrix
