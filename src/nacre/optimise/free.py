"""What may change, and how far it spreads in manufacture: the tables `[free]` and `[spread]` of a target."""

from __future__ import annotations

from nacre.optimise.parameters import Free, own_place, place_of, read_free, values_at
from nacre.optimise.tolerances import spreads_of

__all__ = ["Free", "own_place", "place_of", "read_free", "spreads_of", "values_at"]
