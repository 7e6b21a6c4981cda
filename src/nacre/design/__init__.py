"""Inverse design: from a target appearance to a structure that has it.

`nacre.design(target, folder)` takes a target file.
`nacre.design.many(target, labs)` designs many colours of one target.
"""

import importlib
from typing import Any

from nacre.core.lazy import make_callable

_PLACES = {
    "Design": "nacre.optimise.solutions",
    "Solution": "nacre.optimise.solutions",
    "many": "nacre.optimise.batch",
}
__all__ = list(_PLACES)


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_PLACES[name]), name)


make_callable(__name__, "nacre.optimise.run:run")  # nacre.design("target.toml", "folder")
