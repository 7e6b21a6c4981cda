"""Ctrl-C while a picture is made: at once while there is nothing to keep, between two passes once there is.

Solving and compiling run outside Python for many seconds, and Python would hear of the signal only after them.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator

LEAVING_S = 5.0
_has_passes = threading.Event()  # the picture being made has a pass to keep
_came_late = threading.Event()  # the last picture was whole when an interrupt came


def begin_picture() -> None:
    """Say that a picture begins: nothing of it is there to be kept."""
    _has_passes.clear()
    _came_late.clear()


def note_late() -> None:
    """Say that an interrupt came when the picture had all its passes: it ended nothing."""
    _came_late.set()


def came_late() -> bool:
    """Whether the last picture was whole when an interrupt came; who makes several ends with this one."""
    return _came_late.is_set()


def keep_passes() -> None:
    """Say that a pass is done: from now on an interrupt ends the picture with what is there."""
    _has_passes.set()


@contextlib.contextmanager
def held_back() -> Iterator[Callable[[], bool]]:
    """Hold interrupts back once there is a pass to keep; yield a function that tells whether one came.

    An interrupt that rose inside the renderer would come out of it as another error, and the passes would be lost.
    """
    came = threading.Event()

    def note(number: int, frame: object) -> None:
        if not _has_passes.is_set():
            raise KeyboardInterrupt
        came.set()

    # whoever handles the signal in a way of their own, or ignores it, goes on doing so
    is_ours = threading.current_thread() is threading.main_thread()
    is_ours = is_ours and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if is_ours:
        signal.signal(signal.SIGINT, note)
    try:
        yield came.is_set
    finally:
        if is_ours:
            signal.signal(signal.SIGINT, signal.default_int_handler)


@contextlib.contextmanager
def leaving_at_once(status: int, message: str) -> Iterator[None]:
    """End the whole process on an interrupt that comes before a first pass is done; for the command line.

    Files are written under other names until they are whole, so nothing half-written stays.
    """
    if threading.current_thread() is not threading.main_thread() or os.name != "posix":
        yield
        return
    begin_picture()
    heard, told = os.pipe()
    os.set_blocking(told, False)
    # taken by the first of the two that hear of the interrupt, and never given back: only one of them says so
    leaving = threading.Lock()

    def listen() -> None:
        while number := os.read(heard, 1):
            if number[0] == signal.SIGINT and not _has_passes.is_set() and leaving.acquire(blocking=False):
                cursor = "\x1b[?25h" if sys.stderr.isatty() else ""  # a progress bar may have hidden it
                os.write(2, f"{cursor}{message}\n".encode())
                os._exit(status)
        os.close(heard)

    listener = threading.Thread(target=listen, daemon=True)
    listener.start()
    before = signal.set_wakeup_fd(told, warn_on_full_buffer=False)
    try:
        yield
    except KeyboardInterrupt:
        if not _has_passes.is_set():
            listener.join(LEAVING_S)  # it has heard too, and ends the process
        raise
    finally:
        leaving.acquire()  # waits for the process to end, where the other thread is ending it
        signal.set_wakeup_fd(before)
        os.close(told)
