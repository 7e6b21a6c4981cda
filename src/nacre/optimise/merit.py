"""Merit function: distance of spectra from colour and spectral targets, with its Jacobian.

`MeritFunction` ranks candidates for every search. It knows only spectra and colours: the
spectra of a candidate come as rows (a direction, or a way through the sample), each on one grid of wavelengths, and
1 is white. `distances` judges, `objective` ranks, `residuals` and `residual_jacobian` are for Levenberg-Marquardt.

An operand under a lamp is a term. Colours under several lamps have a term for each; `MeritFunction.terms` lists
them in the order in which `distances` does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.light import delta_e_2000, lab_to_lch, lch_to_lab, smooth_weights, xyz_to_lab

Kind = Literal["colour", "hue", "chroma", "lightness", "spectrum"]

KINDS: tuple[Kind, ...] = ("colour", "hue", "chroma", "lightness", "spectrum")
MEAN_SHARE = 1e-3  # of the mean in the objective: it decides only between equal worst distances
STEP_LAB = 1e-4  # of the differences that differentiate residuals by Lab; their rounding is 1e-10
NEAREST_POINTS = 17  # the nearest colour of a range is looked for on as many points, four times finer and finer
NEAREST_ROUNDS = 5


def default_wavelengths_nm() -> Array:
    """Return 380, 382, ... 780 nm: 201 samples.

    Coatings of two micrometres of high finesse are off by up to 0.5 dE00 on 5 nm, even between splines, and by 0.01 on
    2 nm. A search need not use them all: see `MeritFunction.on`.
    """
    return np.linspace(380.0, 780.0, 201)


@dataclass(frozen=True, eq=False)
class Operand:
    """One wanted property of one measured spectrum.

    Attributes:
        row: which spectrum it looks at.
        kind: what is wanted of it.
        lab: the wanted colour, CIELAB under every lamp, each against its own white (kind "colour").
        xyz: the wanted colour under the first lamp only, Y = 1 for white, instead of `lab`.
        low, high: the ends of a range; None where it is open. A hue needs both, in degrees, and runs upward from the
            first to the second, through 0 if need be; 360 degrees or more ask for nothing.
        reflectance: target spectrum on the wavelengths of the function (kind "spectrum"); NaN if not specified.
        tolerance: distance that is good enough: dE00, or the rms in per cent for a spectrum.
        weight: how much the goal counts; 0 leaves it out.
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
    """What is wanted of the spectra of a candidate.

    Args:
        operands: one or more.
        lamps: names of `nacre.light.ILLUMINANTS`; colours are wanted under all of them.
        observer: "2deg" or "10deg".
        wavelengths_nm: of the spectra, ascending. Between them a spectrum is a cubic spline, so that 16 to 40
            samples give the colour that the same spectrum has in steps of 1 nm.

    Attributes:
        terms: `[(goal, lamp)]`, numbers of each, in the order of `distances`. A spectrum, and a colour given by XYZ,
            have one term, under lamp 0.
        scale: `[term]`, weight / within.
        colour_weights: `[lamp, wavelength, 3]`: XYZ are `spectra @ colour_weights[lamp]`.
        whites: `[lamp, 3]`, XYZ of R = 1.
        lab: `[term, 3]`, the wanted colours (0 for other kinds).

    Raises:
        NacreError: no goals, a goal that lacks what its kind needs, an unknown lamp or observer, wavelengths that do
            not span 400-700 nm where a colour is wanted.

    Example: `MeritFunction([Goal(0, "colour", lab=(50, 0, 0))]).distances(np.full((1, 201), 0.184))` is 0.02.
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
            raise NacreError("a design needs at least one want and one lamp")
        for goal in self.operands:
            _check(goal, len(grid))
        self.rows = 1 + max(goal.row for goal in self.operands)
        has_colour = any(goal.kind != "spectrum" for goal in self.operands)
        self.colour_weights = np.stack(
            [smooth_weights(grid, lamp, observer) if has_colour else np.zeros((len(grid), 3)) for lamp in self.lamps]
        )
        self.whites = self.colour_weights.sum(axis=1) if has_colour else np.ones((len(self.lamps), 3))
        self.terms = [
            (number, lamp)
            for number, goal in enumerate(self.operands)
            for lamp in range(1 if goal.kind == "spectrum" or goal.xyz is not None else len(self.lamps))
        ]
        self.scale = np.array([self.operands[g].weight / self.operands[g].tolerance for g, _ in self.terms])
        self.lab = np.array([self._wanted(self.operands[g], lamp) for g, lamp in self.terms])

    @property
    def residual_counts(self) -> list[int]:
        """Number of residuals of each term."""
        counts = {"colour": 3, "spectrum": len(self.wavelengths_nm)}
        return [counts.get(self.operands[index].kind, 1) for index, _ in self.terms]

    def _wanted(self, goal: Operand, lamp: int) -> Array:
        if goal.xyz is not None:
            return xyz_to_lab(goal.xyz, self.whites[lamp])
        return np.zeros(3) if goal.lab is None else np.asarray(goal.lab, dtype=float)

    def on(self, samples: ArrayLike) -> MeritFunction:
        """Return the same goals on some of the wavelengths, given by their numbers: a cheaper, coarser judge."""
        chosen = np.asarray(samples)
        fewer = []
        for goal in self.operands:
            values = {name: getattr(goal, name) for name in goal.__dataclass_fields__}
            if goal.reflectance is not None:
                values["reflectance"] = goal.reflectance[chosen]
            fewer.append(Operand(**values))
        return MeritFunction(fewer, self.lamps, self.observer, self.wavelengths_nm[chosen])

    def labs(self, spectra: ArrayLike) -> Array:
        """Return CIELAB `[..., row, lamp, 3]` of spectra `[..., row, wavelength]`, each against its lamp's white."""
        seen = np.asarray(spectra, dtype=float)
        return np.stack(
            [xyz_to_lab(seen @ weights, white) for weights, white in zip(self.colour_weights, self.whites)], axis=-2
        )

    def distances(self, spectra: ArrayLike) -> Array:
        """Return `[..., term]`: the dE00 of each goal under each lamp, the rms in per cent for a spectrum.

        For a range of hue, chroma or lightness it is the dE00 to the nearest colour inside, 0 for one that is inside.

        Args:
            spectra: `[..., row, wavelength]`, 1 for white.
        """
        seen = np.asarray(spectra, dtype=float)
        labs = self.labs(seen)
        found = [self._distance(seen, labs, number) for number in range(len(self.terms))]
        return np.stack(np.broadcast_arrays(*found), axis=-1)

    def _distance(self, seen: Array, labs: Array, number: int) -> Array:
        index, lamp = self.terms[number]
        goal = self.operands[index]
        lab = labs[..., goal.row, lamp, :]
        if goal.kind == "colour":
            return delta_e_2000(lab, self.lab[number])
        if goal.kind == "spectrum":
            off = _off(goal, seen)
            return 100.0 * np.sqrt(np.mean(off * off, axis=-1))
        return _to_range(goal, lab)

    def objective(self, d: ArrayLike) -> Array:
        """Return one number a candidate from distances `[..., term]`; smaller is better, below 1 all wants are met.

        It is the worst of weight x d / within, and a thousandth of their mean.
        """
        scaled = np.asarray(d, dtype=float) * self.scale
        return np.asarray(scaled.max(axis=-1) + MEAN_SHARE * scaled.mean(axis=-1))

    def residuals(self, spectra: ArrayLike) -> Array:
        """Return `[..., residual]`, all zero where all is met; the sum of squares is that of weight x d / within.

        Three for a colour under a lamp, with the length of its dE00; one for a range, which is its dE00 near the
        range and further off grows on where the nearest colour would be a grey; one a wavelength for a spectrum.
        """
        seen = np.asarray(spectra, dtype=float)
        labs = self.labs(seen)
        parts = []
        for number, (index, lamp) in enumerate(self.terms):
            goal, scale = self.operands[index], self.scale[number]
            if goal.kind == "spectrum":
                off = _off(goal, seen)
                parts.append(scale * 100.0 / np.sqrt(off.shape[-1]) * off)
            else:
                parts.append(scale * self._of_lab(number, labs[..., goal.row, lamp, :]))
        return np.concatenate(parts, axis=-1)

    def residual_jacobian(self, spectra: ArrayLike) -> Array:
        """Return d residual / d spectrum, `[..., residual, row, wavelength]`, for spectra `[..., row, wavelength]`."""
        seen = np.asarray(spectra, dtype=float)
        labs = self.labs(seen)
        samples = seen.shape[-1]
        parts = []
        for number, (index, lamp) in enumerate(self.terms):
            goal, scale = self.operands[index], self.scale[number]
            if goal.kind == "spectrum":
                known = np.isfinite(np.asarray(goal.reflectance, dtype=float))
                own = np.broadcast_to(
                    scale * 100.0 / np.sqrt(known.sum()) * np.diag(known.astype(float)),
                    (*seen.shape[:-2], samples, samples),
                )
            else:
                lab = labs[..., goal.row, lamp, :]
                by_lab = self._by_lab(number, lab)
                xyz = seen[..., goal.row, :] @ self.colour_weights[lamp]
                own = scale * by_lab @ lab_slopes(xyz, self.whites[lamp]) @ self.colour_weights[lamp].T
            part = np.zeros((*own.shape[:-1], self.rows, samples))
            part[..., goal.row, :] = own
            parts.append(part)
        return np.concatenate(parts, axis=-3)

    def _of_lab(self, number: int, lab: Array) -> Array:
        goal = self.operands[self.terms[number][0]]
        if goal.kind == "colour":
            return difference_components(self.lab[number], lab)
        return _smooth_violation(goal, lab)[..., None]

    def _by_lab(self, number: int, lab: Array) -> Array:
        """Return d (unscaled residual) / d Lab, `[..., residual, 3]`, by central differences."""
        moved = [
            (self._of_lab(number, lab + step) - self._of_lab(number, lab - step)) / (2.0 * STEP_LAB)
            for step in STEP_LAB * np.eye(3)
        ]
        return np.stack(moved, axis=-1)


