"""Pages that are notebooks as well run in Jupyter, cell by cell."""

from __future__ import annotations

import os
import runpy
import sys
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

DOCS = Path(__file__).resolve().parents[2] / "docs"
NOTEBOOKS = runpy.run_path(str(DOCS / "notebooks.py"))


def test_a_notebook_is_one_file_with_its_figures_and_what_is_not_run_is_text() -> None:
    cells = nbformat.reads(NOTEBOOKS["notebook"]("tutorial"), as_version=4).cells
    code = "".join(cell.source for cell in cells if cell.cell_type == "code")
    text = "".join(cell.source for cell in cells if cell.cell_type == "markdown")
    assert "dynident identify ur10 run1.csv" in code
    assert "Client(" not in code
    assert "Client(" in text
    assert "](figures/" not in text
    assert text.count("](data:image/svg+xml;base64,") == 7


@pytest.mark.slow
def test_the_tutorial_runs_in_jupyter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Its cells of the shell find the command as in the environment of the kernel.
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    written = nbformat.reads(NOTEBOOKS["notebook"]("tutorial"), as_version=4)
    done = NotebookClient(written, timeout=600, resources={"metadata": {"path": str(tmp_path)}}).execute()
    told = "".join(one.get("text", "") for cell in done.cells for one in cell.get("outputs", []))
    assert "The model lacks: Gravity compensating spring on shoulder_lift_joint" in told
