"""Build the sdist and the wheel of the committed tree twice, check them, and install both into empty environments.

`python -m tools.release [--sizes] [--out dist]`: writes the two files, the recipe for conda-forge with the sdist's
digest, and `release.json` with hashes, sizes, the Pythons that were run and those that were not, and with --sizes the
megabytes of each extra. Fails if both builds differ, a check complains, the wheel is above 15 MB, or
an installed command does not succeed.
"""

from __future__ import annotations

import argparse
import gzip
import hashlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PYTHONS = ("3.11", "3.12", "3.13")
MAX_WHEEL_MB = 15.0
TOOLS = ("build", "setuptools>=77", "twine", "check-wheel-contents")
USER_EXTRAS = ("studio", "study", "notebook", "gradient")
FILM = """family = "film"
substrate = "Ti"
layers = [{material = "TiO2-film", thickness_nm = 120}]

[surface]
distribution = "ggx"
roughness = 0.1
"""


def call(command: Sequence[str | Path], folder: Path | None = None, **variables: str) -> str:
    """Run a command and return its output.

    Raises:
        SystemExit: it failed; the message ends with its output.
    """
    done = subprocess.run(
        [str(word) for word in command], cwd=folder, env={**os.environ, **variables}, capture_output=True, text=True
    )
    if done.returncode:
        raise SystemExit(
            f"release: {' '.join(map(str, command))}: status {done.returncode}\n{done.stdout}{done.stderr}"
        )
    return done.stdout


def sha256(path: Path) -> str:
    """Return the digest of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def normalise(sdist: Path, epoch: int) -> None:
    """Rewrite an sdist with sorted names, one time, one owner and plain modes: equal content gives equal bytes."""
    packed = io.BytesIO()
    with tarfile.open(sdist) as source, tarfile.open(fileobj=packed, mode="w", format=tarfile.PAX_FORMAT) as target:
        for member in sorted(source.getmembers(), key=lambda one: one.name):
            plain = tarfile.TarInfo(member.name)
            plain.size, plain.mtime, plain.type = member.size, epoch, member.type
            plain.mode = 0o755 if member.isdir() or member.mode & 0o100 else 0o644
            target.addfile(plain, source.extractfile(member) if member.isfile() else None)
    with sdist.open("wb") as out, gzip.GzipFile("", "wb", 9, out, mtime=epoch) as file:
        file.write(packed.getvalue())


def build(python: Path, epoch: int, out: Path) -> list[Path]:
    """Build both files from a new copy of the committed tree; the wheel is made from the sdist."""
    with tempfile.TemporaryDirectory() as folder:
        archive = subprocess.run(["git", "archive", "HEAD"], cwd=ROOT, capture_output=True, check=True).stdout
        with tarfile.open(fileobj=io.BytesIO(archive)) as packed:
            packed.extractall(folder, filter="data")
        out.mkdir(parents=True, exist_ok=True)
        call(
            [python, "-m", "build", "--no-isolation", "-q", "-o", out, "."], Path(folder), SOURCE_DATE_EPOCH=str(epoch)
        )
    for sdist in out.glob("*.tar.gz"):
        normalise(sdist, epoch)
    return sorted(out.glob("nacre-*"))


def find_pythons() -> dict[str, str]:
    """Return the interpreters of `PYTHONS` that this machine has: this one, on the path, or of pyenv."""
    found = {f"{sys.version_info[0]}.{sys.version_info[1]}": sys.executable}
    root = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    for name in PYTHONS:
        named = [*map(str, root.glob(f"{name}.*/bin/python{name}")), shutil.which(f"python{name}")]
        for path in filter(None, named):
            if subprocess.run([path, "-c", ""], capture_output=True).returncode == 0:
                found.setdefault(name, path)
    return {name: found[name] for name in PYTHONS if name in found}


def make_environment(python: str, place: Path) -> Path:
    """Make an empty environment without its own pip (Debian packs ensurepip apart); return its python."""
    call([python, "-m", "venv", "--without-pip", place])
    return place / "bin" / "python"


def pip(python: Path, *words: str | Path) -> str:
    """Run this Python's pip for another environment."""
    return call([sys.executable, "-m", "pip", "--disable-pip-version-check", "-q", "--python", python, *words])


def megabytes(python: Path) -> float:
    """Return the size of an environment's packages in 10^6 bytes."""
    (site,) = python.parents[1].glob("lib/python*/site-packages")
    return round(
        sum(f.stat().st_size for f in site.rglob("*") if f.is_file() and "__pycache__" not in f.parts) / 1e6, 1
    )


