"""The studio: a page on the user's own machine on which a recipe is turned like a knob and seen at once.

`nacre.studio(material)` shows its object in a notebook.
"""

from nacre.core.lazy import make_callable

make_callable(__name__, "nacre.studio.notebook:show")  # nacre.studio(material)
