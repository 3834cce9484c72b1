"""What is said of files, and said anew, between the contract and the science."""

from __future__ import annotations

from collections.abc import Sequence

from dynident.recordings import Check, RecordingMetadata, Revision
from dynident_service.adapters.answers import known
from dynident_service.adapters.derived import body, taken
from dynident_service.models import measurements as wire
from dynident_service.models.revisions import RevisionRequest


def metadata_of(said: wire.MeasurementMetadata) -> RecordingMetadata:
    """Take what is said of a file; `RecordingError` for a window or a delay that cannot be."""
    return taken(said, RecordingMetadata, **said.model_dump(include={"payload"}))


def revision_of(asked: RevisionRequest) -> Revision:
    """Take a revision."""
    return taken(asked, Revision)


def show_revision(found: Revision) -> RevisionRequest:
    """Show a revision."""
    return RevisionRequest.model_validate({name: getattr(found, name) for name in found.changes})


def revised(said: wire.MeasurementMetadata, asked: RevisionRequest) -> wire.MeasurementMetadata:
    """What is said of a file with a revision."""
    after = revision_of(asked).of(metadata_of(said))
    return body(wire.MeasurementMetadata, after, robot_id=said.robot_id)


def checks_of(shown: Sequence[wire.CheckView]) -> tuple[Check, ...]:
    """Take checks that were shown."""
    return tuple(known(Check, one, apply=None if one.apply is None else revision_of(one.apply)) for one in shown)
