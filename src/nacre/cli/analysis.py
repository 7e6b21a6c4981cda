"""Commands that analyse a material: sweep, report, tolerance, runsheet, ellipsometry."""

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

if TYPE_CHECKING:
    from nacre.material.material import Material
    from nacre.measure.texture import Texture, TextureQuantity


def _progress_bar(description: str) -> Any:
    """Return a progress bar on stderr, which is disabled if stderr is not a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    return Progress(
        TextColumn(description), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
        TextColumn("{task.fields[info]}"), console=console, disable=not console.is_terminal,
    )  # fmt: skip


@click.command()
@click.argument("sweep_file", metavar="SWEEP.toml")
@click.option("-o", "output", default=None, metavar="FOLDER.zarr", help="Default: SWEEP.zarr.")
@common.cluster_options
@common.cache_option
@common.jobs_option
def sweep(sweep_file: str, output: str | None, workers: Workers) -> None:
    """Compute a material over many values of its numbers; run again to resume after an interruption."""
    from nacre.analysis.sweep import errors_file, run_sweep
    from nacre.analysis.sweep_plan import load_sweep

    plan = load_sweep(sweep_file)
    path = Path(output) if output else Path(f"{Path(sweep_file).stem}.zarr")
    with _progress_bar("sweep") as bar:
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
@common.set_option
@common.cache_option
@common.jobs_option
def report(
    recipes: tuple[str, ...], illuminant: str, observer: str, samples: int | None, seed: int,
    geometries: tuple[str, ...], formula: str, limits: tuple[str, ...], as_json: bool, output: str | None,
    changes: tuple[str, ...], **more: Any,
) -> None:  # fmt: skip
    """Report colour, flop, gloss, haze and totals of one RECIPE, or of several beside the first."""
    from nacre.analysis.html_report import dump_json, report_html, report_text
    from nacre.analysis.report import compare, compare_with_colours, make_report, read_geometries
    from nacre.core.files import check_output, write_text
    from nacre.core.parallel import on_progress
    from nacre.light.colour_differences import check_formula

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
    with _progress_bar("report") as bar:
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
    is_asked: bool, patch: str | None, instrument: str | None, illuminant: str, observer: str, seed: int
) -> Callable[[Material], Texture | None]:
    """Return the function that computes a material's texture, or None without being asked."""
    from nacre.core.files import check_writable
    from nacre.measure.texture import measure_texture, read_instrument

    if instrument and not (is_asked or patch):
        raise NacreError("--instrument needs --texture")
    if patch is not None:
        if Path(patch).suffix.lower() not in (".png", ".pdf", ".svg"):
            raise NacreError(f"--texture-patch {patch}: the suffix must be .png, .pdf or .svg")
        check_writable(patch)
    tool = read_instrument(instrument)
    method = "patch" if patch else "statistics"

    def add(material: Material) -> Texture | None:
        if not (is_asked or patch):
            return None
        return measure_texture(material, tool, method, illuminant, observer, seed)

    return add


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
    rows = read_colours(path, 1, light)
    names = [row.name for row in rows]
    for name in names:
        if not name or names.count(name) > 1:
            raise NacreError(f'{path}: each row needs its own geometry, such as 45as15; got "{name}"')
    return {row.name: row.lab[0] for row in rows}


def _with_standard(geometries: tuple[str, ...], colours: dict[str, Any] | None) -> tuple[str, ...]:
    """Return the further geometries with those of a standard that no report has by itself."""
    from nacre.measure.geometry import ASPECULAR_DEG, Geometry

    named = [text.rpartition("=")[0] or text for text in geometries]
    usual = [str(Geometry("aspecular", 45.0, angle)) for angle in ASPECULAR_DEG]
    new = [label for label in colours or () if "as" in label and label not in (*usual, *named) and label[0].isdigit()]
    return (*geometries, *new)


