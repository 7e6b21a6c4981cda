"""Commands for files and the installation: read, doctor, indices, examples, cache, blender."""

from __future__ import annotations

import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from nacre.cli import common
from nacre.core.errors import NacreError
from nacre.core.files import check_writable

if TYPE_CHECKING:
    from nacre.readers.measurement import AmbiguousFileError, Measurement, ReadOptions


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print the findings as JSON.")
@common.jobs_option
def doctor(as_json: bool) -> None:
    """Check this machine and say how to fix problems."""
    from nacre.device.doctor import examine

    findings = examine()
    if as_json:
        click.echo(json.dumps([finding.__dict__ for finding in findings], indent=2))
        return
    width = max(len(finding.what) for finding in findings)
    for finding in findings:
        mark = {"ok": "ok  ", "note": "note", "bad": "BAD "}[finding.state]
        click.echo(f"{mark}  {finding.what.ljust(width)}  {finding.found}")
        if finding.advice:
            click.echo(f"      {''.ljust(width)}  -> {finding.advice}")
    bad = [finding for finding in findings if finding.state == "bad"]
    click.echo("everything works" if not bad else f"{len(bad)} problem{'s' * (len(bad) > 1)}, see above")


@click.group()
def indices() -> None:
    """Search and show optical constants."""


@indices.command("search")
@click.argument("text")
@click.option("--limit", type=click.IntRange(1, 1000), default=20, show_default=True)
def indices_search(text: str, limit: int) -> None:
    """List the materials whose name or database entry contains TEXT."""
    from nacre.matter.indices import library

    matches = library.search(text)
    for entry in matches[:limit]:
        reach = "" if entry.range_nm is None else f"  {_range(entry.range_nm)}"
        click.echo(f"{entry.name:32s} {entry.title}{reach}")
    for line in library.pairs_among([entry.name for entry in matches[:limit]]):
        click.echo(line)
    if len(matches) > limit:
        common.note(f"... and {len(matches) - limit} more; use --limit")
    if not matches:
        from nacre.matter.indices.constant import scattering_hint

        hint = scattering_hint(text)
        common.note(f'nothing is called "{text}"' + (f": {hint}" if hint else ""))


def _range(range_nm: tuple[float, float]) -> str:
    low, high = range_nm
    return "any wavelength" if low <= 0 and high > 1e9 else f"{low:g} to {high:g} nm"


@indices.command("show")
@click.argument("name")
@click.option("-o", "output", metavar="FILE", help="Also draw n and k to FILE (.png or .pdf).")
@click.option("--json", "as_json", is_flag=True, help="Print the values as JSON.")
def indices_show(name: str, output: str | None, as_json: bool) -> None:
    """Show source, range and values of an optical constant."""
    import numpy as np

    from nacre.matter.indices import library

    if output:
        check_writable(output)
    constant = library.index({"rii": name} if "/" in name else name)
    entry = constant.describe()
    low, high = constant.range_nm
    visible = low < 830 and high > 360
    grid = np.linspace(max(low, 360.0), min(high, 830.0), 11) if visible else np.linspace(low, high, 11)
    values = constant.n_complex(grid)
    if as_json:
        click.echo(json.dumps({
            "name": name, "title": entry.title, "source": entry.source, "splice": entry.splice,
            "range_nm": [low, high if np.isfinite(high) else None],
            "wavelengths_nm": grid.tolist(), "n": values.real.tolist(), "k": values.imag.tolist(),
        }))  # fmt: skip
    else:
        click.echo(f"{name}: {entry.title}\nsource: {entry.source}\nrange:  {_range((low, high))}")
        if entry.splice:
            click.echo(f"splice: {entry.splice}")
        if remark := library.pair_remark(name):
            click.echo(f"axes:   {remark}")
        click.echo("\n    nm         n         k")
        for wavelength, value in zip(grid, values, strict=True):
            click.echo(f"{wavelength:6.1f}  {value.real:8.4f}  {value.imag:8.4f}")
    if output:
        from nacre.plot import save_index

        save_index(constant, output, title=name)
        common.note(output)


