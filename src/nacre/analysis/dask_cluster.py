"""The Dask cluster of a sweep, closed to everybody but the sweep itself.

Whoever reaches a Dask scheduler can have code of his own run by its workers, so scheduler and workers of this machine
speak TLS, with a key that is made for the run and gone with it, and listen on the loopback address. The HTTP
server that distributed starts with each of them, dashboard or not, answers without any key: it is left out here, where
alone nacre's classes differ from distributed's (there is no switch for it).
"""

from __future__ import annotations

import ssl
from collections.abc import Callable
from pathlib import Path
from typing import Any

from distributed import Client, Nanny, Scheduler, Security, SpecCluster, Worker

from nacre.core.errors import NacreError, did_you_mean
from nacre.core.files import read_text
from nacre.recipe.toml import parse_toml

SECURITY_KEYS = ("ca", "cert", "key")
LOOPBACK = "127.0.0.1"
ERRORS_ONLY = 40  # the level below which distributed says nothing


class SilentScheduler(Scheduler):
    """A scheduler without an HTTP server."""

    def start_http_server(self, *args: Any, **options: Any) -> None:
        """Start none."""


class SilentWorker(Worker):
    """A worker without an HTTP server."""

    def start_http_server(self, *args: Any, **options: Any) -> None:
        """Start none."""


def read_security(path: str | Path) -> Security:
    """Read the file of `--security`: ca, cert and key, the names of PEM files.

    Raises:
        NacreError: in one line: a key or a file is missing, or certificate and key cannot be used.
    """
    path = Path(path)
    given = parse_toml(read_text(path, "security file"), str(path))
    for key in given:
        if key not in SECURITY_KEYS:
            raise NacreError(f"{path}: {key} is not known.{did_you_mean(key, SECURITY_KEYS)} It holds ca, cert and key")
    named = {}
    for key in SECURITY_KEYS:
        if not isinstance(given.get(key), str):
            raise NacreError(f'{path}: {key} should be the name of a PEM file, such as {key} = "{key}.pem"')
        named[key] = path.parent / given[key]
    for key, file in named.items():
        try:
            with file.open("rb"):
                pass
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise NacreError(f'{path}: {key} = "{given[key]}" cannot be read: {reason}') from None
    security = Security(
        require_encryption=True,
        tls_ca_file=str(named["ca"]),
        tls_client_cert=str(named["cert"]),
        tls_client_key=str(named["key"]),
    )
    tests: tuple[tuple[str, Callable[[ssl.SSLContext], None]], ...] = (
        ("ca", lambda context: context.load_verify_locations(named["ca"])),
        ("cert and key", lambda context: context.load_cert_chain(named["cert"], named["key"], password=b"")),
    )
    for keys, test in tests:
        try:
            test(ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT))
        except (OSError, ValueError) as error:  # ssl's own errors are OSErrors
            reason = getattr(error, "reason", None) or error
            raise NacreError(
                f"{path}: {keys} cannot be used: {reason}; PEM files are wanted, the key without a password"
            ) from None
    return security


def local_cluster(workers: int, folder: str) -> SpecCluster:
    """Start a scheduler and worker processes on this machine, each of one thread; close it after use.

    Raises:
        NacreError: there is no `cryptography` to make the run's key with.
    """
    try:
        security = Security.temporary()
    except ImportError:
        raise NacreError(
            "several workers speak TLS, which needs cryptography: pip install 'nacre[study]', or use --workers 1"
        ) from None
    shared: dict[str, Any] = {
        "host": LOOPBACK, "protocol": "tls://", "security": security, "dashboard": False, "dashboard_address": None,
    }  # fmt: skip
    worker = {
        "cls": Nanny,
        "options": {
            **shared, "worker_class": SilentWorker, "nthreads": 1, "memory_limit": 0, "local_directory": folder,
            "silence_logs": ERRORS_ONLY,
        },
    }  # fmt: skip
    return SpecCluster(
        scheduler={"cls": SilentScheduler, "options": {**shared, "port": 0}},
        workers={number: worker for number in range(workers)},
        security=security,
        silence_logs=ERRORS_ONLY,
    )


def connect(scheduler: str, security: str | Path | None, timeout_s: float) -> Client:
    """Connect to a scheduler that runs already.

    Raises:
        NacreError: it cannot be reached, or it does not take what `security` names.
    """
    given = None if security is None else read_security(security)
    if given is not None and not scheduler.startswith("tls://"):
        raise NacreError(f"--scheduler {scheduler}: with --security the address begins with tls://")
    if given is None and scheduler.startswith("tls://"):
        raise NacreError(f"--scheduler {scheduler}: needs --security FILE.toml with ca, cert and key")
    try:
        return Client(scheduler, security=given, timeout=timeout_s)
    except (OSError, TimeoutError, ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())[:200]
        raise NacreError(f"--scheduler {scheduler}: cannot be reached: {reason}") from None


__all__ = ["connect", "local_cluster", "read_security"]
