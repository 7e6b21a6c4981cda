"""`nacre.studio(material)`: the studio's object in a notebook cell, without server, token or network.

Messages to the view: `room` (surroundings and shader tables, sent on request), `appearance` (`Appearance.packed`) and
`error`. Messages from the view: `ready`, and `vary` with a slider's path and value.
"""

import functools
import math
import posixpath
import re
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from nacre.core.errors import NacreError, did_you_mean
from nacre.formats.lut import template
from nacre.light import ILLUMINANTS
from nacre.material.material import Material, MaterialLike, as_material
from nacre.studio.appearance import appearances
from nacre.studio.subprocess_jobs import LatestOnlyWorker, failure_text
from nacre.studio.surroundings import ALPHAS, ROWS, blurred_surroundings

TABLES = "table.glsl"
MAX_SLIDERS = 6
SLIDER_FACTOR = 2.0  # slider maximum relative to the recipe's value
OPTICAL_CONSTANTS = ("n", "k")  # without sliders

IMPORT = re.compile(r'^import \{ (\w+(?:, \w+)*) \} from "(\.[\w./-]+\.js)";$', re.MULTILINE)
EXPORT = re.compile(r"^export (const|class|function|async function) (\w+)", re.MULTILINE)
UNSUPPORTED = re.compile(r"^\s*(?:import|export)\b.*|\bimport\s*[(.].*", re.MULTILINE)


def show(material: MaterialLike, *, illuminant: str = "D65") -> Any:
    """Return a widget for a material: sphere, colour over the angle, reflectance, sliders.

    `widget.material` is the material with the sliders' values; setting it shows another one. Materials are solved
    in a thread, slow ones first as a draft.

    Args:
        material: a material, a path (recipe, `.nacre` file, design folder) or an example name.
        illuminant: lamp.

    Raises:
        NacreError: anywidget is not installed, the material cannot be loaded, or the lamp is not known.

    Example: `nacre.studio("bragg-mirror")`.
    """
    try:
        widget = widget_class()
    except ImportError:
        raise NacreError("nacre.studio in a notebook needs anywidget: pip install 'nacre[notebook]'") from None
    if illuminant not in ILLUMINANTS:
        hint = did_you_mean(str(illuminant), ILLUMINANTS)
        raise NacreError(f'illuminant "{str(illuminant)[:40]}" is not known.{hint} Lamps: {", ".join(ILLUMINANTS)}')
    return widget(as_material(material), illuminant)


def sliders(material: Material) -> list[dict[str, Any]]:
    """Return `path`, `value` and `max` for the first parameters, one slider each."""
    return [
        {"path": path, "value": value, "max": SLIDER_FACTOR * value}
        for path, value in material.parameters.items()
        if value > 0 and math.isfinite(value) and path.rpartition(".")[2] not in OPTICAL_CONSTANTS
    ][:MAX_SLIDERS]


@dataclass(frozen=True)
class _Request:
    number: int
    material: Material
    header: dict[str, Any]


class NotebookView:
    """Solves the newest material and sends its appearance to the view.

    Attributes:
        material: the newest one.
        worker: solves it.
    """

    material: Material

    def __init__(self, send: Callable[..., None], lamp: str) -> None:
        """Create a view; `send` sends a message with its buffers and is called from threads, one call at a time."""
        self._send = send
        self._lamp = lamp
        self.worker = LatestOnlyWorker(self._answer, self._send_packed, self._fail)
        self._number = 0
        self._shown = 0  # counts materials with their own sliders
        self._sliders: list[dict[str, Any]] = []
        self._last: bytes | None = None

    def show(self, material: Material) -> None:
        """Show a material with its own sliders; return at once."""
        self._shown += 1
        self._sliders = sliders(material)
        self._solve(material)

    def receive(self, content: Any) -> None:
        """Handle a message from the view; invalid ones are ignored."""
        if not isinstance(content, dict):
            return
        if content.get("kind") == "ready":
            threading.Thread(target=self.send_room, daemon=True, name="nacre-studio-room").start()
        elif content.get("kind") == "vary":
            path, value = str(content.get("path")), content.get("value")
            if path in [slider["path"] for slider in self._sliders] and isinstance(value, int | float):
                try:
                    self._solve(self.material.vary({path: float(value)}))
                except NacreError as error:
                    with self.worker.sending:
                        self._send({"kind": "error", "message": str(error)})

    def send_room(self) -> None:
        """Send a new view the surroundings, the shader tables and the current appearance."""
        room = blurred_surroundings().layers.astype("<f4").tobytes()
        size = {"rows": ROWS, "columns": 2 * ROWS, "alphas": ALPHAS}
        with self.worker.sending:
            self._send({"kind": "room", "tables": template(TABLES), **size}, room)
            if self._last is not None:
                self._send_packed(self._last)

    def _solve(self, material: Material) -> None:
        self.material = material
        self._number += 1
        numbers = [{**one, "value": material.parameters[one["path"]]} for one in self._sliders]
        header = {"seq": self._number, "name": material.name, "shown": self._shown, "numbers": numbers}
        self.worker.submit(_Request(self._number, material, header))

    def _answer(self, request: _Request, is_superseded: Callable[[], bool]) -> Iterator[tuple[bytes, bool]]:
        for appearance in appearances(request.material, self._lamp, is_superseded):
            yield appearance.packed(**request.header), appearance.is_draft

    def _send_packed(self, packed: bytes) -> None:
        self._last = packed
        self._send({"kind": "appearance"}, packed)

    def _fail(self, request: _Request, error: Exception) -> None:
        self._send({"kind": "error", "message": failure_text(error, request.material.name)})


