"""Use the extension inside `bpy`, as its panel does, and print what was found as JSON; runs in bpy's own environment.

`python blender_worker.py ZIP FOLDER RECIPE`: FOLDER is empty and becomes Blender's user folder and the project's.
"""

import json
import os
import sys

ZIP, FOLDER, RECIPE = sys.argv[1:4]
sys.path.append(os.path.join(os.path.dirname(__file__), "..", "..", "benchmarks"))

from blender_scene import axis_of, ball_in_white, picture, start  # noqa: E402

bpy = start(os.path.join(FOLDER, "user"), ZIP)
found = {"version": bpy.app.version_string}
NAME = next(name for name in bpy.context.preferences.addons.keys() if name.endswith(".nacre"))
extension = sys.modules[NAME]


def attempt(operator, **settings):
    """Return "" or the error that the user would see."""
    try:
        operator(**settings)
    except RuntimeError as error:
        return str(error)
    return ""


def render(name, size=256, samples=16):
    return picture(bpy, os.path.join(FOLDER, name), size, samples)


scene = bpy.context.scene
ball = ball_in_white(bpy)
scene.view_settings.view_transform = "Standard"

# what comes with the extension needs no nacre
kept = os.environ.pop("NACRE_PYTHON")
os.environ["PATH"] = ""
own = extension.built_in()
found["built_in"] = [entry["name"] for entry in own]
found["assign"] = attempt(bpy.ops.nacre.assign, path=own[0]["path"])
material = ball.active_material
node = material.node_tree.nodes["nacre"]
found["group"] = [node.node_tree.bl_idname, [socket.name for socket in node.inputs]]
axis = axis_of(ball)
found["axis"] = [axis.name, axis.low, axis.high]
found["before"] = render("before.png")
axis.value = axis.high
found["after"] = render("after.png", samples=4)
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
found["baked"] = render("baked.png", 64)
bpy.ops.preferences.addon_disable(module=NAME)
found["disabled"] = not hasattr(bpy.types.Scene, "nacre")
print("FOUND " + json.dumps(found))
