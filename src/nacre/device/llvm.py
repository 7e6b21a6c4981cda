"""Find a libLLVM that Dr.Jit can use, and test it in a process of its own.

Mitsuba on the CPU compiles its kernels with whatever LLVM it finds when drjit is imported. LLVM 14 is refused
by drjit and 15 and 16 abort the whole process at the first minimum or maximum, so a library is never trusted
by its name: a child process loads it, compiles a small kernel and compares the numbers. The verdict is kept in
the user's cache folder under the file's path, size and time, so that only the first start pays for it.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import glob
import json
import os
import platform
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

ENVIRONMENT_VARIABLE = "DRJIT_LIBLLVM_PATH"
PROJECT_VARIABLE = "NACRE_PROJECT"  # the checkout, set by make
PREFERRED_VERSIONS = (19, 20, 21, 22)
UNTRIED_VERSIONS = (18, 17)
PROBE_TIMEOUT_S = 120
WHEEL = "karellen-llvm-core"  # a libLLVM on the package index: Apache-2.0, Linux x86-64, a dependency there
WHEEL_VERSION = "19.1.7"  # as in pyproject.toml; the series that the pictures were checked with

# The kernel uses what kills old versions (minimum, maximum) and what the plugins live on: a gather, a loop.
_PROBE = """
import ctypes
import sys
for name in sys.argv[1:]:
    ctypes.CDLL(name)
