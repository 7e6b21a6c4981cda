"""The film material: physical parameters, Bsdf and spectra."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import numpy as np

from nacre.bsdf import Bsdf
from nacre.bsdf.angle_nodes import AngleErrors
from nacre.bsdf.bsdf import Spectrum
from nacre.bsdf.compensation import aligned_transmittance, compensate, facet_transmittance
from nacre.bsdf.facet_distributions import SMOOTH_BELOW, Roughness
from nacre.bsdf.lobe import Lobe
from nacre.bsdf.lobes.interface import AlignedMicrofacet, AlignedSpecular, Diffuse, Microfacet, Specular
from nacre.bsdf.polarisation import InterfacePolarisation, interface_polarisation
from nacre.bsdf.response import InterfaceResponse, mean_over_azimuth
from nacre.bsdf.tabulate import (
    COLOUR_ERROR,
    COS_NODES_VARYING,
    AnisotropicTables,
    StackTables,
    check_size,
    choose_nodes,
    is_transparent,
    reflected_lab,
)
from nacre.bsdf.texture import ParameterAxis, Texture
from nacre.core.arrays import Array, direction, gauss_legendre, take_uniform
from nacre.core.errors import UnsupportedError
from nacre.core.machine import check_memory
from nacre.families.contract import STOKES, Polarised, Traits
from nacre.families.film.ridges import Ridges, remainder
from nacre.light import default_wavelengths, delta_e_2000
from nacre.light.tristimulus import STEPS_NM
from nacre.matter.indices.constant import OpticalConstant
from nacre.matter.indices.crystal import AnisotropicConstant
from nacre.matter.stack.polarised import Helix, PolarisedResponse
from nacre.matter.stack.stack import Layer, Stack, is_isotropic

COLOUR_COSINES = np.array([1.0, 0.8, 0.5, 0.25])  # cosines of the colours compared in the choice of grids
MIDDLE = np.array([0.5, 0.5])
AMPLITUDE_CUTOFF = 1e-5  # round-trip amplitude below which deeper layers are neglected
CUTOFF_WAVELENGTHS = 48
SPREAD_STEP_NM = 5.0
BASE_COSINES = 513  # most cosine nodes for a film over a diffuse base
BYTES_PER_LAYER = 64  # per layer and wavelength: indices, phases and copies
AZIMUTH_NOTE = (
    "its reflectance depends on the azimuth of the light; pictures and the Bsdf hold the mean over the azimuth, "
    "spectra are exact"
)
SCALAR_RIDGES = (
    "ridges diffract by scalar theory; for Morpho its colours differ by dE00 4 to 18 from Maxwell's equations, which "
    'ridges.optics = "vector" solves in minutes'
)


def real_extremes(medium: OpticalConstant | AnisotropicConstant, wavelengths_nm: Array) -> tuple[Array, Array]:
    """Return the largest n and the least k of a medium, each `[wavelength]`."""
    if isinstance(medium, AnisotropicConstant):
        values = medium.indices(wavelengths_nm)
        return values.real.max(axis=0), values.imag.min(axis=0)
    value = medium.n_complex(wavelengths_nm)
    return value.real, value.imag


@dataclass(frozen=True)
class FilmLayer:
    """One layer; its thickness may vary over the surface.

    Attributes:
        material: optical constants; for a helical layer, with its axes at the upper face.
        thickness_nm: thickness.
        incoherent: too thick for interference.
        helix: rotation of the axes with depth, or None.
        path: its place in the recipe.
    """

    material: OpticalConstant | AnisotropicConstant
    thickness_nm: float | Texture
    incoherent: bool = False
    helix: Helix | None = None
    path: str = ""

    @property
    def range_nm(self) -> tuple[float, float]:
        """The least and the largest thickness over the surface."""
        d = self.thickness_nm
        return (d.low, d.high) if isinstance(d, Texture) else (d, d)

    def thickness_at(self, uv: Array = MIDDLE) -> float:
        """Return the thickness at one uv."""
        return float(self.thickness_nm(uv)) if isinstance(self.thickness_nm, Texture) else self.thickness_nm


@dataclass(frozen=True)
class Film(Polarised):
    """A stack of layers on a substrate, with a smooth, rough or ridged surface.

    A clear substrate (k < 1e-4 at all wavelengths) transmits; a substrate equal to the ambient makes a free film,
    without refraction. `base_albedo` adds an opaque Lambertian base below the film. `ridges` replace the roughness.

    Attributes:
        base_albedo: in [0, 1]; 0: without a base.
        range_nm, step_nm: wavelength grid; default step: colours within 0.5 dE00.
    """

    version = 4
    traits = Traits(noun="film", default_parts=("specular_reflectance",), is_quick=True)

    ambient: OpticalConstant
    layers: tuple[FilmLayer, ...]
    substrate: OpticalConstant | AnisotropicConstant
    surface: Roughness = Roughness()
    ridges: Ridges | None = None
    base_albedo: float = 0.0
    range_nm: tuple[float, float] = (360.0, 830.0)
    step_nm: float | None = None

    @property
    def stack(self) -> Stack:
        """The stack at the surface's middle."""
        return self.stack_at(MIDDLE)

    @property
    def warnings(self) -> tuple[str, ...]:
        """The error of scalar ridges, measured on supercells of the Morpho wing (docs/physics/film.md)."""
        return (SCALAR_RIDGES,) if self.ridges is not None and self.ridges.optics == "scalar" else ()

    @property
    def specular_stack(self) -> Stack:
        """The stack; roughness attenuates its specular reflection equally for s and p.

        Raises:
            UnsupportedError: ridges scatter all light.
        """
        if self.ridges is not None:
            raise UnsupportedError("ridges reflect no light specularly")
        return self.stack

    def stack_at(self, uv: Array) -> Stack:
        """Return the stack at one uv."""
        layers = [Layer(e.material, e.thickness_at(uv), e.incoherent, e.helix) for e in self.layers]
        return Stack(self.ambient, layers, self.substrate)

    @property
    def is_anisotropic(self) -> bool:
        """Whether a layer or the substrate is anisotropic."""
        return not all(map(is_isotropic, (self.substrate, *(layer.material for layer in self.layers))))

    @property
    def mixes_polarisations(self) -> bool:
        """Whether the film is anisotropic and its light specular."""
        return self.is_anisotropic and self.base_albedo == 0

    @property
    def depends_on_azimuth(self) -> bool:
        """Whether the optics of a medium depend on the azimuth."""
        media = [self.substrate, *(layer.material for layer in self.layers)]
        return any(isinstance(medium, AnisotropicConstant) and not medium.is_axial for medium in media)

    def transmits(self, wavelengths_nm: Array) -> bool:
        """Whether the substrate is transparent."""
        if isinstance(self.substrate, AnisotropicConstant):
            return is_transparent(self.substrate.indices(wavelengths_nm))
        return is_transparent(self.substrate.n_complex(wavelengths_nm))

    def _refuse_hidden_base(self, transmits: bool) -> None:
        """Check that a diffuse base lies below a transparent substrate.

        Raises:
            UnsupportedError: the substrate hides it.
        """
        if self.base_albedo > 0 and not transmits:
            raise UnsupportedError(
                f'base.albedo = {self.base_albedo:g} does not show through the opaque substrate "{self.substrate.name}"'
            )

    @cached_property
    def wavelengths_nm(self) -> Array:
        """Default grid: the step follows the optical thickness, and is halved until colours converge."""
        low, high = self.range_nm
        if self.step_nm is not None:
            return _grid(low, high, self.step_nm)
        grid = default_wavelengths(self._optical_thickness_nm())
        step = float(grid[1] - grid[0])
        if self.is_anisotropic:  # too costly to compare colours; a pitch spread smooths the spectra
            has_spread = any(e.helix is not None and e.helix.deviation_nm > 0 for e in self.layers)
            return _grid(low, high, max(step, SPREAD_STEP_NM) if has_spread else step)
        finer = [s for s in STEPS_NM if s < step * 0.999][:3]
        coarser = _grid(low, high, step)
        spectra = self._test_spectra(coarser)
        for smaller in finer:
            closer = _grid(low, high, smaller)
            exact = self._test_spectra(closer)
            between = np.stack([np.interp(closer, coarser, row) for row in spectra])
            change = delta_e_2000(reflected_lab(between, closer), reflected_lab(exact, closer))
            if float(np.max(change)) <= COLOUR_ERROR:
                break
            spectra, coarser, step = exact, closer, smaller
        return _grid(low, high, step)

    def _optical_thickness_nm(self) -> float:
        """Return the optical thickness of interfering layers within the round-trip penetration depth.

        Deeper layers cause no fringes. With a clear substrate the stack is also illuminated from below.
        """
        low, high = self.range_nm
        lam = np.linspace(low, high, CUTOFF_WAVELENGTHS)
        ends = np.array([low, 0.5 * (low + high), high])
        layers = []
        materials = {id(layer.material): layer.material for layer in self.layers}
        constants = {key: (real_extremes(m, lam)[1], real_extremes(m, ends)[0]) for key, m in materials.items()}
        for layer in self.layers:
            extinction, refraction = constants[id(layer.material)]
            thinnest, thickest = layer.range_nm
            # round-trip amplitude loss per nm
            loss = 4.0 * np.pi * extinction / lam
            n = 0.0 if layer.incoherent else float(np.max(refraction))
            layers.append((n, thickest, thinnest, loss))
        sides = [layers]
        if self.transmits(lam):
            sides.append(layers[::-1])
        total_nm = 0.0
        for side in sides:
            remaining, optical = np.full(len(lam), -np.log(AMPLITUDE_CUTOFF)), np.zeros(len(lam))
            for n, thickest, thinnest, loss in side:
                optical += n * np.minimum(thickest, remaining / np.maximum(loss, 1e-300))
                remaining = np.maximum(remaining - loss * thinnest, 0.0)
            total_nm = max(total_nm, float(np.max(optical)))
        return total_nm

    def _test_spectra(self, wavelengths_nm: Array) -> Array:
        """Return the reflectance `[case, wavelength]` at the angles and thicknesses of the grid test."""
        tables = self.tables(wavelengths_nm)
        low, high = np.array([layer.range_nm for layer in self.layers]).reshape(-1, 2).T
        shares = (0.5, 1.0) if np.any(high > low) else (0.5,)
        return np.concatenate([tables.outside(low + share * (high - low), COLOUR_COSINES)[0] for share in shares])

    def tables(self, wavelengths_nm: Array) -> StackTables:
        """Return the solver of the film's stack on a wavelength grid.

        Raises:
            UnsupportedError: too much memory.
        """
        count, many = len(wavelengths_nm), len(self.layers) + 2
        check_memory(
            float(BYTES_PER_LAYER) * many * count, f"layers: {many - 2} of them at {count} wavelengths: the film"
        )
        if self.is_anisotropic:
            return AnisotropicTables(
                self.stack, wavelengths_nm, self.transmits(wavelengths_nm), self.depends_on_azimuth
            )
        layers = [
            Layer(layer.material, d, layer.incoherent) for layer, d in zip(self.layers, self._middle_nm, strict=True)
        ]
        n = Stack(self.ambient, layers, self.substrate).indices(wavelengths_nm)
        flags = [layer.incoherent for layer in self.layers]
        return StackTables(n, flags, wavelengths_nm, is_transparent(n[-1]))

    def bsdf(self, wavelengths_nm: Array | None = None) -> Bsdf:
        """Solve the stack and return its lobes.

        Args:
            wavelengths_nm: `[wavelength]`, ascending; default: `self.wavelengths_nm`.

        Raises:
            MaterialRangeError: an optical constant is not known at a wavelength.
            UnsupportedError: more thicknesses vary over the surface than tables allow.
        """
        lam = self.wavelengths_nm if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
        tables = self.tables(lam)
        self._refuse_hidden_base(tables.transmits)
        varies_visibly = isinstance(tables, AnisotropicTables) and tables.varies_visibly(self._middle_nm)
        if varies_visibly and not (self._varying or self.base_albedo > 0 or tables.flipped):
            return self._aligned(cast("AnisotropicTables", tables))
        response, notes = self._response(tables)
        if varies_visibly:
            notes = {**notes, "warnings": [*notes.get("warnings", ()), AZIMUTH_NOTE]}
        if self.ridges is not None:
            lobe = self.ridges.lobe(_from_the_front(response))
            lobes: list[Lobe] = [lobe]
            if self.base_albedo > 0:
                lobes.append(remainder(lobe, np.full(len(lam), self.base_albedo)))
        elif self.base_albedo > 0:
            lobes = [self._surface_lobe(_from_the_front(response)), self._base(response)]
        else:
            lobes = [self._surface_lobe(response)]
            if response.transmits and response.eta == 1.0 and not self.surface.is_smooth:
                lobes.append(self._straight_through(response))
        return Bsdf(tuple(lobes), notes)

    def _aligned(self, tables: AnisotropicTables) -> Bsdf:
        """Return the lobes of a film whose reflectance depends on the azimuth."""
        d = self._middle_nm
        over = tables.over_azimuth(d)
        mean = mean_over_azimuth(over)
        notes = _stated(mean, tables.errors_of(mean, d))
        if self.surface.is_smooth:
            return Bsdf((AlignedSpecular(over, 0.0),), notes)
        rough = self._surface_lobe(mean)
        own = {field.name: getattr(rough, field.name) for field in dataclasses.fields(cast("Microfacet", rough))}
        if not over.transmits or over.eta > 1.0:
            return Bsdf((AlignedMicrofacet(**{**own, "response": over}),), notes)
        passed = aligned_transmittance(over, self.surface.distribution, *self._mean_alpha())
        through = AlignedSpecular(_only_transmitting(over, passed), 0.0)
        return Bsdf((AlignedMicrofacet(**{**own, "response": _without_transmission(over)}), through), notes)

    def polarisation(self, wavelengths_nm: Array | None = None) -> InterfacePolarisation | None:
        """Tabulate the Mueller matrices of the film.

        None for incoherent isotropic layers, ridges, a diffuse base, or thicknesses that vary over the surface: the
        renderer then depolarises.
        """
        lam = self.wavelengths_nm if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
        if self.ridges is not None or self.base_albedo > 0 or self._varying:
            return None
        return interface_polarisation(self.tables(lam), self._middle_nm)

    def _response(self, tables: StackTables) -> tuple[InterfaceResponse, dict[str, Any]]:
        """Return the tables of the smooth film, with an axis for each varying thickness."""
        d, varying = self._middle_nm, self._varying
        if not varying:
            response, errors = tables.with_error(d)
            return response, _stated(response, errors)
        if len(varying) > 2:
            raise UnsupportedError(f"{len(varying)} thicknesses vary over the surface; at most two can")
        axes, notes = [], {}
        for i in varying:

            def spectra(values: Array, i: int = i) -> Array:
                return tables.outside(_with_column(d, i, values), COLOUR_COSINES)[0]

            values, error = choose_nodes(spectra, *self.layers[i].range_nm, tables.wavelengths_nm)
            texture = self.layers[i].thickness_nm
            assert isinstance(texture, Texture)
            name = f"{self.layers[i].path or f'layers[{i}]'}.thickness_nm"
            axes.append(ParameterAxis(name, values, texture))
            notes[name] = {"nodes": len(values), "colour_error_dE00": round(error, 4)}
        check_size([len(axis.values) for axis in axes], COS_NODES_VARYING, len(tables.wavelengths_nm))
        grid = np.meshgrid(*[axis.values for axis in axes], indexing="ij")
        thicknesses = np.broadcast_to(d, (*grid[0].shape, len(d))).copy()
        for i, values in zip(varying, grid, strict=True):
            thicknesses[..., i] = values
        response, errors = tables.with_parameters(thicknesses, tuple(axes))
        return response, {"varying": notes, **_stated(response, errors)}

    @property
    def _varying(self) -> list[int]:
        """Layers whose thickness varies over the surface."""
        return [i for i, layer in enumerate(self.layers) if layer.range_nm[1] > layer.range_nm[0]]

    @property
    def _middle_nm(self) -> Array:
        """Thicknesses `[layer]` at the centre of their ranges."""
        values = [layer.thickness_nm for layer in self.layers]
        return np.array([d.middle if isinstance(d, Texture) else d for d in values], dtype=float)

    def _surface_lobe(self, response: InterfaceResponse) -> Lobe:
        if self.surface.is_smooth:
            return Specular(response)
        if response.transmits and response.eta == 1.0:
            response = _without_transmission(response)
        surface = self.surface
        lobe = Microfacet(
            response,
            surface.distribution,
            max(surface.alpha_x, SMOOTH_BELOW),
            max(surface.alpha_y, SMOOTH_BELOW),
            surface.alpha_texture,
            surface.rotation,
        )
        return compensate(lobe) if surface.compensate else lobe

    def _mean_alpha(self) -> tuple[float, float]:
        factor = 1.0 if self.surface.alpha_texture is None else self.surface.alpha_texture.middle
        return max(self.surface.alpha_x * factor, SMOOTH_BELOW), max(self.surface.alpha_y * factor, SMOOTH_BELOW)

    def _straight_through(self, response: InterfaceResponse) -> Specular:
        """Return the transmission of a rough free film.

        Both interfaces are parallel, so every facet is a plane-parallel film: light is transmitted undeflected. The
        transmittance is the mean over the visible facets (for varying roughness: at the surface's centre).
        """
        passed = facet_transmittance(response, self.surface.distribution, *self._mean_alpha())
        return Specular(_only_transmitting(response, passed))

    def _base(self, response: InterfaceResponse) -> Diffuse:
        """Return the diffuse base below the film, with multiple reflections between both."""
        cos = np.linspace(0.0, 1.0, min(len(response.cos_outside), BASE_COSINES))
        relative = 1.0 / response.eta if response.flipped else response.eta
        outer = response.outside_cosine(cos) if response.flipped else cos
        smooth = response.over_cosine(response.transmittance, outer)
        if response.flipped:
            smooth = np.where((cos > response.cos_critical)[:, None], smooth, 0.0)
        entry, mean = smooth, _cosine_mean(smooth)
        behind = response.hemispherical[0 if response.flipped else 2]
        if not self.surface.is_smooth and not response.flipped:
            entry = facet_transmittance(response, self.surface.distribution, *self._mean_alpha())
            # light not transmitted outward by the facets on average is reflected inside
            behind = behind + (mean - _cosine_mean(entry)) / relative**2
        albedo = self.base_albedo
        scale = albedo / (relative**2 * (1.0 - albedo * np.clip(behind, 0.0, 1.0)))
        under_smooth = None if self.surface.is_smooth else smooth * self._returned_share(response)[..., None, :]
        return Diffuse(response.wavelengths_nm, scale, entry, response.parameters, under_smooth)

    def _returned_share(self, response: InterfaceResponse) -> Array:
        """Return the share of light on the base that leaves through the smooth film again, `[*params, wavelength]`.

        Albedo times diffuse transmittance, summed over the round trips. One quadrature of one set of tables gives both
        factors, so that the share never exceeds one.
        """
        reflected, passed = response.hemispherical[0:2] if response.flipped else response.hemispherical[2:4]
        return np.asarray(self.base_albedo * passed / (1.0 - self.base_albedo * np.clip(reflected, 0.0, 1.0 - passed)))

    def polarised_spectrum(
        self,
        theta_rad: Array,
        wavelengths_nm: Array | None = None,
        polarisation: str = "both",
        azimuth_rad: float = 0.0,
    ) -> Spectrum:
        """Return reflectance and transmittance at angles in the ambient, at the surface's middle.

        The specular parts of a rough film are those of its smooth stack, as is the diffuse part of a base, so that
        their sum never exceeds one. Ridges scatter diffusely, for light in the plane y = 0.

        Args:
            theta_rad: `[angle]` in [0, pi/2].
            wavelengths_nm: `[wavelength]`; default: `self.wavelengths_nm`.
            polarisation: "s", "p", "left", "right", "both", or "mueller" for "both" with Mueller matrices.
            azimuth_rad: azimuth of the direction towards the light, from u; anisotropic films depend on it.

        Raises:
            UnsupportedError: the polarisation is not known for a part of the spectrum.
        """
        lam = self.wavelengths_nm if wavelengths_nm is None else np.asarray(wavelengths_nm, dtype=float)
        theta = np.atleast_1d(np.asarray(theta_rad, dtype=float))
        if polarisation not in STOKES:
            raise UnsupportedError(f'polarisation = "{polarisation}" is not known; use {", ".join(STOKES)}')
        reflected = transmitted = diffuse = None
        matrices: PolarisedResponse | None = None
        if self.ridges is None:
            if polarisation in ("s", "p", "both"):
                powers = self.stack.powers(theta, lam, azimuth_rad=azimuth_rad)
                pick = {"s": (powers.R_s, powers.T_s), "p": (powers.R_p, powers.T_p)}
                reflected, passed = pick.get(polarisation, (powers.reflectance, powers.transmittance))
            else:
                response = self.stack.polarised(theta, lam, azimuth_rad)
                matrices = response if polarisation == "mueller" else None
                reflected = response.mueller_reflected[..., 0, :] @ np.array(STOKES[polarisation])
                passed = response.entering @ np.array(STOKES[polarisation])
            if self.base_albedo == 0 and self.transmits(lam):
                transmitted = passed
        if self.ridges is not None or self.base_albedo > 0:
            if polarisation != "both":
                raise UnsupportedError(
                    f'polarisation = "{polarisation}" is not allowed with ridges or a diffuse base; allowed: "both"'
                )
            bsdf = self.bsdf(lam)  # also refuses a hidden base
            if self.ridges is not None:
                directions = direction(np.minimum(theta, np.radians(89.99)))
                diffuse = np.array([sum(lobe.hemispherical(w)[0] for lobe in bsdf.lobes) for w in directions])
            else:
                still = self.tables(lam).adaptive(np.array([layer.thickness_at() for layer in self.layers]))
                diffuse = passed * self._returned_share(still)
        return Spectrum(
            lam,
            np.degrees(theta),
            reflected,
            transmitted,
            diffuse,
            mueller_reflected=None if matrices is None else matrices.mueller_reflected,
            mueller_transmitted=None if matrices is None or transmitted is None else matrices.mueller_transmitted,
        )


