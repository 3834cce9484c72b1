"""The demonstration from beginning to end."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from pathlib import Path

from rich.console import Console

from dynident.effects import effect_by_id
from dynident.encoding import encode_text
from dynident.errors import DynidentError
from dynident.identification import to_bytes
from dynident.progress import part
from dynident_service.cli.files import write_whole
from dynident_service.cli.terminal import progress_bar
from dynident_service.demo import telling
from dynident_service.demo.analysis import Analysis, analyse
from dynident_service.demo.measuring import MeasuredRun, design_runs, measure, seal
from dynident_service.demo.scenario import Scenario


@dataclass(frozen=True, eq=False)
class Outcome:
    """The scenario, the results of the analysis, and the time that it all took (s)."""

    scenario: Scenario
    analysis: Analysis
    folder: Path
    seconds: float

    @property
    def named_right(self) -> bool:
        """True where the diagnosis recommends the hidden effect on its joint, or nothing where nothing was hidden."""
        hidden = self.scenario.hidden
        recommended = self.analysis.diagnosis.recommended
        if hidden is None:
            return not recommended
        # Some effects are the same function under two names. No data can tell these apart.
        names = {hidden.effect, *effect_by_id(hidden.effect).same_function}
        return any(
            choice.effect in names and (not hidden.joint or hidden.joint in choice.joints) for choice in recommended
        )

    @property
    def joints(self) -> tuple[int, ...]:
        """Indices of the joints that the hidden effect acts on; all joints where it belongs to the robot."""
        names = self.scenario.robot.joint_names
        hidden = self.scenario.hidden
        return (names.index(hidden.joint),) if hidden is not None and hidden.joint else tuple(range(len(names)))

    def document(self) -> dict[str, object]:
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
            "named_right": self.named_right,
            "noise_floor": analysis.diagnosis.noise_floor.tolist(),
            "ladder": [
                {
                    "added": [{"effect": choice.effect, "joints": list(choice.joints)} for choice in model.step.added],
                    "fit": model.fit.relative_total,
                    "held_out": model.held_out.relative_total if model.held_out is not None else None,
                    "held_out_over_noise_floor": analysis.over_floor(model).tolist(),
                }
                for model in analysis.ladder
            ],
            "hidden_joints": list(self.joints),
            "folder": str(self.folder),
            "seconds": self.seconds,
        }


def tell(scenario: Scenario, folder: Path, console: Console) -> Outcome:
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
    _prepare(folder)
    begun = time.monotonic()
    telling.opening(console, scenario)
    with progress_bar("design and measure") as progress:
        designs = design_runs(scenario, part(progress, 0.0, 0.5))
        seal(scenario, folder / "hidden.json")
        runs = measure(scenario, designs, folder, part(progress, 0.5, 1.0))
    telling.experiment(console, runs, time.monotonic() - begun)
    analysis = _analysed(scenario, runs)
    write_whole(folder / "first_model.npz", to_bytes(analysis.first))
    write_whole(folder / "model.npz", to_bytes(analysis.last))
    write_whole(folder / "report.html", encode_text(analysis.report))
    outcome = Outcome(scenario, analysis, folder, time.monotonic() - begun)
    telling.findings(console, scenario.robot, analysis)
    telling.envelope(console, scenario, analysis, outcome.named_right, outcome.joints)
    telling.closing(console, scenario.robot, runs, folder, outcome.seconds)
    return outcome


def _analysed(scenario: Scenario, runs: list[MeasuredRun]) -> Analysis:
    """Analyse the files with nothing but the robot's description: what is hidden is not passed on."""
    training, held_out = [run.path for run in runs[:-1]], [runs[-1].path]
    with progress_bar("identify and diagnose") as progress:
        return analyse(scenario.robot, training, held_out, runs[0].design, progress)


def _prepare(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DynidentError(f"cannot make the folder {folder}: {error.strerror}", pointer="--out") from error
