"""The studio's server: the page, the recipes of the opened folder, the socket, and nothing else of the machine."""

from __future__ import annotations

import asyncio
import gc
import json
import socket
import sys
import threading
import webbrowser
from concurrent.futures import ThreadPoolExecutor
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import quote

import click
import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket
from uvicorn.protocols.http.auto import AutoHTTPProtocol

from nacre._version import __version__
from nacre.core.errors import NacreError
from nacre.families.registry import family_names
from nacre.formats.lut.write import template
from nacre.material.examples import examples
from nacre.material.material import material_from_data
from nacre.matter.indices import library
from nacre.recipe.model import RecipeContext
from nacre.studio.apart import run_apart
from nacre.studio.appearance import looks
from nacre.studio.downloads import read_wanted, targets, unpacked
from nacre.studio.edit import line_of
from nacre.studio.folder import EXAMPLE, MAX_TEXT, STARTS, Opened, mark_of
from nacre.studio.form import family_form
from nacre.studio.measured import built, placed, read_recipes
from nacre.studio.objects import MAX_UPLOAD, OBJECTS, OwnMeshes, packed_object, read_upload
from nacre.studio.routes import Streams
from nacre.studio.security import Asgi, Gate, kept_token, new_token
from nacre.studio.session import MAX_MESSAGE, Session
from nacre.studio.surroundings import ALPHAS, ROWS, SKIES, blurred_surround, floors

LOOPBACK = "127.0.0.1"
USUAL_PORT = 8642  # the same from start to start, so that a page finds its server again
APART = 2  # processes for pictures, reports and files; the others wait
SOLVERS = 2  # sessions that are answered at once; the others wait
MAX_SESSIONS = 64
AT_ONCE = 64  # connections that are taken on in one go, before any of them is judged
MAX_FOUND = 40
MAX_BODY = 2 * MAX_MESSAGE  # two recipes
MEDIA = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".jpg": "image/jpeg"}
SAID = "x-nacre-said"  # header of a file: what an export came to, as JSON
MOST_S_OF_A_FILE = 1800.0
TABLES = "table.glsl"
WARMING = {"family": "film", "substrate": "Si", "layers": [{"material": "SiO2", "thickness_nm": 100}]}
BAD_INPUT, TOO_LARGE, NOT_FOUND = 422, 413, 404


