"""Measurement geometries and simulated measurements: reflectance factors, 1 for a perfect white."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nacre.bsdf.bsdf import Bsdf, Spectrum
from nacre.core.arrays import Array
from nacre.core.errors import RecipeError, UnsupportedError
from nacre.families.contract import narrowest_line_nm, search_model, surrogate_radiance, values_at
from nacre.light import default_wavelengths, lamp_lines_nm, spans_colour, with_lamp_lines
from nacre.material.material import Material
from nacre.measure.colours import WALK_NM
from nacre.measure.evaluate import bsdf_spectrum, evaluate_for_colours, line_wavelengths, on_wavelengths
from nacre.measure.geometry import Geometry, aspecular_pairs, spectrum_at
from nacre.measure.texture import TextureQuantity, check_texture, texture_values

EVALUATION_STEP_NM = 1.0


@dataclass(frozen=True)
class Measurement:
    """Simulated measurement.

    Attributes:
        wavelengths_nm: `[wavelength]`.
        factors: `[geometry, wavelength]`.
        error: standard error of the factors, in their shape; None without Monte Carlo.
        missing: geometries at which the material lacks any signal, such as diffuse light of a mirror.
    """

    wavelengths_nm: Array
    factors: Array
    error: Array | None
    missing: frozenset[Geometry]


def simulate_measurement(
    material: Material,
    geometries: Sequence[Geometry],
    wavelengths_nm: Array | None = None,
    *,
    samples: int | None = None,
    seed: int = 0,
    memory: dict[Any, Any] | None = None,
    is_rough: bool = False,
) -> Measurement:
    """Simulate a measurement of a material.

    Specular and transmitted factors agree with `nacre spectrum`, aspecular ones with `nacre report`. The row of a
    `TextureQuantity` holds its number at every wavelength.

    Args:
        wavelengths_nm: ascending; default: the material defaults.
        samples, seed: Monte Carlo settings.
        memory: cache of a search, shared by its candidates; they are then evaluated at the required directions only,
            if the family can. None: the reference model.
        is_rough: with a cache, whether a ranking is sufficient.

    Raises:
        NacreError: the material cannot be computed.
    """
    if memory is not None:
        material = replace(material, model=search_model(material.model, memory, is_rough))
    model = material.model
    texture = [row for row, geometry in enumerate(geometries) if isinstance(geometry, TextureQuantity)]
    spectral = [geometry for geometry in geometries if not isinstance(geometry, TextureQuantity)]
    by_angle = [geometry for geometry in spectral if geometry.kind != "aspecular"]
    rows = [row for row, geometry in enumerate(geometries) if geometry.kind == "aspecular"]
    wi, wo = aspecular_pairs([geometries[row] for row in rows])
    few = None
    if rows and memory is not None and wavelengths_nm is not None:
        few = _direct_values(model, wi, wo, wavelengths_nm)
    bsdf: Bsdf | None = None
    if rows and few is None:
        bsdf = model.bsdf(wavelengths_nm)
        wavelengths_nm = bsdf.wavelengths_nm
    spectra, bsdf = _spectra(material, by_angle, wavelengths_nm, bsdf, seed)
    grid = next(iter(spectra.values())).wavelengths_nm if spectra else np.asarray(wavelengths_nm)
    factors = np.zeros((len(geometries), len(grid)))
    error: Array | None = None
    missing = []
    for row, geometry in enumerate(geometries):
        if geometry.kind == "aspecular" or row in texture:
            continue
        value = spectrum_at(spectra[geometry.polarisation], geometry)
        if value is None:
            missing.append(geometry)
        else:
            factors[row] = value
    if few is not None:
        factors[rows] = np.pi * few
    elif rows:
        assert bsdf is not None
        if all(lobe.is_delta for lobe in bsdf.lobes):
            missing += [geometries[row] for row in rows]
        values, deviation, own = evaluate_for_colours(bsdf, wi, wo, samples=samples, seed=seed)
        factors[rows] = np.pi * on_wavelengths(values, own, grid)
        if deviation is not None:
            error = np.zeros_like(factors)
            error[rows] = np.pi * deviation
    if texture:
        quantities = [geometry for geometry in geometries if isinstance(geometry, TextureQuantity)]
        numbers, deviations = texture_values(material, quantities, seed, "final" if memory is None else "search")
        factors[texture] = numbers[:, None]
        if error is not None:
            error[texture] = deviations[:, None]
    return Measurement(grid, factors, error, frozenset(missing))


def _direct_values(model: Any, wi: Array, wo: Array, wavelengths_nm: Array) -> Array | None:
    """Return `values_at`, integrated over orders that are narrower than the wavelength steps."""
    own = line_wavelengths(wavelengths_nm, narrowest_line_nm(model))
    values = values_at(model, wi, wo, own)
    return None if values is None else on_wavelengths(values, own, wavelengths_nm)


def surrogate_factors(
    material: Material, geometries: Sequence[Geometry], wavelengths_nm: Array, is_fine: bool = True
) -> tuple[Array, Array] | None:
    """Return exact and approximate factors `[geometry, wavelength]` of a random walk's noise-free surrogate.

    Numbers of texture belong to the exact part.

    Returns:
        None without a surrogate, or if a geometry is neither aspecular nor a `TextureQuantity`.
    """
    texture = [row for row, geometry in enumerate(geometries) if isinstance(geometry, TextureQuantity)]
    rows = [row for row, geometry in enumerate(geometries) if geometry.kind == "aspecular"]
    if len(texture) + len(rows) < len(geometries):
        return None
    wi, wo = aspecular_pairs([geometries[row] for row in rows])
    radiance = surrogate_radiance(material.model, wi, wo, wavelengths_nm, is_fine)
    if radiance is None:
        return None
    exact, rest = np.zeros((2, len(geometries), len(wavelengths_nm)))
    exact[rows], rest[rows] = np.pi * radiance[0], np.pi * radiance[1]
    if texture:
        quantities = [geometry for geometry in geometries if isinstance(geometry, TextureQuantity)]
        exact[texture] = texture_values(material, quantities, 0, "search" if is_fine else "scout")[0][:, None]
    return exact, rest


def _spectra(
    material: Material, geometries: Sequence[Geometry], wavelengths_nm: Array | None, bsdf: Bsdf | None, seed: int
) -> tuple[dict[str, Spectrum], Bsdf | None]:
    """Return the spectra of each polarisation at the angles of its geometries."""
    spectra: dict[str, Spectrum] = {}
    for state in sorted({at.polarisation for at in geometries}):
        rows = [at for at in geometries if at.polarisation == state]
        if state == "both":
            spectra[state], bsdf = _spectrum(material, rows, wavelengths_nm, bsdf, seed)
        else:
            angles = np.unique([at.theta_deg for at in rows])
            spectra[state] = material.spectrum(np.radians(angles), wavelengths_nm, state, seed=seed)
    return spectra, bsdf


def _spectrum(
    material: Material, geometries: Sequence[Geometry], wavelengths_nm: Array | None, bsdf: Bsdf | None, seed: int
) -> tuple[Spectrum, Bsdf | None]:
    """Return the spectrum at the angles; diffuse light is integrated only if required."""
    angles = np.unique([geometry.theta_deg for geometry in geometries])
    spectrum = material.model.spectrum(np.radians(angles), wavelengths_nm, "both", seed)
    if spectrum is not None:
        return spectrum, bsdf
    bsdf = material.model.bsdf(wavelengths_nm) if bsdf is None else bsdf
    needs_diffuse = any(geometry.kind in ("diffuse", "hemispherical") for geometry in geometries)
    return bsdf_spectrum(bsdf, np.radians(angles), seed=seed, diffuse=needs_diffuse), bsdf


def search_wavelengths(material: Material, lamps: Sequence[str]) -> Array:
    """Return a search's wavelengths: the material defaults, and the lines of the lamps.

    Slow materials use the coarse grid of reports; the merit function interpolates it by splines.
    """
    grid = material.model.wavelengths_nm
    if not material.model.traits.is_quick:
        coarse = WALK_NM[(WALK_NM >= grid[0]) & (WALK_NM <= grid[-1])]
        grid = coarse if len(coarse) < len(grid) and spans_colour(coarse) else grid
    return with_lines(grid, lamps)


def evaluation_wavelengths(material: Material, lamps: Sequence[str]) -> Array:
    """Return the final evaluation wavelengths: steps of 1 nm for quick materials, else the material defaults."""
    own = with_lines(material.model.wavelengths_nm, lamps)
    return np.union1d(own, default_wavelengths(step_nm=EVALUATION_STEP_NM)) if material.model.traits.is_quick else own


def with_lines(grid: Array, lamps: Sequence[str]) -> Array:
    """Return a grid that also samples the lines of narrow-band lamps."""
    for lamp in lamps:
        if len(lamp_lines_nm(lamp)):
            grid = with_lamp_lines(grid, lamp)
    return np.asarray(grid)


def why_missing(material: Material, geometry: Geometry) -> str:
    """Return the reason for a missing signal."""
    noun = material.model.traits.noun
    return {
        "specular": f"this {noun} has no specular reflection",
        "transmitted": f"this {noun} has no specular transmission",
        "diffuse": f"this {noun} has no diffuse reflection",
        "hemispherical": f"this {noun} reflects nothing",
        "aspecular": f"this {noun} reflects into the mirror direction only",
    }[geometry.kind]


def check_answers(materials: Sequence[Material], geometries: Sequence[Geometry], where: Sequence[str]) -> None:
    """Refuse a geometry at which every given material lacks a signal.

    Args:
        materials: the recipe and variants of it.
        where: file and key of each geometry, for messages.

    Raises:
        RecipeError: naming the target.
        NacreError: the first material cannot be computed.
    """
    texture = [place for at, place in zip(geometries, where, strict=True) if isinstance(at, TextureQuantity)]
    if texture:
        check_texture(materials[0], texture[0])
    open_: set[Geometry] = {at for at in geometries if not isinstance(at, TextureQuantity)}
    if not open_:
        return
    for number, material in enumerate(materials):
        try:
            open_ &= missing_geometries(material, geometries)
        except UnsupportedError as error:
            if number == 0:
                raise RecipeError(f"{where[0]}: {error}") from None
        if not open_:
            return
    for geometry, place in zip(geometries, where, strict=True):
        if geometry in open_:
            raise RecipeError(f'{place} = "{geometry}" is not possible: {why_missing(materials[0], geometry)}')


def missing_geometries(material: Material, geometries: Sequence[Geometry]) -> frozenset[Geometry]:
    """Return the geometries at which a material lacks signal, without Monte Carlo.

    Raises:
        NacreError: the material cannot be computed.
    """
    geometries = [geometry for geometry in geometries if not isinstance(geometry, TextureQuantity)]
    probe = _probe(material)
    if material.model.traits.is_quick:
        return simulate_measurement(material, geometries, probe).missing
    by_angle = [geometry for geometry in geometries if geometry.kind != "aspecular"]
    angles = np.radians([geometry.theta_deg for geometry in by_angle])
    spectrum = material.model.spectrum(angles, probe, "both", 0) if by_angle else None
    missing = [geometry for geometry in by_angle if spectrum is not None and spectrum_at(spectrum, geometry) is None]
    if spectrum is None:
        bsdf = material.model.bsdf(probe)
        spreads = any(not lobe.is_delta for lobe in bsdf.lobes)
        missing += [geometry for geometry in geometries if geometry.kind in ("aspecular", "diffuse") and not spreads]
        if by_angle:
            mirror = bsdf_spectrum(bsdf, angles, diffuse=False)
            missing += [
                geometry
                for geometry in by_angle
                if geometry.kind in ("specular", "transmitted") and spectrum_at(mirror, geometry) is None
            ]
    return frozenset(missing)


def _probe(material: Material) -> Any:
    grid = np.asarray(material.model.wavelengths_nm)
    return grid[:: max(1, len(grid) // 3)]
