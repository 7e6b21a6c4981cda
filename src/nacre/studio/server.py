"""Loopback server of the studio: access control, routes, sessions, start."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import hmac
import json
import math
import os
import secrets
import signal
import socket
import stat
import sys
import tempfile
import threading
import time
import webbrowser
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, quote

import click
import numpy as np
import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect
from uvicorn.protocols.http.auto import AutoHTTPProtocol

from nacre._version import __version__
from nacre.core.disk_cache import cache_folder
from nacre.core.errors import NacreError
from nacre.families.registry import family_names
from nacre.formats.lut import template
from nacre.light import ILLUMINANTS, delta_e_2000
from nacre.material.examples import examples
from nacre.material.material import material_from_data
from nacre.matter.indices import library
from nacre.recipe.model import RecipeContext
from nacre.recipe.toml import parse_toml
from nacre.studio import folder
from nacre.studio.appearance import Appearance, angle_tables, appearances
from nacre.studio.design_jobs import list_parameters, read_design
from nacre.studio.downloads import formats_of, read_file, read_picture, read_report, unpacked
from nacre.studio.edit import edited, family_form, line_of
from nacre.studio.folder import MAX_TEXT, OpenedFolder, read_incidence
from nacre.studio.objects import OBJECTS, MeshStore, computed_psi_delta, packed_object, read_upload, relief_recipe
from nacre.studio.subprocess_jobs import LatestOnlyWorker, SubprocessJob, failure_text
from nacre.studio.surroundings import ALPHAS, ROWS, SKIES, blurred_surroundings, floors

LOOPBACK = "127.0.0.1"
DEFAULT_PORT = 8642  # the same at each start: an open page finds a restarted server
BACKLOG = 64  # connections accepted at once
WARM_UP_RECIPE = {"family": "film", "substrate": "Si", "layers": [{"material": "SiO2", "thickness_nm": 100}]}
IDLE_TIMEOUT_S = 10.0  # time to receive the request head
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
    signal.signal(signal.SIGTERM, _leave)  # the server restores it at its end and raises the signal again
    if hasattr(signal, "SIGHUP"):
        signal.signal(signal.SIGHUP, lambda *_: signal.raise_signal(signal.SIGTERM))
    uvicorn.Server(config).run(sockets=[listening])


def _leave(number: int, frame: object) -> None:
    """Exit such that temporary files are removed; a signal would end the process at once."""
    sys.exit(128 + number)


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


# Access control: only the user's own page may send requests.
#
# The server listens on loopback, which every page in the user's browser can reach. Each request must therefore carry
# the token, name this server as its host, and not come from a foreign page; the page itself may load only its own
# files.

HOSTS = ("127.0.0.1", "localhost", "[::1]")
HEADER = "x-nacre-token"
TOKEN_LENGTH = 43  # characters for 256 bits
TOKEN_LIFETIME_S = 7 * 24 * 3600
REFUSED = 4403  # close code
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "content-security-policy": POLICY,
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}

Receive = Callable[[], Awaitable[dict[str, Any]]]
Send = Callable[[dict[str, Any]], Awaitable[None]]
Asgi = Callable[[dict[str, Any], Receive, Send], Awaitable[None]]


def new_token() -> str:
    """Return a random 256-bit token."""
    return secrets.token_urlsafe(32)


def stored_token(port: int) -> str:
    """Return the token for the server on a port: the previous one if it is recent, so that open pages stay valid.

    It is stored in the user's cache folder, readable by the user only; without such a folder it is new.
    """
    folder = cache_folder()
    if folder is None:
        return new_token()
    path = folder.parent / f"studio-{port}.token"
    try:
        status = path.lstat()
        token = path.read_text("ascii").strip()
        is_secret = stat.S_ISREG(status.st_mode)
        if os.name == "posix":  # other systems protect the user's folder
            is_secret = is_secret and not status.st_mode & 0o077 and status.st_uid == os.getuid()
        if is_secret and len(token) >= TOKEN_LENGTH and time.time() - status.st_mtime < TOKEN_LIFETIME_S:
            return token
    except (OSError, UnicodeDecodeError):
        pass
    token = new_token()
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        with open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="ascii") as file:
            file.write(token)
    return token


class Gate:
    """ASGI middleware before all routes and the socket: refuses with 403, and sets security headers."""

    def __init__(self, app: Asgi, token: str, port: int) -> None:
        self._app = app
        self._token = token
        self._cookie = f"nacre_studio_{port}"  # all ports share the host's cookies
        self._hosts = {f"{name}:{port}" for name in HOSTS} | (set(HOSTS) if port == 80 else set())

    async def __call__(self, scope: dict[str, Any], receive: Receive, send: Send) -> None:
        """Handle one connection."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = {name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope["headers"]}
        reason = self._foreign_reason(headers, is_socket=scope["type"] == "websocket") or _cross_site_reason(
            headers, scope
        )
        if reason:
            await _refuse(scope, send, reason)
            return
        token = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [""])[-1]
        if scope["type"] == "http" and scope["path"] == "/" and token and self._is_token(token):
            await self._welcome(send)
            return
        if not self._is_token(headers.get(HEADER, "")) and not self._is_token(self._in_cookie(headers)):
            await _refuse(scope, send, "open the address that nacre studio printed: it holds the token")
            return

        async def with_headers(message: dict[str, Any]) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", []), *_encoded(HEADERS)]
            await send(message)

        await self._app(scope, receive, with_headers)

    def _foreign_reason(self, headers: Mapping[str, str], is_socket: bool) -> str:
        if headers.get("host", "").lower() not in self._hosts:
            return "this host name is not the studio's"
        origin = headers.get("origin")
        if origin is None:
            # browsers send a socket's origin; other clients must send the token in a header
            return "a socket without an origin" if is_socket and not self._is_token(headers.get(HEADER, "")) else ""
        own = origin.lower().removeprefix("http://")
        if not origin.lower().startswith("http://") or own != headers["host"].lower():
            return "another page may not talk to the studio"
        return ""

    def _is_token(self, text: str) -> bool:
        return hmac.compare_digest(text.encode(), self._token.encode())

    def _in_cookie(self, headers: Mapping[str, str]) -> str:
        try:
            cookies = SimpleCookie(headers.get("cookie", ""))
        except CookieError:
            return ""
        return cookies[self._cookie].value if self._cookie in cookies else ""

    async def _welcome(self, send: Send) -> None:
        """Store the token in a cookie that scripts cannot read, and redirect to an address without it."""
        body = b"".join(
            (
                b'<!doctype html><meta charset="utf-8"><title>nacre</title>',
                b'<link rel="icon" href="data:,"><meta http-equiv="refresh" content="0;url=/">',
            )
        )
        cookie = f"{self._cookie}={self._token}; Path=/; HttpOnly; SameSite=Strict"
        headers = {**HEADERS, "content-type": "text/html; charset=utf-8", "set-cookie": cookie}
        await send({"type": "http.response.start", "status": 200, "headers": _encoded(headers)})
        await send({"type": "http.response.body", "body": body})


