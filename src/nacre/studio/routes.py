"""The addresses at which long work tells how far it is: designs, gamuts, clouds, pictures; one of a kind per page."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from nacre.core.errors import NacreError
from nacre.studio.design_request import free_numbers, read_design
from nacre.studio.folder import Opened
from nacre.studio.measured import built, placed
from nacre.studio.picture_job import read_question
from nacre.studio.subprocess_jobs import WORK, stream_apart
from nacre.studio.tolerance_job import read_cloud

LINES = "application/x-ndjson"
DESIGNS, OTHERS = 2, 2  # processes at once; the others wait
LATE_S = 240.0  # beyond the seconds asked for: to begin, compile, judge
LONGEST_SESSION = 40

Body = Callable[[Request], Awaitable[dict[str, Any]]]
Shape = Callable[[dict[str, Any]], dict[str, Any]]


class _Running:
    """The work of one page of one kind.

    Attributes:
        stop: asks for an end with what there is; gone: newer work has taken its place.
    """

    def __init__(self) -> None:
        self.stop, self.gone = asyncio.Event(), asyncio.Event()


class Streams:
    """Answers of many lines."""

    def __init__(self, opened: Opened, body: Body, told: Callable[[NacreError], Response], shape: Shape) -> None:
        """Args: body: reads a request's table; told: an error as an answer; shape: adds the mesh that is named."""
        self._opened, self._body, self._told, self._shape = opened, body, told, shape
        self._running: dict[tuple[str, str], _Running] = {}
        self._places = {"design": asyncio.Semaphore(DESIGNS)}
        self._others = asyncio.Semaphore(OTHERS)

    def routes(self) -> list[Route]:
        """Return the routes of all of them."""
        return [
            Route("/api/free", self.free, methods=["POST"]),
            Route("/api/stop", self.stop, methods=["POST"]),
            *(Route(f"/api/{kind}", self._of(kind), methods=["POST"]) for kind in WORK),
        ]

    async def free(self, request: Request) -> Response:
        """Answer what of a recipe may be free."""
        try:
            recipe = placed(await self._body(request), self._opened)
            return JSONResponse(await asyncio.to_thread(lambda: free_numbers(built(recipe))))
        except NacreError as error:
            return self._told(error)

    async def stop(self, request: Request) -> Response:
        """Ask a page's design for an end with what it has."""
        try:
            session = str((await self._body(request)).get("session", ""))
        except NacreError as error:
            return self._told(error)
        if running := self._running.get((session, "design")):
            running.stop.set()
        return JSONResponse({"stopping": running is not None})

    def _of(self, kind: str) -> Callable[[Request], Awaitable[Response]]:
        async def answer(request: Request) -> Response:
            try:
                body = await self._body(request)
                question, seconds = self._question(kind, body)
            except NacreError as error:
                return self._told(error)
            session = str(body.get("session", ""))[:LONGEST_SESSION]
            return StreamingResponse(self._lines(request, kind, session, question, seconds), media_type=LINES)

        return answer

    def _question(self, kind: str, body: dict[str, Any]) -> tuple[dict[str, Any], float]:
        if kind == "picture":
            question = {**read_question(body), **self._shape(body)}
            path, fence = self._opened.place(question["name"])
            return {**question, "path": str(path), "fence": str(fence)}, question["seconds"]
        if kind == "cloud":
            return read_cloud(body, self._opened), 0.0
        question = read_design(body, self._opened)
        return question, question["seconds"]

    async def _lines(
        self, request: Request, kind: str, session: str, question: dict[str, Any], seconds: float
    ) -> AsyncIterator[bytes]:
        own, key = _Running(), (session, kind)
        if session:
            if older := self._running.get(key):
                older.gone.set()
            self._running[key] = own

        async def is_wanted() -> bool:
            return not own.gone.is_set() and not await request.is_disconnected()

        place = self._places.get(kind, self._others)
        try:
            if place.locked():
                yield json.dumps({"kind": "waiting"}).encode() + b"\n"
            async with place:
                if not await is_wanted():
                    return
                async for line in stream_apart(kind, question, is_wanted, own.stop, 2.0 * seconds + LATE_S):
                    yield line
        finally:
            if self._running.get(key) is own:
                del self._running[key]
