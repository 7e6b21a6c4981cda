"""The variant of Mitsuba that tests of the device run in: `NACRE_VARIANT`, else `llvm_ad_spectral`."""

from __future__ import annotations

import os
from typing import Any

from nacre.device.variant import ENVIRONMENT_VARIABLE, use_variant

TESTED = os.environ.get(ENVIRONMENT_VARIABLE) or "llvm_ad_spectral"


def use_tested_variant() -> Any:
    """Return mitsuba in the tested variant."""
    return use_variant(TESTED)