def readme_commands() -> list[str]:
    """Return the commands of the README's section on one's own material."""
    text = (ROOT / "README.md").read_text(encoding="utf-8").partition("## Five minutes")[2]
    block = re.search(r"```bash\n(nacre spectrum titanium.*?)```", text, re.DOTALL)
    assert block is not None, "README.md: the commands of the section on one's own material are missing"
    return [line.partition("#")[0].strip() for line in block[1].splitlines() if line.startswith("nacre")]


def check_installed(python: str, package: Path, commands: Sequence[str]) -> dict[str, Any]:
    """Install a file into an empty environment and run commands from an empty home; return the seconds of each."""
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        started = time.monotonic()
        inside = make_environment(python, home / "venv")
        pip(inside, "install", package)
        taken: dict[str, Any] = {"install": round(time.monotonic() - started, 1)}
        (home / "titanium.toml").write_text(FILM, encoding="utf-8")
        clean = {name: value for name, value in os.environ.items() if not re.match("NACRE|PYTHON|VIRTUAL|XDG", name)}
        clean.update(HOME=folder, PATH=f"{inside.parent}:/usr/bin:/bin")
        for command in ("nacre --version", *commands):
            started = time.monotonic()
            done = subprocess.run(command.split(), cwd=home, env=clean, capture_output=True, text=True)
            if done.returncode:
                raise SystemExit(f"release: {package.name} on {python}: {command}: {done.stderr}")
            taken[command] = round(time.monotonic() - started, 1)
        return taken


def conda_recipe(sdist: Path) -> str:
    """Return the recipe for conda-forge with the version and the digest of an sdist.

    Raises:
        SystemExit: the recipe has no place for one of them, or needs something else than the package.
    """
    text = (ROOT / "packaging" / "conda" / "recipe.yaml").read_text(encoding="utf-8")
    values = {"version": sdist.name.removeprefix("nacre-").removesuffix(".tar.gz"), "sha256": sha256(sdist)}
    for key, value in values.items():
        text, count = re.subn(rf'^(  {key}: )".*"$', rf'\g<1>"{value}"', text, flags=re.MULTILINE)
        if count != 1:
            raise SystemExit(f"release: packaging/conda/recipe.yaml has {count} lines of {key}; it needs one")
    return text


def extra_sizes(wheel: Path) -> dict[str, float]:
    """Return the megabytes of the core and what each extra adds."""
    sizes: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name in ("", *USER_EXTRAS):
            inside = make_environment(sys.executable, Path(folder) / (name or "core"))
            pip(inside, "install", "--no-compile", f"{wheel}[{name}]" if name else wheel)
            sizes[name or "core"] = round(megabytes(inside) - sizes.get("core", 0.0), 1)
    return sizes


def main(argv: Sequence[str] | None = None) -> int:
    """Make the release files and check them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "dist")
    parser.add_argument("--sizes", action="store_true", help="install every extra and state its megabytes")
    parser.add_argument("--no-install", action="store_true", help="build and check only")
    options = parser.parse_args(argv)
    out = options.out.resolve()
    epoch = int(call(["git", "log", "-1", "--format=%ct"], ROOT))
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        tools = make_environment(sys.executable, place / "tools")
        pip(tools, "install", *TOOLS)
        first, second = (build(tools, epoch, place / name) for name in ("one", "two"))
        hashes = {path.name: sha256(path) for path in first}
        if hashes != {path.name: sha256(path) for path in second} or len(hashes) != 2:
            raise SystemExit("release: two builds of one commit differ")
        wheel = next(path for path in first if path.suffix == ".whl")
        call([tools, "-m", "twine", "check", "--strict", *first])
        call([tools.parent / "check-wheel-contents", wheel])
        out.mkdir(parents=True, exist_ok=True)
        made = [Path(shutil.copy2(path, out)) for path in first]
    sdist = next(path for path in made if path.name.endswith(".tar.gz"))
    (out / "recipe.yaml").write_text(conda_recipe(sdist), encoding="utf-8")
    wheel = out / wheel.name
    size = round(wheel.stat().st_size / 1e6, 2)
    if size > MAX_WHEEL_MB:
        raise SystemExit(f"release: {wheel.name} has {size} MB; at most {MAX_WHEEL_MB:g}")
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    pythons = {} if options.no_install else find_pythons()
    result: dict[str, Any] = {
        "sha256": hashes, "wheel_MB": size, "extras": {name: extras[name] for name in USER_EXTRAS},
        "installed": {
            f"{name} {path.name.rpartition('.')[2]}": check_installed(python, path, readme_commands())
            for name, python in pythons.items() for path in made
        },
        "not_run": [name for name in PYTHONS if name not in pythons],
    }  # fmt: skip
    if options.sizes:
        result["extras_MB"] = extra_sizes(wheel)
    (out / "release.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(result, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
