"""Export and import of materials, with a description of the lost properties.

The package for three.js holds the colour table, and colours under uniform light for light from all around.
"""

import contextlib
import functools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from nacre._version import __version__
from nacre.analysis.lut import STEEPEST, ClosureLoss, azimuths, make_table, over_uv, refuse_orders
from nacre.bsdf import Bsdf
from nacre.bsdf.lobes.table import TableLobe, directions_of
from nacre.bsdf.texture import Texture, refuse_place
from nacre.core.arrays import Array, direction
from nacre.core.errors import NacreError, UnsupportedError
from nacre.core.files import atomic_path, check_writable, size_of, write_text
from nacre.families.contract import Masked, OwnFormats
from nacre.formats import bsdf_tables, lut, measured_lobes
from nacre.formats.foreign_materials import ThicknessMap, read_gltf, read_materialx
from nacre.formats.number_maps import GREY, write_png_stream
from nacre.formats.scene_files import Cover, Part, materialx_document, write_gltf, write_materialx, write_usd
from nacre.light import default_wavelengths
from nacre.material.material import MAX_EXCESS, Material, MaterialLike, as_material, material_from_data
from nacre.measure.evaluate import tristimulus_of_pairs
from nacre.readers.bsdf import databases
from nacre.readers.bsdf.ray_tracers import read_zemax_table
from nacre.readers.measurement import ReadOptions
from nacre.readers.registry import recognise
from nacre.recipe.model import RecipeContext
from nacre.recipe.toml import dump_toml

SNIFFED_BYTES = 4096  # read from a file without a known suffix; comments may precede the root element
MAX_F0 = 0.96  # a real index of 98; a perfect mirror would need an infinite one
ENERGY_ANGLES_DEG = (0.0, 30.0, 60.0)
MOST_ENERGY = 4.0  # measurements exceed 1 by tens of per cent
ROUNDING = 1e-6  # relative to the largest value
LOST_OF_MESH = "the mesh file's own materials, nodes and animations: its triangles became one object"
LOST_OF_BLEND = (
    "one surface: the first material lies over the second as the same triangles with alpha, for renderers that "
    "composite in order; the share has 8 bits"
)
OF_VALUES = ("rgl", "merl", "zemax", "csv", "exr", "astm", "brdf-json", "speos")  # formats that evaluate the Bsdf
IMPORTS = (
    "goniometer tables, MERL, RGL tensor, Zemax, ASTM E1392, Speos, SSDD, TracePro, ALTA, UTIA, BRDF JSON, glTF, "
    "MaterialX"
)
RGB_REMARK = "RGB was given smooth spectra that have its colours under D65"


