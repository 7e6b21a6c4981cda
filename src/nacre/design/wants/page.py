"""The report of a design by wants."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from nacre.design.wants.target import Target


def write_page(folder: Path, target: Target, design: Any) -> None:
    """Write report.html and report.png."""
