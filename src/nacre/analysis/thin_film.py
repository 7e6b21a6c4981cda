"""Fit of a single thin film for real-time renderers to a material, with its residual.

The fit compares colours under D65: the specular colours of the material over the incidence angle and those of one
film of constant index on a base of constant index (dielectric) or of constant reflectance per channel (metal). The
spectral approximation of the renderer adds to the residual.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from nacre.analysis.lut import map_over_uv
from nacre.bsdf import Bsdf
from nacre.bsdf.bsdf import Spectrum
from nacre.bsdf.lobes.masked import MaskedLobe
from nacre.bsdf.texture import ParameterAxis
from nacre.core.arrays import Array
from nacre.core.errors import UnsupportedError
from nacre.formats.foreign_materials import ThicknessMap
from nacre.formats.scene_files import ThinFilm
from nacre.light import delta_e_2000, lab_to_xyz, spectrum_to_xyz, srgb_linear_to_xyz, xyz_to_lab, xyz_to_srgb_linear
from nacre.material.material import Material, material_from_data

ANGLES_DEG = np.array([0.0, 15.0, 30.0, 45.0, 60.0, 75.0])
THICKNESSES_NM = np.concatenate([np.arange(0.0, 1000.0, 20.0), np.arange(1000.0, 2001.0, 40.0)])
INDICES = np.arange(1.1, 2.71, 0.1)
# kinds of lobes that the film represents
MIRRORS = ("specular", "aligned-specular", "microfacet", "aligned-microfacet")
LOWEST_INDEX, HIGHEST_INDEX = 1.0, 3.0
MAX_F0 = 0.98


@dataclass(frozen=True)
class ThinFilmFit:
    """The best film, its residual dE00 at `angles_deg`, and descriptions of lost properties."""

    film: ThinFilm
    angles_deg: Array
    residual: Array
    lost: tuple[str, ...]

    @property
    def mean_residual(self) -> float:
        """Mean dE00 over the angles."""
        return float(self.residual.mean())


def fit_thin_film(material: Material) -> ThinFilmFit:
    """Fit one film to a material's specular colours; a blend with its bare base is a share of the film.

    Raises:
        UnsupportedError: the material lacks a specular part, or is a blend.
    """
    covered = covered_share(material)
    if covered is not None:
        return _fit_share(material, *covered)
    bsdf = material.bsdf()
    if any(isinstance(lobe, MaskedLobe) for lobe in bsdf.lobes):
        raise UnsupportedError(
            f"{material.context.source}: mask blends materials over the surface; export each by itself, or "
            "use --to three or gltf"
        )
    spectrum, target = _mirror(material, 1e-6)
    grid, reflectance = spectrum.wavelengths_nm, spectrum.specular_reflectance
    transmittance = spectrum.specular_transmittance
    assert reflectance is not None
    transmits = transmittance is not None and float(transmittance.max()) > 1e-3
    candidates = [_fit_dielectric(target, grid, transmits)]
    if not transmits:  # a transmitting material stays a dielectric, even if a metal matches its reflection better
        candidates.insert(0, _fit_metal(target, reflectance, grid))
    film, residual = min(candidates, key=lambda c: float(c[1].mean()))
    film = ThinFilm(**{**film.__dict__, "roughness": _roughness(material)})
    return ThinFilmFit(film, ANGLES_DEG, residual, _lost(material, bsdf, film))


def covered_share(material: Material) -> tuple[float, Material] | None:
    """Return the share of a blend that a film covers, and the film, if the rest is its bare base; otherwise None."""
    data = material.data
    mask, first, second = (data.get(key) for key in ("mask", "first", "second"))
    if data.get("family") != "blend" or not isinstance(mask, int | float) or isinstance(mask, bool):
        return None
    if not isinstance(first, Mapping) or not isinstance(second, Mapping) or first.get("family") != "film":
        return None
    film, uncovered = ({k: v for k, v in part.items() if k != "layers"} for part in (first, second))
    if film != uncovered or second.get("layers") or not first.get("layers"):
        return None
    return float(mask), material_from_data(first, material.context)


def _fit_share(material: Material, share: float, covering: Material) -> ThinFilmFit:
    """Fit the film of a covered share, with the residual of the whole."""
    fit = fit_thin_film(covering)
    film = dataclasses.replace(fit.film, weight=share)
    spectrum, target = _mirror(material)
    grid = spectrum.wavelengths_nm
    coated, uncovered = (
        np.asarray(lab_to_xyz(film_lab(f, grid))) for f in (film, dataclasses.replace(film, thickness_nm=0.0))
    )
    residual = np.asarray(delta_e_2000(target, xyz_to_lab(share * coated + (1 - share) * uncovered)))
    return ThinFilmFit(film, ANGLES_DEG, residual, fit.lost)


def film_lab(film: ThinFilm, wavelengths_nm: Array) -> Array:
    """Return the Lab of a thin film's mirror direction at `ANGLES_DEG`, `[angle, 3]`."""
    if not film.is_metal:
        values = _reflectance(film.film_ior, film.thickness_nm, np.array(film.base_ior), wavelengths_nm)
        return np.asarray(xyz_to_lab(spectrum_to_xyz(values, wavelengths_nm)))
    root = np.sqrt(np.clip(film.base_rgb, 0.0, MAX_F0))
    bases = (1 + root) / (1 - root)  # real indices with these normal reflectances, which glTF renderers use for metals
    values = _reflectance(film.film_ior, film.thickness_nm, bases, wavelengths_nm)
    rgb = np.diagonal(xyz_to_srgb_linear(spectrum_to_xyz(values, wavelengths_nm)), axis1=0, axis2=2)
    return np.asarray(xyz_to_lab(srgb_linear_to_xyz(rgb)))


