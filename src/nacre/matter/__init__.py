"""Matter: optical constants, layered media and spheres.

Everything is loaded on first use: the numba and JAX kernels are not needed to read a recipe.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
