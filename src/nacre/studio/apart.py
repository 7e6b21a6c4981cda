"""Long work in a process of its own, which ends when nobody waits for it any more: reports, files, meshes, skies.

The page's answers never wait for it, and what it uses of memory goes with it.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from nacre.core.errors import NacreError
from nacre.studio.downloads import made
from nacre.studio.measured import measured
from nacre.studio.objects import own_mesh
from nacre.studio.skies import sky_layers

WORK: dict[str, Callable[[Mapping[str, Any]], bytes]] = {
    "report": measured,
    "file": made,
    "mesh": own_mesh,
    "surround": sky_layers,
}
LOOKED_UP_S = 0.2


async def run_apart(
    kind: str, question: Mapping[str, Any], is_wanted: Callable[[], Awaitable[bool]], most_seconds: float = 300.0
) -> bytes:
    """Return the bytes that a kind of work makes of a question.

    Args:
        kind: one of `WORK`.
        question: what that function takes, as JSON can hold it.
        is_wanted: asked several times a second; when it is not, the process is ended.
        most_seconds: after which the process is ended all the same.

    Raises:
        NacreError: the recipe is wrong, or it cannot be done on this machine, or took too long.
    """
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "nacre.studio.apart", kind, stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE, start_new_session=True,
    )  # fmt: skip
    talk = asyncio.create_task(process.communicate(json.dumps(question).encode()))
    started = asyncio.get_running_loop().time()
    try:
        while not talk.done():
            await asyncio.wait({talk}, timeout=LOOKED_UP_S)
            if not talk.done() and not await is_wanted():
                raise NacreError(f"the {kind} is not wanted any more")
            if asyncio.get_running_loop().time() - started > most_seconds:
                raise NacreError(f"the {kind} took longer than {most_seconds:g} s and was given up")
        out, err = talk.result()
    finally:
        if process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            with contextlib.suppress(Exception):
                await talk
    if process.returncode != 0:
        lines = [line for line in err.decode("utf-8", "replace").splitlines() if line.startswith("nacre: ")]
        raise NacreError(lines[-1].removeprefix("nacre: ") if lines else f"the {kind} could not be made")
    return out


def main() -> int:
    """Read one question from stdin and write the answer to stdout; one line on stderr where there is none."""
    try:
        made = WORK[sys.argv[1]](json.loads(sys.stdin.read()))
    except NacreError as error:  # its one line is all that the page is to see
        sys.stderr.write(f"nacre: {error}\n")
        return 2
    except MemoryError:
        sys.stderr.write("nacre: not enough memory for this\n")
        return 2
    sys.stdout.buffer.write(made)
    sys.stdout.buffer.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main())
