"""Commands that analyse: sweep, report, tolerance, runsheet, ellipsometry, fit, diagnose."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from nacre.cli import common
from nacre.core.errors import NacreError
from nacre.core.jobs import Workers
from nacre.families.contract import method_overrides

if TYPE_CHECKING:
    from nacre.analysis.fit import Fit
    from nacre.material.material import Material
    from nacre.measure.texture import Texture, TextureQuantity


@click.command()
@click.argument("sweep_file", metavar="SWEEP.toml")
@click.option("-o", "output", default=None, metavar="FOLDER.zarr", help="Default: SWEEP.zarr.")
@common.cluster_options
@common.run_options
def sweep(sweep_file: str, output: str | None, workers: Workers) -> None:
    """Compute a material over many values of its numbers; run again to resume after an interruption."""
    from nacre.analysis.sweep import errors_file, run_sweep
    from nacre.analysis.sweep_plan import load_sweep

    plan = load_sweep(sweep_file)
    path = Path(output) if output else Path(f"{Path(sweep_file).stem}.zarr")
    with common.progress_bar("sweep") as bar:
        task = bar.add_task("sweep", total=plan.points.count, info="")

        def show(done: int, failed: int, total: int) -> None:
            bar.update(task, completed=done + failed, info=f"{failed} failed" if failed else "")

        finished, failed = run_sweep(plan, path, workers=workers, progress=show, report=common.note)
    common.note(f"{path}: {finished} of {plan.points.count} points" + (f", {failed} failed" if failed else ""))
    if failed:
        common.note(f"{errors_file(path)} says why")


MOST_RECIPES = 50


@click.command()
@click.argument("recipes", nargs=-1, required=True, metavar="RECIPE...")
@click.option("--illuminant", default="D65", show_default=True, help=common.LAMPS)
@click.option("--observer", type=click.Choice(["2deg", "10deg"]), default="10deg", show_default=True)
@click.option("--samples", type=click.IntRange(1, 10**8), default=None, help=common.WALKS)
@click.option("--seed", type=click.IntRange(0, 2**32 - 1), default=0, show_default=True)
@click.option(
    "--geometry", "geometries", multiple=True, metavar="[NAME=]45as25az90",
    help="Further aspecular geometry; az turns the viewer about the mirror direction (180: towards the light).",
)  # fmt: skip
@click.option(
    "--formula", default="ciede2000", show_default=True, metavar="NAME",
    help="Colour difference to the first recipe: cie76, cie94, cie94-textiles, cmc(1:1), cmc(2:1), ciede2000, din99o, "
    "din6175-2 (effect paints, aspecular geometries).",
)  # fmt: skip
@click.option(
    "--tolerance", "limits", multiple=True, metavar="[GEOMETRY=]VALUE",
    help="Largest accepted difference, such as 1.0 or 45as15=1.5; the report then states pass or fail.",
)  # fmt: skip
@click.option(
    "--standard", default=None, metavar="COLOURS.csv",
    help="List of colours as the standard of one recipe, in place of a first recipe: geometry, L*, a*, b*.",
)  # fmt: skip
@click.option("--texture", "has_texture", is_flag=True, help="Add sparkle and graininess of a coating with flakes.")
@click.option(
    "--texture-patch", "patch", default=None, metavar="FILE.png",
    help="Compute them from drawn flakes, and write the camera's pictures.",
)  # fmt: skip
@click.option(
    "--instrument", default=None, metavar="FILE.toml",
    help="Lamp, camera, threshold and calibration of sparkle and graininess.",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.option("-o", "output", default=None, metavar="FILE.txt|.json|.html", help="Write it there, not to stdout.")
@common.recipe_options
def report(
    recipes: tuple[str, ...], illuminant: str, observer: str, samples: int | None, seed: int,
    geometries: tuple[str, ...], formula: str, limits: tuple[str, ...], as_json: bool, output: str | None,
    changes: tuple[str, ...], **more: Any,
) -> None:  # fmt: skip
    """Report colour, flop, gloss, haze and totals of one RECIPE, or of several beside the first."""
    from nacre.analysis.html_report import dump_json, report_html, report_text
    from nacre.analysis.report import compare, compare_with_colours, make_report, read_geometries
    from nacre.core.files import check_output, write_text
    from nacre.core.machine import on_progress
    from nacre.light.colour_spaces import check_formula

    if len(recipes) > MOST_RECIPES:
        raise NacreError(f"report takes 1 to {MOST_RECIPES} recipes, not {len(recipes)}")
    colours = _standard(more["standard"], recipes, limits, (illuminant, observer))
    read_geometries(geometries)
    geometries = _with_standard(geometries, colours)
    allowed = _limits(limits)
    check_formula(formula)
    add_texture = _texture(more["has_texture"], more["patch"], more["instrument"], illuminant, observer, seed)
    if output:
        check_output(output, ".txt", ".json", ".html")
    materials = [common.load_material(recipe, changes) for recipe in recipes]
    reports = []
    textures = [add_texture(material) for material in materials]  # refuses a material without flakes early
    with common.progress_bar("report") as bar:
        # the bar appears only for families that report their wavelengths
        for number, material in enumerate(materials, start=1):
            task = bar.add_task("report", total=None, visible=False, info=f"{number} of {len(materials)}")

            def show(done: int, total: int, task: Any = task) -> None:
                bar.update(task, completed=done, total=total, visible=True)

            with on_progress(show):
                reports.append(make_report(material, illuminant, observer, samples, seed, geometries))
    reports = [replace(each, texture=texture) for each, texture in zip(reports, textures, strict=True)]
    comparisons = [compare(each, reports[0], formula, allowed) for each in reports[1:]]
    if colours is not None:
        comparisons = [compare_with_colours(reports[0], colours, formula, allowed, str(more["standard"]))]
    if more["patch"]:
        from nacre.plot import save_figure, texture_figure

        save_figure(
            texture_figure([(each.name, each.pictures) for each in textures if each is not None]), more["patch"]
        )
        common.note(more["patch"])
    if output:
        if output.endswith(".html"):
            from nacre.analysis.html_report import figures

            write_text(output, report_html(reports, figures(materials, reports), comparisons))
        else:
            dump = dump_json if output.endswith(".json") else report_text
            write_text(output, dump(reports, comparisons))
        common.note(output)
    if as_json:
        click.echo(dump_json(reports, comparisons), nl=False)
    elif not output:
        click.echo(report_text(reports, comparisons), nl=False)


def _texture(
    is_requested: bool, patch: str | None, instrument: str | None, illuminant: str, observer: str, seed: int
) -> Callable[[Material], Texture | None]:
    """Return the function that computes a material's texture, or None if it was not requested."""
    from nacre.core.files import check_writable
    from nacre.measure.texture import measure_texture, read_instrument

    if instrument and not (is_requested or patch):
        raise NacreError("--instrument needs --texture")
    if patch is not None:
        if Path(patch).suffix.lower() not in (".png", ".pdf", ".svg"):
            raise NacreError(f"--texture-patch {patch}: the suffix must be .png, .pdf or .svg")
        check_writable(patch)
    tool = read_instrument(instrument)
    if not (is_requested or patch):
        return lambda material: None
    method = "patch" if patch else "statistics"
    return lambda material: measure_texture(material, tool, method, illuminant, observer, seed)


