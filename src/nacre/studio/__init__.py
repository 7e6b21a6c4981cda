"""The studio: a local web page that shows a recipe live while its parameters change.

`nacre.studio(material)` shows the object in a notebook.
"""

from nacre.core.lazy import make_callable

make_callable(__name__, "nacre.studio.notebook:show")  # nacre.studio(material)