def _limits(texts: tuple[str, ...]) -> dict[str, float]:
    """Return the largest accepted differences by geometry; "" stands for all."""
    found = {}
    for text in texts:
        name, _, value = text.rpartition("=")
        try:
            found[name] = float(value)
        except ValueError:
            found[name] = math.nan
        if not 0.0 < found[name] < math.inf:
            raise NacreError(f"--tolerance {text}: should be a number above 0, or GEOMETRY=NUMBER such as 45as15=1.5")
    return found


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
@common.cache_option
@common.jobs_option
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
    found = recipe_tolerances(material, tolerances)
    with _progress_bar("tolerance") as bar:
        task = bar.add_task("tolerance", total=draws, info="")
        result = run_tolerance(
            material, found, draws=draws, limit=limit, seed=seed, illuminant=illuminant, samples=samples,
            geometries=geometries, texture=texture, workers=workers,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )  # fmt: skip
    document = tolerance_document(result, found)
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
        click.echo(
            f"  {spread['quantity']:14s}  {spread['nominal']:7.4g}, 95 % of the draws within "
            f"{_dash(spread['off_percent_95'])} %; limit {spread['limit_percent']:g} %: "
            f"{100 * spread['within_limit']:.1f} % pass"
        )
    also = " and texture within its limits" if document["texture"] else ""
    click.echo(f"  yield within dE00 {limit:g} at all geometries{also}: {100 * document['yield']:.1f} %"
               f"  (95 %: {100 * low:.1f} to {100 * high:.1f} %)")  # fmt: skip
    if document["failed_draws"]:
        click.echo(f"  {document['failed_draws']} draws could not be computed and count as outside")
    for path, share in document["share_clipped_at_0"].items():
        click.echo(f"  {path}: {100 * share:.2g} % of the draws were below 0 and became 0")
    click.echo("  sensitivities (dE00 of one standard deviation, share of variance):")
    for path, change, share in result.sensitivities:
        click.echo(f"    {path:44s} {change:8.3f}  {100 * share:5.1f} %")
    click.echo("  contributions of the sources:")
    for source, change, share in result.contributions:
        click.echo(f"    {source:44s} {change:8.3f}  {100 * share:5.1f} %")
    for spread in document["texture"]:
        click.echo(f"  sensitivities of {spread['quantity']} (% of one standard deviation):")
        for path, change in spread["percent_of_one_deviation"].items():
            click.echo(f"    {path:44s} {change:+8.3f}")


def _dash(value: float | None) -> str:
    return "-" if value is None else f"{value:.2g}"


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
    found: dict[str | TextureQuantity, float] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        each = TextureQuantity.named(name.strip(), "--texture", tool, (illuminant, "10deg"))
        try:
            limit = float(value.removesuffix("%")) if equals else TEXTURE_TOLERANCE_PERCENT
        except ValueError:
            limit = math.nan
        if not 0.0 < limit < math.inf:
            raise NacreError(f"--texture {text}: write QUANTITY or QUANTITY=PERCENT, above 0, such as graininess=5")
        if each in found:
            raise NacreError(f"--texture {text}: the quantity occurs twice")
        found[each] = limit
    return found


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
              help="Table (.txt), curves (.csv), both (.json), figure (.png, .pdf, .svg); several times.")  # fmt: skip
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
@click.option("--wavelengths-nm", default=None, help="Such as 400:800:5; default: chosen by the material.")
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
    from nacre.core.files import check_output, write_text
    from nacre.material.material import recipe_provenance

    if output:
        check_output(output, ".csv", ".json")
    angles, grid = common.angles(angles_deg), common.wavelengths(wavelengths_nm)
    material = common.load_material(recipe, changes)
    found = compute_ellipsometry(material, angles, grid, azimuth_deg)
    if output and output.endswith(".csv") or not output and not as_json:
        text = _csv(found.wavelengths_nm, found.angles_deg, found.columns())
    document = None
    if as_json or output and output.endswith(".json"):
        document = json.dumps({**ellipsometry_document(found), "provenance": recipe_provenance(material)})
    if output:
        write_text(output, text if output.endswith(".csv") else f"{document}\n")
        common.note(output)
    if as_json:
        click.echo(document)
    elif not output:
        click.echo(text, nl=False)


def _csv(wavelengths_nm: np.ndarray, angles_deg: np.ndarray, columns: dict[str, np.ndarray]) -> str:
    lines = ["wavelength_nm,angle_of_incidence_deg," + ",".join(columns)]
    for a, angle in enumerate(angles_deg):
        for w, wavelength in enumerate(wavelengths_nm):
            values = ",".join(f"{value[a, w]:.9g}" for value in columns.values())
            lines.append(f"{wavelength:.9g},{angle:.9g},{values}")
    return "\n".join(lines) + "\n"
