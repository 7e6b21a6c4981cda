"""Material appearance for the page: colours over the angle, spectra, colours under lamps; packed as bytes.

The preview draws a mirror-like part (R over the angle in the studio's light), a glossy part (the lobe about the
mirror direction, `nacre.measure.colours`) and a diffuse part: the remaining light, as a matt surface with the same
reflectance at the view angle (reciprocity allows this). Layered films are solved at once. Other materials are first
drafted with few angles and wavelengths, at a quality adapted to the machine.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import math
import struct
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nacre import light
from nacre.bsdf import Bsdf
from nacre.bsdf.facet_distributions import Roughness
from nacre.bsdf.lobes.interface import Microfacet
from nacre.bsdf.texture import Texture, TextureSpec, refuse_place
from nacre.core.arrays import Array
from nacre.core.errors import NacreError, UnsupportedError
from nacre.families import contract
from nacre.families.contract import Surrogate
from nacre.formats.bsdf_tables import is_isotropic
from nacre.formats.lut import lobe_directions, lobe_weight
from nacre.light import spectrum_to_xyz, white_xyz, xyz_to_lab
from nacre.material.material import Material, material_from_data
from nacre.matter.drawings import DrawingRequest, HeightMap
from nacre.matter.indices.constant import OpticalConstant
from nacre.measure.colours import Gloss, find_gloss, geometry_colours, recipe_geometries
from nacre.measure.evaluate import bsdf_spectrum
from nacre.measure.geometry import ASPECULAR_DEG, Geometry
from nacre.measure.texture import ANGLES_DEG as TEXTURE_ANGLES_DEG
from nacre.measure.texture import (
    QUANTITY_NAMES,
    RELATIVE,
    TextureQuantity,
    measure_texture,
    texture_document,
    texture_values,
)
from nacre.optimise.evaluation import lab_hex
from nacre.optimise.measurement import missing_geometries, search_wavelengths, surrogate_factors
from nacre.recipe.model import validate
from nacre.studio.folder import UNPOLARISED, Incidence, built, mixes_polarisations, spectrum_from
from nacre.studio.subprocess_jobs import SupersededError

LAMPS = ("D65", "A", "F11")
PROBE_RAD, PROBE_NM = np.array([0.0]), np.array([450.0, 550.0, 650.0])
QUICK_S = 0.01  # limit for one angle at three wavelengths; layered films need a tenth
MAX_QUICK_FORMS = 256
SHOWN_DEG = (0.0, 30.0, 60.0)  # angles of the spectra
BAND = 12  # wavelengths solved between two checks for a newer request
RIDGE_ROUGHNESS = 0.5  # roughness that approximates the ridges' light fan
DIFFUSE_NOTE = "Scattered light is drawn as diffuse; the rendered picture shows its lobes."
GLOSS_NOTE = "Scattered light is drawn as a rough mirror of fitted width over a diffuse part; see the rendered picture."
ALIGNED_NOTE = "Aligned particles are drawn as seen in the plane of u; the rendered picture includes the azimuth."
AZIMUTH_NOTE = "The colour depends on the azimuth: the light has one azimuth at every point of the drawn object."
HEIGHT_MAP_FORMAT = "stl"  # only height maps are fabricated in this format
MAX_PROFILE_FEATURES = 160
PARTS = ("specular_reflectance", "diffuse_reflectance")
TRANSMITTED_PARTS = ("specular_transmittance", "diffuse_transmittance")
VISIBLE_TRANSMITTANCE = 0.02

ANGLES_DEG = np.arange(0.0, 91.0)
MAX_ANGLE_DEG = 88.0  # largest angle for integrated spectra: the irradiance vanishes at 90 degrees
SLOW_DRAFT_S, FAST_DRAFT_S = 0.3, 0.06  # slower drafts lower the next quality, faster ones raise it

LOBE_SHAPE = (4, 14, 24)  # slices, rows, columns of a lobe image: azimuth, difference angle, square root of half angle
LOBE_NM = np.arange(400.0, 705.0, 8.0)


@dataclass(frozen=True, eq=False)
class Quality:
    """Sampling parameters.

    Attributes:
        angles_deg: table angles.
        wavelengths_nm: default: the material's grid.
        nodes: quadrature nodes along both exit coordinates; a random walk uses nodes**2 paths.
        samples: random-walk paths for one direction pair; default: as in `nacre.evaluate`.
    """

    angles_deg: Array
    wavelengths_nm: Array | None = None
    nodes: int = 48
    samples: int | None = None


QUICK = Quality(ANGLES_DEG)
FINAL = Quality(np.array([0.0, 8.0, 16.0, 24.0, 32.0, 40.0, 48.0, 56.0, 64.0, 72.0, 80.0, MAX_ANGLE_DEG]))
DRAFTS = (
    Quality(np.array([0.0, 20.0, 40.0, 60.0, 75.0, MAX_ANGLE_DEG]), np.arange(400.0, 701.0, 25.0), 16, 512),
    Quality(np.array([0.0, 30.0, 60.0, MAX_ANGLE_DEG]), np.linspace(400.0, 700.0, 9), 12, 256),
    Quality(np.array([0.0, 45.0, MAX_ANGLE_DEG]), np.linspace(400.0, 700.0, 5), 8, 128),
)


class AdaptiveQuality:
    """Draft quality for each family, adapted to measured durations.

    The first draft at a level includes compilation and is ignored.
    """

    def __init__(self) -> None:
        self._levels: dict[str, int] = {}
        self._compiled: set[tuple[str, int]] = set()

    def of(self, family: str) -> Quality:
        """Return the quality for the family's next draft."""
        return DRAFTS[self._levels.get(family, 0)]

    def update(self, family: str, seconds: float) -> None:
        """Record a draft's duration."""
        level = self._levels.get(family, 0)
        if (family, level) not in self._compiled:
            self._compiled.add((family, level))
        elif seconds > SLOW_DRAFT_S:
            level += 1
        elif seconds < FAST_DRAFT_S:
            level -= 1
        self._levels[family] = min(max(level, 0), len(DRAFTS) - 1)


