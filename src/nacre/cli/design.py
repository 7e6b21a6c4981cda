"""Commands that design and fabricate: design, gamut, fabricate, formulate."""

from __future__ import annotations

import contextlib
import json
import math
from pathlib import Path
from typing import Any

import click

from nacre.cli import common
from nacre.cli.common import COMPILING, LONG_COMPILE_S
from nacre.core.errors import NacreError
from nacre.core.files import check_output, check_room, check_writable, read_text, short_name, write_text
from nacre.core.jobs import Workers

MAX_LISTED = 20  # colours of a batch
TARGETS = ("png16", "tiff16", "stl", "gds", "oas", "csv", "npy", "sheet")


@click.command()
@click.argument("target", metavar="TARGET.toml")
@click.option("-o", "output", default=None, metavar="DIR", help="Default: the target's name.")
@click.option("--resume", is_flag=True, help="Resume a stopped run of the same target.")
@click.option(
    "--many",
    "labs",
    default=None,
    metavar="LABS.csv",
    help="Design for each row of L, a, b, or name, L, a, b, in place of TARGET's colours; a folder and a row of "
    "many.csv for each.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the result's numbers as JSON.")
@common.cluster_options
@common.run_options
def design(
    target: str, output: str | None, resume: bool, labs: str | None, as_json: bool, workers: Workers
) -> None:  # fmt: skip
    """Find a structure with the appearance of TARGET; the best solution so far is always on disk.

    TARGET holds [[target]] tables, for a film, pearl, metasurface or any other recipe, or a [target] table, for a
    relief. Ctrl-C ends the search with the best solution so far.
    """
    import os

    from nacre.optimise.run import read_target, run
    from nacre.optimise.solutions import NEED_BYTES

    name = Path(target).stem
    folder = Path(output or (name if labs is None else f"{name}-{Path(labs).stem}"))
    if not folder.exists():
        check_writable(folder)
    check_room(folder, NEED_BYTES)
    if labs is not None:
        _design_many(read_target(target), labs, folder, resume, as_json, workers)
        return
    if workers.cluster is not None or workers.security is not None:
        raise NacreError("--cluster: one design runs on this machine; a cluster serves --many")
    jobs = os.environ.get("NACRE_JOBS")
    with _Screen() as screen:
        result = run(read_target(target), folder, resume, screen.show, int(jobs) if jobs else None)
    if as_json:
        click.echo(json.dumps(result.summary, default=str))
    else:
        _print_solutions(result)
    _print_next(result, target)
    if result.status == "interrupted":
        raise KeyboardInterrupt


def _design_many(target: Any, labs: str, folder: Path, resume: bool, as_json: bool, workers: Workers) -> None:
    """Design for each row of a CSV and print the results."""
    from nacre.optimise.batch import SUMMARY, TABLE, design_batch

    with _Screen() as screen:
        batch = design_batch(target, labs, folder, resume=resume, workers=workers, progress=screen.count)
    if as_json:
        click.echo((folder / SUMMARY).read_text(encoding="utf-8"), nl=False)
    else:
        met = sum(solution.is_met for solution in batch.solutions)
        click.echo(f"{met} of {len(batch.rows)} colours are met")
        pairs = list(zip(batch.rows, batch.solutions, strict=True))
        if len(pairs) > MAX_LISTED:
            pairs = sorted(pairs, key=lambda pair: -pair[1].worst.scaled)[:MAX_LISTED]
            click.echo(f"the {MAX_LISTED} farthest; all are in {folder / TABLE}")
        for row, solution in pairs:
            worst = solution.worst
            missed = "" if solution.is_met else f", not reached (tolerance {worst.target.tolerance:g})"
            light = "" if worst.lamp is None else f" under {worst.lamp}"
            name = row["name"] or row["folder"]
            click.echo(f"  {name}: {worst.distance_text} at {worst.target.geometry}{light}{missed}"
                       f"   {solution.recipe.parent if solution.recipe else ''}")  # fmt: skip
    common.note(f"{folder}: {TABLE}; nacre render {folder / batch.rows[0]['folder']}")


def _print_solutions(result: Any) -> None:
    """Print the outcome of a design and one line per solution; of a relief one line per colour."""
    click.echo(f"{result.message} ({result.seconds:.1f} s)")
    for number, solution in enumerate(result.solutions, start=1):
        if "loss_fixed" in result.summary:
            for one in solution.targets:
                missed = "" if one.is_met else f", not reached so far (tolerance {one.target.tolerance:g})"
                click.echo(f"  {one.distance_text} at {one.target.geometry} under {one.lamp}{missed}")
            continue
        worst = solution.worst
        share = solution.yield_share
        made = "" if share is None else f", yield {100 * share:.0f} %"
        total = solution.facts.get("total_nm")
        thick = "" if total is None else f", {total:.0f} nm in all"
        click.echo(f"  {number}  {worst.distance_text} at {worst.target.geometry}{thick}{made}"
                   f"   {solution.recipe.parent}")  # fmt: skip


