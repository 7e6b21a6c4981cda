"""Make the pages of the documentation that the code itself knows: keys, commands, API, gallery, reports, tutorials.

`conf.py` calls `main` before each build. What is written here is not committed: `docs/reference`, `docs/gallery`,
`docs/reports`, `docs/project`, `docs/tutorials`.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import generate_api
import generate_commands
import generate_formats
import generate_keys

ROOT = Path(__file__).resolve().parents[1]
PROJECT_PAGES = ("CHANGELOG", "CONTRIBUTING", "NOTICE")
FAMILIES = ("film", "pearl", "metasurface", "relief")


def main(docs: Path) -> None:
    """Write all generated pages below `docs`."""
    write(docs / "reference" / "keys.md", generate_keys.page())
    write(docs / "reference" / "commands.md", generate_commands.page())
    write(docs / "reference" / "api.md", generate_api.page())
    write(docs / "reference" / "file-formats.md", generate_formats.page())
    write(docs / "gallery" / "index.md", gallery(docs))
    report(docs, "validation", "REPORT.md", "Validation", "make validate")
    report(docs, "benchmarks", "RESULTS.md", "Benchmarks", "make bench")
    for name in PROJECT_PAGES:
        text = (ROOT / f"{name}.md").read_text(encoding="utf-8")
        for other in PROJECT_PAGES:
            text = text.replace(f"]({other}.md)", f"]({other.lower()}.md)")
        write(docs / "project" / f"{name.lower()}.md", text)
    for family in FAMILIES:
        source = ROOT / "examples" / "notebooks" / f"{family}.ipynb"
        write(docs / "tutorials" / f"{family}.ipynb", source.read_text(encoding="utf-8"))


def write(path: Path, text: str) -> None:
    """Write a page only when it differs, so that Sphinx does not read it anew for nothing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def gallery(docs: Path) -> str:
    """Return the gallery: each picture of examples/gallery.toml, its command and its recipe."""
    from nacre.cli.gallery import load_gallery
    from nacre.material.examples import examples_folder

    folder = examples_folder()
    shows = load_gallery(folder)
    pictures = shows.picture
    targets = {Path(design.target).stem: design.target for design in shows.design}
    lines = [
        "# Gallery", "",
        "The pictures of `nacre demo`, small, each with its recipe. The recipes are in `examples/`; "
        "`nacre demo --quick` makes some of them in about a minute.", "",
    ]  # fmt: skip
    shown: set[str] = set()
    for picture in pictures:
        name = picture.name or Path(picture.recipe).stem
        lines += [f"## {picture.title}", ""]
        if (docs / "images" / "gallery" / f"{name}.jpg").is_file():
            lines += [f"![{picture.title}](../images/gallery/{name}.jpg)", ""]
        options = [f"--scene {picture.scene}"]
        options += [f"--shape {picture.shape}"] if picture.shape else []
        options += [f"--light {picture.light}"] if picture.light else []
        options += [f"--zoom {picture.zoom:g}"] if picture.zoom else []
        options += [f"--illuminant {picture.illuminant}"] if picture.illuminant != "D65" else []
        options += [f"--components {picture.components}"] if picture.components != "sum" else []
        options += [f"--quality {picture.quality}"] if picture.quality else []
        target = targets.get(picture.recipe)
        made = [f"nacre design examples/{target} -o {picture.recipe}"] if target else []
        source = picture.recipe if target else f"examples/{picture.recipe}"
        lines += ["```text", *made, f"nacre render {source} {' '.join(options)}", "```", ""]
        recipe = folder / (target or picture.recipe)
        if picture.recipe not in shown and recipe.is_file() and recipe.suffix == ".toml":
            lines += ["```toml", recipe.read_text(encoding="utf-8").strip(), "```", ""]
            shown.add(picture.recipe)
    return "\n".join(lines)


def report(docs: Path, folder: str, name: str, title: str, command: str) -> None:
    """Copy a report with its figures, or say how to make it."""
    source = ROOT / folder / name
    target = docs / "reports" / f"{folder}.md"
    if not source.is_file():
        write(target, f"# {title}\n\nNot made in this checkout yet: `{command}` writes `{folder}/{name}`.\n")
        return
    figures = ROOT / folder / "figures"
    if figures.is_dir():
        shutil.copytree(figures, docs / "reports" / "figures", dirs_exist_ok=True)
    text = source.read_text(encoding="utf-8")
    kept = []
    for line in text.splitlines():
        # a figure that is named but was not kept would be a dead link
        start = line.find("](figures/")
        if start >= 0 and not (ROOT / folder / line[start + 2 :].partition(")")[0]).is_file():
            continue
        kept.append(line)
    write(target, "\n".join(kept) + "\n")