def _standard(
    path: str | None, recipes: tuple[str, ...], limits: tuple[str, ...], light: tuple[str, str]
) -> dict[str, Any] | None:
    """Return geometry -> CIELAB of a list, or None without one."""
    if path is None:
        if limits and len(recipes) < 2:
            raise NacreError("--tolerance compares two recipes, or one with --standard; the first is the standard")
        return None
    from nacre.optimise.colour_list import read_colours

    if len(recipes) > 1:
        raise NacreError("--standard is compared with one recipe")
    colours: dict[str, Any] = {}
    for row in read_colours(path, 1, light):
        if not row.name or row.name in colours:
            raise NacreError(f'{path}: each row needs its own geometry, such as 45as15; got "{row.name}"')
        colours[row.name] = row.lab[0]
    return colours


def _with_standard(geometries: tuple[str, ...], colours: dict[str, Any] | None) -> tuple[str, ...]:
    """Return the additional geometries, with those of a standard that reports do not include by default."""
    from nacre.measure.geometry import ASPECULAR_DEG, Geometry

    named = [text.rpartition("=")[0] or text for text in geometries]
    usual = [str(Geometry("aspecular", 45.0, angle)) for angle in ASPECULAR_DEG]
    new = [label for label in colours or () if "as" in label and label not in (*usual, *named) and label[0].isdigit()]
    return (*geometries, *new)


