"""Ctrl-C during a picture: immediate within the first pass, afterwards when the current pass ends.

Solvers and compilers run outside Python for many seconds, during which Python does not handle signals.
"""

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator

LEAVING_S = 5.0
_has_passes = threading.Event()  # the current picture has a finished pass
_came_late = threading.Event()  # the last picture was complete at the interrupt


def begin_picture() -> None:
    """Record the start of a picture."""
    _has_passes.clear()
    _came_late.clear()


def note_late() -> None:
    """Note an interrupt after the last pass, which did not end the picture early."""
    _came_late.set()


def came_late() -> bool:
    """Return whether the last picture was complete at an interrupt; a series should end."""
    return _came_late.is_set()


def keep_passes() -> None:
    """Note a finished pass; interrupts now end the picture with its passes."""
    _has_passes.set()


@contextlib.contextmanager
def held_back() -> Iterator[Callable[[], bool]]:
    """Defer interrupts after the first pass; yield a function that returns whether one came.

    An interrupt inside the renderer would become another error and lose the passes.
    """
    interrupted = threading.Event()

    def note(number: int, frame: object) -> None:
        if not _has_passes.is_set():
            raise KeyboardInterrupt
        interrupted.set()

    # other signal handlers stay
    is_ours = threading.current_thread() is threading.main_thread()
    is_ours = is_ours and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if is_ours:
        signal.signal(signal.SIGINT, note)
    try:
        yield interrupted.is_set
    finally:
        if is_ours:
            signal.signal(signal.SIGINT, signal.default_int_handler)


@contextlib.contextmanager
def leaving_at_once(status: int, message: Callable[[], str]) -> Iterator[None]:
    """End the process on an interrupt within the first pass; for the command line.

    Files are written atomically, therefore no partial files remain.
    """
    if threading.current_thread() is not threading.main_thread() or os.name != "posix":
        yield
        return
    begin_picture()
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    # acquired once, by whichever thread notices the interrupt first
    leaving = threading.Lock()

    def listen() -> None:
        while number := os.read(reader, 1):
            if number[0] == signal.SIGINT and not _has_passes.is_set() and leaving.acquire(blocking=False):
                cursor = "\x1b[?25h" if sys.stderr.isatty() else ""  # a progress bar may have hidden it
                os.write(2, f"{cursor}{message()}\n".encode())
                os._exit(status)
        os.close(reader)

    listener = threading.Thread(target=listen, daemon=True)
    listener.start()
    before = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    try:
        yield
    except KeyboardInterrupt:
        if not _has_passes.is_set():
            listener.join(LEAVING_S)  # the listener ends the process
        raise
    finally:
        leaving.acquire()  # waits if the listener is ending the process
        signal.set_wakeup_fd(before)
        os.close(writer)
