"""Sphinx configuration: MyST pages, executed notebooks, and pages made from the code before each build."""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import generate  # noqa: E402  (beside this file)

from nacre import __version__  # noqa: E402

generate.main(HERE)

project = "nacre"
author = "the nacre authors"
copyright = "2026, the nacre authors"
version = release = __version__

extensions = ["myst_nb"]
myst_enable_extensions = ["amsmath", "dollarmath", "colon_fence", "deflist"]
myst_heading_anchors = 3
exclude_patterns = ["_build", "**.ipynb_checkpoints"]

# notebooks run at the build, each in a folder of its own; what has not changed is taken from the cache
nb_execution_mode = "cache"
nb_execution_cache_path = str(HERE / "_build" / "notebook-cache")
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_merge_streams = True

html_theme = "furo"
html_title = f"nacre {release}"
html_static_path: list[str] = []
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#1f6f78", "color-brand-content": "#1f6f78"},
    "dark_css_variables": {"color-brand-primary": "#7cc6cf", "color-brand-content": "#7cc6cf"},
}
# no font or script from elsewhere but MathJax, which needs the network to set formulas
nitpicky = False