draft_quality = AdaptiveQuality()


@dataclass(frozen=True)
class Appearance:
    """A solved appearance.

    Attributes:
        mirror_rgb, gloss_rgb, diffuse_rgb: `[angle, 3]` over `ANGLES_DEG`, linear sRGB, not clipped, adapted from the
            lamp.
        transmitted_rgb: directly transmitted light, only for a visibly transparent free film.
        facets: `distribution` of the mirror-like part, and whether multiple scattering is `compensated`.
        is_clear: light is transmitted; pictures then have a chequered stage.
        alpha, gloss_alpha: roughness, mirror-like and glossy.
        lobe: lobe image of scattered light, see `lobe_image`; the preview approximates it if missing.
        wavelengths_nm: `[wavelength]`; total: `[shown angle, wavelength]`, total reflectance.
        swatches: for each lamp its name and the total colours `hex` and `lab` at `SHOWN_DEG`.
        is_draft: solved at few angles and wavelengths; the final appearance follows.
        notes: sentences about approximations.
        grades: for a material that varies over the surface, its colours at the nodes `tables`
            `[part, node of the second range, node of the first, angle, 3]` (parts: mirror-like, glossy, diffuse,
            transmitted) and the `map` of the surface, see `nacre.studio.appearance`.
        incidence: light azimuth, and polarisation of the chart's spectra; None for a material without such
            choice.
        polarised: `[shown angle, wavelength]`, reflectance of polarised light, if that is selected.
        profile: for height maps `heights_um` along one line, its `length_um` and the map's `depth_um`.
    """

    mirror_rgb: Array
    gloss_rgb: Array
    diffuse_rgb: Array
    transmitted_rgb: Array | None
    facets: dict[str, Any]
    is_clear: bool
    alpha: float
    gloss_alpha: float
    lobe: Array | None
    wavelengths_nm: Array
    total: Array
    swatches: list[dict[str, Any]]
    is_draft: bool
    notes: tuple[str, ...]
    seconds: float
    profile: dict[str, Any] | None
    grades: dict[str, Any] | None = None
    incidence: Incidence | None = None
    polarised: Array | None = None

    def packed(self, **header: Any) -> bytes:
        """Return the appearance as bytes, see `pack`; `header` adds entries such as the request number."""
        arrays = {
            "mirror": self.mirror_rgb,
            "gloss": self.gloss_rgb,
            "spread": self.diffuse_rgb,
            "wavelengths": self.wavelengths_nm,
            "total": self.total,
            **({} if self.polarised is None else {"polarised": self.polarised}),
            **({} if self.lobe is None else {"lobe": self.lobe}),
            **({} if self.transmitted_rgb is None else {"through": self.transmitted_rgb}),
            **({} if self.grades is None else {"grades": self.grades["tables"], "grade_map": self.grades["map"]}),
        }
        own = {
            "facets": self.facets,
            "clear": self.is_clear,
            "alpha": self.alpha,
            "gloss_alpha": self.gloss_alpha,
            "swatches": self.swatches,
            "draft": self.is_draft,
            "notes": self.notes,
            "profile": self.profile,
            "stepped": bool(self.grades and self.grades["is_stepped"]),
            "incidence": None if self.incidence is None else dataclasses.asdict(self.incidence),
            "seconds": round(self.seconds, 4),
            "shown_deg": SHOWN_DEG,
        }
        return pack({**header, **own}, arrays)


