"""The wheel installs without a network and finds its data, its command and its examples; all works after it."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from PIL import Image
from tools import release

from nacre import __version__
from nacre.device import llvm

ROOT = Path(__file__).resolve().parents[1]


QUIET = {"check": True, "capture_output": True, "timeout": 300}
PIP = ["-m", "pip", "--disable-pip-version-check"]
INSTALL_S = 480  # with a warm cache of pip's some 60 s; without, the time to fetch 500 MB
FILM = """family = "film"
substrate = "Si"
layers = [{material = "SiO2", thickness_nm = 300}]
"""
SWEEP = """recipe = "film.toml"
[axes]
"layers[0].thickness_nm" = [100, 200]
"""
TARGET = """family = "relief"
features = 8
feature_um = 1.5
blur_um = 0.5
height_max_um = 0.6
coating = "Al"
coherence = {sigma = 0.8}
spectrum = "published-8"
[target]
kind = "anti-mirror"
colour = "white"
range = 0.3
resolution = 12
intensity_scale = 0.2
[search]
starts = 1
perturbed_restarts = 1
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel, offline, from a copy: two test processes that built in one checkout would undo each other."""
    folder, copy = tmp_path_factory.mktemp("wheel"), tmp_path_factory.mktemp("copy")
    for name in ("src", "examples"):
        shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))
    for file in ROOT.iterdir():
        if file.is_file():
            shutil.copy2(file, copy)
    build = ["wheel", ".", "--no-deps", "--no-build-isolation", "--no-index", "-w", str(folder)]
    done = subprocess.run([sys.executable, *PIP, *build], cwd=copy, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    (found,) = folder.glob("nacre-*.whl")
    return found


@pytest.fixture(scope="module")
def installed(wheel: Path) -> Path:
    """Install the wheel, offline, into a folder of its own."""
    target = wheel.parent / "prefix"
    # without --ignore-installed pip would first remove the checkout's own installation, prefix or not
    apart = ["--no-index", "--no-deps", "--ignore-installed", "--prefix", str(target)]
    subprocess.run([sys.executable, *PIP, "install", *apart, str(wheel)], **QUIET)
    return target


def test_the_conda_recipe_has_the_digest_of_the_sdist(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sdist = tmp_path / "nacre-2.0.1.tar.gz"
    sdist.write_bytes(b"packed")
    recipe = yaml.safe_load(release.conda_recipe(sdist))
    assert recipe["context"]["version"] == "2.0.1"
    assert recipe["source"]["sha256"] == hashlib.sha256(b"packed").hexdigest()
    kept = yaml.safe_load((ROOT / "packaging" / "conda" / "recipe.yaml").read_text())
    assert {**recipe, "context": 0, "source": 0} == {**kept, "context": 0, "source": 0}
    (tmp_path / "packaging" / "conda").mkdir(parents=True)
    (tmp_path / "packaging" / "conda" / "recipe.yaml").write_text('context:\n  version: "1"\n')
    monkeypatch.setattr(release, "ROOT", tmp_path)
    with pytest.raises(SystemExit):
        release.conda_recipe(sdist)


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
        "from nacre.cli.gallery import load_gallery\nfrom nacre.material.examples import examples_folder\n"
        "folder = examples_folder(); gallery = load_gallery(folder); print(folder)\n"
        "print(all((folder / p.recipe).exists() for p in gallery.picture if '.toml' in p.recipe))\n"
        "print(all((folder / d.target).exists() for d in gallery.design))",
    )
    assert said.splitlines()[0].startswith(str(installed))
    assert said.splitlines()[1:] == ["True", "True"]


def test_the_wheel_brings_the_page_of_the_studio(installed: Path) -> None:
    page = ROOT / "src" / "nacre" / "studio" / "page"
    wanted = {path.name: path.stat().st_size for path in page.iterdir()}
    (found,) = installed.glob("lib/python*/site-packages/nacre/studio/page")
    assert {path.name: path.stat().st_size for path in found.iterdir()} == wanted
    assert sum(wanted.values()) < 1_000_000  # what a page may weigh


def test_the_command_is_installed(installed: Path) -> None:
    command = [sys.executable, str(installed / "bin" / "nacre"), "--version"]
    (site,) = installed.glob("lib/python*/site-packages")
    bare = {**os.environ, "PYTHONPATH": str(site)}
    said = subprocess.run(command, capture_output=True, text=True, timeout=60, env=bare)
    assert said.returncode == 0 and __version__ in said.stdout, said.stderr


@pytest.mark.full
@pytest.mark.timeout(1200)
@pytest.mark.skipif(platform.machine() != "x86_64" or sys.platform != "linux", reason="pip brings an LLVM there only")
def test_after_pip_install_alone_everything_works_outside_the_checkout(wheel: Path, tmp_path: Path) -> None:
    """A new environment, no variable that names an LLVM, none of apt's: pictures, a design, a sweep, the examples."""
    home = tmp_path / "home"
    home.mkdir()
    place = home / "venv"
    named = ("LLVM", "NACRE", "DRJIT", "LD_", "PYTHON", "VIRTUAL_ENV", "NUMBA", "XDG", "COV")
    bare = {name: value for name, value in os.environ.items() if not any(part in name for part in named)}
    environment = {**bare, "HOME": str(home), "PATH": f"{place / 'bin'}:/usr/bin:/bin"}
    # without its own pip, which the outer one brings: Debian packs ensurepip apart
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(place)], **QUIET)
    python = place / "bin" / "python"
    arguments = ["--python", str(python), "install", "--no-compile", "-c", str(ROOT / "constraints.txt")]
    command = [sys.executable, *PIP, *arguments, f"{wheel}[study]"]
    done = subprocess.run(command, env=bare, capture_output=True, text=True, timeout=INSTALL_S)
    assert done.returncode == 0, done.stderr

    def nacre(*words: str) -> str:
        done = subprocess.run(
            [str(place / "bin" / "nacre"), *words], cwd=home, env=environment, capture_output=True, text=True,
            timeout=300,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        assert "scalar_spectral" not in done.stderr
        return done.stdout

    for name, text in (("film.toml", FILM), ("sweep.toml", SWEEP), ("target.toml", TARGET)):
        (home / name).write_text(text)
    findings = {f["what"]: f for f in json.loads(nacre("doctor", "--json"))}
    assert findings["LLVM"]["found"].startswith(f"{llvm.WHEEL} {llvm.WHEEL_VERSION}: {place}")
    assert all(f["state"] != "bad" for f in findings.values()), findings
    nacre("render", "film.toml", "--size", "64x64", "--spp", "16", "-o", "film.png")
    with Image.open(home / "film.png") as picture:
        assert '"variant": "llvm_ad_spectral"' in picture.text["nacre"]  # and not the interpreter, which takes minutes
    nacre("design", "target.toml", "-o", "design")
    nacre("render", "design", "--size", "64x64", "--spp", "16", "-o", "design.png")
    nacre("sweep", "sweep.toml", "-o", "sweep.zarr", "--jobs", "1")
    code = "from nacre.material.examples import examples_folder; print(examples_folder())"
    said = subprocess.run([str(python), "-c", code], cwd=home, env=environment, capture_output=True, text=True)
    examples = Path(said.stdout.strip())
    assert examples.is_relative_to(place)
    for recipe in ("morpho.toml", "pearl/mcs1.toml"):
        nacre("render", str(examples / recipe), "--size", "64x64", "--spp", "16", "-o", "example.png")
        assert picture_is_lit(home / "example.png")
    assert picture_is_lit(home / "film.png") and picture_is_lit(home / "design.png")


def picture_is_lit(path: Path) -> bool:
    with Image.open(path) as picture:
        return max(high for _, high in picture.convert("RGB").getextrema()) > 100
