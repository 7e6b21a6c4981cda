"""`nacre.studio(material)`: the studio's object in a cell of Jupyter or VS Code, without server, token or network."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nacre.core.errors import NacreError
from nacre.material.material import MaterialLike, as_material
from nacre.studio.answers import checked_lamp

if TYPE_CHECKING:
    from nacre.studio.widget import StudioWidget


def show(material: MaterialLike, *, illuminant: str = "D65") -> StudioWidget:
    """Return a widget that shows a material: the sphere, colour over the angle, reflectance, sliders.

    Setting `widget.material` shows another one; after a slider was moved it is the material with that number. It is
    solved in a thread, first as a draft where it takes long, so the notebook stays free.

    Args:
        material: a material, or the path of a recipe, `.nacre` file, design folder or the name of an example.
        illuminant: lamp of the studio.

    Raises:
        NacreError: anywidget is not installed, the material cannot be loaded, or the lamp is not known.

    Example: `nacre.studio("bragg-mirror")`.
    """
    try:
        import anywidget  # noqa: F401  (the extra that not everybody has)
    except ImportError:
        raise NacreError("nacre.studio in a notebook needs anywidget: pip install 'nacre[notebook]'") from None
    from nacre.studio.widget import StudioWidget

    return StudioWidget(as_material(material), checked_lamp(illuminant))
