"""Commands about the machine and the data: `nacre doctor`, `nacre indices`."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import click

from nacre.cli import common

if TYPE_CHECKING:
    from pathlib import Path


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print the findings as JSON.")
@common.jobs_option
def doctor(as_json: bool) -> None:
    """Say what works on this machine and what to do if something does not."""
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
    click.echo("everything works" if not bad else f"{len(bad)} thing{'s' * (len(bad) > 1)} to mend, see above")


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
    if len(found) > limit:
        common.note(f"... and {len(found) - limit} more; use --limit")
    if not found:
        common.note(f'nothing is called "{text}"')


def _range(range_nm: tuple[float, float]) -> str:
    low, high = range_nm
    return "any wavelength" if low <= 0 and high > 1e9 else f"{low:g} to {high:g} nm"


@indices.command("show")
@click.argument("name")
@click.option("-o", "output", metavar="FILE", help="Also draw n and k to FILE (.png or .pdf).")
@click.option("--json", "as_json", is_flag=True, help="Print the values as JSON.")
def indices_show(name: str, output: str | None, as_json: bool) -> None:
    """Show where an optical constant comes from, its range and its values."""
    import numpy as np

    from nacre.core.files import check_writable
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
        click.echo("\n    nm         n         k")
        for wavelength, value in zip(grid, values, strict=True):
            click.echo(f"{wavelength:6.1f}  {value.real:8.4f}  {value.imag:8.4f}")
    if output:
        from nacre.plot import save_index

        save_index(constant, output, title=name)
        common.note(output)


@click.command()
@click.option("--clear", is_flag=True, help="Remove everything that is kept.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def cache(clear: bool, as_json: bool) -> None:
    """Show where solved materials are kept on disk and how much there is; --clear removes them.

    Beside whole materials there are parts: patterns of an ensemble, T-matrices, from which a stopped run goes on.
    The folder is $NACRE_CACHE, or nacre in the user's cache folder; NACRE_CACHE=off keeps nothing.
    """
    from nacre.core import disk_cache as kept

    folder = kept.cache_folder()
    before = kept.entries(folder) if folder else []
    removed = kept.clear(folder) if clear and folder else 0
    found = kept.entries(folder) if folder else []
    total = sum(size for _, size, _ in found)
    materials = sum(kept.is_material(path) for _, _, path in found)
    if as_json:
        click.echo(json.dumps({
            "folder": None if folder is None else str(folder), "entries": len(found), "materials": materials,
            "parts": len(found) - materials, "bytes": total, "most_bytes": kept.MAX_BYTES, "removed": removed,
        }))  # fmt: skip
        return
    if folder is None:
        click.echo("off: NACRE_CACHE=off")
        return
    gone = f"; removed: {_in_words(before)}" if clear else ""
    room = f"{total / 1e6:.1f} of at most {kept.MAX_BYTES / 1e6:.0f} MB"
    click.echo(f"{folder}: {_in_words(found)}, {room}{gone}")


def _in_words(entries: list[tuple[float, int, Path]]) -> str:
    """Return how many materials the entries are, and how many parts that materials are made of."""
    from nacre.core.disk_cache import is_material

    materials = sum(is_material(path) for _, _, path in entries)
    parts = len(entries) - materials
    also = f" and {parts} part{'s' * (parts != 1)} of materials" if parts else ""
    return f"{materials} material{'s' * (materials != 1)}{also}"


commands = {"doctor": doctor, "indices": indices, "cache": cache}
