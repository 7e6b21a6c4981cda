"""How carefully a look is solved: a draft as coarse as this machine needs to follow a slider, then the settled one."""

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

from nacre.bsdf import Bsdf
from nacre.bsdf.facet_distributions import Roughness
from nacre.bsdf.lobes.microfacet import Microfacet
from nacre.bsdf.texture import refuse_place
from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.families.contract import Draft, fabrications, is_direct, search_model, surrogate_radiance
from nacre.formats.lobes import is_isotropic
from nacre.formats.lut.table import lobe_directions, lobe_weight
from nacre.light import (
    SRGB_WHITE_XYZ,
    adapt_xyz,
    clip_to_srgb,
    spans_colour,
    spectrum_to_rgb_linear,
    spectrum_to_xyz,
    srgb_to_hex,
    white_xyz,
    xyz_to_lab,
    xyz_to_srgb_linear,
)
from nacre.light.spaces import srgb_encode
from nacre.material.material import Material
from nacre.matter.drawings import DrawingRequest, HeightMap
from nacre.matter.indices.constant import OpticalConstant
from nacre.measure.gloss import Gloss, find_gloss
from nacre.measure.spectrum import bsdf_spectrum

ANGLES_DEG = np.arange(0.0, 91.0)
STEEPEST_DEG = 88.0  # of what is integrated or walked: no light arrives at 90
SLOW_S, SWIFT_S = 0.3, 0.06  # a draft that took longer makes the next one coarser, one that took less finer


@dataclass(frozen=True, eq=False)
class Care:
    """What a look is solved at.

    Attributes:
        angles_deg: of the table.
        wavelengths_nm: None: the material's own.
        nodes: of integrals over all exits, along each of two coordinates; a walk takes their square of paths.
        samples: of a walk between two directions; None: as `nacre.evaluate` takes.
    """

    angles_deg: Array
    wavelengths_nm: Array | None = None
    nodes: int = 48
    samples: int | None = None


EVERY_DEGREE = Care(ANGLES_DEG)
SETTLED = Care(np.array([0.0, 8.0, 16.0, 24.0, 32.0, 40.0, 48.0, 56.0, 64.0, 72.0, 80.0, STEEPEST_DEG]))
DRAFTS = (
    Care(np.array([0.0, 20.0, 40.0, 60.0, 75.0, STEEPEST_DEG]), np.arange(400.0, 701.0, 25.0), 16, 512),
    Care(np.array([0.0, 30.0, 60.0, STEEPEST_DEG]), np.linspace(400.0, 700.0, 9), 12, 256),
    Care(np.array([0.0, 45.0, STEEPEST_DEG]), np.linspace(400.0, 700.0, 5), 8, 128),
)


class Drafts:
    """Which of `DRAFTS` each family is drafted at; it follows what drafts take on this machine.

    The first draft at a level is not judged: it compiles.
    """

    def __init__(self) -> None:
        self._levels: dict[str, int] = {}
        self._compiled: set[tuple[str, int]] = set()

    def of(self, family: str) -> Care:
        """Return how carefully to draft a material of a family."""
        return DRAFTS[self._levels.get(family, 0)]

    def took(self, family: str, seconds: float) -> None:
        """Remember what a draft took."""
        level = self._levels.get(family, 0)
        if (family, level) not in self._compiled:
            self._compiled.add((family, level))
        elif seconds > SLOW_S:
            level += 1
        elif seconds < SWIFT_S:
            level -= 1
        self._levels[family] = min(max(level, 0), len(DRAFTS) - 1)


drafts = Drafts()


# The shape of spread light, as a picture over half and difference angle that the page looks up as exported tables do.

SHAPE = (4, 14, 24)  # slices, rows and columns of the picture: azimuth, difference angle, root of the half angle
LOBE_NM = np.arange(400.0, 705.0, 8.0)

ToRgb = Callable[[Array, Array], Array]  # spectra and their wavelengths -> colours


