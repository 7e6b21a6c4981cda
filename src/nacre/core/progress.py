"""Announcements of work that takes minutes: a front end may ask the user, show progress, or stop the work."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

Listener = Callable[[str, float], None]

_listeners: list[Listener] = []


def announce(what: str, seconds: float) -> None:
    """Call all listeners with a description of the work and its estimated time; a listener may raise to stop it."""
    for listener in list(_listeners):
        listener(what, seconds)


@contextlib.contextmanager
def on_progress(listener: Listener) -> Iterator[None]:
    """Register a listener, `listener(what, seconds)`, for the duration of a block."""
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


__all__ = ["announce", "duration", "on_progress"]
