"""What a report is told about one recording."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.diagnosis import Comparison
from dynident.recordings import Check, Recording, RecordingMetadata, Revision


@dataclass(frozen=True, eq=False)
class ReportedRun:
    """One recording, the checks it passed, and the model's prediction beside it.

    `held_out` is true where no parameter was fitted to it; `edits` is what was said of its file since it was uploaded,
    `sha256` the file's own, "" where nobody knows it; `said` what was said of it when it was read, where that is known.
    """

    recording: Recording
    comparison: Comparison
    held_out: bool
    checks: tuple[Check, ...] = ()
    edits: tuple[Revision, ...] = ()
    sha256: str = ""
    said: RecordingMetadata | None = None

    @property
    def name(self) -> str:
        """Name of the recording."""
        return self.recording.name

    @property
    def role(self) -> str:
        """What it was used for, in a word or two."""
        return "held out" if self.held_out else "identification"
