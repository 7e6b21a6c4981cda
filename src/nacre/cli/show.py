"""Commands that evaluate, draw, store and convert a material: spectrum, evaluate, plot, compile, export, import."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click
import numpy as np

from nacre.cli import common
from nacre.core.errors import NacreError, UnsupportedError
from nacre.core.files import atomic_path, check_output, check_writable, plain, short_name, why_unreadable
from nacre.formats.bsdf_tables import EXPORTS, FOLDERS, export_remarks

PLOT_KINDS = (
    "spectrum", "ribbon", "colour-map", "slice", "lobe", "chromaticity", "tracks",
    "field", "scattering", "structure", "platelet", "microscope", "ellipsometry", "mueller", "circular",
    "michel-levy",
)  # fmt: skip
STEPS, TRACK_STEPS = {"colour-map": 61, "ribbon": 91, "spectrum": 6}, 11  # default counts for a range without a step
NO_DIRECTIONS = "is not an .npz file of numbers (wi[N,3], wo[N,3] and, if need be, uv[N,2])"
SWEEP_ONLY_KINDS = ("gamut", "parallel")
SWEEP_KINDS = ("gamut", "colour-map", "parallel")


@click.command()
@click.argument("recipe")
@click.option("--angles-deg", default="0", show_default=True, help="Incidence, such as 0,30,60 or 0:80:5.")
@click.option("--wavelengths-nm", default=None, help="Such as 380:780:5; default: chosen by the material.")
@click.option(
    "--polarisation", type=click.Choice(["s", "p", "left", "right", "both", "mueller"]), default="both",
    show_default=True, help="Of the incident light; both: unpolarised; mueller: also Mueller matrices.",
)  # fmt: skip
@click.option(
    "--azimuth-deg", type=float, default=0.0, show_default=True, help="Azimuth of the direction to the light, from u."
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON to stdout.")
@click.option("-o", "output", metavar="FILE.csv", help="Write CSV (or JSON, by the suffix) to a file.")
@common.recipe_options
@common.cluster_options
def spectrum(
    recipe: str, angles_deg: str, wavelengths_nm: str | None, polarisation: str, azimuth_deg: float, as_json: bool,
    output: str | None, changes: tuple[str, ...], workers: Any,
) -> None:  # fmt: skip
    """Print reflectance and transmittance of RECIPE over angle and wavelength."""
    from nacre.material.material import recipe_provenance

    if output:
        check_output(output, ".csv", ".json")
    angles = common.angles(angles_deg)
    grid = common.wavelengths(wavelengths_nm)
    material = common.load_material(recipe, changes)
    with common.solving_on(workers, material):
        result = material.spectrum(np.radians(angles), grid, polarisation, azimuth_deg=azimuth_deg)
    parts = result.parts()
    document: dict[str, Any] = {
        "wavelengths_nm": result.wavelengths_nm.tolist(),
        "angles_deg": angles.tolist(),
        "polarisation": polarisation,
        "azimuth_deg": azimuth_deg,
        **{name: value.tolist() for name, value in (parts | result.matrices()).items()},
    }
    document["provenance"] = recipe_provenance(material)
    stated = [] if polarisation in ("both", "mueller") else [polarisation]
    names = ["wavelength_nm", "angle_deg", *["polarisation"] * len(stated)]
    columns = parts | _elements(result.matrices())
    text_csv = common.spectrum_csv(names, result.wavelengths_nm, angles, columns, 6, stated)
    common.answer(document, text_csv, output, as_json)


@click.command()
@click.argument("recipe")
@click.option("--angles-deg", default="0", show_default=True, help="Incidence, such as 0,30,60 or 0:80:5.")
@click.option("--azimuth-deg", type=float, default=0.0, show_default=True, help="Of the direction to the light.")
@click.option("--wavelengths-nm", default=None, help="Such as 400:700:20; default: chosen by the material.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON to stdout.")
@click.option("-o", "output", metavar="FILE.csv", help="Write CSV (or JSON, by the suffix) to a file.")
@common.recipe_options
@common.cluster_options
def orders(
    recipe: str, angles_deg: str, azimuth_deg: float, wavelengths_nm: str | None, as_json: bool, output: str | None,
    changes: tuple[str, ...], workers: Any,
) -> None:  # fmt: skip
    """Print the efficiencies of the diffraction orders of RECIPE, for s and p polarised light."""
    from nacre import api
    from nacre.material.material import recipe_provenance

    if output:
        check_output(output, ".csv", ".json")
    if not np.isfinite(azimuth_deg):
        raise NacreError(f"--azimuth-deg = {azimuth_deg} must be finite")
    angles = common.angles(angles_deg)
    if angles.max() >= 90:
        raise NacreError(f'--angles-deg = "{angles_deg}" must lie in [0, 90)')
    material = common.load_material(recipe, changes)
    with common.solving_on(workers, material):
        solved = api.orders(material, angles, azimuth_deg, common.wavelengths(wavelengths_nm))
    document = {
        "wavelengths_nm": solved.wavelengths_nm.tolist(),
        "angles_deg": angles.tolist(),
        "azimuth_deg": azimuth_deg,
        "orders": solved.numbers.tolist(),
        "reflected": _by_polarisation(solved.reflected),
        "transmitted": _by_polarisation(solved.transmitted),
        "estimated_error": solved.error.tolist(),
        "provenance": recipe_provenance(material),
    }
    text_csv = _orders_csv(solved, angles)
    common.answer(document, text_csv, output, as_json)


def _by_polarisation(efficiency: np.ndarray) -> dict[str, Any]:
    """Return `[angle][wavelength][order]` for s and p, None for orders that do not propagate."""
    return {
        name: [[[None if np.isnan(v) else float(v) for v in row] for row in plane] for plane in efficiency[..., k]]
        for k, name in enumerate("sp")
    }


def _orders_csv(solved: Any, angles_deg: np.ndarray) -> str:
    azimuth = np.degrees(solved.azimuth_rad)
    names = ["wavelength_nm,angle_deg,m,n,reflected_s,reflected_p,transmitted_s,transmitted_p"]
    lines = [",".join([*names, *(["azimuth_deg"] if azimuth else [])])]
    for a, angle in enumerate(angles_deg):
        for w, wavelength in enumerate(solved.wavelengths_nm):
            for o, (m, n) in enumerate(solved.numbers):
                values = [*solved.reflected[a, w, o], *solved.transmitted[a, w, o]]
                if not np.all(np.isnan(values)):
                    cells = ["" if np.isnan(v) else f"{v:.9g}" for v in values]
                    cells += [f"{azimuth:.9g}"] if azimuth else []
                    lines.append(",".join([f"{wavelength:.6g}", f"{angle:.6g}", str(m), str(n), *cells]))
    return "\n".join(lines) + "\n"


def _elements(matrices: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the elements of Mueller matrices as columns: m11 ... m44 reflected, transmitted_m11 ... transmitted."""
    prefix = {"mueller_reflected": "", "mueller_transmitted": "transmitted_"}
    return {
        f"{prefix[name]}m{i + 1}{j + 1}": value[..., i, j]
        for name, value in matrices.items() for i in range(4) for j in range(4)
    }  # fmt: skip


