"""Figure style and storage.

Figures are created without pyplot, therefore drawing changes no global state and is thread-safe.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from nacre import light
from nacre._version import __version__
from nacre.core.arrays import Array
from nacre.core.errors import NacreError
from nacre.core.files import atomic_path
from nacre.core.html import png_uri

if TYPE_CHECKING:
    from matplotlib.axes import Axes


COLUMN_IN = 3.46  # 88 mm, a journal's column
WIDE_IN = 5.4
SHEET_IN = 7.2  # a page's width
INK, FAINT = "#222222", "#9a9a9a"
# Okabe and Ito 2008: distinguishable for colour-blind readers
LINES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#222222")
SUFFIXES = (".png", ".pdf", ".svg")
MIN_LUMINANCE = 0.18  # darker swatches are brightened; the factor is printed

STYLE: dict[str, Any] = {
    "font.family": "sans-serif", "font.sans-serif": ["DejaVu Sans"], "font.size": 7.5,
    "axes.labelsize": 8, "axes.titlesize": 8, "axes.titleweight": "regular", "axes.linewidth": 0.6,
    "axes.edgecolor": INK, "axes.labelcolor": INK, "axes.spines.top": False, "axes.spines.right": False,
    "axes.axisbelow": True, "text.color": INK, "xtick.color": INK, "ytick.color": INK,
    "xtick.labelsize": 7, "ytick.labelsize": 7, "xtick.major.width": 0.6, "ytick.major.width": 0.6,
    "xtick.major.size": 2.5, "ytick.major.size": 2.5, "xtick.direction": "out", "ytick.direction": "out",
    "legend.fontsize": 7, "legend.frameon": False, "lines.linewidth": 1.2, "lines.solid_capstyle": "round",
    "grid.color": "#e4e4e4", "grid.linewidth": 0.5, "figure.facecolor": "white", "savefig.facecolor": "white",
    "savefig.dpi": 300, "pdf.fonttype": 42, "svg.fonttype": "none",
    "image.interpolation": "nearest", "image.resample": True,
}  # fmt: skip


@contextmanager
def house_style() -> Iterator[None]:
    """Context with matplotlib's defaults plus `STYLE`, independent of the user's settings."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        settings: Any = matplotlib.rcParams  # its stubs list every key as a literal
        settings.update(STYLE)
        yield


def new_figure(width_in: float, height_in: float) -> Figure:
    """Return an empty figure with a canvas and constrained layout."""
    figure = Figure(figsize=(width_in, height_in))
    figure.set_layout_engine("constrained", w_pad=0.03, h_pad=0.03, wspace=0.03, hspace=0.04)
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: Figure, path: str | Path, provenance: Mapping[str, Any] | None = None) -> None:
    """Write a figure as PNG (300 dpi), PDF or SVG atomically, with its provenance.

    PNG carries the provenance as JSON in the text chunk `nacre`, PDF in its subject, SVG in its description.

    Raises:
        NacreError: another suffix, or the file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise NacreError(f"{path}: a figure's suffix must be one of {', '.join(SUFFIXES)}")
    stated = json.dumps({"nacre": __version__, **(provenance or {})}, default=str, sort_keys=True)
    software = f"nacre {__version__}"
    metadata: dict[str, dict[str, Any]] = {
        ".png": {"Software": software, "nacre": stated},
        ".pdf": {"Creator": software, "Subject": stated, "CreationDate": None},
        ".svg": {"Creator": software, "Description": stated, "Date": None},
    }
    with house_style(), atomic_path(path) as temporary:
        figure.savefig(temporary, format=path.suffix[1:].lower(), metadata=metadata[path.suffix.lower()])


def angle_colours(count: int) -> list[tuple[float, float, float, float]]:
    """Return line colours for an ordered set (angles, thicknesses): a uniform ramp, dark first."""
    ramp = matplotlib.colormaps["viridis"]
    return [ramp(0.85 * i / max(count - 1, 1)) for i in range(count)]


def exposure_of(xyz: Array) -> float:
    """Return the brightening factor of colours: 1, or a round number for dark ones."""
    brightest = float(np.max(xyz[..., 1], initial=0.0))
    if brightest <= 0.0 or brightest >= MIN_LUMINANCE:
        return 1.0
    wanted = 0.45 / brightest
    decade = 10.0 ** np.floor(np.log10(wanted))
    return float(decade * max(s for s in (1, 2, 5) if s * decade <= wanted * (1 + 1e-9)))


def shown_colours(
    values: ArrayLike, wavelengths_nm: ArrayLike, illuminant: str = "D65", exposure: float | None = None
) -> tuple[Array, float, int]:
    """Return sRGB for spectra `[..., wavelength]`, the exposure, and the number of clipped colours."""
    spectra = np.asarray(values, dtype=float)
    if exposure is None:
        exposure = exposure_of(light.spectrum_to_xyz(spectra, wavelengths_nm, illuminant))
    clipped = light.clip_to_srgb(exposure * light.spectrum_to_rgb_linear(spectra, wavelengths_nm, illuminant))
    return light.srgb_encode(clipped.rgb), exposure, clipped.count


def remark(illuminant: str | None, exposure: float = 1.0, clipped: int = 0, total: int = 0) -> str:
    """Return the small print: lamp, exposure, colour count outside sRGB."""
    adapted = "" if illuminant == "D65" else ", eye adapted to it"
    parts = [f"illuminant {illuminant}{adapted}"] if illuminant else []
    if exposure != 1.0:
        parts.append(f"shown {exposure:g}\u00d7 brighter")
    if clipped:
        parts.append(f"{clipped} of {total} colours outside sRGB, chroma lowered")
    return "; ".join(parts)


def small_print(figure: Figure, text: str) -> None:
    """Write the small print below a figure."""
    if text:
        figure.supxlabel(text, fontsize=5.8, color="#6a6a6a", x=0.995, ha="right")


def panel_title(axes: Axes, text: str) -> None:
    """Write a panel's title at its left edge."""
    axes.set_title(text, loc="left", pad=3)


