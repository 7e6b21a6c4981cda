"""Work of minutes on the command line: confirmation on a terminal, and progress."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import click

from nacre.cli.common import one_line, say

ASK_S = 60.0  # longer work needs confirmation on a terminal
PACE_S = 30.0  # between lines without a terminal
LONG_COMPILE_S = 1.0
COMPILING = "compiling kernels for this machine, once, about 10 s on a free core; later runs reuse them"
BUSY = 1.5  # ratio of wall time to time on free cores, above which both are reported


def listener(yes: bool) -> Callable[[str, float], None]:
    """Return the listener for long work.

    Args:
        yes: whether the user has confirmed.
    """

    def hear(what: str, seconds: float) -> None:
        say(what)
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
    is_said = False

    def hear(seconds: float) -> None:
        nonlocal is_said
        if seconds > LONG_COMPILE_S and not is_said and _is_terminal():
            is_said = True
            say(COMPILING)

    return hear


def _is_terminal() -> bool:
    return all(stream is not None and stream.isatty() for stream in (sys.stdin, sys.stderr))


def _report() -> None:
    """Print finished parts and remaining time at most every half minute.

    On a busy machine both the wall time and the time on free cores are reported.
    """
    from nacre.core import parallel
    from nacre.core.progress import duration

    begun = said = time.monotonic()
    spent = time.process_time()

    def report(done: int, total: int) -> None:
        nonlocal said
        now = time.monotonic()
        if done == total:
            parallel.remove_progress_listener(report)
            say(f"{total} of {total} patterns, after {duration(now - begun)}")
        elif now - said >= PACE_S:
            said = now
            rest = (total - done) / done
            by_clock, free = rest * (now - begun), rest * (time.process_time() - spent) / parallel.available_jobs()
            left = f"about {duration(by_clock)} left"
            if by_clock > BUSY * free:
                left = f"about {duration(free)} left on free cores, {duration(by_clock)} as busy as it is"
            say(f"{done} of {total} patterns, {left}")

    parallel.add_progress_listener(report)


def _follow() -> None:
    """Show the number of finished parts on one line."""
    from nacre.core import parallel

    def report(done: int, total: int) -> None:
        click.echo(f"\r{one_line(f'{done} of {total} patterns')} ", nl=done == total, err=True)
        if done == total:
            parallel.remove_progress_listener(report)

    parallel.add_progress_listener(report)
