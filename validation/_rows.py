"""What the scripts share: one line of the report, and a figure that is written and closed."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def row(claim: str, claimed: object, ours: object, holds: bool, figure: str) -> dict[str, Any]:
    """One line of the report, printed as it is made."""
    line = {
        "claim": claim,
        "claimed": str(claimed),
        "ours": str(ours),
        "verdict": "holds" if holds else "DOES NOT HOLD",
        "figure": figure,
    }
    print(f"{claim}: {claimed} | {ours} | {line['verdict']}", flush=True)
    return line


def finish(figure: Any, out_dir: str | Path, name: str, dpi: int = 150) -> str:
    """Write the figure, close it and return its path."""
    from matplotlib import pyplot

    out = Path(out_dir)
    out.mkdir(parents=True, exist_ok=True)
    figure.savefig(out / name, dpi=dpi)
    pyplot.close(figure)
    return str(out / name)
