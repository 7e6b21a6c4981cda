"""The wheel installs without a network and finds its data, its command and its examples."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from nacre import __version__

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel and install it, offline, into a folder of its own."""
    folder = tmp_path_factory.mktemp("wheel")
    quiet = {"cwd": ROOT, "check": True, "capture_output": True, "timeout": 300}
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
    subprocess.run([*pip, "wheel", ".", "--no-deps", "--no-build-isolation", "--no-index", "-w", str(folder)], **quiet)
    (wheel,) = folder.glob("nacre-*.whl")
    target = folder / "prefix"
    # without --ignore-installed pip would first remove the checkout's own installation, prefix or not
    apart = ["--no-index", "--no-deps", "--ignore-installed", "--prefix", str(target)]
    subprocess.run([*pip, "install", *apart, str(wheel)], **quiet)
    return target


def run_installed(installed: Path, code: str) -> str:
    (site,) = installed.glob("lib/python*/site-packages")
    environment = {**os.environ, "PYTHONPATH": str(site)}
    done = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.prefix = {str(installed)!r}\n{code}"],
        capture_output=True, text=True, env=environment, cwd=installed, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_wheel_holds_the_code_and_its_data(installed: Path) -> None:
    said = run_installed(
        installed,
        "import nacre; from nacre.light import white_xyz\n"
        "print(nacre.__file__); print(white_xyz('F11')[1])\n"
        "print(nacre.material({'family': 'film', 'substrate': 'Si'}).spectrum([0.0]).specular_reflectance.max() > 0.3)",
    )
    assert str(installed) in said.splitlines()[0]
    assert said.splitlines()[2] == "True"


def test_the_wheel_brings_the_examples_of_the_demo(installed: Path) -> None:
    said = run_installed(
        installed,
        "from nacre.cli.gallery import load_gallery\nfrom nacre.materials.examples import examples_folder\n"
        "folder = examples_folder(); gallery = load_gallery(folder); print(folder)\n"
        "print(all((folder / p.recipe).exists() for p in gallery.picture if '.toml' in p.recipe))\n"
        "print(all((folder / d.target).exists() for d in gallery.design))",
    )
    assert said.splitlines()[0].startswith(str(installed))
    assert said.splitlines()[1:] == ["True", "True"]


def test_the_command_is_installed(installed: Path) -> None:
    command = [sys.executable, str(installed / "bin" / "nacre"), "--version"]
    (site,) = installed.glob("lib/python*/site-packages")
    bare = {**os.environ, "PYTHONPATH": str(site)}
    said = subprocess.run(command, capture_output=True, text=True, timeout=60, env=bare)
    assert said.returncode == 0 and __version__ in said.stdout, said.stderr
