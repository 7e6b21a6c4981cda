"""Index page of a folder of colour tables: files, errors, pictures, closures and how to bind them."""

from __future__ import annotations

from nacre._version import __version__
from nacre.core.html import render_page
from nacre.formats.lut.table import LightTable


def page_text(table: LightTable) -> str:
    """Return the index page as HTML; it refers only to the pictures in its folder."""
    bound = [f"nacre{name.capitalize()}" for name in ("facet", "loss", "exchange", "lobe") if name in table.pictures]
    return render_page(
        "lut.html",
        title=table.name,
        table=table,
        version=__version__,
        has_lobe="lobe" in table.pictures or (table.facets is not None and table.facets.alpha[0] > 0),
        bound=bound,
        recipe=str(table.provenance.get("recipe", "")),
    )
