"""The site builds without a warning, so that no internal link is dead; notebooks are executed by their own test."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.full
def test_the_site_builds_without_a_warning_and_its_links_hold(tmp_path: Path) -> None:
    pytest.importorskip("sphinx", reason="the documentation's packages are not installed; `make docs` does it")
    pytest.importorskip("myst_nb", reason="the documentation's packages are not installed; `make docs` does it")
    site = tmp_path / "html"
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", "-d", str(tmp_path / "trees")]
    result = subprocess.run(
        [*command, "-D", "nb_execution_mode=off", "docs", str(site)], cwd=ROOT, capture_output=True, text=True
    )
    assert result.returncode == 0, result.stderr[-2000:]
    # Sphinx checks what it resolves itself; this looks at what came out
    for page in site.rglob("*.html"):
        for target in re.findall(r'(?:href|src)="([^"#?:]+)[#?"]', page.read_text(encoding="utf-8")):
            assert (page.parent / target).exists(), f"{page.relative_to(site)}: {target}"
