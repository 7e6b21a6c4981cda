"""What walks told of a likeness: how far off its guess is, here and at places of much the same light."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from nacre.arrays import Array

ALIKE = 0.1  # mean difference of the logarithms of two guesses, within which the walks at their places tell the same
MOST_FACTOR = 10.0  # by which a correction is trusted to grow
KNOWN_ERROR = 0.01  # of what a likeness knows: it is computed on coarser tables than the walk


@dataclass(frozen=True, eq=False)
class Correction:
    """What a walk told at one place.

    Attributes:
        rest: `[row, wavelength]`, factors beyond what is known.
        guess: `[row, wavelength]`, what the likeness said of them.
    """

    rest: Array
    guess: Array

    def of(self, known: Array, guess: Array) -> Array:
        """Return the factors of another place."""
        ratio = np.where(self.guess > 1e-9, guess / np.maximum(self.guess, 1e-9), 1.0)
        return np.asarray(known + self.rest * np.clip(ratio, 0.0, MOST_FACTOR))


@dataclass
class Told:
    """All walks of a search.

    Attributes:
        off: by what share the likeness' guess is off, as a standard deviation; None: not known.
        walks: their number, guess, rest and its error at each place.
    """

    off: float | None
    walks: list[tuple[int, Array, Array, Array]] = field(default_factory=list)

    @property
    def count(self) -> int:
        """Places that were walked at."""
        return len(self.walks)

    def told(self, walks: int, known: Array, guess: Array, rest: Array, error: Array) -> tuple[Array, Array]:
        """Take a walk; return the rest at its place and its error, by this and all others and by the guess itself.

        Each had its own seed: together they are quieter than one alone. Walks and guess count each as it is sure of
        itself.

        Args:
            walks: their number.
            known, guess: `[row, wavelength]`, of the likeness there.
            rest, error: `[row, wavelength]`, what the walk says beyond what is known.
        """
        self.walks.append((walks, guess, rest, error))
        found, off = self._pooled(guess)
        if self.off is None:
            return found, off
        own = (self.off * guess) ** 2 + (KNOWN_ERROR * known) ** 2
        share = own / np.maximum(own + off**2, 1e-30)
        return guess + share * (found - guess), np.sqrt(share) * off

    def _pooled(self, guess: Array) -> tuple[Array, Array]:
        """Return what the walks at places of much the same light say of the rest at the last one, and its error."""
        total, rest, square = 0.0, np.zeros_like(guess), np.zeros_like(guess)
        floor = np.maximum(guess, 1e-9)
        for walks, other, found, error in self.walks:
            apart = float(np.mean(np.abs(np.log(floor / np.maximum(other, 1e-9)))))
            weight = walks * np.exp(-((apart / ALIKE) ** 2))
            scale = np.where(other > 1e-9, floor / np.maximum(other, 1e-9), 1.0)
            total += weight
            rest += weight * scale * found
            square += (weight * scale * error) ** 2
        return rest / total, np.sqrt(square) / total


__all__ = ["Correction", "Told"]
