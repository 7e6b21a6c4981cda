"""Exit statuses that are not 0, and what is said of an interrupt."""

from __future__ import annotations

STATUS_BAD_INPUT = 2
STATUS_INTERRUPTED = 130
STOPPED = "nacre: stopped; what was finished is kept"
