"""A bottle with shoulder, neck and cap: a surface of revolution, as nail lacquer and perfume are sold in."""

from __future__ import annotations

from nacre.picture.shapes.mesh import Mesh, revolve

# (radius, z) in units of the bottle's greatest half width; doubled points tighten an edge to a small radius
_GLASS = [
    (0.0, 0.05), (0.3, 0.05), (0.62, 0.02), (0.76, 0.0), (0.86, 0.03), (0.93, 0.12), (0.98, 0.36), (1.0, 0.7),
    (0.99, 1.05), (0.94, 1.36), (0.8, 1.6), (0.56, 1.76), (0.4, 1.84), (0.34, 1.93), (0.335, 2.02), (0.335, 2.1),
    (0.33, 2.13), (0.2, 2.14), (0.0, 2.14),
]  # fmt: skip
_CAP = [
    (0.0, 2.09), (0.3, 2.09), (0.43, 2.09), (0.455, 2.09), (0.462, 2.1), (0.462, 2.13), (0.455, 2.3), (0.435, 2.7),
    (0.415, 3.1), (0.405, 3.25), (0.4, 3.3), (0.36, 3.325), (0.2, 3.33), (0.0, 3.33),
]  # fmt: skip


def bottle() -> Mesh:
    """The bottle's body, standing on z = 0, closed at the neck."""
    return revolve(_GLASS, 320, 320)


def bottle_cap() -> Mesh:
    """The cap that sits on the neck."""
    return revolve(_CAP, 200, 200)
