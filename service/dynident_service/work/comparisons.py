"""Jobs that compare a model with a measurement."""

from __future__ import annotations

import tempfile
from pathlib import Path

from dynident.diagnosis import compare, judge
from dynident.diagnosis.comparing.stored import write_comparison
from dynident.progress import part
from dynident_service.adapters.comparisons import describe_comparison
from dynident_service.jobs.work import Outcome, Task
from dynident_service.models.common import plain
from dynident_service.models.comparisons import ComparisonRequest
from dynident_service.models.identifications import StoredIdentification
from dynident_service.work.means import model_by_id, recording_by_id, recordings_by_id


def compare_model(task: Task) -> Outcome:
    """Predict the torque along a measurement and compare it with the measured one."""
    request = ComparisonRequest.model_validate(task.subject.request)
    model = model_by_id(task, request.identification_id)
    recording = recording_by_id(task, request.measurement_id)
    identification = task.resources.get("identification", request.identification_id)
    training_ids = StoredIdentification.model_validate(identification.request).measurement_ids
    # Errors on data that the model was fitted to say little about its quality, so the result says which kind it is.
    held_out = request.measurement_id not in training_ids
    comparison = compare(model, recording, part(task.progress, 0.0, 0.8))
    task.progress(0.8, "looking for repeated motion")
    assessment = judge(
        comparison, recording, model.preprocessing, recordings_by_id(task, training_ids) if held_out else ()
    )
    with tempfile.TemporaryDirectory() as folder:
        path = write_comparison(comparison, Path(folder) / "signals.parquet")
        signals = task.keep("signals", path, "application/vnd.apache.parquet")
    return Outcome(plain(describe_comparison(comparison, assessment, held_out)), (signals,))
