"""The command line.

The module of a command is imported only when the command runs, which keeps `nacre --help` fast. Bad input ends with one
line on stderr and status 2; `--debug` shows the traceback instead.
"""

from __future__ import annotations

import atexit
import gc
import importlib
import os
import sys
import warnings
from pathlib import Path
from typing import Any

import click

from nacre._version import __version__
from nacre.cli import common
from nacre.core.errors import NacreError, did_you_mean
from nacre.core.files import stored
from nacre.core.jit import may_be_stored, on_compile, spare_compilation
from nacre.core.lazy import missing_line
from nacre.core.progress import on_progress

GARBAGE_AFTER = 50_000  # new container objects
ONE_SHOT = ("spectrum", "evaluate", "ellipsometry", "report", "plot", "render", "export")  # solve one material, and end
# points times interfaces solved in NumPy, 0.2 µs each, before the kernel: loading it takes 0.5 s, compiling it 10 s
SPARED, SPARED_UNCOMPILED = 1e6, 24e6

# name -> (module, description)
COMMANDS: dict[str, tuple[str, str]] = {
    "demo": ("nacre.cli.render", "Make pictures and plots of every example recipe, with a contact sheet."),
    "render": ("nacre.cli.render", "Render a material on an object."),
    "spectrum": ("nacre.cli.show", "Print reflectance and transmittance over angle and wavelength."),
    "orders": ("nacre.cli.show", "Print the diffraction orders of a grating."),
    "ellipsometry": ("nacre.cli.analysis", "Print Psi, Delta and Mueller matrices over angle and wavelength."),
    "evaluate": ("nacre.cli.show", "Evaluate the BSDF for given directions."),
    "plot": ("nacre.cli.show", "Draw a figure of a material."),
    "compile": ("nacre.cli.show", "Solve a recipe once and store the result as a .nacre file."),
    "design": ("nacre.cli.design", "Find a structure with a target appearance."),
    "gamut": ("nacre.cli.design", "Show the colours that parameters can reach."),
    "fabricate": ("nacre.cli.design", "Write the files to make a design or a material."),
    "export": ("nacre.cli.show", "Write a material in another program's format."),
    "blender": ("nacre.cli.machine", "Write the extension for Blender."),
    "read": ("nacre.cli.machine", "Show the content of a file from an instrument or another program."),
    "import": ("nacre.cli.show", "Read a measurement or another program's material into a recipe."),
    "fit": ("nacre.cli.analysis", "Fit parameters of a recipe to measurements."),
    "studio": ("nacre.cli.render", "Open a live page on a recipe, on this machine only."),
    "report": ("nacre.cli.analysis", "Report colour, gloss, haze and flop as instruments measure them."),
    "tolerance": ("nacre.cli.analysis", "Compute colour variation and yield from manufacturing tolerances."),
    "diagnose": ("nacre.cli.analysis", "Estimate the deviations in a finished coating run."),
    "formulate": ("nacre.cli.design", "Match an effect paint with pigments of a library."),
    "runsheet": ("nacre.cli.analysis", "Print monitor signals and stop criteria of a coating run."),
    "sweep": ("nacre.cli.analysis", "Compute a material over many values of its numbers."),
    "indices": ("nacre.cli.machine", "Search and show optical constants."),
    "examples": ("nacre.cli.machine", "List the recipes that come with nacre, or copy them."),
    "keys": ("nacre.cli.keys", "Print the keys of recipes, targets and sweeps."),
    "cache": ("nacre.cli.machine", "Show or clear the disk cache of solved materials."),
    "doctor": ("nacre.cli.machine", "Check this machine and say how to fix problems."),
}


