"""Merit function: distance of spectra from colour and spectral targets.

The spectra of a candidate are rows (a direction, in reflection or transmission) on one grid of wavelengths; 1 is white.
`distances` evaluates, `objective` ranks, and `residuals` are for least squares. An operand under one lamp is a term;
colours under several lamps have a term for each, in the order of `MeritFunction.terms`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.light import delta_e_2000, delta_e_2000_components, lab_to_lch, lch_to_lab, smooth_weights, xyz_to_lab

Kind = Literal["colour", "hue", "chroma", "lightness", "spectrum", "texture"]

KINDS: tuple[Kind, ...] = ("colour", "hue", "chroma", "lightness", "spectrum")  # in the compiled merit function
SINGLE: tuple[Kind, ...] = ("spectrum", "texture")  # without a lamp
MEAN_SHARE = 1e-3  # weight of the mean in the objective: it decides between equal worst distances
GRID_POINTS, GRID_ROUNDS = 17, 5  # search for the nearest colour within ranges


def default_wavelengths_nm() -> Array:
    """Return 380, 382, ... 780 nm: 201 samples.

    Coatings of two micrometres and high finesse are off by up to dE00 0.5 with steps of 5 nm, even with splines, and by
    0.01 with 2 nm. A search may use fewer, see `MeritFunction.on`.
    """
    return np.linspace(380.0, 780.0, 201)


@dataclass(frozen=True, eq=False)
class Operand:
    """Target for one property of one spectrum.

    Attributes:
        row: spectrum index.
        kind: property.
        lab: colour target, CIELAB under every lamp, each against its own white (kind "colour").
        xyz: colour target under the first lamp, Y = 1 for white, rather than `lab`.
        low, high: ends of a range, or of a number of texture; None if open. A hue needs both, in degrees, and runs
            upward from the first to the second, possibly through 0; 360 degrees or more allow every hue.
        reflectance: target spectrum on the wavelengths of the merit function (kind "spectrum"); NaN if unspecified.
        tolerance: allowed distance: dE00, the rms in per cent for a spectrum, per cent of the end for texture.
        weight: 0 ignores the operand.
    """

    row: int
    kind: Kind
    lab: tuple[float, float, float] | None = None
    xyz: tuple[float, float, float] | None = None
    low: float | None = None
    high: float | None = None
    reflectance: Array | None = None
    tolerance: float = 2.0
    weight: float = 1.0


class MeritFunction:
    """Merit function of candidate spectra.

    Args:
        operands: one or more.
        lamps: names of `nacre.light.ILLUMINANTS`; colours are targets under each of them.
        observer: "2deg" or "10deg".
        wavelengths_nm: spectral samples, ascending. Spectra are interpolated by a cubic spline: 16 to 40 samples give
            the same colour as 1 nm steps.

    Attributes:
        terms: `[(operand, lamp)]`, indices, in the order of `distances`. A spectrum, texture, and a colour given by
            XYZ have one term, under lamp 0.
        scale: `[term]`, weight / tolerance.
        colour_weights: `[lamp, wavelength, 3]`: XYZ are `spectra @ colour_weights[lamp]`.
        whites: `[lamp, 3]`, XYZ of R = 1.
        lab: `[term, 3]`, target colours (0 for other kinds).

    Raises:
        NacreError: no operands, an incomplete operand, an unknown lamp or observer, or wavelengths that do not span
            400-700 nm for colours.

    Example: `MeritFunction([Operand(0, "colour", lab=(50, 0, 0))]).distances(np.full((1, 201), 0.184))` is 0.02.
    """

    def __init__(
        self,
        operands: Sequence[Operand],
        lamps: Sequence[str] = ("D65",),
        observer: str = "10deg",
        wavelengths_nm: ArrayLike | None = None,
    ) -> None:
        self.operands = tuple(operands)
        self.lamps = tuple(lamps)
        self.observer = observer
        grid = default_wavelengths_nm() if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
        self.wavelengths_nm = grid
        if not self.operands or not self.lamps:
            raise NacreError("a design needs at least one target and one lamp")
        for operand in self.operands:
            _check(operand, len(grid))
        self.rows = 1 + max(operand.row for operand in self.operands)
        has_colour = any(operand.kind not in SINGLE for operand in self.operands)
        self.colour_weights = np.stack(
            [smooth_weights(grid, lamp, observer) if has_colour else np.zeros((len(grid), 3)) for lamp in self.lamps]
        )
        self.whites = self.colour_weights.sum(axis=1) if has_colour else np.ones((len(self.lamps), 3))
        self.terms = [
            (number, lamp)
            for number, operand in enumerate(self.operands)
            for lamp in range(1 if operand.kind in SINGLE or operand.xyz is not None else len(self.lamps))
        ]
        self.scale = np.array([self.operands[i].weight / self.operands[i].tolerance for i, _ in self.terms])
        self.lab = np.array([self._target_lab(self.operands[i], lamp) for i, lamp in self.terms])

    @property
    def residual_counts(self) -> list[int]:
        """Number of residuals of each term."""
        counts = {"colour": 3, "spectrum": len(self.wavelengths_nm)}
        return [counts.get(self.operands[index].kind, 1) for index, _ in self.terms]

    def _target_lab(self, operand: Operand, lamp: int) -> Array:
        if operand.xyz is not None:
            return xyz_to_lab(operand.xyz, self.whites[lamp])
        return np.zeros(3) if operand.lab is None else np.asarray(operand.lab, dtype=float)

    def on(self, samples: ArrayLike) -> MeritFunction:
        """Return the merit function on selected wavelengths, given by their indices."""
        chosen = np.asarray(samples)
        operands = [
            operand if operand.reflectance is None else replace(operand, reflectance=operand.reflectance[chosen])
            for operand in self.operands
        ]
        return MeritFunction(operands, self.lamps, self.observer, self.wavelengths_nm[chosen])

    def labs(self, spectra: ArrayLike) -> Array:
        """Return CIELAB `[..., row, lamp, 3]` of spectra `[..., row, wavelength]`, each against its lamp's white."""
        factors = np.asarray(spectra, dtype=float)
        return np.stack(
            [xyz_to_lab(factors @ weights, white) for weights, white in zip(self.colour_weights, self.whites)], axis=-2
        )

    def distances(self, spectra: ArrayLike) -> Array:
        """Return `[..., term]`: dE00, a spectrum rms in per cent, or the deviation of texture in per cent.

        For a range of hue, chroma or lightness it is the dE00 to the nearest colour inside, 0 if inside.

        Args:
            spectra: `[..., row, wavelength]`, 1 for white.
        """
        factors = np.asarray(spectra, dtype=float)
        labs = self.labs(factors)
        columns = [self._distance(factors, labs, number) for number in range(len(self.terms))]
        return np.stack(np.broadcast_arrays(*columns), axis=-1)

    def _distance(self, factors: Array, labs: Array, number: int) -> Array:
        index, lamp = self.terms[number]
        operand = self.operands[index]
        lab = labs[..., operand.row, lamp, :]
        if operand.kind == "colour":
            return delta_e_2000(lab, self.lab[number])
        if operand.kind == "spectrum":
            off = _spectrum_difference(operand, factors)
            return 100.0 * np.sqrt(np.mean(off * off, axis=-1))
        if operand.kind == "texture":
            return np.abs(texture_deviation(operand.low, operand.high, factors[..., operand.row, :].mean(axis=-1)))
        return _distance_to_range(operand, lab)

    def objective(self, d: ArrayLike) -> Array:
        """Return the largest weight x distance / tolerance, plus a thousandth of the mean; below 1 all targets are met.

        Args:
            d: distances `[..., term]`.
        """
        scaled = np.asarray(d, dtype=float) * self.scale
        return np.asarray(scaled.max(axis=-1) + MEAN_SHARE * scaled.mean(axis=-1))

    def residuals(self, spectra: ArrayLike) -> Array:
        """Return `[..., residual]`; their sum of squares is that of weight x distance / tolerance.

        Three for a colour under a lamp, with the length of its dE00; one for a range, which grows on far from the range
        even if the nearest colour is grey; one per wavelength for a spectrum.
        """
        factors = np.asarray(spectra, dtype=float)
        labs = self.labs(factors)
        parts = []
        for number, (index, lamp) in enumerate(self.terms):
            operand, scale = self.operands[index], self.scale[number]
            lab = labs[..., operand.row, lamp, :]
            if operand.kind == "spectrum":
                off = _spectrum_difference(operand, factors)
                parts.append(scale * 100.0 / np.sqrt(off.shape[-1]) * off)
            elif operand.kind == "texture":
                value = factors[..., operand.row, :].mean(axis=-1)
                parts.append(scale * texture_deviation(operand.low, operand.high, value)[..., None])
            elif operand.kind == "colour":
                parts.append(scale * delta_e_2000_components(self.lab[number], lab))
            else:
                parts.append(scale * _smooth_distance_to_range(operand, lab)[..., None])
        return np.concatenate(parts, axis=-1)