def _print_next(result: Any, target: str) -> None:
    """Print the next commands."""
    from nacre.formats.layouts import PUBLISHED

    follow = f"nacre report {result.folder}"
    if "loss_fixed" in result.summary:
        curve = result.summary["calibration"]
        if curve and curve != PUBLISHED:
            curve = Path(target).parent / curve
        follow = f"nacre fabricate {result.folder} --to png16" + (f" --calibration {curve}" if curve else "")
        if result.summary.get("outside"):
            common.note(f"{result.folder}: {result.summary['outside']}")
    page = "report.html; " if (result.folder / "report.html").is_file() else ""
    common.note(f"{result.folder}: {page}nacre render {result.folder}; {follow}")


class _Screen:
    """Status line of a design on a terminal: worst target or loss, remaining time."""

    def __init__(self) -> None:
        from rich.console import Console

        self._is_reported = False
        console = Console(stderr=True)
        self._status = console.status("designing") if console.is_terminal else None
        self._exits = contextlib.ExitStack()

    def __enter__(self) -> _Screen:
        from nacre.core.jit import on_compile

        self._exits.enter_context(on_compile(self._report_compiling))
        if self._status:
            self._exits.enter_context(self._status)
        return self

    def __exit__(self, *_: object) -> None:
        self._exits.close()

    def _report_compiling(self, seconds: float) -> None:
        """Report once that kernels are being compiled."""
        if seconds > LONG_COMPILE_S and not self._is_reported and self._status is None:  # a terminal has its own line
            self._is_reported = True
            common.note(COMPILING)

    def count(self, done: int, total: int) -> None:
        """Show how many designs of a batch are done."""
        if self._status:
            self._status.update(f"{done} of {total} colours")

    def show(self, progress: Any) -> None:
        """Show the search's progress."""
        if self._status:
            remaining = f", {progress.seconds_left:.0f} s left" if math.isfinite(progress.seconds_left) else ""
            self._status.update(f"{progress.description}, {progress.seconds:.0f} s{remaining}")


@click.command()
@click.argument("recipe")
@click.option(
    "--parameter",
    "parameters",
    multiple=True,
    metavar="PATH=A:B",
    help="A number with its bounds, or a word with its choices as PATH=Al,Ag. May be repeated.",
)
@click.option(
    "--geometry",
    default=None,
    help="specular T, transmitted T, diffuse T, hemispherical T or IasA. Default: specular 0; pearl or relief 45as15, "
    "photonic glass 45as45; the next of these if the recipe has no light there.",
)
@click.option("--points", type=click.IntRange(8, 1_000_000), default=1000, show_default=True, help="Materials tried.")
@click.option(
    "--seconds",
    type=click.FloatRange(1.0),
    default=None,
    help="Time limit of the search, with the points found so far. Default: unlimited.",
)
@click.option(
    "--tolerance", type=float, default=2.0, show_default=True, help="dE00 up to which a colour counts as reached."
)
@click.option("--illuminant", default="D65", show_default=True, help=common.LAMPS)
@click.option("--observer", type=click.Choice(["2deg", "10deg"]), default="10deg", show_default=True)
@click.option("--samples", type=click.IntRange(1, 10**8), default=None, help=common.WALKS)
@click.option("--seed", type=click.IntRange(0, 2**32 - 1), default=0, show_default=True)
@click.option("--json", "as_json", is_flag=True, help="Print every point with its colour and its structure.")
@click.option("-o", "output", default=None, metavar="FILE.png|.json|.html", help="Default: RECIPE-gamut.png.")
@common.recipe_options
def gamut(
    recipe: str, parameters: tuple[str, ...], geometry: str | None, as_json: bool, output: str | None,
    changes: tuple[str, ...], **search: Any,
) -> None:  # fmt: skip
    """Show the colours that RECIPE reaches with its parameters, in a*b* and xy, and their share of all colours."""
    from nacre.optimise.gamut import find_gamut, gamut_chart, gamut_page

    path = Path(output) if output else None if as_json else Path(f"{short_name(recipe)}-gamut.png")
    if path is not None:
        check_output(path, ".png", ".pdf", ".svg", ".json", ".html")
    material = common.load_material(recipe, changes)
    with common.progress_bar("gamut") as bar:
        task = bar.add_task("gamut", total=search["points"], info="")
        area = find_gamut(
            material, parameters, geometry, **search,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )  # fmt: skip
    if path is not None:
        if path.suffix == ".json":
            write_text(path, json.dumps(area.document(), indent=1) + "\n")
        elif path.suffix == ".html":
            write_text(path, gamut_page(area, material.name))
        else:
            from nacre.plot import save_figure

            save_figure(gamut_chart(area, title=f"{material.name}, {area.geometry}"), path, {"recipe": material.text})
    if as_json:
        click.echo(json.dumps(area.document()))
    else:
        low, high = area.lab.min(axis=0), area.lab.max(axis=0)
        click.echo(f"{material.name}: {area.geometry}, {search['illuminant']}, {search['observer']} observer, "
                   f"{len(area.lab)} points")  # fmt: skip
        click.echo("  " + ", ".join(f"{n} {a:.0f} to {b:.0f}" for n, a, b in zip(("L*", "a*", "b*"), low, high)))
        click.echo(f"  within dE00 {search['tolerance']:g}: {100 * area.share_of_srgb:.1f} % of the colours of sRGB, "
                   f"{100 * area.share_of_optimal:.1f} % of the optimal colours")  # fmt: skip
        tried = len(area.lab) + area.failed
        points = search["points"] if area.possible is None else area.possible
        if tried < points:
            click.echo(f"  stopped after {search['seconds']:g} s: {tried} of {points} points; --seconds gives it more")
        if area.failed:
            click.echo(f"  {area.failed} points could not be computed")
    if path is not None:
        common.note(str(path))


