"""The contents of a report, from the recordings that a command has read."""

from __future__ import annotations

from collections.abc import Sequence

from dynident.diagnosis import compare
from dynident.identification import Identification
from dynident.progress import Progress, scale_progress
from dynident.recordings.recording_files import compute_digest
from dynident.reports import ReportedRecording
from dynident_service.cli.inputs import LoadedRecording


def build_reported_runs(
    identification: Identification,
    training: Sequence[LoadedRecording],
    held_out: Sequence[LoadedRecording],
    progress: Progress,
) -> list[ReportedRecording]:
    """Compare each recording with the model's prediction, for the report."""
    everything = [(item, False) for item in training] + [(item, True) for item in held_out]
    runs = []
    for index, (item, is_held_out) in enumerate(everything):
        share = scale_progress(progress, index / len(everything), (index + 1) / len(everything))
        compared = compare(identification, item.recording, share)
        runs.append(
            ReportedRecording(
                item.recording,
                compared,
                is_held_out,
                item.checks,
                sha256=compute_digest(item.path),
                stated_metadata=item.metadata,
            )
        )
    return runs