def _without_transmission(response: InterfaceResponse) -> InterfaceResponse:
    return dataclasses.replace(response, transmittance=np.zeros_like(response.transmittance), transmits=False)


def _only_transmitting(response: InterfaceResponse, passed: Array) -> InterfaceResponse:
    """Return the response without reflection; `passed[*params, cos, wavelength]` is on uniform cosines."""
    zero, cos = np.zeros_like(passed), np.linspace(0.0, 1.0, passed.shape[-2])
    tables: dict[str, Any] = {"reflectance": zero, "reflectance_inside": zero, "transmittance": passed}
    return dataclasses.replace(response, cos_outside=cos, total_nodes=None, **tables)


def _stated(response: InterfaceResponse, errors: AngleErrors) -> dict[str, Any]:
    """Return the note on a table over angle: its nodes, and the errors of R and T found."""
    return {"angle_table": {"cosines": len(response.cos_outside), **errors.stated(response.flipped)}}


def _grid(low: float, high: float, step: float) -> Array:
    return np.linspace(low, high, max(2, int(np.ceil((high - low) / step - 1e-9)) + 1))


def _with_column(d: Array, i: int, values: Array) -> Array:
    rows = np.broadcast_to(d, (len(values), len(d))).copy()
    rows[:, i] = values
    return rows


def _cosine_mean(table: Array) -> Array:
    """Return twice the integral of mu times the linear interpolant of `[*params, mu, wavelength]`."""
    x, weight = gauss_legendre(128)
    mu, weight = 0.5 * (x + 1.0), 0.5 * weight
    return np.asarray(np.einsum("q,...ql->...l", 2.0 * weight * mu, take_uniform(table, mu, -2)))


def _from_the_front(response: InterfaceResponse) -> InterfaceResponse:
    """Return the response without transmission and without light from the substrate."""
    zero = np.zeros_like(response.reflectance)
    if response.flipped:
        return dataclasses.replace(response, reflectance=zero, transmittance=zero, transmits=False, relative_index=None)
    empty = np.zeros((*response.total.shape[:-2], 0, response.total.shape[-1]))
    return dataclasses.replace(
        response,
        transmittance=zero,
        reflectance_inside=zero,
        total=empty,
        eta=1.0,
        transmits=False,
        relative_index=None,
    )
