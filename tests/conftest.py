"""What all tests share: threads, and what becomes of tests whose machinery this machine lacks.

Tests marked `render` need Mitsuba with a working LLVM, or a GPU where `NACRE_VARIANT=cuda_ad_spectral` makes them
run on it (`make test-gpu`). Without one they do not run, and the session then FAILS with one line that says why: a
picture that nobody checked must not look like a pass. Tests marked `gpu` skip where there is no NVIDIA GPU.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
import uuid
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import pytest

# modules of tests are loaded by path, not by package; what several folders share stands here
sys.path.insert(0, str(Path(__file__).parent / "helpers"))
# a package from outside, on the path with its .dist-info as if installed: its family and lobe join the shared suites
sys.path.insert(0, str(Path(__file__).parent / "toy"))

# small matrices: threads of BLAS would only fight with those of numba and Dr.Jit
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
os.environ.setdefault("NUMBA_NUM_THREADS", str(min(8, os.cpu_count() or 1)))

# a suite started in the background of a shell inherits an ignored interrupt, and its children from it: what an
# interrupt does could then not be tested, and a render that waits for one would never end
signal.signal(signal.SIGINT, signal.default_int_handler)

# tests and the commands that they start import hundreds of modules: compiled ones are kept
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# what imports leave in memory lives to the end: collecting garbage among it takes more time than the imports do
gc.disable()

# tests measure pictures as they were rendered; those of the denoiser ask for it
os.environ["NACRE_DENOISE"] = "0"

NO_RENDER = "cannot render:"
_not_rendered: list[str] = []
_why: dict[str, str] = {}


SLOW_CASES = Path(__file__).parent / "slow_cases.txt"


def slow_cases() -> list[str]:
    """Return the names of the tests that are too slow for the quick suite."""
    if not SLOW_CASES.exists():  # a suite of its own, of a test
        return []
    lines = SLOW_CASES.read_text(encoding="utf-8").splitlines()
    return [line for line in lines if line and not line.startswith("#")]


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark the slow tests `full` and `slow`, before pytest chooses by mark; stop if a name belongs to no test."""
    slow = dict.fromkeys(slow_cases(), False)
    files = set()
    for item in items:
        files.add(item.nodeid.partition("::")[0])
        for name in (item.nodeid, item.nodeid.partition("[")[0]):
            if name in slow:
                slow[name] = True
                item.add_marker(pytest.mark.full)
                item.add_marker(pytest.mark.slow)
    files |= {file for name in slow if not (SLOW_CASES.parents[1] / (file := name.partition("::")[0])).exists()}
    whole = {name.partition("::")[0] for name in slow} <= files
    if gone := [name for name, found in slow.items() if not found and whole]:
        reason = f"{SLOW_CASES.name}: no such case: {', '.join(gone)}"
        if hasattr(config, "workerinput"):  # the main process of xdist stops, but does not learn why
            with config.pluginmanager.getplugin("capturemanager").global_and_fixture_disabled():
                print(reason, file=sys.stderr, flush=True)
        raise pytest.UsageError(reason)


def pytest_collection_finish() -> None:
    """Collect garbage from here on, but never again among what imports left."""
    gc.freeze()
    gc.enable()


def _why_no_render() -> str:
    if "render" not in _why:
        from nacre.core.errors import NacreError
        from nacre.device.variant import cuda_failure, import_mitsuba, llvm_failure

        try:
            import_mitsuba()
            on_gpu = os.environ.get("NACRE_VARIANT", "").startswith("cuda")
            _why["render"] = cuda_failure() if on_gpu else llvm_failure()
        except NacreError as error:
            _why["render"] = str(error)
    return _why["render"]


def _why_no_gpu() -> str:
    if "gpu" not in _why:
        from nacre.core.errors import NacreError
        from nacre.device.variant import cuda_failure, import_mitsuba

        try:
            import_mitsuba()
            _why["gpu"] = cuda_failure()
        except NacreError as error:
            _why["gpu"] = str(error)
    return _why["gpu"]


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Stop a test before its fixtures when the machine cannot run it; let warnings of earlier tests appear again."""
    if errors := sys.modules.get("nacre.core.errors"):
        errors.warn_once.cache_clear()
    if item.get_closest_marker("render") and (reason := _why_no_render()):
        pytest.skip(f"{NO_RENDER} {reason}")
    if item.get_closest_marker("gpu") and (reason := _why_no_gpu()):
        pytest.skip(reason)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Count what could not be rendered; under xdist this runs in the process that decides the exit status."""
    if report.skipped and isinstance(report.longrepr, tuple) and NO_RENDER in report.longrepr[2]:
        _not_rendered.append(report.longrepr[2].split(NO_RENDER, 1)[1].strip())


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_sessionfinish(session: pytest.Session) -> Generator[None, Any, Any]:
    """Fail the session if rendering tests could not run, and say why in the very last line."""
    if _not_rendered:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
    result = yield
    gc.collect()
    gc.freeze()  # pytest and the interpreter collect several times while they end
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if _not_rendered and reporter is not None:
        reporter.write_line(f"FAILED: {len(_not_rendered)} rendering tests could not run: {_not_rendered[0]}", red=True)
    return result


@pytest.fixture(scope="session", autouse=True)
def _cache_of_the_session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Keep solved materials of fixtures that many tests share out of the user's own cache."""
    folder = tmp_path_factory.mktemp("cache")
    os.environ["NACRE_CACHE"] = str(folder / "shared")
    return folder


@pytest.fixture(autouse=True)
def _empty_cache(_cache_of_the_session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Give every test an empty cache: none may pass by what another one solved."""
    monkeypatch.setenv("NACRE_CACHE", str(_cache_of_the_session / uuid.uuid4().hex))


@pytest.fixture(scope="session")
def mi() -> Iterator[Any]:
    """Return mitsuba in the tested variant, with the `nacre` plugin registered; for tests marked `render`."""
    from tested_variant import use_tested_variant

    import nacre.render  # noqa: F401 - registers the `nacre` plugin with every variant

    yield use_tested_variant()
