"""The lobes in Mitsuba: one plugin for each lobe, and the random walk through strata.

Importing this package points drjit to a working LLVM; it does not set a variant.
"""

import importlib.util

from nacre.device.llvm import use_llvm

if importlib.util.find_spec("drjit") is not None:
    use_llvm()