def _reflectance(n_film: float, thickness_nm: float, n_base: Array, wavelengths_nm: Array) -> Array:
    """Return Airy's unpolarised reflectance of a lossless film, `[..., angle, wavelength]`; `n_base` is `[...]`."""
    sine = np.sin(np.radians(ANGLES_DEG))
    indices = [np.ones(1), np.array([n_film]), n_base[..., None]]
    above, inside, below = (np.sqrt(1.0 - (sine / n) ** 2) for n in indices)
    phase = np.cos(4.0 * np.pi * n_film * thickness_nm * inside[:, None] / wavelengths_nm)
    total = np.zeros((*n_base.shape, *phase.shape))
    for power in (1, -1):  # s, p: admittances n cos and cos / n
        first, second, third = (n**power * c for n, c in zip(indices, (above, inside, below), strict=True))
        upper = ((first - second) / (first + second))[:, None]
        lower = ((second - third) / (second + third))[..., None]
        mixed = 2.0 * upper * lower * phase
        total += (upper**2 + lower**2 + mixed) / (1.0 + (upper * lower) ** 2 + mixed)
    return 0.5 * total


def _residual(film: ThinFilm, target: Array, grid: Array) -> Array:
    return np.asarray(delta_e_2000(target, film_lab(film, grid)))


def _fit_metal(target: Array, reflectance: Array, grid: Array) -> tuple[ThinFilm, Array]:
    mean = np.clip(np.asarray(xyz_to_srgb_linear(spectrum_to_xyz(reflectance[0], grid))), 0.02, MAX_F0)
    level = float(np.clip(mean.max(), 0.1, 0.95))

    def build(x: Array) -> ThinFilm:
        r, g, b = (float(np.clip(c, 0.0, MAX_F0)) for c in x[2:5])
        return ThinFilm(float(abs(x[0])), float(np.clip(x[1], LOWEST_INDEX, HIGHEST_INDEX)), (r, g, b), 1.5, True)

    starts = [np.array([d, n, *base]) for d in THICKNESSES_NM[::2] for n in (1.4, 2.0) for base in (mean, [level] * 3)]
    return _search(build, starts, target, grid)


