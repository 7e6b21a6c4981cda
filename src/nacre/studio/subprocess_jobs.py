"""Long work in a process of its own that tells how far it is: designs, gamuts, clouds of tolerance, pictures.

What it tells are lines of JSON, each a table with its `kind`. It ends when nobody listens any more: its stdin then
closes. A line "stop" there asks for an end with what there is.
"""

from __future__ import annotations

import asyncio
import contextlib
import importlib
import json
import os
import signal
import sys
import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any

from nacre.core.errors import NacreError

# what is told of -> module and function; imported by the process alone, as they take long to import
WORK = {
    "design": "nacre.studio.design_job:designed",
    "reach": "nacre.studio.gamut_job:reachable",
    "cloud": "nacre.studio.tolerance_job:clouded",
    "picture": "nacre.studio.picture_job:drawn",
}
LOOKED_UP_S = 0.2
STOPPING_S = 20.0  # from being asked to stop to being ended
LONGEST_LINE = 32 << 20  # bytes: a picture in base 64
MOST_MEMORY = 4 << 30  # bytes that a process may hold


async def stream_apart(
    kind: str, question: Mapping[str, Any], is_wanted: Callable[[], Awaitable[bool]], stop: asyncio.Event,
    most_seconds: float,
) -> AsyncIterator[bytes]:  # fmt: skip
    """Yield what a kind of work tells, a line of JSON each; the last is of kind "done" or "error".

    Args:
        kind: one of `WORK`.
        question: what that function takes, as JSON can hold it.
        is_wanted: asked several times a second; when it is not, the process is ended.
        stop: set to ask for an end with what there is.
        most_seconds: after which the process is ended all the same.
    """
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "nacre.studio.subprocess_jobs", kind, stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.DEVNULL, start_new_session=True, limit=LONGEST_LINE,
    )  # fmt: skip
    assert process.stdin is not None and process.stdout is not None
    loop = asyncio.get_running_loop()
    ends = loop.time() + most_seconds
    is_asked = False
    reading = asyncio.create_task(process.stdout.readline())
    try:
        process.stdin.write(json.dumps(question).encode() + b"\n")
        while True:
            await asyncio.wait({reading}, timeout=LOOKED_UP_S)
            if reading.done():
                line = reading.result()
                if not line:
                    yield _line({"kind": "error", "error": f"the {kind} ended without an answer"})
                    return
                yield line
                if json.loads(line).get("kind") in ("done", "error"):
                    return
                reading = asyncio.create_task(process.stdout.readline())
            if not await is_wanted():
                return
            if stop.is_set() and not is_asked:
                is_asked, ends = True, min(ends, loop.time() + STOPPING_S)
                process.stdin.write(b"stop\n")
            why = _why_too_much(process.pid, loop.time() > ends, kind)
            if why:
                yield _line({"kind": "error", "error": why})
                return
    finally:
        reading.cancel()
        if process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
        with contextlib.suppress(Exception):
            await asyncio.shield(process.wait())


def _line(event: Mapping[str, Any]) -> bytes:
    return json.dumps(event).encode() + b"\n"


def _why_too_much(pid: int, is_late: bool, kind: str) -> str:
    if is_late:
        return f"the {kind} took too long and was given up"
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    except (OSError, ValueError, IndexError):
        return ""  # not everywhere can one ask
    if pages * os.sysconf("SC_PAGE_SIZE") <= MOST_MEMORY:
        return ""
    return f"the {kind} took more than {MOST_MEMORY >> 30} GiB of memory and was given up; make it smaller"


def main() -> int:
    """Read one question from stdin and tell what comes of it on stdout."""
    out = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # whatever else is printed is no line of ours
    lock = threading.Lock()

    def tell(event: Mapping[str, Any]) -> None:
        with lock:
            out.write(json.dumps(event, default=float) + "\n")
            out.flush()

    try:
        question = json.loads(sys.stdin.readline())
        threading.Thread(target=_listen, daemon=True).start()
        module, _, function = WORK[sys.argv[1]].partition(":")
        getattr(importlib.import_module(module), function)(question, tell)
        tell({"kind": "done"})
    except NacreError as error:
        tell({"kind": "error", "error": str(error)})
    except MemoryError:
        tell({"kind": "error", "error": "not enough memory for this"})
    except KeyboardInterrupt:
        tell({"kind": "done"})
    except Exception as error:  # whatever it was: the page must hear of it
        what = f"{type(error).__name__}: {str(error)[:200]}"
        tell({"kind": "error", "error": f"this is a bug in nacre, please report it: {what}"})
    return 0


def _listen() -> None:
    for line in sys.stdin:
        if line.strip() == "stop":
            os.kill(os.getpid(), signal.SIGINT)
    os._exit(3)  # the server has gone, or wants no answer any more


if __name__ == "__main__":
    sys.exit(main())
