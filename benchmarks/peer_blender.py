"""The Blender extension in bpy's own environment: move a slider, and render the changed picture."""

from __future__ import annotations

import os
import tempfile
import time
from typing import Any

from common import serve

USER = tempfile.mkdtemp()
os.environ["BLENDER_USER_RESOURCES"] = USER  # read when bpy is imported
os.makedirs(os.path.join(USER, "extensions"))

import bpy  # noqa: E402

SIZE = 256


def setup(extension: str, name: str) -> list[float]:
    """Install the zip, put a material on a ball under white light; return the range of its axis."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.extensions.package_install_files(filepath=extension, repo="user_default", enable_on_install=True)
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32)
    bpy.ops.object.shade_smooth()
    ball = bpy.context.object
    bpy.ops.object.camera_add(location=(0, -4, 0), rotation=(1.5707963, 0, 0))
    scene.camera = bpy.context.object
    scene.world = bpy.data.worlds.new("white")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (1, 1, 1, 1)
    bpy.ops.object.select_all(action="DESELECT")
    bpy.context.view_layer.objects.active = ball
    ball.select_set(True)
    bpy.ops.nacre.assign(path=name)
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.use_denoising = "CPU", False
    scene.render.use_persistent_data = True  # as a viewport, which holds its scene
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    axis = next(one for one in ball.active_material.nacre.numbers if one.is_axis)
    return [axis.low, axis.high]


def slide(share: float, samples: int) -> dict[str, Any]:
    """Move the slider to a share of its range, render; return (wall, cpu) seconds and the middle pixel."""
    scene = bpy.context.scene
    scene.cycles.samples = samples
    scene.render.filepath = os.path.join(USER, "slide.png")
    numbers = bpy.context.view_layer.objects.active.active_material.nacre.numbers
    axis = next(one for one in numbers if one.is_axis)
    wall, cpu = time.perf_counter(), time.process_time()
    axis.value = axis.low + share * (axis.high - axis.low)
    bpy.ops.render.render(write_still=True)
    spent = [time.perf_counter() - wall, time.process_time() - cpu]
    image = bpy.data.images.load(scene.render.filepath)
    middle = 4 * (SIZE * (SIZE // 2) + SIZE // 2)
    pixel = list(image.pixels[middle : middle + 3])
    bpy.data.images.remove(image)
    return {"spent": spent, "pixel": pixel}


if __name__ == "__main__":
    serve({"setup": setup, "slide": slide})
