"""Figures, fit for a paper as they come out: one column wide, in the colours that a material really has.

Each `*_figure` function takes a `Bsdf`, a `Spectrum` or plain arrays and returns a matplotlib `Figure`;
`save_figure` writes it as PNG, PDF or SVG with its provenance. `material_figure(material, kind)` chooses by the
name that `nacre plot --kind` takes. matplotlib is loaded with the first figure.

What a family supplies through `figure_data(kind)`, as a dictionary of arrays (`title` is always optional):

| kind | arrays |
|---|---|
| field | `z_nm[z]`, `wavelengths_nm[l]`, `interfaces_nm[i]`, `s[z, l]` and `p[z, l]` or `intensity[z, l]`; optional `names[i + 1]`, `theta_deg` |
| colour-map | `thicknesses_nm[y]` (or `y[y]` with `y_label`), `angles_deg[x]`, `wavelengths_nm[l]`, `reflectance[y, x, l]` |
| structure | a stack: `names[medium]`, `thicknesses_nm[layer]`, `n[medium]`, `k[medium]`, optional `wavelength_nm`; a monolayer: `q[q]`, `sq[..., q]`, optional `labels`, `q_label`, `xy_um[point, 2]`, `radius_um` |
| platelet | `angles_deg[a]`, `wavelengths_nm[l]`, `reflectance[..., a, l]`, optional `transmittance[..., a, l]`, `names` |
| scattering | `theta_deg[t]` from forward to back, `s[..., t]`, `p[..., t]`, optional `wavelengths_nm[l]` (the leading axis), `decades` |
| microscope | `extent_um`, and `rgb[y, x, 3]` (linear), `spectra[y, x, l]` with `wavelengths_nm[l]`, or `intensity[y, x]`; optional `exposure` |
"""  # noqa: E501  (a table row is one line)

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from nacre.callable_module import make_callable

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Figure  # so that others name what they draw without matplotlib

    from nacre.plot.colours import chromaticity_figure, colour_map_figure
    from nacre.plot.directions import bsdf_slice_figure, lobe_figure, scattering_figure, slice_figure
    from nacre.plot.material import KINDS, data_figure, material_figure, save_index, save_material
    from nacre.plot.spectra import index_figure, ribbon_figure, spectrum_figure
    from nacre.plot.structures import field_figure, microscope_figure, platelet_figure, structure_figure
    from nacre.plot.style import house_style, new_figure, save_figure
    from nacre.plot.sweeps import gamut_figure, parallel_figure, sweep_map_figure
    from nacre.plot.tracks import Track, angle_tracks, number_tracks, tracks_figure

_LAZY = {
    "KINDS": "material",
    "Track": "tracks",
    "angle_tracks": "tracks",
    "bsdf_slice_figure": "directions",
    "chromaticity_figure": "colours",
    "colour_map_figure": "colours",
    "data_figure": "material",
    "field_figure": "structures",
    "gamut_figure": "sweeps",
    "house_style": "style",
    "index_figure": "spectra",
    "lobe_figure": "directions",
    "material_figure": "material",
    "microscope_figure": "structures",
    "new_figure": "style",
    "number_tracks": "tracks",
    "parallel_figure": "sweeps",
    "platelet_figure": "structures",
    "ribbon_figure": "spectra",
    "save_figure": "style",
    "save_index": "material",
    "save_material": "material",
    "scattering_figure": "directions",
    "slice_figure": "directions",
    "spectrum_figure": "spectra",
    "structure_figure": "structures",
    "sweep_map_figure": "sweeps",
    "tracks_figure": "tracks",
}

__all__ = [
    "KINDS",
    "Track",
    "angle_tracks",
    "bsdf_slice_figure",
    "chromaticity_figure",
    "colour_map_figure",
    "data_figure",
    "field_figure",
    "gamut_figure",
    "house_style",
    "index_figure",
    "lobe_figure",
    "material_figure",
    "microscope_figure",
    "new_figure",
    "number_tracks",
    "parallel_figure",
    "platelet_figure",
    "ribbon_figure",
    "save_figure",
    "save_index",
    "save_material",
    "scattering_figure",
    "slice_figure",
    "spectrum_figure",
    "structure_figure",
    "sweep_map_figure",
    "tracks_figure",
]


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        import importlib

        return getattr(importlib.import_module(f"nacre.plot.{_LAZY[name]}"), name)
    raise AttributeError(f"module 'nacre.plot' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted(__all__)


make_callable(__name__, "nacre.api:plot_material")  # nacre.plot(material, "ribbon", "ribbon.png")