def lobe_picture(material: Material, bsdf: Bsdf | None, to_rgb: ToRgb) -> Array | None:
    """Return pi f 2 cos_i cos_o / (cos_i + cos_o) of spread light, `[slice, row, column, 3]`; or None.

    Args:
        bsdf: solved on any wavelengths, or None where the material gives its spectra without one.
        to_rgb: of spectra `[pair, wavelength]` on wavelengths `[wavelength]`.
    """
    wi, wo = lobe_directions(*SHAPE)
    pairs = wi.reshape(-1, 3), wo.reshape(-1, 3)
    values, wavelengths = _values(material, bsdf, *pairs)
    if values is None:
        return None
    rgb = to_rgb(np.nan_to_num(values), wavelengths)
    weighted = rgb.reshape(*SHAPE, 3) * np.pi * lobe_weight(wi, wo)[..., None]
    return weighted if weighted.max() > 0 else None


def _values(material: Material, bsdf: Bsdf | None, wi: Array, wo: Array) -> tuple[Array | None, Array]:
    if bsdf is None:
        bsdf = material.bsdf(LOBE_NM, keep=False)
    lobes = tuple(lobe for lobe in bsdf.lobes if not lobe.is_delta and not isinstance(lobe, Microfacet))
    spread = dataclasses.replace(bsdf, lobes=lobes)
    if not lobes:
        return None, LOBE_NM
    if not any(lobe.is_stochastic for lobe in lobes):
        return (spread.evaluate(wi, wo) if is_isotropic(spread) else None), bsdf.wavelengths_nm
    found = surrogate_radiance(material.model, wi, wo, LOBE_NM)
    return None if found is None else found[0] + found[1], LOBE_NM


# What the page shows of a material: colours over the angle, spectra, colours under lamps; as one block of bytes.

LAMPS = ("D65", "A", "F11")
PROBE_RAD, PROBE_NM = np.array([0.0]), np.array([450.0, 550.0, 650.0])
QUICK_S = 0.01  # of one angle at three wavelengths; layered films take a tenth of it
MOST_KNOWN = 256  # kinds of recipe that are known to be quick
SHOWN_DEG = (0.0, 30.0, 60.0)  # angles of the spectra
BAND = 12  # wavelengths that are solved without looking up
RIDGE_FAN = 0.5  # roughness by which the page draws the fan of ridges
SPREAD = "Spread light is drawn as if it left evenly in all directions; its lobes are in the settled picture."
GLOSS = "Spread light is drawn as a rough mirror of fitted width over an even ground; see the settled picture."
ALIGNED = "Aligned particles are drawn as they look in the plane of u; the settled picture knows the azimuth."
OF_HEIGHTS = "stl"  # the drawing that only height maps have
MOST_FEATURES = 160  # of a profile
PARTS = ("specular_reflectance", "diffuse_reflectance")
THROUGH = ("specular_transmittance", "diffuse_transmittance")
SEEN_THROUGH = 0.02


class SupersededError(Exception):
    """A newer recipe has come; this one is not wanted any more."""


@dataclass(frozen=True)
class Look:
    """A solved look.

    Attributes:
        mirror_rgb, gloss_rgb, spread_rgb: `[angle, 3]` over `ANGLES_DEG`, linear sRGB, not clipped, adapted from
            the lamp.
        through_rgb: the same of the light that goes straight on through a free film; None: nothing is seen through it.
        facets: of the mirror-like part: their `distribution`, and whether the light lost between them is `compensated`.
        is_clear: light goes through, so that pictures have a chequered stage.
        alpha, gloss_alpha: roughness that the mirror-like and the glossy part are drawn with.
        lobe: where the glossy and the spread light go, `nacre.studio.appearance`; None: as the preview draws them.
        wavelengths_nm: `[wavelength]`; total: `[shown angle, wavelength]`, reflectance, all parts.
        swatches: for each lamp its name and the colours `hex` and `lab` of the total at `SHOWN_DEG`.
        is_draft: few angles and wavelengths; a settled one follows.
        notes: what the preview leaves out, in sentences.
        profile: of a height map `heights_um` along one line, its `length_um` and the map's `depth_um`; else None.
    """

    mirror_rgb: Array
    gloss_rgb: Array
    spread_rgb: Array
    through_rgb: Array | None
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

    def packed(self, **header: Any) -> bytes:
        """Return the look as bytes: length of the header (little-endian), header as JSON, arrays as float32.

        Args:
            header: what stands in the header beside the look: the number of the question, the recipe.
        """
        arrays = {
            "mirror": self.mirror_rgb,
            "gloss": self.gloss_rgb,
            "spread": self.spread_rgb,
            "wavelengths": self.wavelengths_nm,
            "total": self.total,
            **({} if self.lobe is None else {"lobe": self.lobe}),
            **({} if self.through_rgb is None else {"through": self.through_rgb}),
        }
        told = {
            **header,
            "facets": self.facets,
            "clear": self.is_clear,
            "alpha": self.alpha,
            "gloss_alpha": self.gloss_alpha,
            "swatches": self.swatches,
            "draft": self.is_draft,
            "notes": self.notes,
            "profile": self.profile,
            "seconds": round(self.seconds, 4),
            "shown_deg": SHOWN_DEG,
            "arrays": [[name, list(array.shape)] for name, array in arrays.items()],
        }
        text = json.dumps(told).encode()
        text += b" " * (-len(text) % 4)
        body = b"".join(np.ascontiguousarray(array, dtype="<f4").tobytes() for array in arrays.values())
        return struct.pack("<I", len(text)) + text + body


