"""The command line: thin, quick to start, one line for every mistake.

Each command lives in a module that is imported only when the command runs, so that `nacre --help` answers at
once. Bad input ends with one line on stderr and status 2; `--debug` shows the traceback instead.
"""

from __future__ import annotations

import atexit
import gc
import importlib
import os
import sys
import warnings
from typing import Any

import click

from nacre._version import __version__
from nacre.cli.common import STATUS_BAD_INPUT, STATUS_INTERRUPTED, STOPPED, hold_closed_streams, say
from nacre.cli.progress import listener
from nacre.core.errors import NacreError, did_you_mean
from nacre.core.progress import on_progress

GARBAGE_AFTER = 50_000  # new objects that may hold others

# name -> (module, one line for the list)
COMMANDS: dict[str, tuple[str, str]] = {
    "demo": ("nacre.cli.demo", "Make pictures and plots of every example recipe, with a contact sheet."),
    "render": ("nacre.cli.render", "Render a material on an object."),
    "spectrum": ("nacre.cli.show", "Print reflectance and transmittance over angle and wavelength."),
    "evaluate": ("nacre.cli.show", "Evaluate the BSDF for given directions."),
    "plot": ("nacre.cli.show", "Draw a figure of a material."),
    "compile": ("nacre.cli.show", "Solve a recipe once and store the result as a .nacre file."),
    "design": ("nacre.cli.design", "Find the structure that gives a wanted appearance."),
    "gamut": ("nacre.cli.design", "Show the colours that free numbers can reach."),
    "fabricate": ("nacre.cli.design", "Write the files to make a design or a material."),
    "export": ("nacre.cli.exchange", "Write a material in another program's format."),
    "import": ("nacre.cli.exchange", "Read a measurement or another program's material into a recipe."),
    "fit": ("nacre.cli.analysis", "Fit a recipe's free numbers to a measurement."),
    "studio": ("nacre.cli.studio", "Open a live page on a recipe, on this machine only."),
    "report": ("nacre.cli.analysis", "Report colour, gloss, haze and flop as instruments measure them."),
    "tolerance": ("nacre.cli.analysis", "Turn manufacturing spreads into colour spread and yield."),
    "sweep": ("nacre.cli.analysis", "Compute a material over many values of its numbers."),
    "indices": ("nacre.cli.machine", "Search and show optical constants."),
    "examples": ("nacre.cli.examples", "List the recipes that come with nacre, or copy them."),
    "keys": ("nacre.cli.keys", "Print what a recipe, target or sweep may hold, key by key."),
    "cache": ("nacre.cli.machine", "Show what solved materials are kept on disk, or clear them."),
    "doctor": ("nacre.cli.machine", "Say what works on this machine and what to do if something does not."),
}


class LazyGroup(click.Group):
    """A group that knows its commands' names and imports a command only to run it or to show its own help."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return [name for name in COMMANDS if _exists(COMMANDS[name][0])]

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in self.list_commands(ctx):
            return None
        module = importlib.import_module(COMMANDS[name][0])
        command: click.Command = module.commands[name]
        return command

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        if args and args[0] not in self.list_commands(ctx):
            hint = did_you_mean(args[0], COMMANDS)
            raise click.UsageError(f'no command "{args[0]}".{hint} Commands: {", ".join(self.list_commands(ctx))}')
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, COMMANDS[name][1]) for name in self.list_commands(ctx)])


def _exists(module: str) -> bool:
    path = os.path.join(os.path.dirname(__file__), module.rpartition(".")[2] + ".py")
    return os.path.exists(path)


@click.group(
    cls=LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    help="Structural colour from nanostructure to picture and back.\n\nA material is a recipe: a TOML file with a "
    "family and its physical numbers. Start with: nacre demo --quick\n\nWork of minutes is asked about on a terminal; "
    "--yes anywhere on the line answers.",
)
@click.version_option(__version__, "--version", prog_name="nacre")
def cli() -> None:
    """Hold the commands together; the work is in the modules of `COMMANDS`."""


def main(argv: list[str] | None = None) -> None:
    """Run the command line and leave the process with its status.

    `--debug` anywhere on the line shows tracebacks instead of one-line errors; `--yes` answers what is asked before
    work of minutes.
    """
    hold_closed_streams()
    # imports make a million objects that all stay: searching them for garbage costs a command 0.3 s by default
    gc.set_threshold(GARBAGE_AFTER)
    atexit.register(gc.freeze)  # nor are they searched once more, 0.2 s, when the process ends
    sys.exit(run(sys.argv[1:] if argv is None else argv))


def run(argv: list[str]) -> int:
    """Run one command line and return its exit status: 0, 2 for bad input, 130 when interrupted."""
    debug, yes = "--debug" in argv, "--yes" in argv
    argv = [word for word in argv if word not in ("--debug", "--yes")]
    try:
        if any("\0" in word for word in argv):
            raise NacreError("an argument holds a NUL character, which no file name and no number has")
        with on_progress(listener(yes)), warnings.catch_warnings():
            warnings.showwarning = _say_warning  # type: ignore[assignment]  # takes the rest by *where
            cli.main(args=argv, prog_name="nacre", standalone_mode=False)
        sys.stdout.flush()
    except (KeyboardInterrupt, click.Abort):
        if debug:
            raise
        say(STOPPED)
        return STATUS_INTERRUPTED
    except click.exceptions.Exit as leave:
        return leave.exit_code
    except click.ClickException as error:
        context = getattr(error, "ctx", None)
        command = f" {context.info_name}" if context is not None and context.parent is not None else ""
        say(f"nacre{command}: {error.format_message()}")
        return STATUS_BAD_INPUT
    except BrokenPipeError:
        # the reader of our output has gone (`nacre ... | head`): not an error, and nothing more can be said
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except NacreError as error:
        if debug:
            raise
        say(f"nacre: {error}")
        return STATUS_BAD_INPUT
    except (OSError, MemoryError) as error:
        if debug:
            raise
        what = "not enough memory; try a smaller size" if isinstance(error, MemoryError) else _os_line(error)
        say(f"nacre: {what}")
        return STATUS_BAD_INPUT
    except Exception as error:
        if debug:
            raise
        if _was_interrupted(error):
            say(STOPPED)
            return STATUS_INTERRUPTED
        say(
            f"nacre: this is a bug in nacre, please report it: {type(error).__name__}: "
            f"{str(error)[:300]} (run again with --debug for the details)"
        )
        return 1
    return 0


def _say_warning(message: Warning | str, category: type[Warning], *where: Any) -> None:
    """Say a warning of ours as all else is said: what it tells, without the line of code that told it."""
    if category.__module__.partition(".")[0] == "nacre":
        say(str(message))
    else:
        say(f"{category.__name__}: {message}")


def _was_interrupted(error: BaseException | None) -> bool:
    """Whether an interrupt lies behind an error: the renderer wraps one that comes while it works."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__cause__ or error.__context__
    return False


def _os_line(error: OSError) -> str:
    name = f"{error.filename}: " if error.filename else ""
    return f"{name}{error.strerror or error}"
