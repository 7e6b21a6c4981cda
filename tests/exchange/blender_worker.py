"""Use the extension inside `bpy`, as its panel does, and print what was found as JSON; runs in bpy's own environment.

`python blender_worker.py ZIP FOLDER RECIPE`: FOLDER is empty and becomes Blender's user folder and the project's.
"""

import json
import os
import sys

ZIP, FOLDER, RECIPE = sys.argv[1:4]
os.environ["BLENDER_USER_RESOURCES"] = os.path.join(FOLDER, "user")
os.makedirs(os.path.join(FOLDER, "user", "extensions"), exist_ok=True)

import bpy  # noqa: E402  # reads the variable when imported

bpy.ops.wm.read_factory_settings(use_empty=True)
found = {"version": bpy.app.version_string}
bpy.ops.extensions.package_install_files(filepath=ZIP, repo="user_default", enable_on_install=True)
NAME = next(name for name in bpy.context.preferences.addons.keys() if name.endswith(".nacre"))
extension = sys.modules[NAME]


def attempt(operator, **settings):
    """Return "" or the error that the user would see."""
    try:
        operator(**settings)
    except RuntimeError as error:
        return str(error)
    return ""


def render(path, size=256, samples=16):
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = samples, False
    scene.render.resolution_x = scene.render.resolution_y = size
    scene.render.image_settings.file_format = "PNG"
    scene.render.filepath = path
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(path)
    pixels = list(image.pixels)
    middle = 4 * (size * (size // 2) + size // 2)
    return pixels[middle : middle + 3]


scene = bpy.context.scene
bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32)
bpy.ops.object.shade_smooth()
ball = bpy.context.object
bpy.ops.object.camera_add(location=(0, -4, 0), rotation=(1.5707963, 0, 0))
scene.camera = bpy.context.object
world = bpy.data.worlds.new("white")
scene.world = world
world.use_nodes = True
world.node_tree.nodes["Background"].inputs["Color"].default_value = (1, 1, 1, 1)
scene.view_settings.view_transform = "Standard"
bpy.context.view_layer.objects.active = ball
bpy.ops.object.select_all(action="DESELECT")
ball.select_set(True)

# what comes with the extension needs no nacre
kept = os.environ.pop("NACRE_PYTHON")
os.environ["PATH"] = ""
own = extension.built_in()
found["built_in"] = [entry["name"] for entry in own]
found["assign"] = attempt(bpy.ops.nacre.assign, path=own[0]["path"])
material = ball.active_material
node = material.node_tree.nodes["nacre"]
found["group"] = [node.node_tree.bl_idname, [socket.name for socket in node.inputs]]
axis = next(one for one in material.nacre.numbers if one.is_axis)
found["axis"] = [axis.name, axis.low, axis.high]
found["before"] = render(os.path.join(FOLDER, "before.png"))
axis.value = axis.high
found["after"] = render(os.path.join(FOLDER, "after.png"), samples=4)
found["input"] = node.inputs[axis.name].default_value
axis.value = 10.0 * axis.high
found["clamped"] = axis.value
found["no_recipe"] = attempt(bpy.ops.nacre.solve)

# without nacre: one line with the command
found["absent"] = attempt(bpy.ops.nacre.assign, path=RECIPE)
os.environ["NACRE_PYTHON"] = kept

# a job that is cancelled
extension.running["error"] = ""
job = extension.Job("library", {"folders": []}, lambda result: None)
job.cancel()
found["cancel"] = [job.step(wait=60.0), extension.running["error"], job.process.wait(60) != 0]

# a recipe of one's own, by nacre
scene.nacre.folder = os.path.dirname(RECIPE)
found["refresh"] = attempt(bpy.ops.nacre.refresh)
found["listed"] = [entry["name"] for entry in extension.entries()]
with open(os.path.join(extension.cache_folder(), "library.json"), "w") as file:
    json.dump(
        [
            {"name": "oxide", "family": "film", "about": "", "path": RECIPE},
            {"name": "star", "family": "relief", "about": "", "path": "relief/star"},
        ],
        file,
    )
found["thumbnails"] = attempt(bpy.ops.nacre.thumbnails)
found["sizes"] = [os.path.getsize(extension.thumbnail_file(entry)) for entry in extension.entries()]
found["items"] = [item[0] for item in extension.library_items(None, None)]
found["assign_own"] = attempt(bpy.ops.nacre.assign, path=RECIPE)
material = ball.active_material
found["own_numbers"] = {one.name: [one.value, one.is_axis] for one in material.nacre.numbers}
found["thumbnail"] = os.path.isfile(os.path.join(material.nacre.folder, "thumbnail.png"))
other = next(one for one in material.nacre.numbers if not one.is_axis)
other.value = 0.4
found["solve"] = attempt(bpy.ops.nacre.solve)
found["solved"] = {one.name: one.value for one in material.nacre.numbers}[other.name]
other = next(one for one in material.nacre.numbers if one.name == "surface.roughness")
other["value"] = 7.0
found["refused"] = attempt(bpy.ops.nacre.solve)
found["kept"] = material.node_tree.nodes["nacre"].node_tree is not None

# the recipe changes
with open(RECIPE, encoding="utf-8") as file:
    text = file.read()
with open(RECIPE, "w", encoding="utf-8") as file:
    file.write(text.replace("= 120", "= 80"))
os.utime(RECIPE, (2e9, 2e9))
found["is_stale"] = extension.stamp(material.nacre.recipe) != material.nacre.stamp
found["reimport"] = attempt(bpy.ops.nacre.reimport)
found["reimported"] = {one.name: one.value for one in material.nacre.numbers}["layers[0].thickness_nm"]

# bake
found["unsaved"] = attempt(bpy.ops.nacre.bake)
bpy.ops.wm.save_as_mainfile(filepath=os.path.join(FOLDER, "project.blend"))
found["bake"] = attempt(bpy.ops.nacre.bake)
group = material.node_tree.nodes["nacre"].node_tree
found["images"] = sorted({n.image.filepath for n in group.nodes if n.type == "TEX_IMAGE"})
bpy.ops.wm.save_mainfile()
bpy.ops.wm.open_mainfile(filepath=os.path.join(FOLDER, "project.blend"))
found["baked"] = render(os.path.join(FOLDER, "baked.png"), 64)
bpy.ops.preferences.addon_disable(module=NAME)
found["disabled"] = not hasattr(bpy.types.Scene, "nacre")
print("FOUND " + json.dumps(found))