import drjit as dr
from drjit.llvm.ad import Float, UInt32
x = dr.arange(Float, 37) * 0.25
y = dr.gather(Float, dr.minimum(dr.maximum(x, 2.0), 7.0), UInt32(dr.arange(UInt32, 37)))
i, s = dr.while_loop((UInt32(0), Float(y)), lambda i, s: i < 3, lambda i, s: (i + 1, dr.fma(s, 2.0, 1.0)))
good = all(abs(float(s[k]) - (8 * min(max(k * 0.25, 2.0), 7.0) + 7)) < 1e-3 for k in range(37))
version = ".".join(str(v) for v in dr.detail.llvm_version())
print(version if good else "wrong numbers")
sys.exit(0 if good else 3)
"""


@dataclass(frozen=True)
class Probe:
    """The verdict on one library.

    Attributes:
        path: the library; "" is drjit's own search.
        version: what drjit says of it, such as "19.1.7".
        reason: why it fails; empty if it works.
        needs: libraries that must be loaded before it (see `companions`).
    """

    path: str
    version: str
    reason: str
    needs: tuple[str, ...] = ()

    @property
    def works(self) -> bool:
        """Whether a kernel compiled and gave the right numbers."""
        return not self.reason


def advice(system: str | None = None, machine: str | None = None) -> str:
    """Return the command that brings a good LLVM to a machine, this one by default, in one sentence.

    Args:
        system: as `platform.system()` says it: "Linux", "Darwin", "Windows".
        machine: as `platform.machine()` says it: "x86_64", "aarch64", "arm64".
    """
    system, machine = system or platform.system(), machine or platform.machine()
    if system == "Darwin":
        return "On macOS: `brew install llvm`; nacre finds it where Homebrew puts it"
    if system == "Windows":
        return (
            "On Windows: `winget install LLVM.LLVM`; nacre finds it in C:\\Program Files\\LLVM, or set "
            f"{ENVIRONMENT_VARIABLE} to the path of its LLVM-C.dll"
        )
    if system == "Linux" and machine == "x86_64":
        return (
            f"`pip install {WHEEL}=={WHEEL_VERSION}` in this Python's environment (no root needed); or install "
            f"LLVM 19 or newer and set {ENVIRONMENT_VARIABLE} to its libLLVM.so"
        )
    return (
        "On Debian or Ubuntu: `apt-get install libllvm19` or, without root, `make setup` in a checkout; on Fedora: "
        f"`dnf install llvm-libs`; elsewhere install LLVM 19 or newer and set {ENVIRONMENT_VARIABLE} to its libLLVM.so"
    )


@functools.cache
def find_llvm() -> tuple[Probe | None, tuple[Probe, ...]]:
    """Return the library to use, or None, and every verdict on the way to it.

    The library of the environment variable comes first; when it fails, the search goes on and the report
    keeps the reason, since a picture from another LLVM is better than no picture.
    """
    tried: list[Probe] = []
    for path in candidates():
        probe = probe_library(path)
        tried.append(probe)
        if probe.works:
            return probe, tuple(tried)
    return None, tuple(tried)


def use_llvm() -> Probe | None:
    """Point drjit to a working library; call it before drjit is imported.

    When drjit is already in memory its choice is fixed, so that choice is judged instead.
    """
    if "drjit" in sys.modules:
        return _judge_loaded()
    found, _ = find_llvm()
    if found is not None and found.path:
        os.environ[ENVIRONMENT_VARIABLE] = found.path
        for name in found.needs:
            ctypes.CDLL(name)
    return found


def companions(path: str) -> list[str]:
    """Return the libraries that must be in memory before `path` loads, in order.

    An LLVM that was unpacked without installing it stands beside its own libz3, libedit and so on, where the
    system's loader does not look; a library already in memory is taken by its name instead. The wheel's stands
    beside its own libc++, whose short name is made at the first start of an interpreter that may write there:
    in an environment that belongs to another user it may be lacking for ever.
    """
    if path in _wheel_libraries():
        root, ending = Path(path).parent, "*"
    elif ".llvm" in Path(path).parts:
        root, ending = Path(*Path(path).parts[: Path(path).parts.index(".llvm") + 1]), ""
    else:
        return []  # an installed LLVM finds its libraries by itself
    needed: list[str] = []
    for _ in range(20):
        missing = _missing_library([*needed, path])
        found = next(iter(sorted(root.rglob(missing + ending))), None) if missing else None
        if found is None or str(found) in needed:
            break
        needed.insert(0, str(found))  # what a companion needs must come before it
    return needed


def _missing_library(paths: list[str]) -> str | None:
    """Return the file name of the first library that cannot be found when `paths` are loaded in a child process."""
    script = "import ctypes, sys\nfor name in sys.argv[1:]: ctypes.CDLL(name)"
    done = subprocess.run([sys.executable, "-c", script, *paths], capture_output=True, text=True)
    match = re.search(r"OSError: (\S+): cannot open shared object file", done.stderr)
    return os.path.basename(match.group(1)) if done.returncode and match else None


def _judge_loaded() -> Probe | None:
    """Judge the LLVM that drjit loaded before nacre could choose one."""
    path = os.environ.get(ENVIRONMENT_VARIABLE, "")
    probe = probe_library(path)
    return probe if probe.works else None


def candidates() -> list[str]:
    """Return the libraries worth a probe, best first, without duplicates; "" is drjit's own search.

    The one named by the environment variable, then the wheel's, whose version is pinned, then what is installed.
    """
    given = os.environ.get(ENVIRONMENT_VARIABLE)
    found: dict[str, str] = {}
    for path in _installed():
        found.setdefault(os.path.realpath(path), path)
    ranked = sorted((rank, path) for path in found.values() if (rank := _rank(path)) is not None)
    listed = ([given] if given else []) + _wheel_libraries() + [path for _, path in ranked]
    return list(dict.fromkeys(listed)) + [""]


def _wheel_libraries() -> list[str]:
    """Return the libLLVM that pip installed for this Python, wherever it put it (a user's folder, a prefix)."""
    try:
        files = metadata.files(WHEEL) or []
    except metadata.PackageNotFoundError:
        return []
    named = [file for file in files if re.fullmatch(r"libLLVM\.so\.[\d.]+", file.name)]
    return sorted(path for file in named if os.path.exists(path := os.path.realpath(str(file.locate()))))


def wheel_version() -> str | None:
    """Return the version of the wheel with a libLLVM in this Python's environment, or None."""
    try:
        return metadata.version(WHEEL)
    except metadata.PackageNotFoundError:
        return None


def from_wheel(path: str) -> bool:
    """Whether a library is the one that the wheel brought."""
    return bool(path) and os.path.realpath(path) in _wheel_libraries()


def _installed() -> Iterator[str]:
    """Yield every libLLVM in the project's own folder and the usual places."""
    project = os.environ.get(PROJECT_VARIABLE)
    checkout = Path(__file__).resolve().parents[3]
    for folder in dict.fromkeys((Path(project) if project else checkout, checkout, Path.cwd())):
        yield from glob.glob(str(folder / ".llvm" / "**" / "libLLVM*.so*"), recursive=True)
    for pattern in (
        "/usr/lib/llvm-*/lib/libLLVM*.so*",
        "/usr/lib/*-linux-gnu/libLLVM*.so*",
        "/usr/lib64/libLLVM*.so*",
        "/usr/lib64/llvm*/lib*/libLLVM*.so*",
        "/usr/lib/libLLVM*.so*",
        "/usr/local/lib/libLLVM*.so*",
        os.path.join(sys.prefix, "lib", "libLLVM*.so*"),
        "/opt/homebrew/opt/llvm*/lib/libLLVM*.dylib",
        "/usr/local/opt/llvm*/lib/libLLVM*.dylib",
        os.path.join(os.environ.get("PROGRAMFILES", r"C:\Program Files"), "LLVM", "bin", "LLVM-C.dll"),
    ):
        yield from glob.glob(pattern)


def _rank(path: str) -> int | None:
    """Order a library by the version in its name; None for those known to fail, unknown ones last."""
    match = re.search(r"(?:libLLVM[-.](?:so\.|dylib\.)?|llvm[-@]?)(\d+)", os.path.realpath(path))
    version = int(match.group(1)) if match else None
    order = (*PREFERRED_VERSIONS, None, *UNTRIED_VERSIONS)
    if version in order:
        return order.index(version)
    return len(order) if version is not None and version > max(PREFERRED_VERSIONS) else None


def probe_library(path: str) -> Probe:
    """Try one library in a child process, or recall the verdict of an earlier trial."""
    key = _cache_key(path)
    cache = _read_cache()
    if key in cache:
        version, reason, *needs = cache[key]
        return Probe(path, version, reason, tuple(needs))
    probe = _run_probe(path)
    _write_cache(key, probe)
    return probe


def _run_probe(path: str) -> Probe:
    if path and not os.path.exists(path):
        return Probe(path, "", "the file does not exist")
    environment = {name: value for name, value in os.environ.items() if name != ENVIRONMENT_VARIABLE}
    if path:
        environment[ENVIRONMENT_VARIABLE] = path
    needs = companions(path)
    try:
        done = subprocess.run(
            [sys.executable, "-c", _PROBE, *needs],
            env=environment,
            capture_output=True,
            text=True,
            timeout=PROBE_TIMEOUT_S,
        )
    except subprocess.TimeoutExpired:
        return Probe(path, "", f"it gave no answer within {PROBE_TIMEOUT_S} s")
    except OSError as error:
        return Probe(path, "", f"it could not be tried: {error}")
    if done.returncode == 0:
        return Probe(path, done.stdout.strip(), "", tuple(needs))
    return Probe(path, "", _reason(done.returncode, done.stderr))


def _reason(status: int, message: str) -> str:
    """Put a failed probe into a few words."""
    if "No module named 'drjit'" in message:
        return "drjit is not installed"
    if match := re.search(r"LLVM ERROR: (Cannot select): .*?= (\w+)", message):
        return f"it cannot compile {match.group(2)}; LLVM 17 or newer is needed"
    if "backend is inactive" in message:
        return "drjit does not accept it (too old, or not an LLVM library)"
    lines = [line for line in message.strip().splitlines() if line.strip()]
    cause = f"signal {-status}" if status < 0 else f"status {status}"
    return f"a test kernel failed with {cause}" + (f": {lines[-1].strip()[:120]}" if lines else "")


def _cache_key(path: str) -> str:
    """Key by everything that may change the verdict: the file, drjit and the interpreter."""
    stamp = ""
    if path and os.path.exists(path):
        status = os.stat(path)
        stamp = f"{status.st_size}:{status.st_mtime_ns}"
    if not path:  # drjit's own search: any installed file may change its outcome
        stamp = ";".join(sorted(_installed()))
    return "|".join((path, stamp, _drjit_version(), sys.executable))


@functools.cache
def _drjit_version() -> str:
    """Of this process: a picture asks some twenty times, and each answer takes 4 ms."""
    try:
        return metadata.version("drjit")
    except metadata.PackageNotFoundError:
        return "none"


def _cache_file() -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    return Path(base) / "nacre" / "llvm.json"


def _read_cache() -> dict[str, list[str]]:
    try:
        data = json.loads(_cache_file().read_text())
    except (OSError, ValueError):
        return {}
    good = isinstance(data, dict)
    return {k: v for k, v in data.items() if isinstance(v, list) and len(v) >= 2} if good else {}


def _write_cache(key: str, probe: Probe) -> None:
    """Keep a verdict; a cache that cannot be written costs a second at each start and nothing else."""
    if probe.reason.startswith(("it gave no answer", "it could not be tried")):
        return  # the machine's fault perhaps, not the library's
    with contextlib.suppress(OSError):
        file = _cache_file()
        file.parent.mkdir(parents=True, exist_ok=True)
        data = {**_read_cache(), key: [probe.version, probe.reason, *probe.needs]}
        descriptor, name = tempfile.mkstemp(dir=file.parent, prefix=".llvm-")
        with os.fdopen(descriptor, "w") as out:
            json.dump(data, out, indent=1)
        os.replace(name, file)


if __name__ == "__main__":  # the set-up asks this way whether an LLVM works, and what to say if none does
    if sys.argv[1:] == ["--advice"]:
        sys.exit(print(advice()))
    sys.exit(0 if find_llvm()[0] is not None else 1)