def export_material(
    thing: MaterialLike,
    to: str,
    output: str | Path,
    *,
    angle_step_deg: float = 10.0,
    wavelength_nm: float | None = None,
    illuminant: str = "D65",
    mesh: str | Path | None = None,
    progress: Callable[[str], None] = lambda what: None,
) -> dict[str, Any]:
    """Write a material in another program's format; `["lost"]` of the result lists lost properties.

    Args:
        thing: a material or a path.
        to: "rgl", "merl", "csv", "zemax", "astm", "brdf-json", "speos", "gltf", "materialx", "usd", "exr", "nacre",
            "tmat", or "lut" or "three" (folders).
        output: the file; for "three" and "lut" a folder, which is new, empty or holds such tables.
        angle_step_deg: step of the direction grid of csv, astm, brdf-json and speos.
        wavelength_nm: for a monochrome zemax file.
        illuminant: illuminant for colours in lut and three.
        mesh: for gltf, the object with the material: a mesh file (.gltf, .glb, .obj, .ply, .stl); default: a sphere.
        progress: called with a description of each step of lut and three.

    Raises:
        UnsupportedError: the format cannot represent the material, or a formula depends on the place on an object.
        NacreError: the file cannot be written.
    """
    target, path = to, Path(output)
    if target not in bsdf_tables.FOLDERS:
        check_writable(path)
    material = as_material(thing)
    refuse_place(material.model, f"{material.context.source}: export")
    comment = f"nacre {__version__}, {material.name}\n{material.text}"
    facts: dict[str, Any] = {"format": target, "file": str(path), "lost": []}
    if target == "tmat":
        return facts | {"lost": _export_tmatrix(material, path, comment)}
    if target == "lut":
        return facts | _export_table(material, path, illuminant, progress)
    if target == "three":
        return facts | export_three(material, path, illuminant, progress)
    if target in ("gltf", "materialx", "usd"):
        return facts | _export_film(material, target, path, mesh)
    bsdf = material.bsdf()
    if target in OF_VALUES and any(lobe.is_stochastic for lobe in bsdf.lobes):
        raise UnsupportedError(
            f"{material.context.source}: is a random walk, and a file of kind {target} holds values; give it "
            'quality = "fast" where the family has that (--set quality=fast), or export a lut'
        )
    colours = _line_colours(bsdf)
    if target == "nacre":
        bsdf.save(path)
    elif target == "rgl":
        facts["lost"] = bsdf_tables.write_rgl(path, bsdf, comment, is_isotropic=bsdf_tables.is_isotropic(bsdf))
    elif target == "merl":
        if not bsdf_tables.is_isotropic(bsdf):
            facts["lost"].append("anisotropy: MERL holds isotropic materials, phi = 0 was taken")
        bsdf_tables.write_merl(path, bsdf_tables.merl_table(bsdf, colours=colours))
        facts["lost"] += ["the spectrum: MERL holds linear RGB"] + bsdf_tables.lost_parts(bsdf)
    elif target == "zemax":
        bsdf_tables.write_zemax(path, bsdf_tables.zemax_table(bsdf, wavelength_nm, colours=colours), comment)
        facts["lost"] = bsdf_tables.lost_parts(bsdf)
    elif target == "csv":
        measured_lobes.write_gonio_csv(path, bsdf_tables.gonio_grid(bsdf, angle_step_deg), comment)
        facts["lost"] = bsdf_tables.unresolved_lost(bsdf)
    elif target in ("astm", "brdf-json", "speos"):
        facts["lost"] = _export_measured(bsdf, target, path, angle_step_deg, material.name, comment)
    elif target == "exr":
        bsdf_tables.write_slice(path, bsdf, comment, colours)
        facts["lost"] = ["all but one slice over (theta_half, theta_diff)"] + bsdf_tables.lost_parts(bsdf)
    return facts | {"lost": facts["lost"] + bsdf_tables.lines_lost(bsdf, target)}


def _line_colours(bsdf: Bsdf) -> bsdf_tables.Colours | None:
    """Return the colours of narrow orders, integrated over wavelength; None for other materials."""
    is_narrow = bool(bsdf_tables.narrow_lost(bsdf))
    return functools.partial(tristimulus_of_pairs, bsdf, illuminant="D65") if is_narrow else None


def _export_tmatrix(material: Material, path: Path, comment: str) -> list[str]:
    """Write the T-matrix of a metasurface's particles and return the lost properties."""
    model = material.model
    writer = model.own_formats.get("tmat") if isinstance(model, OwnFormats) else None
    if writer is None:
        raise UnsupportedError(
            f"{material.context.source}: a {model.traits.noun} has no T-matrix; tmat is for the particles of "
            "metasurfaces"
        )
    return writer(path, comment)


def _export_measured(bsdf: Bsdf, target: str, path: Path, step_deg: float, name: str, comment: str) -> list[str]:
    """Write a direction grid in a format of measurements and return the lost properties."""
    lost, data = bsdf_tables.unresolved_lost(bsdf), bsdf_tables.gonio_grid(bsdf, step_deg)
    if target == "speos":
        is_first = data.angles_deg[:, 1] == data.angles_deg[0, 1]
        if not np.all(is_first):
            lost.append("anisotropy: azimuth 0 of the light was taken")
        data = measured_lobes.GonioData(data.angles_deg[is_first], data.wavelengths_nm, data.values[is_first])
        measured_lobes.write_speos(path, data, comment)
        return lost
    if bsdf.transmits:
        lost.append("transmission and the lower side")
        up = data.angles_deg[:, 2] < 90
        data = measured_lobes.GonioData(data.angles_deg[up], data.wavelengths_nm, data.values[up])
    if target == "astm":
        measured_lobes.write_astm(path, data, comment)
    else:
        measured_lobes.write_brdf_json(path, data, name, comment)
    return lost


