"""How a stack sends plane waves of multipoles back to where they came from: what all integrals over it are made of.

Over a stack a wave that goes down comes back up, and that is all. In a layer both faces reflect: with R_b and R_a the
reflections below and above, phase at the centre, waves sent down (up) come back up (down) with R_b (R_a) over
1 - R_a R_b, and either in its own direction with R_a R_b over the same.
"""

from __future__ import annotations

from dataclasses import dataclass

from nacre.arrays import Array, ComplexArray
from nacre.families.metasurface.angular import adjoint, mirrored


@dataclass(frozen=True)
class Echo:
    """What comes back of plane waves, `[pol, angle]` each, phase at the centre of the particle.

    Attributes:
        up: of a wave sent down, which comes back up.
        down: of one sent up, which comes back down; None: nothing reflects above.
        again: of either, in its own direction; None: nothing reflects above.
    """

    up: ComplexArray
    down: ComplexArray | None = None
    again: ComplexArray | None = None

    @classmethod
    def between(cls, below: ComplexArray, above: ComplexArray) -> Echo:
        """Return it for two mirrors that see one another, R_b and R_a."""
        left = 1.0 - below * above
        return cls(below / left, above / left, below * above / left)

    def pairs(self, b: ComplexArray) -> list[tuple[ComplexArray, ComplexArray]]:
        """Return what comes to multipole n and what n' sent, `[m, pol, n, angle]` each: sums of products over both.

        sum_pairs left_n right_n' = Bdag_n(+) (up B_n'(-) + again B_n'(+)) + Bdag_n(-) (down B_n'(+) + again B_n'(-)).

        Args:
            b: B(+) of the angles, `[m, pol, n, angle]`.
        """
        rising = adjoint(b)
        if self.down is None or self.again is None:
            return [(rising * _wide(self.up), mirrored(b))]
        falling = mirrored(rising)
        return [
            (rising * _wide(self.up) + falling * _wide(self.again), mirrored(b)),
            (falling * _wide(self.down) + rising * _wide(self.again), b),
        ]

    def signed(self, pol: int, target: Array, source: Array) -> ComplexArray:
        """Return the factor of Bdag_n(+) B_n'(+), `[angle, n or 1, n']`, by the signs that a mirror gives to n and n'.

        Args:
            pol: of the waves.
            target, source: signs, `[n]` and `[n']`.
        """
        out: ComplexArray = self.up[pol][:, None, None] * source
        if self.down is not None and self.again is not None:
            both = 1.0 + target[:, None] * source
            out = out + self.down[pol][:, None, None] * target[:, None] + self.again[pol][:, None, None] * both
        return out


def _wide(values: ComplexArray) -> ComplexArray:
    return values[None, :, None, :]
