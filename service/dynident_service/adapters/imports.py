"""Files that are looked at, between the contract and the science."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from dynident.identification.imports import Inspection, inspect_file
from dynident.recordings import RecordingMetadata
from dynident.robot import Robot
from dynident_service.adapters.answers import shown
from dynident_service.adapters.derived import body, taken
from dynident_service.models import imports as wire
from dynident_service.models.common import plain
from dynident_service.models.measurements import MeasurementMetadata


def look_at(source: Path, robot: Robot, said: wire.ImportMetadata, sha256: str) -> wire.ImportResult:
    """Look at a user's file, which is known by its `sha256`; what is said of it goes before what is guessed."""
    known = taken(said, RecordingMetadata)
    found = inspect_file(source, robot, known.rate)
    assert found.proposal is not None
    proposed = replace(
        known,
        columns={**found.proposal.columns, **known.columns},
        units={**found.proposal.units, **known.units},
        effort_kind=found.proposal.effort_kind,
    )
    answered = {key.rstrip("0123456789") for key in (*known.columns, *known.units)}
    view = describe_inspection(found, sha256)
    questions = [one for one in view.questions if one.field.rpartition("/")[2].rstrip("0123456789") not in answered]
    document = plain(body(MeasurementMetadata, proposed, robot_id=said.robot_id))
    return wire.ImportResult(**{**view.model_dump(), "questions": questions, "proposed": document})


def describe_inspection(found: Inspection, sha256: str) -> wire.InspectionView:
    """Describe what was found in a file for the wire."""
    proposal = found.proposal
    questions = [
        shown(wire.QuestionView, one, choices=one.choices or None) for one in (proposal.questions if proposal else ())
    ]
    return shown(
        wire.InspectionView,
        found,
        sha256=sha256,
        guesses=proposal.guesses if proposal else [],
        questions=questions,
        effort_kind=proposal.effort_kind if proposal else "unknown",
        preview=shown(wire.PreviewView, found),
    )
