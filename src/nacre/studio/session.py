"""One page's conversation with the server: the newest question is answered, one at a time.

The page keeps the recipe, the server nothing: a question holds the recipe's text and what was changed since, so a
server that was started anew goes on where the old one stopped.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor
from typing import Any

import numpy as np
from starlette.websockets import WebSocket, WebSocketDisconnect

from nacre.core.errors import NacreError
from nacre.light import ILLUMINANTS, delta_e_2000
from nacre.recipe.toml import parse_toml
from nacre.studio.appearance import Look, SupersededError, looks
from nacre.studio.edit import edited, line_of
from nacre.studio.folder import MAX_TEXT, Opened

MAX_MESSAGE = 2 * MAX_TEXT
MOST_LAB = 1e4
RESTING = 0.25  # seconds without a newer question after which a slow material is settled


class Session:
    """The socket of one page.

    A newer question replaces the one that waits, and makes the one that is being answered stop between its parts.
    """

    def __init__(self, socket: WebSocket, opened: Opened, workers: Executor) -> None:
        self._socket = socket
        self._opened = opened
        self._workers = workers
        self._waiting: dict[str, Any] | None = None
        self._came = asyncio.Event()
        self._is_gone = False

    async def run(self) -> None:
        """Talk until the page is closed."""
        await self._socket.accept()
        answering = asyncio.create_task(self._answer_all())
        try:
            while True:
                text = await self._socket.receive_text()
                if len(text) > MAX_MESSAGE:
                    break
                try:
                    question = json.loads(text)
                except (ValueError, RecursionError):
                    break
                if not isinstance(question, dict) or not isinstance(question.get("seq"), int):
                    break
                self._waiting = question
                self._came.set()
        except (WebSocketDisconnect, KeyError):
            pass
        finally:
            self._is_gone = True
            answering.cancel()
            with contextlib.suppress(asyncio.CancelledError, Exception):
                await answering
        with contextlib.suppress(RuntimeError):
            await self._socket.close(1008)

    async def _answer_all(self) -> None:
        while True:
            await self._came.wait()
            self._came.clear()
            question, self._waiting = self._waiting, None
            if question is not None:
                await self._answer(question)

    def _is_superseded(self) -> bool:
        return self._is_gone or self._waiting is not None

    async def _answer(self, question: Mapping[str, Any]) -> None:
        loop = asyncio.get_running_loop()
        answer = _Answer(question, self._opened, self._is_superseded)
        try:
            while True:
                # one job a look, from the text to the bytes: each hand-over would queue behind other pages' work
                sent = await loop.run_in_executor(self._workers, answer.next_look)
                if sent is None:
                    return
                await self._socket.send_bytes(sent)
                if answer.is_draft:
                    await self._rest()
        except SupersededError:
            return
        except NacreError as error:
            await self._tell(answer, str(error))
        except MemoryError:
            await self._tell(answer, f"{question.get('name', 'recipe')}: not enough memory for this recipe")
        except Exception as error:  # whatever it was: the page must hear of it, and the next question be answered
            what = f"this is a bug in nacre, please report it: {type(error).__name__}: {str(error)[:200]}"
            await self._tell(answer, what)

    async def _rest(self) -> None:
        """Wait until nothing new has come for a moment, so that a long solution is not begun in vain."""
        until = time.monotonic() + RESTING
        while time.monotonic() < until and not self._is_superseded():
            await asyncio.sleep(0.02)

    async def _tell(self, answer: _Answer, message: str) -> None:
        text = answer.text
        try:
            data = _plain(parse_toml(text, "recipe"))
        except NacreError:
            data = None
        told = {"seq": answer.seq, "text": text, "error": message, "line": line_of(text, message), "data": data}
        await self._socket.send_text(json.dumps(told))


class _Answer:
    """The looks that answer one question, packed; made in a thread of the workers.

    Attributes:
        seq: the question's number.
        text: the recipe's, with the changes written into it as soon as they are.
        is_draft: whether the look given last was one.
    """

    def __init__(self, question: Mapping[str, Any], opened: Opened, is_superseded: Callable[[], bool]) -> None:
        self.seq: int = question["seq"]
        self.text = str(question.get("text", ""))
        self.is_draft = False
        self._question = question
        self._opened = opened
        self._is_superseded = is_superseded
        self._looks = self._solved()

    def next_look(self) -> bytes | None:
        """Return the next look; None after the last one.

        Raises:
            NacreError: the recipe is wrong, or cannot be solved.
            SupersededError: a newer question has come.
        """
        return next(self._looks, None)

    def _solved(self) -> Iterator[bytes]:
        question = self._question
        name, lamp = str(question.get("name", "")), str(question.get("lamp", "D65"))
        self.text = _written(question, name, self.text)
        material = self._opened.material(self.text, name)
        told = {"seq": self.seq, "text": self.text, "data": _plain(material.data)}
        for look in looks(material, lamp if lamp in ILLUMINANTS else "D65", self._is_superseded):
            self.is_draft = look.is_draft
            yield look.packed(**told, **_difference(question.get("beside"), look))


def _written(question: Mapping[str, Any], name: str, text: str) -> str:
    """Return the recipe's text with the changes made since written into it."""
    if len(text) > MAX_TEXT:
        raise NacreError(f"{name}: a recipe of {len(text)} characters; at most {MAX_TEXT} are shown")
    edits = question.get("edits") or []
    if not isinstance(edits, list) or not all(isinstance(edit, dict) for edit in edits):
        raise NacreError(f"{name}: the changes are not a list")
    return edited(text, edits, name.rpartition("/")[2] or "recipe") if edits else text


def _difference(beside: Any, look: Look) -> dict[str, Any]:
    """Return how far a look is (CIEDE2000) from one that the page holds, given by its Lab `[lamp, angle, 3]`."""
    own = np.array([swatch["lab"] for swatch in look.swatches])
    try:
        given = np.array(beside, dtype=float)
    except (TypeError, ValueError):
        return {}
    if given.shape != own.shape or not np.isfinite(given).all() or np.abs(given).max() > MOST_LAB:
        return {}
    return {"difference": np.round(delta_e_2000(given, own), 2).tolist()}


def _plain(data: Any) -> Any:
    """Return a recipe's dictionary as JSON can hold it: dates and the like as their text, numbers finite."""
    return json.loads(json.dumps(data, default=str, allow_nan=True).replace("NaN", "null").replace("Infinity", "1e999"))
