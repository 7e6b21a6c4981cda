"""Materials: recipes of all families, loaded, varied and solved."""

from nacre.core.lazy import make_callable

make_callable(__name__, "nacre.material.material:material")  # nacre.material({"family": "film", ...})
