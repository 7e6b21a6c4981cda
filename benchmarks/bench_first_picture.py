"""The first commands on a machine: whole processes in an empty home, with no kernel of numba or Dr.Jit compiled.

CPU seconds are compared with the bar, since they do not depend on other work; on free cores the clock shows fewer.
Floor: importing mitsuba and numpy (1 s), Dr.Jit's compilation of one scene (3 s), 8 million samples.
Prediction (before the first run): 1 s for a spectrum, which needs neither numba nor mitsuba; 12 s for a picture.
Outcome: see RESULTS.md. Until the first small work was solved in NumPy, a spectrum took 11 CPU s and a picture 20.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from common import Row, interleaved, parser, report

RECIPE = """family = "film"
substrate = "Ti"
layers = [{material = "TiO2-film", thickness_nm = 120}]

[surface]
distribution = "ggx"
roughness = 0.1
"""
PICTURE_BAR_S = 20.0
COMMANDS = {
    "spectrum": ["spectrum", "titanium.toml"],
    "picture": ["render", "titanium.toml", "--size", "256x256", "-o", "titanium.png"],
    "soap": ["render", "soap", "--size", "200x200", "-o", "soap.png"],
}


def first(words: list[str]) -> tuple[float, float]:
    """Run one command in an empty home; return (wall, cpu) seconds of the whole process."""
    with tempfile.TemporaryDirectory() as home:
        Path(home, "titanium.toml").write_text(RECIPE)
        clean = {name: value for name, value in os.environ.items() if not name.startswith(("NACRE", "XDG"))}
        clean |= {"HOME": home, "NUMBA_CACHE_DIR": f"{home}/numba"}
        before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        subprocess.run([sys.executable, "-m", "nacre", *words], cwd=home, env=clean, check=True, capture_output=True)
        wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
        return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; 0 if the bar is reached."""
    options = parser(__doc__, repeats=3).parse_args(arguments)
    found = interleaved({name: lambda words=words: first(words) for name, words in COMMANDS.items()}, options.repeats)
    rows = [
        Row(f"nacre {' '.join(COMMANDS[name])}", times.median_cpu, "CPU s",
            PICTURE_BAR_S if name == "picture" else None, higher_is_better=False,
            note=f"{times.median_wall:.1f} s by the clock")
        for name, times in found.items()
    ]  # fmt: skip
    return report("first_picture: whole processes, nothing compiled", rows, options.json)


if __name__ == "__main__":
    sys.exit(main())
