"""Light: wavelengths, illuminants, and the conversion of spectra to colours.

Colours are `[..., 3]` arrays. XYZ has Y = 1 for a perfect white under the illuminant; defaults are D65 and
the CIE 1931 2 degree observer. By default sRGB outputs are adapted to sRGB's white by Bradford's transform, so a
white sheet stays white under every illuminant.
"""

from nacre.light.adaptation import (
    ADAPTATIONS,
    Adaptation,
    IlluminantShift,
    adapt_xyz,
    adaptation_matrix,
    illuminant_shift,
    metamerism,
)
from nacre.light.difference import delta_e_76, delta_e_2000
from nacre.light.display import (
    Clipped,
    clip_to_srgb,
    outside_srgb,
    spectrum_to_rgb_linear,
    spectrum_to_rgb_matrix,
    spectrum_to_srgb,
    swatch_hex,
)
from nacre.light.spaces import (
    SRGB_WHITE_XYZ,
    lab_to_lch,
    lab_to_xyz,
    lch_to_lab,
    srgb_decode,
    srgb_encode,
    srgb_linear_to_xyz,
    srgb_to_hex,
    xyy_to_xyz,
    xyz_to_lab,
    xyz_to_srgb_linear,
    xyz_to_xyy,
)
from nacre.light.tables import ILLUMINANTS, OBSERVERS, Illuminant, illuminant, observer, table_wavelengths_nm
from nacre.light.tristimulus import (
    lamp_lines_nm,
    smooth_weights,
    spans_colour,
    spectrum_to_xyz,
    white_xyz,
    with_lamp_lines,
    xyz_weights,
)
from nacre.light.wavelengths import WAVELENGTH_RANGE_NM, colour_step_nm, default_wavelengths

__all__ = [
    "ADAPTATIONS",
    "ILLUMINANTS",
    "OBSERVERS",
    "SRGB_WHITE_XYZ",
    "WAVELENGTH_RANGE_NM",
    "Adaptation",
    "Clipped",
    "Illuminant",
    "IlluminantShift",
    "adapt_xyz",
    "adaptation_matrix",
    "clip_to_srgb",
    "colour_step_nm",
    "default_wavelengths",
    "delta_e_76",
    "delta_e_2000",
    "illuminant",
    "illuminant_shift",
    "lab_to_lch",
    "lab_to_xyz",
    "lamp_lines_nm",
    "lch_to_lab",
    "metamerism",
    "observer",
    "outside_srgb",
    "smooth_weights",
    "spans_colour",
    "spectrum_to_rgb_linear",
    "spectrum_to_rgb_matrix",
    "spectrum_to_srgb",
    "spectrum_to_xyz",
    "srgb_decode",
    "srgb_encode",
    "srgb_linear_to_xyz",
    "srgb_to_hex",
    "swatch_hex",
    "table_wavelengths_nm",
    "white_xyz",
    "with_lamp_lines",
    "xyy_to_xyz",
    "xyz_to_lab",
    "xyz_to_srgb_linear",
    "xyz_to_xyy",
    "xyz_weights",
]