def _fit_dielectric(target: Array, grid: Array, transmits: bool) -> tuple[ThinFilm, Array]:
    def build(x: Array) -> ThinFilm:
        base = float(np.clip(x[2], 1.0, HIGHEST_INDEX))
        n_film = float(np.clip(x[1], LOWEST_INDEX, HIGHEST_INDEX))
        return ThinFilm(float(abs(x[0])), n_film, (1.0, 1.0, 1.0), base, False, transmits=transmits)

    starts = [np.array([d, n, base]) for d in THICKNESSES_NM for n in INDICES[::2] for base in (1.0, 1.5)]
    return _search(build, starts, target, grid)


def _search(build: object, starts: list[Array], target: Array, grid: Array) -> tuple[ThinFilm, Array]:
    """Evaluate all starts and refine the best with Nelder-Mead, since dE00 is not smooth."""
    from scipy.optimize import minimize

    coarse = grid if len(grid) <= 48 else np.linspace(grid[0], grid[-1], 48)

    def loss(x: Array) -> float:
        return float(_residual(build(x), target, coarse).mean())  # type: ignore[operator]  # one of two closures

    ranked = sorted(starts, key=loss)[:4]
    polished = [minimize(loss, x, method="Nelder-Mead", options={"maxiter": 400, "xatol": 1e-4}).x for x in ranked]
    best = min([*polished, ranked[0]], key=loss)
    film: ThinFilm = build(best)  # type: ignore[operator]  # as above
    return film, _residual(film, target, grid)


def _roughness(material: Material) -> float:
    """Return the geometric mean of the recipe's GGX alphas."""
    surface = material.data.get("surface", {})
    alpha = surface.get("roughness", 0.0) if isinstance(surface, dict) else 0.0
    values = np.atleast_1d(np.asarray(alpha, dtype=float)) if not isinstance(alpha, dict | str) else np.zeros(1)
    return float(np.sqrt(values[0] * values[-1]))


def _lost(material: Material, bsdf: Bsdf, film: ThinFilm) -> tuple[str, ...]:
    """Return descriptions of the properties that the format cannot represent."""
    lost = []
    others = dict.fromkeys(lobe.kind for lobe in bsdf.lobes if lobe.kind not in MIRRORS)
    if others:
        lost.append(f"scattered light is left out ({', '.join(others)})")
    if film.transmits:
        lost.append("the colour of transmitted light is left out")
    layers = material.data.get("layers", [])
    if isinstance(layers, list) and len(layers) > 1:
        lost.append(f"{len(layers)} layers became one film")
    if film.is_metal:
        lost.append("the base's complex index became one real index per colour channel")
    surface = material.data.get("surface", {})
    alpha = surface.get("roughness") if isinstance(surface, dict) else None
    if isinstance(alpha, list) and len(set(alpha)) > 1:
        lost.append("anisotropic roughness became isotropic")
    if material.data.get("ridges") or material.data.get("preset"):
        lost.append("the ridges' diffraction is left out")
    if isinstance(layers, list) and any(isinstance(x.get("thickness_nm"), dict) for x in layers if isinstance(x, dict)):
        lost.append("the thickness texture became its mean")
    lost.append("dispersion of the film's index is left out")
    return tuple(lost)


# The thickness map of one thin film for a material with a number that varies over the surface.
#
# Each value of the number has its own best film thickness; index and base are common. A picture holds any such
# function of the number, so the map is baked for the recipe's uv.

VALUES = 25  # values of the varying number
FITTED = (0.1, 0.5, 0.9)  # positions in its range at which index and base are fitted
STEP_NM = 4.0
THICKEST_NM = 1600.0
BANDS = 48  # wavelengths of the search
CONTINUITY = 0.02  # cost in dE00 per nm of thickness change between neighbouring values


