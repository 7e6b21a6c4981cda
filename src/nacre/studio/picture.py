"""The settled picture: Mitsuba in a process of its own, which ends when nobody waits for it any more."""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from nacre.errors import NacreError

SIZES = (128, 640)
SECONDS = (1.0, 120.0)
SCENES = ("sphere", "probe", "speedshape", "panel", "butterfly", "bottle", "knob", "body")
MAX_PNG = 16 << 20


async def settled_picture(
    question: dict[str, Any], is_wanted: Callable[[], Awaitable[bool]], most_seconds: float = 300.0
) -> bytes:
    """Return a PNG of a recipe, denoised.

    Args:
        question: `text`, `path`, `fence`, `scene`, `lamp`, `size` and `seconds`.
        is_wanted: asked several times a second; when it is not, the process is ended.
        most_seconds: after which the process is ended all the same.

    Raises:
        NacreError: the recipe is wrong, or nothing can be rendered on this machine.
    """
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "nacre.studio.picture", stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE, start_new_session=True,
    )  # fmt: skip
    talk = asyncio.create_task(process.communicate(json.dumps(question).encode()))
    started = asyncio.get_running_loop().time()
    try:
        while not talk.done():
            await asyncio.wait({talk}, timeout=0.2)
            if not talk.done() and not await is_wanted():
                raise NacreError("the picture is not wanted any more")
            if asyncio.get_running_loop().time() - started > most_seconds:
                raise NacreError(f"the picture took longer than {most_seconds:g} s; ask for a smaller one")
        out, err = talk.result()
    finally:
        if process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            with contextlib.suppress(Exception):
                await talk
    if process.returncode != 0 or not out.startswith(b"\x89PNG"):
        lines = [line for line in err.decode("utf-8", "replace").splitlines() if line.startswith("nacre: ")]
        raise NacreError(lines[-1].removeprefix("nacre: ") if lines else "the picture could not be rendered")
    return out


def read_question(body: Any) -> dict[str, Any]:
    """Return the bounded options of a picture.

    Raises:
        NacreError: not a table, or a value that is not allowed.
    """
    if not isinstance(body, dict) or not isinstance(body.get("text"), str) or not isinstance(body.get("name"), str):
        raise NacreError("a picture needs text and name")
    scene, size, seconds = body.get("scene", "sphere"), body.get("size", 320), body.get("seconds", 6)
    if scene not in SCENES:
        raise NacreError(f'scene "{str(scene)[:40]}" is not known; choose from {", ".join(SCENES)}')
    for key, value, (low, high) in (("size", size, SIZES), ("seconds", seconds, SECONDS)):
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
            raise NacreError(f"{key} = {str(value)[:20]} is not allowed; it should be from {low:g} to {high:g}")
    return {
        "text": body["text"], "name": body["name"], "lamp": str(body.get("lamp", "D65")), "scene": scene,
        "size": int(size), "seconds": float(seconds),
    }  # fmt: skip


def main() -> int:
    """Read one question from stdin and write the PNG to stdout; one line on stderr where it cannot be done."""
    import io

    from PIL import Image

    from nacre.light.gamut import clip_to_srgb
    from nacre.light.spaces import srgb_encode
    from nacre.picture.picture import render
    from nacre.studio.folder import build

    question = json.loads(sys.stdin.read())
    path = Path(question["path"])
    try:
        material = build(question["text"], path.name, path.parent, Path(question["fence"]))
        side = question["size"]
        result = render(
            material, question["scene"], light="studio", illuminant=question["lamp"], size=(side, side),
            seconds=question["seconds"], exposure=0.0 if question["scene"] == "sphere" else "auto", progress=False,
        )  # fmt: skip
        pixels = (255.0 * srgb_encode(clip_to_srgb(result.rgb).rgb) + 0.5).astype("uint8")
        held = io.BytesIO()
        Image.fromarray(pixels).save(held, "PNG")
        sys.stdout.buffer.write(held.getvalue())
        sys.stdout.buffer.flush()
    except NacreError as error:
        sys.stderr.write(f"nacre: {error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
