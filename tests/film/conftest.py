"""Lets the tests of this folder share helpers with those of the lobes."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "bsdf"))
