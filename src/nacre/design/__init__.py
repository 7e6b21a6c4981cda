"""Inverse design: from a wanted appearance to a structure that has it.

`nacre.design(target, folder)` takes a target file of either form; `nacre.design.many(target, labs)` many colours of
one target.
"""

import lazy_loader

from nacre.lazy import make_callable

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

make_callable(__name__, "nacre.design.verb:run")  # nacre.design("target.toml", "folder")
