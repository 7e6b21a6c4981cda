"""The Python interface, with the names and defaults of the command line.

`nacre.load`, `nacre.material`, `nacre.evaluate`, `nacre.spectrum`, `nacre.report` and others; `nacre.render` makes
pictures, `nacre.plot` figures, `nacre.design` structures.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from nacre.analysis.diagnose import Diagnosis, Observation
from nacre.analysis.diagnose import diagnose as run_diagnosis
from nacre.analysis.ellipsometry import compute_ellipsometry as ellipsometry
from nacre.analysis.fit import Fit, fit_parameters, read_measurements, run_fit
from nacre.analysis.import_export import export_material as export
from nacre.analysis.import_export import import_material
from nacre.analysis.report import make_report as report
from nacre.analysis.run_sheet import make_run_sheet as runsheet
from nacre.analysis.sweep import run_sweep
from nacre.analysis.sweep_plan import load_sweep
from nacre.analysis.ties import read_ties
from nacre.analysis.tolerance import recipe_tolerances
from nacre.analysis.tolerance import run_tolerance as tolerance
from nacre.bsdf import Bsdf
from nacre.bsdf.bsdf import Spectrum
from nacre.core.arrays import Array, floats
from nacre.core.errors import NacreError, UnsupportedError, did_you_mean
from nacre.core.files import DESIGN_RECIPE, check_output, check_writable, short_name
from nacre.core.jobs import Workers
from nacre.families.contract import Diffracting, Model, fabrications
from nacre.formats.fabrication import SUFFIXES, HeightOptions, write_drawing
from nacre.formats.number_maps import FORMATS as MAP_FORMATS
from nacre.formats.number_maps import SUFFIXES as MAP_SUFFIXES
from nacre.formats.number_maps import write_number_maps
from nacre.material.material import Material, MaterialLike, as_material, load, loaded
from nacre.material.spatial_variation import number_maps
from nacre.matter.drawings import DrawingRequest
from nacre.matter.periodic.orders import Orders
from nacre.matter.periodic.structure import NotConvergedError
from nacre.measure.evaluate import HasBsdf, evaluate_with_error
from nacre.measure.texture import Instrument, Texture, measure_texture
from nacre.optimise.formulation import formulate
from nacre.optimise.gamut import find_gamut as gamut
from nacre.readers.measurement import Measurement, ReadOptions
from nacre.readers.registry import open_file

__all__ = [
    "ellipsometry",
    "evaluate",
    "export",
    "fabricate",
    "fit",
    "formulate",
    "gamut",
    "import_",
    "orders",
    "read",
    "report",
    "runsheet",
    "spectrum",
    "sweep",
    "diagnose",
    "texture",
    "tolerance",
]


def as_bsdf(thing: HasBsdf | Bsdf | MaterialLike) -> Bsdf:
    """Return the Bsdf of a material, a Bsdf, a recipe's path or table, or a `.nacre` file.

    Raises:
        NacreError: the file is not a material.
    """
    if isinstance(thing, Bsdf):
        return thing
    found = loaded(thing)
    made: Bsdf = (found if hasattr(found, "bsdf") else as_material(found)).bsdf()
    return made


def evaluate(
    thing: HasBsdf | Bsdf | MaterialLike,
    wi: ArrayLike,
    wo: ArrayLike,
    *,
    uv: ArrayLike | None = None,
    samples: int | None = None,
    seed: int = 0,
) -> Array:
    """Return the non-delta BSDF, `[..., wavelength]`, in 1/sr, without the cosine.

    Args:
        thing: a material, a Bsdf, or a recipe path or `.nacre` file, an example's name or a recipe's table.
        wi: unit vectors to the light, `[..., 3]`, in the local frame (z is the normal).
        wo: unit vectors to the viewer, `[..., 3]`; on the other side of the surface: the radiance BTDF.
        uv: surface coordinates `[..., 2]` for materials that vary over the surface; default: (0.5, 0.5).
        samples, seed: number per pair and seed of random walks, for stochastic lobes (pearls).

    Raises:
        UnsupportedError: the lobe needs a random walk, and this machine lacks LLVM.
    """
    return evaluate_with_error(as_bsdf(thing), wi, wo, uv=uv, samples=samples, seed=seed)[0]


def spectrum(
    thing: MaterialLike,
    angles_deg: ArrayLike = 0.0,
    wavelengths_nm: ArrayLike | None = None,
    polarisation: str = "both",
    azimuth_deg: float = 0.0,
) -> Spectrum:
    """Return reflectance and transmittance of a material as a `Spectrum`, each part `[angle, wavelength]`.

    Args:
        thing: a recipe, a file or a material.
        angles_deg: incidence angles in the ambient medium.
        wavelengths_nm: vacuum wavelengths; default: chosen by the material.
        polarisation: "s", "p", "both" (unpolarised), "left" or "right" (circular), or "mueller": unpolarised, with
            `mueller_reflected` and `mueller_transmitted`, `[angle, wavelength, 4, 4]`.
        azimuth_deg: azimuth of the direction towards the light, from u; anisotropic films depend on it.

    Raises:
        NacreError: the recipe is wrong, or an optical constant is not known at a wavelength.
    """
    theta = np.radians(floats(angles_deg, "angles_deg"))
    return as_material(thing).spectrum(theta, wavelengths_nm, polarisation, azimuth_deg=azimuth_deg)


def orders(
    thing: MaterialLike,
    angles_deg: ArrayLike = 0.0,
    azimuth_deg: float = 0.0,
    wavelengths_nm: ArrayLike | None = None,
) -> Orders:
    """Return a grating's diffraction orders: efficiencies, Jones matrices and directions.

    Args:
        thing: a material, or a recipe path, an example's name or a recipe's table.
        angles_deg: incidence angles in the ambient.
        azimuth_deg: azimuth of the direction towards the light, from x (across the lines) towards y.
        wavelengths_nm: default: the material's own.

    Raises:
        UnsupportedError: the material is not periodic.
        NotConvergedError: the orders do not converge to the tolerance.

    Example:
        >>> lines = {"shape": "line", "material": {"n": 1.5}, "width_nm": 500}
        >>> layer = {"thickness_nm": 200, "material": "air", "shapes": [lines]}
        >>> recipe = {"family": "grating", "substrate": {"n": 1.5}, "layers": [layer], "lattice": {"period_nm": 1000}}
        >>> nacre.orders(recipe, 0, 0, [600]).numbers[:, 0].tolist()
        [-2, -1, 0, 1, 2]
    """
    material = as_material(thing)
    model = material.model
    if not isinstance(model, Diffracting):
        raise UnsupportedError(
            f"{material.context.source}: a {model.traits.noun} has no orders; allowed: a grating, a relief of lines "
            'with model.optics = "vector"'
        )
    grid = None if wavelengths_nm is None else np.atleast_1d(floats(wavelengths_nm, "wavelengths_nm"))
    if grid is not None and (grid.ndim != 1 or not grid.size or not np.all((grid > 0.0) & np.isfinite(grid))):
        raise NacreError("wavelengths_nm must be a list of positive numbers, at least one")
    theta = np.radians(np.atleast_1d(floats(angles_deg, "angles_deg")))
    if theta.ndim != 1 or not theta.size or not np.all((theta >= 0.0) & (theta < 0.5 * np.pi)):
        raise NacreError("angles_deg must be a list of numbers in [0, 90), at least one")
    azimuth = floats(azimuth_deg, "azimuth_deg")
    if azimuth.ndim != 0 or not np.isfinite(azimuth):
        raise NacreError("azimuth_deg must be one finite number")
    try:
        return model.diffraction_orders(theta, float(np.radians(azimuth)), grid)
    except NotConvergedError as error:
        raise NotConvergedError(f"{material.context.source}: {error}") from None


@functools.wraps(measure_texture)
def texture(thing: MaterialLike, *arguments: Any, **options: Any) -> Texture:
    """As `measure_texture`, for a material, or a recipe path, an example's name or a recipe's table."""
    return measure_texture(as_material(thing), *arguments, **options)


def diagnose(
    thing: MaterialLike,
    observations: Iterable[Observation],
    noise: float | Sequence[float | Array],
    tolerances: Iterable[str] = (),
    **options: Any,
) -> Diagnosis:
    """Estimate which recipe numbers were off in a finished run.

    Args:
        thing: a material or a path: the recipe as intended.
        observations: `nacre.analysis.diagnose.SpectrumObservation` and `ColourObservation`, or measurements that
            `nacre.analysis.fit.read_measurement` read; `nacre.analysis.fit_data.stated_texture` makes those of texture.
        noise: standard deviation of the measured values, one number or one (or an array) per observation.
        tolerances: such as "layers[0].thickness_nm=2%", in addition to those of the recipe's `[tolerance]`.
        options: further arguments of `nacre.analysis.diagnose.diagnose`.

    Raises:
        NacreError: nothing is measured, or a tolerance names no recipe number.
    """
    material = as_material(thing)
    return run_diagnosis(material, recipe_tolerances(material, tuple(tolerances)), list(observations), noise, **options)


def fit(
    measurement: str | Path | Sequence[str | Path], thing: MaterialLike, parameters: Iterable[str] = (), *,
    starts: int = 4, ties: Iterable[str] = (), range_nm: tuple[float, float] | None = None,
    report: str | Path | None = None, colours: Mapping[str, Sequence[float]] | None = None,
    texture: Mapping[str, float] | None = None, instrument: str | Path | Mapping[str, Any] | Instrument | None = None,
    angle_deg: float | None = None, delta_convention: str | None = None,
    **options: Any,
) -> Fit:  # fmt: skip
    """Fit parameters of a recipe to measurements of one sample.

    Args:
        measurement: file of an ellipsometer or spectrometer, CSV of a spectrum, of goniometer values or of colours with
            their geometries; or several.
        thing: a material or a path.
        parameters: such as "layers[0].thickness_nm=50:400", in addition to those of the recipe's `[fit]`.
        starts: refined starting points; options: further arguments of `nacre.analysis.fit.run_fit`.
        ties: such as "layers[2].thickness_nm=layers[0].thickness_nm", in addition to those of the recipe's `[ties]`.
        range_nm: other wavelengths of the measurements are ignored.
        colours: measured CIELAB by geometry ("45as15" or a name of `[[geometry]]`), D65, 10 degree observer.
        texture: measured numbers, such as {"sparkle_45": 1.2}; instrument: lamp, camera, calibration of texture.
        report: HTML file that compares measurement and fit.
        angle_deg, delta_convention: properties that an ellipsometer's file does not state.

    Raises:
        NacreError: the measurement cannot be read, or parameters are missing.
    """
    if report is not None:
        check_output(report, ".html", option="")
    paths = [measurement] if isinstance(measurement, str | Path) else list(measurement)
    stated = ReadOptions(angle_deg=angle_deg, delta_convention=delta_convention)
    material, measured = as_material(thing), read_measurements(paths, stated, range_nm, colours, texture, instrument)
    numbers = fit_parameters(material, tuple(parameters))
    tied = read_ties(material, [number.path for number in numbers], tuple(ties))
    found = run_fit(material, measured, numbers, starts=starts, ties=tied, **options)
    if report is not None:
        from nacre.analysis.fit_report import write_fit_page

        write_fit_page(report, found, measured, numbers)
    return found


def sweep(
    path: str | Path,
    output: str | Path | None = None,
    *,
    jobs: int | None = None,
    cluster: str | None = None,
    security: str | Path | None = None,
    progress: Callable[[int, int, int], None] | None = None,
) -> Path:
    """Compute a sweep, or its missing points; return the Zarr folder (errors of failed points lie beside it).

    Args:
        path: the sweep's TOML file.
        output: the Zarr folder; default: the file's name with .zarr, in the current folder.
        jobs: worker processes; 1: this process; default: one per core.
        cluster: address of a Dask scheduler (`tls://host:port`) whose workers have nacre, in place of `jobs`.
        security: TOML file with `ca`, `cert` and `key`, the PEM files for such a scheduler.
        progress: called with (finished, failed, total) after every point.

    Raises:
        NacreError: the file is not valid, or the folder holds another sweep.
    """
    store = Path(output) if output is not None else Path(f"{Path(path).stem}.zarr")
    run_sweep(load_sweep(path), store, workers=Workers(jobs, cluster, security), progress=progress)
    return store


def import_(source: str | Path, recipe: str | Path, *, law: str | None = None, **options: Any) -> Material:
    """Convert a measured BSDF or a material of another program (glTF, MaterialX) to a recipe, and load it.

    Args:
        source: the file to read.
        recipe: the TOML file to write; tables go into a `.nacre` file beside it.
        law: "half-angle" extrapolates a scan in the plane of incidence.
        options: facts that a measurement does not state, as for `read`.

    Raises:
        NacreError: the file has an unknown format or is damaged.
        UnsupportedError: the measurement is not a BRDF of an isotropic sample.
    """
    check_writable(recipe)
    import_material(Path(source), Path(recipe), options=_read_options(options), law=law)
    return load(recipe)


def read(path: str | Path, **options: Any) -> Measurement | list[Measurement]:
    """Read a file of an instrument or another program: a `Measurement`, or a list if the file contains several.

    Args:
        path: the file; the format is recognised by its content.
        options: facts not stated in the file, as fields of `nacre.readers.measurement.ReadOptions`: `quantity`, `unit`,
            `angle_deg`, `delta_convention`, `channel`, `spectrum`, `pitch_um`, `columns`, `ignore`, `format`,
            `wavelengths`.

    Raises:
        NacreError: unknown format, damaged contents, or an unknown option.
        AmbiguousFileError: the file can be read in several ways; `option` names the option that decides.
    """
    found = open_file(path, _read_options(options))
    return found[0] if len(found) == 1 else found


def _read_options(options: Mapping[str, Any]) -> ReadOptions:
    """Check the names of options.

    Raises:
        NacreError: an unknown option.
    """
    allowed = [entry.name for entry in fields(ReadOptions)]
    for name in options:
        if name not in allowed:
            raise NacreError(
                f"{name} is not an option of read.{did_you_mean(name, allowed)} Allowed: {', '.join(allowed)}"
            )
    values = dict(options)
    for name in ("columns", "ignore"):
        if isinstance(values.get(name), str):
            values[name] = tuple(word.strip() for word in values[name].split(","))
    if isinstance(values.get("pitch_um"), int | float):
        values["pitch_um"] = (float(values["pitch_um"]),) * 2
    return ReadOptions(**values)


def fabricate(
    source: MaterialLike | Model,
    to: str,
    path: str | Path | None = None,
    *,
    size_mm: tuple[float, float] | None = None,
    calibration: str | Path | Mapping[str, str | Path] | None = None,
    levels: int | None = None,
    pixels_per_feature: int = 1,
    base_um: float = 1.0,
    seed: int | None = None,
) -> tuple[Path, ...]:
    """Write a fabrication file and, except for a layer table, a JSON that describes it.

    Args:
        source: a material, its model, or a recipe path or design folder.
        to: relief: "png16", "tiff16", "stl", "gds", "oas" or "csv"; metasurface: "gds", "oas", "csv" or "sheet"; film:
            "sheet"; numbers from images, of any family: "png16", "tiff16", "npy", "csv", "gds" or "oas", a file each.
        path: output; default: name and format's suffix, in the design folder or the current one.
        size_mm: area (x, y) that is tiled; default: one period. For maps: their size.
        calibration: CSV of grey value and depth in um, for images, or "published" for the built-in curve; default:
            linear, 65,535 at the top and 0 at the deepest point of this relief. For maps: a CSV of machine setting
            and value (volts, nm), or a table from recipe paths to such files.
        levels: number of heights of a mask; default: that of the relief, or 16. For maps: value count.
        pixels_per_feature: pixels along a feature's side, for images.
        base_um: thickness of an STL's base.
        seed: seed for random positions; default: the recipe's.

    Returns:
        paths of the files; `path` is the first.

    Raises:
        UnsupportedError: the family has no drawing for the format.
        NacreError: the calibration does not fit, or the file cannot be written.
    """
    folder, name, place = Path(), "material", "material"
    if isinstance(source, str | Path):
        folder = Path(source) if Path(source).is_dir() else Path()
    source = loaded(source)
    model = source
    if isinstance(source, Material):
        place, model = source.context.source, source.model
        name = short_name(place) if Path(place).name == DESIGN_RECIPE else Path(place).name
    if not isinstance(model, Model):
        raise UnsupportedError(f"{model!r:.60} is not a material, no path or name of one and no table of a recipe")
    drawers = fabrications(model)
    if to not in drawers:
        maps = number_maps(source) if isinstance(source, Material) else []
        if maps and to in MAP_FORMATS:
            if seed is not None:
                raise UnsupportedError(f"{place}: --to {to} takes no --seed here: nothing of a map is drawn at random")
            stem = maps[0].slug if len(maps) == 1 else "map"  # several maps have their recipe paths in the names
            target = Path(path) if path is not None else folder / f"{stem}{MAP_SUFFIXES[to]}"
            return write_number_maps(
                maps, to, target, name, size_mm=size_mm, calibration=calibration, levels=levels
            )  # fmt: skip
        formats = [*drawers, *(MAP_FORMATS if maps else ())]
        known = f"Formats: {', '.join(formats)}" if formats else "It has none: nothing of it can be drawn"
        hint = did_you_mean(to, drawers)
        raise UnsupportedError(f"{place}: --to {to} is not known for a {model.traits.noun}.{hint} {known}")
    if isinstance(calibration, Mapping):
        raise UnsupportedError(f"{place}: --calibration PATH=CSV is for maps of numbers; --to {to} takes one curve")
    drawing = drawers[to](DrawingRequest(size_mm, seed))
    target = Path(path) if path is not None else folder / f"{drawing.stem}{SUFFIXES[to]}"
    options = HeightOptions(size_mm, calibration, levels, pixels_per_feature, base_um, seed)
    return write_drawing(drawing, to, target, name, options)