def looks(material: Material, illuminant: str, is_superseded: Callable[[], bool]) -> Iterator[Look]:
    """Yield a material's looks: one that is settled, or a draft before it.

    Args:
        illuminant: lamp of the studio, such as "D65".
        is_superseded: asked between the parts of a long solution.

    Raises:
        NacreError: the material cannot be solved.
        SupersededError: a newer recipe has come.
    """
    refuse_place(material.model, material.context.source)
    if not material.model.traits.is_quick:
        material = material.at_low_fidelity()  # a page waits for no ensemble of minutes
    if not _is_quick(material):
        family = material.family
        draft = _look(_sketched(material), illuminant, is_superseded, drafts.of(family))
        drafts.took(family, draft.seconds)
        yield draft
        if is_superseded():
            raise SupersededError
        yield _look(material, illuminant, is_superseded, SETTLED)
    else:
        yield _look(material, illuminant, is_superseded, EVERY_DEGREE)


def _sketched(material: Material) -> Material:
    """Return a material as drafts are solved: its family's sketch, or one that gives spectra without noise where its
    own are walked; itself where there is neither."""
    if isinstance(material.model, Draft):
        return replace(material, model=material.model.draft)
    near = search_model(material.model, {})
    if is_direct(material.model) or not is_direct(near) or near.spectrum(PROBE_RAD, PROBE_NM, "both", 0) is None:
        return material
    return replace(material, model=near)


def _is_quick(material: Material) -> bool:
    """Whether the whole look takes milliseconds: spectra are at hand, and nothing has to be integrated for them.

    The clock decides: ridges are films too. The second of two trials counts, as the first one may compile. What was
    quick once stays so while only its numbers change: a machine that was busy for a moment makes no draft of a film.
    """
    if not material.model.traits.is_quick:
        return False
    kind = _kind(material.data)
    if kind in _known_quick:
        return True
    took = math.inf
    for _ in range(2):
        if took > QUICK_S:
            started = time.perf_counter()
            if material.model.spectrum(PROBE_RAD, PROBE_NM, "both", 0) is None:
                return False
            took = time.perf_counter() - started
    if took <= QUICK_S:
        if len(_known_quick) >= MOST_KNOWN:
            _known_quick.clear()
        _known_quick.add(kind)
    return took <= QUICK_S


_known_quick: set[str] = set()


def _kind(data: Any) -> str:
    """Return a recipe's dictionary without its numbers, as text."""
    if isinstance(data, Mapping):
        return "{" + ",".join(f"{key}:{_kind(value)}" for key, value in data.items()) + "}"
    if isinstance(data, list | tuple):
        return "[" + ",".join(map(_kind, data)) + "]"
    return "0" if isinstance(data, int | float) and not isinstance(data, bool) else repr(data)


