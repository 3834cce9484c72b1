"""Run the tutorial's commands and draw its figures: `python docs/figures.py [--folder FOLDER]`.

The figures are written to docs/figures; what the commands print, and all files, stay in the folder.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from dynident import load_model, read_recordings
from dynident.diagnosis import Diagnosis, compare, evidence
from dynident.excitation import design_experiment
from dynident.identification import Identification
from dynident.recordings import Recording
from dynident.reports.figures.design import draw_design
from dynident.reports.figures.diagnosis import draw_candidates, draw_evidence
from dynident.reports.figures.ladder import draw_models
from dynident.reports.figures.residuals import draw_residuals
from dynident.reports.figures.signals_over_time import draw_torque
from dynident_cli.contract_documents import load_diagnosis
from dynident_cli.design_and_simulation_files import load_proposed_design

HERE = Path(__file__).resolve().parent
FIGURES = HERE / "figures"
JOINT = "shoulder_lift_joint"
RIVAL = "joint_spring"
_BARS = 6


def commands() -> list[str]:
    """The shell blocks of the tutorial, in their order."""
    text = (HERE / "tutorial.md").read_text(encoding="utf-8")
    return re.findall(r"^```sh\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def run(folder: Path) -> None:
    """Run the tutorial's commands in a folder; what they print is kept in told.txt."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    with (folder / "told.txt").open("w", encoding="utf-8") as told:
        for block in commands():
            told.write(f"$ {block}")
            told.flush()
            environment = {**os.environ, "PATH": path, "COLUMNS": "120"}
            subprocess.run(["/bin/sh", "-e", "-c", block], cwd=folder, env=environment, stdout=told, check=True)


def draw(folder: Path) -> dict[str, str]:
    """The figures by name, from the files that the commands left."""
    first, better = (load_model(folder / name).identification for name in ("model.npz", "better.npz"))
    found = load_diagnosis(folder / "diagnosis.json")
    robot = first.model.robot
    joint = robot.joint_names.index(JOINT)
    files = [folder / name for name in ("run1.csv", "run2.csv", "validation.csv")]
    run1, run2, validation = read_recordings(*files, robot=robot).recordings
    compared = compare(first, validation)
    return {
        "compare": draw_torque(compared, [joint], "validation"),
        "where": draw_residuals([compare(first, run1)], [joint]),
        "ranking": draw_candidates(found.candidates[:_BARS]),
        "evidence": _both(first, found, [run1]),
        "next": draw_design(design_experiment(robot, load_proposed_design(folder / "diagnosis.json")), robot),
        "decided": _both(first, found, [run1, run2]),
        "ladder": _ladder(better, found),
    }


def _both(first: Identification, found: Diagnosis, recordings: list[Recording]) -> str:
    """What the first name and its rival explain of the same data."""
    rival = next(item for item in found.candidates if item.effect == RIVAL)
    return draw_evidence(evidence(first, [found.candidates[0], rival], recordings), first.model.robot)


def _ladder(model: Identification, found: Diagnosis) -> str:
    models = list(model.ladder())
    held_out = models[-1].held_out
    assert held_out is not None
    measured = (held_out.measured / held_out.counts) ** 0.5
    return draw_models(models, found.noise_floor / measured)


def main() -> None:
    """Run, draw, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, help="where to run the commands; a temporary folder otherwise")
    parser.add_argument("--out", type=Path, default=FIGURES, help="where to write the figures")
    parser.add_argument("--only-draw", action="store_true", help="the commands have been run in the folder")
    options = parser.parse_args()
    with TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        if not options.only_draw:
            run(folder)
        options.out.mkdir(parents=True, exist_ok=True)
        for name, figure in draw(folder).items():
            (options.out / f"{name}.svg").write_text(f"{figure}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
