"""Every snippet of the README and the documentation runs, in the order of its page, in an empty folder.

What a fence is for stands in its language: `toml` is a file whose first line is a comment with its name, as is `text`
with such a line, `bash` are commands, `python` is one program a page. Anything else is only shown. To be quick the
same commands run with small pictures, few frames, short searches and, unless written, spectra of two wavelengths.
"""

from __future__ import annotations

import re
import shlex
import tomllib
from pathlib import Path

import pytest

import nacre
from nacre.cli import COMMANDS, run

ROOT = Path(__file__).resolve().parents[2]
GENERATED = ("_build", "tutorials", "reference", "gallery", "reports", "project")
FENCE = re.compile(r"^```(\w+)\n(.*?)^```", re.MULTILINE | re.DOTALL)
NAME = re.compile(r"#\s*([\w./-]+\.(?:toml|csv))\s*$")
QUICK_RENDER = ["--size", "24x24", "--spp", "1"]
LARGE_PICTURE = re.compile(r"(nacre\.render\([^()\n]*)\bsize=\d{3,}")
QUICK_FRAMES = ["--frames", "2"]
QUICK_SEARCH_S = 2
QUICK_ENSEMBLE = "[model.ensemble]\nspheres = 20\nrealisations = 4\n"
RANGE = re.compile(r"^(\d+):(\d+):\d+$")
NOT_RUN_HERE = ("nacre demo", "nacre studio")  # they have tests of their own


def _pages() -> list[Path]:
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
    pages += sorted((ROOT / "docs").rglob("*.md"))
    return [p for p in pages if p.is_file() and p.relative_to(ROOT).parts[:2][-1] not in GENERATED]


def _blocks(page: Path) -> list[tuple[str, str]]:
    blocks = [(m[1], m[2]) for m in FENCE.finditer(page.read_text(encoding="utf-8"))]
    return [("toml" if kind == "text" and NAME.match(text.splitlines()[0]) else kind, text) for kind, text in blocks]


def _parameters() -> list[object]:
    found = []
    for page in _pages():
        blocks = [(kind, text) for kind, text in _blocks(page) if kind in ("toml", "bash", "python")]
        needs_llvm = any("render" in text or '"pearl"' in text for _, text in blocks)
        marks = [pytest.mark.render] if needs_llvm else []
        if blocks:
            found.append(pytest.param(page, marks=marks, id=str(page.relative_to(ROOT))))
    return found


def _commands(text: str) -> list[str]:
    lines = text.replace("\\\n", " ").splitlines()
    return [line for line in (line.split("  #")[0].strip() for line in lines) if line and not line.startswith("#")]


def _write(text: str) -> None:
    first = text.splitlines()[0]
    match = NAME.match(first)
    assert match, f'a file\'s first line should be a comment with its name, not "{first}"'
    text = re.sub(r"^seconds = \d+", f"seconds = {QUICK_SEARCH_S}", text, flags=re.MULTILINE)
    Path(match[1]).parent.mkdir(parents=True, exist_ok=True)
    Path(match[1]).write_text(text, encoding="utf-8")
    if match[1].endswith(".toml"):
        data = tomllib.loads(text)
        if "family" in data and "target" not in data:
            nacre.load(match[1])
        if data.get("family") == "metasurface" and "model" not in data:
            Path(match[1]).write_text(f"{text}\n{QUICK_ENSEMBLE}", encoding="utf-8")


def _run_line(line: str) -> None:
    words = shlex.split(line)
    if words[0] == "make":
        targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
        wanted = [w for w in words[1:] if "=" not in w]
        assert set(wanted) <= set(targets), f"{line}: the Makefile has {targets}"
        return
    assert words[0] == "nacre", f"{line}: only nacre and make commands can be shown as bash; use text"
    assert words[1] in COMMANDS
    if line.startswith(NOT_RUN_HERE):
        return
    if words[1] == "render":
        words = [w for i, w in enumerate(words) if w not in ("--size", "--spp", "--frames") and
                 words[i - 1] not in ("--size", "--spp", "--frames")]  # fmt: skip
        words += QUICK_RENDER + (QUICK_FRAMES if "--animate" in words else [])
    if words[1] == "spectrum" and "-o" not in words:  # a written spectrum may be read by the next command
        words = [RANGE.sub(lambda m: f"{m[1]}:{m[2]}:{int(m[2]) - int(m[1])}", word) for word in words]
    assert run(words[1:]) == 0, line


@pytest.mark.parametrize("page", _parameters())
def test_the_snippets_of_a_page_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, object] = {}
    for kind, text in _blocks(page):
        if kind == "toml":
            _write(text)
        elif kind == "bash":
            for line in _commands(text):
                _run_line(line)
        elif kind == "python":
            text = LARGE_PICTURE.sub(r"\1size=24, spp=1", text)
            exec(compile(text, str(page), "exec"), namespace)  # the page's own program


def test_the_readme_lists_every_command() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\| `nacre (\w+)`", text, re.MULTILINE)
    assert sorted(listed) == sorted(COMMANDS)


def test_the_links_of_the_root_pages_lead_to_files() -> None:
    for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "NOTICE.md"):
        text = (ROOT / name).read_text(encoding="utf-8")
        for link in re.findall(r"\]\(([^)#]+)[^)]*\)", text):
            assert link.startswith("http") or (ROOT / link).exists(), f"{name}: {link}"