@click.command()
@click.option("--clear", is_flag=True, help="Remove all entries.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def cache(clear: bool, as_json: bool) -> None:
    """Show folder and size of the disk cache of solved materials; --clear empties it.

    Besides whole materials it holds parts, such as patterns of an ensemble and T-matrices, with which a stopped run is
    resumed. The folder is $NACRE_CACHE, or nacre in the user's cache folder; NACRE_CACHE=off disables the cache.
    """
    from nacre.core import disk_cache

    folder = disk_cache.cache_folder()
    before = disk_cache.entries(folder) if folder else []
    removed = disk_cache.clear(folder) if clear and folder else 0
    remaining = disk_cache.entries(folder) if folder else []
    total = sum(size for _, size, _ in remaining)
    materials = sum(disk_cache.is_material(path) for _, _, path in remaining)
    if as_json:
        click.echo(json.dumps({
            "folder": None if folder is None else str(folder), "entries": len(remaining), "materials": materials,
            "parts": len(remaining) - materials, "bytes": total, "most_bytes": disk_cache.MAX_BYTES, "removed": removed,
        }))  # fmt: skip
        return
    if folder is None:
        click.echo("off: NACRE_CACHE=off")
        return
    removal = f"; removed: {_in_words(before)}" if clear else ""
    room = f"{total / 1e6:.1f} of at most {disk_cache.MAX_BYTES / 1e6:.0f} MB"
    click.echo(f"{folder}: {_in_words(remaining)}, {room}{removal}")


def _in_words(entries: list[tuple[float, int, Path]]) -> str:
    """Return the numbers of whole materials and of parts in words."""
    from nacre.core.disk_cache import is_material

    materials = sum(is_material(path) for _, _, path in entries)
    parts = len(entries) - materials
    also = f" and {parts} part{'s' * (parts != 1)} of materials" if parts else ""
    return f"{materials} material{'s' * (materials != 1)}{also}"


@click.command()
@click.argument("names", metavar="[NAME]...", nargs=-1)
@click.option("-o", "folder", default=None, metavar="DIR", help="Copy them there, with the files that they name.")
@click.option("--json", "as_json", is_flag=True, help="Print the list as JSON.")
def examples(names: tuple[str, ...], folder: str | None, as_json: bool) -> None:
    """List the recipes that come with nacre, or copy them.

    Commands accept the names in place of recipe files: nacre render soap. NAME selects names and families that contain
    it; with -o the named examples, or all, are copied.
    """
    from nacre.material.examples import copy_examples
    from nacre.material.examples import examples as shipped

    if folder is not None:
        paths = copy_examples(list(names), Path(folder))
        common.note(f"{folder}: {len(paths)} files")
        return
    matches = [e for e in shipped() if not names or any(n in e.name or n == e.family for n in names)]
    if as_json:
        fields = ("name", "family", "about")
        click.echo(json.dumps([{f: getattr(e, f) for f in fields} | {"path": str(e.path)} for e in matches], indent=2))
        return
    width = max((len(e.name) for e in matches), default=0)
    columns = max(60, shutil.get_terminal_size((120, 24)).columns - width - 16)
    for e in matches:
        about = e.about if len(e.about) <= columns else e.about[: columns - 3].rstrip() + "..."
        click.echo(f"{e.name:{width}s}  {e.family:11s}  {about}")
    if not matches:
        common.note(f"no example is called {', '.join(names)}")


@click.command()
@click.argument("recipes", metavar="[RECIPE]...", nargs=-1)
@click.option("-o", "output", default="nacre-blender.zip", show_default=True, metavar="FILE.zip", help="The extension.")
def blender(recipes: tuple[str, ...], output: str) -> None:
    """Write the extension for Blender 4.2 and newer.

    In Blender: Preferences, Get Extensions, Install from Disk. Each RECIPE is solved now and comes with the
    extension, for machines without nacre.
    """
    from nacre.studio.blender import write_extension

    check_writable(output)
    write_extension(Path(output), recipes, lambda event: common.note(event["what"]))
    common.note(output)


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
    **stated: Any,
) -> None:  # fmt: skip
    """Show the content of FILE: format, quantities, units, range, and assumed or omitted values."""
    from nacre.readers.measurement import ReadOptions, describe, lines, write_measurements

    for path in filter(None, (plot, output)):
        check_writable(path)
    options = ReadOptions(
        format=format_id, pitch_um=_pitch(stated.pop("pitch_um")), columns=common.words(stated.pop("columns")),
        ignore=common.words(stated.pop("ignore")), **stated,
    )  # fmt: skip
    measurements = [measurement for file in files for measurement in _opened(file, options)]
    if as_json:
        click.echo(json.dumps([describe(measurement, show) for measurement in measurements], ensure_ascii=False))
    elif not output:
        for measurement in measurements:
            click.echo("\n".join(lines(measurement, _title(measurement), show)))
    if output:
        write_measurements(output, measurements)
        common.note(output)
    if plot:
        from nacre.plot.measurements import measurement_figure
        from nacre.plot.style import save_figure

        save_figure(measurement_figure(measurements), plot)
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
            options = replace(options, **{error.option: _prompted(error, option)})


def _prompted(error: AmbiguousFileError, option: str) -> Any:
    """Return the user's answer, in the option's type."""
    kind = click.Choice(error.choices) if error.choices else None
    answer = click.prompt(f"{error}\n{option}", type=kind, err=True)
    if error.option == "angle_deg":
        return float(common.numbers(str(answer), option)[0])
    if error.option == "pitch_um":
        return _pitch(str(answer))
    return common.words(str(answer)) if error.option in ("columns", "ignore") else str(answer)