def lab_slopes(xyz: ArrayLike, white: ArrayLike) -> Array:
    """Return d Lab / d XYZ, `[..., 3, 3]`, of XYZ `[..., 3]` against a white `[3]`."""
    ratio = np.asarray(xyz, dtype=float) / np.asarray(white, dtype=float)
    is_light = ratio > 216 / 24389
    slope = np.where(is_light, np.where(is_light, ratio, 1.0) ** (-2.0 / 3.0) / 3.0, 24389 / 27 / 116.0)
    f = slope / np.asarray(white, dtype=float)
    mix = np.array([[0.0, 116.0, 0.0], [500.0, -500.0, 0.0], [0.0, 200.0, -200.0]])
    return mix * f[..., None, :]


def difference_components(wanted: ArrayLike, lab: ArrayLike) -> Array:
    """Return three numbers `[..., 3]` whose length is the dE00 of two colours: lightness, chroma and hue parts.

    CIEDE2000 is x^2 + y^2 + z^2 + R y z; with y' = y + R z / 2 and z' = z sqrt(1 - R^2 / 4) it is a sum of squares.
    Signed, and smooth but for the formula's own jumps (hues 180 degrees apart) and its corner at two greys.
    """
    base, other = np.broadcast_arrays(np.asarray(wanted, dtype=float), np.asarray(lab, dtype=float))
    c1, c2 = np.hypot(base[..., 1], base[..., 2]), np.hypot(other[..., 1], other[..., 2])
    mean7 = (0.5 * (c1 + c2)) ** 7
    stretch = 1.5 - 0.5 * np.sqrt(mean7 / (mean7 + 25.0**7))
    a1, a2, b1, b2 = stretch * base[..., 1], stretch * other[..., 1], base[..., 2], other[..., 2]
    c1, c2 = np.hypot(a1, b1), np.hypot(a2, b2)
    h1, h2 = np.degrees(np.arctan2(b1, a1)), np.degrees(np.arctan2(b2, a2))
    turn = (h2 - h1 + 180.0) % 360.0 - 180.0
    turn = np.where(c1 * c2 == 0.0, 0.0, turn)
    hue = np.where(c1 == 0.0, h2, h1 + 0.5 * turn)
    chroma, lightness = 0.5 * (c1 + c2), 0.5 * (base[..., 0] + other[..., 0])
    weight = (
        1.0
        - 0.17 * np.cos(np.radians(hue - 30.0))
        + 0.24 * np.cos(np.radians(2.0 * hue))
        + 0.32 * np.cos(np.radians(3.0 * hue + 6.0))
        - 0.20 * np.cos(np.radians(4.0 * hue - 63.0))
    )
    x = (other[..., 0] - base[..., 0]) / (1.0 + 0.015 * (lightness - 50.0) ** 2 / np.hypot(20.0**0.5, lightness - 50.0))
    y = (c2 - c1) / (1.0 + 0.045 * chroma)
    z = 2.0 * np.sqrt(c1 * c2) * np.sin(np.radians(0.5 * turn)) / (1.0 + 0.015 * chroma * weight)
    rotation = 60.0 * np.exp(-(((hue % 360.0 - 275.0) / 25.0) ** 2))
    blue = -2.0 * np.sqrt(chroma**7 / (chroma**7 + 25.0**7)) * np.sin(np.radians(rotation))
    return np.stack([x, y + 0.5 * blue * z, z * np.sqrt(1.0 - 0.25 * blue * blue)], axis=-1)


