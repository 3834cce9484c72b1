"""The section on the origin of the report: versions, time, choices, hashes of files."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from hashlib import sha256
from importlib.metadata import version

from dynident.encoding import encode_text
from dynident.identification import Identification
from dynident.reports.commands import build_commands, collect_metadata_files
from dynident.reports.run import ReportedRecording
from dynident.reports.section import Section
from dynident.version import __version__

_PACKAGES = ("casadi", "numpy", "scipy", "pin", "pyarrow")


@dataclass(frozen=True)
class ProvenanceContent:
    """The content of the section.

    Attributes
    ----------
    facts : tuple of (name, value)
    commands : tuple of str
        Commands that make the model again.
    files : tuple of (name, content)
        The files that the commands name.
    address : str
        URL of a page that shows the model, "" where it is unknown.
    """

    facts: tuple[tuple[str, str], ...]
    commands: tuple[str, ...]
    files: tuple[tuple[str, str], ...] = ()
    address: str = ""


def build_provenance_section(
    identification: Identification, runs: Sequence[ReportedRecording], created: datetime, address: str = ""
) -> Section:
    """Return the section on how to get the same model again.

    Parameters
    ----------
    identification : Identification
    runs : sequence of ReportedRun
    created : datetime
        When the report was made, with its time zone.
    address : str
        URL of a page that shows the model, or "".

    Returns
    -------
    Section
    """
    robot = identification.model.robot
    digest = sha256(encode_text(robot.description.content)).hexdigest()
    facts = (
        ("made", created.astimezone(UTC).strftime("%Y-%m-%d %H:%M UTC")),
        ("dynident", __version__),
        ("python", platform.python_version()),
        ("packages", ", ".join(f"{name} {version(name)}" for name in _PACKAGES)),
        ("robot description", f"{robot.description.format}, sha256 {digest}"),
        ("identified from", ", ".join(identification.data.measurement_names)),
        ("tried on", ", ".join(identification.data.validation_names) or "no held-out data"),
        ("shown", ", ".join(run.name for run in runs)),
        *((f"file of {run.name}", f"sha256 {run.sha256}") for run in runs if run.sha256),
        *((f"said anew of {run.name}", "; then ".join(map(str, run.edits))) for run in runs if run.edits),
        ("models before this one", str(len(list(identification.ladder())) - 1)),
    )
    metadata = {run.name: run.stated_metadata for run in runs if run.stated_metadata is not None}
    command_lines = build_commands(identification, [run.recording for run in runs], metadata)
    files = tuple(collect_metadata_files(metadata).items())
    return Section("provenance", "Provenance", "provenance", ProvenanceContent(facts, command_lines, files, address))
