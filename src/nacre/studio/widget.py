"""The studio's object as a Jupyter widget; the only file that imports anywidget."""

from __future__ import annotations

import functools
from importlib.resources import files
from typing import Any

import anywidget

from nacre.material.material import Material, MaterialLike, as_material
from nacre.studio.answers import Answers
from nacre.studio.bundle import bundle


@functools.cache
def _style() -> str:
    return files("nacre.studio").joinpath("widget.css").read_text(encoding="utf-8")


class StudioWidget(anywidget.AnyWidget):
    """A material in a notebook; see `nacre.studio.notebook.show`."""

    _esm = bundle("widget.js")
    _css = _style()

    def __init__(self, material: Material, lamp: str) -> None:
        """Show a material in the light of a known lamp; `show` checks both, as half a widget cannot be closed."""
        self._answers = Answers(self._tell, lamp)
        super().__init__()
        self.on_msg(self._hear)
        self._answers.show(material)

    @property
    def material(self) -> Material:
        """What is shown; setting it shows another one (also by path or by the name of an example)."""
        return self._answers.material

    @material.setter
    def material(self, other: MaterialLike) -> None:
        self._answers.show(as_material(other))

    def close(self) -> None:
        """Take the widget away, and end what is being solved for it."""
        self._answers.stop()
        super().close()

    def _tell(self, content: dict[str, Any], *buffers: bytes) -> None:
        self.send(content, buffers=list(buffers))

    def _hear(self, _: Any, content: Any, buffers: Any) -> None:
        self._answers.hear(content)
