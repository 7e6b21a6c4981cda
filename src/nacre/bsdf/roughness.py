"""Roughness of an interface: a distribution of facet normals and its widths, which may vary over the surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from nacre.bsdf.texture import Texture

SMOOTH_BELOW = 1e-3  # alpha; such a surface spreads light by less than a tenth of a degree


@dataclass(frozen=True)
class Roughness:
    """How rough an interface is; all layers of a film follow it.

    Attributes:
        distribution: "ggx", "beckmann", "blinn" or "ashikhmin-shirley".
        alpha_x, alpha_y: widths; smooth if both are below 0.001.
        alpha_texture: multiplies both, or None.
        rotation: of the x axis of the roughness in rad, or None.
        compensate: return the light lost between facets.
    """

    distribution: str = "ggx"
    alpha_x: float = 0.0
    alpha_y: float = 0.0
    alpha_texture: Texture | None = None
    rotation: Texture | None = None
    compensate: bool = False

    @property
    def is_smooth(self) -> bool:
        """Whether the interface is a mirror."""
        return max(self.alpha_x, self.alpha_y) < SMOOTH_BELOW


def check_widths(value: object, forms: str, shown: str) -> None:
    """Check one or two widths as a recipe gives them.

    Args:
        value: what the recipe gives.
        forms: how a roughness may be written, for the message.
        shown: the value, for the message.

    Raises:
        ValueError: not one or two numbers, or one outside [0, 1]; the message goes on behind the key.
    """
    numbers: Any = value if isinstance(value, list | tuple) else [value]
    if len(numbers) not in (1, 2) or not all(isinstance(v, int | float) and not isinstance(v, bool) for v in numbers):
        raise ValueError(f"= {shown} is not a roughness; write {forms}")
    if not all(0.0 <= v <= 1.0 for v in numbers):
        raise ValueError(f"= {shown} is not allowed; it should be in [0, 1]")