def make_app(opened: Opened, token: str, port: int) -> Asgi:
    """Return the server as an ASGI application, behind its gate.

    Args:
        opened: the folder.
        token: what every request has to show.
        port: that it listens on; part of the host names that it answers to.
    """
    workers = ThreadPoolExecutor(SOLVERS, thread_name_prefix="nacre-studio")
    apart = asyncio.Semaphore(APART)
    meshes = OwnMeshes()
    talking: set[Session] = set()
    skies: dict[str, bytes] = {}  # asked of Mitsuba once
    page = _page_files()

    async def asset(request: Request) -> Response:
        name = request.path_params.get("name") or "index.html"
        if name not in page:
            return Response("404: no such file\n", NOT_FOUND)
        content, media = page[name]
        return Response(content, media_type=media)

    async def no_icon(request: Request) -> Response:
        return Response(status_code=204)

    async def state(request: Request) -> Response:
        def look() -> dict[str, Any]:
            shipped = {example.name: example for example in examples()}
            chosen = [name for name in STARTS if name in shipped]
            known = set(family_names())  # a target is an example too, and no recipe
            return {
                "version": __version__,
                "folder": opened.folder.name,
                "first": opened.first,
                "recipes": (names := opened.names()),
                "begin": next(filter(opened.is_readable, names), next(iter(names), "")),
                "families": sorted(known),
                "starts": [_example(shipped[name]) for name in chosen],
                "examples": [_example(e) for e in shipped.values() if {e.family} <= known],
                "objects": OBJECTS,
                "surround": {"rows": ROWS, "columns": 2 * ROWS, "alphas": ALPHAS, "places": floors()},
            }

        return JSONResponse(await asyncio.get_running_loop().run_in_executor(workers, look))

    async def surround(request: Request) -> Response:
        name = request.query_params.get("name", "studio")
        try:
            if name in SKIES and name not in skies:
                skies[name] = await work(request, "surround", {"name": name})
            elif name not in SKIES:
                place = await asyncio.get_running_loop().run_in_executor(workers, blurred_surround, name)
        except NacreError as error:
            return _told(error)
        sent = skies[name] if name in SKIES else place.packed()
        return Response(sent, media_type="application/octet-stream")

    async def recipe(request: Request) -> Response:
        name = request.query_params.get("name", "")
        try:
            text = opened.read(name)
        except NacreError as error:
            return _told(error)
        if len(text) > MAX_TEXT:
            return _told(NacreError(f"{name}: a recipe of {len(text)} characters; at most {MAX_TEXT} are shown"))
        return JSONResponse({"name": name, "text": text, "mark": "" if name.startswith(EXAMPLE) else mark_of(text)})

    async def form(request: Request) -> Response:
        try:
            return JSONResponse(family_form(request.query_params.get("family")))
        except NacreError as error:
            return _told(error)

    async def indices(request: Request) -> Response:
        words = request.query_params.get("q", "")[:80]
        found = await asyncio.get_running_loop().run_in_executor(workers, library.search, words)
        listed = [{"name": e.name, "title": e.title} for e in found[:MAX_FOUND]]
        return JSONResponse({"found": listed, "more": max(len(found) - MAX_FOUND, 0)})

    async def save(request: Request) -> Response:
        try:
            body = await _body(request)
            name, text, known = (body.get(key) for key in ("name", "text", "mark"))
            if not (isinstance(name, str) and isinstance(text, str) and isinstance(known, str)):
                raise NacreError("saving takes name, text and mark")
            if len(text) > MAX_TEXT:
                raise NacreError(f"{name[:80]}: a recipe of {len(text)} characters; at most {MAX_TEXT} are saved")
            return JSONResponse({"name": name, "mark": opened.save(name, text, known)})
        except NacreError as error:
            return _told(error)

    async def report(request: Request) -> Response:
        try:
            made = await work(request, "report", read_recipes(await _body(request), opened))
        except NacreError as error:
            return _told(error)
        return Response(made, media_type="application/json")

    async def wanted(request: Request) -> Response:
        def look(recipe: dict[str, str]) -> dict[str, list[str]]:
            return targets(built(recipe))

        try:
            recipe = placed(await _body(request), opened)
            return JSONResponse(await asyncio.get_running_loop().run_in_executor(workers, look, recipe))
        except NacreError as error:
            return _told(error)

    async def file(request: Request) -> Response:
        try:
            body = await _body(request)
            question = {**read_wanted(body, opened), **shape(body)}
            packed = await work(request, "file", question, MOST_S_OF_A_FILE)
        except NacreError as error:
            return _told(error)
        header, content = unpacked(packed)
        headers = {
            "content-disposition": f"attachment; filename*=UTF-8''{quote(header['name'])}",
            SAID: json.dumps(header["said"]),  # ASCII
        }
        return Response(content, media_type="application/octet-stream", headers=headers)

    async def thing(request: Request) -> Response:
        try:
            name = request.query_params.get("name", "")
            packed = await asyncio.get_running_loop().run_in_executor(workers, packed_object, name)
        except NacreError as error:
            return _told(error)
        return Response(packed, media_type="application/octet-stream")

    async def mesh(request: Request) -> Response:
        name, up = (request.query_params.get(key, "") for key in ("name", "up"))
        name = name.rpartition("/")[2][-80:]
        identity, came = "", None
        try:
            identity, came, keep = meshes.place(read_upload(name, up))
            await _upload(request, came, name)
            question = {"path": str(came), "name": name, "up": up, "keep": str(keep), "id": identity}
            packed = await work(request, "mesh", question)
        except NacreError as error:
            meshes.drop(identity)
            return _told(error)
        finally:
            if came is not None:
                came.unlink(missing_ok=True)
        return Response(packed, media_type="application/octet-stream")

    def shape(body: dict[str, Any]) -> dict[str, Any]:
        wanted = body.get("mesh")
        return {"shape": str(meshes.path(str(wanted)))} if wanted else {}

    async def work(request: Request, kind: str, question: dict[str, Any], most_seconds: float = 300.0) -> bytes:
        async def is_wanted() -> bool:
            return not await request.is_disconnected()

        async with apart:
            return await run_apart(kind, question, is_wanted, most_seconds)

    async def talk(websocket: WebSocket) -> None:
        if len(talking) >= MAX_SESSIONS:
            await websocket.close(1013, "too many pages are open")
            return
        session = Session(websocket, opened, workers)
        talking.add(session)
        try:
            await session.run()
        finally:
            talking.discard(session)

    app = Starlette(
        routes=[
            Route("/", asset),
            Route("/favicon.ico", no_icon),  # browsers ask for it before they have read that there is none
            Route("/page/{name}", asset),
            Route("/api/state", state),
            Route("/api/surround", surround),
            Route("/api/recipe", recipe),
            Route("/api/form", form),
            Route("/api/indices", indices),
            Route("/api/save", save, methods=["POST"]),
            Route("/api/report", report, methods=["POST"]),
            Route("/api/object", thing),
            Route("/api/mesh", mesh, methods=["POST"]),
            Route("/api/targets", wanted, methods=["POST"]),
            Route("/api/file", file, methods=["POST"]),
            *Streams(opened, _body, _told, shape).routes(),
            WebSocketRoute("/ws", talk),
        ]
    )
    return Gate(app, token, port)  # type: ignore[arg-type]  # Starlette's own types of the same protocol