def spectral_strip(axes: Axes, low_nm: float, high_nm: float, height: float = 0.025) -> None:
    """Draw the spectral colours above a wavelength axis, fading with the eye's sensitivity."""
    nm = np.arange(max(low_nm, 380.0), min(high_nm, 720.0) + 1.0)
    if len(nm) < 2:
        return
    matching = np.stack([np.interp(nm, light.table_wavelengths_nm(), c) for c in light.observer().T], axis=-1)
    # spectral colours lie outside sRGB: cut negative values and use full brightness
    rgb = np.maximum(light.xyz_to_srgb_linear(matching), 0.0)
    rgb /= rgb.max(axis=-1, keepdims=True)
    sight = np.clip(np.minimum((nm - 385.0) / 45.0, (715.0 - nm) / 60.0), 0.0, 1.0)[:, None]
    pixels = (0.18 + 0.82 * light.srgb_encode(rgb)) * sight + (1.0 - sight)
    strip = axes.inset_axes((0.0, 0.0, 1.0, height), transform=axes.transAxes, zorder=0.5)
    strip.imshow(pixels[None], extent=(nm[0], nm[-1], 0, 1), aspect="auto", interpolation="bilinear")
    strip.set_xlim(*axes.get_xlim())
    strip.axis("off")


def cell_edges(centres: Array) -> Array:
    """Return cell edges around ascending centres; the outer edges are the outer centres."""
    middle = 0.5 * (centres[1:] + centres[:-1])
    return np.concatenate([[centres[0]], middle, [centres[-1]]])


def need(data: Mapping[str, Any], kind: str, *names: str) -> list[Array]:
    """Return named arrays of the figure data.

    Raises:
        NacreError: an array is missing or has a value that is not finite.
    """
    arrays = []
    for name in names:
        if name not in data:
            raise NacreError(f"figure {kind}: {name} is missing; given are {', '.join(data) or 'none'}")
        array = np.asarray(data[name], dtype=float)
        if array.size == 0 or not np.isfinite(array).all():
            raise NacreError(f"figure {kind}: {name} is empty or holds a value that is not finite")
        arrays.append(array)
    return arrays


# Figures as data URIs for HTML pages.

DPI = 170


def data_uri(figure: Figure, dpi: int) -> str:
    """Return a figure as a PNG data URI."""
    stream = io.BytesIO()
    with house_style():
        figure.savefig(stream, format="png", dpi=dpi)
    return png_uri(stream.getvalue())
