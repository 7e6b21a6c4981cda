"""Access control: only the user's own page may send requests.

The server listens on loopback, which every page in the user's browser can reach. Each request must therefore carry the
token, name this server as its host, and not come from a foreign page; the page itself may load only its own files.
"""

import contextlib
import hmac
import os
import secrets
import stat
import time
from collections.abc import Awaitable, Callable, Mapping
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs

from nacre.core.disk_cache import cache_folder

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
        given = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [""])[-1]
        if scope["type"] == "http" and scope["path"] == "/" and given and self._is_token(given):
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
