"""Run a long job in a subprocess that reports events as JSON lines.

A job is a function `(request, emit)`, named "module:function". It calls `emit` with JSON objects that have a `kind`,
and may return bytes. The job is cancelled when the client disconnects (stdin closes); the line "stop" on stdin
interrupts it, and a job that handles `KeyboardInterrupt` then finishes with its current best result.
"""

import _thread
import asyncio
import contextlib
import importlib
import json
import os
import signal
import sys
import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

from nacre.core.errors import NacreError

Emit = Callable[[Mapping[str, Any]], None]
POLL_S = 0.2
STOP_GRACE_S = 20.0
MAX_LINE_BYTES = 32 << 20  # one event holds a base64 picture


@dataclass
class SubprocessJob:
    """A job's execution.

    Attributes:
        name: a noun for messages.
        function: "module:function"; only the subprocess imports it.
        request: the function's first argument, serialisable as JSON.
        is_connected: polled several times a second; the job is killed once it returns False.
        max_seconds: the job is killed after this time.
        max_bytes: largest resident memory; default: unlimited.
        stop: set to finish the job early with its current best result.
        result: bytes that the function returned, available after the last event.
    """

    name: str
    function: str
    request: Mapping[str, Any]
    is_connected: Callable[[], Awaitable[bool]]
    max_seconds: float
    max_bytes: int | None = None
    stop: asyncio.Event = field(default_factory=asyncio.Event)
    result: bytes = b""

    async def run(self) -> bytes:
        """Return the job's result.

        Raises:
            NacreError: the job failed, was cancelled or exceeded a limit.
        """
        event: dict[str, Any] = {}
        async for line in self.events():
            event = json.loads(line)
        if event.get("kind") != "done":
            raise NacreError(event.get("error", f"the {self.name} was cancelled"))
        return self.result

    async def events(self) -> AsyncIterator[bytes]:
        """Yield the job's events, one JSON line each; the last is "done" or "error" unless it is cancelled."""
        pipe = asyncio.subprocess.PIPE
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", __name__, self.function, stdin=pipe, stdout=pipe,
            stderr=asyncio.subprocess.DEVNULL, start_new_session=True, limit=MAX_LINE_BYTES,
        )  # fmt: skip
        assert process.stdin is not None and process.stdout is not None
        now = asyncio.get_running_loop().time
        deadline, is_stopping = now() + self.max_seconds, False
        reading = asyncio.create_task(self._read(process.stdout))
        try:
            process.stdin.write(json.dumps(self.request).encode() + b"\n")
            while True:
                await asyncio.wait({reading}, timeout=POLL_S)
                if reading.done():
                    line = reading.result() or _line(
                        {"kind": "error", "error": f"the {self.name} ended without a result"}
                    )
                    yield line
                    if json.loads(line).get("kind") in ("done", "error"):
                        return
                    reading = asyncio.create_task(self._read(process.stdout))
                if not await self.is_connected():
                    return
                if self.stop.is_set() and not is_stopping:
                    is_stopping, deadline = True, min(deadline, now() + STOP_GRACE_S)
                    process.stdin.write(b"stop\n")
                if reason := self._exceeded_limit(process.pid, now() > deadline):
                    yield _line({"kind": "error", "error": reason})
                    return
        finally:
            reading.cancel()
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            with contextlib.suppress(Exception):
                await asyncio.shield(process.wait())

    async def _read(self, stdout: asyncio.StreamReader) -> bytes:
        """Return the next event; store a result that precedes it."""
        line = await stdout.readline()
        if line.startswith(b'{"result_bytes": '):
            self.result = await stdout.readexactly(json.loads(line)["result_bytes"])
            line = await stdout.readline()
        return line

    def _exceeded_limit(self, pid: int, is_late: bool) -> str:
        if is_late:
            return f"the {self.name} took too long and was cancelled"
        if self.max_bytes is None:
            return ""
        try:
            pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
        except (OSError, ValueError, IndexError):  # systems without /proc
            return ""
        if pages * os.sysconf("SC_PAGE_SIZE") <= self.max_bytes:
            return ""
        return f"the {self.name} took more than {self.max_bytes >> 30} GiB of memory and was cancelled; make it smaller"


def _line(event: Mapping[str, Any]) -> bytes:
    return json.dumps(event, default=float).encode() + b"\n"


