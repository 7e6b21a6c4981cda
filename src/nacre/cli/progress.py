"""Work of minutes on the command line: told, asked about on a terminal, and followed while it runs."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import click

from nacre.cli.common import one_line, say

ASK_S = 60.0  # work that takes longer is asked about where a person can answer
PACE_S = 30.0  # between lines where nobody sees a line that changes
BUSY = 1.5  # by the clock over what the work takes of free cores, from where both are told


def listener(yes: bool) -> Callable[[str, float], None]:
    """Return what hears of long work.

    Args:
        yes: go on without asking.
    """

    def hear(what: str, seconds: float) -> None:
        say(what)
        is_terminal = _is_terminal()
        if seconds > ASK_S and not yes and is_terminal:
            # the answer goes to the terminal's own stream: stdout belongs to the command's output
            click.confirm("Go on? (--yes answers)", default=True, abort=True, err=True)
        if is_terminal:
            _follow()
        elif seconds > ASK_S:
            _report()

    return hear


def _is_terminal() -> bool:
    return all(stream is not None and stream.isatty() for stream in (sys.stdin, sys.stderr))


def _report() -> None:
    """Say in a line of its own, every half minute at most, how many parts are done and how long the rest may take.

    Other work on the machine slows the clock's time, not the processor's: where they differ much, both are told.
    """
    from nacre.core import parallel
    from nacre.core.progress import duration

    begun = said = time.monotonic()
    spent = time.process_time()

    def tell(done: int, total: int) -> None:
        nonlocal said
        now = time.monotonic()
        if done == total:
            parallel.remove_progress_listener(tell)
            say(f"{total} of {total} patterns, after {duration(now - begun)}")
        elif now - said >= PACE_S:
            said = now
            rest = (total - done) / done
            by_clock, free = rest * (now - begun), rest * (time.process_time() - spent) / parallel.available_jobs()
            left = f"about {duration(by_clock)} left"
            if by_clock > BUSY * free:
                left = f"about {duration(free)} left on free cores, {duration(by_clock)} as busy as it is"
            say(f"{done} of {total} patterns, {left}")

    parallel.add_progress_listener(tell)


def _follow() -> None:
    """Show how many parts are done, on one line, until the last one is."""
    from nacre.core import parallel

    def tell(done: int, total: int) -> None:
        click.echo(f"\r{one_line(f'{done} of {total} patterns')} ", nl=done == total, err=True)
        if done == total:
            parallel.remove_progress_listener(tell)

    parallel.add_progress_listener(tell)
