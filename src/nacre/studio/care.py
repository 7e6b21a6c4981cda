"""How carefully a look is solved: a draft as coarse as this machine needs to follow a slider, then the settled one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nacre.arrays import Array

ANGLES_DEG = np.arange(0.0, 91.0)
STEEPEST_DEG = 88.0  # of what is integrated or walked: no light arrives at 90
SLOW_S, SWIFT_S = 0.3, 0.06  # a draft that took longer makes the next one coarser, one that took less finer


@dataclass(frozen=True, eq=False)
class Care:
    """What a look is solved at.

    Attributes:
        angles_deg: of the table.
        wavelengths_nm: None: the material's own.
        nodes: of integrals over all exits, along each of two coordinates; a walk takes their square of paths.
        samples: of a walk between two directions; None: as `nacre.evaluate` takes.
    """

    angles_deg: Array
    wavelengths_nm: Array | None = None
    nodes: int = 48
    samples: int | None = None


EVERY_DEGREE = Care(ANGLES_DEG)
SETTLED = Care(np.array([0.0, 8.0, 16.0, 24.0, 32.0, 40.0, 48.0, 56.0, 64.0, 72.0, 80.0, STEEPEST_DEG]))
DRAFTS = (
    Care(np.array([0.0, 20.0, 40.0, 60.0, 75.0, STEEPEST_DEG]), np.arange(400.0, 701.0, 25.0), 16, 512),
    Care(np.array([0.0, 30.0, 60.0, STEEPEST_DEG]), np.linspace(400.0, 700.0, 9), 12, 256),
    Care(np.array([0.0, 45.0, STEEPEST_DEG]), np.linspace(400.0, 700.0, 5), 8, 128),
)


class Drafts:
    """Which of `DRAFTS` each family is drafted at; it follows what drafts take on this machine.

    The first draft at a level is not judged: it compiles.
    """

    def __init__(self) -> None:
        self._levels: dict[str, int] = {}
        self._compiled: set[tuple[str, int]] = set()

    def of(self, family: str) -> Care:
        """Return how carefully to draft a material of a family."""
        return DRAFTS[self._levels.get(family, 0)]

    def took(self, family: str, seconds: float) -> None:
        """Remember what a draft took."""
        level = self._levels.get(family, 0)
        if (family, level) not in self._compiled:
            self._compiled.add((family, level))
        elif seconds > SLOW_S:
            level += 1
        elif seconds < SWIFT_S:
            level -= 1
        self._levels[family] = min(max(level, 0), len(DRAFTS) - 1)


drafts = Drafts()