def _export_table(material: Material, folder: Path, illuminant: str, progress: Callable[[str], None]) -> dict[str, Any]:
    lut.check_folder(folder)
    table = make_table(material, illuminant, progress)
    files = lut.write_table(folder, table)
    return {
        "illuminant": table.illuminant, "lost": list(table.lost), "files": [path.name for path in files],
        "errors_dE00": {what: dict(values) for what, values in table.errors.items()},
    }  # fmt: skip


def _export_film(material: Material, target: str, path: Path, mesh: str | Path | None) -> dict[str, Any]:
    """Write the best-fitting thin film; in glTF on a mesh, with a thickness map if a number varies."""
    from nacre.analysis.thin_film import covered_share, fit_thickness_map, fit_thin_film, varying_axis

    if target == "usd" and path.suffix.lower() in (".usdc", ".usdz"):
        raise UnsupportedError(f"{path}: USD is written as text; allowed: a name that ends in .usda or .usd")
    parts = [] if mesh is None else _mesh_parts(Path(mesh))
    if target == "gltf" and isinstance(material.model, Masked) and covered_share(material) is None:
        return _export_blend(material, material.model, path, parts)
    axis = varying_axis(material) if target == "gltf" else None
    mapped = None if axis is None else fit_thickness_map(material, axis)
    fit = mapped.fit if mapped else fit_thin_film(material)
    residual = mapped.mean_residual if mapped else fit.mean_residual
    film = {key: value for key, value in fit.film.__dict__.items() if key != "thickness_map"}
    facts = {
        "film": film, "lost": list(fit.lost), "angles_deg": fit.angles_deg.tolist(),
        "residual_delta_e_2000": residual, "residual_by_angle": fit.residual.tolist(),
    }  # fmt: skip
    if mapped and axis:
        del facts["residual_by_angle"]
        facts |= {
            "lost": [part for part in fit.lost if "texture" not in part],
            "thickness_map": {
                "low_nm": mapped.thickness.low_nm, "high_nm": mapped.thickness.high_nm, "number": axis.name,
                "values": mapped.values.tolist(), "residual_by_value": mapped.residual.tolist(),
            },
        }  # fmt: skip
    provenance = {"nacre": __version__, "recipe": material.text, "residual_delta_e_2000": residual}
    comment = f"nacre {__version__}, residual dE00 {residual:.2f}"
    if target == "gltf":
        write_gltf(path, fit.film, material.name, provenance, parts, mapped.thickness if mapped else None)
    elif target == "usd":
        write_usd(path, materialx_document(fit.film, material.name), comment)
    else:
        write_materialx(path, fit.film, material.name, comment)
    if mesh is not None:
        facts["lost"].append(LOST_OF_MESH)
    return facts


def _export_blend(material: Material, blend: Masked, path: Path, parts: list[Any]) -> dict[str, Any]:
    """Write the best-fitting film of each material of a blend, the first one over the second by its share.

    Raises:
        UnsupportedError: no film represents one of them, or one is a blend.
    """
    from nacre.analysis.thin_film import fit_thin_film

    fits = []
    for name, part in (("first", blend.first), ("second", blend.second)):
        with _part_of_blend(name):
            fits.append(fit_thin_film(part))
    over, under = fits
    share = _share(blend.mask)
    mean = share.mean
    residual = mean * over.mean_residual + (1.0 - mean) * under.mean_residual
    named = zip((blend.first, blend.second), (over, under), (mean, 1.0 - mean), strict=True)
    facts = {
        "parts": [
            {"name": part.name, "mean_share": weight, "film": dict(fit.film.__dict__),
             "residual_delta_e_2000": fit.mean_residual, "lost": list(fit.lost)}
            for part, fit, weight in named
        ],
        "lost": [*dict.fromkeys((*over.lost, *under.lost)), LOST_OF_BLEND, *([LOST_OF_MESH] if parts else [])],
        "residual_delta_e_2000": residual,
    }  # fmt: skip
    provenance = {"nacre": __version__, "recipe": material.text, "residual_delta_e_2000": residual}
    cover = Cover(over.film, blend.first.name, mean if share.map is None else share.map)
    write_gltf(path, under.film, blend.second.name, provenance, parts, cover=cover)
    return facts