def _off(goal: Operand, seen: Array) -> Array:
    """Return what spectra are off from a wanted one, 0 where nothing is wanted; their rms is that of the rest."""
    wanted = np.asarray(goal.reflectance, dtype=float)
    known = np.isfinite(wanted)
    off = np.where(known, seen[..., goal.row, :] - np.where(known, wanted, 0.0), 0.0)
    return np.asarray(off * np.sqrt(len(known) / known.sum()))


def _check(goal: Operand, samples: int) -> None:
    """Raise a NacreError for a goal that does not hold together."""
    if goal.kind not in KINDS:
        raise NacreError(f'a want of the kind "{goal.kind}" is not known; choose from {", ".join(KINDS)}')
    if goal.row < 0 or not goal.tolerance > 0.0 or not goal.weight >= 0.0:
        raise NacreError(
            f"a want needs row >= 0, within > 0 and weight >= 0; got {goal.row}, {goal.tolerance:g}, {goal.weight:g}"
        )
    if goal.kind == "colour" and (goal.lab is None) == (goal.xyz is None):
        raise NacreError("a wanted colour is either lab or xyz")
    if goal.kind == "hue" and (goal.low is None or goal.high is None):
        raise NacreError("a wanted hue needs both ends of its range, in degrees")
    if goal.kind in ("chroma", "lightness"):
        if goal.low is None and goal.high is None:
            raise NacreError(f"a wanted {goal.kind} needs a lower or an upper bound")
        if goal.low is not None and goal.high is not None and goal.low > goal.high:
            raise NacreError(f"the bounds of a wanted {goal.kind} cross: {goal.low:g} and {goal.high:g}")
    shape = () if goal.reflectance is None else goal.reflectance.shape
    if goal.kind == "spectrum" and shape != (samples,):
        raise NacreError(f"a wanted spectrum needs {samples} values, one a wavelength; got shape {shape}")
    if goal.reflectance is not None and not np.isfinite(goal.reflectance).any():
        raise NacreError("a wanted spectrum says nothing about the wavelengths that are looked at")