@functools.cache
def widget_class() -> Any:
    """Return the Jupyter widget class.

    Raises:
        ImportError: anywidget is not installed.
    """
    import anywidget

    class StudioWidget(anywidget.AnyWidget):
        """A material in a notebook; see `show`."""

        _esm = bundle("widget.js")
        _css = files("nacre.studio").joinpath("widget.css").read_text(encoding="utf-8")

        def __init__(self, material: Material, lamp: str) -> None:
            self.view = NotebookView(lambda content, *buffers: self.send(content, buffers=list(buffers)), lamp)
            super().__init__()
            self.on_msg(lambda _, content, buffers: self.view.receive(content))
            self.view.show(material)

        @property
        def material(self) -> Material:
            """The current material; setting it shows another one (also by path or example name)."""
            return self.view.material

        @material.setter
        def material(self, other: MaterialLike) -> None:
            self.view.show(as_material(other))

        def close(self) -> None:
            """Remove the widget and cancel its solution."""
            self.view.worker.cancel()
            super().close()

    return StudioWidget


def bundle(entry: str) -> str:
    """Return a JavaScript module with its imports as one module, without build step.

    Each module becomes a function that runs once and returns its exports, therefore names of different modules
    cannot clash. Only import and export forms used by the studio are supported. The default export contains the entry's
    exports.

    Args:
        entry: path relative to the studio's folder, such as "widget.js".

    Raises:
        ValueError: an unsupported import or export, a circular import, or an unknown name.
    """
    modules: dict[str, tuple[str, list[str]]] = {}  # dependencies first
    _add(entry, modules, ())
    return "\n".join([*(text for text, _ in modules.values()), f"export default {_variable(entry)};\n"])


def _add(path: str, modules: dict[str, tuple[str, list[str]]], importers: tuple[str, ...]) -> None:
    if path in importers:
        raise ValueError(f"modules import each other: {' -> '.join([*importers, path])}")
    if path in modules:
        return
    source = files("nacre.studio").joinpath(path).read_text(encoding="utf-8")

    def imported(match: re.Match[str]) -> str:
        names, other = match[1], posixpath.normpath(posixpath.join(posixpath.dirname(path), match[2]))
        _add(other, modules, (*importers, path))
        missing = [name for name in names.split(", ") if name not in modules[other][1]]
        if missing:
            raise ValueError(f"{path}: {other} does not export {', '.join(missing)}")
        return f"const {{ {names} }} = {_variable(other)};"

    exports = [match[2] for match in EXPORT.finditer(source)]
    text = EXPORT.sub(r"\1 \2", IMPORT.sub(imported, source))
    if unsupported := UNSUPPORTED.search(text):
        raise ValueError(f"{path}: {unsupported[0].strip()[:60]} is not supported")
    modules[path] = (
        f"const {_variable(path)} = (() => {{\n{text}\nreturn {{ {', '.join(exports)} }};\n}})();",
        exports,
    )


def _variable(path: str) -> str:
    return "_" + re.sub(r"\W", "_", path)