def _spectrum_difference(operand: Operand, factors: Array) -> Array:
    """Return the difference from a target spectrum, 0 if unspecified, scaled to the rms of the specified part."""
    wanted = np.asarray(operand.reflectance, dtype=float)
    is_specified = np.isfinite(wanted)
    off = np.where(is_specified, factors[..., operand.row, :] - np.where(is_specified, wanted, 0.0), 0.0)
    return np.asarray(off * np.sqrt(len(is_specified) / is_specified.sum()))


def texture_deviation(low: float | None, high: float | None, value: ArrayLike) -> Array:
    """Return by how many per cent of the nearer end numbers `[...]` leave a range; 0 inside."""
    numbers = np.asarray(value, dtype=float)
    above = np.zeros_like(numbers) if high is None else np.maximum(numbers - high, 0.0) / (high or 1.0)
    below = np.zeros_like(numbers) if low is None else np.minimum(numbers - low, 0.0) / (low or 1.0)
    return 100.0 * np.asarray(above + below)


def _check(operand: Operand, samples: int) -> None:
    """Raise a NacreError for an incomplete or contradictory operand."""
    kind, low, high = operand.kind, operand.low, operand.high
    if kind not in (kinds := get_args(Kind)):
        raise NacreError(f'a target of kind "{kind}" is not known; choose from {", ".join(kinds)}')
    if operand.row < 0 or not operand.tolerance > 0.0 or not operand.weight >= 0.0:
        values = f"{operand.row}, {operand.tolerance:g}, {operand.weight:g}"
        raise NacreError(f"a target needs row >= 0, tolerance > 0 and weight >= 0; got {values}")
    if kind == "colour" and (operand.lab is None) == (operand.xyz is None):
        raise NacreError("a target colour is either lab or xyz")
    if kind == "hue" and (low is None or high is None):
        raise NacreError("a target hue needs both ends of its range, in degrees")
    if kind in ("chroma", "lightness", "texture"):
        if low is None and high is None:
            raise NacreError(f"a target {kind} needs a lower or an upper bound")
        if low is not None and high is not None and low > high:
            raise NacreError(f"the bounds of a target {kind} cross: {low:g} and {high:g}")
    shape = () if operand.reflectance is None else operand.reflectance.shape
    if kind == "spectrum" and shape != (samples,):
        raise NacreError(f"a target spectrum needs {samples} values, one per wavelength; got shape {shape}")
    if operand.reflectance is not None and not np.isfinite(operand.reflectance).any():
        raise NacreError("a target spectrum has no value at the wavelengths of the merit function")