class LazyGroup(click.Group):
    """A group that imports a command only to run it or to show its help."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in COMMANDS:
            return None
        module = importlib.import_module(COMMANDS[name][0])
        command: click.Command = getattr(module, name, None) or getattr(module, f"{name}_")  # `import_`, `compile_`
        return command

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        if args and args[0] not in COMMANDS:
            hint = did_you_mean(args[0], COMMANDS)
            raise click.UsageError(f'no command "{args[0]}".{hint} Commands: {", ".join(COMMANDS)}')
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, COMMANDS[name][1]) for name in COMMANDS])


@click.group(
    cls=LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    help="Structural colour from nanostructure to picture and back.\n\nA material is a recipe: a TOML file with a "
    "family and its physical numbers. Start with: nacre demo --quick\n\nOn a terminal nacre asks before work of "
    "minutes; --yes confirms.",
)
@click.version_option(__version__, "--version", prog_name="nacre")
def cli() -> None:
    """Group of all commands."""


def main(argv: list[str] | None = None) -> None:
    """Run the command line and exit with its status.

    `--debug` shows tracebacks in place of one-line errors; `--yes` confirms work of minutes.
    """
    common.hold_closed_streams()
    # garbage collection of the million imported objects takes 0.3 s by default, and 0.2 s at exit
    gc.set_threshold(GARBAGE_AFTER)
    atexit.register(gc.freeze)
    words = sys.argv[1:] if argv is None else argv
    if words and words[0] in ONE_SHOT:
        stack = Path(__file__).parents[1] / "matter" / "stack"
        spare_compilation(SPARED if may_be_stored(stack, "kernel.solve_range") else SPARED_UNCOMPILED)
    sys.exit(run(words))


def run(argv: list[str]) -> int:
    """Run one command line and return its exit status: 0, 2 for bad input, 130 when interrupted."""
    debug, yes = "--debug" in argv, "--yes" in argv
    argv = [word for word in argv if word not in ("--debug", "--yes")]
    stored.clear()
    try:
        if any("\0" in word for word in argv):
            raise NacreError("an argument holds a NUL character, which no file name and no number has")
        with on_progress(common.listener(yes)), on_compile(common.compile_listener()), warnings.catch_warnings():
            warnings.showwarning = _show_warning  # type: ignore[assignment]  # takes the rest by *where
            cli.main(args=argv, prog_name="nacre", standalone_mode=False)
        sys.stdout.flush()
    except click.exceptions.Exit as leave:
        return leave.exit_code
    except BrokenPipeError:
        # the reader of the output has ended (`nacre ... | head`)
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (Exception, KeyboardInterrupt) as error:
        if debug and not isinstance(error, click.ClickException):
            raise
        status, line = _outcome(error)
        common.note(line)
        return status
    return 0


def _outcome(error: BaseException) -> tuple[int, str]:
    """Return the exit status and the message for an error."""
    if isinstance(error, KeyboardInterrupt | click.Abort):
        return common.STATUS_INTERRUPTED, common.stopped_line()
    if isinstance(error, click.ClickException):
        context = getattr(error, "ctx", None)
        command = f" {context.info_name}" if context is not None and context.parent is not None else ""
        return common.STATUS_BAD_INPUT, f"nacre{command}: {error.format_message()}"
    if isinstance(error, NacreError):
        return common.STATUS_BAD_INPUT, f"nacre: {error}"
    if isinstance(error, MemoryError):
        return common.STATUS_BAD_INPUT, "nacre: not enough memory; try a smaller size"
    if isinstance(error, OSError):
        name = f"{error.filename}: " if error.filename else ""
        return common.STATUS_BAD_INPUT, f"nacre: {name}{error.strerror or error}"
    if _was_interrupted(error):
        return common.STATUS_INTERRUPTED, common.stopped_line()
    if isinstance(error, ModuleNotFoundError) and (line := missing_line(error.name or "")):
        return common.STATUS_BAD_INPUT, f"nacre: {line}"
    return 1, (
        f"nacre: this is a bug in nacre, please report it: {type(error).__name__}: "
        f"{str(error)[:300]} (run again with --debug for the details)"
    )


def _show_warning(message: Warning | str, category: type[Warning], *where: Any) -> None:
    """Print a warning as a message, without the line of code; of others than nacre with its type."""
    is_own = category.__module__.partition(".")[0] == "nacre"
    common.note(str(message) if is_own else f"{category.__name__}: {message}")


def _was_interrupted(error: BaseException | None) -> bool:
    """Whether an interrupt caused an error; the renderer wraps interrupts."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__cause__ or error.__context__
    return False
