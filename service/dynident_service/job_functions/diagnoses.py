"""Job: diagnose a model."""

from __future__ import annotations

from dynident.advice import advise
from dynident.diagnosis import DiagnosisChoices, evidence, examine
from dynident.diagnosis.changes_between_recordings import identify_on_both
from dynident.progress import scale_progress
from dynident_service.adapters.diagnoses import describe_diagnosis, write_evidence
from dynident_service.adapters.field_by_field import to_request
from dynident_service.job_functions.stored_inputs import load_stored_model, open_stored_recordings
from dynident_service.jobs.task_input_output import Outcome, Task
from dynident_service.wire_types.diagnoses import DiagnosisRequest
from dynident_service.wire_types.shared_types import to_plain_json


def diagnose_model(task: Task) -> Outcome:
    """Find which effects an identified model lacks, and propose the next experiment."""
    subject = task.subject
    request = DiagnosisRequest.model_validate(subject.request)
    choices = to_request(request, DiagnosisChoices)
    identification = task.resources.get("identification", request.identification_id)
    measurement_ids = request.measurement_ids or identification.request["measurement_ids"]
    model = load_stored_model(task, request.identification_id)
    recordings = open_stored_recordings(task, measurement_ids)
    earlier = open_stored_recordings(task, request.baseline_ids)
    # What is known of the robot now, which may be more than when the model was identified.
    robot = task.resources.get("robot", identification.get_dependency("robot")).request
    stated = {**dict.fromkeys(robot.get("has", ()), True), **dict.fromkeys(robot.get("has_not", ()), False)}
    examined = examine(
        model,
        recordings,
        baseline=earlier,
        candidates=choices.candidates,
        most_effects=choices.max_effects,
        significance=choices.significance,
        hardware={**stated, **choices.hardware},
        progress=scale_progress(task.progress, 0.0, 0.9),
    )
    diagnosis = advise(examined)
    # With a baseline, the evidence is of a model identified on all recordings as if nothing had changed.
    explained_model, explained_recordings, _ = (
        identify_on_both(model, earlier, recordings) if earlier else (model, recordings, ())
    )
    figures = evidence(
        explained_model, diagnosis.candidates, explained_recordings, scale_progress(task.progress, 0.9, 1.0)
    )
    evidence_file = task.store_file("evidence", write_evidence(figures, model.model.robot), "application/json")
    # Those that were diagnosed: tests of single joints' friction are left out.
    everything = zip((*request.baseline_ids, *measurement_ids), (*earlier, *recordings), strict=True)
    diagnosed_ids = [identifier for identifier, recording in everything if recording.role != "friction"]
    return Outcome(
        to_plain_json(
            describe_diagnosis(
                diagnosis, identification.get_dependency("robot"), diagnosed_ids, request.identification_id
            )
        ),
        (evidence_file,),
    )
