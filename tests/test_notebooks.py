"""The notebooks of the documentation run as they stand."""

import os
import sys
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient
from nbformat import NotebookNode

from tests.support.paths import DOCS

pytestmark = pytest.mark.slow

FOLDER = DOCS / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


def opened(path: Path) -> NotebookNode:
    notebook: NotebookNode = nbformat.read(path, as_version=4)  # type: ignore[no-untyped-call]
    return notebook


@pytest.mark.long
def test_the_first_flight_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    notebook = opened(FOLDER / "first-flight.ipynb")
    NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(tmp_path)}}).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    printed = "".join(output.get("text", "") for output in outputs)
    assert "c1=True, c2=True, c3=True" in printed
    assert "results: 4 runs: 4 pass" in printed
    assert sum("image/png" in output.get("data", {}) for output in outputs) == 2


def test_notebooks_are_kept_without_outputs(subtests: pytest.Subtests) -> None:
    for path in NOTEBOOKS:
        with subtests.test(notebook=path.name):
            cells = opened(path).cells
            assert not [cell for cell in cells if cell.get("outputs") or cell.get("execution_count")]
