"""What a notebook's view of a material is told: the newest material's looks, solved in a thread, never an old one.

Messages to the view: `room` (the light around the object and the shaders' tables, sent to whoever asks), `look`
(`Look.packed`) and `error`. From the view: `ready` and `vary`, a slider's path and value.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import Any

from nacre.core.errors import NacreError, did_you_mean
from nacre.formats.lut.write import template
from nacre.light import ILLUMINANTS
from nacre.material.material import Material
from nacre.studio.appearance import SupersededError, looks
from nacre.studio.surroundings import ALPHAS, ROWS, blurred_surround

TABLES = "table.glsl"
RESTING_S = 0.25  # without a newer material, after which a slow one is settled
MOST_SLIDERS = 6
SPAN = 2.0  # a slider ends at this many times its number
OF_OPTICS = ("n", "k")  # constants of a medium are seldom what one turns

Tell = Callable[..., None]


def checked_lamp(illuminant: str) -> str:
    """Return the name of a lamp.

    Raises:
        NacreError: it is not known.
    """
    if illuminant not in ILLUMINANTS:
        hint = did_you_mean(str(illuminant), ILLUMINANTS)
        raise NacreError(f'illuminant "{str(illuminant)[:40]}" is not known.{hint} Lamps: {", ".join(ILLUMINANTS)}')
    return illuminant


def sliders(material: Material) -> list[dict[str, Any]]:
    """Return the first numbers of a recipe that a slider can turn: `path`, `value`, `most`."""
    return [
        {"path": path, "value": value, "most": SPAN * value}
        for path, value in material.parameters.items()
        if value > 0 and math.isfinite(value) and path.rpartition(".")[2] not in OF_OPTICS
    ][:MOST_SLIDERS]


class Answers:
    """Solves the newest material and tells its looks.

    Attributes:
        material: the newest one.
    """

    material: Material

    def __init__(self, tell: Tell, lamp: str) -> None:
        """Args: tell: sends a message with its buffers; called from threads, one at a time. lamp: of the studio."""
        self._tell = tell
        self._lamp = lamp
        self._changed = threading.Condition()
        self._telling = threading.Lock()
        self._seq = 0
        self._given = 0  # of the material that the sliders are made for
        self._sliders: list[dict[str, Any]] = []
        self._waiting = False
        self._thread: threading.Thread | None = None
        self._last: tuple[dict[str, Any], bytes] | None = None

    def show(self, material: Material) -> None:
        """Show a material, with sliders of its own; return at once."""
        with self._changed:
            self._given += 1
            self._sliders = sliders(material)
        self._solve(material)

    def hear(self, content: Any) -> None:
        """Answer a message of the view; one that makes no sense is left alone."""
        if not isinstance(content, dict):
            return
        if content.get("kind") == "ready":
            threading.Thread(target=self._furnish, daemon=True, name="nacre-studio-room").start()
        elif content.get("kind") == "vary":
            path, value = str(content.get("path")), content.get("value")
            if path in [slider["path"] for slider in self._sliders] and isinstance(value, int | float):
                try:
                    self._solve(self.material.vary({path: float(value)}))
                except NacreError as error:
                    self._say(str(error))

    def stop(self) -> None:
        """Give up what is being solved."""
        with self._changed:
            self._seq += 1
            self._waiting = False
            self._changed.notify_all()

    def wait(self, seconds: float) -> bool:
        """Wait until all is settled; return whether it is."""
        with self._changed:
            return self._changed.wait_for(lambda: self._thread is None, seconds)

    def _solve(self, material: Material) -> None:
        with self._changed:
            self.material = material
            self._seq += 1
            self._waiting = True
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, daemon=True, name="nacre-studio")
                self._thread.start()
            self._changed.notify_all()

    def _work(self) -> None:
        while True:
            with self._changed:
                if not self._waiting:
                    self._thread = None
                    self._changed.notify_all()
                    return
                self._waiting = False
                seq, material = self._seq, self.material
                told = {"seq": seq, "name": material.name, "given": self._given}
                told["numbers"] = [{**one, "value": material.parameters[one["path"]]} for one in self._sliders]
            try:
                self._answer(seq, material, told)
            except SupersededError:
                continue
            except NacreError as error:
                self._say(str(error))
            except MemoryError:
                self._say(f"{material.name}: not enough memory for this recipe")
            except Exception as error:  # whatever it was: it must be seen, and the next material be answered
                what = f"{type(error).__name__}: {str(error)[:200]}"
                self._say(f"this is a bug in nacre, please report it: {what}")

    def _answer(self, seq: int, material: Material, told: dict[str, Any]) -> None:
        is_superseded = lambda: self._seq != seq
        for look in looks(material, self._lamp, is_superseded):
            with self._telling:
                if is_superseded():
                    raise SupersededError
                self._last = {"kind": "look"}, look.packed(**told)
                self._tell(self._last[0], self._last[1])
            if look.is_draft:
                with self._changed:
                    if self._changed.wait_for(is_superseded, RESTING_S):
                        raise SupersededError

    def _furnish(self) -> None:
        """Tell a view that has just come all that it needs."""
        room = blurred_surround().layers.astype("<f4").tobytes()
        size = {"rows": ROWS, "columns": 2 * ROWS, "alphas": ALPHAS}
        with self._telling:
            self._tell({"kind": "room", "tables": template(TABLES), **size}, room)
            if self._last is not None:
                self._tell(*self._last)

    def _say(self, message: str) -> None:
        with self._telling:
            self._tell({"kind": "error", "message": message})