@click.command()
@click.argument("recipe")
@click.option(
    "--directions", required=True, metavar="DIRS.npz",
    help="Arrays wi[N,3] and wo[N,3], of unit length, z along the normal; uv[N,2] if it varies.",
)  # fmt: skip
@click.option("--wavelengths-nm", default=None, help="Such as 380:780:5; default: chosen by the material.")
@click.option(
    "--samples", type=click.IntRange(1, 10**8), default=None,
    help="Random walks a direction pair (pearls); default: 4096.",
)  # fmt: skip
@click.option("--seed", type=click.IntRange(0, 2**32 - 1), default=0, show_default=True)
@click.option(
    "-o", "output", required=True, metavar="VALUES.npz",
    help="Arrays f[N, wavelength] and wavelengths_nm; of pearls also f_std, the standard error.",
)  # fmt: skip
@common.recipe_options
def evaluate(
    recipe: str, directions: str, wavelengths_nm: str | None, samples: int | None, seed: int, output: str,
    changes: tuple[str, ...],
) -> None:  # fmt: skip
    """Evaluate the BSDF of RECIPE for given directions (the non-delta part, 1/sr, without the cosine)."""
    from nacre.material.material import recipe_provenance
    from nacre.measure.evaluate import evaluate_with_error

    check_output(output, ".npz")
    wi, wo, uv = _read_directions(directions)
    grid = common.wavelengths(wavelengths_nm)
    material = common.load_material(recipe, changes)
    bsdf = material.bsdf(grid)
    values, error = evaluate_with_error(bsdf, wi, wo, uv=uv, samples=samples, seed=seed)
    arrays: dict[str, Any] = {"f": values, "wavelengths_nm": bsdf.wavelengths_nm}
    if error is not None:
        arrays["f_std"] = error
    arrays["provenance"] = np.array(json.dumps({**recipe_provenance(material), "seed": seed}))
    with atomic_path(output) as temporary, open(temporary, "wb") as file:
        np.savez(file, **arrays)
    common.note(output)


