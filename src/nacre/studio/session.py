"""A page's WebSocket session: the newest request is answered.

The server is stateless: each request carries the recipe's text and the edits since, therefore a restarted server
continues previous sessions.
"""

import asyncio
import contextlib
import json
import math
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from starlette.websockets import WebSocket, WebSocketDisconnect

from nacre.core.errors import NacreError
from nacre.light import ILLUMINANTS, delta_e_2000
from nacre.recipe.toml import parse_toml
from nacre.studio.appearance import Appearance, appearances
from nacre.studio.edit import edited, line_of
from nacre.studio.folder import MAX_TEXT, OpenedFolder, read_incidence
from nacre.studio.measured import computed_psi_delta
from nacre.studio.subprocess_jobs import LatestOnlyWorker, failure_text

MAX_MESSAGE = 2 * MAX_TEXT
MAX_LAB = 1e4


@dataclass
class PageRequest:
    """A request from the page.

    Attributes:
        body: its JSON object.
        text: the recipe; the edits are applied to it first.
    """

    body: Mapping[str, Any]
    text: str

    @property
    def name(self) -> str:
        """Recipe name."""
        return str(self.body.get("name", ""))


class Session:
    """A page's socket. A newer request replaces the waiting one and interrupts the one in progress."""

    def __init__(self, socket: WebSocket, opened: OpenedFolder, slot: threading.Semaphore) -> None:
        self._socket = socket
        self._opened = opened
        self._loop = asyncio.get_running_loop()
        self._worker = LatestOnlyWorker(self._answer, self._send, self._fail, slot, drops_superseded=False)

    async def run(self) -> None:
        """Answer requests until the page is closed or sends an invalid message."""
        await self._socket.accept()
        try:
            while (body := _message(await self._socket.receive_text())) is not None:
                self._worker.submit(PageRequest(body, str(body.get("text", ""))))
        except (WebSocketDisconnect, KeyError):
            pass
        finally:
            self._worker.cancel()
        with contextlib.suppress(RuntimeError):
            await self._socket.close(1008)

    def _answer(self, request: PageRequest, is_superseded: Callable[[], bool]) -> Iterator[tuple[bytes, bool]]:
        request.text = _with_edits(request)
        material = self._opened.material(request.text, request.name)
        header = {"seq": request.body["seq"], "text": request.text, "data": json_data(material.data)}
        lamp = str(request.body.get("lamp", "D65"))
        lamp = lamp if lamp in ILLUMINANTS else "D65"
        for found in appearances(material, lamp, is_superseded, read_incidence(request.body)):
            beside = (
                {} if found.is_draft else {"psi_delta": computed_psi_delta(material, request.body.get("ellipsometry"))}
            )
            compared = _difference(request.body.get("compared_lab"), found)
            yield found.packed(**header, **beside, **compared), found.is_draft

    def _fail(self, request: PageRequest, error: Exception) -> None:
        message = failure_text(error, request.name or "recipe")
        try:
            data = json_data(parse_toml(request.text, "recipe"))
        except NacreError:
            data = None
        self._send(json.dumps({
            "seq": request.body["seq"], "text": request.text, "error": message, "data": data,
            "line": line_of(request.text, message),
        }))  # fmt: skip

    def _send(self, message: bytes | str) -> None:
        """Send a message from the worker's thread; a closed socket ends the answer."""
        send = self._socket.send_bytes(message) if isinstance(message, bytes) else self._socket.send_text(message)
        with contextlib.suppress(RuntimeError, WebSocketDisconnect):
            asyncio.run_coroutine_threadsafe(send, self._loop).result()


def _message(text: str) -> dict[str, Any] | None:
    """Return a valid request, else None."""
    if len(text) > MAX_MESSAGE:
        return None
    try:
        body = json.loads(text)
    except (ValueError, RecursionError):
        return None
    return body if isinstance(body, dict) and isinstance(body.get("seq"), int) else None


def _with_edits(request: PageRequest) -> str:
    """Return the recipe's text with the page's edits applied."""
    if len(request.text) > MAX_TEXT:
        raise NacreError(f"{request.name}: a recipe of {len(request.text)} characters; at most {MAX_TEXT} are shown")
    edits = request.body.get("edits") or []
    if not isinstance(edits, list) or not all(isinstance(edit, dict) for edit in edits):
        raise NacreError(f"{request.name}: the edits are not a list")
    return edited(request.text, edits, request.name.rpartition("/")[2] or "recipe") if edits else request.text


def _difference(compared: Any, own: Appearance) -> dict[str, Any]:
    """Return the CIEDE2000 difference from the appearance that the page stores, given as Lab `[lamp, angle, 3]`."""
    lab = np.array([swatch["lab"] for swatch in own.swatches])
    try:
        given = np.array(compared, dtype=float)
    except (TypeError, ValueError):
        return {}
    if given.shape != lab.shape or not np.isfinite(given).all() or np.abs(given).max() > MAX_LAB:
        return {}
    return {"difference": np.round(delta_e_2000(given, lab), 2).tolist()}


def json_data(data: Any) -> Any:
    """Return a recipe's data as JSON values: NaN and infinity become null, dates and times become text.

    Example:
        >>> json_data({"title": "NaN glass", "thickness_nm": float("inf")})
        {'title': 'NaN glass', 'thickness_nm': None}
    """
    if isinstance(data, Mapping):
        return {str(key): json_data(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [json_data(value) for value in data]
    if isinstance(data, float):
        return float(data) if math.isfinite(data) else None
    return data if data is None or isinstance(data, bool | int | str) else str(data)