def _cross_site_reason(headers: Mapping[str, str], scope: Mapping[str, Any]) -> str:
    """Refuse requests from other servers' pages without an origin, such as images and scripts.

    Another port on this host is the same site, so that browsers attach the cookie. Such a page cannot read the answer,
    but could start jobs. Links to the page itself are allowed.
    """
    if headers.get("sec-fetch-site", "none") in ("none", "same-origin"):
        return ""
    is_page = scope["type"] == "http" and scope["path"] == "/" and scope["method"] == "GET"
    if is_page and headers.get("sec-fetch-mode") == "navigate" and headers.get("sec-fetch-dest") == "document":
        return ""
    return "another page may not talk to the studio"


async def _refuse(scope: Mapping[str, Any], send: Send, reason: str) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": REFUSED, "reason": reason})  # before accepting: 403
        return
    headers = {**HEADERS, "content-type": "text/plain; charset=utf-8"}
    await send({"type": "http.response.start", "status": 403, "headers": _encoded(headers)})
    await send({"type": "http.response.body", "body": f"403: {reason}\n".encode()})


def _encoded(headers: Mapping[str, str]) -> list[tuple[bytes, bytes]]:
    return [(name.encode(), value.encode()) for name, value in headers.items()]


# HTTP routes: the page's files, recipes, validated requests, and subprocess jobs.

