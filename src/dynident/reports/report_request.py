"""The request of a report: its format (HTML, PDF) and options."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from dynident.schema.fields import Request, declare_field

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
