"""Ctrl-C: at once before there is a pass, and with the passes done after it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

import nacre
from nacre.cli.common import STOPPED_EARLY

# a render whose material stays for ever in compiled code, which no signal breaks off: it reports when it has begun
SLOW = """
import ctypes
import sys
from nacre.cli import main
from nacre.material.material import Material

def bsdf(self, *arguments, **options):
    print("solving", flush=True)
    lock, mutex = ctypes.CDLL(None).pthread_mutex_lock, ctypes.create_string_buffer(64)
    lock(mutex)
    lock(mutex)

Material.bsdf = bsdf
main(sys.argv[1:])
"""

pytestmark = pytest.mark.render


def test_before_the_first_pass_a_render_leaves_at_once(tmp_path: Path) -> None:
    picture = tmp_path / "a.png"
    command = [sys.executable, "-c", SLOW, "render", "copper", "-o", str(picture)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "solving\n"
        time.sleep(0.5)
        process.send_signal(signal.SIGINT)
        try:
            reported = process.communicate(timeout=60)[1]
        finally:
            process.kill()
    assert process.returncode == 130
    assert reported == f"{STOPPED_EARLY}\n"
    assert list(tmp_path.iterdir()) == []


def test_who_leaves_at_once_says_so_once() -> None:
    """The main thread also receives the interrupt; it must not report it again while the process ends."""
    code = """
import os, signal, time
from nacre.picture.interrupt import leaving_at_once
leave = os._exit
os._exit = lambda status: (time.sleep(0.5), leave(status))
try:
    with leaving_at_once(130, lambda: "stopped"):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(5)
except KeyboardInterrupt:
    time.sleep(0.1)
    os.write(2, b"stopped\\n")
    leave(130)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 130
    assert done.stderr == "stopped\n"


@pytest.mark.parametrize("delay_s", [0.05, 0.3, 0.7])
def test_after_it_the_passes_done_are_written(tmp_path: Path, delay_s: float) -> None:
    """The interrupt comes while the renderer works, where Python's own would come out as another error."""

    def ask(done: int, total: int, seconds_left: float) -> None:
        if done == 1:
            threading.Timer(delay_s, os.kill, (os.getpid(), signal.SIGINT)).start()

    silicon = nacre.material({"family": "film", "substrate": "Si", "surface": {"roughness": 0.2}})
    result = nacre.render(silicon, size=(600, 500), spp=4096, output=tmp_path / "a.png", progress=ask)
    assert result.stats["interrupted"] and 0 < result.stats["spp"] < 4096
    assert (tmp_path / "a.png").exists()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
