"""The tutorial holds: what it runs runs as it stands, in Jupyter, and tells what the text says that it tells."""

from __future__ import annotations

import os
import re
import runpy
import sys
from pathlib import Path

import nbformat
import pytest
from loaded_command import loaded_command
from nbclient import NotebookClient

DOCS = Path(__file__).resolve().parents[2] / "docs"
TEXT = (DOCS / "tutorial.md").read_text(encoding="utf-8")
FIGURES = runpy.run_path(str(DOCS / "figures.py"))
NOTEBOOKS = runpy.run_path(str(DOCS / "notebooks.py"))

SPRING = "Gravity compensating spring"
GUESS = "Torque over the position (gravity compensating spring?)"


def numbers_after(words: str, page: str) -> list[float]:
    """Per cents that the page's tables have behind these words."""
    return [float(number) for number in re.findall(f"{re.escape(words)} ([\\d.]+) %", page)]


def test_every_figure_is_drawn_by_the_script_and_every_one_drawn_is_shown() -> None:
    shown = re.findall(r"\]\(figures/(\w+)\.svg\)", TEXT)
    drawn = re.findall(r'^\s+"(\w+)": \w+\(', (DOCS / "figures.py").read_text(encoding="utf-8"), re.MULTILINE)
    assert sorted(shown) == sorted(drawn)
    elsewhere = re.findall(r"\]\(figures/(\w+)\.svg\)", (DOCS / "experiments.md").read_text(encoding="utf-8"))
    others = runpy.run_path(str(DOCS / "experiment_figures.py"))
    assert sorted(elsewhere) == sorted(others["SHOWN"])
    assert sorted(shown + elsewhere) == sorted(path.stem for path in (DOCS / "figures").glob("*.svg"))


def test_its_notebook_is_one_file_with_its_figures_and_what_is_not_run_is_text() -> None:
    cells = nbformat.reads(NOTEBOOKS["notebook"]("tutorial"), as_version=4).cells
    code = "".join(cell.source for cell in cells if cell.cell_type == "code")
    text = "".join(cell.source for cell in cells if cell.cell_type == "markdown")
    assert "dynident identify ur10 run1.csv" in code
    assert all(block.strip() in code for block in FIGURES["commands"]())
    assert "Client(" not in code
    assert "Client(" in text
    assert "](figures/" not in text
    assert text.count("](data:image/svg+xml;base64,") == 7


def in_jupyter(folder: Path) -> nbformat.NotebookNode:
    """The page as a notebook, after all of its cells were run in a folder."""
    written = nbformat.reads(NOTEBOOKS["notebook"]("tutorial"), as_version=4)
    return NotebookClient(written, timeout=600, resources={"metadata": {"path": str(folder)}}).execute()


@pytest.mark.slow
def test_its_commands_find_the_spring_in_jupyter_and_the_next_experiment_decides(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    with loaded_command(tmp_path_factory.mktemp("bin")) as programs:
        # Its cells of the shell find the command there, and all others as in the environment of the kernel.
        found = (str(programs), str(Path(sys.executable).parent), os.environ["PATH"])
        monkeypatch.setenv("PATH", os.pathsep.join(found))
        monkeypatch.setenv("COLUMNS", "120")
        done = in_jupyter(tmp_path)
    of_cells = ["".join(one.get("text", "") for one in cell.get("outputs", [])) for cell in done.cells]
    told = " ".join("".join(of_cells).split())
    # Of one recording (twice, the second time with the next experiment), of both, and in Python.
    assert told.count(f"The model lacks: {GUESS} on shoulder_lift_joint") == 4
    assert "Held-out data do not confirm Joint spring" in told
    assert re.search(r"would distinguish Gravity compensating spring from (Torque ripple|Joint spring)", told)
    page = " ".join(TEXT.split())
    for rung in ("1 first model", *(f"2 {name} on shoulder_lift_joint" for name in (SPRING, "Joint spring"))):
        # After shape constants and the number of parameters, the errors of the fit and held out.
        found = re.search(f"{rung}(?: \\([^%]*?)? \\d+ [\\d.]+ % ([\\d.]+) %", told)
        assert found is not None
        # Rounding differs from one kind of processor to the next, and what was searched for with it.
        assert any(abs(float(found[1]) - said) < 0.1 * said for said in numbers_after(rung[2:], page)), rung
    (python,) = (
        of_cells[k] for k, cell in enumerate(done.cells) if "import dynident as dy" in cell.source and of_cells[k]
    )
    assert f"{GUESS} on shoulder_lift_joint" in python
    assert "slow_sweep" in python
    assert all(figure.startswith("<svg") for figure in FIGURES["draw"](tmp_path).values())
