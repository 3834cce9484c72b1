"""The analysis of the demonstration: from recorded files to a named effect, as any user would do it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from dynident.advice import AdvisedDiagnosis, advise
from dynident.array_types import FloatArray
from dynident.diagnosis import Comparison, Diagnosis, compare, examine
from dynident.excitation import Design
from dynident.identification import Identification, extend, identify
from dynident.progress import Progress, scale_progress
from dynident.recordings import Recording
from dynident.reports import html_report
from dynident.robot import Robot
from dynident_service.cli.inputs import LoadedRecording, extract_recordings, load_recordings
from dynident_service.cli.options import Reading
from dynident_service.cli.report_contents import build_reported_runs


@dataclass(frozen=True, eq=False)
class Analysis:
    """The results of all steps; `ladder` holds the models from the first to the last."""

    training: tuple[LoadedRecording, ...]
    held_out: tuple[LoadedRecording, ...]
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

    def compute_floor_ratio(self, model: Identification) -> FloatArray:
        """Return the held-out residual of a model over the noise floor, joint by joint, where joints move.

        Parameters
        ----------
        model : Identification

        Returns
        -------
        (n,) array
            1 is the best that a model can reach.
        """
        moving = model.held_out_moving
        assert moving is not None
        return moving.rms / self.diagnosis.noise_floor


def analyse_recordings(
    robot: Robot,
    training: Sequence[Path],
    held_out: Sequence[Path],
    design: Design,
    progress: Progress,
) -> Analysis:
    """Identify, compare, diagnose, add the recommended effects one by one, and write the report.

    Parameters
    ----------
    robot : Robot
        As its description has it.
    training, held_out : sequence of Path
        Recorded files.
    design : Design
        Of the first recording, for the report.
    progress : function

    Returns
    -------
    Analysis
    """
    with load_recordings(training, robot, Reading(), scale_progress(progress, 0.0, 0.1), held_out) as (
        training_data,
        held_out_data,
    ):
        recordings, validation = extract_recordings(training_data), extract_recordings(held_out_data)
        # As any user would, with the usual effects and without a choice.
        first = identify(robot, recordings, validation, progress=scale_progress(progress, 0.1, 0.2))
        comparison = compare(first, validation[0])
        diagnosis = advise(examine(first, recordings, progress=scale_progress(progress, 0.2, 0.7)))
        ladder = _build_ladder(first, diagnosis, recordings, validation, scale_progress(progress, 0.7, 0.85))
        runs = build_reported_runs(ladder[-1], training_data, held_out_data, scale_progress(progress, 0.85, 0.9))
        progress(0.9, "writing the report")
        report = html_report(ladder[-1], runs, diagnosis=diagnosis, design=design, title=f"Demonstration: {robot.name}")
        return Analysis(tuple(training_data), tuple(held_out_data), comparison, diagnosis, tuple(ladder), report)


def _build_ladder(
    first: Identification,
    diagnosis: Diagnosis,
    recordings: Sequence[Recording],
    validation: Sequence[Recording],
    progress: Progress,
) -> list[Identification]:
    models = [first]
    for index, choice in enumerate(diagnosis.recommended):
        progress(index / len(diagnosis.recommended), f"adding {choice.effect}")
        models.append(extend(models[-1], [choice], recordings, validation))
    return models
