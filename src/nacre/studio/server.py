"""Loopback server: application, port, start."""

from __future__ import annotations

import asyncio
import gc
import socket
import sys
import threading
import webbrowser
from typing import Any

import click
import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from uvicorn.protocols.http.auto import AutoHTTPProtocol

from nacre.core.errors import NacreError
from nacre.material.material import material_from_data
from nacre.recipe.model import RecipeContext
from nacre.studio.appearance import appearances
from nacre.studio.folder import OpenedFolder
from nacre.studio.routes import Studio, failed, routes
from nacre.studio.security import Gate, new_token, stored_token
from nacre.studio.session import MAX_MESSAGE
from nacre.studio.surroundings import blurred_surroundings

LOOPBACK = "127.0.0.1"
DEFAULT_PORT = 8642  # the same at each start: an open page finds a restarted server
BACKLOG = 64  # connections accepted at once
WARM_UP_RECIPE = {"family": "film", "substrate": "Si", "layers": [{"material": "SiO2", "thickness_nm": 100}]}
IDLE_TIMEOUT_S = 10.0  # for the request head
MAX_IDLE = 64  # connections


class IdleTimeoutProtocol(AutoHTTPProtocol):  # type: ignore[misc, valid-type]  # uvicorn chooses the class at import
    """HTTP protocol that closes connections without a complete request, after a timeout or when there are too many.

    Any program on the machine can open many connections; without a limit the page could run out of file descriptors.
    """

    idle: dict[IdleTimeoutProtocol, asyncio.TimerHandle]  # idle connections, oldest first

    def connection_made(self, transport: Any) -> None:
        """Start the timeout."""
        super().connection_made(transport)
        self.idle[self] = asyncio.get_running_loop().call_later(IDLE_TIMEOUT_S, self._close)
        if len(self.idle) > MAX_IDLE:
            next(iter(self.idle))._close()

    def data_received(self, data: bytes) -> None:
        """Cancel the timeout when the request is complete or the connection became a WebSocket."""
        super().data_received(data)
        if self.cycle is not None or self.transport.get_protocol() is not self:
            self._cancel_timeout()

    def connection_lost(self, exc: Exception | None) -> None:
        """Cancel the timeout."""
        self._cancel_timeout()
        super().connection_lost(exc)

    def _cancel_timeout(self) -> None:
        if timer := self.idle.pop(self, None):
            timer.cancel()

    def _close(self) -> None:
        self._cancel_timeout()
        self.transport.abort()


def idle_timeout_protocol() -> type[IdleTimeoutProtocol]:
    """Return a server's protocol class with its own list of idle connections."""
    return type("ServerProtocol", (IdleTimeoutProtocol,), {"idle": {}})


def make_app(opened: OpenedFolder, token: str, port: int) -> Starlette:
    """Return the server as an ASGI application.

    Args:
        opened: the folder.
        token: required in every request.
        port: part of accepted host names.
    """
    app = Starlette(
        routes=routes(), middleware=[Middleware(Gate, token=token, port=port)], exception_handlers={NacreError: failed}
    )
    app.state.studio = Studio(opened)
    return app


def open_port(port: int | None) -> socket.socket:
    """Return a listening socket on loopback; port 0: any free one; default: the usual one, or any.

    Raises:
        NacreError: the port is in use or not permitted.
    """
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((LOOPBACK, DEFAULT_PORT if port is None else port))
        listening.listen(BACKLOG)
    except OSError as error:
        listening.close()
        if port is None:
            return open_port(0)
        raise NacreError(
            f"--port {port}: {(error.strerror or str(error)).lower()}; choose another, or leave --port out"
        ) from None
    return listening


def serve(opened: OpenedFolder, port: int | None, opens_browser: bool) -> None:
    """Serve until interrupted; the only line on stdout is the address with its token.

    Raises:
        NacreError: the port is not available.
    """
    listening = open_port(port)
    chosen = listening.getsockname()[1]
    token = stored_token(chosen) if chosen in (port, DEFAULT_PORT) else new_token()
    config = uvicorn.Config(
        make_app(opened, token, chosen), http=idle_timeout_protocol(), backlog=BACKLOG, log_level="critical",
        access_log=False, lifespan="off", ws_max_size=MAX_MESSAGE, timeout_graceful_shutdown=1, server_header=False,
        ws_per_message_deflate=False,  # useless on one machine
    )  # fmt: skip
    address = f"http://{LOOPBACK}:{chosen}/?token={token}"
    click.echo(address)
    sys.stdout.flush()
    if opens_browser:
        threading.Thread(target=_open_browser, args=(address,), daemon=True).start()
    threading.Thread(target=_warm_up, daemon=True).start()
    uvicorn.Server(config).run(sockets=[listening])


def _open_browser(address: str) -> None:
    try:
        is_opened = webbrowser.open(address)
    except (OSError, webbrowser.Error):
        is_opened = False
    if not is_opened:
        click.echo("nacre: no browser was found on this machine; open the address above in one", err=True)


def _warm_up() -> None:
    """Prepare the first page: studio light and compiled film kernels."""
    blurred_surroundings()
    material = material_from_data(WARM_UP_RECIPE, RecipeContext())
    next(appearances(material, "D65", lambda: False), None)
    gc.freeze()  # scanning imported libraries' objects would delay some answers by 0.1 s
