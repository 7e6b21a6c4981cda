"""Light: wavelengths, illuminants, and the conversion of spectra to colours.

Colours are `[..., 3]` arrays. XYZ has Y = 1 for a perfect white under the illuminant; defaults are D65 and
the CIE 1931 2 degree observer. By default sRGB outputs are adapted to sRGB's white by Bradford's transform, so a
white sheet stays white under every illuminant.
"""

from nacre.light.colour_spaces import SRGB_WHITE_XYZ as SRGB_WHITE_XYZ
from nacre.light.colour_spaces import colour_difference as colour_difference
from nacre.light.colour_spaces import delta_e_76 as delta_e_76
from nacre.light.colour_spaces import delta_e_94 as delta_e_94
from nacre.light.colour_spaces import delta_e_2000 as delta_e_2000
from nacre.light.colour_spaces import delta_e_2000_components as delta_e_2000_components
from nacre.light.colour_spaces import delta_e_cmc as delta_e_cmc
from nacre.light.colour_spaces import delta_e_din99o as delta_e_din99o
from nacre.light.colour_spaces import delta_e_din6175 as delta_e_din6175
from nacre.light.colour_spaces import lab_to_din99o as lab_to_din99o
from nacre.light.colour_spaces import lab_to_lch as lab_to_lch
from nacre.light.colour_spaces import lab_to_xyz as lab_to_xyz
from nacre.light.colour_spaces import lch_to_lab as lch_to_lab
from nacre.light.colour_spaces import srgb_decode as srgb_decode
from nacre.light.colour_spaces import srgb_encode as srgb_encode
from nacre.light.colour_spaces import srgb_linear_to_xyz as srgb_linear_to_xyz
from nacre.light.colour_spaces import srgb_to_hex as srgb_to_hex
from nacre.light.colour_spaces import xyy_to_xyz as xyy_to_xyz
from nacre.light.colour_spaces import xyz_to_lab as xyz_to_lab
from nacre.light.colour_spaces import xyz_to_srgb_linear as xyz_to_srgb_linear
from nacre.light.colour_spaces import xyz_to_xyy as xyz_to_xyy
from nacre.light.display import ADAPTATIONS as ADAPTATIONS
from nacre.light.display import Adaptation as Adaptation
from nacre.light.display import Clipped as Clipped
from nacre.light.display import IlluminantShift as IlluminantShift
from nacre.light.display import adapt_xyz as adapt_xyz
from nacre.light.display import adaptation_matrix as adaptation_matrix
from nacre.light.display import clip_to_srgb as clip_to_srgb
from nacre.light.display import illuminant_shift as illuminant_shift
from nacre.light.display import metamerism as metamerism
from nacre.light.display import outside_srgb as outside_srgb
from nacre.light.display import spectrum_to_rgb_linear as spectrum_to_rgb_linear
from nacre.light.display import spectrum_to_rgb_matrix as spectrum_to_rgb_matrix
from nacre.light.display import spectrum_to_srgb as spectrum_to_srgb
from nacre.light.display import swatch_hex as swatch_hex
from nacre.light.tristimulus import ILLUMINANTS as ILLUMINANTS
from nacre.light.tristimulus import OBSERVERS as OBSERVERS
from nacre.light.tristimulus import WAVELENGTH_RANGE_NM as WAVELENGTH_RANGE_NM
from nacre.light.tristimulus import Illuminant as Illuminant
from nacre.light.tristimulus import colour_step_nm as colour_step_nm
from nacre.light.tristimulus import default_wavelengths as default_wavelengths
from nacre.light.tristimulus import illuminant as illuminant
from nacre.light.tristimulus import lamp_lines_nm as lamp_lines_nm
from nacre.light.tristimulus import observer as observer
from nacre.light.tristimulus import smooth_weights as smooth_weights
from nacre.light.tristimulus import spans_colour as spans_colour
from nacre.light.tristimulus import spectrum_to_xyz as spectrum_to_xyz
from nacre.light.tristimulus import table_wavelengths_nm as table_wavelengths_nm
from nacre.light.tristimulus import white_xyz as white_xyz
from nacre.light.tristimulus import with_lamp_lines as with_lamp_lines
from nacre.light.tristimulus import xyz_weights as xyz_weights
