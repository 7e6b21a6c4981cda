"""`nacre studio`: a local web page that shows a recipe live while its parameters change."""

from __future__ import annotations

import click

from nacre.cli import common


@click.command()
@click.argument("what", metavar="[RECIPE|FOLDER]", required=False)
@click.option(
    "--port", type=click.IntRange(0, 65535), default=None, metavar="N",
    help="Listen on this port, 0 for any that is free; default: 8642, or any.",
)  # fmt: skip
@click.option("--no-browser", is_flag=True, help="Only print the address, and open nothing.")
@common.jobs_option
def studio(what: str | None, port: int | None, no_browser: bool) -> None:
    """Open a live page on a RECIPE, or on a FOLDER of recipes, in the browser.

    Prints one address, with a token without which nobody else on this machine can use it, and serves until Ctrl-C.
    Recipes are read from the folder and saved into it; default: the current one. Needs no network.
    """
    from nacre.studio.folder import OpenedFolder

    opened = OpenedFolder.of(what)
    from nacre.studio.server import serve

    serve(opened, port, not no_browser)


commands = {"studio": studio}
