"""Cost of one candidate of `Material.parametrise`: a plain film, one with an index file, one with a large texture.

Bars: 0.15 ms with an index file and with a texture of 2048 x 2048 pixels; `Material.vary` took 2.9 and 127 ms.
Outcome: see RESULTS.md.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from PIL import Image

import nacre
from benchmarks.common import Row, parser, report

BAR_MS = 0.15
SIDE = 2048
CANDIDATES = 1000
PATH = "layers[0].thickness_nm"
LAYERS = [{"material": "SiO2", "thickness_nm": 350.0}, {"material": "TiO2", "thickness_nm": 60.0}]
FILM = {"family": "film", "substrate": "Si", "layers": LAYERS}
TEXTURE = {"texture": "grey.png", "min": 0.1, "max": 0.4}
CASES = {
    "a film of named materials": FILM,
    "a film with an index file": {**FILM, "substrate": {"file": "index.csv"}},
    f"a film with a texture of {SIDE} x {SIDE}": {**FILM, "surface": {"roughness": TEXTURE}},
}


def candidate_ms(recipe: dict, folder: Path, repeats: int) -> float:
    """Return the smallest mean time of a candidate among some repeats."""
    make = nacre.material(recipe, folder).parametrise([PATH])
    values = np.linspace(100.0, 600.0, CANDIDATES).tolist()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        for value in values:
            make({PATH: value})
        times.append(1e3 * (time.process_time() - start) / CANDIDATES)
    return min(times)


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; 0 if the bars are reached."""
    options = parser(__doc__, repeats=5).parse_args(arguments)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        noise = np.random.default_rng(1).integers(0, 256, (SIDE, SIDE), dtype=np.uint8)
        Image.fromarray(noise).save(folder / "grey.png")
        lines = [f"{nm},{1.5 + 2000.0 / nm**2},0" for nm in range(300, 900, 5)]
        (folder / "index.csv").write_text("\n".join(lines) + "\n")
        rows = [
            Row(title, candidate_ms(recipe, folder, options.repeats), "ms", BAR_MS, higher_is_better=False)
            for title, recipe in CASES.items()
        ]
    return report("vary: one candidate of a parametrised material", rows, options.json)


if __name__ == "__main__":
    sys.exit(main())