def _hue_excess(operand: Operand, hue_deg: Array) -> tuple[Array, Array]:
    """Return the degrees by which hues lie outside a range (0 inside, at most 180), and its nearer end."""
    assert operand.low is not None and operand.high is not None
    span = operand.high - operand.low
    width = 360.0 if span >= 360.0 else span % 360.0
    above = (hue_deg - operand.low) % 360.0
    over, under = above - width, 360.0 - above
    is_over = over <= under
    excess = np.where(above <= width, 0.0, np.where(is_over, over, under))
    return excess, np.where(is_over, operand.high, operand.low)


def _smooth_distance_to_range(operand: Operand, lab: Array) -> Array:
    """Return a distance to a range, `[...]`, that is smooth and has no local minima."""
    lightness, chroma, hue = np.moveaxis(lab_to_lch(lab), -1, 0)
    if operand.kind == "hue":
        excess, end = _hue_excess(operand, hue)
        # the difference in hue at the present chroma: otherwise greys would attract
        turned = lch_to_lab(np.stack([lightness, chroma, np.broadcast_to(end, chroma.shape)], axis=-1))
        return np.where(excess > 0.0, np.linalg.norm(delta_e_2000_components(turned, lab), axis=-1), 0.0)
    is_chroma = operand.kind == "chroma"
    value = chroma if is_chroma else lightness
    clipped = np.clip(value, operand.low, operand.high)
    near = np.stack([lightness, clipped, hue] if is_chroma else [clipped, chroma, hue], axis=-1)
    return np.where(clipped == value, 0.0, delta_e_2000(lch_to_lab(near), lab))


