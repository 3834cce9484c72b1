"""Jobs: diagnose a model; monitor a robot over many days."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace

from dynident.advice import decide_doubts
from dynident.diagnosis import DiagnosisChoices, evidence, examine
from dynident.diagnosis.changes_between_recordings import identify_on_both
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
from dynident.robot.limits_and_drives import split_hardware
from dynident.text_encoding import encode_text
from dynident_service.diagnoses.adapters import (
    describe_diagnosis,
    describe_series,
    restore_doubts,
    show_next_experiment,
    write_evidence,
)
from dynident_service.diagnoses.wire_types import Day as AskedDay
from dynident_service.diagnoses.wire_types import DiagnosisRequest, NextExperimentResult, SeriesRequest
from dynident_service.jobs.task_input_output import Outcome, Task
from dynident_service.shared.field_by_field import to_request
from dynident_service.shared.stored_inputs import load_stored_checks, load_stored_model, open_stored_recordings
from dynident_service.shared.wire_types import to_plain_json


def diagnose_model(task: Task) -> Outcome:
    """Find which effects an identified model lacks."""
    subject = task.subject
    request = DiagnosisRequest.model_validate(subject.request)
    choices = to_request(request, DiagnosisChoices)
    identification = task.resources.get("identification", request.identification_id)
    measurement_ids = request.measurement_ids or identification.request["measurement_ids"]
    model = load_stored_model(task, request.identification_id)
    recordings = open_stored_recordings(task, measurement_ids)
    earlier = open_stored_recordings(task, request.baseline_ids)
    # Held-out recordings are of the days of the identification, and the robot of other recordings may differ since.
    is_own = set(measurement_ids) <= set(identification.request["measurement_ids"])
    held_out_ids = identification.request.get("validation_ids", ()) if is_own else ()
    # What is known of the robot now, which may be more than when the model was identified.
    robot = task.resources.get("robot", identification.get_dependency("robot")).request
    stated = {**dict.fromkeys(robot.get("has", ()), True), **dict.fromkeys(robot.get("has_not", ()), False)}
    has, has_not = split_hardware({**stated, **choices.hardware})
    examined = examine(
        model,
        recordings,
        replace(choices, has=has, has_not=has_not),
        baseline=earlier,
        validation=open_stored_recordings(task, held_out_ids),
        checks=load_stored_checks(task, measurement_ids),
        progress=scale_progress(task.progress, 0.0, 0.9),
    )
    diagnosis = examined.diagnosis
    # With a baseline, the evidence is of a model identified on all recordings as if nothing had changed.
    explained_model, explained_recordings, _ = (
        identify_on_both(model, earlier, recordings) if earlier else (model, recordings, ())
    )
    figures = evidence(
        explained_model, diagnosis.candidates, explained_recordings, scale_progress(task.progress, 0.9, 1.0)
    )
    evidence_file = task.store_file("evidence", write_evidence(figures, model.model.robot), "application/json")
    return Outcome(to_plain_json(describe_diagnosis(diagnosis, doubts=examined.doubts)), (evidence_file,))


def find_next_experiment(task: Task) -> Outcome:
    """Look for a motion that decides what a diagnosis left open."""
    diagnosed = task.resources.get("diagnosis", task.subject.get_dependency("diagnosis"))
    request = DiagnosisRequest.model_validate(diagnosed.request)
    identification = task.resources.get("identification", request.identification_id)
    measurement_ids = request.measurement_ids or identification.request["measurement_ids"]
    recordings = open_stored_recordings(task, measurement_ids)
    earlier = open_stored_recordings(task, request.baseline_ids)
    model = load_stored_model(task, request.identification_id)
    doubts = restore_doubts(diagnosed.result or {})
    proposed = decide_doubts(model, recordings, doubts, earlier, task.progress)
    # Those that were diagnosed: tests of single joints' friction are left out.
    everything = zip((*request.baseline_ids, *measurement_ids), (*earlier, *recordings), strict=True)
    diagnosed_ids = [identifier for identifier, recording in everything if recording.role != "friction"]
    experiment = None
    if proposed is not None:
        robot_id = identification.get_dependency("robot")
        experiment = show_next_experiment(proposed, robot_id, diagnosed_ids, request.identification_id)
    return Outcome(to_plain_json(NextExperimentResult(experiment=experiment)))


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
