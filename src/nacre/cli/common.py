"""Shared options, notations for lists, messages, exit statuses, and progress of long work."""

from __future__ import annotations

import contextlib
import errno
import functools
import io
import json
import math
import os
import re
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, TypeVar

import click
import numpy as np
from numpy.typing import NDArray

from nacre.core.errors import NacreError
from nacre.core.files import stored, write_text

F = TypeVar("F", bound=Callable[..., Any])
MAX_LIST = 100_000


def numbers(text: str, option: str) -> NDArray[np.float64]:
    """Read `0,30,60` or `380:780:5` (both ends included) or a mixture of both.

    Raises:
        NacreError: naming the option, the text and the form.

    Example:
        >>> numbers("0,10:30:10", "--angles-deg").tolist()
        [0.0, 10.0, 20.0, 30.0]
    """
    values: list[float] = []
    for part in text.split(","):
        try:
            fields = [float(f) for f in part.split(":")]
        except ValueError:
            raise NacreError(f'{option} = "{text}" cannot be read; write numbers like 0,30,60 or a:b:step') from None
        if not all(np.isfinite(fields)):
            raise NacreError(f'{option} = "{text}" holds a number that is not finite')
        if len(values) > MAX_LIST:
            raise NacreError(f'{option} = "{text}" asks for over {MAX_LIST} values, the most that are allowed')
        if len(fields) == 1:
            values.append(fields[0])
        elif len(fields) == 3 and fields[2] > 0 and fields[1] >= fields[0]:
            steps = (fields[1] - fields[0]) / fields[2] + 1e-9
            if not steps < MAX_LIST:  # infinite if the step underflows
                raise NacreError(f'{option} = "{text}" asks for {steps:.6g} values; at most {MAX_LIST} are allowed')
            values += list(fields[0] + fields[2] * np.arange(int(steps) + 1))
        else:
            raise NacreError(f'{option} = "{text}" cannot be read; a range is start:end:step with a step above 0')
    return np.array(values)


def wavelengths(text: str | None) -> NDArray[np.float64] | None:
    """Read `--wavelengths-nm`; None leaves the choice to the material.

    Raises:
        NacreError: not positive or not ascending.
    """
    if text is None:
        return None
    grid = numbers(text, "--wavelengths-nm")
    if grid[0] <= 0 or np.any(np.diff(grid) <= 0):
        raise NacreError(f'--wavelengths-nm = "{text}" must be positive and ascending')
    return grid


def angles(text: str) -> NDArray[np.float64]:
    """Read `--angles-deg`, in the ambient medium.

    Raises:
        NacreError: outside [0, 90] degrees.
    """
    grid = numbers(text, "--angles-deg")
    if grid.min() < 0 or grid.max() > 90:
        raise NacreError(f'--angles-deg = "{text}" must lie in [0, 90]')
    return grid


def set_jobs(jobs: int | None) -> None:
    """Limit the threads of every numeric library; must run before they are imported."""
    if jobs is None:
        return
    if jobs < 1:
        raise NacreError(f"--jobs = {jobs} must be at least 1")
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NACRE_JOBS"):
        os.environ[name] = str(jobs)
    os.environ["NUMBA_NUM_THREADS"] = str(min(jobs, os.cpu_count() or 1))


def jobs_option(function: F) -> F:
    """Add `--jobs N`, which takes effect before numeric libraries are imported."""
    return click.option(
        "--jobs", type=int, metavar="N", is_eager=True, expose_value=False, callback=lambda *args: set_jobs(args[2]),
        help="Threads, or processes of sweeps, tolerances and batches; default: all cores.",
    )(function)  # fmt: skip


def cluster_options(function: Callable[..., None]) -> Callable[..., None]:
    """Add `--cluster ADDRESS` and `--security FILE`; the command gets them as `workers`.

    `--jobs N` sets the number of worker processes of this machine.
    """

    @click.option(
        "--cluster",
        default=None,
        metavar="tls://HOST:PORT",
        help="Compute on the workers of this Dask scheduler, not on this machine.",
    )
    @click.option(
        "--security",
        default=None,
        metavar="FILE.toml",
        help="For a tls:// cluster: names the PEM files ca, cert and key.",
    )
    @functools.wraps(function)
    def command(*args: Any, cluster: str | None, security: str | None, **options: Any) -> None:
        from nacre.core.jobs import Workers

        function(*args, workers=Workers(None, cluster, security), **options)  # --jobs sets the process's default

    return command


@contextlib.contextmanager
def solving_on(workers: Any, material: Any) -> Iterator[None]:
    """Solve a grating's orders or a metasurface's ensemble on the cluster of `cluster_options`.

    Raises:
        NacreError: the material has neither, or the options do not suit the cluster.
    """
    from nacre.core.jobs import on_cluster
    from nacre.families.contract import Diffracting, ExpensiveMethod

    model = material.model
    is_shared = isinstance(model, Diffracting) or (isinstance(model, ExpensiveMethod) and model.is_distributed)
    if workers.cluster is not None and not is_shared:
        raise NacreError(
            f"--cluster: this {model.traits.noun} is solved on this machine; a cluster computes grating orders, "
            "metasurface ensembles and --animate frames"
        )
    with on_cluster(workers):
        yield


