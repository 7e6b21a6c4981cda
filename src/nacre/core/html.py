"""Self-contained HTML pages from jinja2 templates with one layout."""

from __future__ import annotations

import base64
import functools
import io
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import jinja2


@functools.cache
def _environment() -> jinja2.Environment:
    import jinja2

    loader = jinja2.PackageLoader("nacre.core")
    environment = jinja2.Environment(
        loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
    environment.filters["zip"] = zip
    environment.globals["infinity"] = float("inf")
    return environment


def render_page(template: str, **values: Any) -> str:
    """Return a page from a template in the folder `templates`; text values are escaped.

    Args:
        template: file name.
        values: template variables; `title` is the page title.
    """
    return _environment().get_template(template).render(values)


def png_bytes(pixels: NDArray[np.uint8], **options: Any) -> bytes:
    """Return a picture `[row, column, channel]` as PNG; the options are those of Pillow."""
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "PNG", **options)
    return stream.getvalue()


def png_uri(png: bytes) -> str:
    """Return PNG bytes as a data URI."""
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")