def _distance_to_range(operand: Operand, lab: Array) -> Array:
    """Return the dE00 from colours `[..., 3]` to the nearest range colour."""
    lightness, chroma, hue = np.moveaxis(lab_to_lch(lab), -1, 0)
    if operand.kind == "lightness":
        clipped = np.clip(lightness, operand.low, operand.high)
        return delta_e_2000(np.concatenate([clipped[..., None], lab[..., 1:]], axis=-1), lab)

    def distance(chromas: Array, hues: Array) -> Array:
        lch = np.stack(np.broadcast_arrays(lightness[..., None], chromas, hues), axis=-1)
        return delta_e_2000(lch_to_lab(lch), lab[..., None, :])

    if operand.kind == "chroma":
        clipped = np.clip(chroma, operand.low, operand.high)
        window = np.full(chroma.shape, 40.0)
        least = _minimum(lambda offset: distance(clipped[..., None], hue[..., None] + offset), -window, window)
        return np.where(clipped == chroma, 0.0, least)
    assert operand.low is not None and operand.high is not None
    excess, _ = _hue_excess(operand, hue)
    zero = np.zeros(chroma.shape)
    ends = [
        _minimum(lambda other, end=end: distance(other, np.asarray(end)), zero, 1.5 * chroma)  # type: ignore[misc]
        for end in (operand.low, operand.high)
    ]
    return np.where(excess > 0.0, np.minimum(*ends), 0.0)


def _minimum(distance: Callable[[Array], Array], low: Array, high: Array) -> Array:
    """Return the minimum of a function over an interval each, by a grid that is refined around it."""
    share = np.linspace(0.0, 1.0, GRID_POINTS)
    best = np.full(low.shape, np.inf)
    for _ in range(GRID_ROUNDS):
        points = low[..., None] + (high - low)[..., None] * share
        values = distance(points)
        at = np.argmin(values, axis=-1)[..., None]
        best = np.minimum(best, np.take_along_axis(values, at, axis=-1)[..., 0])
        centre = np.take_along_axis(points, at, axis=-1)[..., 0]
        half = (high - low) / (GRID_POINTS - 1)
        low, high = np.maximum(low, centre - half), np.minimum(high, centre + half)
    return best