def _limits(texts: tuple[str, ...]) -> dict[str, float]:
    """Return the largest accepted differences by geometry; "" stands for all."""
    limits = {}
    for text in texts:
        name, _, value = text.rpartition("=")
        limits[name] = common.number_or_nan(value)
        if not 0.0 < limits[name] < math.inf:
            raise NacreError(f"--tolerance {text}: should be a number above 0, or GEOMETRY=NUMBER such as 45as15=1.5")
    return limits


@click.command()
@click.argument("recipe")
@click.option(
    "--tolerance", "tolerances", multiple=True, metavar="PATH=VALUE",
    help="Standard deviation of a number, such as layers[0].thickness_nm=2% or =5; default: the recipe's [tolerance].",
)  # fmt: skip
@click.option("--draws", type=int, default=500, show_default=True, help="Materials drawn at random.")
@click.option("--limit", type=float, default=1.0, show_default=True, help="Largest accepted CIEDE2000 difference.")
@click.option("--seed", type=click.IntRange(0, 2**32 - 1), default=0, show_default=True)
@click.option("--illuminant", default="D65", show_default=True, help=common.LAMPS)
@click.option(
    "--geometry", "geometries", multiple=True, metavar="45as15",
    help="Geometry, such as 45as15 or specular 0, or a name of the recipe's [[geometry]]; default: the named ones.",
)  # fmt: skip
@click.option(
    "--texture", "quantities", multiple=True, metavar="QUANTITY[=PERCENT]",
    help="Texture of a coating with flakes, such as sparkle_45 or graininess=5, and its largest accepted deviation "
    "(10 %).",
)  # fmt: skip
@click.option("--instrument", default=None, metavar="FILE.toml", help="Lamp, camera and calibration of texture.")
@click.option("--samples", type=click.IntRange(1, 10**8), default=None, help=common.WALKS)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.option("-o", "output", default=None, metavar="FILE.json", help="Also write the numbers, as JSON.")
@common.set_option
@common.cluster_options
@common.run_options
def tolerance(
    recipe: str, tolerances: tuple[str, ...], draws: int, limit: float, seed: int, illuminant: str,
    geometries: tuple[str, ...], samples: int | None, as_json: bool, output: str | None, changes: tuple[str, ...],
    workers: Workers, **more: Any,
) -> None:  # fmt: skip
    """Compute colour variation, yield and ranked sensitivities from the manufacturing tolerances of RECIPE."""
    from nacre.analysis.tolerance import recipe_tolerances, run_tolerance, tolerance_document
    from nacre.core.files import check_output, write_text

    if output:
        check_output(output, ".json")
    texture = _texture_limits(more["quantities"], more["instrument"], illuminant)
    material = common.load_material(recipe, changes)
    own_tolerances = recipe_tolerances(material, tolerances)
    with common.progress_bar("tolerance") as bar:
        task = bar.add_task("tolerance", total=draws, info="")
        result = run_tolerance(
            material, own_tolerances, draws=draws, limit=limit, seed=seed, illuminant=illuminant, samples=samples,
            geometries=geometries, texture=texture, workers=workers,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )  # fmt: skip
    document = tolerance_document(result, own_tolerances)
    if output:
        write_text(output, json.dumps(document, indent=2) + "\n")
        common.note(output)
    if as_json:
        click.echo(json.dumps(document))
        return
    low, high = document["yield_interval_95"]
    click.echo(f"{material.name}: {document['geometry']}, {draws} draws, {illuminant}, 10 degree observer")
    click.echo("  geometry        nominal L*, a*, b*          dE00 median   95 %")
    rows = zip(document["geometries"], document["nominal_lab"], document["delta_e_2000_median"],
               document["delta_e_2000_95"], strict=True)  # fmt: skip
    for label, lab, median, high95 in rows:
        click.echo(f"  {label:14s}  {lab[0]:7.2f} {lab[1]:7.2f} {lab[2]:7.2f}     {median:8.2f}  {high95:8.2f}")
    for spread in document["texture"]:
        off = "-" if spread["off_percent_95"] is None else f"{spread['off_percent_95']:.2g}"
        click.echo(
            f"  {spread['quantity']:14s}  {spread['nominal']:7.4g}, 95 % of the draws within "
            f"{off} %; limit {spread['limit_percent']:g} %: "
            f"{100 * spread['within_limit']:.1f} % pass"
        )
    also = " and texture within its limits" if document["texture"] else ""
    click.echo(f"  yield within dE00 {limit:g} at all geometries{also}: {100 * document['yield']:.1f} %"
               f"  (95 %: {100 * low:.1f} to {100 * high:.1f} %)")  # fmt: skip
    if document["failed_draws"]:
        click.echo(f"  {document['failed_draws']} draws could not be computed and count as outside")
    for path, share in document["share_clipped_at_0"].items():
        click.echo(f"  {path}: {100 * share:.2g} % of the draws were below 0 and became 0")
    for title, changes_of in (
        ("sensitivities (dE00 of one standard deviation, share of variance)", result.sensitivities),
        ("contributions of the sources", result.contributions),
    ):
        click.echo(f"  {title}:")
        for name, change, share in changes_of:
            click.echo(f"    {name:44s} {change:8.3f}  {100 * share:5.1f} %")
    for spread in document["texture"]:
        click.echo(f"  sensitivities of {spread['quantity']} (% of one standard deviation):")
        for path, change in spread["percent_of_one_deviation"].items():
            click.echo(f"    {path:44s} {change:+8.3f}")