def _read_directions(path: str) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    try:
        with np.load(plain(path), allow_pickle=False) as data:
            arrays = {name: np.asarray(data[name], dtype=float) for name in ("wi", "wo", "uv") if name in data}
    except Exception as error:  # zipfile, zlib and numpy each raise their own kinds for a broken file
        # an OSError of zipfile has no number
        reason = why_unreadable(error) if isinstance(error, OSError) and error.errno else NO_DIRECTIONS
        raise NacreError(f"{path}: {reason}") from None
    for name in ("wi", "wo"):
        if name not in arrays:
            raise NacreError(f"{path}: the array {name}[N,3] is missing")
        array = arrays[name]
        if array.ndim != 2 or array.shape[1] != 3:
            raise NacreError(f"{path}: {name} has shape {list(array.shape)}; it should be [N, 3]")
        norm = np.linalg.norm(array, axis=1)
        if not np.all(np.isfinite(array)) or np.any(np.abs(norm - 1) > 1e-3):
            raise NacreError(f"{path}: {name} must hold unit vectors")
        arrays[name] = array / norm[:, None]
    if arrays["wi"].shape != arrays["wo"].shape:
        raise NacreError(f"{path}: wi has {len(arrays['wi'])} rows and wo has {len(arrays['wo'])}; they must agree")
    uv = arrays.get("uv")
    if uv is not None and uv.shape != (len(arrays["wi"]), 2):
        raise NacreError(f"{path}: uv has shape {list(uv.shape)}; it should be [{len(arrays['wi'])}, 2]")
    return arrays["wi"], arrays["wo"], uv