def _no_cache_callback(ctx: click.Context, param: click.Parameter, value: bool) -> None:
    if value:
        os.environ["NACRE_CACHE"] = "off"  # inherited by worker processes


def run_options(function: F) -> F:
    """Add `--no-cache`, which disables the disk cache of solved optics, and `--jobs N`."""
    return click.option(
        "--no-cache", is_flag=True, is_eager=True, expose_value=False, callback=_no_cache_callback,
        help="Do not use the disk cache; see nacre cache.",
    )(jobs_option(function))  # fmt: skip


LAMPS = "A, C, D50, D65, E, F2, F11 or LED-B3."  # nacre.light.ILLUMINANTS, without importing it

WALKS = "Random walks per direction (pearls); default: 4096, or as many as the command needs."


def set_option(function: F) -> F:
    """Add `--set PATH=VALUE`, which changes a number of the recipe for this run."""
    return click.option(
        "--set", "changes", multiple=True, metavar="PATH=VALUE",
        help="Change one value of the recipe, such as layers[0].thickness_nm=420. May be repeated.",
    )(function)  # fmt: skip


def recipe_options(function: F) -> F:
    """Add `--set`, `--no-cache` and `--jobs N`."""
    return set_option(run_options(function))


def load_material(recipe: str, changes: tuple[str, ...] = ()) -> Any:
    """Load a recipe, a .nacre file or a design folder, and apply `--set` changes; numbers tied to them follow.

    Raises:
        NacreError: see `nacre.load`, or a change cannot be read.
    """
    from nacre.material.material import load

    material = load(recipe)
    if not changes:
        return material
    values = dict(parse_change(change) for change in changes)
    made = material.vary(values)
    if not made.data.get("ties"):
        return made
    from nacre.analysis.ties import with_ties

    return with_ties(made, [*values])


def parse_change(text: str) -> tuple[str, Any]:
    """Split `PATH=VALUE`; the value is read as TOML, or as text if that fails.

    Raises:
        NacreError: no equals sign.
    """
    import tomllib

    from nacre.recipe.toml import parse_toml

    path, equals, value = text.partition("=")
    if not equals or not path.strip():
        raise NacreError(f'--set "{text}" cannot be read; write it like layers[0].thickness_nm=420')
    try:
        tomllib.loads(f"value = {value}")
    except tomllib.TOMLDecodeError:
        return path.strip(), value.strip()
    except (ValueError, OverflowError, RecursionError):
        pass  # reported below
    return path.strip(), parse_toml(f"value = {value}", f"--set {path.strip()}")["value"]


def progress_bar(description: str) -> Any:
    """Return a progress bar on stderr, which is disabled if stderr is not a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    return Progress(
        TextColumn(description), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
        TextColumn("{task.fields[info]}"), console=console, disable=not console.is_terminal,
    )  # fmt: skip


def answer(document: Mapping[str, Any], text_csv: str, output: str | None, as_json: bool) -> None:
    """Write a table to a file, as CSV or JSON by its suffix, and print it as JSON, or as CSV without a file."""
    if output:
        write_text(output, text_csv if output.endswith(".csv") else json.dumps(document) + "\n")
        note(output)
    if as_json:
        click.echo(json.dumps(document))
    elif not output:
        click.echo(text_csv, nl=False)


STATUS_BAD_INPUT = 2
STATUS_INTERRUPTED = 130
STOPPED = "nacre: stopped; finished results are stored"
STOPPED_EARLY = "nacre: stopped before the first result was stored"
MAX_WORD = 200  # characters; longer words of a message are shortened


def stopped_line() -> str:
    """Return the message of an interrupted command."""
    return STOPPED if stored.is_set() else STOPPED_EARLY


def spectrum_csv(
    names: Sequence[str], wavelengths_nm: NDArray[Any], angles_deg: NDArray[Any], columns: Mapping[str, NDArray[Any]],
    digits: int, stated: Sequence[str] = (),
) -> str:  # fmt: skip
    """Return a table with a row for each angle and wavelength.

    Args:
        names: headings before those of the columns.
        columns: `[angle, wavelength]` by heading.
        digits: of wavelengths and angles.
        stated: cells behind the angle that are equal in all rows.
    """
    lines = [",".join([*names, *columns])]
    for a, angle in enumerate(angles_deg):
        for w, wavelength in enumerate(wavelengths_nm):
            values = [f"{value[a, w]:.9g}" for value in columns.values()]
            lines.append(",".join([f"{wavelength:.{digits}g}", f"{angle:.{digits}g}", *stated, *values]))
    return "\n".join(lines) + "\n"


def note(message: str) -> None:
    """Print one line on stderr, since stdout is reserved for results; a closed stream is ignored."""
    with contextlib.suppress(OSError, ValueError):
        click.echo(one_line(message), err=True)


def one_line(message: str) -> str:
    """Return a message on one line, with long words shortened and control characters escaped."""
    line = " ".join(message.split())
    line = re.sub(rf"\S{{{MAX_WORD},}}", lambda word: f"{word[0][:60]}...{word[0][-20:]}", line)
    return "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in line)


class _Closed(io.TextIOBase):
    """Replacement of a closed stdout that refuses output."""

    def write(self, text: str) -> int:
        """Refuse the output.

        Raises:
            OSError: always.
        """
        raise OSError(errno.EBADF, "standard output is closed; there is nowhere to write the answer")


def hold_closed_streams() -> None:
    """Occupy the descriptors of closed standard streams, so that no opened file receives them."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # receives the lowest free descriptor, which is this one
    if sys.stdout is None:
        sys.stdout = _Closed()
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # open until the process ends


