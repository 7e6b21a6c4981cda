"""Choice of the Mitsuba variant, and import of mitsuba.

Order: the caller's or `NACRE_VARIANT`'s variant; a variant already set by the user's code; the GPU if one works;
LLVM; and scalar_spectral with a warning, hundreds of times slower. Only spectral variants are supported, because a
structural colour is a spectrum; the polarised ones are used only on request.
"""

import contextlib
import functools
import importlib.util
import os
import sys
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from types import ModuleType
from typing import Any

from nacre.core.errors import MachineError, UnsupportedError, did_you_mean
from nacre.device import llvm

ENVIRONMENT_VARIABLE = "NACRE_VARIANT"
UNPOLARISED = ("llvm_ad_spectral", "cuda_ad_spectral", "scalar_spectral")
POLARISED = tuple(f"{name}_polarized" for name in UNPOLARISED)
VARIANTS = UNPOLARISED + POLARISED
ON_GPU = "cuda_ad_spectral"
GPU_WARNING = "{reason}: rendering on the CPU; NACRE_VARIANT=llvm_ad_spectral chooses it without this warning"
RGB = ("llvm_ad_rgb", "cuda_ad_rgb", "scalar_rgb")  # only in the user's own scenes
SCALAR_WARNING = (
    "{reason}: falling back to scalar_spectral, some hundreds of times slower, good for tiny previews only; {remedy}"
)


def use_variant(requested: str | None = None) -> ModuleType:
    """Return mitsuba with a spectral variant set.

    Args:
        requested: a variant in `VARIANTS`; default: `NACRE_VARIANT` (its polarised twin if that is set), else the
            variant already set, else the best working one.

    Raises:
        UnsupportedError: the variant is not in `VARIANTS`.
        MachineError: mitsuba is missing, or the requested variant does not work on this machine.
    """
    is_default = requested is None
    requested = requested or os.environ.get(ENVIRONMENT_VARIABLE) or None
    if requested is not None:
        _check_name(requested)
    mi = import_mitsuba()
    current = mi.variant()
    is_twin = is_default and current == f"{requested}_polarized"  # set by `polarised_variant`
    if current is not None and (is_twin or requested in (None, current)):
        _check_name(current)
        check_set_variant(current)
    else:
        mi.set_variant(_available(requested, mi))
    return mi


@contextlib.contextmanager
def polarised_variant() -> Iterator[ModuleType]:
    """Set the polarised twin of the variant in use, and return to it afterwards.

    Raises:
        MachineError: no variant works on this machine.
    """
    mi = use_variant()
    before = str(mi.variant())
    try:
        if before not in POLARISED:
            mi.set_variant(f"{before}_polarized")
        yield mi
    finally:
        mi.set_variant(before)


def depolarised(value: Any) -> Any:
    """Return an unpolarised value as the variant's spectrum: a depolarising Mueller matrix if that is polarised."""
    import mitsuba as mi

    return mi.mueller.depolarizer(value) if mi.is_polarized else value


def import_mitsuba() -> ModuleType:
    """Import mitsuba after pointing drjit to a working LLVM, without setting a variant.

    Raises:
        MachineError: mitsuba is not installed.
    """
    if importlib.util.find_spec("mitsuba") is None:
        raise MachineError("mitsuba is not installed; `pip install mitsuba` (rendering needs it)")
    llvm.use_llvm()
    import mitsuba

    llvm.use_gather_instructions()
    return mitsuba


def _check_name(name: str) -> None:
    if name not in VARIANTS:
        raise UnsupportedError(
            f'Mitsuba variant "{name}" cannot carry spectral materials; use {", ".join(VARIANTS)}.'
            f"{did_you_mean(name, VARIANTS)}"
        )


def _available(requested: str | None, mi: ModuleType) -> str:
    """Return the requested variant or the best working one."""
    if requested is not None:
        if reason := _variant_failure(requested, mi):
            raise MachineError(f"Mitsuba variant {requested} does not work here: {reason}")
        return requested
    if not (reason := _variant_failure(ON_GPU, mi)):
        return ON_GPU
    # stacklevel: the caller of use_variant
    if has_gpu():
        warnings.warn(GPU_WARNING.format(reason=reason), RuntimeWarning, stacklevel=3)
    if not _variant_failure("llvm_ad_spectral", mi):
        return "llvm_ad_spectral"
    warnings.warn(_scalar_warning(), RuntimeWarning, stacklevel=3)
    return "scalar_spectral"


@functools.cache
def _set_variant_failure(name: str) -> str:
    """Return the reason why an already set variant does not work, or an empty string."""
    return llvm_failure() if name.startswith("llvm") else ""


def check_set_variant(name: str) -> None:
    """Check an already set variant, whose first kernel might otherwise abort the process.

    Raises:
        MachineError: it does not work on this machine.
    """
    if reason := _set_variant_failure(name):
        raise MachineError(f"Mitsuba variant {name} does not work here: {reason}")