def _texture_limits(
    texts: Sequence[str], instrument: str | None, illuminant: str
) -> dict[str | TextureQuantity, float]:
    """Return the quantities of `QUANTITY[=PERCENT]` with their limits.

    Raises:
        NacreError: one is not known, occurs twice, or has no limit above 0.
    """
    from nacre.measure.texture import TextureQuantity, read_instrument
    from nacre.optimise.spec import TEXTURE_TOLERANCE_PERCENT

    if instrument and not texts:
        raise NacreError("--instrument needs --texture")
    tool = read_instrument(instrument)
    limits: dict[str | TextureQuantity, float] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        each = TextureQuantity.named(name.strip(), "--texture", tool, (illuminant, "10deg"))
        limit = common.number_or_nan(value.removesuffix("%")) if equals else TEXTURE_TOLERANCE_PERCENT
        if not 0.0 < limit < math.inf:
            raise NacreError(f"--texture {text}: write QUANTITY or QUANTITY=PERCENT, above 0, such as graininess=5")
        if each in limits:
            raise NacreError(f"--texture {text}: the quantity occurs twice")
        limits[each] = limit
    return limits


SUFFIXES = (".txt", ".csv", ".json", ".png", ".pdf", ".svg")


@click.command()
@click.argument("recipe")
@click.option("--wavelength-nm", type=float, default=550.0, show_default=True, help="Wavelength of the monitor.")
@click.option("--angle-deg", type=float, default=0.0, show_default=True, help="Angle of incidence of its light.")
@click.option("--quantity", type=click.Choice(["reflectance", "transmittance"]), default="reflectance",
              show_default=True, help="Signal of the monitor.")  # fmt: skip
@click.option("--noise", type=float, default=0.001, show_default=True, help="Standard deviation of the signal.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.option("-o", "outputs", multiple=True, metavar="FILE",
              help="Table (.txt), curves (.csv), both (.json), figure (.png, .pdf, .svg); repeatable.")  # fmt: skip
