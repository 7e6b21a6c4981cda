"""Tables for engines (`nacre export --to lut`) in Cycles against nacre in Mitsuba: a sphere, pixel by pixel.

Cycles is Blender's path tracer, from the `bpy` package, in an environment of its own (`.venv-cycles`, made by this
script): it knows nothing of films, only the pictures of the table and its own closures. Under even white light the bar
is a mean dE00 of 1; under the studio's light, where the shape of the lobe counts, the difference is stated.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import venv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import nacre
import nacre.render  # before mitsuba
from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.light import delta_e_2000, srgb_encode, srgb_linear_to_xyz, xyz_to_lab, xyz_to_srgb_linear
from nacre.light.display import clip_to_srgb
from nacre.picture.emitters import make_environment
from nacre.picture.environments import studio
from validation._film import canvas
from validation._rows import finish, row

FIGURE = "tools_tables_in_cycles.png"
ROOT = Path(__file__).resolve().parents[1]
VENV = ROOT / ".venv-cycles"
WORKER = Path(__file__).with_name("_cycles_worker.py")
PACKAGES = ("bpy==5.0.1; python_version == '3.11'", "bpy; python_version != '3.11'")
MATERIALS = {  # and what one film in glTF is off by, on the mean of the angles
    "bragg-mirror": "13.9", "morpho-film": "11.9", "jewel-beetle": "4.4", "tempered-steel": "2.8",
    "anodised-titanium": "1.9", "pearl/bottle3": "refused",
}  # fmt: skip
BAR = 1.0
SIZE, DISTANCE, FOV_DEG = 48, 4.0, 32.0
CYCLES_SAMPLES, MITSUBA_SAMPLES = 4096, 16384  # under white light; a quarter under the studio's, and for OSL
NOISIER = {"bragg-mirror": 4, "pearl/bottle3": 2}  # times as many: light that is thrown to and fro inside a body
PASS = 2048  # samples that Mitsuba takes at once
WITHIN = 0.97  # of the sphere's radius: pixels at the rim hold both it and the surroundings
RINGS = 96


def python() -> Path | None:
    """Return the Python of bpy's environment, made if need be, or of NACRE_BPY_PYTHON; None: bpy cannot be had."""
    if given := os.environ.get("NACRE_BPY_PYTHON"):
        return Path(given)
    found = VENV / "bin" / "python"
    if not (VENV / "ready").exists():
        venv.create(VENV, with_pip=True, clear=True)
        command = [str(found), "-m", "pip", "install", "-q", "--disable-pip-version-check", *PACKAGES]
        if subprocess.run(command).returncode:
            return None
        (VENV / "ready").touch()
    return found if subprocess.run([str(found), "-c", "import bpy"]).returncode == 0 else None


def ball() -> dict[str, Array]:
    """A sphere of triangles with its normals; u runs round, v from pole to pole."""
    v, u = np.meshgrid(np.linspace(0, 1, RINGS + 1), np.linspace(0, 1, 2 * RINGS + 1), indexing="ij")
    theta, phi = np.pi * (1 - v), 2 * np.pi * u + np.pi / 2  # the seam lies behind
    points = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    low, left = np.meshgrid(np.arange(RINGS), np.arange(2 * RINGS), indexing="ij")
    a = low * (2 * RINGS + 1) + left
    b = a + 2 * RINGS + 1
    quads = np.stack([a, a + 1, b + 1, b], axis=-1)
    first, second = quads[..., [0, 1, 2]], quads[..., [0, 2, 3]]
    faces = np.concatenate([first[1:].reshape(-1, 3), second[:-1].reshape(-1, 3)])  # no slivers at the poles
    flat = points.reshape(-1, 3)
    return {"vertices": flat, "normals": flat, "uv": np.stack([u, v], axis=-1).reshape(-1, 2), "faces": faces}