def pack(header: Mapping[str, Any], arrays: Mapping[str, Array]) -> bytes:
    """Return the header's length (little-endian), the JSON header with array names and shapes, and float32 arrays."""
    shapes = [[name, list(array.shape)] for name, array in arrays.items()]
    text = json.dumps({**header, "arrays": shapes}).encode()
    text += b" " * (-len(text) % 4)
    body = b"".join(np.ascontiguousarray(array, dtype="<f4").tobytes() for array in arrays.values())
    return struct.pack("<I", len(text)) + text + body


def appearances(
    material: Material, illuminant: str, is_superseded: Callable[[], bool], incidence: Incidence = UNPOLARISED
) -> Iterator[Appearance]:
    """Yield the final appearance, after a draft if the material is slow.

    Args:
        illuminant: lamp, such as "D65".
        is_superseded: polled during a long solution.
        incidence: light azimuth and polarisation on a film that mixes polarisations; other materials ignore it.

    Raises:
        NacreError: the material cannot be solved.
        SupersededError: a newer request has arrived.
    """
    refuse_place(material.model, material.context.source)
    if not material.model.traits.is_quick:
        material = material.at_low_fidelity()  # an interactive page cannot wait minutes for an ensemble
    if not _is_quick(material):
        family = material.family
        draft = _solve(_drafted(material), illuminant, is_superseded, draft_quality.of(family), incidence)
        draft_quality.update(family, draft.seconds)
        yield draft
        _check(is_superseded)
        final = _solve(material, illuminant, is_superseded, FINAL, incidence)
        grades = grades_of(material)
        if grades is not None:
            yield replace(final, is_draft=True)
        yield _graded(final, grades, illuminant, is_superseded, DRAFTS[0], incidence)
    else:
        appearance = _solve(material, illuminant, is_superseded, QUICK, incidence)
        yield _graded(appearance, grades_of(material), illuminant, is_superseded, QUICK, incidence)


def _graded(
    appearance: Appearance,
    grades: Grades | None,
    illuminant: str,
    is_superseded: Callable[[], bool],
    quality: Quality,
    incidence: Incidence,
) -> Appearance:
    """Return the appearance with its colours at the nodes of the numbers that vary over the surface."""
    if grades is None:
        return appearance
    start = time.perf_counter()
    rows = []
    for node in grades.materials:
        _check(is_superseded)
        wavelengths, parts, gloss, _ = _spectra(node, quality, is_superseded, incidence)
        rgb = [_rgb(part, wavelengths, illuminant, quality.angles_deg) for part in _split(parts, gloss)]
        transmitted = parts[TRANSMITTED_PARTS[0]]
        has_light = appearance.transmitted_rgb is not None
        rgb.append(_rgb(transmitted if has_light else 0.0 * transmitted, wavelengths, illuminant, quality.angles_deg))
        rows.append(rgb)
    first, second = grades.shape
    tables = np.array(rows).transpose(1, 0, 2, 3).reshape(4, second, first, len(ANGLES_DEG), 3)
    return replace(
        appearance,
        grades={"tables": tables, "map": grades.place, "is_stepped": grades.is_stepped},
        lobe=None,  # its shape is that of the centre
        seconds=appearance.seconds + time.perf_counter() - start,
    )