MAX_JOBS = 2  # subprocesses at once in each group: designs, other streaming jobs, jobs with one result
MAX_SOLVERS = 2  # sessions that compute at once
MAX_SESSIONS = 64
MAX_FOUND = 40
MAX_MESSAGE = 2 * MAX_TEXT
MAX_BODY = 2 * MAX_MESSAGE  # two recipes
MAX_UPLOAD = 64 << 20  # bytes
MAX_SESSION_NAME = 40
MAX_SUFFIX = 16  # characters
MEDIA = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".jpg": "image/jpeg"}
REMARKS_HEADER = "x-nacre-remarks"  # remarks on an exported file, as JSON
JOB_S, FILE_S = 300.0, 1800.0  # time limits
OVERHEAD_S = 240.0  # added to the requested seconds for start, compilation and final evaluation
MAX_JOB_BYTES = 4 << 30  # memory limit for streaming jobs
TABLES = "table.glsl"
DRAWS, MAX_PERCENT = (4, 400), 50.0
BAD_INPUT, NOT_FOUND = 422, 404
JOBS = {  # route -> function
    "design": "nacre.studio.design_jobs:design",
    "gamut": "nacre.studio.design_jobs:gamut",
    "tolerance": "nacre.studio.design_jobs:tolerance",
    "picture": "nacre.studio.downloads:render_picture",
}

Body = dict[str, Any]


@dataclass
class Studio:
    """Server state.

    Attributes:
        opened: the folder.
        meshes: uploaded meshes.
        slot: limits the sessions that compute at once.
        limits: limit subprocesses by group.
        running: current streaming jobs by page and route.
        skies: surroundings computed by Mitsuba.
    """

    opened: folder.OpenedFolder
    meshes: MeshStore = field(default_factory=MeshStore)
    slot: threading.Semaphore = field(default_factory=lambda: threading.Semaphore(MAX_SOLVERS))
    limits: dict[str, asyncio.Semaphore] = field(
        default_factory=lambda: {
            group: asyncio.Semaphore(MAX_JOBS) for group in ("design", "stream", "result", "angles")
        }
    )
    sessions: set[Session] = field(default_factory=set)
    running: dict[tuple[str, str], StreamingJob] = field(default_factory=dict)
    skies: dict[str, bytes] = field(default_factory=dict)


@dataclass(eq=False)
class StreamingJob:
    """A page's streaming job: `stop` finishes it early, `is_replaced` cancels it for a newer one."""

    stop: asyncio.Event = field(default_factory=asyncio.Event)
    is_replaced: bool = False


def routes() -> list[BaseRoute]:
    """Return all routes; `app.state.studio` holds the `Studio`."""
    page = _page_files()

    def asset(request: Request) -> Response:
        name = request.path_params.get("name") or "index.html"
        if name not in page:
            return Response("404: no such file\n", NOT_FOUND)
        content, media = page[name]
        return Response(content, media_type=media)

    get = {
        "/api/state": state, "/api/surroundings": surroundings, "/api/recipe": recipe, "/api/form": form,
        "/api/indices": indices, "/api/object": picture_object, "/favicon.ico": no_icon,
    }  # fmt: skip
    post = {
        "/api/save": save, "/api/report": report, "/api/mesh": mesh, "/api/measurement": measurement, "/api/scan": scan,
        "/api/angles": angles, "/api/formats": formats, "/api/file": file,
        "/api/parameters": parameters, "/api/stop": stop, **{f"/api/{name}": _streaming(name) for name in JOBS},
    }  # fmt: skip
    return [
        Route("/", asset),
        Route("/page/{name}", asset),
        *(Route(path, endpoint) for path, endpoint in get.items()),
        *(Route(path, endpoint, methods=["POST"]) for path, endpoint in post.items()),
        WebSocketRoute("/ws", talk),
    ]


def _page_files() -> dict[str, tuple[bytes, str]]:
    """Return the page's files, read once; names in requests therefore never become paths."""
    contents = {}
    for entry in files("nacre.studio").joinpath("page").iterdir():
        media = MEDIA.get(f".{entry.name.rpartition('.')[2]}")
        if media:
            contents[entry.name] = (entry.read_bytes(), media)
    contents[TABLES] = (template(TABLES).encode(), "text/plain")  # look-ups as in exported tables
    return contents