def _look(material: Material, illuminant: str, is_superseded: Callable[[], bool], care: Care) -> Look:
    started = time.perf_counter()
    angles_deg, grid = care.angles_deg, care.wavelengths_nm
    wavelengths, parts, gloss, bsdf = _spectra(material, care, is_superseded)
    if not spans_colour(wavelengths):
        raise NacreError(
            f"{material.context.source}: wavelengths from {wavelengths[0]:g} to {wavelengths[-1]:g} nm make no colour"
        )
    mirror, spread = (parts[name] for name in PARTS)
    glossy = 0.0 * spread if gloss is None else gloss.reflectance
    mirror_rgb, gloss_rgb, spread_rgb = (
        _rgb(part, wavelengths, illuminant, angles_deg) for part in (mirror, glossy, spread - glossy)
    )
    total = mirror + spread
    shown = _at_angles(total, angles_deg)
    alpha, facets, notes = _surface(material)
    lobe = None
    if np.any(spread > 0):
        # the page's picture of a lobe holds no azimuth, and to find that out takes most of a minute
        if grid is None and not material.model.traits.is_quick and not _is_aligned(material):
            _go_on(is_superseded)
            lobe = lobe_picture(material, bsdf, functools.partial(spectrum_to_rgb_linear, illuminant=illuminant))
        if lobe is None:
            notes.append(SPREAD if gloss is None else GLOSS)
    is_clear = any(bool(np.any(parts[name] > 0)) for name in THROUGH)
    through = None
    if np.max(parts[THROUGH[0]]) > SEEN_THROUGH:
        if _is_free(material):
            through = _rgb(parts[THROUGH[0]], wavelengths, illuminant, angles_deg)
        else:
            notes.append("Light that goes through the substrate is not drawn.")
    return Look(
        mirror_rgb, gloss_rgb, spread_rgb, through, facets, is_clear, alpha,
        0.0 if gloss is None else gloss.alpha, lobe, wavelengths, shown,
        _swatches(shown, wavelengths), grid is not None, tuple(notes), time.perf_counter() - started,
        _profile(material),
    )  # fmt: skip


