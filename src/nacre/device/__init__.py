"""The lobes in Mitsuba: one plugin for each kind of lobe, and the random walk through strata.

Whatever is imported from here first points drjit to an LLVM that works; no variant is set.
"""

import importlib.util

from nacre.device.llvm import use_llvm

if importlib.util.find_spec("drjit") is not None:
    use_llvm()
