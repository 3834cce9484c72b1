"""The contents of a report, from the recordings that a command has read."""

from __future__ import annotations

from collections.abc import Sequence

from dynident.diagnosis import compare
from dynident.identification import Identification
from dynident.progress import Progress, part
from dynident.recordings.digest import digest_of
from dynident.reports import ReportedRun
from dynident_service.cli.inputs import Loaded


def reported_runs(
    identification: Identification, training: Sequence[Loaded], held_out: Sequence[Loaded], progress: Progress
) -> list[ReportedRun]:
    """Compare each recording with the model's prediction, for the report."""
    everything = [(item, False) for item in training] + [(item, True) for item in held_out]
    runs = []
    for index, (item, is_held_out) in enumerate(everything):
        share = part(progress, index / len(everything), (index + 1) / len(everything))
        compared = compare(identification, item.recording, share)
        runs.append(
            ReportedRun(item.recording, compared, is_held_out, item.checks, sha256=digest_of(item.path), said=item.said)
        )
    return runs
