"""The tutorial holds: its commands and its Python run as they stand, and tell what the text says they tell."""

from __future__ import annotations

import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"
TEXT = (DOCS / "tutorial.md").read_text(encoding="utf-8")
FIGURES = runpy.run_path(str(DOCS / "figures.py"))


SPRING = "Gravity compensating spring"


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


@pytest.mark.slow
def test_the_commands_find_the_spring_and_the_next_experiment_decides(tmp_path: Path) -> None:
    FIGURES["run"](tmp_path)
    told = " ".join((tmp_path / "told.txt").read_text(encoding="utf-8").split())
    assert told.count("The model lacks: Gravity compensating spring on shoulder_lift_joint") == 2
    assert "Joint spring does not survive held-out data" in told
    assert re.search(r"would tell Gravity compensating spring from (Torque ripple|Joint spring)", told)
    page = " ".join(TEXT.split())
    for rung in ("1 first model", *(f"2 {name} on shoulder_lift_joint" for name in (SPRING, "Joint spring"))):
        found = re.search(f"{rung} [\\d.]+ % ([\\d.]+) %", told)
        assert found is not None
        # Rounding differs from one kind of processor to the next, and what was searched for with it.
        assert any(abs(float(found[1]) - said) < 0.1 * said for said in numbers_after(rung[2:], page)), rung
    figures = FIGURES["draw"](tmp_path)
    assert all(figure.startswith("<svg") for figure in figures.values())
    python = re.findall(r"^```python\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)[0]
    ended = subprocess.run([sys.executable, "-c", python], cwd=tmp_path, capture_output=True, text=True, timeout=800)
    assert ended.returncode == 0, ended.stderr
    assert "Gravity compensating spring on shoulder_lift_joint" in ended.stdout
    assert "slow_sweep" in ended.stdout
