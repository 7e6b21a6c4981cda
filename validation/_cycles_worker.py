"""Render a sphere in Cycles with the material that a folder's `blender.py` builds; runs in bpy's own environment.

`python _cycles_worker.py JOB.json`: mesh (npz: vertices, normals, uv, faces), folder, light ("white" or the path of a
float EXR in Blender's equirectangular form), size, samples, shader ("nodes", "osl", or "extension" with `zip`, the
extension that holds the solved material `name`), output (EXR).
"""

from __future__ import annotations

import importlib.util
import json
import math
import os
import sys
from pathlib import Path
from typing import Any

JOB = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
if JOB["shader"] == "extension":
    os.environ["BLENDER_USER_RESOURCES"] = JOB["user"]  # read when bpy is imported
    Path(JOB["user"], "extensions").mkdir(parents=True, exist_ok=True)

import bpy  # noqa: E402
import numpy as np  # noqa: E402


def load_mesh(path: str) -> Any:
    """Make the object of arrays, with its uv and its own normals."""
    held = np.load(path)
    mesh = bpy.data.meshes.new("ball")
    mesh.from_pydata(held["vertices"].tolist(), [], held["faces"].tolist())
    layer = mesh.uv_layers.new(name="UVMap")
    corners = np.array([loop.vertex_index for loop in mesh.loops])
    layer.data.foreach_set("uv", held["uv"][corners].astype(np.float32).ravel())
    mesh.polygons.foreach_set("use_smooth", [True] * len(mesh.polygons))
    mesh.normals_split_custom_set_from_vertices(held["normals"].tolist())
    made = bpy.data.objects.new("ball", mesh)
    bpy.context.scene.collection.objects.link(made)
    return made


def material(job: dict[str, Any]) -> Any:
    """Build the material of the folder, by its script or as a node that runs its OSL."""
    folder = Path(job["folder"])
    if job["shader"] == "nodes":
        found = importlib.util.spec_from_file_location("blender_material", folder / "blender.py")
        module = importlib.util.module_from_spec(found)
        found.loader.exec_module(module)
        return module.build(folder=str(folder))
    made = bpy.data.materials.new("osl")
    made.use_nodes = True
    tree = made.node_tree
    tree.nodes.clear()
    script = tree.nodes.new("ShaderNodeScript")
    import _cycles  # which is there when bpy is

    compiled = folder.parent / "shader.oso"
    if not _cycles.osl_compile(str(folder / "shader.osl"), str(compiled)):
        raise SystemExit("shader.osl cannot be compiled")
    script.mode = "EXTERNAL"
    script.filepath = str(compiled)
    # Blender itself asks the shader for its sockets, by a module that bpy comes without
    for kind, name in (("NodeSocketString", "folder"), ("NodeSocketVector", "UV"), ("NodeSocketVector", "Tangent")):
        script.inputs.new(kind, name)
    script.outputs.new("NodeSocketShader", "BSDF")
    script.inputs["folder"].default_value = f"{folder}/"
    tree.links.new(tree.nodes.new("ShaderNodeTexCoord").outputs["UV"], script.inputs["UV"])
    tangent = tree.nodes.new("ShaderNodeTangent")
    tangent.direction_type = "UV_MAP"
    tree.links.new(tangent.outputs[0], script.inputs["Tangent"])
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(script.outputs["BSDF"], output.inputs["Surface"])
    return made


def install(job: dict[str, Any]) -> None:
    """Install the extension's zip into an empty user folder, as "Install from Disk" does."""
    bpy.ops.extensions.package_install_files(filepath=job["zip"], repo="user_default", enable_on_install=True)


def assign(job: dict[str, Any], thing: Any) -> None:
    """Put a material on an object by the extension's own operator; end with its error if it reports one."""
    bpy.context.view_layer.objects.active = thing
    thing.select_set(True)
    bpy.ops.nacre.assign(path=job["name"])
    if not thing.active_material or thing.active_material.node_tree.nodes["nacre"].type != "GROUP":
        raise SystemExit("the extension assigned no node group")


def surround(scene: Any, light: str) -> None:
    """Light the scene: evenly white, or by a picture."""
    world = bpy.data.worlds.new("world")
    scene.world = world
    world.use_nodes = True
    tree = world.node_tree
    back = tree.nodes["Background"]
    if light == "white":
        back.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
        return
    node = tree.nodes.new("ShaderNodeTexEnvironment")
    node.image = bpy.data.images.load(light)
    node.image.colorspace_settings.name = "Non-Color"
    tree.links.new(node.outputs["Color"], back.inputs["Color"])


def main(job: dict[str, Any]) -> None:
    """Do the job."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    cycles = scene.cycles
    cycles.device = "CPU"
    cycles.shading_system = job["shader"] == "osl"
    cycles.samples, cycles.use_denoising, cycles.use_adaptive_sampling = job["samples"], False, False
    cycles.sample_clamp_indirect = cycles.sample_clamp_direct = 0.0
    cycles.caustics_reflective = cycles.caustics_refractive = True
    cycles.blur_glossy = 0.0
    for name in ("max", "glossy", "transmission", "diffuse", "transparent_max"):
        setattr(cycles, f"{name}_bounces", 64)
    cycles.pixel_filter_type, cycles.seed = "BOX", job.get("seed", 0)
    thing = load_mesh(job["mesh"])
    if job["shader"] == "extension":
        install(job)
        assign(job, thing)
    else:
        thing.data.materials.append(material(job))
    surround(scene, job["light"])
    camera = bpy.data.cameras.new("camera")
    camera.angle = math.radians(job["fov_deg"])
    eye = bpy.data.objects.new("camera", camera)
    eye.location, eye.rotation_euler = (0.0, -job["distance"], 0.0), (math.pi / 2, 0.0, 0.0)
    scene.collection.objects.link(eye)
    scene.camera = eye
    scene.render.resolution_x = scene.render.resolution_y = job["size"]
    scene.render.resolution_percentage = 100
    scene.render.film_transparent = False
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.render.filepath = job["output"]
    bpy.ops.render.render(write_still=True)


if __name__ == "__main__":
    main(JOB)