@common.set_option
def runsheet(
    recipe: str, wavelength_nm: float, angle_deg: float, quantity: str, noise: float, as_json: bool,
    outputs: tuple[str, ...], changes: tuple[str, ...],
) -> None:  # fmt: skip
    """Print each layer's optical monitor signal, turning points and stop criterion."""
    from nacre.analysis.run_sheet import make_run_sheet, run_sheet_csv, run_sheet_document, run_sheet_text
    from nacre.core.files import check_output, write_text

    for output in outputs:
        check_output(output, *SUFFIXES)
    material = common.load_material(recipe, changes)
    sheet = make_run_sheet(material, wavelength_nm, angle_deg, quantity, noise)
    document = run_sheet_document(sheet)
    for output in outputs:
        texts = {".txt": run_sheet_text, ".csv": run_sheet_csv}
        suffix = Path(output).suffix
        if suffix == ".json":
            write_text(output, json.dumps(document, indent=1) + "\n")
        elif suffix in texts:
            write_text(output, texts[suffix](sheet))
        else:
            from nacre.plot import save_figure
            from nacre.plot.sheets import run_sheet_figure

            curves = [(each.material, each.grown_nm, each.signal, each.turning_nm, each.turning_signal)
                      for each in sheet.layers]  # fmt: skip
            label = f"{quantity.capitalize()} at {wavelength_nm:g} nm (%)"
            save_figure(run_sheet_figure(curves, label, material.name), output, {"recipe": material.text})
        common.note(output)
    if as_json:
        click.echo(json.dumps(document))
    elif not outputs:
        click.echo(run_sheet_text(sheet), nl=False)


DEFAULT_ANGLES = "65,70,75"


@click.command()
@click.argument("recipe")
@click.option("--angles-deg", default=DEFAULT_ANGLES, show_default=True, help="Incidence, such as 65,70,75 or 50:80:5.")
@click.option("--wavelengths-nm", default=None, help="Grid such as 400:800:5; default: chosen by the material.")
@click.option("--azimuth-deg", type=float, default=None, help="Azimuth of the direction to the light, from u.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON, with the conventions.")
@click.option("-o", "output", metavar="FILE.csv", help="Write CSV (or JSON, by the suffix) to a file.")
@common.set_option
@common.jobs_option
def ellipsometry(
    recipe: str, angles_deg: str, wavelengths_nm: str | None, azimuth_deg: float | None, as_json: bool,
    output: str | None, changes: tuple[str, ...],
) -> None:  # fmt: skip
    """Print what an ellipsometer measures of RECIPE: Psi, Delta, N C S, Mueller matrix, pseudo-dielectric function.

    Delta: r_p / r_s = tan(Psi) exp(i Delta) for fields exp(+i w t), r_p = -r_s at normal incidence, so that a bare
    metal or wafer has Delta between 0 and 180 degrees, as in the programs of Woollam, Sentech, Accurion, Film Sense and
    Horiba (Is = S, Ic = C). The recipe's [instrument] table averages over bandwidth, cone and thickness spread.
    """
    from nacre.analysis.ellipsometry import compute_ellipsometry, ellipsometry_document
    from nacre.core.files import check_output
    from nacre.material.material import recipe_provenance

    if output:
        check_output(output, ".csv", ".json")
    angles, grid = common.angles(angles_deg), common.wavelengths(wavelengths_nm)
    material = common.load_material(recipe, changes)
    result = compute_ellipsometry(material, angles, grid, azimuth_deg)
    names = ("wavelength_nm", "angle_of_incidence_deg")
    text = common.spectrum_csv(names, result.wavelengths_nm, result.angles_deg, result.columns(), 9)
    document = {**ellipsometry_document(result), "provenance": recipe_provenance(material)}
    common.answer(document, text, output, as_json)


# The commands `fit`, parameters of a recipe from measurements, and `diagnose`, the faults of a coating run.


@click.command()
@click.argument("files", nargs=-1, required=True, metavar="MEASUREMENT... RECIPE")
@click.option("--parameter", "parameters", multiple=True, metavar="PATH=LOW:HIGH", help="Fit a number between bounds.")
@click.option("--tie", "ties", multiple=True, metavar="PATH=EXPRESSION",
              help="Compute a number from others, such as layers[2].thickness_nm=layers[0].thickness_nm.")  # fmt: skip
@click.option(
    "--starts",
    type=click.IntRange(1, 1000),
    default=4,
    show_default=True,
    help="Refined starting points in addition to the recipe's values.",
)
@click.option(
    "--weights",
    type=click.Choice(["equal", "relative"]),
    default="equal",
    show_default=True,
    help="Whether the noise is equal for all values or proportional to them; ellipsometer files state it.",
)
@click.option("--intervals", type=click.Choice(["auto", "linear", "profile", "resampling"]), default="auto",
              show_default=True, help="Method of the 95 % intervals.")  # fmt: skip