def _spectra(
    material: Material, care: Care, is_superseded: Callable[[], bool]
) -> tuple[Array, dict[str, Array], Gloss | None, Bsdf | None]:
    """Return wavelengths, parts by name, `[angle, wavelength]`, zero where one does not apply, the glossy part, and the
    Bsdf where it had to be solved for them."""
    model, theta, grid = material.model, np.radians(care.angles_deg), care.wavelengths_nm
    bands = [grid]
    if (
        len(theta) < len(ANGLES_DEG) and grid is None
    ):  # long, and a wavelength stands for itself: look up between a few of them
        own = np.asarray(model.wavelengths_nm, dtype=float)
        bands = np.array_split(own, -(-own.size // BAND))
    spectra, axis = [], 1  # along which they are put together
    for band in bands:
        _go_on(is_superseded)
        found = model.spectrum(theta, band, "both", 0)
        if found is None:
            break
        spectra.append(found)
    if not spectra:
        bsdf, axis = material.bsdf(grid, keep=False), 0  # no file is waited for: the next change has another
        for angle in theta:
            _go_on(is_superseded)
            spectra.append(bsdf_spectrum(bsdf, np.array([angle]), nodes=care.nodes))
    parts = {}
    for name in (*PARTS, *THROUGH):
        zero = np.zeros((len(spectra[0].angles_deg), 1))
        blocks = [s.parts().get(name, zero + np.zeros(len(s.wavelengths_nm))) for s in spectra]
        parts[name] = np.nan_to_num(np.concatenate(blocks, axis=axis))
    if axis == 0:
        _go_on(is_superseded)
        return spectra[0].wavelengths_nm, parts, find_gloss(bsdf, theta, parts[PARTS[1]], care.samples), bsdf
    return np.concatenate([s.wavelengths_nm for s in spectra]), parts, None, None


def _go_on(is_superseded: Callable[[], bool]) -> None:
    if is_superseded():
        raise SupersededError


def _rgb(values: Array, wavelengths: Array, illuminant: str, angles_deg: Array) -> Array:
    """Return the colours of spectra at the angles of the table, `[angle, 3]`."""
    if not values.any():  # a part that the material has not
        return np.zeros((len(ANGLES_DEG), 3))
    rgb = spectrum_to_rgb_linear(values, wavelengths, illuminant)
    return np.stack([np.interp(ANGLES_DEG, angles_deg, channel) for channel in rgb.T], axis=-1)


def _at_angles(total: Array, angles_deg: Array) -> Array:
    """Return `[shown angle, wavelength]`, linear between the angles of the table."""
    after = np.clip(np.searchsorted(angles_deg, SHOWN_DEG), 1, len(angles_deg) - 1)
    share = ((np.array(SHOWN_DEG) - angles_deg[after - 1]) / (angles_deg[after] - angles_deg[after - 1]))[:, None]
    return np.asarray((1.0 - share) * total[after - 1] + share * total[after])


def _swatches(total: Array, wavelengths: Array) -> list[dict[str, Any]]:
    whites = [white_xyz(lamp) for lamp in LAMPS]
    seen = [spectrum_to_xyz(total, wavelengths, lamp) for lamp in LAMPS]
    linear = [
        xyz_to_srgb_linear(adapt_xyz(xyz, white, SRGB_WHITE_XYZ)) for xyz, white in zip(seen, whites, strict=True)
    ]
    shown = srgb_encode(clip_to_srgb(np.stack(linear)).rgb)  # all at once: the search for the nearest is what costs
    return [
        {
            "lamp": lamp,
            "hex": [srgb_to_hex(colour) for colour in colours],
            "lab": np.round(xyz_to_lab(xyz, white), 1).tolist(),
        }
        for lamp, colours, xyz, white in zip(LAMPS, shown, seen, whites, strict=True)
    ]


def _is_aligned(material: Material) -> bool:
    """Whether the material looks otherwise when it is turned about its normal, as one of aligned particles does."""
    return bool(getattr(material.model, "is_aligned", False))


def _surface(material: Material) -> tuple[float, dict[str, Any], list[str]]:
    """Return the roughness to draw with, of what facets, and what the drawing leaves out."""
    notes: list[str] = []
    rough = getattr(material.model, "surface", None)
    alpha, facets = 0.0, {"distribution": "ggx", "compensated": False}
    if isinstance(rough, Roughness):
        facets = {"distribution": rough.distribution, "compensated": rough.compensate}
        alpha = float(np.sqrt(rough.alpha_x * rough.alpha_y))
        if rough.alpha_texture is not None:
            alpha *= float(rough.alpha_texture(np.array([0.5, 0.5])))
        if rough.alpha_x != rough.alpha_y:
            notes.append("Brushed surfaces are drawn with the mean of their two roughnesses.")
    if getattr(material.model, "ridges", None) is not None:
        alpha = RIDGE_FAN
        notes.append("The fan of light of the ridges is drawn as a rough mirror; its shape is in the settled picture.")
    if _is_aligned(material):
        notes.append(ALIGNED)
    if _varies(material.data):
        notes.append("What varies over the surface is drawn as it is at the surface's middle.")
    return alpha, facets, notes


def _is_free(material: Material) -> bool:
    """Whether light that goes through goes straight on: the same medium lies on both sides."""
    sides = [getattr(material.model, name, None) for name in ("ambient", "substrate")]
    if not all(isinstance(side, OpticalConstant) for side in sides):
        return False
    above, below = (side.n_complex(PROBE_NM) for side in sides)  # type: ignore[union-attr]  # as just seen
    return bool(np.array_equal(above, below))


def _profile(material: Material) -> dict[str, Any] | None:
    """Return the heights along a line through the middle, where the material is one that is made from heights."""
    drawers = fabrications(material.model)
    drawing = drawers[OF_HEIGHTS](DrawingRequest()) if OF_HEIGHTS in drawers else None
    if not isinstance(drawing, HeightMap):
        return None
    # the part with the most to see: a line across the largest step
    steps = np.abs(np.diff(drawing.heights_um, axis=0)).sum(axis=0)
    line = drawing.heights_um[:MOST_FEATURES, int(np.argmax(steps))]
    return {
        "heights_um": np.round(line, 5).tolist(),
        "length_um": len(line) * drawing.feature_um,
        "depth_um": float(np.ptp(drawing.heights_um)),
    }


def _varies(data: Any) -> bool:
    if isinstance(data, list):
        return any(_varies(value) for value in data)
    if not hasattr(data, "items"):
        return False
    return "texture" in data or "formula" in data or any(_varies(value) for value in data.values())
