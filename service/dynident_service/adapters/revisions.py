"""Metadata of recordings and their revisions, converted between the contract and the library."""

from __future__ import annotations

from collections.abc import Sequence

from dynident.recordings import Check, RecordingMetadata, Revision
from dynident_service.adapters.answers import known
from dynident_service.adapters.derived import body, taken
from dynident_service.models import measurements as wire
from dynident_service.models.revisions import RevisionRequest


def metadata_of(metadata: wire.MeasurementMetadata) -> RecordingMetadata:
    """Convert metadata of a body; `RecordingError` for an impossible window or delay."""
    return taken(metadata, RecordingMetadata, **metadata.model_dump(include={"payload"}))


def revision_of(revision_request: RevisionRequest) -> Revision:
    """Convert a revision of a body."""
    return taken(revision_request, Revision)


def show_revision(revision: Revision) -> RevisionRequest:
    """Build the view of a revision, with the fields that it changes."""
    return RevisionRequest.model_validate({name: getattr(revision, name) for name in revision.changes})


def revised(metadata: wire.MeasurementMetadata, revision_request: RevisionRequest) -> wire.MeasurementMetadata:
    """Return the metadata of a file after a revision."""
    after = revision_of(revision_request).of(metadata_of(metadata))
    return body(wire.MeasurementMetadata, after, robot_id=metadata.robot_id)


def checks_of(views: Sequence[wire.CheckView]) -> tuple[Check, ...]:
    """Restore checks from their views."""
    return tuple(known(Check, view, apply=None if view.apply is None else revision_of(view.apply)) for view in views)
