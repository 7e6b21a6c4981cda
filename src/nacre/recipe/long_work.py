"""Work of minutes, told before it begins: whoever faces a person may ask, show it, or stop it.

A model announces such work here; a command registers what asks and what draws. Where nobody listens it goes on.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

Listener = Callable[[str, float], None]

_listeners: list[Listener] = []


def announce(what: str, seconds: float) -> None:
    """Tell what begins, in words, and about how long it takes; a listener that says no raises."""
    for listener in list(_listeners):
        listener(what, seconds)


@contextlib.contextmanager
def heard_by(listener: Listener) -> Iterator[None]:
    """Let a function hear of long work: `listener(what, seconds)`."""
    _listeners.append(listener)
    try:
        yield
    finally:
        _listeners.remove(listener)


def duration(seconds: float) -> str:
    """Return a duration as people say it.

    Example: `duration(200.0)` is "3 minutes".
    """
    if seconds < 100:
        return f"{max(seconds, 1.0):.0f} seconds"
    return f"{seconds / 60:.0f} minutes" if seconds < 6000 else f"{seconds / 3600:.1f} hours"


__all__ = ["announce", "duration", "heard_by"]
