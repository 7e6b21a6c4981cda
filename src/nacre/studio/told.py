"""What long work tells while it is done: a table with its `kind` for each event, as JSON can hold it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

Tell = Callable[[Mapping[str, Any]], None]