def hue_excess(low_deg: float, high_deg: float, hue_deg: Array) -> tuple[Array, Array]:
    """Return how far hues lie outside a range, in degrees (0 inside, 180 at most), and the nearer end of it."""
    width = min(high_deg - low_deg if high_deg - low_deg >= 360.0 else (high_deg - low_deg) % 360.0, 360.0)
    above = (hue_deg - low_deg) % 360.0
    over, under = above - width, 360.0 - above
    is_inside = above <= width
    is_over = over <= under
    return np.where(is_inside, 0.0, np.where(is_over, over, under)), np.where(is_over, high_deg, low_deg)


def _smooth_violation(goal: Operand, lab: Array) -> Array:
    """Return a distance to a range, `[...]`, cheap and without the dead ends of the true one."""
    lightness, chroma, hue = np.moveaxis(lab_to_lch(lab), -1, 0)
    if goal.kind == "hue":
        assert goal.low is not None and goal.high is not None
        excess, end = hue_excess(goal.low, goal.high, hue)
        # as far round as the hues are apart, at the chroma that is there: a grey has no way out otherwise
        bent = lch_to_lab(np.stack([lightness, chroma, np.broadcast_to(end, chroma.shape)], axis=-1))
        parts = difference_components(bent, lab)
        return np.where(excess > 0.0, np.linalg.norm(parts, axis=-1), 0.0)
    value, others = (chroma, (lightness, hue)) if goal.kind == "chroma" else (lightness, (chroma, hue))
    held = np.clip(value, goal.low, goal.high)
    near = np.stack([others[0], held, others[1]] if goal.kind == "chroma" else [held, *others], axis=-1)
    return np.where(held == value, 0.0, delta_e_2000(lch_to_lab(near), lab))