def _page_files() -> dict[str, tuple[bytes, str]]:
    """Return the files of the page, read once: no name of a request ever becomes a path."""
    found = {}
    for entry in files("nacre.studio").joinpath("page").iterdir():
        media = MEDIA.get(f".{entry.name.rpartition('.')[2]}")
        if media:
            found[entry.name] = (entry.read_bytes(), media)
    found[TABLES] = (template(TABLES).encode(), "text/plain")  # the page looks colours up as exported tables do
    return found


def _example(example: Any) -> dict[str, str]:
    return {"name": EXAMPLE + example.name, "title": example.name, "family": example.family, "about": example.about}


def _told(error: NacreError) -> JSONResponse:
    return JSONResponse({"error": str(error), "line": line_of("", str(error))}, BAD_INPUT)


async def _body(request: Request) -> dict[str, Any]:
    held = b""
    async for chunk in request.stream():
        held += chunk
        if len(held) > MAX_BODY:
            raise NacreError(f"more than {MAX_BODY} bytes were sent")
    try:
        body = json.loads(held)
    except (ValueError, RecursionError):
        raise NacreError("what was sent is not JSON") from None
    if not isinstance(body, dict):
        raise NacreError("what was sent is not a table")
    return body


async def _upload(request: Request, path: Path, name: str) -> None:
    """Write what is sent into a file."""
    size = 0
    with open(path, "wb") as file:
        async for chunk in request.stream():
            size += len(chunk)
            if size > MAX_UPLOAD:
                raise NacreError(f"{name}: a mesh of more than {MAX_UPLOAD >> 20} MiB; the page takes no larger ones")
            file.write(chunk)


def open_port(port: int | None) -> socket.socket:
    """Return a listening socket on loopback; port 0: any that is free; None: the usual one, or any.

    Raises:
        NacreError: the port is in use or may not be taken.
    """
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((LOOPBACK, USUAL_PORT if port is None else port))
        listening.listen(AT_ONCE)
    except OSError as error:
        listening.close()
        if port is None:
            return open_port(0)
        raise NacreError(
            f"--port {port}: {(error.strerror or str(error)).lower()}; choose another, or leave --port out"
        ) from None
    return listening


def serve(opened: Opened, port: int | None, is_browser_wanted: bool) -> None:
    """Serve until interrupted; the one line on stdout is the address, with its token.

    Raises:
        NacreError: the port cannot be taken.
    """
    listening = open_port(port)
    chosen = listening.getsockname()[1]
    token = kept_token(chosen) if chosen in (port, USUAL_PORT) else new_token()
    app = make_app(opened, token, chosen)
    config = uvicorn.Config(
        app, http=impatient(), backlog=AT_ONCE, log_level="critical", access_log=False, lifespan="off",
        ws_max_size=MAX_MESSAGE,
        timeout_graceful_shutdown=1, server_header=False, ws_per_message_deflate=False,  # it all stays on this machine
    )  # fmt: skip
    address = f"http://{LOOPBACK}:{chosen}/?token={token}"
    click.echo(address)
    sys.stdout.flush()
    if is_browser_wanted:
        threading.Thread(target=_open_browser, args=(address,), daemon=True).start()
    threading.Thread(target=_warm, daemon=True).start()
    uvicorn.Server(config).run(sockets=[listening])


def _open_browser(address: str) -> None:
    try:
        is_opened = webbrowser.open(address)
    except (OSError, webbrowser.Error):
        is_opened = False
    if not is_opened:
        click.echo("nacre: no browser was found on this machine; open the address above in one", err=True)


def _warm() -> None:
    """Do what every first page needs, before it asks: the room's light, and the compiled loops of a look at a film."""
    blurred_surround()
    material = material_from_data(WARMING, RecipeContext())
    next(looks(material, "D65", lambda: False), None)
    # the library's own objects are never garbage: to walk them all (0.1 s) would now and then hold an answer up
    gc.freeze()


# Connections that ask nothing: closed after a while, and at once where there are too many of them.

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