def failed(request: Request, error: Exception) -> Response:
    """Send an error in one line."""
    return JSONResponse({"error": str(error), "line": line_of("", str(error))}, BAD_INPUT)


def _studio(request: Request | WebSocket) -> Studio:
    studio: Studio = request.app.state.studio
    return studio


def no_icon(request: Request) -> Response:
    """Send an empty response to the browser's icon request."""
    return Response(status_code=204)


def state(request: Request) -> Response:
    """Send the recipes, examples, families, objects and surroundings."""
    opened = _studio(request).opened
    shipped = {example.name: example for example in examples()}
    names = opened.names()
    return JSONResponse(
        {
            "version": __version__,
            "folder": opened.folder.name,
            "first": opened.first,
            "recipes": names,
            "begin": next(filter(opened.is_readable, names), next(iter(names), "")),
            "families": sorted(family_names()),
            "starts": [_example(shipped[name]) for name in folder.STARTS if name in shipped],
            "examples": [_example(example) for example in shipped.values() if example.is_recipe],
            "objects": OBJECTS,
            "surroundings": {"rows": ROWS, "columns": 2 * ROWS, "alphas": ALPHAS, "places": floors()},
        }
    )


def _example(example: Any) -> dict[str, str]:
    return {
        "name": folder.EXAMPLE + example.name,
        "title": example.name,
        "family": example.family,
        "about": example.about,
    }


async def surroundings(request: Request) -> Response:
    """Send packed surroundings; a sky is computed once, by a job."""
    name, skies = request.query_params.get("name", "studio"), _studio(request).skies
    if name not in SKIES:
        return _binary((await asyncio.to_thread(blurred_surroundings, name)).packed())
    if name not in skies:
        skies[name] = await _result(request, "sky", "nacre.studio.surroundings:sky_job", {"name": name})
    return _binary(skies[name])


def _binary(content: bytes, headers: Mapping[str, str] | None = None) -> Response:
    return Response(content, media_type="application/octet-stream", headers=headers)


def recipe(request: Request) -> Response:
    """Send a recipe's text and version."""
    name = request.query_params.get("name", "")
    text = _studio(request).opened.read(name)
    if len(text) > folder.MAX_TEXT:
        raise NacreError(f"{name}: a recipe of {len(text)} characters; at most {folder.MAX_TEXT} are shown")
    return JSONResponse(
        {"name": name, "text": text, "version": "" if name.startswith(folder.EXAMPLE) else folder.version_of(text)}
    )


def form(request: Request) -> Response:
    """Send a family's form."""
    return JSONResponse(family_form(request.query_params.get("family")))


def indices(request: Request) -> Response:
    """Send the optical constants whose names match the query."""
    entries = library.search(request.query_params.get("q", "")[:80])
    listed = [{"name": entry.name, "title": entry.title} for entry in entries[:MAX_FOUND]]
    return JSONResponse({"found": listed, "more": max(len(entries) - MAX_FOUND, 0)})


def picture_object(request: Request) -> Response:
    """Send an object's triangles."""
    return _binary(packed_object(request.query_params.get("name", "")))


async def save(request: Request) -> Response:
    """Save a recipe into the folder."""
    body = await _body(request)
    name, text, known = (body.get(key) for key in ("name", "text", "version"))
    if not (isinstance(name, str) and isinstance(text, str) and isinstance(known, str)):
        raise NacreError("to save, name, text and version must be strings")
    if len(text) > folder.MAX_TEXT:
        raise NacreError(f"{name[:80]}: a recipe of {len(text)} characters; at most {folder.MAX_TEXT} are saved")
    return JSONResponse({"name": name, "version": _studio(request).opened.save(name, text, known)})


async def report(request: Request) -> Response:
    """Send a report on one recipe or two."""
    question = read_report(await _body(request), _studio(request).opened)
    found = await _result(request, "report", "nacre.studio.downloads:report", question)
    return Response(found, media_type="application/json")