@click.option("--lab", "labs", multiple=True, metavar="GEOMETRY=L,a,b",
              help="A measured colour, such as 45as15=62,30,-12; D65, 10 degree observer.")  # fmt: skip
@click.option("--texture", "texture", multiple=True, metavar="QUANTITY=VALUE",
              help="Measured sparkle or graininess, such as sparkle_45=1.2.")  # fmt: skip
@click.option("--instrument", default=None, metavar="FILE.toml", help="Lamp, camera and calibration of texture.")
@click.option("--range-nm", default=None, metavar="LOW:HIGH", help="Ignore other wavelengths of the measurements.")
@click.option("--angle-deg", type=float, default=None, help="Angle of incidence that a file does not state.")
@click.option("--delta-convention", type=click.Choice(["positive", "negative", "positive-shifted", "negative-shifted"]),
              default=None, help="Sign of Delta that a file does not state.")  # fmt: skip
@click.option("--spectrum", default=None, metavar="NAME", help="One spectrum, place or time of a file with several.")
@click.option("--quantity", default=None, metavar="NAME", help="Quantity of a spectrum that a file does not state.")
@click.option("--unit", metavar="UNIT", help="Unit of the wavelengths or energies, if a file names none.")
@click.option("--columns", metavar="NAME,...", help="Names of the columns of a table; - ignores one.")
@click.option("--ignore", metavar="HEADING,...", help="Headings of columns to ignore.")
@click.option("--samples", type=click.IntRange(1, 10**8), default=None, help=common.WALKS)
@click.option("--seed", type=click.IntRange(0, 2**32 - 1), default=0, show_default=True)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.option("--residual", default=None, metavar="FILE.npz", help="Store the residual map.")
@click.option("--report", "page", default=None, metavar="FIT.html", help="Write a page on measurement and fit.")
@click.option("-o", "output", default=None, metavar="FITTED.toml", help="Default: RECIPE-fitted.toml.")
@common.run_options
def fit(
    files: tuple[str, ...], parameters: tuple[str, ...], ties: tuple[str, ...], as_json: bool, residual: str | None,
    page: str | None, output: str | None, range_nm: str | None, labs: tuple[str, ...], texture: tuple[str, ...],
    instrument: str | None, **options: Any,
) -> None:  # fmt: skip
    """Fit parameters of RECIPE to each MEASUREMENT: ellipsometer files, spectra, gonio CSV, colours, texture.

    Several measurements are of one sample; each is weighted by its own residual.
    """
    from nacre.analysis.fit import fit_parameters, is_at_bound, other_sign, read_measurements, run_fit
    from nacre.analysis.fit_data import checked_range, parts_of
    from nacre.analysis.ties import read_ties
    from nacre.core.files import atomic_path, check_output, short_name, write_text
    from nacre.readers.measurement import ReadOptions
    from nacre.recipe.toml import edit_toml

    *measurements, recipe = files
    if not measurements and not labs and not texture:
        raise NacreError("give the measurements and then the recipe: nacre fit MEASUREMENT... RECIPE")
    colours = common.read_labs(labs)
    path = Path(output) if output else Path(f"{short_name(recipe)}-fitted.toml")
    for target, suffix in ((path, ".toml"), (residual, ".npz"), (page, ".html")):
        if target:
            check_output(target, suffix, option="")
    names = ("angle_deg", "delta_convention", "spectrum", "quantity", "unit")
    stated = {name: options.pop(name) for name in names}
    stated |= {name: common.words(options.pop(name)) for name in ("columns", "ignore")}
    measured = read_measurements(measurements, ReadOptions(**stated), checked_range(range_nm), colours,
                                 common.read_texture(texture), instrument)  # fmt: skip
    material = common.load_material(recipe)
    numbers = fit_parameters(material, parameters)
    tied = read_ties(material, [number.path for number in numbers], ties)
    for part in parts_of(measured):
        _note_remarks(part)
    result = run_fit(
        material, measured, numbers, ties=tied,
        progress=lambda what, best: common.note(f"{what}: relative rms {best:.4g}"), **options,
    )  # fmt: skip
    better = other_sign(result, measured, numbers, tied)
    if better is not None:
        common.note(
            f"the other sign of Delta agrees better (relative rms {better:.4g}, not {result.relative_rms:.4g}): try "
            "--delta-convention negative"
        )
    changes = {
        **{n.path: n.value for n in result.numbers}, **result.tied, **method_overrides(result.material.model)
    }  # fmt: skip
    write_text(path, edit_toml(material.with_parts_loaded(changes).text, changes, recipe))
    if residual:
        with atomic_path(residual) as temporary, open(temporary, "wb") as file:
            np.savez(file, residual=result.residual, wavelengths_nm=measured.wavelengths_nm)
    if page:
        from nacre.analysis.fit_report import write_fit_page

        write_fit_page(page, result, measured, numbers)
    at_bound = [is_at_bound(number, bounds) for number, bounds in zip(result.numbers, numbers, strict=True)]
    if as_json:
        click.echo(json.dumps({**_document(result, at_bound), "recipe": str(path)}))
    else:
        _print(result, at_bound)
    common.note(str(path))


