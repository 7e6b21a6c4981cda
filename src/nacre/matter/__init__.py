"""Matter: optical constants and what layered media do to a plane wave.

Everything is loaded on first use: the numba and JAX kernels are not needed to read a recipe.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
