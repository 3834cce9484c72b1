"""The page about notebooks holds: its blocks run one after the other on the files of a small arm."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

import dynident as dy

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE = (DOCS / "notebook.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_page_is_a_notebook_whose_every_block_runs_and_that_shows_tables_and_figures(desk: Path) -> None:
    pytest.importorskip("pandas")
    assert len(re.findall(r"^```python\n", PAGE, re.MULTILINE)) > 7
    written = nbformat.reads(runpy.run_path(str(DOCS / "notebooks.py"))["notebook"]("notebook"), as_version=4)
    done = NotebookClient(written, timeout=300, resources={"metadata": {"path": str(desk)}}).execute()
    outputs = [one for cell in done.cells for one in cell.get("outputs", [])]
    shown = [one["data"].get("text/html", "") for one in outputs if "data" in one]
    assert sum("<table" in page for page in shown) > 2
    assert any("<svg" in page for page in shown)
    assert any("Coulomb friction on elbow" in str(one.get("text", one.get("data"))) for one in outputs)
    assert "</html>" in (desk / "report.html").read_text(encoding="utf-8")
    assert (desk / "trajectory.csv").is_file()


def test_what_the_text_says_besides_can_be_done(model: dy.Model, found: dy.DiagnosedModel) -> None:
    assert model.extend(found.candidates[0]).effects[-1].effect == "stribeck"
    grown = model.extend("stribeck@shoulder")
    assert [name for name, _ in grown.effects[-1].shape]
    assert grown.remove("stribeck").effects == model.effects
