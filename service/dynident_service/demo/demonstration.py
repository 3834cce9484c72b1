"""The demonstration from beginning to end."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from pathlib import Path

from rich.console import Console

from dynident.effects import get_effect
from dynident.encoding import encode_text
from dynident.errors import DynidentError
from dynident.identification import to_bytes
from dynident.progress import scale_progress
from dynident_service.cli.files import write_atomically
from dynident_service.cli.terminal import show_progress_bar
from dynident_service.demo import console_output
from dynident_service.demo.analysis import Analysis, analyse_recordings
from dynident_service.demo.measurement import MeasuredRun, design_runs, record_runs, write_hidden_effect
from dynident_service.demo.scenario import Scenario


@dataclass(frozen=True, eq=False)
class Outcome:
    """The scenario, the results of the analysis, and the time that it all took (s)."""

    scenario: Scenario
    analysis: Analysis
    folder: Path
    seconds: float

    @property
    def is_named_correctly(self) -> bool:
        """True where the diagnosis recommends the hidden effect on its joint, or nothing where nothing was hidden."""
        hidden = self.scenario.hidden
        recommended = self.analysis.diagnosis.recommended
        if hidden is None:
            return not recommended
        # Some effects are the same function under two names. No data can tell these apart.
        names = {hidden.effect, *get_effect(hidden.effect).same_function}
        return any(
            choice.effect in names and (not hidden.joint or hidden.joint in choice.joints) for choice in recommended
        )

    @property
    def joints(self) -> tuple[int, ...]:
        """Indices of the joints that the hidden effect acts on; all joints where it belongs to the robot."""
        names = self.scenario.robot.joint_names
        hidden = self.scenario.hidden
        return (names.index(hidden.joint),) if hidden is not None and hidden.joint else tuple(range(len(names)))

    def to_document(self) -> dict[str, object]:
        """Return the outcome as a JSON document."""
        analysis, hidden = self.analysis, self.scenario.hidden
        return {
            "robot": self.scenario.robot.name,
            "joints": list(self.scenario.robot.joint_names),
            "seed": self.scenario.seed,
            "hidden": None
            if hidden is None
            else {**asdict(hidden), "values": dict(hidden.values), "shape": dict(hidden.shape)},
            "verdict": analysis.diagnosis.verdict,
            "named": [
                {"effect": choice.effect, "joints": list(choice.joints)} for choice in analysis.diagnosis.recommended
            ],
            "named_right": self.is_named_correctly,
            "noise_floor": analysis.diagnosis.noise_floor.tolist(),
            "ladder": [
                {
                    "added": [{"effect": choice.effect, "joints": list(choice.joints)} for choice in model.step.added],
                    "fit": model.fit.relative_total,
                    "held_out": model.held_out.relative_total if model.held_out is not None else None,
                    "held_out_over_noise_floor": analysis.compute_floor_ratio(model).tolist(),
                }
                for model in analysis.ladder
            ],
            "hidden_joints": list(self.joints),
            "folder": str(self.folder),
            "seconds": self.seconds,
        }


def run_demonstration(scenario: Scenario, folder: Path, console: Console) -> Outcome:
    """Run the demonstration, report on it as it goes, and write its files.

    Parameters
    ----------
    scenario : Scenario
    folder : Path
        For the files; it is made where it does not exist.
    console : Console
        For the text.

    Returns
    -------
    Outcome
    """
    _make_folder(folder)
    begun = time.monotonic()
    console_output.print_introduction(console, scenario)
    with show_progress_bar("design and measure") as progress:
        designs = design_runs(scenario, scale_progress(progress, 0.0, 0.5))
        # Written before anything is analysed: nobody can say later that it was made to fit.
        write_hidden_effect(scenario, folder / "hidden.json")
        runs = record_runs(scenario, designs, folder, scale_progress(progress, 0.5, 1.0))
    console_output.print_experiment(console, runs, time.monotonic() - begun)
    analysis = _analyse_files(scenario, runs)
    write_atomically(folder / "first_model.npz", to_bytes(analysis.first))
    write_atomically(folder / "model.npz", to_bytes(analysis.last))
    write_atomically(folder / "report.html", encode_text(analysis.report))
    outcome = Outcome(scenario, analysis, folder, time.monotonic() - begun)
    console_output.print_findings(console, scenario.robot, analysis)
    console_output.print_hidden_effect(console, scenario, analysis, outcome.is_named_correctly, outcome.joints)
    console_output.print_files(console, scenario.robot, runs, folder, outcome.seconds)
    return outcome


def _analyse_files(scenario: Scenario, runs: list[MeasuredRun]) -> Analysis:
    """Analyse the files with nothing but the robot's description: what is hidden is not passed on."""
    # The last run is the validation: no parameter sees it.
    training, held_out = [run.path for run in runs[:-1]], [runs[-1].path]
    with show_progress_bar("identify and diagnose") as progress:
        return analyse_recordings(scenario.robot, training, held_out, runs[0].design, progress)


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DynidentError(f"cannot make the folder {folder}: {error.strerror}", pointer="--out") from error
