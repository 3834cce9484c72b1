"""The request of a report (format, heading) and what it is made from: sections, reported recordings and validations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from dynident.schema.fields import Request, declare_field

if TYPE_CHECKING:
    # A request is read without the code that answers it.
    from dynident.diagnosis import Comparison
    from dynident.presentation.tables import ReportedTable
    from dynident.recordings import Check, Recording, RecordingMetadata, Revision
    from dynident.validation import ValidationOutcome

ReportFormat = Literal["html", "pdf", "json"]
MEDIA_TYPES: dict[ReportFormat, str] = {"html": "text/html", "pdf": "application/pdf", "json": "application/json"}


@dataclass(frozen=True)
class ReportChoices(Request):
    """What a report is written as, and its heading.

    Parameters
    ----------
    format : {"html", "pdf", "json"}
        Format of the file.
    name : str
        The heading; the robot's name by default.
    """

    format: ReportFormat = declare_field("Format of the report", default="html", option="-")
    name: str = declare_field("Heading of the report; the robot's name by default", default="", option="--title")


@dataclass(frozen=True, eq=False)
class Section:
    """One section of a report: a template and the content that fills it.

    Attributes
    ----------
    anchor : str
        The target of links in the table of contents.
    title : str
        Heading of the section.
    template : str
        File name of the template without its ending.
    content : object
        What the template sees under the name `it`.
    """

    anchor: str
    title: str
    template: str
    content: Any


@dataclass(frozen=True)
class ReportedValidation:
    """The result of one validation.

    Parameters
    ----------
    title : str
        What was tested.
    judged : ValidationOutcome
        The verdict and its reason.
    tables : tuple of ReportedTable
        The numbers behind it.
    kind : str
        The kind of the validation, "" where it is unknown.
    """

    title: str
    judged: ValidationOutcome
    tables: tuple[ReportedTable, ...] = ()
    kind: str = ""


@dataclass(frozen=True, eq=False)
class ReportedRecording:
    """One recording with its checks and the model's prediction.

    Parameters
    ----------
    recording : Recording
        The checked recording.
    comparison : Comparison
        Measured and predicted torque.
    held_out : bool
        True where no parameter was fitted to it.
    checks : tuple of Check
        What was found when it was imported.
    edits : tuple of Revision
        Later changes of the file's metadata, in order.
    sha256 : str
        Digest of the file, "" where it is unknown.
    stated_metadata : RecordingMetadata, optional
        The metadata that the user stated for the file, where they are known.
    """

    recording: Recording
    comparison: Comparison
    held_out: bool
    checks: tuple[Check, ...] = ()
    edits: tuple[Revision, ...] = ()
    sha256: str = ""
    stated_metadata: RecordingMetadata | None = None

    @property
    def name(self) -> str:
        """The name of the recording."""
        return self.recording.name

    @property
    def role(self) -> str:
        """What the recording was used for, in a word or two."""
        return "held out" if self.held_out else "identification"
