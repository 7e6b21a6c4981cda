"""Find a libLLVM for Dr.Jit, and test it in a subprocess.

Mitsuba's CPU variants compile kernels with the LLVM found when drjit is imported. drjit refuses LLVM 14, and 15 and 16
abort the process at the first minimum or maximum. A library's name is therefore insufficient: a subprocess loads it,
compiles a small kernel and checks the numbers. The result is cached in the user's cache folder under the file's path,
size and time.
"""

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

from nacre.core.files import plain

ENVIRONMENT_VARIABLE = "DRJIT_LIBLLVM_PATH"
PROJECT_VARIABLE = "NACRE_PROJECT"  # the checkout, set by make
PREFERRED_VERSIONS = (19, 20, 21, 22)
UNTRIED_VERSIONS = (18, 17)
PROBE_TIMEOUT_S = 120
FAST_GATHER = b"+fast-gather"  # LLVM's name
WHEEL = "karellen-llvm-core"  # a libLLVM wheel (Apache-2.0), a dependency on Linux x86-64
WHEEL_VERSION = "19.1.7"  # as in pyproject.toml; the version of the reference pictures

# The kernel uses the operations that fail in old versions (minimum, maximum), a gather and a loop.
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
    """The test result for one library.

    Attributes:
        path: the library; "" is drjit's own search.
        version: drjit's version string, such as "19.1.7".
        reason: reason of the failure; empty if it works.
        needs: libraries to load before it (see `companions`).
    """

    path: str
    version: str
    reason: str
    needs: tuple[str, ...] = ()

    @property
    def works(self) -> bool:
        """Whether a kernel compiled and gave correct numbers."""
        return not self.reason


def advice(system: str | None = None, machine: str | None = None) -> str:
    """Return one sentence with the command that installs a suitable LLVM, by default for this machine.

    Args:
        system: value of `platform.system()`: "Linux", "Darwin", "Windows".
        machine: value of `platform.machine()`: "x86_64", "aarch64", "arm64".
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
    """Return the first working library, or None, and all test results.

    The environment variable's library is tested first. If it fails, the search continues and the report contains the
    reason.
    """
    tried: list[Probe] = []
    for path in candidates():
        probe = probe_library(path)
        tried.append(probe)
        if probe.works:
            return probe, tuple(tried)
    return None, tuple(tried)


def use_llvm() -> Probe | None:
    """Point drjit to a working library; must be called before drjit is imported.

    If drjit is already imported, its choice is fixed and is tested instead.
    """
    if "drjit" in sys.modules:
        loaded = probe_library(os.environ.get(ENVIRONMENT_VARIABLE, ""))
        return loaded if loaded.works else None
    working, _ = find_llvm()
    if working is not None and working.path:
        os.environ[ENVIRONMENT_VARIABLE] = working.path
        for name in working.needs:
            ctypes.CDLL(name)
    return working


def use_gather_instructions() -> None:
    """Configure LLVM to compile a gather to one instruction on processors with AVX2; call after importing drjit.

    For AMD processors without AVX-512, LLVM splits each gather into eight conditional loads. The kernel of a relief has
    hundreds of gathers and compiles 15 times faster if they are not split. Values change by rounding only. drjit has a
    function for it only in C++; where that is missing, kernels stay as they are.
    """
    if sys.platform != "linux" or platform.machine() != "x86_64":
        return
    import drjit as dr

    if not dr.has_backend(dr.JitBackend.LLVM):  # this also waits for drjit to start it
        return
    try:
        core = ctypes.CDLL(str(Path(dr.__file__).parent / "libdrjit-core.so"))
        cpu, features = core._Z19jit_llvm_target_cpuv, core._Z24jit_llvm_target_featuresv
        width, set_target = core._Z21jit_llvm_vector_widthv, core._Z19jit_llvm_set_targetPKcS0_j
    except (OSError, AttributeError):
        return
    cpu.restype = features.restype = ctypes.c_char_p
    width.restype = ctypes.c_uint
    set_target.argtypes, set_target.restype = [ctypes.c_char_p, ctypes.c_char_p, ctypes.c_uint], None
    known = (features() or b"").split(b",")
    if b"+avx2" in known and FAST_GATHER not in known:
        set_target(cpu(), b",".join([*known, FAST_GATHER]), width())


def companions(path: str) -> list[str]:
    """Return the libraries to load before `path`, in order.

    An unpacked (not installed) LLVM has its own libz3, libedit and so on beside it, unknown to the system's loader,
    which accepts libraries already in memory by name. The wheel has its own libc++ beside it, whose short name is
    created at the first start of an interpreter with write permission; in another user's environment it may be missing.
    """
    if path in _wheel_libraries():
        root, ending = Path(path).parent, "*"
    elif ".llvm" in Path(path).parts:
        root, ending = Path(*Path(path).parts[: Path(path).parts.index(".llvm") + 1]), ""
    else:
        return []  # an installed LLVM finds its libraries
    needed: list[str] = []
    for _ in range(20):
        missing = _missing_library([*needed, path])
        library = next(iter(sorted(root.rglob(missing + ending))), None) if missing else None
        if library is None or str(library) in needed:
            break
        needed.insert(0, str(library))  # dependencies of a companion come first
    return needed


def _missing_library(paths: list[str]) -> str | None:
    """Return the file name of the first library missing when a subprocess loads `paths`."""
    script = "import ctypes, sys\nfor name in sys.argv[1:]: ctypes.CDLL(name)"
    done = subprocess.run([sys.executable, "-c", script, *paths], capture_output=True, text=True)
    match = re.search(r"OSError: (\S+): cannot open shared object file", done.stderr)
    return os.path.basename(match.group(1)) if done.returncode and match else None


def candidates() -> list[str]:
    """Return the candidate libraries, best first, without duplicates; "" is drjit's own search.

    Order: the environment variable's library, the wheel's (pinned version), installed libraries.
    """
    named = os.environ.get(ENVIRONMENT_VARIABLE)
    by_real_path: dict[str, str] = {}
    for path in _installed():
        by_real_path.setdefault(os.path.realpath(path), path)
    ranked = sorted((rank, path) for path in by_real_path.values() if (rank := _rank(path)) is not None)
    listed = ([named] if named else []) + _wheel_libraries() + [path for _, path in ranked]
    return list(dict.fromkeys(listed)) + [""]


def _wheel_libraries() -> list[str]:
    """Return the libLLVM installed by pip for this Python, in any installation folder."""
    try:
        files = metadata.files(WHEEL) or []
    except metadata.PackageNotFoundError:
        return []
    named = [file for file in files if re.fullmatch(r"libLLVM\.so\.[\d.]+", file.name)]
    return sorted(path for file in named if os.path.exists(path := os.path.realpath(str(file.locate()))))


def wheel_version() -> str | None:
    """Return the version of the libLLVM wheel in this Python's environment, or None."""
    try:
        return metadata.version(WHEEL)
    except metadata.PackageNotFoundError:
        return None


