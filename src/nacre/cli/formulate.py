"""Command that matches effect paints with pigments of a library."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from nacre.cli import common
from nacre.core.errors import NacreError


@click.command()
@click.argument("target", metavar="TARGET.toml")
@click.option("-o", "output", default=None, metavar="FOLDER", help="Default: the name of the target.")
@click.option("--batch", default=None, metavar="COLOURS.csv",
              help="Correct a batch with these colours (geometry, L*, a*, b*) by additions; needs --made.")  # fmt: skip
@click.option("--made", default=None, metavar="FOLDER", help="Formulation that the batch was made by.")
@click.option("--answer", type=click.IntRange(1, 20), default=1, show_default=True, help="Its answer.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@common.cache_option
@common.jobs_option
def formulate(
    target: str, output: str | None, batch: str | None, made: str | None, answer: int, as_json: bool
) -> None:  # fmt: skip
    """Choose pigments, a dye and concentrations from a library for the measured colours of TARGET."""
    from nacre.optimise.formulation.formulate import (
        check_answers,
        formulation_document,
        read_formulation,
        write_formulation,
    )
    from nacre.optimise.formulation.formulate import (
        formulate as run,
    )

    if (batch is None) != (made is None):
        raise NacreError("--batch and --made belong together: the colours of a batch, and its formulation")
    task = read_formulation(target)
    if batch is not None and made is not None:
        _rematch(task, batch, Path(made), answer, as_json)
        return
    folder = Path(output or Path(target).stem)
    check_answers(folder)
    found = run(
        task, lambda done, total, best: common.note(f"{done} of {total}: rms {best:.3g}") if done == total else None
    )
    write_formulation(found, folder)
    document = formulation_document(found)
    if as_json:
        click.echo(json.dumps(document))
    else:
        _print(document)
    common.note(str(folder))
    if found.status == "interrupted":
        raise KeyboardInterrupt


def _print(document: dict[str, Any]) -> None:
    for number, each in enumerate(document["formulas"], start=1):
        parts = ", ".join(f"{name} {_percent(share)} %" for name, share in each["mass_shares"].items())
        state = "within the tolerances" if each["met"] else "outside the tolerances"
        click.echo(f"{number}  dE00 mean {each['mean_de00']:.2f}, largest {max(each['de00']):.2f}, {state}")
        for name, one in each["texture"].items():
            click.echo(f"   {name} {one['value']:.4g}, {one['off_percent']:.2g} % off")
        click.echo(f"   by mass, dry: {parts}")
        errors = each["volume_fraction_errors"]
        volumes = [
            f"{name} {_percent(v)} +- {100 * errors[name]:.2g} %" for name, v in each["volume_fractions"].items()
        ]
        click.echo(f"   by volume, dry: {', '.join(volumes)}")
        click.echo(f"   {each['cost_per_kg']:.2f} per kg, {each['cost_per_m2']:.3f} per m2; contrast ratio "
                   f"{100 * each['contrast_ratio']:.1f} %")  # fmt: skip


def _percent(share: float) -> str:
    """Return a share in per cent: three digits, or two decimals if that says more."""
    return f"{100 * share:.2f}" if share >= 0.1 else f"{100 * share:.3g}"


def _rematch(task: Any, batch: str, made: Path, answer: int, as_json: bool) -> None:
    from nacre.core.files import read_text
    from nacre.optimise.colour_list import read_colours
    from nacre.optimise.formulation.formulate import SUMMARY, rematch

    try:
        amounts = json.loads(read_text(made / SUMMARY, "formulation"))["formulas"][answer - 1]["volume_fractions"]
    except (ValueError, KeyError, IndexError, TypeError):
        raise NacreError(f"{made / SUMMARY}: has no answer {answer}") from None
    light = (task.spec.light.illuminants[0], task.spec.light.observer)
    seen = {row.name: row.lab[0] for row in read_colours(batch, 1, light)}
    found = rematch(task, amounts, seen)
    if as_json:
        document = found.__dict__ | {"de00_before": found.de00_before.tolist(), "de00_after": found.de00_after.tolist()}
        click.echo(json.dumps(document))
        return
    for name, share in found.batch.items():
        click.echo(f"{name}: intended {amounts[name]:.5f}, in the batch {share:.5f} of the volume")
    for name, volume in found.additions.items():
        click.echo(f"add {name}: {1000 * volume:.3g} ml per litre of dry batch")
    click.echo(f"mean dE00 {found.de00_before.mean():.2f} becomes {found.de00_after.mean():.2f}; the additions cost "
               f"{found.cost_per_kg_of_batch:.3f} per kg of the batch")  # fmt: skip


commands: dict[str, click.Command] = {"formulate": formulate}