async def angles(request: Request) -> Response:
    """Send colours at the geometries of multi-angle instruments, and texture."""
    body = await _body(request)
    placed, lamp = folder.read_recipe(body.get("recipe"), _studio(request).opened), folder.read_lamp(body)
    async with _studio(request).limits["angles"]:
        return JSONResponse(await asyncio.to_thread(angle_tables, placed, lamp, bool(body.get("fine"))))


async def formats(request: Request) -> Response:
    """Send a recipe's file formats."""
    placed = folder.read_recipe(await _body(request), _studio(request).opened)
    return JSONResponse(await asyncio.to_thread(lambda: formats_of(folder.built(placed))))


async def parameters(request: Request) -> Response:
    """Send the possible design parameters."""
    placed = folder.read_recipe(await _body(request), _studio(request).opened)
    return JSONResponse(await asyncio.to_thread(lambda: list_parameters(folder.built(placed))))


async def file(request: Request) -> Response:
    """Return an exported or fabrication file, or a rendered picture."""
    body, studio = await _body(request), _studio(request)
    question = {**read_file(body, studio.opened), **_mesh(body, studio)}
    packed = await _result(request, "file", "nacre.studio.downloads:make_file", question, FILE_S)
    header, content = unpacked(packed)
    return _binary(
        content,
        {
            "content-disposition": f"attachment; filename*=UTF-8''{quote(header['name'])}",
            REMARKS_HEADER: json.dumps(header["remarks"]),  # ASCII
        },
    )


async def mesh(request: Request) -> Response:
    """Store an uploaded mesh and return its triangles."""
    name, up = (request.query_params.get(key, "") for key in ("name", "up"))
    name = name.rpartition("/")[2][-80:]
    suffix = read_upload(name, up)
    meshes = _studio(request).meshes
    key, uploaded, stored = meshes.place(suffix)
    try:
        await _upload(request, uploaded, name)
        question = {"path": str(uploaded), "name": name, "up": up, "stored": str(stored), "id": key}
        packed = await _result(request, "mesh", "nacre.studio.objects:mesh_job", question)
    except NacreError:
        meshes.drop(key)
        raise
    finally:
        uploaded.unlink(missing_ok=True)
    return _binary(packed)


async def measurement(request: Request) -> Response:
    """Return the content of a dropped instrument file."""
    return Response((await _dropped(request, "measurement_job"))[1], media_type="application/json")


async def scan(request: Request) -> Response:
    """Store a dropped scan in the opened folder; return an unsaved recipe of its relief."""
    name, _, content = await _dropped(request, "scan_job")
    await asyncio.to_thread(_studio(request).opened.store, name, content)
    return JSONResponse({"name": f"{Path(name).stem}.toml", "text": relief_recipe(name), "version": ""})


async def _dropped(request: Request, job: str) -> tuple[str, bytes, bytes]:
    """Return the name of an uploaded file, a job's answer about it, and its content."""
    name = request.query_params.get("name", "").replace("\\", "/").rpartition("/")[2][-80:]
    suffix = Path(name).suffix if len(Path(name).suffix) <= MAX_SUFFIX else ""
    with tempfile.TemporaryDirectory(prefix="nacre-studio-") as place:
        uploaded = Path(place) / f"upload{suffix}"
        await _upload(request, uploaded, name)
        question = {"path": str(uploaded), "name": name}
        found = await _result(request, "measurement", f"nacre.studio.objects:{job}", question)
        return name, found, uploaded.read_bytes()


def _mesh(body: Body, studio: Studio) -> dict[str, Any]:
    return {"mesh": str(studio.meshes.path(str(body["mesh"])))} if body.get("mesh") else {}


async def _result(
    request: Request, name: str, function: str, question: Mapping[str, Any], max_seconds: float = JOB_S
) -> bytes:
    """Run a job and return its result."""

    async def is_connected() -> bool:
        return not await request.is_disconnected()

    async with _studio(request).limits["result"]:
        return await SubprocessJob(name, function, question, is_connected, max_seconds).run()


async def _body(request: Request) -> Body:
    content = b""
    async for chunk in request.stream():
        content += chunk
        if len(content) > MAX_BODY:
            raise NacreError(f"the request is larger than {MAX_BODY} bytes")
    try:
        body = json.loads(content)
    except (ValueError, RecursionError):
        raise NacreError("the request is not JSON") from None
    if not isinstance(body, dict):
        raise NacreError("the request is not a table")
    return body


