"""Pages of HTML that need nothing else: their frame, and figures and pictures inside them."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 170  # of sheets on a page


def framed(name: str, body: Sequence[str]) -> str:
    """Return a whole page of its parts."""
    return _PAGE.replace("TITLE", html.escape(name)).replace("BODY", "\n".join(body))


_PAGE = """<!doctype html><html lang="en"><head><meta charset="utf-8"><title>nacre: TITLE</title><style>
body{font:15px/1.5 system-ui,sans-serif;max-width:1180px;margin:2em auto;padding:0 1em;color:#222}
table{border-collapse:collapse;margin:.6em 0}td,th{padding:3px 14px 3px 0;border-bottom:1px solid #ddd;text-align:left}
.pair{display:inline-block;width:84px;height:24px;border:1px solid #222;vertical-align:middle}
.pair i{display:inline-block;width:42px;height:24px}.good{background:#e4f3e4;padding:8px 12px}
.far{background:#fff2cc;padding:8px 12px}img,svg{max-width:100%}
h2{margin-top:1.6em;border-top:1px solid #ccc;padding-top:.6em}
.small{color:#667;font-size:13px}
</style></head><body>
BODY
</body></html>
"""


def data_uri(figure: Figure, dpi: int) -> str:
    """Return a figure as a PNG data URI."""
    from nacre.plot.style import house_style  # with matplotlib, which a page without figures need not load

    stream = io.BytesIO()
    with house_style():
        figure.savefig(stream, format="png", dpi=dpi)
    return png_uri(stream.getvalue())


def png_uri(png: bytes) -> str:
    """Return the bytes of a PNG as a data URI."""
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")