@dataclass(frozen=True)
class ThicknessMapFit:
    """The film, its map, and the residual dE00.

    Attributes:
        fit: the fit with one value for the whole map.
        thickness: the map.
        values: the number.
        residual: mean over the angles, for each value.
        mean_residual: mean over the angles and the map.
    """

    fit: ThinFilmFit
    thickness: ThicknessMap
    values: Array
    residual: Array
    mean_residual: float


def varying_axis(material: Material) -> ParameterAxis | None:
    """Return the number that varies over the surface; None if none or several do."""
    axes = {axis.name: axis for lobe in material.bsdf().lobes for axis in getattr(lobe, "parameters", ())}
    return next(iter(axes.values())) if len(axes) == 1 else None


def fit_thickness_map(material: Material, axis: ParameterAxis) -> ThicknessMapFit:
    """Fit one film whose thickness follows the varying number of a material.

    Args:
        axis: from `varying_axis`.

    Raises:
        UnsupportedError: the material lacks a specular part, or is a blend.
    """
    low, high = float(axis.values[0]), float(axis.values[-1])
    values = np.linspace(low, high, VALUES)
    targets = np.stack([_mirror(material.vary({axis.name: float(value)}))[1] for value in values])
    fits = [fit_thin_film(material.vary({axis.name: low + (high - low) * part})) for part in FITTED]
    grid = np.linspace(400.0, 700.0, BANDS)
    best: tuple[float, ThinFilmFit, Array, Array] | None = None
    for fit in fits:
        thicknesses = np.arange(0.0, THICKEST_NM, STEP_NM)
        labs = np.stack([film_lab(dataclasses.replace(fit.film, thickness_nm=float(d)), grid) for d in thicknesses])
        cost = np.asarray(delta_e_2000(labs[None], targets[:, None])).mean(axis=-1)
        path = _path(cost)
        residual = cost[np.arange(VALUES), path]
        if best is None or residual.mean() < best[0]:
            best = float(residual.mean()), fit, thicknesses[path], residual
    assert best is not None
    _, fit, best_thicknesses, residual = best
    image = map_over_uv(axis)[::-1]
    unit = np.linspace(0.0, 1.0, VALUES)
    nm = np.interp(image, unit, best_thicknesses)
    least, most = float(best_thicknesses.min()), float(best_thicknesses.max())
    thickness = ThicknessMap(least, most, (nm - least) / max(most - least, 1e-9))
    return ThicknessMapFit(fit, thickness, values, residual, float(np.interp(image, unit, residual).mean()))


def _mirror(material: Material, least: float = 0.0) -> tuple[Spectrum, Array]:
    """Return the spectrum at `ANGLES_DEG` and the CIELAB of its mirror direction, `[angle, 3]`."""
    spectrum = material.spectrum(np.radians(ANGLES_DEG))
    reflectance = spectrum.specular_reflectance
    if reflectance is None or reflectance.max() < least:
        raise UnsupportedError(
            f"{material.context.source}: has no mirror-like reflection, so no thin film represents it"
        )
    return spectrum, np.asarray(xyz_to_lab(spectrum_to_xyz(reflectance, spectrum.wavelengths_nm)))


def _path(cost: Array) -> Array:
    """Return the thickness index of each value along the cheapest continuous path (Viterbi)."""
    count = cost.shape[1]
    change = CONTINUITY * STEP_NM * np.abs(np.arange(count)[:, None] - np.arange(count)[None])
    total, previous = cost[0], []
    for row in cost[1:]:
        candidates = total[:, None] + change
        previous.append(np.argmin(candidates, axis=0))
        total = candidates.min(axis=0) + row
    path = [int(np.argmin(total))]
    for back in reversed(previous):
        path.append(int(back[path[-1]]))
    return np.array(path[::-1])
