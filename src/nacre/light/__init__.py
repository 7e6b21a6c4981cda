"""Light: wavelengths, illuminants, and the conversion of spectra to colours.

Colours are `[..., 3]` arrays. XYZ has Y = 1 for a perfect white under the illuminant; defaults are D65 and
the CIE 1931 2 degree observer. By default sRGB outputs are adapted to sRGB's white by Bradford's transform, so a
white sheet stays white under every illuminant. Everything is loaded on first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
