"""Metadata of recordings and their revisions, converted between the contract and the library."""

from __future__ import annotations

from collections.abc import Sequence

from dynident.recordings import Check, RecordingMetadata, Revision
from dynident_service.adapters.answers import from_view
from dynident_service.adapters.derived import to_body, to_request
from dynident_service.models import measurements as wire
from dynident_service.models.revisions import RevisionRequest


def to_recording_metadata(metadata: wire.MeasurementMetadata) -> RecordingMetadata:
    """Convert metadata of a body; `RecordingError` for an impossible window or delay."""
    return to_request(metadata, RecordingMetadata, **metadata.model_dump(include={"payload"}))


def to_revision(revision_request: RevisionRequest) -> Revision:
    """Convert a revision of a body."""
    return to_request(revision_request, Revision)


def show_revision(revision: Revision) -> RevisionRequest:
    """Build the view of a revision, with the fields that it changes."""
    return RevisionRequest.model_validate({name: getattr(revision, name) for name in revision.changes})


def apply_revision(metadata: wire.MeasurementMetadata, revision_request: RevisionRequest) -> wire.MeasurementMetadata:
    """Return the metadata of a file after a revision."""
    after = to_revision(revision_request).apply_to(to_recording_metadata(metadata))
    return to_body(wire.MeasurementMetadata, after, robot_id=metadata.robot_id)


def restore_checks(views: Sequence[wire.CheckView]) -> tuple[Check, ...]:
    """Restore checks from their views."""
    return tuple(
        from_view(Check, view, apply=None if view.apply is None else to_revision(view.apply)) for view in views
    )