def mitsuba_picture(name: str, mesh: dict[str, Array], light: Any, samples: int) -> Array:
    """Render in Mitsuba; linear sRGB `[row, column, 3]` where the white light itself is (1, 1, 1)."""
    mi = nacre.render.use_variant()
    counts = (len(mesh["vertices"]), len(mesh["faces"]))
    shape = mi.Mesh("ball", *counts, has_vertex_normals=True, has_vertex_texcoords=True)
    held = mi.traverse(shape)
    for key, values in (("vertex_positions", "vertices"), ("vertex_normals", "normals"), ("vertex_texcoords", "uv")):
        held[key] = mesh[values].astype(np.float32).ravel()
    held["faces"] = mesh["faces"].astype(np.uint32).ravel()
    held.update()
    shape.set_bsdf(nacre.render.make_bsdf(nacre.load(name).bsdf()))
    transform = mi.ScalarTransform4f().look_at(origin=[0, -DISTANCE, 0], target=[0, 0, 0], up=[0, 0, 1])
    film = {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}, "pixel_format": "xyz"}
    scene = mi.load_dict(
        {
            "type": "scene", "shape": shape, "light": make_environment(light),
            "sensor": {"type": "perspective", "fov": FOV_DEG, "to_world": transform, "film": film},
            "integrator": {"type": "path", "max_depth": 64, "rr_depth": 64},
        }
    )  # fmt: skip
    passes = [np.array(mi.render(scene, spp=PASS, seed=seed), dtype=float)[..., :3] for seed in range(samples // PASS)]
    total = np.mean(passes, axis=0)
    return np.asarray(xyz_to_srgb_linear(total))


def cycles_picture(
    exe: Path, folder: Path, work: Path, light: str, shader: str, samples: int, extra: Mapping[str, str] | None = None
) -> Array:
    """Render in Cycles; `extra` goes into the worker's job."""
    import OpenEXR

    output = work / "cycles.exr"
    output.unlink(missing_ok=True)
    job = {
        "mesh": str(work / "ball.npz"), "folder": str(folder), "light": light, "size": SIZE, "samples": samples,
        "shader": shader, "output": str(output), "distance": DISTANCE, "fov_deg": FOV_DEG,
        **(extra or {}),
    }  # fmt: skip
    (work / "job.json").write_text(json.dumps(job), encoding="utf-8")
    done = subprocess.run([str(exe), str(WORKER), str(work / "job.json")], capture_output=True, text=True)
    if done.returncode or not output.exists():
        raise NacreError(f"Cycles failed: {(done.stderr or done.stdout)[-2000:]}")
    channels = OpenEXR.File(str(output)).channels()
    found = next(iter(channels.values())).pixels if len(channels) == 1 else None
    if found is None:
        found = np.stack([channels[key].pixels for key in "RGB"], axis=-1)
    return np.asarray(found[..., :3], dtype=float)


def write_room(path: Path, weights: Array) -> None:
    """Write the surroundings as Blender has them: the middle column looks along +x, azimuth falls to the right."""
    import OpenEXR

    columns = weights.shape[1]
    turned = np.roll(weights[:, ::-1], -(columns // 2), axis=1)
    pixels = np.ascontiguousarray(turned, np.float32)
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {key: pixels for key in "RGB"}).write(str(path))


def inside() -> Array:
    """Which pixels show the sphere alone."""
    y, x = np.mgrid[:SIZE, :SIZE] + 0.5 - SIZE / 2
    scale = np.tan(np.radians(FOV_DEG) / 2) / (SIZE / 2)
    return np.hypot(x, y) * scale < WITHIN * np.tan(np.arcsin(1.0 / DISTANCE))


def difference(one: Array, other: Array) -> Array:
    """dE00 a pixel."""
    labs = [np.asarray(xyz_to_lab(srgb_linear_to_xyz(rgb))) for rgb in (one, other)]
    return np.asarray(delta_e_2000(*labs))


def main(out_dir: str | Path, names: tuple[str, ...] = tuple(MATERIALS)) -> list[dict[str, Any]]:
    """Print claimed | ours | verdict, write the figure, return the rows."""
    exe = python()
    if exe is None:
        print("bpy cannot be had here: nothing is compared with Cycles", flush=True)
        missing = row("tables in Cycles", f"mean dE00 <= {BAR:g}", "bpy cannot be had", False, "")
        return [{**missing, "verdict": "cannot be checked here"}]
    mesh, mask, rows = ball(), inside(), []
    room = studio("D65", 256)
    white = type(room)(np.ones((1, 16, 32)), room.spectra, "white")
    figure, axes = canvas(len(names), 6, 12.0, 2.0 * len(names))
    with tempfile.TemporaryDirectory() as temporary:
        work = Path(temporary)
        np.savez(work / "ball.npz", **mesh)
        write_room(work / "room.exr", room.weights[0])
        for line, name in enumerate(names):
            folder = work / Path(name).name
            nacre.export(name, "lut", folder)
            for place, (title, light, where) in enumerate(
                (("white", white, "white"), ("studio", room, str(work / "room.exr")))
            ):
                share = NOISIER.get(name, 1) if title == "white" else 0.25
                ours = mitsuba_picture(name, mesh, light, int(share * MITSUBA_SAMPLES))
                theirs = cycles_picture(exe, folder, work, where, "nodes", int(share * CYCLES_SAMPLES))
                gap = difference(ours, theirs)
                mean = float(gap[mask].mean())
                note = f"{mean:.2f} (95 % of pixels below {np.quantile(gap[mask], 0.95):.2f})"
                if title == "white":
                    osl = difference(ours, cycles_picture(exe, folder, work, where, "osl", CYCLES_SAMPLES // 4))
                    note += f"; by shader.osl {osl[mask].mean():.2f}"
                    claim = f"{name}, even white light: Cycles against Mitsuba, mean dE00 (one film: {MATERIALS[name]})"
                    rows.append(row(claim, f"<= {BAR:g}", note, mean <= BAR, FIGURE))
                else:
                    rows.append(row(f"{name}, studio's light: the same", "stated", note, True, FIGURE))
                error = np.clip(gap * mask / 5, 0, 1)
                for column, (what, image) in enumerate(
                    (("Mitsuba", shown(ours)), ("Cycles", shown(theirs)), ("dE00, 0 to 5", error))
                ):
                    axis = axes[line, 3 * place + column]
                    axis.set_axis_off()
                    axis.imshow(image, cmap="magma", vmin=0, vmax=1)
                    axis.set_title(f"{Path(name).name}, {title}: {what}", fontsize=6)
    finish(figure, out_dir, FIGURE)
    return rows


def shown(rgb: Array) -> Array:
    """A picture as it is displayed."""
    return np.asarray(srgb_encode(clip_to_srgb(rgb).rgb))


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "out/validation", tuple(sys.argv[2:]) or tuple(MATERIALS))
