"""Texture of effect coatings: sparkle under a small lamp at 15, 45 and 75 degrees, and graininess under diffuse light.

Both follow from the recipe's flakes (size, slope, number, depth, layers above), by their statistics
(`nacre.measure.sparkle`) or from simulated camera images of drawn patches. The mean luminance comes from the
material's noise-free surrogate (doubling method) if its error is known, else from its Bsdf. Commercial instruments
map such quantities to scales that are not public: without measured pairs (`calibration`) the scale is relative.
`TextureQuantity` represents one number in a design or a fit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pydantic
from pydantic import Field

from nacre.bsdf import Bsdf
from nacre.core.arrays import Array, direction
from nacre.core.errors import NacreError, RecipeError, UnsupportedError, did_you_mean
from nacre.core.files import read_text
from nacre.families.contract import Mixed, Model, ResolvedFlakes, SingleFlakes, Surrogate, surrogate_radiance
from nacre.light import smooth_weights
from nacre.measure.evaluate import evaluate_with_error, hemispherical
from nacre.measure.geometry import Geometry
from nacre.measure.sparkle import (
    TILES,
    Area,
    DiffuseArea,
    Graininess,
    Pixels,
    Sparkle,
    graininess_patch,
    graininess_statistics,
    sparkle_patch,
    sparkle_statistics,
)
from nacre.recipe.model import RecipeContext, RecipeModel, show_value, validate
from nacre.recipe.toml import parse_toml

ANGLES_DEG = (15.0, 45.0, 75.0)
WAVELENGTHS_NM = np.arange(400.0, 701.0, 10.0)
SAMPLES = 1 << 16  # random walks for a mean luminance
HEMISPHERE_NODES = 160
SEARCH_NM = np.linspace(400.0, 700.0, 9)  # the luminance of a search is within 1e-3
HEMISPHERE_ORDER, SEARCH_ORDER = 16, 8  # Gauss nodes in sin theta, for a surrogate, which is isotropic
LEAST_PASSED = 1e-3  # transmittance of all flakes, below which the base is not seen
NORMAL = np.array([0.0, 0.0, 1.0])
METHODS = ("statistics", "patch")
QUANTITIES = ("sparkle", "intensity", "area", "graininess")
QUANTITY_NAMES = (*(f"{name}_{angle:g}" for name in QUANTITIES[:3] for angle in ANGLES_DEG), "graininess")
RELATIVE = "relative: not that of an instrument; give calibration = {...} with measured pairs"
CALIBRATED = "calibrated by measured pairs"

Fidelity = Literal["final", "search", "scout"]
Degrees = Annotated[float, Field(gt=0.0, le=20.0)]
Pair = tuple[float, float]


class Instrument(RecipeModel):
    """Lamp, camera and definition of sparkle; `calibration` maps this scale to that of an instrument.

    Keys of `calibration` are `sparkle`, `intensity`, `area` (at all angles, or `sparkle_15` at one) and `graininess`;
    values are pairs [relative, measured], at least one.
    """

    lamp_deg: Degrees = Field(default=2.0, description="angle that the lamp subtends", examples=[2])
    camera_deg: Degrees = Field(
        default=2.0, description="angle that the camera's entrance pupil subtends", examples=[2]
    )
    pixel_um: Annotated[float, Field(ge=2.0, le=1000.0)] = Field(
        default=40.0, description="side of a pixel on the surface", examples=[40]
    )
    field_mm: Annotated[float, Field(ge=4.0, le=100.0)] = Field(
        default=20.0, description="side of the field of view", examples=[20]
    )
    distance_mm: Annotated[float, Field(ge=100.0, le=10000.0)] = Field(
        default=500.0, description="viewing distance of graininess", examples=[500]
    )
    threshold: Annotated[float, Field(ge=0.1, le=100.0)] = Field(
        default=1.0, description="least contrast of a sparkling pixel to the mean", examples=[1]
    )
    dark: Annotated[float, Field(gt=0.0, le=1.0)] = Field(
        default=0.01, description="dark light added to the mean in contrasts, as luminance factor", examples=[0.01]
    )
    calibration: dict[str, tuple[Pair, ...]] = Field(
        default_factory=dict, description="measured pairs [relative, measured]", examples=[{"sparkle_45": [[30, 5.2]]}]
    )

    @pydantic.model_validator(mode="after")
    def _check(self) -> Instrument:
        names = [*QUANTITIES[:3], *QUANTITY_NAMES]
        for name, pairs in self.calibration.items():
            if name not in names:
                raise ValueError(
                    f"calibration.{name} is not known.{did_you_mean(name, names)} Known: {', '.join(names)}"
                )
            if not pairs or not all(math.isfinite(v) and v >= 0 for pair in pairs for v in pair):
                text = show_value([list(pair) for pair in pairs])
                raise ValueError(f"calibration.{name} = {text} is not allowed; write [[relative, measured]], from 0 up")
            if max(pair[0] for pair in pairs) <= 0:
                raise ValueError(f"calibration.{name} needs a relative value above 0")
        if self.pixel_um * 64 > self.field_mm * 1e3:
            raise ValueError(
                f"pixel_um = {self.pixel_um:g} is not allowed; field_mm = {self.field_mm:g} should hold 64 or more"
            )
        return self


@dataclass(frozen=True)
class TextureQuantity(Geometry):
    """A texture value in place of a geometry; its "spectrum" is that number at every wavelength.

    `kind` is "sparkle" (the grade), "intensity", "area" or "graininess", and `theta_deg` the angle of the lamp.

    Attributes:
        instrument: lamp, camera and calibration; None is the default.
        light: illuminant and observer of the luminance.
    """

    instrument: Instrument | None = field(default=None, compare=False)
    light: tuple[str, str] = field(default=("D65", "10deg"), compare=False)

    @classmethod
    def named(
        cls, name: str, where: str, instrument: Instrument | None = None, light: tuple[str, str] = ("D65", "10deg")
    ) -> TextureQuantity:
        """Return the quantity "sparkle_45", "intensity_15", "area_75" or "graininess".

        Raises:
            RecipeError: another name.
        """
        if name not in QUANTITY_NAMES:
            hint = did_you_mean(name, QUANTITY_NAMES)
            raise RecipeError(f"{where} = {show_value(name)} is not known.{hint} Known: {', '.join(QUANTITY_NAMES)}")
        kind, _, angle = name.partition("_")
        return cls(kind, float(angle or 0.0), instrument=instrument, light=light)

    def __str__(self) -> str:
        return self.kind if self.kind == "graininess" else f"{self.kind}_{self.theta_deg:g}"

    @property
    def is_calibrated(self) -> bool:
        """Whether measured pairs map the number to the scale of the instrument."""
        return self.instrument is not None and _pairs(self.instrument, str(self)) is not None

    @property
    def unit(self) -> str:
        """Unit of the number."""
        return "%" if self.kind in ("area", "graininess") else ""


def read_instrument(source: str | Path | Mapping[str, Any] | Instrument | None) -> Instrument:
    """Return an instrument from a TOML file or a mapping; None is the default.

    Raises:
        RecipeError: the file cannot be read, or a key or value is not allowed.
    """
    if source is None:
        return Instrument()
    if isinstance(source, Instrument):
        return source
    if isinstance(source, Mapping):
        return validate(Instrument, source, RecipeContext("instrument"))  # type: ignore[no-any-return]
    text = read_text(Path(source), "instrument")
    return validate(Instrument, parse_toml(text, str(source)), RecipeContext(str(source)))  # type: ignore[no-any-return]


@dataclass(frozen=True)
class Texture:
    """Texture of one material.

    Attributes:
        name: recipe name.
        method: "statistics" or "patch".
        sparkle: angle of the lamp in degrees -> sparkle.
        graininess: graininess under diffuse light.
        luminance: angle -> mean luminance factor and its standard error; "diffuse" under diffuse light.
        calibrated: quantity, such as "sparkle_45" -> value on the instrument's scale.
        extrapolated: calibrated quantities outside of their measured pairs.
        instrument: lamp, camera and definitions.
        images: patches, angle or "diffuse" -> luminance factors `[row, column]`; empty for "statistics".
        seed: random seed.
    """

    name: str
    method: str
    sparkle: dict[str, Sparkle]
    graininess: Graininess
    luminance: dict[str, tuple[float, float]]
    calibrated: dict[str, float]
    extrapolated: tuple[str, ...]
    instrument: Instrument
    images: dict[str, Array] = field(default_factory=dict, compare=False, repr=False)
    seed: int = 0

    @property
    def pictures(self) -> dict[str, tuple[Array, float]]:
        """Images of the patches with the lengths of their sides in mm, for `nacre.plot.texture_figure`."""
        images = {}
        for name, image in self.images.items():
            tile = self.instrument.field_mm / math.sqrt(TILES)
            images[name] = (image, tile if name == "diffuse" else image.shape[0] * self.instrument.pixel_um / 1e3)
        return images

    @property
    def scale(self) -> str:
        """Whether the scale is relative."""
        return CALIBRATED if self.calibrated else RELATIVE


def calibrate(pairs: Sequence[Pair], value: float) -> tuple[float, bool]:
    """Return the instrument's value for a relative one, and whether it lies outside of the pairs.

    The map is the monotone least-squares fit to the pairs (pooling of adjacent violators, Ayer et al. 1955), linear
    between them, through the origin below the first, and proportional above the last.

    Example:
        >>> calibrate([(10.0, 2.0), (20.0, 6.0)], 15.0)
        (4.0, False)
    """
    from scipy.optimize import isotonic_regression

    ordered: dict[float, list[float]] = {}
    for x, y in sorted(pairs):
        ordered.setdefault(x, []).append(y)
    means = [sum(values) / len(values) for values in ordered.values()]
    rising = isotonic_regression(means, weights=[len(values) for values in ordered.values()]).x
    nodes = list(zip(ordered, map(float, rising), strict=True))
    is_outside = not nodes[0][0] <= value <= nodes[-1][0]
    if value > nodes[-1][0]:
        return nodes[-1][1] * value / nodes[-1][0], is_outside
    if nodes[0][0] > 0:
        nodes.insert(0, (0.0, 0.0))
    calibrated = np.interp(value, [x for x, _ in nodes], [y for _, y in nodes])
    return float(calibrated), is_outside


def texture_values(
    material: Any, quantities: Sequence[TextureQuantity], seed: int = 0, fidelity: Fidelity = "final"
) -> tuple[Array, Array]:
    """Return numbers of texture `[quantity]` in closed form, calibrated where pairs are measured, and standard errors.

    Flake tables are cached, as most search candidates share them.

    Args:
        material: anything with `name`, `model` and `context`.
        quantities: quantities with one instrument and light.
        seed: random-walk seed.
        fidelity: "search" has half the nodes and 9 wavelengths, 0.05 CPU s, "scout" also means by two streams, 0.02.

    Raises:
        UnsupportedError: the material lacks flakes, or their diameters.
    """
    if not quantities:
        return np.zeros(0), np.zeros(0)
    tool = quantities[0].instrument or Instrument()
    is_final = fidelity == "final"
    scene = _Scene(material, *quantities[0].light, seed, fidelity, [str(each) for each in quantities])
    pixels, cones = _camera(tool)
    sparkle: dict[float, Sparkle] = {}
    numbers = []
    for each in quantities:
        if each.kind == "graininess":
            grain = graininess_statistics(scene.diffuse()[0], tool.distance_mm, is_final)
            value, error = grain.value, grain.error
        else:
            if each.theta_deg not in sparkle:
                areas, _ = scene.lit(math.radians(each.theta_deg), *cones)
                sparkle[each.theta_deg] = sparkle_statistics(areas, pixels, is_final)
            name = "grade" if each.kind == "sparkle" else each.kind
            one = sparkle[each.theta_deg]
            value, error = getattr(one, name), getattr(one, f"{name}_error")
        pairs = _pairs(tool, str(each))
        if pairs:
            low, high = (calibrate(pairs, max(v, 0.0))[0] for v in (value - error, value + error))
            value, error = calibrate(pairs, value)[0], 0.5 * (high - low)
        numbers.append((value, error))
    values, errors = np.array(numbers).T
    return values, errors


def check_texture(material: Any, where: str) -> None:
    """Refuse a material without texture.

    Raises:
        RecipeError: it lacks flakes, or their diameters.
    """
    try:
        _Scene(material, "D65", "10deg", 0)
    except UnsupportedError as error:
        raise RecipeError(f"{where}: {error}") from None


def _camera(tool: Instrument) -> tuple[Pixels, tuple[float, float]]:
    """Return an instrument's pixels, and the half angles of its lamp and camera in radians."""
    cones = (math.radians(tool.lamp_deg / 2), math.radians(tool.camera_deg / 2))
    return Pixels(tool.pixel_um, tool.field_mm, tool.threshold, tool.dark), cones


