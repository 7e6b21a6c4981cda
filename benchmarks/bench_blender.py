"""The Blender extension: a slider of a table axis to the changed picture, 256 x 256 on the CPU.

bpy has no window, so a final render with persistent data stands for the viewport, whose first picture has one sample
a pixel and whose next ones refine it. NACRE_BPY_PYTHON, or `.venv-cycles`, is the Python with bpy.
Floor: 65,536 paths of one reflection, 0.05 CPU s; starting and ending a render of Cycles, some 0.2 s.
Prediction (before the first run): 0.4 s for one sample, 1 s for 16.
Outcome: see RESULTS.md.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

from common import ROOT, Row, Worker, interleaved, parser, report

from nacre.studio.blender import write_extension

BAR_S = 1.0
RECIPE = """family = "film"
substrate = "Ti"
layers = [{material = "TiO2-film", thickness_nm = 120}]
[surface]
roughness = 0.15
"""
PLACES = (0.2, 0.8)  # of the slider, in turn


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; 0 if the bar is reached."""
    options = parser(__doc__, repeats=7).parse_args(arguments)
    python = Path(os.environ.get("NACRE_BPY_PYTHON", ROOT / ".venv-cycles" / "bin" / "python"))
    with tempfile.TemporaryDirectory() as folder, Worker("peer_blender.py", python) as blender:
        recipe, extension = Path(folder, "oxide.toml"), Path(folder, "extension.zip")
        recipe.write_text(RECIPE)
        write_extension(extension, [str(recipe)])
        blender.ask("setup", extension=str(extension), name="oxide")
        turn, pixels = 0, []

        def slide(samples: int) -> tuple[float, float]:
            nonlocal turn
            turn += 1
            found = blender.ask("slide", share=PLACES[turn % 2], samples=samples)
            pixels.append(found["pixel"])
            return found["spent"][0], found["spent"][1]

        times = interleaved({"one": lambda: slide(1), "sixteen": lambda: slide(16)}, options.repeats)
    change = max(abs(a - b) for a, b in zip(pixels[0], pixels[1], strict=True))
    one, many = times["one"], times["sixteen"]
    rows = [
        Row("slider to changed picture, one sample a pixel", one.median_wall, "s", BAR_S, higher_is_better=False,
            note=f"{one.median_cpu:.2f} CPU seconds; the middle pixel changes by {change:.2f}"),
        Row("slider to changed picture, 16 samples a pixel", many.median_wall, "s",
            note=f"{many.median_cpu:.2f} CPU seconds"),
    ]  # fmt: skip
    return report("blender: the extension in Cycles, 256^2, CPU", rows, options.json)


if __name__ == "__main__":
    sys.exit(main())