@click.command()
@click.argument("source", metavar="DESIGN_DIR|RECIPE")
@click.option("--to", "target", required=True, type=click.Choice(TARGETS))
@click.option("-o", "output", default=None, metavar="FILE", help="Default: SOURCE-TO and the suffix.")
@click.option(
    "--calibration",
    multiple=True,
    metavar="CSV|published",
    help="Heights: grey value against depth in um; default: linear, 65535 is the top, 0 the deepest point. Numbers "
    "from an image: machine setting against value, such as volts, nm; for several numbers PATH=CSV each.",
)
@click.option("--size-mm", default=None, metavar="WxH", help="Tile the pattern over an area; for a picture: its size.")
@click.option("--levels", type=click.IntRange(2, 256), default=None, help="gds, oas: number of heights or values.")
@click.option(
    "--seed",
    type=click.IntRange(0, 2**32 - 1),
    default=None,
    help="Seed of random points; default: the recipe's.",
)
@common.run_options
def fabricate(
    source: str, target: str, output: str | None, calibration: tuple[str, ...], size_mm: str | None,
    levels: int | None, seed: int | None,
) -> None:  # fmt: skip
    """Write the files to make a design or a material."""
    from nacre.api import fabricate as write
    from nacre.formats.fabrication import SUFFIXES
    from nacre.formats.number_maps import SUFFIXES as MAP_SUFFIXES

    name = short_name(source)
    path = Path(output) if output else Path(f"{name}-{target}{(MAP_SUFFIXES | SUFFIXES)[target]}")
    check_writable(path)
    area = None
    if size_mm is not None:
        try:
            width, height = (float(v) for v in size_mm.lower().split("x"))
        except ValueError:
            raise NacreError(f'--size-mm = "{size_mm}" cannot be read; write it like 50x50') from None
        if not (0 < width <= 1000 and 0 < height <= 1000):
            raise NacreError(f'--size-mm = "{size_mm}" must lie between 0 and 1000 mm')
        area = (width, height)
    paths = write(source, target, path, calibration=_curves(calibration), size_mm=area, levels=levels, seed=seed)
    for file in paths:
        common.note(str(file))
    if target in ("png16", "tiff16"):
        for beside in (file for file in paths if file.suffix == ".json"):
            _print_curve(beside)


def _curves(texts: tuple[str, ...]) -> str | dict[str, str | Path] | None:
    """Return one calibration curve, or a table of curves by recipe path.

    Raises:
        NacreError: one of several curves has no path.
    """
    if len(texts) < 2 and not (texts and "=" in texts[0] and not Path(texts[0]).exists()):
        return texts[0] if texts else None
    table: dict[str, str | Path] = {}
    for each in texts:
        path, equals, file = each.partition("=")
        if not equals or not file or path in table:
            raise NacreError(f'--calibration "{each}": of several numbers write PATH=CSV each, every path once')
        table[path] = file
    return table