def _pairs(tool: Instrument, name: str) -> tuple[Pair, ...] | None:
    """Return the measured pairs of a quantity such as "sparkle_45"."""
    return tool.calibration.get(name) or tool.calibration.get(name.rpartition("_")[0])


def measure_texture(
    material: Any,
    instrument: str | Path | Mapping[str, Any] | Instrument | None = None,
    method: str = "statistics",
    illuminant: str = "D65",
    observer: str = "10deg",
    seed: int = 0,
) -> Texture:
    """Compute sparkle and graininess of a pearl, or of a blend with pearls.

    Args:
        material: anything with `name`, `model` and `context`; each of its flakes has a diameter.
        instrument: lamp, camera and calibration, a TOML file or its keys; default: `Instrument()`.
        method: "statistics", in closed form, or "patch", from drawn flakes.
        illuminant, observer: for the luminance.
        seed: seed for random walks and drawn flakes.

    Raises:
        UnsupportedError: the material lacks flakes, or their diameters.
        RecipeError: the instrument has a key or value that is not allowed.
    """
    if method not in METHODS:
        raise NacreError(f'method = "{method}" is not known; known: {", ".join(METHODS)}')
    tool = read_instrument(instrument)
    scene = _Scene(material, illuminant, observer, seed)
    pixels, cones = _camera(tool)
    sparkle, luminance, images = {}, {}, {}
    for number, angle in enumerate(ANGLES_DEG):
        areas, error = scene.lit(math.radians(angle), *cones)
        label = f"{angle:g}"
        luminance[label] = (sum(area.share * area.mean for area in areas), error)
        closed = sparkle_statistics(areas, pixels)
        result = closed
        if method == "patch":
            result, images[label] = sparkle_patch(areas, pixels, 8 * seed + number)
        sparkle[label] = _with_mean_error(result, closed, areas, pixels, error)
    diffuse, mean = scene.diffuse()
    luminance["diffuse"] = (mean, 0.0)
    if method == "patch":
        grain, images["diffuse"] = graininess_patch(diffuse, tool.distance_mm, tool.field_mm, 8 * seed + 7)
    else:
        grain = graininess_statistics(diffuse, tool.distance_mm)
    plain = Texture(material.name, method, sparkle, grain, luminance, {}, (), tool, images, seed)
    calibrated, outside = _calibrated(plain)
    return replace(plain, calibrated=calibrated, extrapolated=outside)


