"""Days of a series, from measurement files and from the file that stores earlier days."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from dynident.diagnosis.monitoring import Day, Measure, build_measure, find_free_name, load_days, reduce_day
from dynident.identification import Identification
from dynident.progress import Progress, scale_progress
from dynident.recordings.recording_files import compute_digest
from dynident_service.cli.inputs import load_recordings
from dynident_service.cli.options import Reading


def load_continued_days(
    identification: Identification,
    paths: Sequence[Path],
    reading: Reading,
    keep: Path | None,
    progress: Progress,
) -> tuple[Measure, tuple[Day, ...]]:
    """Estimate the parameters of each day.

    Parameters
    ----------
    identification : Identification
        The model whose parameters are followed.
    paths : sequence of Path
        One file a day, in their order.
    reading : Reading
        How the files are read.
    keep : Path, optional
        The file that stores earlier days.
    progress : callable
        Reports progress.

    Returns
    -------
    measure : Measure
        Which parameters may differ from day to day.
    days : tuple of Day
        The stored days in their order, then the new ones.
    """
    robot = identification.model.robot
    days: tuple[Day, ...] = ()
    content = keep.read_bytes() if keep is not None and keep.exists() else None
    with load_recordings(paths, robot, reading, scale_progress(progress, 0.0, 0.6)) as (measurements, _):
        recordings = [item.recording for item in measurements]
        if content is None:
            # The first files decide whether temperature is a regressor: all later days have to be comparable.
            warm = all(recording.has_temperature for recording in recordings)
            measure = build_measure(identification, with_temperature=warm)
        else:
            measure, days = load_days(identification, content)
        all_days = list(days)
        # A digest of its file is what a day is known by.
        sources = [compute_digest(path) for path in paths]
        for number, (recording, source) in enumerate(zip(recordings, sources, strict=True)):
            # A file that is stored already is known by its hash, whatever it is called now.
            if any(day.source == source for day in all_days):
                continue
            day_progress = scale_progress(
                progress, 0.6 + 0.4 * number / len(paths), 0.6 + 0.4 * (number + 1) / len(paths)
            )
            all_days.append(
                reduce_day(measure, find_free_name(recording.name, all_days), [recording], day_progress, source)
            )
    return measure, tuple(all_days)