def _split(parts: Mapping[str, Array], gloss: Gloss | None) -> tuple[Array, Array, Array]:
    """Return the mirror-like, glossy and diffuse reflectances `[angle, wavelength]`."""
    mirror, diffuse = (parts[name] for name in PARTS)
    glossy = 0.0 * diffuse if gloss is None else gloss.reflectance
    return mirror, glossy, diffuse - glossy


def _drafted(material: Material) -> Material:
    """Return the material with its family's draft model, or with one that has noise-free spectra rather than walks."""
    if isinstance(material.model, contract.Draft):
        return replace(material, model=material.model.draft)
    near = contract.search_model(material.model, {})
    if (
        contract.is_direct(material.model)
        or not contract.is_direct(near)
        or near.spectrum(PROBE_RAD, PROBE_NM, "both", 0) is None
    ):
        return material
    return replace(material, model=near)


_quick_forms: set[str] = set()


def _is_quick(material: Material) -> bool:
    """Whether the whole appearance takes milliseconds: spectra are available without integration.

    It is measured, because films with ridges are slow. The second trial counts, as the first may compile.
    The result is stored for recipes that differ in numbers only; a busy machine therefore does not draft films.
    """
    if not material.model.traits.is_quick:
        return False
    form = _form(material.data)
    if form in _quick_forms:
        return True
    duration = math.inf
    for _ in range(2):
        if duration > QUICK_S:
            start = time.perf_counter()
            if material.model.spectrum(PROBE_RAD, PROBE_NM, "both", 0) is None:
                return False
            duration = time.perf_counter() - start
    if duration <= QUICK_S:
        if len(_quick_forms) >= MAX_QUICK_FORMS:
            _quick_forms.clear()
        _quick_forms.add(form)
    return duration <= QUICK_S


def _form(data: Any) -> str:
    """Return a recipe's data as text, without its numbers."""
    if isinstance(data, Mapping):
        return "{" + ",".join(f"{key}:{_form(value)}" for key, value in data.items()) + "}"
    if isinstance(data, list | tuple):
        return "[" + ",".join(map(_form, data)) + "]"
    return "0" if isinstance(data, int | float) and not isinstance(data, bool) else repr(data)


def _solve(
    material: Material, illuminant: str, is_superseded: Callable[[], bool], quality: Quality, incidence: Incidence
) -> Appearance:
    start = time.perf_counter()
    angles_deg, grid = quality.angles_deg, quality.wavelengths_nm
    wavelengths, parts, gloss, bsdf = _spectra(material, quality, is_superseded, incidence)
    if not light.spans_colour(wavelengths):
        raise NacreError(
            f"{material.context.source}: wavelengths from {wavelengths[0]:g} to {wavelengths[-1]:g} nm make no colour"
        )
    mirror, diffuse = (parts[name] for name in PARTS)
    mirror_rgb, gloss_rgb, diffuse_rgb = (
        _rgb(part, wavelengths, illuminant, angles_deg) for part in _split(parts, gloss)
    )
    at_angles = _at_angles(mirror + diffuse, angles_deg)
    alpha, facets, notes = _surface(material)
    lobe = None
    if np.any(diffuse > 0):
        # lobe images lack the azimuth, and detecting anisotropy takes most of a minute
        if grid is None and not material.model.traits.is_quick and not _is_aligned(material):
            _check(is_superseded)
            lobe = lobe_image(material, bsdf, functools.partial(light.spectrum_to_rgb_linear, illuminant=illuminant))
        if lobe is None:
            notes.append(DIFFUSE_NOTE if gloss is None else GLOSS_NOTE)
    transmitted = None
    if np.max(parts[TRANSMITTED_PARTS[0]]) > VISIBLE_TRANSMITTANCE:
        if _is_free(material):
            transmitted = _rgb(parts[TRANSMITTED_PARTS[0]], wavelengths, illuminant, angles_deg)
        else:
            notes.append("Light transmitted through the substrate is not drawn.")
    return Appearance(
        mirror_rgb=mirror_rgb,
        gloss_rgb=gloss_rgb,
        diffuse_rgb=diffuse_rgb,
        transmitted_rgb=transmitted,
        facets=facets,
        is_clear=any(bool(np.any(parts[name] > 0)) for name in TRANSMITTED_PARTS),
        alpha=alpha,
        gloss_alpha=0.0 if gloss is None else gloss.alpha,
        lobe=lobe,
        wavelengths_nm=wavelengths,
        total=at_angles,
        swatches=_swatches(at_angles, wavelengths),
        is_draft=grid is not None,
        notes=tuple(notes),
        seconds=time.perf_counter() - start,
        profile=_profile(material),
        incidence=incidence if mixes_polarisations(material) else None,
        polarised=_polarised(material, wavelengths, incidence),
    )


