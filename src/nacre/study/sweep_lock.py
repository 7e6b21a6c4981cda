"""One writer for a sweep's store at a time: a small file beside it that names the process."""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path

from nacre.errors import NacreError
from nacre.files import Process, check_writable

POLL_S = 0.2
_held: set[Path] = set()  # by this process; another of its threads waits like another process


def lock_file(store: Path) -> Path:
    """Return the lock of a store; it lies beside it, since Zarr warns of files that it does not know."""
    return store.with_name(store.name + ".lock")


@contextlib.contextmanager
def locked(store: Path, *, break_lock: bool = False, tell: Callable[[str], None] | None = None) -> Iterator[None]:
    """Be the one that writes a store; while another process of this machine does, wait.

    A lock whose process has ended is taken over. Of another machine's process nobody here can tell whether it runs:
    only `break_lock` takes its lock.

    Args:
        store: the Zarr folder, there or not yet.
        break_lock: take the lock of another machine.
        tell: called once, with a line that says who is waited for.

    Raises:
        NacreError: another machine holds the lock, or the folder cannot be written.
    """
    path = lock_file(store)
    check_writable(path)
    waits = False
    while (owner := _take(path, break_lock)) is not None:
        if not owner.is_here:
            machine = owner.host.partition(" ")[0]
            raise NacreError(
                f"{store}: process {owner.pid} of {machine} writes it, or was ended there before it could say so; "
                "if nothing runs there any more, --break-lock takes over"
            )
        if not waits and tell:
            tell(f"{store}: waiting for process {owner.pid}, which writes it")
        waits = True
        time.sleep(POLL_S)
    try:
        yield
    finally:
        with contextlib.suppress(OSError), _guarded(path.parent):
            _held.discard(path.resolve())
            if _owner(path) == Process.this():
                path.unlink()


def _take(path: Path, break_lock: bool) -> Process | None:
    """Take the lock if it is free; if not, return whose it is."""
    this, here = Process.this(), path.resolve()
    try:
        with _guarded(path.parent):
            owner = _owner(path)
            is_left = owner is None or owner.is_dead or (owner == this and here not in _held)
            if not is_left and not (break_lock and owner is not None and not owner.is_here):
                return owner
            path.write_text(json.dumps(asdict(this)), encoding="utf-8")
            _held.add(here)
            return None
    except OSError as error:
        raise NacreError(f"{path}: cannot be written: {error.strerror or error}") from None


def _owner(path: Path) -> Process | None:
    """Return whose lock it is; None where there is none, or one that was never written whole."""
    try:
        return Process(**json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None


@contextlib.contextmanager
def _guarded(folder: Path) -> Iterator[None]:
    """Keep all others from looking at the lock for a moment; where the system has no such lock, go without."""
    try:
        import fcntl

        descriptor = os.open(folder, os.O_RDONLY)
    except (ImportError, OSError):
        yield
        return
    try:
        with contextlib.suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