def _print_curve(beside: Path) -> None:
    """Print the calibration curve of the grey values and its range."""
    facts = json.loads(beside.read_text(encoding="utf-8"))
    if "depth_um" not in facts:
        unit = facts["setting"] if "setting" in facts else facts["unit"] or ""
        of = f" of {facts['path']}" if "path" in facts else ""
        common.note(f"grey values{of}: 0 is {facts['black']:.6g}, 65535 is {facts['white']:.6g} {unit}".rstrip())
        return
    low, high = min(facts["depth_um"]), max(facts["depth_um"])
    stretched = ", stretched from 8 bits" if facts["stretched_from_8_bit"] else ""
    common.note(
        f"grey values: calibration {facts['calibration']}{stretched}, {low:.4g} to {high:.4g} um deep at grey "
        f"{facts['grey'][0]:.0f} to {facts['grey'][-1]:.0f}, {facts['nm_per_level']:.3g} nm a level"
    )


@click.command()
@click.argument("targets", nargs=-1, required=True, metavar="TARGET.toml...")
@click.option("-o", "output", default=None, metavar="FOLDER",
              help="Default: the name of the target; several targets get a folder each inside.")  # fmt: skip
@click.option("--resume", is_flag=True, help="Resume a stopped run of the same target.")
@click.option("--batch", default=None, metavar="COLOURS.csv",
              help="Correct a batch with these colours (geometry, L*, a*, b*) by additions; needs --made.")  # fmt: skip
@click.option("--made", default=None, metavar="FOLDER", help="Formulation that the batch was made by.")
@click.option("--answer", type=click.IntRange(1, 20), default=1, show_default=True, help="Number of the solution.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@common.run_options
def formulate(
    targets: tuple[str, ...], output: str | None, resume: bool, batch: str | None, made: str | None, answer: int,
    as_json: bool,
) -> None:  # fmt: skip
    """Choose pigments, a dye and concentrations from a library for the measured colours of each TARGET."""
    from nacre.optimise.formulation import check_answers, formulation_document, read_formulation
    from nacre.optimise.formulation import formulate as run

    if (batch is None) != (made is None):
        raise NacreError("--batch and --made belong together: the colours of a batch, and its formulation")
    if batch is not None and len(targets) > 1:
        raise NacreError(f"--batch corrects one target, not {len(targets)}")
    tasks = [read_formulation(target) for target in targets]  # refuses a bad one before the first search
    if batch is not None and made is not None:
        _rematch(tasks[0], batch, Path(made), answer, as_json)
        return
    folders = [Path(output or Path(target).stem) for target in targets]
    if len(targets) > 1:
        folders = [Path(output or ".") / Path(target).stem for target in targets]
        if output and not Path(output).exists():
            check_writable(output)
            Path(output).mkdir()
    for target, folder in zip(targets, folders, strict=True):
        if folders.count(folder) > 1:
            raise NacreError(f"{target}: another target has the folder {folder} too; rename one")
        check_answers(folder)
    documents = []
    for number, (task, folder) in enumerate(zip(tasks, folders, strict=True), start=1):
        result = run(
            task,
            folder,
            lambda done, total, best: common.note(f"{done} of {total}: rms {best:.3g}") if done == total else None,
            resume,
        )
        documents.append(formulation_document(result))
        if not as_json:
            if len(tasks) > 1:
                click.echo(f"{folder.name} ({number} of {len(tasks)})")
            _print(documents[-1])
        common.note(str(folder))
        if result.status == "interrupted":
            raise KeyboardInterrupt
    if as_json:
        click.echo(json.dumps(documents[0] if len(documents) == 1 else documents))


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
    from nacre.optimise.colour_list import read_colours
    from nacre.optimise.formulation import STARTED, SUMMARY, rematch

    try:
        document = json.loads(read_text(made / SUMMARY, "formulation"))
        if document["status"] == STARTED:
            raise NacreError(f"{made / SUMMARY}: is incomplete; run nacre formulate again")
        amounts = document["formulas"][answer - 1]["volume_fractions"]
    except (ValueError, KeyError, IndexError, TypeError):
        raise NacreError(f"{made / SUMMARY}: has no answer {answer}") from None
    light = (task.spec.light.illuminants[0], task.spec.light.observer)
    measured = {row.name: row.lab[0] for row in read_colours(batch, 1, light)}
    result = rematch(task, amounts, measured)
    if as_json:
        differences = {name: getattr(result, name).tolist() for name in ("de00_before", "de00_after")}
        document = result.__dict__ | differences
        click.echo(json.dumps(document))
        return
    for name, share in result.batch.items():
        click.echo(f"{name}: intended {amounts[name]:.5f}, in the batch {share:.5f} of the volume")
    for name, volume in result.additions.items():
        click.echo(f"add {name}: {1000 * volume:.3g} ml per litre of dry batch")
    click.echo(f"mean dE00 {result.de00_before.mean():.2f} becomes {result.de00_after.mean():.2f}; the additions cost "
               f"{result.cost_per_kg_of_batch:.3f} per kg of the batch")  # fmt: skip
