"""The Blender extension against nacre in Mitsuba: a sphere, pixel by pixel, of six materials under two lights.

The zip of `nacre blender` is installed into an empty user folder of `bpy`, its own operator assigns each material, and
Cycles renders. The tables are those of the panel: a film's first thickness is their axis. The bar is a mean dE00 of 1
under even white light, and of 2.5 under the studio's light, which depends on the shape of the lobe.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from nacre.picture.environments import studio
from nacre.studio.blender import write_extension
from validation._film import canvas
from validation._rows import finish, row
from validation.tools_tables_in_cycles import (
    CYCLES_SAMPLES,
    MATERIALS,
    MITSUBA_SAMPLES,
    NOISIER,
    ball,
    cycles_picture,
    difference,
    inside,
    mitsuba_picture,
    python,
    shown,
    write_room,
)  # fmt: skip

FIGURE = "tools_blender_extension.png"
BARS = {"white": 1.0, "studio": 2.5}  # mean dE00
SHARES = {"white": 1.0, "studio": 0.25}  # of the samples of `tools_tables_in_cycles`; noise adds to dE00


def main(out_dir: str | Path, names: tuple[str, ...] = tuple(MATERIALS)) -> list[dict[str, Any]]:
    """Print claimed | ours | verdict, write the figure, return the rows."""
    exe = python()
    if exe is None:
        print("bpy cannot be had here: the extension is not compared", flush=True)
        missing = row("Blender extension", f"mean dE00 <= {BARS['white']:g}", "bpy cannot be had", False, "")
        return [{**missing, "verdict": "cannot be checked here"}]
    mesh, mask, rows = ball(), inside(), []
    room = studio("D65", 256)
    white = type(room)(np.ones((1, 16, 32)), room.spectra, "white")
    figure, axes = canvas(len(names), 6, 12.0, 2.0 * len(names))
    with tempfile.TemporaryDirectory() as temporary:
        work = Path(temporary)
        np.savez(work / "ball.npz", **mesh)
        write_room(work / "room.exr", room.weights[0])
        write_extension(work / "extension.zip", names)
        for line, name in enumerate(names):
            for place, (light, ours_in, theirs_in) in enumerate(
                (("white", white, "white"), ("studio", room, str(work / "room.exr")))
            ):
                share = SHARES[light] * NOISIER.get(name, 1)
                extra = {
                    "zip": str(work / "extension.zip"),
                    "name": Path(name).name,
                    "user": str(work / f"{line}{place}"),
                }
                ours = mitsuba_picture(name, mesh, ours_in, int(share * MITSUBA_SAMPLES))
                theirs = cycles_picture(
                    exe, work / "none", work, theirs_in, "extension", int(share * CYCLES_SAMPLES), extra
                )
                gap = difference(ours, theirs)
                mean = float(gap[mask].mean())
                found = f"{mean:.2f} (95 % of pixels below {np.quantile(gap[mask], 0.95):.2f})"
                claim = f"{name}, {light} light: the extension in Cycles against Mitsuba, mean dE00"
                rows.append(row(claim, f"<= {BARS[light]:g}", found, mean <= BARS[light], FIGURE))
                error = np.clip(gap * mask / 5, 0, 1)
                for column, (what, image) in enumerate(
                    (("Mitsuba", shown(ours)), ("Blender", shown(theirs)), ("dE00, 0 to 5", error))
                ):
                    axis = axes[line, 3 * place + column]
                    axis.set_axis_off()
                    axis.imshow(image, cmap="magma", vmin=0, vmax=1)
                    axis.set_title(f"{Path(name).name}, {light}: {what}", fontsize=6)
    finish(figure, out_dir, FIGURE)
    return rows


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "out/validation", tuple(sys.argv[2:]) or tuple(MATERIALS))
