"""HTTP routes: the page's files, recipes, validated requests, and subprocess jobs."""

from __future__ import annotations

import asyncio
import json
import tempfile
import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import quote

from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.websockets import WebSocket

from nacre._version import __version__
from nacre.core.errors import NacreError
from nacre.families.registry import family_names
from nacre.formats.lut import template
from nacre.material.examples import examples
from nacre.matter.indices import library
from nacre.studio import folder
from nacre.studio.angles import angle_tables
from nacre.studio.design_jobs import list_parameters, read_design
from nacre.studio.downloads import formats_of, read_file, read_picture, read_report, unpacked
from nacre.studio.edit import line_of
from nacre.studio.form import family_form
from nacre.studio.incidence import read_incidence
from nacre.studio.measured import relief_recipe
from nacre.studio.objects import OBJECTS, MeshStore, packed_object, read_upload
from nacre.studio.session import MAX_MESSAGE, Session
from nacre.studio.subprocess_jobs import SubprocessJob
from nacre.studio.surroundings import ALPHAS, ROWS, SKIES, blurred_surroundings, floors

MAX_JOBS = 2  # subprocesses at once in each group: designs, other streaming jobs, jobs with one result
MAX_SOLVERS = 2  # sessions that compute at once
MAX_SESSIONS = 64
MAX_FOUND = 40
MAX_BODY = 2 * MAX_MESSAGE  # two recipes
MAX_UPLOAD = 64 << 20  # bytes
MAX_SESSION_NAME = 40
MAX_SUFFIX = 16  # characters
MEDIA = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".jpg": "image/jpeg"}
REMARKS_HEADER = "x-nacre-remarks"  # remarks on an exported file, as JSON
JOB_S, FILE_S = 300.0, 1800.0  # time limits
OVERHEAD_S = 240.0  # beyond the requested seconds: start, compilation, final evaluation
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
    found = {}
    for entry in files("nacre.studio").joinpath("page").iterdir():
        media = MEDIA.get(f".{entry.name.rpartition('.')[2]}")
        if media:
            found[entry.name] = (entry.read_bytes(), media)
    found[TABLES] = (template(TABLES).encode(), "text/plain")  # look-ups as in exported tables
    return found


def failed(request: Request, error: Exception) -> Response:
    """Answer an error in one line."""
    return JSONResponse({"error": str(error), "line": line_of("", str(error))}, BAD_INPUT)


def _studio(request: Request | WebSocket) -> Studio:
    studio: Studio = request.app.state.studio
    return studio


def no_icon(request: Request) -> Response:
    """Answer the browsers' initial icon request."""
    return Response(status_code=204)


def state(request: Request) -> Response:
    """Answer the recipes, examples, families, objects and surroundings."""
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
    """Answer packed surroundings; a sky is computed once, by a job."""
    name, skies = request.query_params.get("name", "studio"), _studio(request).skies
    if name not in SKIES:
        return _binary((await asyncio.to_thread(blurred_surroundings, name)).packed())
    if name not in skies:
        skies[name] = await _result(request, "sky", "nacre.studio.surroundings:sky_job", {"name": name})
    return _binary(skies[name])


def _binary(content: bytes, headers: Mapping[str, str] | None = None) -> Response:
    return Response(content, media_type="application/octet-stream", headers=headers)


def recipe(request: Request) -> Response:
    """Answer a recipe's text and version."""
    name = request.query_params.get("name", "")
    text = _studio(request).opened.read(name)
    if len(text) > folder.MAX_TEXT:
        raise NacreError(f"{name}: a recipe of {len(text)} characters; at most {folder.MAX_TEXT} are shown")
    return JSONResponse(
        {"name": name, "text": text, "version": "" if name.startswith(folder.EXAMPLE) else folder.version_of(text)}
    )


def form(request: Request) -> Response:
    """Answer a family's form."""
    return JSONResponse(family_form(request.query_params.get("family")))


def indices(request: Request) -> Response:
    """Answer the optical constants whose names match the query."""
    found = library.search(request.query_params.get("q", "")[:80])
    listed = [{"name": entry.name, "title": entry.title} for entry in found[:MAX_FOUND]]
    return JSONResponse({"found": listed, "more": max(len(found) - MAX_FOUND, 0)})


def picture_object(request: Request) -> Response:
    """Answer an object's triangles."""
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
    """Answer a report on one recipe or two."""
    question = read_report(await _body(request), _studio(request).opened)
    found = await _result(request, "report", "nacre.studio.downloads:report", question)
    return Response(found, media_type="application/json")


async def angles(request: Request) -> Response:
    """Answer colours at the geometries of multi-angle instruments, and texture."""
    body = await _body(request)
    placed, lamp = folder.read_recipe(body.get("recipe"), _studio(request).opened), folder.read_lamp(body)
    async with _studio(request).limits["angles"]:
        return JSONResponse(await asyncio.to_thread(angle_tables, placed, lamp, bool(body.get("fine"))))


async def formats(request: Request) -> Response:
    """Answer a recipe's file formats."""
    placed = folder.read_recipe(await _body(request), _studio(request).opened)
    return JSONResponse(await asyncio.to_thread(lambda: formats_of(folder.built(placed))))


async def parameters(request: Request) -> Response:
    """Answer the possible design parameters."""
    placed = folder.read_recipe(await _body(request), _studio(request).opened)
    return JSONResponse(await asyncio.to_thread(lambda: list_parameters(folder.built(placed))))


async def file(request: Request) -> Response:
    """Answer an exported or fabrication file, or a rendered picture."""
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
    """Store an uploaded mesh and answer its triangles."""
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
    """Answer what a dropped instrument file contains."""
    return Response((await _dropped(request, "measurement_job"))[1], media_type="application/json")


async def scan(request: Request) -> Response:
    """Store a dropped scan in the opened folder; answer a recipe of its relief, which is not saved."""
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
        found = await _result(request, "measurement", f"nacre.studio.measured:{job}", question)
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
