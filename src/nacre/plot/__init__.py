"""Publication figures, one column wide, with true material colours.

Each `*_figure` function takes a `Bsdf`, a `Spectrum` or plain arrays and returns a matplotlib `Figure`;
`save_figure` writes it as PNG, PDF or SVG with its provenance. `material_figure(material, kind)` takes the names of
`nacre plot --kind`. The first figure loads matplotlib.

Arrays that a family returns from `figure_data(kind)` (`title` is always optional):

| kind | arrays |
|---|---|
| field | `z_nm[z]`, `wavelengths_nm[l]`, `interfaces_nm[i]`, `s[z, l]` and `p[z, l]` or `intensity[z, l]`; optional `names[i + 1]`, `theta_deg` |
| colour-map | `thicknesses_nm[y]` (or `y[y]` with `y_label`), `angles_deg[x]`, `wavelengths_nm[l]`, `reflectance[y, x, l]` |
| structure | a stack: `names[medium]`, `thicknesses_nm[layer]`, `n[medium]`, `k[medium]`, optional `wavelength_nm`; a monolayer: `q[q]`, `sq[..., q]`, optional `labels`, `q_label`, `xy_um[point, 2]`, `radius_um` |
| platelet | `angles_deg[a]`, `wavelengths_nm[l]`, `reflectance[..., a, l]`, optional `transmittance[..., a, l]`, `names` |
| scattering | `theta_deg[t]` from forward to back, `s[..., t]`, `p[..., t]`, optional `wavelengths_nm[l]` (the leading axis), `decades` |
| microscope | `extent_um`, and `rgb[y, x, 3]` (linear), `spectra[y, x, l]` with `wavelengths_nm[l]`, or `intensity[y, x]`; optional `exposure` |
"""  # noqa: E501  (a table row is one line)

import lazy_loader

from nacre.core.lazy import make_callable

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

make_callable(__name__, "nacre.plot.material:plot_material")  # nacre.plot(material, "ribbon", "ribbon.png")