@contextlib.contextmanager
def _part_of_blend(name: str) -> Iterator[None]:
    """Name the part of a blend in its errors."""
    try:
        yield
    except UnsupportedError as error:
        raise UnsupportedError(f"the part {name} of the blend: {error}; export the other part alone") from None


def _mesh_parts(mesh: Path) -> list[Any]:
    """Return the triangles of a mesh file, y up.

    Raises:
        NacreError: the file is missing, damaged, empty or too large.
    """
    from nacre.picture.subjects import TO_Z_UP, read_mesh

    read = read_mesh(mesh)
    turn = TO_Z_UP["y"]
    return [Part(read.vertices @ turn, read.normals @ turn, read.uv, read.faces)]


def import_material(
    source: Path, recipe: Path, *, options: ReadOptions | None = None, law: str | None = None
) -> list[str]:
    """Read a file of another program and write a recipe, and for tables a `.nacre` file beside it.

    Args:
        options: properties of a measurement that the file does not state.
        law: extrapolation of a scan in the plane of incidence; see `nacre.formats.measured_lobes.LAWS`.

    Returns:
        remarks.

    Raises:
        NacreError: the file has an unknown format or is damaged.
        UnsupportedError: a measurement that is not a BRDF of an isotropic sample.
    """
    size_of(source)  # refuses a missing file
    if source.suffix.lower() in (".gltf", ".glb", ".mtlx") or _is_materialx(source):
        return _import_film(source, recipe, (options or ReadOptions()).spectrum)
    try:
        lobe, remarks = _import_bsdf(source, options or ReadOptions(), law)
    except UnsupportedError as error:
        raise error if str(source) in str(error) else UnsupportedError(f"{source}: {error}") from None
    remarks = [*remarks, *_check_energy(source, lobe)]
    stored = recipe.with_suffix(".nacre")
    Bsdf((lobe,), {"nacre": __version__, "imported": source.name}).save(stored)
    write_text(recipe, dump_toml({"family": "measured", "file": stored.name}))
    return [*remarks, str(stored)]


def _is_materialx(source: Path) -> bool:
    """Whether the root element of a file is that of a MaterialX document."""
    try:
        with open(source, "rb") as file:
            return b"<materialx" in file.read(SNIFFED_BYTES)
    except OSError:
        return False


def _check_energy(source: Path, lobe: TableLobe) -> list[str]:
    """Return a remark if reflectance and transmittance exceed the incident light.

    Raises:
        NacreError: an impossible value, or a sum beyond any measurement error.
    """
    low, high = float(lobe.values.min()), float(lobe.values.max())
    is_spectral = lobe.values.shape[-1] != 3  # colour channels of a measurement may be negative
    if not np.isfinite(low + high) or (is_spectral and low < -ROUNDING * high) or high > measured_lobes.MAX_VALUE:
        raise NacreError(f"{source}: holds BSDF values below 0 or beyond {measured_lobes.MAX_VALUE:g}; none has them")
    for angle in ENERGY_ANGLES_DEG:
        sums = np.sum(lobe.hemispherical(direction(np.radians(angle))), axis=0)
        worst, nm = float(sums.max()), lobe.wavelengths_nm[int(np.argmax(sums))]
        if worst > MOST_ENERGY:
            raise NacreError(
                f"{source}: sends out {worst:.3g} times the light that arrives at {angle:g} degrees ({nm:g} nm); "
                "is it in per cent, or multiplied by something?"
            )
        if worst > 1.0 + MAX_EXCESS:
            where = f"at {angle:g} degrees ({nm:g} nm)"
            return [f"sends out {worst:.3g} times the light that arrives {where}; kept as it is"]
    return []


