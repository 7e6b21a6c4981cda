"""Export and import: which format holds what of a material, and what of it is lost, said in words."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nacre._version import __version__
from nacre.bsdf import Bsdf
from nacre.bsdf.table import TableLobe, directions_of
from nacre.errors import NacreError, UnsupportedError
from nacre.exchange.gonio_csv import GonioData, read_gonio_csv, write_gonio_csv
from nacre.exchange.merl import SHAPE, merl_table, read_merl, write_merl
from nacre.files import write_text
from nacre.light import default_wavelengths, spectrum_to_rgb_matrix
from nacre.recipe import Material, dump_toml

Array = NDArray[np.float64]
MAX_F0 = 0.96  # a real index of 98, which a recipe still takes; a perfect mirror would need an endless one
TENSOR_MAGIC = b"tensor_file\0"
IMPORTS = ".csv (goniometer), .binary (MERL), .bsdf (RGL tensor or Zemax), .gltf, .mtlx"
TABLE_NODES = (46, 46, 37)  # theta_i, theta_o, dphi of a table made from scattered measurements


def export_material(
    material: Material, target: str, path: Path, *, angle_step_deg: float = 10.0, wavelength_nm: float | None = None
) -> dict[str, Any]:
    """Write a material in a foreign format.

    Args:
        target: "rgl", "merl", "csv", "zemax", "gltf", "materialx", "exr" or "nacre".
        angle_step_deg: of the csv's direction grid.
        wavelength_nm: for a monochrome zemax file.

    Returns:
        what was written: `lost` lists in words what the format cannot hold.

    Raises:
        UnsupportedError: the format can hold nothing of the material.
        NacreError: the file cannot be written.
    """
    comment = f"nacre {__version__}, {material.name}\n{material.context.text}"
    facts: dict[str, Any] = {"format": target, "file": str(path), "lost": []}
    if target in ("gltf", "materialx"):
        return facts | _export_film(material, target, path)
    bsdf = material.bsdf()
    if target == "nacre":
        bsdf.save(path)
    elif target == "rgl":
        from nacre.exchange.rgl_tensor import write_rgl

        facts["lost"] = write_rgl(path, bsdf, comment, is_isotropic=is_isotropic(bsdf))
    elif target == "merl":
        if not is_isotropic(bsdf):
            facts["lost"].append("anisotropy: MERL holds isotropic materials, phi = 0 was taken")
        write_merl(path, merl_table(bsdf))
        facts["lost"] += ["the spectrum: MERL holds linear RGB"] + _lost_parts(bsdf)
    elif target == "zemax":
        from nacre.exchange.zemax import write_zemax, zemax_table

        write_zemax(path, zemax_table(bsdf, wavelength_nm), comment)
        facts["lost"] = _lost_parts(bsdf)
    elif target == "csv":
        write_gonio_csv(path, gonio_grid(bsdf, angle_step_deg), comment)
        facts["lost"] = _delta_lost(bsdf)
    elif target == "exr":
        from nacre.exchange.slice_exr import write_slice

        write_slice(path, bsdf, comment)
        facts["lost"] = ["all but one slice over (theta_half, theta_diff)"] + _lost_parts(bsdf)
    return facts


def _export_film(material: Material, target: str, path: Path) -> dict[str, Any]:
    from nacre.study.thin_film_fit import fit_thin_film

    fit = fit_thin_film(material)
    provenance = {"nacre": __version__, "recipe": material.context.text, "residual_delta_e_2000": fit.mean_residual}
    if target == "gltf":
        from nacre.exchange.gltf import write_gltf

        write_gltf(path, fit.film, material.name, provenance)
    else:
        from nacre.exchange.materialx import write_materialx

        write_materialx(path, fit.film, material.name, f"nacre {__version__}, residual dE00 {fit.mean_residual:.2f}")
    return {
        "film": dict(fit.film.__dict__), "lost": list(fit.lost), "angles_deg": fit.angles_deg.tolist(),
        "residual_delta_e_2000": fit.mean_residual, "residual_by_angle": fit.residual.tolist(),
    }  # fmt: skip


def is_isotropic(bsdf: Bsdf) -> bool:
    """Whether turning both directions about the normal changes nothing, tested at a few pairs."""
    from nacre.bsdf.hemisphere import direction

    theta_i, theta_o, dphi = (np.radians(v) for v in ([20.0, 50.0, 70.0], [35.0, 45.0, 60.0], [180.0, 150.0, 90.0]))
    values = [
        bsdf.evaluate(direction(theta_i, turn), direction(theta_o, dphi + turn)) for turn in np.radians([0, 31, 77, 90])
    ]
    scale = max(float(np.max(values)), 1e-30)
    return bool(np.ptp(np.stack(values), axis=0).max() <= 1e-4 * scale)


def _lost_parts(bsdf: Bsdf) -> list[str]:
    return _delta_lost(bsdf) + (["transmission and the lower side"] if bsdf.transmits else [])


def _delta_lost(bsdf: Bsdf) -> list[str]:
    delta = bsdf.specular(np.radians([0.0, 45.0, 80.0]))
    has = max(float(delta.reflectance.max()), float(delta.transmittance.max())) > 1e-6
    return ["the mirror-like (delta) part"] if has else []


def gonio_grid(bsdf: Bsdf, step_deg: float) -> GonioData:
    """Evaluate a Bsdf on a regular grid of directions, both sides where it transmits.

    Raises:
        UnsupportedError: nothing but deltas, or a stochastic lobe.
    """
    if any(lobe.is_stochastic for lobe in bsdf.lobes):
        raise UnsupportedError('a gonio table needs arrays, not a random walk; set quality = "fast" in the recipe')
    if all(lobe.is_delta for lobe in bsdf.lobes):
        raise UnsupportedError("a gonio table cannot hold a smooth material: mirror directions are delta functions")
    theta = np.arange(0.0, 90.0, step_deg)
    theta_out = np.concatenate([theta, 180.0 - theta[::-1]]) if bsdf.transmits else theta
    phi_i = np.zeros(1) if is_isotropic(bsdf) else np.arange(0.0, 180.0, max(step_deg, 15.0))
    phi_o = np.arange(0.0, 360.0, step_deg)
    grids = np.meshgrid(theta, phi_i, theta_out, phi_o, indexing="ij")
    data = GonioData(np.stack([g.ravel() for g in grids], axis=-1), bsdf.wavelengths_nm, np.zeros((0, 0)))
    return GonioData(data.angles_deg, bsdf.wavelengths_nm, bsdf.evaluate(data.wi, data.wo))


def import_material(source: Path, recipe: Path) -> list[str]:
    """Read a foreign file and write a recipe (and, for tables, a `.nacre` file beside it).

    Returns:
        remarks, in words.

    Raises:
        NacreError: the file is none of the known formats, or is damaged.
    """
    if not source.is_file():
        raise NacreError(f"{source}: does not exist")
    suffix = source.suffix.lower()
    if suffix in (".gltf", ".mtlx"):
        return _import_film(source, recipe)
    if suffix == ".csv":
        lobe, remarks = gonio_table(read_gonio_csv(source), str(source))
    elif suffix == ".binary":
        lobe, remarks = merl_lobe(read_merl(source)), ["RGB was given smooth spectra that have its colours under D65"]
    elif suffix == ".bsdf":
        lobe, remarks = _import_bsdf(source)
    else:
        raise NacreError(f"{source}: is of no known format; nacre imports {IMPORTS}")
    stored = recipe.with_suffix(".nacre")
    Bsdf((lobe,), {"nacre": __version__, "imported": source.name}).save(stored)
    write_text(recipe, dump_toml({"family": "measured", "file": stored.name}))
    return [*remarks, str(stored)]


def _import_film(source: Path, recipe: Path) -> list[str]:
    if source.suffix.lower() == ".gltf":
        from nacre.exchange.gltf import read_gltf

        film = read_gltf(source)
    else:
        from nacre.exchange.materialx import read_materialx

        film = read_materialx(source)
    remarks = []
    base = film.base_ior
    if film.is_metal:
        f0 = min(max(float(np.dot(film.base_rgb, (0.2126, 0.7152, 0.0722))), 0.0), MAX_F0)
        base = (1 + f0**0.5) / (1 - f0**0.5)
        remarks.append("the metal's RGB became one real index of the same luminance; name the metal for its own colour")
    if film.not_read:
        remarks.append(f"not carried over: {', '.join(film.not_read)}")
    # a metal lets nothing through: a trace of absorption makes the base opaque without changing its reflection
    substrate = {"n": base} if film.transmits else {"n": base, "k": 1e-4}
    data: dict[str, Any] = {
        "family": "film", "ambient": "air", "substrate": substrate,
        "layers": [{"material": {"n": film.film_ior}, "thickness_nm": film.thickness_nm}],
        "surface": {"distribution": "ggx", "roughness": film.roughness},
    }  # fmt: skip
    write_text(recipe, dump_toml(data))
    return remarks


def _import_bsdf(source: Path) -> tuple[TableLobe, list[str]]:
    with open(source, "rb") as file:
        is_tensor = file.read(len(TENSOR_MAGIC)) == TENSOR_MAGIC
    if is_tensor:
        from nacre.exchange.rgl_reader import RglBsdf

        rgl = RglBsdf.read(source)
        wi, wo = directions_of("half", (90, 46, 24))
        return TableLobe(rgl.wavelengths_nm, rgl.evaluate(wi, wo), np.eye(len(rgl.wavelengths_nm)), "half"), []
    from nacre.exchange.zemax import read_zemax
    from nacre.study.zemax_table import zemax_lobe

    return zemax_lobe(read_zemax(source)), ["the table holds no spectrum beyond its channels"]


def rgb_basis(wavelengths_nm: Array) -> Array:
    """Return the smoothest three spectra that have the linear sRGB colours (1,0,0), (0,1,0), (0,0,1) under D65.

    Smooth in the sense of the summed squared second differences; they may dip below zero, which the table's
    evaluation cuts, and they sum to a flat spectrum up to that smoothness.
    """
    matrix = np.asarray(spectrum_to_rgb_matrix(wavelengths_nm))
    matrix = matrix if matrix.shape[0] == 3 else matrix.T
    count = len(wavelengths_nm)
    second = np.diff(np.eye(count), 2, axis=0)
    # a little stiffness against size keeps the ends, where the eye is blind, from drifting off
    stiffness = second.T @ second + 1e-6 * np.eye(count)
    inverse = np.linalg.inv(stiffness)
    return np.asarray((inverse @ matrix.T @ np.linalg.inv(matrix @ inverse @ matrix.T)).T)


def merl_lobe(rgb: Array) -> TableLobe:
    """Return the table of a MERL measurement, its bins taken as samples at their centres."""
    wavelengths = default_wavelengths()
    half, diff, phi = (np.linspace(0, 1, n) for n in SHAPE)
    values = rgb
    for axis, nodes in enumerate((half, diff, phi)):
        n = SHAPE[axis]
        place = np.clip(nodes * n - 0.5, 0, n - 1)
        low = np.minimum(place.astype(int), n - 2)
        share = (place - low).reshape([-1 if i == axis else 1 for i in range(4)])
        values = np.take(values, low, axis=axis) * (1 - share) + np.take(values, low + 1, axis=axis) * share
    return TableLobe(wavelengths, values, rgb_basis(wavelengths), "half")


def gonio_table(data: GonioData, name: str) -> tuple[TableLobe, list[str]]:
    """Return a table through the points of a measurement, and remarks.

    Regular grids are interpolated linearly in theta_i, theta_o and |dphi|; scattered points by their nearest
    neighbours, weighted by the inverse square of the distance.

    Raises:
        NacreError: fewer than four pairs lie above the surface.
    """
    theta_i, phi_i, theta_o, phi_o = data.angles_deg.T
    up = (theta_i < 90) & (theta_o < 90)
    remarks = [] if np.all(up) else [f"{int(np.sum(~up))} pairs of the other side were left out"]
    if np.sum(up) < 4:
        raise NacreError(f"{name}: holds {int(np.sum(up))} direction pairs above the surface; at least 4 are needed")
    dphi = np.abs((phi_o - phi_i + 180.0) % 360.0 - 180.0)
    points = np.stack([theta_i, theta_o, dphi], axis=-1)[up]
    axes = [np.unique(np.round(points[:, i], 6)) for i in range(3)]
    values = data.values[up]
    grid = [np.linspace(0, limit, n) for limit, n in zip((90.0, 90.0, 180.0), TABLE_NODES, strict=True)]
    if np.prod([len(a) for a in axes]) <= len(points) and min(len(a) for a in axes) > 1:
        table = _regular(points, axes, values, grid)
    else:
        remarks.append("the directions form no grid; values between them come from the nearest ones")
        table = _scattered(points, values, grid)
    return TableLobe(data.wavelengths_nm, table, np.eye(values.shape[1])), remarks


def _regular(points: Array, axes: list[Array], values: Array, grid: list[Array]) -> Array:
    from scipy.interpolate import RegularGridInterpolator

    total = np.zeros((*(len(a) for a in axes), values.shape[1]))
    count = np.zeros(total.shape[:3])
    place = tuple(np.searchsorted(a, np.round(points[:, i], 6)) for i, a in enumerate(axes))
    np.add.at(total, place, values)  # pairs that differ by a mirror of the plane are averaged
    np.add.at(count, place, 1)
    interpolate = RegularGridInterpolator(axes, total / np.maximum(count, 1)[..., None])
    inside = [np.clip(g, a[0], a[-1]) for g, a in zip(grid, axes, strict=True)]
    return np.asarray(interpolate(np.stack(np.meshgrid(*inside, indexing="ij"), axis=-1)))


def _scattered(points: Array, values: Array, grid: list[Array]) -> Array:
    from scipy.spatial import cKDTree

    nodes = np.stack(np.meshgrid(*grid, indexing="ij"), axis=-1).reshape(-1, 3)
    found = cKDTree(points).query(nodes, k=min(8, len(points)))
    distance, index = np.asarray(found[0]), np.asarray(found[1])
    weight = 1.0 / (distance**2 + 1e-6)
    weight = weight / weight.sum(axis=1, keepdims=True)
    return np.asarray(np.einsum("nk,nkw->nw", weight, values[index]).reshape(*(len(g) for g in grid), -1))
