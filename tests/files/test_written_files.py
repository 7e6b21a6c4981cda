"""Files are written whole or not at all; devices stay devices; killed runs leave nothing behind for long."""

from __future__ import annotations

import os
import signal
import stat
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from nacre.core.errors import NacreError
from nacre.core.files import Process, atomic_path, check_writable, read_text, short_name, write_text

HANG = (
    "import sys, time\nfrom nacre.core.files import atomic_path\n"
    "with atomic_path(sys.argv[1]):\n    print(flush=True)\n"
)


def writer(path: Path) -> subprocess.Popen[str]:
    """Start a process that is in the middle of writing `path`."""
    code = HANG + "    time.sleep(60)\n"
    process = subprocess.Popen([sys.executable, "-c", code, str(path)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    with process.stdout:
        process.stdout.readline()
    return process


def test_a_pipe_gets_the_bytes_and_stays_a_pipe(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.csv"
    os.mkfifo(pipe)
    read: list[str] = []
    reader = threading.Thread(target=lambda: read.append(pipe.read_text()), daemon=True)
    reader.start()
    write_text(pipe, "0.5\n")
    reader.join(10)
    assert read == ["0.5\n"]
    assert stat.S_ISFIFO(pipe.lstat().st_mode)
    assert os.listdir(tmp_path) == ["pipe.csv"]


def test_a_device_stays_a_device(tmp_path: Path) -> None:
    node = tmp_path / "null.csv"
    try:
        os.mknod(node, stat.S_IFCHR | 0o666, os.makedev(1, 3))
        node.write_text("a device may be made here, but not used")
    except OSError:
        pytest.skip("device nodes cannot be made here")
    write_text(node, "0.5\n")
    assert stat.S_ISCHR(node.lstat().st_mode)


def test_a_link_is_followed_and_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "link.csv").symlink_to("/dev/null")
    write_text(tmp_path / "link.csv", "0.5\n")
    assert os.readlink(tmp_path / "link.csv") == "/dev/null"
    (tmp_path / "other.csv").symlink_to("real.csv")
    write_text(tmp_path / "other.csv", "0.5\n")
    assert (tmp_path / "other.csv").is_symlink() and (tmp_path / "real.csv").read_text() == "0.5\n"


def test_a_socket_is_refused(tmp_path: Path) -> None:
    import socket

    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "s"))
        with pytest.raises(NacreError, match="cannot be written as a file"):
            check_writable(tmp_path / "s")


def test_the_next_run_removes_what_a_killed_one_was_writing(tmp_path: Path) -> None:
    process = writer(tmp_path / "out.csv")
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert len(os.listdir(tmp_path)) == 1
    write_text(tmp_path / "out.csv", "0.5\n")
    assert os.listdir(tmp_path) == ["out.csv"]


def test_what_a_living_process_writes_is_left_alone(tmp_path: Path) -> None:
    process = writer(tmp_path / "out.csv")
    try:
        write_text(tmp_path / "out.csv", "0.5\n")
        assert len(os.listdir(tmp_path)) == 2
    finally:
        process.kill()
        process.wait()


def test_a_number_that_another_process_got_later_is_not_the_same_process() -> None:
    this = Process.this()
    assert not this.is_dead
    assert Process(this.host, this.pid, this.started - 1).is_dead
    assert not Process("elsewhere", this.pid, this.started - 1).is_dead


def test_a_failed_write_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="half-way"), atomic_path(tmp_path / "out.csv") as temporary:
        temporary.write_text("0.")
        raise ValueError("half-way")
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("path", "name"),
    [("soap.toml", "soap"), ("sign/recipe.toml", "sign"), ("sign", "sign"), ("sign/2", "sign-2"),
     ("sign/2/recipe.toml", "sign-2"), ("v1.5", "v1.5"), ("2.toml", "2"), ("recipe", "recipe")],
)  # fmt: skip
def test_what_is_made_of_a_design_is_called_after_its_folder(tmp_path: Path, path: str, name: str) -> None:
    for folder in ("sign/2", "v1.5"):
        (tmp_path / folder).mkdir(parents=True)
    assert short_name(tmp_path / path) == name


@pytest.mark.parametrize("mask", [0o022, 0o077])
def test_a_new_file_has_the_permissions_of_any_new_file(mask: int, tmp_path: Path) -> None:
    """Without a change of the process-wide mask, which other threads share."""
    code = "import os, sys; os.umask(int(sys.argv[2])); from nacre.core.files import write_text\n"
    code += "write_text(sys.argv[1], 'x')\nos.umask(0o007)\nwrite_text(sys.argv[1] + '2', 'x')"
    path = tmp_path / "a.txt"
    subprocess.run([sys.executable, "-c", code, str(path), str(mask)], check=True)
    assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~mask
    assert stat.S_IMODE((tmp_path / "a.txt2").stat().st_mode) == 0o660


def test_pipes_are_read_to_their_end_and_refused_without_a_writer(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.toml"
    os.mkfifo(pipe)
    with pytest.raises(NacreError, match="pipe"):
        read_text(pipe)
    text = "x" * 200_000
    sender = threading.Thread(target=lambda: pipe.write_text(text), daemon=True)
    sender.start()
    assert read_text(pipe) == text
    sender.join(10)
