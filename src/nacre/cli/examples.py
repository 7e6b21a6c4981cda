"""`nacre examples`: the recipes that come with the package."""

from __future__ import annotations

import json
import os
from pathlib import Path

import click

from nacre.cli import common


@click.command()
@click.argument("names", metavar="[NAME]...", nargs=-1)
@click.option("-o", "folder", default=None, metavar="DIR", help="Copy them there, with the files that they name.")
@click.option("--json", "as_json", is_flag=True, help="Print the list as JSON.")
def examples(names: tuple[str, ...], folder: str | None, as_json: bool) -> None:
    """List the recipes that come with nacre, or copy them.

    Their names stand for them wherever a command takes a recipe: nacre render soap. With NAME only those whose name
    or family holds it are listed; with -o exactly those named are copied, or all.
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


commands = {"examples": examples}