def main() -> int:
    """Run the job that the command line names: read its request from stdin and write its events to stdout."""
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # other output must not mix with the events
    lock = threading.Lock()

    def write(*parts: bytes) -> None:
        with lock:
            for part in parts:
                out.write(part)
            out.flush()

    try:
        request = json.loads(sys.stdin.readline())
        threading.Thread(target=_listen, daemon=True).start()
        module, _, function = sys.argv[1].partition(":")
        result = getattr(importlib.import_module(module), function)(request, lambda event: write(_line(event)))
        if result is not None:
            write(_line({"result_bytes": len(result)}), result)
        last = {"kind": "done"}
    except KeyboardInterrupt:
        last = {"kind": "done"}
    except Exception as error:  # the page must show any failure
        last = {"kind": "error", "error": failure_text(error)}
    write(_line(last))
    return 0


def failure_text(error: Exception, name: str = "") -> str:
    """Return one line for the user about a failed request for the recipe `name`."""
    if isinstance(error, NacreError):
        return str(error)
    if isinstance(error, MemoryError):
        return f"{name}: not enough memory for this recipe" if name else "not enough memory for this"
    return f"this is a bug in nacre, please report it: {type(error).__name__}: {str(error)[:200]}"


def interrupt(system: str = os.name) -> None:
    """Raise KeyboardInterrupt in the main thread of this process.

    A signal also ends a wait of the main thread; on Windows it would end the process instead.
    """
    if system == "posix":
        os.kill(os.getpid(), signal.SIGINT)
    else:
        _thread.interrupt_main()


def _listen() -> None:
    for line in sys.stdin:
        if line.strip() == "stop":
            interrupt()
    os._exit(3)  # stdin closed: the server ended or cancelled the job


# A worker thread that serves only the newest request.

REST_S = 0.25  # pause after a draft, in which a newer request may arrive
Request = TypeVar("Request")


class SupersededError(Exception):
    """A newer request has arrived."""


class LatestOnlyWorker(Generic[Request]):
    """Processes the newest request; older ones are dropped, and one in progress is superseded.

    `answer(request, is_superseded)` yields `(message, is_draft)` and may raise `SupersededError`; the worker rests
    after a draft. The thread ends when all requests are answered.
    """

    def __init__(
        self,
        answer: Callable[[Request, Callable[[], bool]], Iterator[tuple[Any, bool]]],
        send: Callable[[Any], None],
        fail: Callable[[Request, Exception], None],
        slot: AbstractContextManager[Any] | None = None,
        drops_superseded: bool = True,
    ) -> None:
        """Create an idle worker.

        Args:
            answer: generates messages for a request.
            send: sends a message; never called concurrently.
            fail: reports an exception in `answer`.
            slot: held while a message is computed, to limit the workers that compute at once.
            drops_superseded: whether a message is dropped if a newer request arrived during its computation.
        """
        self._answer, self._send, self._fail = answer, send, fail
        self._slot = nullcontext() if slot is None else slot
        self._drops_superseded = drops_superseded
        self._changed = threading.Condition()
        self.sending = threading.Lock()
        self._number = 0
        self._waiting: list[Request] = []  # the newest request, until its computation begins
        self._is_cancelled = False
        self._thread: threading.Thread | None = None

    def submit(self, request: Request) -> None:
        """Replace the current request; return at once."""
        with self._changed:
            self._number += 1
            self._waiting = [request]
            self._is_cancelled = False
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, daemon=True, name="nacre-studio")
                self._thread.start()
            self._changed.notify_all()

    def cancel(self) -> None:
        """Drop the current request."""
        with self._changed:
            self._number += 1
            self._waiting = []
            self._is_cancelled = True
            self._changed.notify_all()

    def wait(self, seconds: float) -> bool:
        """Wait until all requests are answered; return whether they are."""
        with self._changed:
            return self._changed.wait_for(lambda: self._thread is None, seconds)

    def _work(self) -> None:
        while True:
            with self._changed:
                if not self._waiting:
                    self._thread = None
                    self._changed.notify_all()
                    return
                number, request = self._number, self._waiting.pop()
            try:
                self._respond(request, lambda number=number: self._number != number)  # type: ignore[misc]
            except SupersededError:
                pass
            except Exception as error:  # reported; the next request is answered all the same
                with self.sending:
                    if not self._is_cancelled:
                        self._fail(request, error)

    def _respond(self, request: Request, is_superseded: Callable[[], bool]) -> None:
        messages = self._answer(request, is_superseded)
        while True:
            with self._slot:
                message, is_draft = next(messages, (None, False))
            if message is None:
                return
            with self.sending:
                if self._is_cancelled or (self._drops_superseded and is_superseded()):
                    raise SupersededError
                self._send(message)
            if is_draft:
                with self._changed:
                    if self._changed.wait_for(is_superseded, REST_S):
                        raise SupersededError


if __name__ == "__main__":
    sys.exit(main())