def _import_film(source: Path, recipe: Path, name: str | None = None) -> list[str]:
    film = (
        read_materialx(source, name) if _is_materialx(source) or source.suffix == ".mtlx" else read_gltf(source, name)
    )
    for key, value in film.__dict__.items():
        if any(isinstance(v, float) and not np.isfinite(v) for v in np.ravel(np.asarray(value, dtype=object))):
            raise NacreError(f"{source}: its {key} is not a finite number")
    if not 0.0 <= film.weight <= 1.0:
        raise NacreError(f"{source}: its share of the film, {film.weight:g}, is not in 0 to 1")
    remarks = list(film.remarks)
    base = film.base_ior
    if film.is_metal:
        f0 = min(max(float(np.dot(film.base_rgb, (0.2126, 0.7152, 0.0722))), 0.0), MAX_F0)
        base = (1 + f0**0.5) / (1 - f0**0.5)
        remarks.append("the metal's RGB became one real index of the same luminance; name the metal for its own colour")
    if film.not_read:
        remarks.append(f"not carried over: {', '.join(film.not_read)}")
    # slight absorption makes the base of a metal opaque without changing its reflection
    substrate = {"n": base} if film.transmits else {"n": base, "k": 1e-4}
    thickness: Any = film.thickness_nm
    picture = recipe.with_name(f"{recipe.stem}-thickness.png")
    if film.thickness_map is not None:
        low, high = sorted((film.thickness_map.low_nm, film.thickness_map.high_nm))
        if not 0.0 <= low <= high < np.inf:
            raise NacreError(f"{source}: its thickness map runs from {low:g} to {high:g} nm; allowed: 0 and more")
        thickness = low if low == high else {"texture": picture.name, "min": low, "max": high}
    coated: dict[str, Any] = {
        "family": "film", "ambient": "air", "substrate": substrate,
        "layers": [{"material": {"n": film.film_ior}, "thickness_nm": film.thickness_nm}],
        "surface": {"distribution": "ggx", "roughness": film.roughness},
    }  # fmt: skip
    uncoated = coated | {"layers": []}
    textured = coated | {"layers": [{"material": {"n": film.film_ior}, "thickness_nm": thickness}]}
    data = textured if film.weight == 1.0 else uncoated if film.weight == 0.0 else {
        "family": "blend", "mask": film.weight, "first": textured, "second": uncoated,
    }  # fmt: skip
    try:
        material_from_data(coated, RecipeContext("film"))
    except NacreError as error:  # leave no recipe that the next command refuses
        raise NacreError(f"{source}: holds an impossible film: {str(error).removeprefix('film: ')}") from None
    if isinstance(thickness, dict) and film.thickness_map is not None:
        _write_grey(picture, film.thickness_map)
        remarks.append(f"the thickness map is {picture.name}, from {thickness['min']:g} to {thickness['max']:g} nm")
    write_text(recipe, dump_toml(data))
    return remarks


def _write_grey(path: Path, thickness: ThicknessMap) -> None:
    """Write a thickness map as a grey picture with 16 bits; white is the thickest."""
    unit = np.clip(thickness.image, 0.0, 1.0)
    unit = 1.0 - unit if thickness.low_nm > thickness.high_nm else unit
    rows = np.round(65535 * unit).astype(np.uint16)
    with atomic_path(path) as temporary, open(temporary, "wb") as stream:
        write_png_stream(stream, rows, (rows.shape[1], rows.shape[0]), GREY, "thickness", level=9)


def _import_bsdf(source: Path, options: ReadOptions, law: str | None) -> tuple[TableLobe, list[str]]:
    """Read a file of a known BSDF format as a table, with remarks."""
    found = [entry for _, entry in recognise(source) if entry.kind == "bsdf"]
    if not found:
        raise NacreError(f"{source}: is of no known format of a BSDF or a material; nacre imports {IMPORTS}")
    entry = found[0]
    if law is None and entry.id in ("merl", "rgl", "zemax"):
        return _on_own_nodes(source, entry.id)
    measured = entry.read(source, options)
    table = next((m for m in measured if m.metadata.get("scatter") != "btdf"), measured[0])
    data, remarks = measured_lobes.gonio_data(table)
    lobe, law_remarks = measured_lobes.measured_table(data, str(source), law)
    lobe, more = measured_lobes.with_spectra(lobe, table)
    left = [f"{m.metadata.get('scatter', 'part')} {m.name}: not imported" for m in measured if m is not table]
    remarks = [line for line in remarks if not line.endswith("are kept")]  # `law_remarks` state their treatment
    return lobe, [*remarks, *law_remarks, *more, *left]