def from_wheel(path: str) -> bool:
    """Whether a library belongs to the wheel."""
    return bool(path) and os.path.realpath(path) in _wheel_libraries()


def _installed() -> Iterator[str]:
    """Yield every libLLVM in the project's own folder and the usual folders."""
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
    """Return a library's rank by the version in its name; None for failing versions, unknown ones last."""
    match = re.search(r"(?:libLLVM[-.](?:so\.|dylib\.)?|llvm[-@]?)(\d+)", os.path.realpath(path))
    version = int(match.group(1)) if match else None
    order = (*PREFERRED_VERSIONS, None, *UNTRIED_VERSIONS)
    if version in order:
        return order.index(version)
    return len(order) if version is not None and version > max(PREFERRED_VERSIONS) else None


def probe_library(path: str) -> Probe:
    """Test one library in a subprocess, or return the cached result."""
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
    """Summarise a failed test."""
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
    """Return a key of everything that may change the result: the file, drjit and the interpreter."""
    stamp = ""
    if path and os.path.exists(path):
        status = os.stat(path)
        stamp = f"{status.st_size}:{status.st_mtime_ns}"
    if not path:  # drjit's own search depends on all installed files
        stamp = ";".join(sorted(_installed()))
    return "|".join((path, stamp, _drjit_version(), sys.executable))


@functools.cache
def _drjit_version() -> str:
    """Return drjit's version; cached, since a look-up takes 4 ms and a picture needs twenty."""
    try:
        return metadata.version("drjit")
    except metadata.PackageNotFoundError:
        return "none"


def _cache_file() -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    return Path(base) / "nacre" / "llvm.json"


def _read_cache() -> dict[str, list[str]]:
    try:
        data = json.loads(plain(_cache_file()).read_text())
    except (OSError, ValueError):
        return {}
    good = isinstance(data, dict)
    return {k: v for k, v in data.items() if isinstance(v, list) and len(v) >= 2} if good else {}


def _write_cache(key: str, probe: Probe) -> None:
    """Store a result; an unwritable cache only costs a second at each start."""
    if probe.reason.startswith(("it gave no answer", "it could not be tried")):
        return  # possibly caused by the machine, not by the library
    with contextlib.suppress(OSError):
        file = _cache_file()
        file.parent.mkdir(parents=True, exist_ok=True)
        data = {**_read_cache(), key: [probe.version, probe.reason, *probe.needs]}
        descriptor, name = tempfile.mkstemp(dir=file.parent, prefix=".llvm-")
        with os.fdopen(descriptor, "w") as out:
            json.dump(data, out, indent=1)
        os.replace(name, file)


if __name__ == "__main__":  # for the set-up: whether an LLVM works, and the advice otherwise
    if sys.argv[1:] == ["--advice"]:
        sys.exit(print(advice()))
    sys.exit(0 if find_llvm()[0] is not None else 1)
