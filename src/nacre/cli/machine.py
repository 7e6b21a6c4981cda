"""Commands about the installation: doctor, indices, examples, cache."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING

import click

from nacre.cli import common
from nacre.core.files import check_writable

if TYPE_CHECKING:
    from pathlib import Path


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

    found = library.search(text)
    for entry in found[:limit]:
        reach = "" if entry.range_nm is None else f"  {_range(entry.range_nm)}"
        click.echo(f"{entry.name:32s} {entry.title}{reach}")
    for line in library.pairs_among([entry.name for entry in found[:limit]]):
        click.echo(line)
    if len(found) > limit:
        common.note(f"... and {len(found) - limit} more; use --limit")
    if not found:
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
    found = disk_cache.entries(folder) if folder else []
    total = sum(size for _, size, _ in found)
    materials = sum(disk_cache.is_material(path) for _, _, path in found)
    if as_json:
        click.echo(json.dumps({
            "folder": None if folder is None else str(folder), "entries": len(found), "materials": materials,
            "parts": len(found) - materials, "bytes": total, "most_bytes": disk_cache.MAX_BYTES, "removed": removed,
        }))  # fmt: skip
        return
    if folder is None:
        click.echo("off: NACRE_CACHE=off")
        return
    gone = f"; removed: {_in_words(before)}" if clear else ""
    room = f"{total / 1e6:.1f} of at most {disk_cache.MAX_BYTES / 1e6:.0f} MB"
    click.echo(f"{folder}: {_in_words(found)}, {room}{gone}")


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
        written = copy_examples(list(names), Path(folder))
        common.note(f"{folder}: {len(written)} files")
        return
    found = [e for e in shipped() if not names or any(n in e.name or n == e.family for n in names)]
    if as_json:
        fields = ("name", "family", "about")
        click.echo(json.dumps([{f: getattr(e, f) for f in fields} | {"path": str(e.path)} for e in found], indent=2))
        return
    width = max((len(e.name) for e in found), default=0)
    columns = max(60, _terminal_width() - width - 16)
    for e in found:
        about = e.about if len(e.about) <= columns else e.about[: columns - 3].rstrip() + "..."
        click.echo(f"{e.name:{width}s}  {e.family:11s}  {about}")
    if not found:
        common.note(f"no example is called {', '.join(names)}")


def _terminal_width() -> int:
    try:
        return os.get_terminal_size().columns
    except OSError:
        return 120


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