def _with_mean_error(sparkle: Sparkle, closed: Sparkle, areas: Sequence[Area], pixels: Pixels, error: float) -> Sparkle:
    """Add the effect of the error of the mean luminance to the standard errors."""
    if error <= 0:
        return sparkle
    moved = sparkle_statistics([replace(area, mean=area.mean + error) for area in areas], pixels)
    names = ("intensity", "area", "grade")
    changes = {
        f"{name}_error": math.hypot(getattr(sparkle, f"{name}_error"), getattr(moved, name) - getattr(closed, name))
        for name in names
    }
    return replace(sparkle, **changes)


def _calibrated(texture: Texture) -> tuple[dict[str, float], tuple[str, ...]]:
    values = {"graininess": texture.graininess.value}
    for label, one in texture.sparkle.items():
        values |= {f"sparkle_{label}": one.grade, f"intensity_{label}": one.intensity, f"area_{label}": one.area}
    calibrated, outside = {}, []
    for name, value in values.items():
        pairs = _pairs(texture.instrument, name)
        if pairs:
            calibrated[name], is_outside = calibrate(pairs, value)
            outside += [name] if is_outside else []
    return calibrated, tuple(outside)


class _Scene:
    """A material's parts with their flakes and mean luminances."""

    def __init__(
        self,
        material: Any,
        illuminant: str,
        observer: str,
        seed: int,
        fidelity: Fidelity = "final",
        names: Sequence[str] = QUANTITY_NAMES,
    ) -> None:
        self.seed, self.is_scout = seed, fidelity == "scout"
        self.wavelengths_nm = WAVELENGTHS_NM if fidelity == "final" else SEARCH_NM
        self.angles = [angle for angle in ANGLES_DEG if any(name.endswith(f"_{angle:g}") for name in names)]
        order = HEMISPHERE_ORDER if fidelity == "final" else SEARCH_ORDER
        node, weight = np.polynomial.legendre.leggauss(order if "graininess" in names else 1)
        self.nodes = 0.5 * (node + 1.0)  # sines; the integral of f cos is pi times the mean over their squares
        self.node_weights = weight * self.nodes
        weights = smooth_weights(self.wavelengths_nm, illuminant, observer)[:, 1]
        self.weights = weights / weights.sum()
        self.luminances: dict[int, tuple[Array, Array] | None] = {}
        self.kept: list[Model] = []
        self.places = _places(material.model, 1.0, 1.0)
        self.flakes: dict[int, SingleFlakes] = {}
        self.models = {id(model): model for _, parts in self.places for _, model in parts}
        self.bsdfs: dict[int, Bsdf] = {}
        for key, model in self.models.items():
            if isinstance(model, ResolvedFlakes):
                try:
                    self.flakes[key] = model.single_flakes(self.wavelengths_nm, self.weights)
                except UnsupportedError as error:
                    raise UnsupportedError(f"{material.context.source}: {error}") from None
        if not self.flakes:
            raise UnsupportedError(
                f"{material.context.source}: a {material.model.traits.noun} has no flakes, and so no sparkle or "
                "graininess; texture is known for pearls with platelets, and for blends with one"
            )

    def _surrogate(self, model: Model) -> tuple[Array, Array] | None:
        """Return the exact and approximate luminance along the normal at `angles`, then at `nodes`; None without."""
        if id(model) not in self.luminances:
            wi = direction(np.concatenate([np.radians(self.angles), np.arcsin(self.nodes)]))
            wo = np.broadcast_to(NORMAL, wi.shape)
            radiance = surrogate_radiance(model, wi, wo, self.wavelengths_nm, not self.is_scout)
            if radiance is not None and not self.is_scout and np.any(radiance[1]):
                assert isinstance(model, Surrogate)
                radiance = None if model.surrogate_error is None else radiance  # a base that is not diffuse
            parts = (
                None if radiance is None else (np.pi * radiance[0] @ self.weights, np.pi * radiance[1] @ self.weights)
            )
            self.luminances[id(model)] = parts
        return self.luminances[id(model)]

    def _mean(self, model: Model, theta_rad: float) -> tuple[float, float]:
        """Return the luminance factor along the normal under a lamp, and its standard error."""
        at = next((k for k, a in enumerate(self.angles) if math.isclose(math.radians(a), theta_rad)), None)
        pair = None if at is None else self._surrogate(model)
        if at is not None and pair is not None:
            assert isinstance(model, Surrogate)
            return float(pair[0][at] + pair[1][at]), (model.surrogate_error or 0.0) * float(pair[1][at])
        wi = direction(theta_rad)[None]
        values, error = evaluate_with_error(self._bsdf(model), wi, NORMAL[None], samples=SAMPLES, seed=self.seed)
        return float(np.pi * values[0] @ self.weights), 0.0 if error is None else float(np.pi * error[0] @ self.weights)

    def _bsdf(self, model: Model) -> Bsdf:
        if id(model) not in self.bsdfs:
            self.bsdfs[id(model)] = model.bsdf(self.wavelengths_nm)
        return self.bsdfs[id(model)]

    def lit(self, theta_rad: float, lamp_rad: float, camera_rad: float) -> tuple[list[Area], float]:
        """Return the surface's parts with their flakes under a lamp, and the standard error of the mean luminance."""
        flakes = {key: single.lit(theta_rad, lamp_rad, camera_rad) for key, single in self.flakes.items()}
        means = {key: self._mean(model, theta_rad) for key, model in self.models.items()}
        areas, variance = [], 0.0
        for share, parts in self.places:
            flat = tuple(one.scaled(factor) for factor, m in parts if factor > 0 for one in flakes.get(id(m), []))
            areas.append(Area(share, flat, sum(factor * means[id(m)][0] for factor, m in parts)))
        for key, (_, deviation) in means.items():
            total = sum(share * factor for share, parts in self.places for factor, m in parts if id(m) == key)
            variance += (total * deviation) ** 2
        return areas, math.sqrt(variance)

    def diffuse(self) -> tuple[list[tuple[float, DiffuseArea]], float]:
        """Return the parts under diffuse light, each with the factor on its deviation, and the mean luminance."""
        areas: list[tuple[float, DiffuseArea]] = []
        mean, made = 0.0, {}
        for share, parts in self.places:
            for factor, model in parts:
                if factor <= 0:
                    continue
                if id(model) not in made:
                    made[id(model)] = self._diffuse_part(model)
                areas.append((math.sqrt(share) * factor, made[id(model)]))
                mean += share * factor * made[id(model)].mean
        # variances are weighted by the squares; the means of the parts only enter by their sum
        flakes = [(factor, area) for factor, area in areas if area.flakes]
        weighted = sum(factor * area.mean for factor, area in flakes)
        rest = DiffuseArea((), mean - weighted)
        return [*flakes, (1.0, rest)], mean

    def _diffuse_part(self, model: Model) -> DiffuseArea:
        mean = self._hemisphere(model)
        if id(model) not in self.flakes:
            return DiffuseArea((), mean)
        flakes = tuple(self.flakes[id(model)].diffuse())
        assert isinstance(model, ResolvedFlakes)
        black = model.over_black
        self.kept.append(black)  # so that its id is not reused
        from_base = mean - self._hemisphere(black)
        passed = math.exp(-sum(f.coverage * (1.0 - _mean_transmittance(f.facing, f.transmittance)) for f in flakes))
        base = min(max(from_base / passed, 0.0), 1.0) if passed > LEAST_PASSED else 0.0
        return DiffuseArea(flakes, mean, base)

    def _hemisphere(self, model: Model) -> float:
        """Return the luminance factor along the normal under diffuse light: the hemispherical reflectance."""
        pair = self._surrogate(model)
        if pair is not None:
            return float(self.node_weights @ (pair[0] + pair[1])[len(self.angles) :])
        total = sum(
            hemispherical(lobe, NORMAL, nodes=HEMISPHERE_NODES, seed=self.seed)[0] @ self.weights
            for lobe in self._bsdf(model).lobes
            if not lobe.is_delta
        )
        return float(total)


