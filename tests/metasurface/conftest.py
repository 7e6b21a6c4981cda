"""Let the metasurface tests import their helpers; test modules have no package in importlib mode."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