def _on_own_nodes(source: Path, form: str) -> tuple[TableLobe, list[str]]:
    """Return the table of a format with its own coordinates, and remarks."""
    if form == "merl":
        table, remarks = bsdf_tables.read_merl_filled(source)
        return bsdf_tables.merl_lobe(table), [RGB_REMARK, *remarks]
    if form == "zemax":
        zemax = read_zemax_table(source)
        if len(zemax.incidence_deg) < 2:
            raise UnsupportedError(
                f"has one incidence, {zemax.incidence_deg[0]:g} degrees, and determines no BRDF by itself; state a "
                f"law: --law {measured_lobes.LAWS[0]} (the BRDF depends on half and difference angle only)"
            )
        lobe, first = bsdf_tables.zemax_lobe(zemax), float(zemax.incidence_deg[0])
        remarks = ["the table holds no spectrum beyond its channels"]
        if first > 0:
            remarks.append(f"incidences below {first:g} degrees were not measured; the nearest values are held")
        if zemax.rotated is not None:
            has_nodes = lobe.nodes_turn is not None
            what = "differ: the sample is anisotropic" if has_nodes else "agree and were averaged"
            remarks.append(f"{len(zemax.rotation_deg)} sample rotations {what}")
        return lobe, remarks
    rgl = databases.RglBsdf.read(source)
    if not rgl.is_isotropic:
        lobe, remarks = bsdf_tables.rgl_lobe(rgl)
        return lobe, [*([RGB_REMARK] if rgl.wavelengths_nm is None else []), *remarks]
    wi, wo = directions_of("half", (90, 46, 24))
    values = rgl.evaluate(wi, wo)
    if rgl.wavelengths_nm is None:
        wavelengths = default_wavelengths()
        return TableLobe(wavelengths, values, measured_lobes.rgb_basis(wavelengths), "half"), [RGB_REMARK]
    return TableLobe(rgl.wavelengths_nm, values, np.eye(values.shape[-1]), "half"), []


COLUMNS = 64  # angles of view
REFLECTED, PASSED = ("glossy", "diffuse"), ("straight", "refract")


def export_three(material: Material, folder: Path, illuminant: str, progress: Callable[[str], None]) -> dict[str, Any]:
    """Write a package for three.js; return its facts.

    Raises:
        UnsupportedError: a table cannot represent the material, or its scattered light has no noise-free form.
        NacreError: the folder cannot be written.
    """
    lut.check_folder(folder)
    if not isinstance(material.model, Masked):
        part, lost = _part(material, illuminant, progress)
        files = lut.write_three(folder, material.name, [part], lost)
        return {"illuminant": part.table.illuminant, "lost": lost, "files": files, "errors_dE00": _errors(part)}
    parts: list[lut.ThreePart] = []
    lost = []
    both = ("first", material.model.first), ("second", material.model.second)
    for name, one in both:
        with _part_of_blend(name):
            refuse_orders(one)
    for name, one in both:
        with _part_of_blend(name):
            made, missing = _part(one, illuminant, _named(progress, name))
        parts.append(made)
        lost += [what for what in missing if what not in lost]
    share = _share(material.model.mask)
    files = lut.write_three(folder, material.name, parts, lost, share)
    return {
        "illuminant": parts[0].table.illuminant, "lost": lost, "files": files, "mean_share": share.mean,
        "errors_dE00": {f"{name}: {what}": error for name, part in zip(("first", "second"), parts, strict=True)
                        for what, error in _errors(part).items()},
    }  # fmt: skip


def _named(progress: Callable[[str], None], name: str) -> Callable[[str], None]:
    return lambda what: progress(f"{name}: {what}")


def _errors(part: lut.ThreePart) -> dict[str, dict[str, float]]:
    return {what: dict(values) for what, values in part.table.errors.items()}


