"""Inverse design: from a wanted appearance to a relief that has it."""

import lazy_loader

from nacre.lazy import make_callable

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

make_callable(__name__, "nacre.design.run:run")  # nacre.design("target.toml", "folder")
