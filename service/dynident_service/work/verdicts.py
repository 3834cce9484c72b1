"""Fitness for use of models, for requests that wait: plain values in, plain values out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypedDict

from dynident.identification import from_bytes
from dynident.recordings import Check, open_recording
from dynident.recordings.metadata import Status
from dynident.validation import ValidationOutcome, Verdict
from dynident.verdict import Outcome, verdict
from dynident_service.adapters.verdicts import SeenMeasurement, show_verdict
from dynident_service.models.common import to_plain_json
from dynident_service.models.measurements import MeasurementMetadata


class SentCheck(TypedDict):
    """Check of a recording, as sent to the child process."""

    name: str
    status: Status
    detail: str


class SentMeasurement(TypedDict):
    """Measurement as sent to the child process; `recording` is a path."""

    id: str
    recording: str
    request: Mapping[str, object]
    checks: Sequence[SentCheck]


class SentOutcome(TypedDict):
    """Finished validation, as sent to the child process."""

    kind: str
    verdict: Verdict
    reason: str


def judge_model(
    model: str,
    fitted: Sequence[SentMeasurement],
    held_out: Sequence[SentMeasurement],
    outcomes: Sequence[SentOutcome] = (),
) -> dict[str, object]:
    """Return what the model in a file is fit for.

    Parameters
    ----------
    model : str
        Path of the model.
    fitted, held_out : sequence of SentMeasurement
        Measurements that the model was fitted to, and others.
    outcomes : sequence of SentOutcome
        Finished validations of the model.
    """
    names: set[str] = set()
    opened = (
        [_open_measurement(measurement, names) for measurement in fitted],
        [_open_measurement(measurement, names) for measurement in held_out],
    )
    pairs = zip([*opened[0], *opened[1]], [*fitted, *held_out], strict=True)
    checks = {measurement.recording.name: _build_checks(sent) for measurement, sent in pairs}
    recordings, validation = ([measurement.recording for measurement in group] for group in opened)
    ended = [Outcome(outcome["kind"], ValidationOutcome(outcome["verdict"], outcome["reason"])) for outcome in outcomes]
    result = verdict(from_bytes(Path(model).read_bytes()), recordings, validation, checks, ended)
    return to_plain_json(show_verdict(result, [*opened[0], *opened[1]]))


def _build_checks(measurement: SentMeasurement) -> list[Check]:
    return [Check(check["name"], check["status"], check["detail"]) for check in measurement["checks"]]


def _open_measurement(measurement: SentMeasurement, names: set[str]) -> SeenMeasurement:
    recording = open_recording(Path(measurement["recording"]))
    # The verdict refers to recordings by name, and two measurements may have the same one.
    name = recording.name if recording.name not in names else f"{recording.name} ({measurement['id']})"
    names.add(name)
    return SeenMeasurement(
        measurement["id"], replace(recording, name=name), MeasurementMetadata.model_validate(measurement["request"])
    )
