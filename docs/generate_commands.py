"""The reference of the commands, from the commands themselves."""

from __future__ import annotations

import click


def page() -> str:
    """Return the page of all commands with their options."""
    from nacre.cli import COMMANDS, cli

    lines = [
        "# Commands", "",
        "Made from the command line itself; `nacre COMMAND --help` says the same. Numbers in lists are written "
        "`0,30,60` or `start:end:step`, both ends included. `--debug` anywhere on the line shows a traceback in place "
        "of the one-line error. Exit status: 0, 2 for bad input, 130 after Ctrl-C.", "",
    ]  # fmt: skip
    root = click.Context(cli, info_name="nacre")
    for name in COMMANDS:
        command = cli.get_command(root, name)
        if command is not None:
            lines += _command(command, name, root, 2)
    return "\n".join(lines)


def _command(command: click.Command, name: str, parent: click.Context, level: int) -> list[str]:
    context = click.Context(command, info_name=name, parent=parent)
    usage = " ".join(command.collect_usage_pieces(context))
    lines = [f"{'#' * level} {context.command_path}", "", _text(command.help or ""), ""]
    lines += ["```text", f"{context.command_path} {usage}", "```", ""]
    rows = []
    for parameter in command.get_params(context):
        record = parameter.get_help_record(context)
        if record is not None and "--help" not in record[0]:
            rows.append(f"| {_code(record[0])} | {_text(record[1])} |")
    if rows:
        lines += ["| option | |", "|---|---|", *rows, ""]
    if isinstance(command, click.Group):
        for inner in command.list_commands(context):
            found = command.get_command(context, inner)
            if found is not None:
                lines += _command(found, inner, context, level + 1)
    return lines


def _code(text: str) -> str:
    return "`" + text.replace("|", "\\|") + "`"


def _text(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("*", "\\*").replace("<", "\\<").replace("[", "\\[")
