"""The extension in bpy's own environment: an empty user folder, a ball under white light, a picture of it.

Import it before `bpy`, and call `start`, which sets Blender's user folder and then imports bpy.
"""

from __future__ import annotations

import os
from typing import Any


def start(user: str, extension: str) -> Any:
    """Import bpy with an empty user folder, install the zip as "Install from Disk" does; return the module bpy."""
    os.environ["BLENDER_USER_RESOURCES"] = user  # read when bpy is imported
    os.makedirs(os.path.join(user, "extensions"), exist_ok=True)
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.extensions.package_install_files(filepath=extension, repo="user_default", enable_on_install=True)
    return bpy


def ball_in_white(bpy: Any) -> Any:
    """Put a selected ball, a camera and even white light into the scene; return the ball."""
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
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.use_denoising = "CPU", False
    scene.render.image_settings.file_format = "PNG"
    return ball


def axis_of(ball: Any) -> Any:
    """Return the number of the ball's material that is the axis of its table."""
    return next(number for number in ball.active_material.nacre.numbers if number.is_axis)


def picture(bpy: Any, path: str, size: int, samples: int) -> list[float]:
    """Render to a file and return the middle pixel."""
    scene = bpy.context.scene
    scene.cycles.samples, scene.render.filepath = samples, path
    scene.render.resolution_x = scene.render.resolution_y = size
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(path)
    middle = 4 * (size * (size // 2) + size // 2)
    pixel = list(image.pixels[middle : middle + 3])
    bpy.data.images.remove(image)
    return pixel
