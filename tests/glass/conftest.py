"""Make the helpers beside these tests importable: modules of tests are loaded by path, not by package."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
