"""Inspections of uploaded files as views, with the metadata that are proposed for them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from dynident.identification.column_inference import Inspection, inspect_file
from dynident.recordings import RecordingMetadata
from dynident.robot import Robot
from dynident_service.adapters.requests import to_body, to_request
from dynident_service.adapters.serialise import to_view
from dynident_service.models import imports as wire
from dynident_service.models.common import to_plain_json
from dynident_service.models.measurements import MeasurementMetadata


def inspect_upload(source: Path, robot: Robot, metadata: wire.ImportMetadata, sha256: str) -> wire.ImportResult:
    """Inspect an uploaded file and propose metadata for it.

    Parameters
    ----------
    source : Path
        The file.
    robot : Robot
        The robot that it is a recording of.
    metadata : ImportMetadata
        What the user states; it wins over what is guessed.
    sha256 : str
        The hash of the file.

    Returns
    -------
    ImportResult
        Guesses, open questions and the proposed metadata.
    """
    stated_metadata = to_request(metadata, RecordingMetadata)
    inspection = inspect_file(source, robot, stated_metadata.rate)
    assert inspection.proposal is not None
    proposed = replace(
        stated_metadata,
        # What the user has stated stands: guesses only fill what is left open.
        columns={**inspection.proposal.columns, **stated_metadata.columns},
        units={**inspection.proposal.units, **stated_metadata.units},
        effort_kind=inspection.proposal.effort_kind,
    )
    # A question about the columns of one kind, as tau1…, is answered by any stated key of that kind.
    answered = {key.rstrip("0123456789") for key in (*stated_metadata.columns, *stated_metadata.units)}
    view = describe_inspection(inspection, sha256)
    questions = [
        question
        for question in view.questions
        if question.field.rpartition("/")[2].rstrip("0123456789") not in answered
    ]
    document = to_plain_json(to_body(MeasurementMetadata, proposed, robot_id=metadata.robot_id))
    return wire.ImportResult(**{**view.model_dump(), "questions": questions, "proposed": document})


def describe_inspection(inspection: Inspection, sha256: str) -> wire.InspectionView:
    """Build the view of an inspection; without a proposal it has no guesses and questions."""
    proposal = inspection.proposal
    questions = [
        to_view(wire.QuestionView, question, choices=question.choices or None)
        for question in (proposal.questions if proposal else ())
    ]
    return to_view(
        wire.InspectionView,
        inspection,
        sha256=sha256,
        guesses=proposal.guesses if proposal else [],
        questions=questions,
        effort_kind=proposal.effort_kind if proposal else "unknown",
        preview=to_view(wire.PreviewView, inspection),
    )