def _part(material: Material, illuminant: str, progress: Callable[[str], None]) -> tuple[lut.ThreePart, list[str]]:
    """Return a material's table with its colours under uniform light, and the lost properties."""
    table = make_table(material, illuminant, progress)
    scatters = any(closure.kind == "diffuse" for closure in table.closures)
    if scatters and "lobe" not in table.pictures:
        raise UnsupportedError(
            f"{material.context.source}: scatters by a random walk without a noise-free form, which a "
            "shader needs; export a lut, whose colours over the angle of view three.js can use"
        )
    progress("colours under uniform light")
    even, alphas = even_pictures(table)
    lost = [part.replace("GLSL: ", "") for part in table.lost]
    if "through" in even:
        lost.append("the colour of the light that passes: what lies behind is seen through the mean of its channels")
    if table.facets is not None and table.facets.alpha[0] == 0:
        lost.append("highlights of point lights: a smooth surface reflects the light from all around only")
    return lut.ThreePart(table, even, alphas), lost


def _share(mask: Texture) -> lut.Share:
    """Return the share of a blend's first material."""
    if mask.low == mask.high:
        return lut.Share(float(mask.low))
    values = over_uv(mask)
    return lut.Share(float(np.mean(values)), values)


def even_pictures(table: lut.LightTable) -> tuple[dict[str, lut.Picture], tuple[float, ...]]:
    """Return colours under uniform light over the view angle, and the roughness of each "gloss" band.

    "albedo": all reflected light; "through": directly transmitted light; "spread": scattered light in all directions,
    each with a band for each side; "gloss": about the mirror direction, with a band for each width. The reflected light
    is a closure's colour times the white closure's energy (`nacre.analysis.lut.rough_view`).
    """
    sums: dict[str, list[Array | None]] = {}
    rows_over = {picture.rows for picture in table.pictures.values() if picture.rows}
    rows = rows_over.pop() if rows_over else ""
    alphas: list[float] = []
    gloss: list[Array] = []
    for closure in table.closures:
        names = ["albedo"] if closure.kind in REFLECTED else ["through"] if closure.kind in PASSED else []
        if closure.front is not None and closure.front.startswith("gloss"):
            alphas.append(closure.alpha[0])
            gloss.append(np.asarray(_even(table, closure, closure.front, rows)))
        if closure.kind == "diffuse":
            names.append("spread")
        for name in names:
            sums[name] = [
                _added(old, _even(table, closure, side, rows))
                for old, side in zip(sums.get(name, [None, None]), (closure.front, closure.behind), strict=True)
            ]
    pictures = {"gloss": lut.Picture(np.stack(gloss), "gloss under uniform light", rows=rows)} if gloss else {}
    for name, (front, behind) in sums.items():
        bands = [part for part in (front, behind) if part is not None]
        if not bands or max(float(band.max()) for band in bands) <= 0.0:
            continue
        if front is None:
            bands.insert(0, np.zeros_like(bands[0]))
        count = max(len(band) for band in bands)
        values = np.stack([np.broadcast_to(band, (count, *band.shape[1:])) for band in bands])
        pictures[name] = lut.Picture(values, f"{name} under uniform light", rows=rows)
    return pictures, tuple(alphas)


def _added(old: Array | None, new: Array | None) -> Array | None:
    return new if old is None else old if new is None else old + new


def _even(table: lut.LightTable, closure: lut.Closure, name: str | None, rows_over: str) -> Array | None:
    """Return the colours `[row, column, 3]` that a closure sends under uniform light, on one side."""
    if name is None:
        return None
    picture, angles = table.pictures[name], np.minimum(lut.column_angles(COLUMNS), STEEPEST)
    count = picture.values.shape[1]
    x = lut.column_angles(COLUMNS) / (np.pi / 2)
    unit = np.linspace(0.0, 1.0, count) if count > 1 else np.zeros(1)
    values = np.stack([picture.at(x, np.full(COLUMNS, row)) for row in unit])
    if closure.alpha[0] == 0.0 or closure.kind not in ("glossy", "refract"):
        return values
    eta = 1.0 / closure.ior if name.endswith("-behind") else closure.ior
    loss, side = ClosureLoss(closure.distribution, closure.alpha, eta), int(closure.kind == "refract")

    def kept(turns: Array) -> Array:
        return np.array([np.mean([loss.kept(direction(t, turn))[side] for turn in turns]) for t in angles])

    if picture.rows == "azimuth" and rows_over == "azimuth":
        return values * np.stack([kept(np.array([np.arccos(np.sqrt(row))])) for row in unit])[..., None]
    return values * kept(azimuths(closure.alpha))[:, None]