def _finite(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else float(value)


def _document(result: Fit, at_bound: Sequence[bool]) -> dict[str, Any]:
    return {
        "numbers": [
            {"path": n.path, "value": n.value, "half_width_95": _finite(n.half_width), "determined": n.is_determined,
             "interval_95": [_finite(end) for end in n.interval], "interval_method": n.method, "at_bound": at_end}
            for n, at_end in zip(result.numbers, at_bound, strict=True)
        ],
        "tied": dict(result.tied),
        "correlation": [[_finite(value) for value in row] for row in result.correlation],
        "measurements": [
            {"name": p.name, "kind": p.kind, "values": p.values, "rms": p.rms, "relative_rms": p.relative_rms,
             "mse": p.mse}
            for p in result.parts
        ],
        "rms": result.rms, "relative_rms": result.relative_rms, "starts": list(result.starts),
        "evaluations": result.evaluations,
    }  # fmt: skip


def _print(result: Fit, at_bound: Sequence[bool]) -> None:
    for n, at_end in zip(result.numbers, at_bound, strict=True):
        if not n.is_determined:
            tail = "not determined by these data"
        elif n.method == "linear":
            tail = f"+- {n.half_width:.3g} (95 %)"
        else:
            tail = f"{n.interval[0]:.6g} to {n.interval[1]:.6g} (95 %, {n.method})"
        click.echo(f"{n.path:44s} {n.value:12.6g}  {tail}{', at its bound' if at_end else ''}")
    for path, value in result.tied.items():
        click.echo(f"{path:44s} {value:12.6g}  tied")
    if len(result.numbers) > 1:
        click.echo("correlation")
        for n, row in zip(result.numbers, result.correlation):
            click.echo(f"  {n.path:42s} " + " ".join(f"{value:7.3f}" for value in row))
    for part in result.parts if len(result.parts) > 1 or any(p.mse is not None for p in result.parts) else ():
        mse = "" if part.mse is None else f", MSE {part.mse:.4g} (N, C, S in 0.001)"
        click.echo(f"{part.name}: {part.values} values, rms {part.rms:.4g}{mse}")
    click.echo(f"relative rms {result.relative_rms:.4g}, {result.evaluations} evaluations")


TEXTURE_NOISE_PERCENT = 5.0  # repeatability over several places of a panel
LAB_NOISE = 0.2  # repeatability of a good spectrophotometer, with room for its position


@click.command()
@click.argument("files", nargs=-1, required=True, metavar="[MEASUREMENT...] RECIPE")
@click.option("--noise", type=float, default=0.003, show_default=True, metavar="SIGMA",
              help="Standard deviation of the measured spectra, absolute.")  # fmt: skip
@click.option("--lab", "labs", multiple=True, metavar="GEOMETRY=L,a,b",
              help="A measured colour, such as 'specular 5=62,30,-12'; D65, 10 degree observer.")  # fmt: skip
@click.option("--texture", "texture", multiple=True, metavar="QUANTITY=VALUE",
              help="Measured sparkle or graininess, such as sparkle_45=1.2.")  # fmt: skip
@click.option("--instrument", default=None, metavar="FILE.toml", help="Lamp, camera and calibration of texture.")
@click.option("--lab-noise", type=float, default=LAB_NOISE, show_default=True, metavar="SIGMA",
              help="Standard deviation of measured L, a and b.")  # fmt: skip
@click.option("--texture-noise", type=float, default=TEXTURE_NOISE_PERCENT, show_default=True, metavar="PERCENT",
              help="Standard deviation of measured texture, relative to it.")  # fmt: skip
@click.option("--tolerance", "tolerances", multiple=True, metavar="PATH=VALUE",
              help="Standard deviation of a number, as for `nacre tolerance`.")  # fmt: skip
@click.option("--range-nm", default=None, metavar="LOW:HIGH", help="Ignore other wavelengths of the measurements.")
@click.option("--angle-deg", type=float, default=None, help="Angle of incidence that a file does not state.")
@click.option("--quantity", default=None, metavar="NAME", help="Quantity of a spectrum that a file does not state.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.option("-o", "output", default=None, metavar="FILE.toml", help="Write the recipe as it was made.")
@common.run_options
def diagnose(
    files: tuple[str, ...], noise: float, labs: tuple[str, ...], lab_noise: float, tolerances: tuple[str, ...],
    range_nm: str | None, as_json: bool, output: str | None, **more: Any,
) -> None:  # fmt: skip
    """Estimate which number of RECIPE was off in a finished run, from measured spectra and colours."""
    from nacre.analysis.diagnose import diagnose as run
    from nacre.analysis.diagnose import diagnosis_document
    from nacre.analysis.fit import read_measurements
    from nacre.analysis.fit_data import checked_range, parts_of
    from nacre.analysis.tolerance import recipe_tolerances
    from nacre.core.files import check_output, write_text
    from nacre.optimise.measurement import check_answers
    from nacre.readers.measurement import ReadOptions

    *measurements, recipe = files
    texture_noise = more["texture_noise"]
    for option, sigma in (("--noise", noise), ("--lab-noise", lab_noise), ("--texture-noise", texture_noise)):
        if not 0.0 < sigma < math.inf:
            raise NacreError(f"{option} = {sigma:g} should be a finite number above 0")
    texture, instrument = common.read_texture(more["texture"]), more["instrument"]
    if not measurements and not labs and not texture:
        raise NacreError("nothing is measured; name a file of a spectrum before the recipe, or use --lab")
    if output is not None:
        check_output(output, ".toml")
    material = common.load_material(recipe, ())
    options = ReadOptions(quantity=more["quantity"], angle_deg=more["angle_deg"])
    data = read_measurements(
        measurements, options, checked_range(range_nm), common.read_labs(labs), texture, instrument
    )
    parts: list[Any] = [each.resolved(material) if hasattr(each, "resolved") else each for each in parts_of(data)]
    for part in parts:
        if part.kind == "colours":
            check_answers([material], part.geometries, [f"{part.name or '--lab'}: geometry"] * len(part.geometries))
        _note_remarks(part)
    result = run(
        material, recipe_tolerances(material, tolerances), parts,
        [_noise(part, noise, lab_noise, texture_noise) for part in parts],
    )  # fmt: skip
    if output is not None:
        write_text(output, result.material.text)
        common.note(output)
    if as_json:
        click.echo(json.dumps(diagnosis_document(result)))
        return
    click.echo(result.text)
    click.echo("  single cause                                  probability   deviation / sigma chi-squared")
    for each in result.suspects[:10]:
        click.echo(f"    {each.name:44s} {each.probability:8.3f}   {each.factor:+7.2f} +- {each.factor_error:.2f}"
                   f"   {each.chi2:10.1f}")  # fmt: skip
    click.echo(f"  {result.points} measured values; chi-squared of the recipe as it is: {result.nominal_chi2:.1f}")


def _note_remarks(part: Any) -> None:
    for remark in getattr(part, "remarks", ()):
        common.note(f"{part.name}: {remark}" if part.name else remark)


def _noise(part: Any, noise: float, lab_noise: float, texture_percent: float) -> Any:
    """Return the standard deviation of one observation, or those of its values."""
    return {"colours": lab_noise, "texture": 0.01 * texture_percent * part.values}.get(part.kind, noise)
