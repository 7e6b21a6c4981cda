"""Memory guard: refuse arrays that exceed the memory limit before they are allocated.

Code that allocates an array whose size depends on user input calls `check_memory` first. The limit is a quarter of the
memory of the machine or its container, which leaves room for copies and the program; `NACRE_MEMORY` sets another one.
"""

import contextlib
import os
import re
from pathlib import Path

from nacre.core.errors import MachineError, UnsupportedError

VARIABLE = "NACRE_MEMORY"
SHARE = 0.25  # of the machine's memory
UNKNOWN_MACHINE = 8 << 30  # assumed if the system does not report its memory
LEAST = 1 << 20  # a smaller limit would refuse everything
_UNITS = {"": 1, "kb": 10**3, "mb": 10**6, "gb": 10**9, "tb": 10**12,
          "kib": 2**10, "mib": 2**20, "gib": 2**30, "tib": 2**40}  # fmt: skip
_CONTAINER_LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")


def check_memory(asked_bytes: float, what: str, advice: str = "") -> None:
    """Refuse an allocation that exceeds the memory limit.

    Args:
        asked_bytes: estimated peak memory.
        what: the key and value, or the file, that determines the size; starts the message.
        advice: remedy at the message's end.

    Raises:
        UnsupportedError: the limit is exceeded.
        MachineError: `NACRE_MEMORY` cannot be read.

    Example: `check_memory(1e15, "feature_um = 1e-06")` raises on today's machines.
    """
    if asked_bytes <= LEAST and VARIABLE not in os.environ:
        return  # below the limit of every machine; reading the limit costs time
    allowed, why = _limit()
    if not asked_bytes <= allowed:  # NaN is refused as well
        raise UnsupportedError(
            f"{what} asks for {shown_bytes(asked_bytes)} of memory; at most {shown_bytes(allowed)} are allowed "
            f"({why}){'; ' + advice if advice else ''}"
        )


def memory_limit() -> int:
    """Return the memory limit of one allocation in bytes.

    Raises:
        MachineError: `NACRE_MEMORY` cannot be read.
    """
    return _limit()[0]


def _limit() -> tuple[int, str]:
    """Return the limit in bytes and its origin."""
    given = os.environ.get(VARIABLE, "").strip()
    if not given:
        return int(SHARE * machine_memory()), f"a quarter of this machine's; {VARIABLE}=8GiB allows 8 GiB"
    match = re.fullmatch(r"(\d+(?:\.\d*)?|\.\d+)\s*([kmgt]i?b)?", given.lower())
    value = float(match[1]) * _UNITS[match[2] or ""] if match else 0.0
    if not LEAST <= value < 2**63:
        raise MachineError(f'{VARIABLE} = "{given[:40]}" is not an amount of memory; write it like 4GiB or 500MB')
    return int(value), f"{VARIABLE} = {given}"


def machine_memory() -> int:
    """Return the memory of this machine in bytes, or of its container if that is smaller."""
    total = UNKNOWN_MACHINE
    with contextlib.suppress(ValueError, OSError, AttributeError):
        total = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    for place in _CONTAINER_LIMITS:
        with contextlib.suppress(ValueError, OSError):
            total = min(total, int(Path(place).read_text()))  # "max" if there is no limit
    return total


def shown_bytes(amount: float) -> str:
    """Return an amount of memory with a suitable unit.

    Example: `shown_bytes(3 << 30)` is "3 GiB".
    """
    for unit in ("bytes", "KiB", "MiB", "GiB"):
        if amount < 1024.0:
            return f"{amount:.3g} {unit}"
        amount /= 1024.0
    return f"{amount:.3g} TiB"
