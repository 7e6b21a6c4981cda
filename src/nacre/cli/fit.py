"""The commands `fit`, parameters of a recipe from measurements, and `diagnose`, the faults of a coating run."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from nacre.cli import common
from nacre.core.errors import NacreError
from nacre.families.contract import method_overrides

if TYPE_CHECKING:
    from nacre.analysis.fit import Fit


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
@common.cache_option
@common.jobs_option
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
    asked = ((path, ".toml"), (residual and Path(residual), ".npz"), (page and Path(page), ".html"))
    for target, suffix in asked:
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
@common.cache_option
@common.jobs_option
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
