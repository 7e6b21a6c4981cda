"""Progress of long work: a bar on a terminal or in a notebook, and announcements of work that takes minutes.

A front end may ask the user before announced work, show its progress, or stop it.
"""

import contextlib
import html
import sys
import time
from collections.abc import Callable, Iterator

FIRST_PASS = "the first pass loads or compiles kernels"
SMOOTHING = 0.3  # weight of the newest estimate of the time left
# done passes, all passes, seconds left
ProgressCallback = Callable[[int, int, float], None]


class Clock:
    """Estimates the time left from the passes done; the first pass, which compiles, counts only until the second.

    Later estimates move gradually: single passes and the estimated number of passes vary.
    """

    def __init__(self) -> None:
        self._start = time.perf_counter()
        self._after_first: float | None = None
        self._end: float | None = None

    def left(self, done: int, total: int) -> float:
        """Return the seconds left after `done` of `total` passes."""
        now = time.perf_counter()
        if done <= 1 or self._after_first is None:
            self._after_first = now
            return (now - self._start) * (total - done) / max(done, 1)
        end = now + (now - self._after_first) / (done - 1) * (total - done)
        weight = 1.0 if self._end is None else max(SMOOTHING, done / max(total, 1))
        self._end = end if self._end is None else self._end + weight * (end - self._end)
        return max(self._end - now, 0.0) if done < total else 0.0


def silent(done: int, total: int, seconds_left: float) -> None:
    """Report nothing."""


@contextlib.contextmanager
def progress_bar(title: str, wanted: bool | ProgressCallback | None) -> Iterator[ProgressCallback]:
    """Yield a callback; True shows a bar, None does so in a notebook and where stderr is a terminal."""
    if callable(wanted):
        yield wanted
        return
    if wanted is not False and _is_notebook():
        yield from _notebook_bar(title)
        return
    if wanted is False or (wanted is None and not sys.stderr.isatty()):
        yield silent
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

    columns = (TextColumn(title), BarColumn(), TaskProgressColumn(), TextColumn("{task.fields[left]}"))
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=1, left=FIRST_PASS)

        def show(done: int, total: int, seconds_left: float) -> None:
            # the first pass compiles: its time does not predict the others
            remaining = f"about {duration(seconds_left)} left" if 1 < done < total else ""
            bar.update(task, total=total, completed=done, left=remaining)

        yield show


def _is_notebook() -> bool:
    """Whether this process is the kernel of a notebook; IPython is not imported for the test."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    return type(shell).__name__ == "ZMQInteractiveShell"


def _notebook_bar(title: str) -> Iterator[ProgressCallback]:
    """Yield a callback that redraws one bar in the cell's output, which is empty again at the end."""
    from IPython.display import HTML, display

    def bar(done: int, total: int, words: str) -> HTML:
        return HTML(f'<progress value="{done}" max="{max(total, 1)}"></progress> <small>{html.escape(words)}</small>')

    handle = display(bar(0, 1, f"{title}, {FIRST_PASS}"), display_id=True)

    def show(done: int, total: int, seconds_left: float) -> None:
        handle.update(bar(done, total, f"{title}, about {duration(seconds_left)} left" if 1 < done < total else title))

    try:
        yield show
    finally:
        handle.update(HTML(""))


Listener = Callable[[str, float], None]

_listeners: list[Listener] = []


def announce(what: str, seconds: float) -> None:
    """Call all listeners with a description of the work and its estimated time; a listener may raise to stop it."""
    for listener in list(_listeners):
        listener(what, seconds)


@contextlib.contextmanager
def on_progress(listener: Listener) -> Iterator[None]:
    """Register a listener, `listener(what, seconds)`, for a block's duration."""
    _listeners.append(listener)
    try:
        yield
    finally:
        _listeners.remove(listener)


def duration(seconds: float) -> str:
    """Return a duration in words.

    Example: `duration(200.0)` is "3 minutes".
    """
    if seconds < 100:
        return f"{max(seconds, 1.0):.0f} seconds"
    return f"{seconds / 60:.0f} minutes" if seconds < 6000 else f"{seconds / 3600:.1f} hours"
