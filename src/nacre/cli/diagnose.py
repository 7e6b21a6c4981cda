"""Command that finds what was off in a coating run."""

from __future__ import annotations

import json
import math
from pathlib import Path

import click
import numpy as np

from nacre.cli import common
from nacre.core.errors import NacreError

LAB_NOISE = 0.2  # repeatability of a good spectrophotometer, with room for its position


@click.command()
@click.argument("files", nargs=-1, required=True, metavar="[MEASUREMENT...] RECIPE")
@click.option("--noise", type=float, default=0.003, show_default=True, metavar="SIGMA",
              help="Standard deviation of the measured spectra, absolute.")  # fmt: skip
@click.option("--lab", "labs", multiple=True, metavar="GEOMETRY=L,a,b",
              help="A measured colour, such as 'specular 5=62,30,-12'; D65, 10 degree observer.")  # fmt: skip
@click.option("--lab-noise", type=float, default=LAB_NOISE, show_default=True, metavar="SIGMA",
              help="Standard deviation of measured L, a and b.")  # fmt: skip
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
    range_nm: str | None, angle_deg: float | None, quantity: str | None, as_json: bool, output: str | None,
) -> None:  # fmt: skip
    """Estimate which number of RECIPE was off in a finished run, from measured spectra and colours."""
    from nacre.analysis.diagnose import ColourObservation, diagnosis_document
    from nacre.analysis.diagnose import diagnose as run
    from nacre.analysis.fit import read_measurement
    from nacre.analysis.fit_data import checked_range, parts_of
    from nacre.analysis.tolerance import recipe_tolerances
    from nacre.core.files import check_writable, write_text
    from nacre.readers.measurement import ReadOptions

    *measurements, recipe = files
    for option, sigma in (("--noise", noise), ("--lab-noise", lab_noise)):
        if not 0.0 < sigma < math.inf:
            raise NacreError(f"{option} = {sigma:g} should be a finite number above 0")
    if not measurements and not labs:
        raise NacreError("nothing is measured; name a file of a spectrum before the recipe, or use --lab")
    if output is not None:
        if Path(output).suffix != ".toml":
            raise NacreError(f"-o {output}: the suffix must be .toml")
        check_writable(output)
    material = common.load_material(recipe, ())
    options = ReadOptions(quantity=quantity, angle_deg=angle_deg)
    range_ = checked_range(range_nm)
    spectra = [part for path in measurements for part in parts_of(read_measurement(path, options, range_))]
    colours = [ColourObservation(geometry, np.array(lab)) for geometry, lab in common.read_labs(labs).items()]
    result = run(
        material,
        recipe_tolerances(material, tolerances),
        [*spectra, *colours],
        [lab_noise if part.kind == "colours" else noise for part in spectra] + [lab_noise] * len(colours),
    )
    if output is not None:
        write_text(output, result.material.text)
        common.note(output)
    if as_json:
        click.echo(json.dumps(diagnosis_document(result)))
        return
    click.echo(result.text)
    click.echo("  single cause                                  probability   deviations        chi-squared")
    for each in result.suspects[:10]:
        click.echo(f"    {each.name:44s} {each.probability:8.3f}   {each.factor:+7.2f} +- {each.factor_error:.2f}"
                   f"   {each.chi2:10.1f}")  # fmt: skip
    click.echo(f"  {result.points} measured values; chi-squared of the recipe as it is: {result.nominal_chi2:.1f}")


commands: dict[str, click.Command] = {"diagnose": diagnose}
