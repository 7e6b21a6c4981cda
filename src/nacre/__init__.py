"""nacre: structural colour from nanostructure to picture and back.

Everything is loaded on first use, so that `import nacre` stays quick.
"""

import lazy_loader

from nacre._version import __version__  # noqa: F401  (handed on)

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
