"""The command `read`: what a file of an instrument or another program contains."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from nacre.cli import common
from nacre.core.errors import NacreError
from nacre.core.files import check_writable

if TYPE_CHECKING:
    from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions

SIGNS = ("positive", "negative", "positive-shifted", "negative-shifted")


@click.command()
@click.argument("files", nargs=-1, required=True, metavar="FILE...")
@click.option("--json", "as_json", is_flag=True, help="Print the description as JSON.")
@click.option("--show", type=click.IntRange(0), default=0, metavar="ROWS", help="Print the first rows.")
@click.option("--plot", metavar="FILE", help="Draw the data to FILE (.png, .pdf or .svg).")
@click.option("-o", "output", metavar="FILE", help="Write a tidy .csv (units in the headings) or .npz.")
@click.option("--format", "format_id", metavar="ID", help="Read as this format; see nacre read --formats.")
@click.option("--formats", is_flag=True, is_eager=True, expose_value=False, callback=lambda *given: _formats(*given),
              help="List all formats.")  # fmt: skip
@click.option("--quantity", metavar="NAME", help="Quantity of the values, such as reflectance or absorbance.")
@click.option("--unit", metavar="UNIT", help="Unit of the abscissa (nm, um, eV, 1/cm), or of heights.")
@click.option("--angle-deg", type=float, metavar="DEG", help="Angle of incidence.")
@click.option("--delta-convention", type=click.Choice(SIGNS), help="Sign of Delta.")
@click.option("--channel", metavar="NAME", help="Channel or zone of a file with several.")
@click.option("--spectrum", metavar="NAME", help="Name or number of one spectrum, material or block.")
@click.option("--pitch-um", metavar="X[,Y]", help="Lateral distance of height samples.")
@click.option("--columns", metavar="NAME,...", help="Names of the columns of a table without headings; - ignores one.")
@click.option("--wavelengths", metavar="FILE", help="File of the wavelengths of a spectrum of the USGS library.")
@click.option("--ignore", metavar="HEADING,...", help="Headings of columns to ignore.")
def read(
    files: tuple[str, ...], as_json: bool, show: int, plot: str | None, output: str | None, format_id: str | None,
    **given: Any,
) -> None:  # fmt: skip
    """Say what FILE contains: format, quantities, units, range, and what was assumed or left out."""
    from nacre.readers.measurement import ReadOptions, describe, lines, write_measurements

    for path in filter(None, (plot, output)):
        check_writable(path)
    options = ReadOptions(
        format=format_id, pitch_um=_pitch(given.pop("pitch_um")), columns=common.words(given.pop("columns")),
        ignore=common.words(given.pop("ignore")), **given,
    )  # fmt: skip
    found = [measurement for file in files for measurement in _opened(file, options)]
    if as_json:
        click.echo(json.dumps([describe(measurement, show) for measurement in found], ensure_ascii=False))
    elif not output:
        for measurement in found:
            click.echo("\n".join(lines(measurement, _title(measurement), show)))
    if output:
        write_measurements(output, found)
        common.note(output)
    if plot:
        from nacre.plot.measurements import measurement_figure
        from nacre.plot.style import save_figure

        save_figure(measurement_figure(found), plot)
        common.note(plot)


def _formats(context: click.Context, parameter: click.Parameter, value: bool) -> None:
    from nacre.readers.registry import FORMATS

    if value and not context.resilient_parsing:
        for entry in FORMATS:
            click.echo(f"{entry.id:28s} {entry.kind:13s} {entry.title}")
        context.exit()


def _title(measurement: Measurement) -> str:
    from nacre.readers.registry import format_named

    return f"{format_named(measurement.format).title} ({measurement.format})"


def _pitch(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    values = common.numbers(text, "--pitch-um")
    if len(values) not in (1, 2) or values.min() <= 0:
        raise NacreError(f'--pitch-um = "{text}" must be one or two numbers above 0')
    return float(values[0]), float(values[-1])


def _opened(file: str, options: ReadOptions) -> list[Measurement]:
    """Read a file; on a terminal, ask for the properties that it does not state."""
    from nacre.readers.measurement import AmbiguousFileError
    from nacre.readers.registry import open_file

    while True:
        try:
            return open_file(file, options)
        except AmbiguousFileError as error:
            option = f"--{error.option.replace('_', '-')}"
            if not (sys.stdin.isatty() and sys.stderr.isatty()):
                if option in str(error):
                    raise NacreError(str(error)) from None
                allowed = f"; allowed: {', '.join(error.choices)}" if error.choices else ""
                raise NacreError(f"{error}; decide with {option}{allowed}") from None
            options = replace(options, **{error.option: _asked(error, option)})


def _asked(error: AmbiguousFileError, option: str) -> Any:
    """Return the user's answer, in the option's type."""
    kind = click.Choice(error.choices) if error.choices else None
    answer = click.prompt(f"{error}\n{option}", type=kind, err=True)
    if error.option == "angle_deg":
        return float(common.numbers(str(answer), option)[0])
    if error.option == "pitch_um":
        return _pitch(str(answer))
    return common.words(str(answer)) if error.option in ("columns", "ignore") else str(answer)