@click.command()
@click.argument("recipe", metavar="RECIPE|SWEEP.zarr")
@click.option("--kind", default=None, type=click.Choice(PLOT_KINDS + SWEEP_ONLY_KINDS), help="Needed for a RECIPE.")
@click.option("--angles-deg", default=None, help="Incidence, such as 0,30,60; the default depends on the kind.")
@click.option("--wavelengths-nm", default=None, help="Such as 380:780:5; default: chosen by the material.")
@click.option("--illuminant", default="D65", show_default=True, help=common.LAMPS)
@click.option(
    "--over",
    default=None,
    metavar="PATH=A:B[:STEP]",
    help="Number of the recipe that spectrum, ribbon, tracks, colour-map or chromaticity run over, "
    "such as layers[0].thickness_nm=0:600.",
)
@click.option("--lightness", type=float, default=None, metavar="L", help="tracks: scale a*, b* to this L*, such as 50.")
@click.option("--part", default=None, metavar="NAME", help="Part of a sweep's spectrum; default: the brightest stored.")
@click.option("-o", "output", default=None, metavar="FILE.png|.pdf", help="Default: RECIPE-KIND.png.")
@common.recipe_options
def plot(
    recipe: str, kind: str | None, angles_deg: str | None, wavelengths_nm: str | None, illuminant: str,
    over: str | None, lightness: float | None, part: str | None, output: str | None, changes: tuple[str, ...],
) -> None:  # fmt: skip
    """Draw a figure of RECIPE in publication quality, or of a sweep: gamut, colour-map or parallel coordinates."""
    from nacre.plot.material import plot_material

    is_sweep = Path(recipe).suffix == ".zarr"
    allowed = SWEEP_KINDS if is_sweep else PLOT_KINDS
    kind = kind or ("gamut" if is_sweep else None)
    if kind is None or kind not in allowed:
        problem = "--kind is missing" if kind is None else f"--kind {kind} is not for {Path(recipe).name}"
        raise NacreError(f"{problem}; choose one of {', '.join(allowed)}")
    path = Path(output) if output else Path(f"{short_name(recipe)}-{kind}.png")
    check_output(path, ".png", ".pdf", ".svg")
    angles = None if angles_deg is None else common.angles(angles_deg)
    if is_sweep:
        from nacre.analysis.sweep import save_sweep_figure

        if changes or wavelengths_nm or over or lightness is not None:
            raise NacreError(
                "--set, --over, --lightness and --wavelengths-nm are for recipes; a sweep holds finished colours"
            )
        save_sweep_figure(recipe, kind, path, angles, part)
        common.note(str(path))
        return
    if part is not None:
        raise NacreError("--part is for sweeps; a recipe's figure shows every part")
    grid = common.wavelengths(wavelengths_nm)
    material = common.load_material(recipe, changes)
    plot_material(
        material,
        kind,
        path,
        angles_deg=angles,
        wavelengths_nm=grid,
        illuminant=illuminant,
        over=_over(over, kind),
        lightness=lightness,
    )
    common.note(str(path))


def _over(text: str | None, kind: str) -> tuple[str, np.ndarray] | None:
    """Read `--over PATH=VALUES`; a range without a step is divided evenly."""
    if text is None:
        return None
    path, equals, values = text.rpartition("=")
    if not equals or not path:
        raise NacreError(
            f'--over "{text}" cannot be read; write PATH=A:B or PATH=A:B:STEP, '
            "such as layers[0].thickness_nm=100:500:50"
        )
    if values.count(":") == 1 and "," not in values:
        low, high = common.numbers(values.replace(":", ","), "--over")
        return path, np.linspace(low, high, STEPS.get(kind, TRACK_STEPS))
    return path, common.numbers(values, "--over")


@click.command(name="compile")
@click.argument("recipe")
@click.option("--wavelengths-nm", default=None, help="Such as 380:780:5; default: chosen by the material.")
@click.option("-o", "output", default=None, metavar="FILE.nacre", help="Default: RECIPE.nacre, in the current folder.")
@common.recipe_options
@common.cluster_options
def compile_(
    recipe: str, wavelengths_nm: str | None, output: str | None, changes: tuple[str, ...], workers: Any
) -> None:
    """Solve RECIPE and store its BSDF for repeated rendering."""

    path = Path(output) if output else Path(f"{short_name(recipe)}.nacre")
    check_output(path, ".nacre")
    if path.exists() and Path(recipe).exists() and path.samefile(recipe):
        raise UnsupportedError(f"{recipe}: is compiled already")
    material = common.load_material(recipe, changes)
    with common.solving_on(workers, material):
        solved = material.bsdf(common.wavelengths(wavelengths_nm))
    solved.save(path)
    for remark in solved.provenance.get("notes", ()):
        common.note(remark)
    common.note(str(path))


