"""What the film scripts share: materials, colours, pictures, and the table."""

from __future__ import annotations

from typing import Any

import numpy as np

from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.light import spectrum_to_srgb, spectrum_to_xyz, xyz_to_lab
from nacre.material.material import Material, material

HUES = (  # CIELAB hue angle at which each name begins, measured on spectra of one reflectance peak
    (0.0, "red"),
    (45.0, "orange"),
    (75.0, "yellow"),
    (110.0, "green"),
    (200.0, "blue"),
    (285.0, "purple"),
    (340.0, "red"),
)


def film(**recipe: Any) -> Material:
    """Return a film of a recipe's keys."""
    return material({"family": "film", **recipe})


def reflectance(made: Material, theta_deg: float | Array, wavelengths_nm: Array) -> Array:
    """Specular reflectance `[angle, wavelength]` of the film's stack."""
    values = made.spectrum(np.radians(np.atleast_1d(theta_deg)), wavelengths_nm).specular_reflectance
    assert values is not None
    return values


def srgb(values: Array, wavelengths_nm: Array, gain: float = 1.0) -> Array:
    """Displayable colours of spectra, brightened by `gain`."""
    return np.asarray(spectrum_to_srgb(np.asarray(values) * gain, wavelengths_nm))


def hue_deg(values: Array, wavelengths_nm: Array) -> float:
    """CIELAB hue angle in degrees, under D65."""
    lab = np.asarray(xyz_to_lab(spectrum_to_xyz(values, wavelengths_nm)))
    return float(np.degrees(np.arctan2(lab[2], lab[1])) % 360.0)


def hue_name(values: Array, wavelengths_nm: Array) -> str:
    """The name of a spectrum's hue."""
    angle = hue_deg(values, wavelengths_nm)
    return [name for start, name in HUES if angle >= start][-1]


def picture(made: Material, scene: str = "sphere", size: int = 160, spp: int = 32, **settings: Any) -> Any:
    """Render a small picture `[row, column, 3]`, or return None on a machine that cannot."""
    try:
        import nacre.render as render

        return render.render(made, scene, size=(size, size), spp=spp, progress=False, **settings).srgb8
    except (NacreError, ImportError) as error:
        print(f"no picture: {error}", flush=True)
        return None


def show(axis: Any, image: Any, title: str) -> None:
    """Draw a picture, or say that there is none."""
    axis.set_axis_off()
    axis.set_title(title, fontsize=8)
    if image is None:
        axis.text(0.5, 0.5, "not rendered here", ha="center", va="center", fontsize=8)
    else:
        axis.imshow(image)


def canvas(rows: int, columns: int, width: float = 7.0, height: float | None = None) -> tuple[Any, Any]:
    """Return figure and axes without a window, `axes[row, column]`."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    size = (width, height if height is not None else width * rows / columns)
    return pyplot.subplots(rows, columns, figsize=size, squeeze=False, constrained_layout=True)
