"""Verdicts of models, for requests that wait for them: plain values in, plain values out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypedDict

from dynident.identification import from_bytes
from dynident.recordings import Check, open_recording
from dynident.recordings.types import Status
from dynident.validation import Judged, Verdict
from dynident.verdict import Outcome, verdict
from dynident_service.adapters.verdicts import SeenMeasurement, show_verdict
from dynident_service.models.common import plain
from dynident_service.models.measurements import MeasurementMetadata


class SentCheck(TypedDict):
    """What is sent of a check."""

    name: str
    status: Status
    detail: str


class SentMeasurement(TypedDict):
    """What is sent of a measurement; `recording` is a path, `checks` are as they were found."""

    id: str
    recording: str
    request: Mapping[str, object]
    checks: Sequence[SentCheck]


class SentOutcome(TypedDict):
    """What is sent of a validation that has ended."""

    kind: str
    verdict: Verdict
    reason: str


def judge(
    model: str,
    fitted: Sequence[SentMeasurement],
    held_out: Sequence[SentMeasurement],
    outcomes: Sequence[SentOutcome] = (),
) -> dict[str, object]:
    """Say what the model in a file is fit for."""
    names: set[str] = set()
    seen = [_opened(one, names) for one in fitted], [_opened(one, names) for one in held_out]
    pairs = zip([*seen[0], *seen[1]], [*fitted, *held_out], strict=True)
    checks = {one.recording.name: _checks(given) for one, given in pairs}
    recordings, validation = ([one.recording for one in group] for group in seen)
    ended = [Outcome(one["kind"], Judged(one["verdict"], one["reason"])) for one in outcomes]
    found = verdict(from_bytes(Path(model).read_bytes()), recordings, validation, checks, ended)
    return plain(show_verdict(found, [*seen[0], *seen[1]]))


def _checks(one: SentMeasurement) -> list[Check]:
    return [Check(check["name"], check["status"], check["detail"]) for check in one["checks"]]


def _opened(one: SentMeasurement, names: set[str]) -> SeenMeasurement:
    recording = open_recording(Path(one["recording"]))
    # The verdict tells of recordings by name, and measurements may share one.
    name = recording.name if recording.name not in names else f"{recording.name} ({one['id']})"
    names.add(name)
    return SeenMeasurement(one["id"], replace(recording, name=name), MeasurementMetadata.model_validate(one["request"]))
