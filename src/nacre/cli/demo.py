"""`nacre demo`: everything in one run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from nacre.cli import common


@click.command()
@click.option("--out", default="demo", show_default=True, metavar="DIR")
@click.option("--quick", is_flag=True, help="Small pictures of a few recipes, in about a minute.")
@common.jobs_option
def demo(out: str, quick: bool) -> None:
    """Make pictures, figures and animations of every example recipe, and a contact sheet."""
    from nacre.cli.gallery import run_demo

    def show(item: Any, number: int, total: int, seconds: float, left: float) -> None:
        common.note(f"[{number:2d}/{total}] {_clock(seconds)} spent, about {_clock(left)} left: {item.title}")

    files = run_demo(Path(out), quick, show)
    common.note(f"{len(files)} files in {out}; begin with {files[0]}")


def _clock(seconds: float) -> str:
    return f"{int(seconds // 60)}:{int(seconds % 60):02d}"


commands = {"demo": demo}