def _to_range(goal: Operand, lab: Array) -> Array:
    """Return the dE00 from colours `[..., 3]` to the nearest colour of a range."""
    lightness, chroma, hue = np.moveaxis(lab_to_lch(lab), -1, 0)
    if goal.kind == "lightness":
        held = np.clip(lightness, goal.low, goal.high)
        return delta_e_2000(np.concatenate([held[..., None], lab[..., 1:]], axis=-1), lab)
    if goal.kind == "chroma":
        held = np.clip(chroma, goal.low, goal.high)

        def turned(offset: Array) -> Array:
            shape = np.broadcast_shapes(offset.shape, held[..., None].shape)
            full = [np.broadcast_to(v, shape) for v in (lightness[..., None], held[..., None], hue[..., None] + offset)]
            return delta_e_2000(lch_to_lab(np.stack(full, axis=-1)), lab[..., None, :])

        nearest = _least(turned, np.full(chroma.shape, -40.0), np.full(chroma.shape, 40.0))
        return np.where(held == chroma, 0.0, nearest)
    assert goal.low is not None and goal.high is not None
    excess, _ = hue_excess(goal.low, goal.high, hue)
    ends = []
    for end in (goal.low, goal.high):

        def along(other: Array, end: float = end) -> Array:
            full = np.broadcast_arrays(lightness[..., None], other, np.full(other.shape, end))
            return delta_e_2000(lch_to_lab(np.stack(full, axis=-1)), lab[..., None, :])

        ends.append(_least(along, np.zeros(chroma.shape), 1.5 * chroma))
    return np.where(excess > 0.0, np.minimum(*ends), 0.0)


def _least(distance: object, low: Array, high: Array) -> Array:
    """Return the least of a function over an interval each, on points that close in on it."""
    assert callable(distance)
    share = np.linspace(0.0, 1.0, NEAREST_POINTS)
    best = np.full(low.shape, np.inf)
    for _ in range(NEAREST_ROUNDS):
        points = low[..., None] + (high - low)[..., None] * share
        values = distance(points)
        at = np.argmin(values, axis=-1)[..., None]
        best = np.minimum(best, np.take_along_axis(values, at, axis=-1)[..., 0])
        centre = np.take_along_axis(points, at, axis=-1)[..., 0]
        half = (high - low) / (NEAREST_POINTS - 1)
        low, high = np.maximum(low, centre - half), np.minimum(high, centre + half)
    return best
