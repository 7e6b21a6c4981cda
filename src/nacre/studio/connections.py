"""Connections that ask nothing: closed after a while, and at once where there are too many of them.

A browser's page cannot hold many, but any program of the machine can open a thousand and say half a request on each;
then the server would have no file left to answer the user's own page with.
"""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn.protocols.http.auto import AutoHTTPProtocol

SILENCE_S = 10.0  # in which the head of a request has to come
MOST_SILENT = 64


class Impatient(AutoHTTPProtocol):  # type: ignore[misc, valid-type]  # uvicorn chooses the class when it is imported
    """uvicorn's protocol, which ends connections that say nothing, or only half a request."""

    silent: dict[Impatient, asyncio.TimerHandle]  # of all connections of a server, the oldest first

    def connection_made(self, transport: Any) -> None:
        """Begin to wait."""
        super().connection_made(transport)
        self.silent[self] = asyncio.get_running_loop().call_later(SILENCE_S, self._end)
        if len(self.silent) > MOST_SILENT:
            next(iter(self.silent))._end()

    def data_received(self, data: bytes) -> None:
        """Wait no longer once a request is whole."""
        super().data_received(data)
        if self.cycle is not None or self.transport.get_protocol() is not self:  # or it has become a socket
            self._forget()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget it."""
        self._forget()
        super().connection_lost(exc)

    def _forget(self) -> None:
        if timer := self.silent.pop(self, None):
            timer.cancel()

    def _end(self) -> None:
        self._forget()
        self.transport.abort()


def impatient() -> type[Impatient]:
    """Return the protocol of one server, with a list of silent connections of its own."""

    class OfOneServer(Impatient):
        silent: dict[Impatient, asyncio.TimerHandle] = {}

    return OfOneServer
