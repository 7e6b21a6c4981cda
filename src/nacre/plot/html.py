"""Figures as data URIs for HTML pages."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

from nacre.core.html import png_uri

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 170


def data_uri(figure: Figure, dpi: int) -> str:
    """Return a figure as a PNG data URI."""
    from nacre.plot.style import house_style  # imports matplotlib

    stream = io.BytesIO()
    with house_style():
        figure.savefig(stream, format="png", dpi=dpi)
    return png_uri(stream.getvalue())
