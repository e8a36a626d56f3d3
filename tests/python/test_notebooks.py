"""Every notebook runs from top to bottom in under a minute, and draws."""

import os
import time
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOKS = sorted((Path(os.environ["WIGGERS_ROOT"]) / "notebooks").glob("*.ipynb"))


def test_all_are_there():
    assert len(NOTEBOOKS) == 5


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook(path):
    notebook = nbformat.read(path, as_version=4)
    assert not any(cell.get("outputs") for cell in notebook.cells), "notebooks are kept without outputs"
    begun = time.perf_counter()
    NotebookClient(notebook, timeout=300, kernel_name="python3").execute()
    print(f"{path.stem}: {time.perf_counter() - begun:.1f} s")
    pictures = [output for cell in notebook.cells for output in cell.get("outputs", [])
                if "image/png" in output.get("data", {})]
    assert pictures and all(len(p["data"]["image/png"]) > 5000 for p in pictures)
