"""How a stack sends plane waves of multipoles back to where they came from: what all integrals over it are made of.

Over a stack a wave that goes down comes back up, and that is all. In a layer both faces reflect: with R_b and R_a the
reflections below and above, phase at the centre, waves sent down (up) come back up (down) with R_b (R_a) over
1 - R_a R_b, and either in its own direction with R_a R_b over the same. Between centres at unlike heights the phases of
the first two count from the mean height; in its own direction a wave that rises gathers more on its way to the higher.
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
        risen: of one sent up, in its own direction; None: nothing reflects above.
        fallen: of one sent down, in its own direction; None: nothing reflects above.
    """

    up: ComplexArray
    down: ComplexArray | None = None
    risen: ComplexArray | None = None
    fallen: ComplexArray | None = None

    @classmethod
    def between(
        cls, below: ComplexArray, above: ComplexArray, risen: ComplexArray | None = None,
        fallen: ComplexArray | None = None,
    ) -> Echo:  # fmt: skip
        """Return it for two mirrors that see one another, R_b and R_a.

        Args:
            risen, fallen: R_a R_b with the phases of a wave on its way to another height; R_a R_b of one height.
        """
        both = below * above
        left = 1.0 - both
        return cls(
            below / left, above / left, (both if risen is None else risen) / left,
            (both if fallen is None else fallen) / left,
        )  # fmt: skip

    def pairs(self, b: ComplexArray) -> list[tuple[ComplexArray, ComplexArray]]:
        """Return what comes to multipole n and what n' sent, `[m, pol, n, angle]` each: sums of products over both.

        sum_pairs left_n right_n' = Bdag_n(+) (up B_n'(-) + risen B_n'(+)) + Bdag_n(-) (down B_n'(+) + fallen B_n'(-)).

        Args:
            b: B(+) of the angles, `[m, pol, n, angle]`.
        """
        rising = adjoint(b)
        if self.down is None or self.risen is None or self.fallen is None:
            return [(rising * _wide(self.up), mirrored(b))]
        falling = mirrored(rising)
        return [
            (rising * _wide(self.up) + falling * _wide(self.fallen), mirrored(b)),
            (falling * _wide(self.down) + rising * _wide(self.risen), b),
        ]

    def signed(self, pol: int, target: Array, source: Array) -> ComplexArray:
        """Return the factor of Bdag_n(+) B_n'(+), `[angle, n or 1, n']`, by the signs that a mirror gives to n and n'.

        Args:
            pol: of the waves.
            target, source: signs, `[n]` and `[n']`.
        """
        out: ComplexArray = self.up[pol][:, None, None] * source
        if self.down is not None and self.risen is not None and self.fallen is not None:
            out = out + self.down[pol][:, None, None] * target[:, None] + self.risen[pol][:, None, None]
            out = out + self.fallen[pol][:, None, None] * (target[:, None] * source)
        return out


def _wide(values: ComplexArray) -> ComplexArray:
    return values[None, :, None, :]