async def _upload(request: Request, path: Path, name: str) -> None:
    """Write the request's body into a file."""
    size = 0
    with open(path, "wb") as file:
        async for chunk in request.stream():
            size += len(chunk)
            if size > MAX_UPLOAD:
                raise NacreError(f"{name}: is larger than {MAX_UPLOAD >> 20} MiB; the page takes no larger files")
            file.write(chunk)


async def stop(request: Request) -> Response:
    """Finish a page's design with its current best solutions."""
    session = str((await _body(request)).get("session", ""))
    if running := _studio(request).running.get((session, "design")):
        running.stop.set()
    return JSONResponse({"stopping": running is not None})


def _streaming(name: str) -> Callable[[Request], Awaitable[Response]]:
    """Return the endpoint for a streaming job."""

    async def endpoint(request: Request) -> Response:
        body = await _body(request)
        question = _question(name, body, _studio(request))
        session = str(body.get("session", ""))[:MAX_SESSION_NAME]
        return StreamingResponse(_stream(request, name, session, question), media_type="application/x-ndjson")

    return endpoint


def _question(name: str, body: Body, studio: Studio) -> dict[str, Any]:
    if name == "picture":
        return {**read_picture(body, studio.opened), **_mesh(body, studio)}
    if name == "tolerance":
        return {
            "recipe": folder.read_recipe(body, studio.opened),
            "lamp": folder.read_lamp(body),
            "azimuth_deg": read_incidence(body).azimuth_deg,
            "percent": folder.read_number(body.get("percent", 2), "tolerance in %", 0.0, MAX_PERCENT),
            "draws": int(folder.read_number(body.get("draws", 64), "draws", *DRAWS)),
        }
    return read_design(body, studio.opened)


async def _stream(request: Request, name: str, session: str, question: Mapping[str, Any]) -> AsyncIterator[bytes]:
    """Yield a job's events; a newer job for the same page and route replaces it."""
    studio, own, key = _studio(request), StreamingJob(), (session, name)
    if session:
        if older := studio.running.get(key):
            older.is_replaced = True
        studio.running[key] = own

    async def is_connected() -> bool:
        return not own.is_replaced and not await request.is_disconnected()

    limit = studio.limits["design" if name == "design" else "stream"]
    max_seconds = 2.0 * question.get("seconds", 0.0) + OVERHEAD_S
    try:
        if limit.locked():
            yield json.dumps({"kind": "waiting"}).encode() + b"\n"
        async with limit:
            if not await is_connected():
                return
            job = SubprocessJob(name, JOBS[name], question, is_connected, max_seconds, MAX_JOB_BYTES, own.stop)
            async for line in job.events():
                yield line
    finally:
        if studio.running.get(key) is own:
            del studio.running[key]


async def talk(websocket: WebSocket) -> None:
    """Run a page's session."""
    studio = _studio(websocket)
    if len(studio.sessions) >= MAX_SESSIONS:
        await websocket.close(1013, "too many pages are open")
        return
    session = Session(websocket, studio.opened, studio.slot)
    studio.sessions.add(session)
    try:
        await session.run()
    finally:
        studio.sessions.discard(session)


# A page's WebSocket session: the newest request is answered.
#
# The server is stateless: each request carries the recipe's text and the edits since, therefore a restarted server
# continues previous sessions.

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
        """Serve requests until the page is closed or sends an invalid message."""
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
        for view in appearances(material, lamp, is_superseded, read_incidence(request.body)):
            beside = (
                {} if view.is_draft else {"psi_delta": computed_psi_delta(material, request.body.get("ellipsometry"))}
            )
            compared = _difference(request.body.get("compared_lab"), view)
            yield view.packed(**header, **beside, **compared), view.is_draft

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
        """Send a message from the worker's thread; a closed socket ends the job."""
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
        stored = np.array(compared, dtype=float)
    except (TypeError, ValueError):
        return {}
    if stored.shape != lab.shape or not np.isfinite(stored).all() or np.abs(stored).max() > MAX_LAB:
        return {}
    return {"difference": np.round(delta_e_2000(stored, lab), 2).tolist()}


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
