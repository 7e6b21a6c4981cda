"""The Blender extension in bpy's own environment: move a slider, and render the changed picture."""

from __future__ import annotations

import os
import tempfile
import time
from typing import Any

from blender_scene import axis_of, ball_in_white, picture, start
from common import serve

USER = tempfile.mkdtemp()
SIZE = 256


def setup(extension: str, name: str) -> list[float]:
    """Install the zip, put a material on a ball under white light; return the range of its axis."""
    bpy = start(USER, extension)
    ball = ball_in_white(bpy)
    bpy.ops.nacre.assign(path=name)
    bpy.context.scene.render.use_persistent_data = True  # as a viewport, which holds its scene
    axis = axis_of(ball)
    return [axis.low, axis.high]


def slide(share: float, samples: int) -> dict[str, Any]:
    """Move the slider to a share of its range, render; return (wall, cpu) seconds and the middle pixel."""
    import bpy  # after `start`

    axis = axis_of(bpy.context.view_layer.objects.active)
    wall, cpu = time.perf_counter(), time.process_time()
    axis.value = axis.low + share * (axis.high - axis.low)
    pixel = picture(bpy, os.path.join(USER, "slide.png"), SIZE, samples)
    return {"spent": [time.perf_counter() - wall, time.process_time() - cpu], "pixel": pixel}


if __name__ == "__main__":
    serve({"setup": setup, "slide": slide})
