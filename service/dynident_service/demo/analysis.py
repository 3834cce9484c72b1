"""From files to a named effect: what any user would do, and all that the analysis ever sees."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from dynident.advice import AdvisedDiagnosis, advise
from dynident.arrays import FloatArray
from dynident.diagnosis import Comparison, Diagnosis, compare, examine
from dynident.excitation import Design
from dynident.identification import Identification, extend, identify
from dynident.progress import Progress, part
from dynident.recordings import Recording
from dynident.reports import html_report
from dynident.robot import Robot
from dynident_service.cli.inputs import Loaded, loaded, recordings_of
from dynident_service.cli.options import Reading
from dynident_service.cli.reporting import reported_runs


@dataclass(frozen=True, eq=False)
class Analysis:
    """What came out, step by step; `ladder` from the first model to the last."""

    training: tuple[Loaded, ...]
    held_out: tuple[Loaded, ...]
    comparison: Comparison
    diagnosis: AdvisedDiagnosis
    ladder: tuple[Identification, ...]
    report: str

    @property
    def first(self) -> Identification:
        """The model before anything was added."""
        return self.ladder[0]

    @property
    def last(self) -> Identification:
        """The model with everything that the diagnosis recommends."""
        return self.ladder[-1]

    def over_floor(self, model: Identification) -> FloatArray:
        """(n,): held-out residual of a model where joints move, over the noise floor; 1 is all that can be reached."""
        moving = model.held_out_moving
        assert moving is not None
        return moving.rms / self.diagnosis.noise_floor


def analyse(
    robot: Robot,
    training: Sequence[Path],
    held_out: Sequence[Path],
    design: Design,
    progress: Progress,
) -> Analysis:
    """Identify, compare, diagnose, add what is missing one by one, and write the report (with the first design)."""
    with loaded(training, robot, Reading(), part(progress, 0.0, 0.1), held_out) as (given, tried):
        recordings, validation = recordings_of(given), recordings_of(tried)
        first = identify(robot, recordings, validation, progress=part(progress, 0.1, 0.2))
        compared = compare(first, validation[0])
        found = advise(examine(first, recordings, progress=part(progress, 0.2, 0.7)))
        ladder = _ladder(first, found, recordings, validation, part(progress, 0.7, 0.85))
        runs = reported_runs(ladder[-1], given, tried, part(progress, 0.85, 0.9))
        progress(0.9, "writing the report")
        report = html_report(ladder[-1], runs, diagnosis=found, design=design, title=f"Demonstration: {robot.name}")
        return Analysis(tuple(given), tuple(tried), compared, found, tuple(ladder), report)


def _ladder(
    first: Identification,
    found: Diagnosis,
    recordings: Sequence[Recording],
    validation: Sequence[Recording],
    progress: Progress,
) -> list[Identification]:
    models = [first]
    for index, choice in enumerate(found.recommended):
        progress(index / len(found.recommended), f"adding {choice.effect}")
        models.append(extend(models[-1], [choice], recordings, validation))
    return models
