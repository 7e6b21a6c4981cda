"""The notebooks of examples/ run from top to bottom in an empty folder, and their materials show themselves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

NOTEBOOKS = Path(__file__).resolve().parents[2] / "examples" / "notebooks"
CELL_LIMIT_S = 400
HEAVY = ("metasurface", "pearl", "relief")  # half a minute of optics each; they run with the heavy bars


def _parameters() -> list[Any]:
    names = sorted(path.stem for path in NOTEBOOKS.glob("*.ipynb"))
    return [pytest.param(name, marks=[pytest.mark.full] if name in HEAVY else []) for name in names]


def test_every_family_has_its_notebook() -> None:
    assert {path.stem for path in NOTEBOOKS.glob("*.ipynb")} >= {"film", "pearl", "metasurface", "relief"}


@pytest.mark.render
@pytest.mark.parametrize("name", _parameters())
def test_a_notebook_runs_and_its_material_shows_itself(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import nbclient
    import nbformat

    # no history, no profile: nothing is read from or left in the home folder
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    monkeypatch.setenv("JUPYTER_PLATFORM_DIRS", "1")
    notebook = nbformat.read(NOTEBOOKS / f"{name}.ipynb", as_version=4)
    work = tmp_path / "work"
    work.mkdir()
    client = nbclient.NotebookClient(notebook, timeout=CELL_LIMIT_S, resources={"metadata": {"path": str(work)}})
    client.execute()

    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    shown = [output["data"] for output in outputs if "data" in output]
    assert any(data.get("text/html", "").count("<img") == 2 for data in shown), "no sphere and ribbon"
    assert any("image/png" in data for data in shown), "no figure"
    assert not [output for output in outputs if output.get("name") == "stderr"]


def test_notebooks_are_stored_without_outputs() -> None:
    import nbformat

    for path in NOTEBOOKS.glob("*.ipynb"):
        notebook = nbformat.read(path, as_version=4)
        assert not [cell for cell in notebook.cells if cell.cell_type == "code" and cell.outputs], path.name


def test_a_render_shows_its_progress_in_a_notebook_and_cleans_up(tmp_path: Path) -> None:
    import nbclient
    import nbformat

    notebook = nbformat.v4.new_notebook()
    notebook.cells = [
        nbformat.v4.new_code_cell(
            "from nacre.core.progress import progress_bar\n"
            "bar = progress_bar('render', None)\nshow = bar.__enter__()\nshow(2, 4, 3.0)"
        )
    ]
    client = nbclient.NotebookClient(notebook, timeout=CELL_LIMIT_S, resources={"metadata": {"path": str(tmp_path)}})
    client.execute()
    shown = notebook.cells[0].outputs[0]["data"]["text/html"]
    assert '<progress value="2" max="4">' in shown and "about 3 " in shown

    notebook.cells[0].source += "\nbar.__exit__(None, None, None)"
    client.execute()
    assert notebook.cells[0].outputs[0]["data"]["text/html"] == ""
