"""Job: compare a model with a measurement."""

from __future__ import annotations

import tempfile
from pathlib import Path

from dynident.diagnosis import compare, judge
from dynident.diagnosis.comparison.comparison_files import write_comparison
from dynident.progress import scale_progress
from dynident_service.comparisons.adapters import describe_comparison
from dynident_service.comparisons.wire_types import ComparisonRequest
from dynident_service.identifications.wire_types import StoredIdentification
from dynident_service.jobs.task_input_output import Outcome, Task
from dynident_service.shared.stored_inputs import load_stored_model, open_recording_by_id, open_stored_recordings
from dynident_service.shared.wire_types import to_plain_json


def compare_model(task: Task) -> Outcome:
    """Predict the torque along a measurement and compare it with the measured one."""
    request = ComparisonRequest.model_validate(task.subject.request)
    model = load_stored_model(task, request.identification_id)
    recording = open_recording_by_id(task, request.measurement_id)
    identification = task.resources.get("identification", request.identification_id)
    training_ids = StoredIdentification.model_validate(identification.request).measurement_ids
    # Errors on data that the model was fitted to say little about its quality, so the result says which kind it is.
    held_out = request.measurement_id not in training_ids
    comparison = compare(model, recording, scale_progress(task.progress, 0.0, 0.8))
    task.progress(0.8, "looking for repeated motion")
    assessment = judge(
        comparison, recording, model.preprocessing, open_stored_recordings(task, training_ids) if held_out else ()
    )
    # Written as a file: the routes read single signals of it, and never all.
    with tempfile.TemporaryDirectory() as folder:
        path = write_comparison(comparison, Path(folder) / "signals.parquet")
        signals = task.store_file("signals", path, "application/vnd.apache.parquet")
    return Outcome(to_plain_json(describe_comparison(comparison, assessment, held_out)), (signals,))
