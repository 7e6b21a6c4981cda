"""The settled picture: what Mitsuba renders of the recipe."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nacre.core.errors import NacreError
from nacre.studio.folder import build
from nacre.studio.surroundings import NAMES
from nacre.studio.told import Tell

if TYPE_CHECKING:
    from nacre.picture.images import RenderResult

SIZES = (128, 640)
SECONDS = (1.0, 120.0)
SCENES = (
    "sphere", "probe", "speedshape", "panel", "butterfly", "bottle", "knob", "body", "beetle", "ring", "cuff",
    "banknote", "card",
)  # fmt: skip
MAX_PNG = 16 << 20


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
    light = body.get("light", "studio")
    if not isinstance(light, str) or light not in NAMES:
        raise NacreError(f'light "{str(light)[:40]}" is not known; choose from {", ".join(NAMES)}')
    for key, value, (low, high) in (("size", size, SIZES), ("seconds", seconds, SECONDS)):
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
            raise NacreError(f"{key} = {str(value)[:20]} is not allowed; it should be from {low:g} to {high:g}")
    return {
        "text": body["text"], "name": body["name"], "lamp": str(body.get("lamp", "D65")), "scene": scene,
        "light": light, "size": int(size), "seconds": float(seconds),
    }  # fmt: skip


def shape_of(question: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of a picture of an own mesh, or none: it is kept with z up."""
    return {"shape": question["shape"], "up": "z"} if question.get("shape") else {}


def drawn(question: Mapping[str, Any], tell: Tell) -> None:
    """Tell "begun", then "picture" with a PNG (as a data address) each time the samples have doubled, and the last.

    Raises:
        NacreError: the recipe is wrong, or nothing can be rendered on this machine.
    """
    from nacre.picture.picture import render

    path = Path(question["path"])
    material = build(question["text"], path.name, path.parent, Path(question["fence"]))
    side, scene = question["size"], question["scene"]
    tell({"kind": "begun"})
    stops: Any = 0.0 if scene == "sphere" else "auto"

    def heard(done: int, passes: int, seconds_left: float) -> None:
        tell({"kind": "progress", "done": done, "of": passes, "seconds_left": round(seconds_left, 1)})

    def seen(result: RenderResult) -> None:
        tell({"kind": "picture", "spp": result.stats["spp"], "is_last": False, "png": _png(result)})

    result = render(
        material, scene, **shape_of(question), light=question["light"], illuminant=question["lamp"],
        size=(side, side), seconds=question["seconds"], exposure=stops, progress=heard, on_better=seen,
    )  # fmt: skip
    tell({"kind": "picture", "spp": result.stats["spp"], "is_last": True, "png": _png(result)})


def _png(result: RenderResult) -> str:
    import base64
    import io

    from PIL import Image

    from nacre.light.display import clip_to_srgb
    from nacre.light.spaces import srgb_encode

    pixels = (255.0 * srgb_encode(clip_to_srgb(result.rgb).rgb) + 0.5).astype("uint8")
    held = io.BytesIO()
    Image.fromarray(pixels).save(held, "PNG")
    return "data:image/png;base64," + base64.b64encode(held.getvalue()).decode()
