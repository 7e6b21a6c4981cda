"""The photonic glass: spheres in a matrix over a base, and the lobes that follow from them."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np

from nacre.bsdf import Bsdf
from nacre.bsdf.bsdf import Spectrum
from nacre.bsdf.compensation import interface_losses
from nacre.bsdf.facet_distributions import Roughness
from nacre.bsdf.lobes.layered import Layered
from nacre.bsdf.substrate import Substrate
from nacre.core.arrays import Array
from nacre.core.parallel import in_threads
from nacre.families.contract import DirectEvaluation, Figure, Model, SearchFidelity, Strata, Surrogate, Traits
from nacre.families.glass.balls import Balls
from nacre.families.glass.composite import Composite, EffectiveDispersion
from nacre.families.glass.figures import colour_map, scattering, structure
from nacre.families.glass.medium import Medium
from nacre.families.glass.radiative_transfer import AZIMUTHS, Slab, brdf_pairs, with_one_index
from nacre.families.glass.random_walk import Face, walk
from nacre.families.glass.rough_interface import Passing
from nacre.families.glass.tables import behind_rough, diffuse_table, face_lobe, interpolation_error, walk_error
from nacre.light import default_wavelengths
from nacre.light.tristimulus import spline_matrix

logger = logging.getLogger("nacre")

WALKED_ANGLES = 13  # of rough faces; a spline runs between them
FEW_WALKERS = 10_000  # through a ball, where it is one of many candidates: the colour's noise is 0.4 dE00
SPECTRUM_WALKERS = 40_000  # a standard error of at most .0025


@dataclass(frozen=True)
class Layer:
    """One stratum of glass; `surface` is its upper face."""

    composite: Composite | Balls
    thickness_nm: float
    surface: Roughness = Roughness()


@dataclass(frozen=True)
class Glass(Model, Strata, Surrogate, SearchFidelity):
    """Photonic glass in air, of one stratum or several.

    Attributes:
        composite: spheres and matrix of the uppermost stratum, or balls of them in a binder.
        thickness_nm: of that stratum.
        surface: of its upper face.
        base: what lies below all strata.
        quality: "reference", the random walk, or "fast", noise-free tables where they can be made.
        is_checked: whether the error of those tables is walked for; a search does without.
        below: further strata, from the light's side inward.
    """

    traits = Traits(
        noun="photonic glass",
        unpolarised_reason="scatters light many times and is known for unpolarised light only",
        default_geometry="45as45",  # the specular reflection of the upper interface has no colour
        takes_ambient=False,
    )

    composite: Composite | Balls
    thickness_nm: float
    surface: Roughness = Roughness()
    base: Substrate = Substrate()
    quality: str = "reference"
    is_checked: bool = True
    below: tuple[Layer, ...] = ()

    @property
    def wavelengths_nm(self) -> Array:
        """Default grid: every 10 nm; the ends are set by a base that is known in less than the visible."""
        return self.base.known_in(default_wavelengths())

    @property
    def layers(self) -> tuple[Layer, ...]:
        """All strata."""
        return (Layer(self.composite, self.thickness_nm, self.surface), *self.below)

    @property
    def figures(self) -> Mapping[str, Figure]:
        """S of the order, light scattered inside, and reflectance over thickness: see `figures`."""

        def of_thickness(thickness_nm: float, theta_rad: Array, lam: Array) -> Spectrum | None:
            layer = replace(self, thickness_nm=thickness_nm)
            return layer._estimated(theta_rad, lam) or layer.spectrum(theta_rad, lam, "both")

        return {
            "structure": partial(structure, [layer.composite for layer in self.layers]),
            "scattering": partial(scattering, self.composite),
            "colour-map": partial(colour_map, self.composite, self.thickness_nm, of_thickness),
        }

    def inapplicable_reason(self) -> str | None:
        """Return why there are no noise-free tables of it, or None."""
        if self.below:
            return "it has several strata"
        if self.base.kind == "none":
            return "light passes through it"
        if self.base.kind != "diffuse":
            return "its base is not a diffuse one"
        if self.surface.alpha_x != self.surface.alpha_y:
            return "its surface is anisotropic"
        return None

    def bsdf(self, wavelengths_nm: Array | None = None) -> Bsdf:
        """Return the strata of a walk, or a noise-free form of them: the face, and a table of the diffuse light.

        Raises:
            MaterialRangeError: an index is not known at a wavelength.
        """
        lam = self.wavelengths_nm if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
        if self.quality == "fast":
            reason = self.inapplicable_reason()
            if reason is None:
                return self._fast(lam)
            note = f'quality = "fast" is not possible, since {reason}; "reference" is used'
            logger.warning("%s", note)
            return Bsdf((self._layered(lam, wavelengths_nm is None),), {"notes": [note]})
        return Bsdf((self._layered(lam, wavelengths_nm is None),))

    def spectrum(
        self, theta_rad: Array, wavelengths_nm: Array | None, polarisation: str, seed: int = 0
    ) -> Spectrum | None:
        """Return reflectance and transmittance: without noise between smooth faces, by a quick walk between rough ones.

        The fast form of a rough one has what its tables hold, without making them. None for s and p, of several
        strata, and over bases of other lobes.
        """
        if polarisation != "both" or self.below or self.base.kind not in ("none", "diffuse"):
            return None
        lam = self.wavelengths_nm if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
        theta = np.atleast_1d(np.asarray(theta_rad, dtype=float))
        cos = np.where(theta >= np.pi / 2, 0.0, np.cos(theta))
        is_open = self.base.kind == "none"
        if not self.surface.is_smooth or (is_open and not self.base.surface.is_smooth):
            found = self._estimated(theta, lam) if self.quality == "fast" else None
            return found or (self._walked(theta, lam, seed) if self._is_walked_quickly else None)
        parts = np.stack([slab.powers(cos) for slab in self._slabs(lam, 1)], axis=-1)
        return Spectrum(
            lam, np.degrees(theta), parts[0], parts[1] if is_open else None, parts[2], parts[3] if is_open else None
        )

    def _estimated(self, theta: Array, lam: Array) -> Spectrum | None:
        """Return the spectrum behind a rough face as the fast form has it, without noise; None: there is none."""
        if self.surface.is_smooth or self.inapplicable_reason() is not None:
            return None
        passing = Passing.behind(self.surface, self._medium(lam))
        if passing is None:
            return None
        cos = np.cos(np.minimum(theta, np.pi / 2))
        slabs = self._slabs(lam, 1)
        entered = np.stack([slab.powers(cos)[2] * passing.kept(slab) for slab in slabs], axis=-1)
        changed = (passing.over_smooth(cos) * passing.escape)[:, None]
        return Spectrum(lam, np.degrees(theta), None, None, passing.mirrored(cos)[:, None] + changed * entered, None)

    @property
    def _is_walked_quickly(self) -> bool:
        """Whether the compiled walk of one slab knows its faces; the fast form is integrated as it is."""
        rough = [self.surface, self.base.surface] if self.base.kind == "none" else [self.surface]
        known = all(each.is_smooth or (each.distribution == "ggx" and each.alpha_x == each.alpha_y) for each in rough)
        return known and (self.quality != "fast" or self.inapplicable_reason() is not None)

    def _walked(self, theta: Array, lam: Array, seed: int) -> Spectrum:
        """Return the spectrum of rough faces: nothing of it is a mirror's. Many angles are walked at a few of them."""
        is_open = self.base.kind == "none"
        last = np.radians(89.99)
        walked = theta if len(theta) <= WALKED_ANGLES else np.linspace(0.0, last, WALKED_ANGLES)
        index = float(self.composite.walk_index)
        found = [
            walk(
                self._medium(lam), self.thickness_nm, None if is_open else self._albedo(lam),
                float(np.cos(min(angle, last))), walkers=SPECTRUM_WALKERS, upper=Face.of(self.surface, index),
                lower=Face.of(self.base.surface, index), seed=seed * WALKED_ANGLES + i,
            )
            for i, angle in enumerate(walked)
        ]  # fmt: skip
        back = np.stack([f.surface + f.reflected.sum(axis=0) for f in found])
        through = np.stack([f.transmitted for f in found])
        if len(walked) < len(theta):
            spread = spline_matrix(walked, np.minimum(theta, last))
            back, through = (np.clip(spread @ part, 0.0, 1.0) for part in (back, through))
        return Spectrum(lam, np.degrees(theta), None, None, back, through if is_open else None)

    def search_model(self, memory: dict[Any, Any], is_rough: bool = False) -> Model:
        """Return its noise-free form where it has one, without the walks that would state its error."""
        if self.inapplicable_reason() is not None:
            return self
        composite = self.composite
        if isinstance(composite, Balls):
            composite = replace(composite, walkers=FEW_WALKERS)
        return FastGlass(composite, self.thickness_nm, self.surface, self.base, "fast", is_checked=False)

    def surrogate_radiance(
        self, wi: Array, wo: Array, wavelengths_nm: Array, is_fine: bool = False
    ) -> tuple[Array, Array] | None:
        """Return the light at pairs as transfer in modes of the azimuth gives it; see `radiance`.

        It is the walk's own value but for what a rough face does to the diffuse light, and for the dispersion of
        refraction, which the walk makes up for in diffuse light alone: see `one_index`.
        """
        if self.below or self.base.kind not in ("none", "diffuse"):
            return None
        values = self._scattered(wi, wo, np.asarray(wavelengths_nm, dtype=float))
        return values, np.zeros_like(values)

    def _scattered(self, wi: Array, wo: Array, lam: Array) -> Array:
        medium = self._medium(lam)
        slabs = self._slabs(lam, AZIMUTHS)
        values = np.stack([brdf_pairs(medium, i, slab, wi, wo) for i, slab in enumerate(slabs)], axis=-1)
        passing = Passing.behind(self.surface, medium)
        if passing is not None:
            shares = passing.over_smooth(np.abs(wi[:, 2])) * passing.over_smooth(np.abs(wo[:, 2]))
            values = values * shares[:, None] * np.array([passing.kept(slab) for slab in slabs])
        up = (wi[:, 2] > 0) & (wo[:, 2] > 0)
        return np.where(up[:, None], values, 0.0) + face_lobe(medium, self.surface).evaluate(wi, wo)

    def _medium(self, lam: Array) -> Medium:
        return _solved(self.composite, tuple(lam.tolist()))

    def _slabs(self, lam: Array, modes: int) -> list[Slab]:
        medium, albedo = self._medium(lam), self._albedo(lam)
        is_open = self.base.kind == "none"

        def solve(band: int) -> Slab:
            return Slab.solve(medium, band, self.thickness_nm, None if is_open else float(albedo[band]), modes)

        return in_threads(solve, range(len(lam)))

    def _albedo(self, lam: Array) -> Array:
        albedo = self.base.albedo
        return np.interp(lam, *albedo) if isinstance(albedo, tuple) else np.full(len(lam), float(albedo))

    def _fast(self, lam: Array) -> Bsdf:
        medium, slabs = self._medium(lam), self._slabs(lam, AZIMUTHS)
        smooth = diffuse_table(medium, slabs)
        table = behind_rough(smooth, medium, slabs, self.surface)
        lobes = (face_lobe(medium, self.surface), table)
        if not self.is_checked:
            return Bsdf(lobes)
        walked = walk_error(table, medium, self.thickness_nm, self._albedo(lam), self.surface)
        error = np.hypot(walked, interpolation_error(smooth, medium, slabs))
        note = (
            f"noise-free form: error {100 * error.mean():.2f} % on average over wavelengths, at most "
            f"{100 * error.max():.2f} % (L2 of f cos: against transfer over all directions, and against the walk over "
            "the polar angle)"
        )
        logger.info("%s", note)
        return Bsdf(lobes, {"notes": [note]})

    def _layered(self, lam: Array, is_own_grid: bool, is_in_air: bool = True) -> Layered:
        """Return the arrays of the walk: the glass is what a dye that scatters is to a pearl."""
        count = len(lam)
        layers = self.layers
        media = [_solved(layer.composite, tuple(lam.tolist())) for layer in layers]
        if is_in_air and len(layers) == 1 and self.base.kind == "diffuse":
            media = [self._for_one_index(tuple(lam.tolist()))]
        index = np.array([layer.composite.walk_index for layer in layers])
        faces = [*(layer.surface for layer in layers), self.base.surface]
        depths = [
            np.stack([medium.extinction, medium.scattering], axis=-1) * layer.thickness_nm
            for medium, layer in zip(media, layers, strict=True)
        ]
        lobe = Layered(
            wavelengths_nm=lam,
            index=index,
            alpha=np.array([[face.alpha_x, face.alpha_y] for face in faces]),
            is_beckmann=np.array([face.distribution == "beckmann" for face in faces], dtype=np.int64),
            flake_stratum=np.zeros(0, dtype=np.int64),
            flake_number=np.zeros(0),
            flake_axes=np.zeros((0, 3)),
            flake_frame=np.zeros((0, 3, 3)),
            flake_response=np.zeros((0, 1, count, 2)),
            flake_extinction=np.zeros((0, 1, 2, count)),
            base=self.base.walk_kind,
            base_reflectance=self._base_table(lam),
            loss=interface_losses(faces, index, self.base.walk_kind == "none"),
            dye=np.stack(depths),
            dye_phase=np.stack([medium.phase.T for medium in media]),
            dye_quantile=np.stack([medium.quantiles().T for medium in media]),
            base_lobes=self.base.default_lobes if is_own_grid else self.base.lobes(lam),
        )
        lobe.check()
        return self.base.continued(lobe)

    def _for_one_index(self, wavelengths_nm: tuple[float, ...]) -> Medium:
        albedo = self._albedo(np.array(wavelengths_nm))
        return _made_up_for(self.composite, self.thickness_nm, tuple(albedo.tolist()), wavelengths_nm)

    def strata_at(self, wavelengths_nm: Array) -> Layered:
        """Return the arrays of the walk, for strata that other ones may lie on."""
        return self._layered(np.asarray(wavelengths_nm, dtype=float), False, is_in_air=False)

    def _base_table(self, lam: Array) -> Array:
        last = self.below[-1].composite if self.below else self.composite
        return self.base.reflectance(lam, EffectiveDispersion(last))


@dataclass(frozen=True)
class FastGlass(Glass, DirectEvaluation):
    """A photonic glass whose light is known without noise: searches look at it in the wanted directions alone."""

    def values_at(self, wi: Array, wo: Array, wavelengths_nm: Array) -> Array | None:
        """Return what transfer gives at a few pairs, and a rough face."""
        return self._scattered(wi, wo, np.asarray(wavelengths_nm, dtype=float))


@lru_cache(maxsize=32)
def _solved(composite: Composite | Balls, wavelengths_nm: tuple[float, ...]) -> Medium:
    return composite.medium(np.array(wavelengths_nm))


@lru_cache(maxsize=8)
def _made_up_for(
    composite: Composite | Balls, thickness_nm: float, albedo: tuple[float, ...], wavelengths_nm: tuple[float, ...]
) -> Medium:
    index = float(composite.walk_index)
    return with_one_index(_solved(composite, wavelengths_nm), index, thickness_nm, np.array(albedo))
