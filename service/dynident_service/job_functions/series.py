"""Job: monitor a robot over many days."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

from dynident.diagnosis.monitoring import (
    Day,
    Measure,
    build_measure,
    days_to_bytes,
    find_free_name,
    load_days,
    reduce_day,
)
from dynident.diagnosis.monitoring import monitor_days as series_of
from dynident.errors import DynidentError
from dynident.progress import scale_progress
from dynident.reports.figures.changes import draw_parameter_tracks
from dynident.text_encoding import encode_text
from dynident_service.adapters.diagnoses import describe_series
from dynident_service.job_functions.stored_inputs import load_stored_model, open_stored_recordings
from dynident_service.jobs.task_input_output import Outcome, Task
from dynident_service.wire_types.diagnoses import Day as AskedDay
from dynident_service.wire_types.diagnoses import SeriesRequest
from dynident_service.wire_types.shared_types import to_plain_json


def follow_robot(task: Task) -> Outcome:
    """Find what has changed over the days and since when, and track each parameter."""
    request = SeriesRequest.model_validate(task.subject.request)
    measure, days = _begin_series(task, request)
    for number, day_request in enumerate(request.days):
        days.append(_reduce_day(task, measure, day_request, days, f"/days/{number}"))
        task.progress(0.5 * (number + 1) / len(request.days), days[-1].name)
    monitored = series_of(measure, days, scale_progress(task.progress, 0.5, 0.95))
    days_file = task.store_file("days", days_to_bytes(measure, days))
    figure_file = task.store_file("figure", encode_text(str(draw_parameter_tracks(monitored))), "image/svg+xml")
    return Outcome(to_plain_json(describe_series(monitored)), (days_file, figure_file))


def _begin_series(task: Task, request: SeriesRequest) -> tuple[Measure, list[Day]]:
    """Return what each day is reduced to, and the days of the series that this one continues.

    Temperatures are included if the first day of all has them.
    """
    model = load_stored_model(task, request.identification_id)
    if request.continues is None:
        first = open_stored_recordings(task, request.days[0].measurement_ids)
        return build_measure(model, with_temperature=all(recording.has_temperature for recording in first)), []
    earlier = task.resources.get("series", request.continues)
    content = task.objects.get(earlier.objects["days"].key)
    # The days of the earlier series come reduced: their recordings are not read again.
    measure, days = load_days(model, content)
    return measure, list(days)


def _reduce_day(task: Task, measure: Measure, day_request: AskedDay, before: Sequence[Day], pointer: str) -> Day:
    recordings = open_stored_recordings(task, day_request.measurement_ids)
    source = hashlib.sha256(",".join(day_request.measurement_ids).encode()).hexdigest()
    # The same day twice would count its noise as evidence for constancy.
    if any(day.source == source for day in before):
        raise DynidentError("these measurements are already a day of the series", pointer=pointer, title="Twice")
    return reduce_day(
        measure, day_request.name or find_free_name(recordings[0].name, before), recordings, source=source
    )