def words(text: str | None) -> tuple[str, ...]:
    """Return an option's words, delimited by commas."""
    return tuple(word.strip() for word in text.split(",")) if text else ()


def read_labs(texts: Sequence[str]) -> dict[str, tuple[float, ...]]:
    """Return geometry -> CIELAB from options `GEOMETRY=L,a,b`.

    Raises:
        NacreError: one cannot be read, or a geometry occurs twice.
    """
    colours: dict[str, tuple[float, ...]] = {}
    for text in texts:
        geometry, _, values = text.rpartition("=")
        lab = tuple(number_or_nan(cell) for cell in values.split(","))
        if not geometry.strip() or len(lab) != 3 or not all(map(math.isfinite, lab)):
            raise NacreError(f'--lab "{text}" cannot be read; write it like "specular 5=62,30,-12"')
        if geometry.strip() in colours:
            raise NacreError(f'--lab "{text}": the geometry occurs twice')
        colours[geometry.strip()] = lab
    return colours


def number_or_nan(text: str) -> float:
    """Return the number that a text states, or NaN."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def read_texture(texts: Sequence[str]) -> dict[str, float]:
    """Return quantity -> measured number from options `QUANTITY=VALUE`.

    Raises:
        NacreError: one cannot be read, or a quantity occurs twice.
    """
    numbers: dict[str, float] = {}
    for text in texts:
        quantity, _, value = text.partition("=")
        number = number_or_nan(value)
        if not quantity.strip() or not math.isfinite(number):
            raise NacreError(f'--texture "{text}" cannot be read; write it like sparkle_45=1.2')
        if quantity.strip() in numbers:
            raise NacreError(f'--texture "{text}": the quantity occurs twice')
        numbers[quantity.strip()] = number
    return numbers


ASK_S = 60.0  # longer work needs confirmation on a terminal
PACE_S = 30.0  # interval between progress lines without a terminal
LONG_COMPILE_S = 1.0
COMPILING = "compiling kernels for this machine, once, about 10 s on a free core; later runs reuse them"
BUSY = 1.5  # ratio of wall time to time on free cores, above which both are reported


def listener(yes: bool) -> Callable[[str, float], None]:
    """Return the listener for long work.

    Args:
        yes: whether the user has confirmed.
    """

    def hear(what: str, seconds: float) -> None:
        note(what)
        is_terminal = _is_terminal()
        if seconds > ASK_S and not yes and is_terminal:
            # stdout is reserved for results
            click.confirm("Go on? (--yes answers)", default=True, abort=True, err=True)
        if is_terminal:
            _follow()
        elif seconds > ASK_S:
            _report()

    return hear


def compile_listener() -> Callable[[float], None]:
    """Return a listener that says once, on a terminal, that the first run compiles kernels."""
    is_reported = False

    def hear(seconds: float) -> None:
        nonlocal is_reported
        if seconds > LONG_COMPILE_S and not is_reported and _is_terminal():
            is_reported = True
            note(COMPILING)

    return hear


def _is_terminal() -> bool:
    return all(stream is not None and stream.isatty() for stream in (sys.stdin, sys.stderr))


def _report() -> None:
    """Print finished parts and remaining time at most every half minute.

    On a busy machine both the wall time and the time on free cores are reported.
    """
    from nacre.core import machine
    from nacre.core.progress import duration

    begun = last_report = time.monotonic()
    spent = time.process_time()

    def report(done: int, total: int) -> None:
        nonlocal last_report
        now = time.monotonic()
        if done == total:
            machine.remove_progress_listener(report)
            note(f"{total} of {total} solved, after {duration(now - begun)}")
        elif now - last_report >= PACE_S:
            last_report = now
            rest = (total - done) / done
            by_clock, free = rest * (now - begun), rest * (time.process_time() - spent) / machine.available_jobs()
            remaining = f"about {duration(by_clock)} left"
            if by_clock > BUSY * free:
                remaining = f"about {duration(free)} left on free cores, {duration(by_clock)} as busy as it is"
            note(f"{done} of {total} solved, {remaining}")

    machine.add_progress_listener(report)


def _follow() -> None:
    """Show the number of finished parts on one line."""
    from nacre.core import machine

    def report(done: int, total: int) -> None:
        click.echo(f"\r{one_line(f'{done} of {total} solved')} ", nl=done == total, err=True)
        if done == total:
            machine.remove_progress_listener(report)

    machine.add_progress_listener(report)