def _polarised(material: Material, wavelengths: Array, incidence: Incidence) -> Array | None:
    """Return the reflectance of the selected polarised light at `SHOWN_DEG`, `[shown angle, wavelength]`."""
    if incidence.polarisation == "both" or not mixes_polarisations(material):
        return None
    spectrum = spectrum_from(material, np.radians(SHOWN_DEG), wavelengths, incidence)
    return None if spectrum is None else np.nan_to_num(spectrum.parts()[PARTS[0]])


def _spectra(
    material: Material, quality: Quality, is_superseded: Callable[[], bool], incidence: Incidence
) -> tuple[Array, dict[str, Array], Gloss | None, Bsdf | None]:
    """Return wavelengths, the parts `[angle, wavelength]` by name (zeros for absent ones), the glossy part, and the
    Bsdf if it had to be solved."""
    unpolarised = replace(incidence, polarisation="both")
    model, theta, grid = material.model, np.radians(quality.angles_deg), quality.wavelengths_nm
    bands = [grid]
    if len(theta) < len(ANGLES_DEG) and grid is None:  # a slow solution is interruptible between bands
        own = np.asarray(model.wavelengths_nm, dtype=float)
        bands = np.array_split(own, -(-own.size // BAND))
    spectra, axis = [], 1  # concatenated along the wavelengths
    for band in bands:
        _check(is_superseded)
        spectrum = spectrum_from(material, theta, band, unpolarised)
        if spectrum is None:
            break
        spectra.append(spectrum)
    if not spectra:
        bsdf, axis = material.bsdf(grid, keep=False), 0  # not cached: the next edit needs another one
        for angle in theta:
            _check(is_superseded)
            spectra.append(bsdf_spectrum(bsdf, np.array([angle]), nodes=quality.nodes))
    parts = {}
    for name in (*PARTS, *TRANSMITTED_PARTS):
        blocks = [s.parts().get(name, np.zeros((len(s.angles_deg), len(s.wavelengths_nm)))) for s in spectra]
        parts[name] = np.nan_to_num(np.concatenate(blocks, axis=axis))
    if axis == 0:
        _check(is_superseded)
        return spectra[0].wavelengths_nm, parts, find_gloss(bsdf, theta, parts[PARTS[1]], quality.samples), bsdf
    return np.concatenate([s.wavelengths_nm for s in spectra]), parts, None, None


def _check(is_superseded: Callable[[], bool]) -> None:
    if is_superseded():
        raise SupersededError


def _rgb(values: Array, wavelengths: Array, illuminant: str, angles_deg: Array) -> Array:
    """Return spectral colours at the table angles, `[angle, 3]`."""
    if not values.any():
        return np.zeros((len(ANGLES_DEG), 3))
    rgb = light.spectrum_to_rgb_linear(values, wavelengths, illuminant)
    return np.stack([np.interp(ANGLES_DEG, angles_deg, channel) for channel in rgb.T], axis=-1)


def _at_angles(total: Array, angles_deg: Array) -> Array:
    """Interpolate linearly at `SHOWN_DEG`, `[shown angle, wavelength]`."""
    after = np.clip(np.searchsorted(angles_deg, SHOWN_DEG), 1, len(angles_deg) - 1)
    share = ((np.array(SHOWN_DEG) - angles_deg[after - 1]) / (angles_deg[after] - angles_deg[after - 1]))[:, None]
    return np.asarray((1.0 - share) * total[after - 1] + share * total[after])


def _swatches(total: Array, wavelengths: Array) -> list[dict[str, Any]]:
    whites = [light.white_xyz(lamp) for lamp in LAMPS]
    xyz = [light.spectrum_to_xyz(total, wavelengths, lamp) for lamp in LAMPS]
    linear = [
        light.xyz_to_srgb_linear(light.adapt_xyz(own, white, light.SRGB_WHITE_XYZ))
        for own, white in zip(xyz, whites, strict=True)
    ]
    encoded = light.srgb_encode(light.clip_to_srgb(np.stack(linear)).rgb)  # one call: gamut mapping dominates the cost
    return [
        {
            "lamp": lamp,
            "hex": [light.srgb_to_hex(colour) for colour in colours],
            "lab": np.round(light.xyz_to_lab(own, white), 1).tolist(),
        }
        for lamp, colours, own, white in zip(LAMPS, encoded, xyz, whites, strict=True)
    ]


def _is_aligned(material: Material) -> bool:
    """Whether the material is anisotropic because its particles are aligned."""
    return isinstance(material.model, contract.Aligned) and material.model.is_aligned


def _surface(material: Material) -> tuple[float, dict[str, Any], list[str]]:
    """Return the preview's roughness, its facet distribution, and notes on approximations."""
    notes: list[str] = []
    model = material.model
    rough = model.surface if isinstance(model, contract.RoughSurface) else None
    alpha, facets = 0.0, {"distribution": "ggx", "compensated": False}
    if isinstance(rough, Roughness):
        facets = {"distribution": rough.distribution, "compensated": rough.compensate}
        alpha = float(np.sqrt(rough.alpha_x * rough.alpha_y))
        if rough.alpha_texture is not None:
            alpha *= float(rough.alpha_texture(np.array([0.5, 0.5])))
        if rough.alpha_x != rough.alpha_y:
            notes.append("Brushed surfaces are drawn with the mean of their two roughnesses.")
    if isinstance(model, contract.Ridged) and model.ridges is not None:
        alpha = RIDGE_ROUGHNESS
        notes.append("The fan of light of the ridges is drawn as a rough mirror; the rendered picture shows its shape.")
    if _is_aligned(material):
        notes.append(ALIGNED_NOTE)
    if mixes_polarisations(material):
        notes.append(AZIMUTH_NOTE)
    if is_undrawn(material.data):
        notes.append("Roughness and directions that vary over the surface are drawn as at the surface's centre.")
    return alpha, facets, notes


def _is_free(material: Material) -> bool:
    """Whether transmitted light continues straight on: both sides are the same medium."""
    model = material.model
    if not isinstance(model, contract.BetweenMedia):
        return False
    sides = (model.ambient, model.substrate)
    if not all(isinstance(side, OpticalConstant) for side in sides):
        return False
    above, below = (side.n_complex(PROBE_NM) for side in sides)
    return bool(np.array_equal(above, below))


def _profile(material: Material) -> dict[str, Any] | None:
    """Return heights along the line with the largest steps."""
    formats = contract.fabrications(material.model)
    drawing = formats[HEIGHT_MAP_FORMAT](DrawingRequest()) if HEIGHT_MAP_FORMAT in formats else None
    if not isinstance(drawing, HeightMap):
        return None
    steps = np.abs(np.diff(drawing.heights_um, axis=0)).sum(axis=0)
    line = drawing.heights_um[:MAX_PROFILE_FEATURES, int(np.argmax(steps))]
    return {
        "heights_um": np.round(line, 5).tolist(),
        "length_um": len(line) * drawing.feature_um,
        "depth_um": float(np.ptp(drawing.heights_um)),
    }


def lobe_image(material: Material, bsdf: Bsdf | None, to_rgb: Callable[[Array, Array], Array]) -> Array | None:
    """Return pi f 2 cos_i cos_o / (cos_i + cos_o) for scattered light, `[slice, row, column, 3]`; or None.

    The coordinates are half and difference angles, as in exported tables. The page uses only the shape and takes the
    total from the spectra, therefore a coarse wavelength grid and the walk's noise-free surrogate suffice.

    Args:
        bsdf: at any wavelengths, if it was solved for the spectra.
        to_rgb: maps spectra `[pair, wavelength]` and wavelengths `[wavelength]` to colours.
    """
    wi, wo = lobe_directions(*LOBE_SHAPE)
    values, wavelengths = _lobe_values(material, bsdf, wi.reshape(-1, 3), wo.reshape(-1, 3))
    if values is None:
        return None
    rgb = to_rgb(np.nan_to_num(values), wavelengths)
    weighted = rgb.reshape(*LOBE_SHAPE, 3) * np.pi * lobe_weight(wi, wo)[..., None]
    return weighted if weighted.max() > 0 else None


def _lobe_values(material: Material, bsdf: Bsdf | None, wi: Array, wo: Array) -> tuple[Array | None, Array]:
    if bsdf is None:
        bsdf = material.bsdf(LOBE_NM, keep=False)
    lobes = tuple(lobe for lobe in bsdf.lobes if not lobe.is_delta and not isinstance(lobe, Microfacet))
    scattering = dataclasses.replace(bsdf, lobes=lobes)
    if not lobes:
        return None, LOBE_NM
    if not any(lobe.is_stochastic for lobe in lobes):
        return (scattering.evaluate(wi, wo) if is_isotropic(scattering) else None), bsdf.wavelengths_nm
    radiance = contract.surrogate_radiance(material.model, wi, wo, LOBE_NM)
    return None if radiance is None else radiance[0] + radiance[1], LOBE_NM


# Numbers that vary over the surface, for the preview: a map, and the material at nodes of their ranges.

MAP_SIZE = 256  # texels along each side of the map
NODES = {(True, 1): (48,), (True, 2): (24, 6), (False, 1): (5,), (False, 2): (3, 3)}  # (is quick, range count) -> nodes
DRAWN = ("thickness_nm", "thickness_um", "thickness_mm", "mask")  # rotations change no colour of a table
MAX_VARYING = 2


@dataclass(frozen=True, eq=False)
class Grades:
    """A material that varies over the surface.

    Attributes:
        place: `[row, column, 2]`, bottom row (v = 0) first: positions in the two ranges, from 0 to 1.
        is_stepped: the map is not interpolated.
        materials: uniform materials, the first range fastest.
        shape: numbers of nodes along both ranges.
    """

    place: Array
    is_stepped: bool
    materials: list[Material]
    shape: tuple[int, int]


def grades_of(material: Material) -> Grades | None:
    """Return a material's grades; None for a uniform one, or if more than two numbers vary."""
    textures = list(_textures(material.data, ()))
    if not 1 <= len(textures) <= MAX_VARYING:
        return None
    axis = (np.arange(MAP_SIZE) + 0.5) / MAP_SIZE
    uv = np.stack(np.meshgrid(axis, axis), axis=-1)
    counts = NODES[material.model.traits.is_quick, len(textures)]
    place, values, stepped = np.zeros((MAP_SIZE, MAP_SIZE, 2)), [], False
    for i, (path, table) in enumerate(textures):
        texture = _built(material, table, path)
        if texture is None:
            return None
        over = texture(uv)
        low, high = float(over.min()), float(over.max())
        if high > low:
            place[..., i] = (over - low) / (high - low)
        stepped |= texture.is_stepped
        values.append(np.linspace(low, high, counts[i]))
    first, second = values[0], values[1] if len(values) == MAX_VARYING else [None]
    materials = [
        material_from_data(
            _with(_with(material.data, textures[0][0], float(a)), textures[-1][0], float(a if b is None else b)),
            material.context,
        )
        for b in second
        for a in first
    ]
    return Grades(place, stepped, materials, (len(first), len(second)))


def is_undrawn(data: Any) -> bool:
    """Whether a quantity varies over the surface but not in the preview."""
    return any(True for _ in _textures(data, (), of_colour=False)) or len(list(_textures(data, ()))) > MAX_VARYING


def _textures(data: Any, path: tuple[Any, ...], of_colour: bool = True) -> Iterator[tuple[tuple[Any, ...], Any]]:
    """Yield the paths and tables of varying numbers."""
    if isinstance(data, Mapping):
        if "formula" in data or "texture" in data:
            if (path[-1] in DRAWN) == of_colour:
                yield path, data
            return
        for key, value in data.items():
            yield from _textures(value, (*path, key), of_colour)
    elif isinstance(data, list):
        for i, value in enumerate(data):
            yield from _textures(value, (*path, i), of_colour)


def _built(material: Material, table: Mapping[str, Any], path: tuple[Any, ...]) -> Texture | None:
    try:
        texture = validate(TextureSpec, table, material.context).build(material.context, ".".join(map(str, path)))
        refuse_place(texture)
        return texture
    except NacreError:
        return None


def _with(data: Any, path: tuple[Any, ...], value: float) -> Any:
    if not path:
        return value
    if isinstance(data, Mapping):
        return {**data, path[0]: _with(data[path[0]], path[1:], value)}
    return [_with(part, path[1:], value) if i == path[0] else part for i, part in enumerate(data)]


# Colours at the geometries of multi-angle instruments, and texture, for the page's panel that follows the recipe.

OBSERVER = "10deg"
ACROSS = ("45as25az90", "45as25az-90", "45as60az125.3", "45as60az-125.3")  # out of the plane of incidence
SLOW = "is measured by the report below, not while the recipe changes"
MIRROR = "reflects into the mirror direction only: see the colour over angle above"


def angle_tables(recipe: Mapping[str, str], lamp: str, is_fine: bool) -> dict[str, Any]:
    """Return `colours` at each geometry and `texture` as JSON data, without random walks.

    Args:
        recipe: from `read_recipe`.
        lamp: illuminant.
        is_fine: texture as in a report, with standard errors (0.5 to 2 CPU s), or in the accuracy of a search.

    Raises:
        NacreError: the recipe cannot be computed.
    """
    material = built(recipe)
    named = {str(at): at for at in (Geometry("aspecular", 45.0, angle) for angle in ASPECULAR_DEG)}
    named |= {text: Geometry.read(text, "geometry") for text in ACROSS}
    named |= {name: at for name, at in recipe_geometries(material).items() if at.kind == "aspecular"}
    try:
        labs = _colours(material, list(named.values()), lamp)
    except UnsupportedError as error:
        return {"colours": [], "texture": {"reason": str(error)}}
    white = white_xyz(lamp, OBSERVER)
    rows = [
        {"geometry": name, "lab": lab.tolist(), "srgb": lab_hex(lab, white)}
        for name, lab in zip(named, labs, strict=True)
    ]
    return {"colours": rows, "texture": _texture(material, lamp, is_fine)}


def _colours(material: Material, geometries: list[Geometry], lamp: str) -> Array:
    grid, model = search_wavelengths(material, [lamp]), material.model
    # mixed polarisations need angle tables, which take seconds
    is_quick = model.traits.is_quick and not mixes_polarisations(material)
    factors = None if is_quick else surrogate_factors(material, geometries, grid)
    is_accurate = isinstance(model, Surrogate) and model.surrogate_error is not None
    if factors is not None and (is_accurate or not np.any(factors[1])):  # exact, or with a small error
        xyz = spectrum_to_xyz(factors[0] + factors[1], grid, lamp, OBSERVER)
        return np.asarray(xyz_to_lab(xyz, white_xyz(lamp, OBSERVER)))
    if not is_quick:
        raise UnsupportedError(f"This {model.traits.noun} {SLOW}.")
    if len(missing_geometries(material, geometries)) == len(set(geometries)):
        raise UnsupportedError(f"This {model.traits.noun} {MIRROR}.")
    return geometry_colours(material, geometries, lamp, OBSERVER)


def _texture(material: Material, lamp: str, is_fine: bool) -> dict[str, Any]:
    """Return rows of sparkle and graininess, or the reason why there are none."""
    quantities = [TextureQuantity.named(name, "texture", light=(lamp, OBSERVER)) for name in QUANTITY_NAMES]
    pairs: list[list[Any]]
    try:
        if is_fine:
            document = texture_document(measure_texture(material, None, "statistics", lamp, OBSERVER))
            pairs = [_pair(document, each) for each in quantities]
        else:
            pairs = [[float(value), None] for value in texture_values(material, quantities, 0, "search")[0]]
    except UnsupportedError as error:
        return {"reason": str(error)}
    return {
        "scale": RELATIVE,
        "angles_deg": list(TEXTURE_ANGLES_DEG),
        "values": dict(zip(QUANTITY_NAMES, pairs, strict=True)),
    }


def _pair(document: Mapping[str, Any], quantity: TextureQuantity) -> list[float]:
    """Return a quantity and its standard error."""
    if quantity.kind == "graininess":
        return [document["graininess"]["value"], document["graininess"]["error"]]
    name, one = "grade" if quantity.kind == "sparkle" else quantity.kind, document["sparkle"][f"{quantity.theta_deg:g}"]
    return [one[name], one[f"{name}_error"]]
