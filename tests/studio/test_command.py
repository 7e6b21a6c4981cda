"""`nacre studio` in a terminal: what it opens, what it prints, and what it says when it cannot."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

from nacre.cli import run
from nacre.studio.server import HEADER

FILES = 512  # that a server may have open; half of what Linux gives


def test_folders_and_files_that_cannot_be_opened_are_one_line(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    for what, words in ((empty, "no recipe"), (tmp_path / "none.toml", "no such file"), (__file__, "is not a recipe")):
        assert run(["studio", str(what), "--no-browser"]) == 2
        said = capsys.readouterr()
        assert words in said.err and said.err.count("\n") == 1 and not said.out


def test_a_port_in_use_is_one_line(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen(1)
        port = taken.getsockname()[1]
        assert run(["studio", str(folder), "--no-browser", "--port", str(port)]) == 2
    said = capsys.readouterr()
    assert f"--port {port}: address already in use" in said.err and said.err.count("\n") == 1 and not said.out


def test_the_command_prints_one_address_and_listens_on_loopback_alone(folder: Path) -> None:
    command = [sys.executable, "-m", "nacre", "studio", str(folder), "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None and process.stderr is not None
            address = process.stdout.readline().strip()
            assert address.startswith("http://127.0.0.1:") and "?token=" in address
            port = int(address.split(":")[2].split("/")[0])
            with socket.create_connection(("127.0.0.1", port), timeout=60) as open_one:
                open_one.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nConnection: close\r\n\r\n".encode())
                assert b" 403 " in open_one.recv(100)
        finally:
            process.send_signal(2)
            out, err = process.communicate(timeout=120)
    assert out == "" and "Traceback" not in err and process.returncode == 130


TRIANGLE = b"v 0 0 0\nv 1 0 0\nv 0 0 1\nf 1 2 3\n"


@pytest.mark.skipif(sys.platform == "win32", reason="no such signals")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_without_a_browser_the_server_serves_on_and_a_signal_removes_its_meshes(
    folder: Path, tmp_path: Path, number: signal.Signals
) -> None:
    command = [sys.executable, "-m", "nacre", "studio", str(folder), "--port", "0"]
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    environment = {**os.environ, "BROWSER": "/no/such/browser", "TMPDIR": str(temporary)}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    ) as process:
        assert process.stdout is not None and process.stderr is not None
        try:
            address = process.stdout.readline().strip()
            assert "no browser" in process.stderr.readline()
            assert process.poll() is None
            place, _, token = address.partition("?token=")
            asked = urllib.request.Request(f"{place}api/mesh?name=a.obj", TRIANGLE, {HEADER: token})
            with urllib.request.urlopen(asked, timeout=60):
                assert list(temporary.glob("nacre-studio-meshes-*/*.ply"))
            process.send_signal(number)
            assert process.wait(60) == 128 + signal.SIGTERM
        finally:
            process.kill()
    assert not list(temporary.glob("nacre-studio-meshes-*"))


@pytest.mark.skipif(sys.platform == "win32", reason="no limit of open files to reach")
def test_half_requests_without_number_do_not_keep_the_page_from_being_answered(folder: Path) -> None:
    # The limit is set by a process of its own, which then becomes the command: a `preexec_fn` would fork this one,
    # which has threads once a test before it in the same worker has imported JAX.
    few_files = f"import resource, os, sys; resource.setrlimit(resource.RLIMIT_NOFILE, ({FILES}, {FILES})); "
    command = [sys.executable, "-c", few_files + "os.execv(sys.executable, [sys.executable, *sys.argv[1:]])"]
    command += ["-m", "nacre", "studio", str(folder), "--no-browser", "--port", "0"]
    with contextlib.ExitStack() as held:
        process = held.enter_context(
            subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        )
        held.callback(process.kill)
        assert process.stdout is not None
        port = int(process.stdout.readline().split(":")[2].split("/")[0])
        half = [held.enter_context(socket.create_connection(("127.0.0.1", port), timeout=60)) for _ in range(FILES)]
        for one in half:
            with contextlib.suppress(OSError):  # it may be closed already
                one.sendall(b"GET / HTTP/1.1\r\nHost: loc")
        with socket.create_connection(("127.0.0.1", port), timeout=60) as whole:
            whole.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nConnection: close\r\n\r\n".encode())
            assert b" 403 " in whole.recv(100)
        process.kill()
        assert process.communicate()[1] == ""  # nor is the terminal filled with the system's complaints
