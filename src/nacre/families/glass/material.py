"""The photonic glass: spheres in a matrix over a base, its lobes and its figures."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre.bsdf import Bsdf
from nacre.bsdf.bsdf import Spectrum
from nacre.bsdf.compensation import interface_losses
from nacre.bsdf.facet_distributions import Roughness
from nacre.bsdf.lobes.layered import Layered
from nacre.bsdf.substrate import Substrate
from nacre.core.arrays import Array
from nacre.core.errors import UnsupportedError
from nacre.core.machine import in_threads
from nacre.families.contract import DirectEvaluation, Figure, Model, SearchFidelity, Strata, Surrogate, Traits
from nacre.families.glass import tables
from nacre.families.glass.composite import Balls, Composite, EffectiveDispersion
from nacre.families.glass.medium import SIZES, Medium, mixture_power, percus_yevick, schulz_sizes
from nacre.families.glass.radiative_transfer import AZIMUTHS, Slab, brdf_pairs, with_one_index
from nacre.families.glass.random_walk import Face, walk
from nacre.light import default_wavelengths
from nacre.light.tristimulus import spline_matrix

logger = logging.getLogger("nacre")

WALK_ANGLES = 13  # incidences for rough faces, interpolated by a spline
# volume fraction, relative error of the reflectance in per cent: `python -m validation glass_balls`
DENSE_BALLS = ((0.05, 4.0), (0.1, 6.0), (0.2, 8.0), (0.3, 10.0))
SEARCH_WALKERS = 10_000  # walks per ball in searches: noise 0.4 dE00
SPECTRUM_WALKERS = 40_000  # walks per spectrum: standard error at most 0.0025


@dataclass(frozen=True)
class Layer:
    """One stratum of glass; `surface` is its upper face."""

    composite: Composite | Balls
    thickness_nm: float
    surface: Roughness = Roughness()


@dataclass(frozen=True)
class Glass(Model, Strata, Surrogate, SearchFidelity):
    """Photonic glass in air, in one or several strata.

    Attributes:
        composite: spheres and matrix of the uppermost stratum, or balls in a binder.
        thickness_nm, surface: its thickness and upper face.
        base: below all strata.
        quality: "reference", the random walk, or "fast", noise-free tables if they apply.
        is_checked: whether random walks estimate the error of the tables; not in searches.
        below: further strata, from the light inward.
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
        """Default grid: every 10 nm within the base's range."""
        return self.base.known_in(default_wavelengths())

    @property
    def layers(self) -> tuple[Layer, ...]:
        """All strata."""
        return (Layer(self.composite, self.thickness_nm, self.surface), *self.below)

    @property
    def figures(self) -> Mapping[str, Figure]:
        """Structure factor, scattering, and reflectance over thickness: see `figures`."""

        def of_thickness(thickness_nm: float, theta_rad: Array, lam: Array) -> Spectrum | None:
            layer = replace(self, thickness_nm=thickness_nm)
            return layer._estimated(theta_rad, lam) or layer.spectrum(theta_rad, lam, "both")

        return {
            "structure": partial(structure, [layer.composite for layer in self.layers]),
            "scattering": partial(scattering, self.composite),
            "colour-map": partial(colour_map, self.composite, self.thickness_nm, of_thickness),
        }

    @property
    def warnings(self) -> tuple[str, ...]:
        """Error of the reflectance of dense balls that are whole at the faces."""
        densest = max((each.composite.volume_fraction for each in self.layers if isinstance(each.composite, Balls)),
                      default=0.0)  # fmt: skip
        if densest <= DENSE_BALLS[0][0]:
            return ()
        fractions, errors = np.array(DENSE_BALLS).T
        per_cent = float(np.interp(densest, fractions, errors))
        return (
            f"photonic balls of {100 * densest:.3g} % by volume: the reflectance is up to {per_cent:.2g} % too low "
            "(relative) if whole balls leave a gap at the faces, and within 3 % if the faces cut balls",
        )

    def inapplicable_reason(self) -> str | None:
        """Return why the noise-free form does not apply, or None."""
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
        """Return a layered lobe, or its noise-free form: the face, and a table of the diffuse light.

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
        """Return reflectance and transmittance: by transfer for smooth faces, by quick random walks for rough ones.

        None for s and p, for several strata and for bases with other lobes.
        """
        if polarisation != "both" or self.below or self.base.kind not in ("none", "diffuse"):
            return None
        lam = self.wavelengths_nm if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
        theta = np.atleast_1d(np.asarray(theta_rad, dtype=float))
        cos = np.where(theta >= np.pi / 2, 0.0, np.cos(theta))
        is_open = self.base.kind == "none"
        if not self.surface.is_smooth or (is_open and not self.base.surface.is_smooth):
            powers = self._estimated(theta, lam) if self.quality == "fast" else None
            return powers or (self._spectrum_by_walks(theta, lam, seed) if self._has_compiled_walk else None)
        parts = np.stack([slab.powers(cos) for slab in self._slabs(lam, 1)], axis=-1)
        return Spectrum(
            lam, np.degrees(theta), parts[0], parts[1] if is_open else None, parts[2], parts[3] if is_open else None
        )

    def _estimated(self, theta: Array, lam: Array) -> Spectrum | None:
        """Return the spectrum behind a rough face in the noise-free form; None if it does not apply."""
        if self.surface.is_smooth or self.inapplicable_reason() is not None:
            return None
        interface = tables.RoughInterface.behind(self.surface, self._medium(lam))
        if interface is None:
            return None
        cos = np.cos(np.minimum(theta, np.pi / 2))
        slabs, oblique = self._slabs(lam, 1), np.maximum(cos, tables.GRAZING)
        entered = np.stack([slab.powers(oblique)[2] * interface.internal_factor(slab) for slab in slabs], axis=-1)
        changed = (interface.over_smooth(cos) * interface.escape)[:, None]
        return Spectrum(lam, np.degrees(theta), None, None, interface.mirrored(cos)[:, None] + changed * entered, None)

    @property
    def _has_compiled_walk(self) -> bool:
        """Whether the compiled walk applies to its faces; the noise-free form is integrated instead."""
        rough = [self.surface, self.base.surface] if self.base.kind == "none" else [self.surface]
        known = all(each.is_smooth or (each.distribution == "ggx" and each.alpha_x == each.alpha_y) for each in rough)
        return known and (self.quality != "fast" or self.inapplicable_reason() is not None)

    def _spectrum_by_walks(self, theta: Array, lam: Array, seed: int) -> Spectrum:
        """Return the spectrum of rough faces, all diffuse; many angles are interpolated between a few."""
        is_open = self.base.kind == "none"
        last = np.radians(89.99)
        nodes = theta if len(theta) <= WALK_ANGLES else np.linspace(0.0, last, WALK_ANGLES)
        index = float(self.composite.walk_index)
        walked = [
            walk(
                self._medium(lam), self.thickness_nm, None if is_open else self._albedo(lam),
                float(np.cos(min(angle, last))), walkers=SPECTRUM_WALKERS, upper=Face.of(self.surface, index),
                lower=Face.of(self.base.surface, index), seed=seed * WALK_ANGLES + i,
            )
            for i, angle in enumerate(nodes)
        ]  # fmt: skip
        back = np.stack([f.surface + f.reflected.sum(axis=0) for f in walked])
        through = np.stack([f.transmitted for f in walked])
        if len(nodes) < len(theta):
            spread = spline_matrix(nodes, np.minimum(theta, last))
            back, through = (np.clip(spread @ part, 0.0, 1.0) for part in (back, through))
        return Spectrum(lam, np.degrees(theta), None, None, back, through if is_open else None)

    def search_model(self, memory: dict[Any, Any], is_rough: bool = False) -> Model:
        """Return the noise-free form, if it applies, without the walks that estimate its error."""
        if self.inapplicable_reason() is not None:
            return self
        composite = self.composite
        if isinstance(composite, Balls):
            composite = replace(composite, walkers=SEARCH_WALKERS)
        return FastGlass(composite, self.thickness_nm, self.surface, self.base, "fast", is_checked=False)

    def surrogate_radiance(
        self, wi: Array, wo: Array, wavelengths_nm: Array, is_fine: bool = False
    ) -> tuple[Array, Array] | None:
        """Return the light at pairs by radiative transfer, as the exact part.

        It differs from the walk by the approximation of rough faces, and by the dispersion of refraction, which the
        walk compensates in diffuse light only: see `with_one_index`.
        """
        if self.below or self.base.kind not in ("none", "diffuse"):
            return None
        values = self._scattered(wi, wo, np.asarray(wavelengths_nm, dtype=float))
        return values, np.zeros_like(values)

    def _scattered(self, wi: Array, wo: Array, lam: Array) -> Array:
        medium = self._medium(lam)
        slabs = self._slabs(lam, AZIMUTHS)
        values = np.stack([brdf_pairs(medium, i, slab, wi, wo) for i, slab in enumerate(slabs)], axis=-1)
        interface = tables.RoughInterface.behind(self.surface, medium)
        if interface is not None:
            shares = interface.over_smooth(np.abs(wi[:, 2])) * interface.over_smooth(np.abs(wo[:, 2]))
            values = values * shares[:, None] * np.array([interface.internal_factor(slab) for slab in slabs])
        up = (wi[:, 2] > 0) & (wo[:, 2] > 0)
        return np.where(up[:, None], values, 0.0) + tables.face_lobe(medium, self.surface).evaluate(wi, wo)

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
        smooth = tables.diffuse_table(medium, slabs)
        table = tables.behind_rough(smooth, medium, slabs, self.surface)
        lobes = (tables.face_lobe(medium, self.surface), table)
        if not self.is_checked:
            return Bsdf(lobes)
        walk_deviation = tables.walk_error(table, medium, self.thickness_nm, self._albedo(lam), self.surface)
        error = np.hypot(walk_deviation, tables.interpolation_error(smooth, medium, slabs))
        note = (
            f"noise-free form: error {100 * error.mean():.2f} % on average over wavelengths, at most "
            f"{100 * error.max():.2f} % (L2 of f cos: against transfer over all directions, and against the walk over "
            "the polar angle)"
        )
        logger.info("%s", note)
        stated = tables.incidence_error(lobes, medium, slabs, self.surface).stated()
        return Bsdf(lobes, {"notes": [note], "angle_table": {"angles": tables.THETA_NODES, **stated}})

    def _layered(self, lam: Array, is_own_grid: bool, is_in_air: bool = True) -> Layered:
        """Return the layered lobe: the glass enters as a scattering dye."""
        count = len(lam)
        layers = self.layers
        media = [_solved(layer.composite, tuple(lam.tolist())) for layer in layers]
        if is_in_air and len(layers) == 1 and self.base.kind == "diffuse":
            albedo = tuple(self._albedo(lam).tolist())
            media = [_one_index_medium(self.composite, self.thickness_nm, albedo, tuple(lam.tolist()))]
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

    def strata_at(self, wavelengths_nm: Array) -> Layered:
        """Return the layered lobe."""
        return self._layered(np.asarray(wavelengths_nm, dtype=float), False, is_in_air=False)

    def _base_table(self, lam: Array) -> Array:
        last = self.below[-1].composite if self.below else self.composite
        return self.base.reflectance(lam, EffectiveDispersion(last))


@dataclass(frozen=True)
class FastGlass(Glass, DirectEvaluation):
    """A photonic glass with a noise-free form, evaluated directly at direction pairs."""

    def values_at(self, wi: Array, wo: Array, wavelengths_nm: Array) -> Array | None:
        """Return the light at pairs by radiative transfer."""
        return self._scattered(wi, wo, np.asarray(wavelengths_nm, dtype=float))


@lru_cache(maxsize=32)
def _solved(composite: Composite | Balls, wavelengths_nm: tuple[float, ...]) -> Medium:
    return composite.medium(np.array(wavelengths_nm))


@lru_cache(maxsize=8)
def _one_index_medium(
    composite: Composite | Balls, thickness_nm: float, albedo: tuple[float, ...], wavelengths_nm: tuple[float, ...]
) -> Medium:
    index = float(composite.walk_index)
    return with_one_index(_solved(composite, wavelengths_nm), index, thickness_nm, np.array(albedo))


SHOWN_NM = (450.0, 550.0, 650.0)
MAP_THICKNESSES = 13
MAP_NM = np.arange(400.0, 721.0, 20.0)


def structure(fillings: Sequence[Composite | Balls]) -> dict[str, NDArray[Any]]:
    """Return S over q d of every stratum; polydisperse spheres count as equal points at their centres."""
    y = np.linspace(0.0, 20.0, 801)
    rows, labels = [], []
    for number, filling in enumerate(fillings):
        glass = _spheres_of(filling)
        d, phi = glass.diameter_nm, glass.volume_fraction
        if glass.structure is not None:
            rows.append(glass.structure(y))
        elif glass.deviation_nm > 0:
            radii, shares = schulz_sizes(d / 2, glass.deviation_nm, SIZES)
            density = phi / (4 / 3 * np.pi * float(np.sum(shares * radii**3)))
            points = np.ones((1, len(radii), len(y)), dtype=complex)
            rows.append(mixture_power(y / d, 2 * radii, density * shares, points)[0] / density)
        else:
            rows.append(percus_yevick(y, phi))
        name = "" if len(fillings) == 1 else f"strata[{number}], "
        labels.append(f"{name}d = {d:.3g} nm, {100 * phi:.3g} %")
    return {"q": y, "sq": np.stack(rows), "labels": np.array(labels), "q_label": np.array("$q d$")}


def scattering(filling: Composite | Balls, wavelengths_nm: Any = None) -> dict[str, NDArray[Any]]:
    """Return the scattering of the uppermost stratum over the angle for s and p; equal for balls."""
    lam = np.asarray(SHOWN_NM if wavelengths_nm is None else wavelengths_nm, dtype=float)
    theta = np.linspace(0.0, 180.0, 361)
    if isinstance(filling, Composite):
        s, p = filling.spheres(lam).cross_sections(np.cos(np.radians(theta))) * 1e3
    else:
        medium = filling.medium(lam)
        nodes = np.linspace(-1.0, 1.0, medium.phase.shape[1])
        light = [np.interp(np.cos(np.radians(theta)), nodes, row) for row in medium.phase]
        s = p = np.stack(light) * medium.scattering[:, None] * 1e3
    return {"theta_deg": theta, "s": s, "p": p, "wavelengths_nm": lam, "title": np.array("In the layer")}


def colour_map(
    filling: Composite | Balls,
    thickness_nm: float,
    spectrum: Callable[[float, Any, Any], Spectrum | None],
    part: str = "diffuse",
    angles_deg: Any = None,
) -> dict[str, NDArray[Any]]:
    """Return the hemispherical reflectance over thickness and incidence, `reflectance[y, x, l]`.

    Args:
        filling, thickness_nm: layer at the centre of the thickness range.
        spectrum: function of thickness, angles in radians and wavelengths, or None if unknown.
        part: "diffuse" or "specular".
        angles_deg: incidence; default: 0 to 80 in steps of 10.
    """
    if part not in ("diffuse", "specular"):
        raise UnsupportedError(f'part = "{part}" is not known; use diffuse or specular')
    angles = np.arange(0.0, 81.0, 10.0) if angles_deg is None else np.asarray(angles_deg, dtype=float)
    least = 3 * _spheres_of(filling).diameter_nm
    if isinstance(filling, Balls):
        least = 6 * filling.radius_nm
    # at least three spheres or balls, as in recipes
    thicknesses = np.geomspace(max(least, 0.1 * thickness_nm), 4 * thickness_nm, MAP_THICKNESSES)
    rows = []
    for thickness in thicknesses:
        spectra = spectrum(float(thickness), np.radians(angles), MAP_NM)
        if spectra is None:
            raise UnsupportedError("a map over the thickness is known of one stratum over a plain base only")
        values = spectra.diffuse_reflectance if part == "diffuse" else spectra.specular_reflectance
        rows.append(np.zeros((len(angles), len(MAP_NM))) if values is None else values)
    return {
        "y": thicknesses / 1e3,
        "y_label": np.array("Thickness (\u00b5m)"),
        "angles_deg": angles,
        "wavelengths_nm": MAP_NM,
        "reflectance": np.clip(np.array(rows), 0.0, 1.0),
        "title": np.array(f"{part} reflectance"),
    }


def _spheres_of(filling: Composite | Balls) -> Composite:
    return filling.glass if isinstance(filling, Balls) else filling