def _scalar_warning() -> str:
    """Return the reason for the slowest variant, and the remedy: an LLVM, or another import order."""
    working, _ = llvm.find_llvm()
    if working is not None and llvm.use_llvm() is None:
        remedy = f"import nacre.render first, or set {llvm.ENVIRONMENT_VARIABLE}={working.path}"
        reason = "mitsuba or drjit was imported before nacre.render, and the LLVM that it chose fails"
    else:
        reason, remedy = "no usable LLVM was found", "`nacre doctor` shows how to install LLVM"
    return SCALAR_WARNING.format(reason=reason, remedy=remedy)


def _variant_failure(name: str, mi: ModuleType) -> str:
    """Return the reason why a variant does not work, or an empty string."""
    if name not in mi.variants():
        return "this build of mitsuba does not contain it"
    if name.startswith("cuda"):
        return cuda_failure() or ray_failure()
    if name.startswith("llvm"):
        return llvm_failure()
    return ""


def has_gpu() -> bool:
    """Whether Dr.Jit finds an NVIDIA GPU with its driver."""
    import drjit as dr

    return bool(dr.has_backend(dr.JitBackend.CUDA))


@functools.cache
def ray_failure(name: str = ON_GPU) -> str:
    """Trace a ray in a variant, by OptiX on a GPU; return the reason of a failure, or an empty string.

    Containers often have the GPU without OptiX. A variant set before remains set; without one, `name` is.
    """
    import mitsuba as mi

    before = mi.variant()
    try:
        mi.set_variant(name)
        scene = mi.load_dict({"type": "scene", "shape": {"type": "rectangle"}})
        hit = scene.ray_intersect(mi.Ray3f(mi.Point3f(0.0, 0.0, 2.0), mi.Vector3f(0.0, 0.0, -1.0)))
        good = abs(float(hit.t[0]) - 2.0) < 1e-3
    except Exception as error:  # drivers have various exceptions
        text = str(error).strip() or type(error).__name__
        return f"the GPU traces no rays (OptiX, a part of its driver): {text.splitlines()[0][:120]}"
    finally:
        if before is not None:
            mi.set_variant(before)
    return "" if good else "the GPU traced a ray to a wrong place"


def cuda_failure() -> str:
    """Test a small kernel on the GPU; return the reason of a failure, or an empty string."""
    import drjit as dr

    if not has_gpu():
        return "no NVIDIA GPU with its driver was found"
    try:
        from drjit.cuda import Float

        good = float(dr.sum(dr.maximum(dr.arange(Float, 8), 2.0))[0]) == 31.0
    except Exception as error:  # drivers have various exceptions
        return f"the GPU failed a test kernel: {str(error).splitlines()[0][:120]}"
    return "" if good else "the GPU returned wrong numbers"


def llvm_failure() -> str:
    """Return the reasons why every tested LLVM fails, or an empty string if one works."""
    if llvm.use_llvm() is not None:
        return ""
    if "drjit" in sys.modules:
        probe = llvm.probe_library(os.environ.get(llvm.ENVIRONMENT_VARIABLE, ""))
        working, _ = llvm.find_llvm()
        if working is not None:
            return (
                f"mitsuba or drjit was imported before nacre.render and its LLVM fails ({probe.reason}); import "
                f"nacre.render first, or set {llvm.ENVIRONMENT_VARIABLE}={working.path}"
            )
    _, tried = llvm.find_llvm()
    named = [f"{probe.path or 'the default of drjit'}: {probe.reason}" for probe in tried]
    return f"no usable LLVM ({'; '.join(named)}). {llvm.advice()}"


@dataclass(frozen=True)
class VariantReport:
    """Rendering diagnosis for `nacre doctor`."""

    variant: str | None
    variants: dict[str, str]
    llvm_used: str
    llvm_version: str
    llvm_tried: tuple[llvm.Probe, ...]
    mitsuba_version: str | None
    advice: str


def report() -> VariantReport:
    """Examine the machine: best variant, failures, advice. A GPU is examined with its variant, then the best is set."""
    working, tried = llvm.find_llvm()
    path = (working.path or "default of drjit") if working else ""
    version = working.version if working else ""
    try:
        mi = import_mitsuba()
    except MachineError as error:
        return VariantReport(None, {}, path, version, tried, None, str(error))
    before = mi.variant()
    reasons = {name: _variant_failure(name, mi) for name in VARIANTS}
    best = next(name for name in ("cuda_ad_spectral", "llvm_ad_spectral", "scalar_spectral") if not reasons[name])
    if mi.variant() != before:
        mi.set_variant(best)
    best = os.environ.get(ENVIRONMENT_VARIABLE) or best
    advice = "" if best != "scalar_spectral" else f"Rendering will be very slow. {llvm.advice()}"
    return VariantReport(best, reasons, path, version, tried, mi.__version__, advice)