@click.command()
@click.argument("recipe")
@click.option("--to", "target", required=True, type=click.Choice(sorted(EXPORTS)))
@click.option(
    "-o",
    "output",
    default=None,
    metavar="FILE",
    help="Default: RECIPE with the format's suffix; lut and three: a folder.",
)
@click.option("--angle-step-deg", type=click.FloatRange(0.5, 30), default=10.0, show_default=True, help="csv: grid.")
@click.option("--wavelength-nm", type=float, default=None, help="zemax: one wavelength instead of XYZ.")
@click.option("--illuminant", default=None, help="lut, three: the lamp that the colours are for.  [default: D65]")
@click.option(
    "--mesh",
    default=None,
    metavar="FILE",
    help="gltf: the object (.gltf, .glb, .obj, .ply, .stl).  [default: a sphere]",
)
@click.option("--json", "as_json", is_flag=True, help="Print the written files and the losses as JSON.")
@common.recipe_options
@common.cluster_options
def export(
    recipe: str, target: str, output: str | None, angle_step_deg: float, wavelength_nm: float | None,
    illuminant: str | None, mesh: str | None, as_json: bool, changes: tuple[str, ...], workers: Any,
) -> None:  # fmt: skip
    """Write RECIPE in the format of another program and list the properties that it cannot hold."""
    from nacre.analysis.import_export import export_material
    from nacre.formats.lut import check_folder

    path = Path(output) if output else Path(f"{short_name(recipe)}{EXPORTS[target]}")
    options: dict[str, Any] = {"angle_step_deg": angle_step_deg, "wavelength_nm": wavelength_nm}
    if target in FOLDERS:
        check_folder(path)
        options |= {"illuminant": illuminant or "D65", "progress": lambda what: common.note(f"{what} ...")}
    else:
        if illuminant is not None:
            raise NacreError(
                f"--illuminant {illuminant}: is for --to {', '.join(FOLDERS)}; {target} holds no colours of one lamp"
            )
        check_writable(path)
    if mesh is not None and target != "gltf":
        raise NacreError(f"--mesh {mesh}: is for --to gltf; {target} holds no mesh")
    options["mesh"] = mesh
    material = common.load_material(recipe, changes)
    with common.solving_on(workers, material):
        facts = export_material(material, target, path, **options)
    if as_json:
        click.echo(json.dumps(facts))
        return
    common.note(str(path))
    for line in export_remarks(facts):
        common.note(line)


@click.command(name="import")
@click.argument("file", metavar="FILE")
@click.option("-o", "output", default=None, metavar="RECIPE.toml", help="Default: FILE with the suffix .toml.")
@click.option("--material", default=None, metavar="NAME", help="Material of a glTF or MaterialX file with several.")
@click.option("--quantity", default=None, help="bsdf or reflectance_factor, if the file lacks it.")
@click.option("--unit", default=None, help="Unit of angles (deg, rad) or wavelengths (nm, um), if missing.")
@click.option("--ignore", multiple=True, metavar="HEADING", help="A column to ignore; repeatable.")
@click.option(
    "--law", default=None, metavar="half-angle",
    help="Extrapolate a scan in the plane of incidence: the BRDF depends on half and difference angle only.",
)  # fmt: skip
@common.run_options
def import_(
    file: str, output: str | None, material: str | None, quantity: str | None, unit: str | None,
    ignore: tuple[str, ...], law: str | None,
) -> None:  # fmt: skip
    """Read a measurement or a material of another program and write a recipe for it."""
    from nacre.analysis.import_export import import_material
    from nacre.readers.measurement import ReadOptions

    path = Path(output) if output else Path(f"{Path(file).stem}.toml")
    check_output(path, ".toml")
    options = ReadOptions(quantity=quantity, unit=unit, ignore=ignore, spectrum=material)
    for line in import_material(Path(file), path, options=options, law=law):
        common.note(line)
    common.note(str(path))