def _mean_transmittance(facing: Array, transmittance: Array) -> float:
    return float(np.mean(np.interp(facing, np.linspace(0.0, 1.0, len(transmittance)), transmittance)))


def _places(model: Model, share: float, factor: float) -> list[tuple[float, list[tuple[float, Model]]]]:
    """Return the parts of the surface with all nested mixtures resolved."""
    if not isinstance(model, Mixed):
        return [(share, [(factor, model)])]
    places = []
    for part, materials in model.mixture:
        combined: list[tuple[float, list[tuple[float, Model]]]] = [(share * part, [])]
        for one, other in materials:
            if one <= 0:
                continue
            inner = _places(other, 1.0, factor * one)
            combined = [(a * b, [*leading, *right]) for a, leading in combined for b, right in inner]
        places += combined
    return places


def texture_rows(texture: Texture) -> list[tuple[str, str]]:
    """Return the numbers of a texture with their names and units, as text."""
    rows = []
    for label, one in texture.sparkle.items():
        luminance, error = texture.luminance[label]
        at = f"at {label} degrees"
        rows += [
            (f"sparkle {at}", f"{one.grade:.4g} +- {one.grade_error:.2g}"),
            (f"  intensity {at}", f"{one.intensity:.4g} +- {one.intensity_error:.2g}"),
            (f"  area {at} (%)", f"{one.area:.4g} +- {one.area_error:.2g}"),
            (f"  mean luminance {at}", f"{luminance:.4g} +- {error:.2g}"),
        ]
    rows.append(("graininess (%)", f"{texture.graininess.value:.4g} +- {texture.graininess.error:.2g}"))
    rows.append(("  mean luminance, diffuse light", f"{texture.luminance['diffuse'][0]:.4g}"))
    for name, value in texture.calibrated.items():
        note = " (beyond the measured pairs)" if name in texture.extrapolated else ""
        rows.append((f"{name.replace('_', ' at ')} by calibration", f"{value:.4g}{note}"))
    method = "statistics of the flakes" if texture.method == "statistics" else "drawn patch"
    rows += [("texture by", f"{method}"), ("scale of texture", texture.scale)]
    return rows


def texture_document(texture: Texture) -> dict[str, Any]:
    """Return a texture as data for JSON, without images."""
    return {
        "method": texture.method,
        "scale": "calibrated" if texture.calibrated else "relative",
        "sparkle": {label: dict(one.__dict__) for label, one in texture.sparkle.items()},
        "graininess": dict(texture.graininess.__dict__),
        "luminance": {name: {"value": v, "error": e} for name, (v, e) in texture.luminance.items()},
        "calibrated": texture.calibrated,
        "extrapolated": list(texture.extrapolated),
        "instrument": texture.instrument.model_dump(mode="json"),
        "seed": texture.seed,
    }
