"""Relief, inverse: every published target designed afresh, beside the published design under the same plain model."""

from __future__ import annotations

import importlib.util
import os
import tempfile
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[1]
TIME_LIMIT_S = float(os.environ.get("NACRE_DESIGN_SECONDS", "60"))
FIXED_BAR, FREE_BAR = 0.80, 0.75


def bench() -> ModuleType:
    """Return the design benchmark, which knows how a published design becomes a target."""
    spec = importlib.util.spec_from_file_location("bench_relief_design", ROOT / "benchmarks" / "bench_relief_design.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def shown(rgb: NDArray[np.float64], scale: float, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return what the loss sees, as a picture."""
    return np.clip(np.maximum(scale * rgb, 0.0) ** (1 / 2.2), 0.0, 1.0).reshape(shape)


def main(out_dir: Path) -> list[dict[str, Any]]:
    """Design all targets; return rows and write target | published | ours at the fixed and at the best scale."""
    from PIL import Image

    from nacre.design.problem import measure_design
    from nacre.design.run import design
    from nacre.design.search import one_thread_each

    out_dir = Path(out_dir)
    out_dir.mkdir(parents=True, exist_ok=True)
    tool = bench()
    with np.load(tool.REFERENCE / "published_designs.npz") as data:
        designs = {name: data[name] for name in data.files}
    figure = out_dir / "designs.png"
    rows, strips, ratios = [], [], []
    for i in range(len(designs["pixel_um"])):
        spec, context = tool.checked(designs, i, TIME_LIMIT_S)
        problem = spec.build(context)
        with tempfile.TemporaryDirectory() as folder:
            result = design(spec, context, folder)
        with one_thread_each():
            published = measure_design(problem, 1e3 * designs["feature_height"][i].astype(float))
            ours = measure_design(problem, 1e3 * result.heights_um)
        a, b = published.losses, ours.losses
        ratios.append((b.fixed / a.fixed, b.free / a.free))
        shape = problem.views[0].target.shape[1:]
        strip = [np.clip(problem.target.reshape(shape), 0, 1)]
        strip += [shown(m.rgb, m.losses.scale_fixed, shape) for m in (published, ours)]
        strip += [shown(m.rgb, m.losses.scale_free, shape) for m in (published, ours)]
        strips.append(np.concatenate([np.pad(s, ((2, 2), (2, 2), (0, 0)), constant_values=1) for s in strip], axis=1))
        rows.append(
            {
                "claim": f"design of {designs['name'][i]}",
                "claimed": f"fixed {a.fixed:.4f}, free {a.free:.4f} (published; black {a.black:.4f})",
                "ours": f"fixed {b.fixed:.4f} ({ratios[-1][0]:.2f}), free {b.free:.4f} ({ratios[-1][1]:.2f}) at scale "
                f"{b.scale_free:.3g}, {result.summary['seconds']:.0f} s",
                "verdict": "reached" if b.fixed < a.fixed and b.free < a.free else "misses",
                "figure": str(figure),
            }
        )
        print(
            f"{rows[-1]['claim']:66s} {rows[-1]['claimed']:60s} {rows[-1]['ours']:70s} {rows[-1]['verdict']}",
            flush=True,
        )
    fixed, free = np.median(ratios, axis=0)
    rows.append(
        {
            "claim": f"median ratio of the losses after at most {TIME_LIMIT_S:g} s",
            "claimed": f"fixed <= {FIXED_BAR}, free <= {FREE_BAR}",
            "ours": f"fixed {fixed:.2f}, free {free:.2f}",
            "verdict": "reached" if fixed <= FIXED_BAR and free <= FREE_BAR else "misses",
            "figure": str(figure),
        }
    )
    while len(strips) % 3:
        strips.append(np.ones_like(strips[0]))
    page = np.concatenate([np.concatenate(strips[k::3], axis=0) for k in range(3)], axis=1)
    Image.fromarray(np.round(255 * page).astype(np.uint8)).save(figure)
    return rows


if __name__ == "__main__":
    main(Path(__file__).resolve().parent / "figures" / Path(__file__).stem)
