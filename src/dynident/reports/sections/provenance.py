"""Where the figures come from: versions, time, choices, fingerprints."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from hashlib import sha256
from importlib.metadata import version

from dynident.encoding import encode_text
from dynident.identification import Identification
from dynident.reports.commands import commands, metadata_files
from dynident.reports.run import ReportedRun
from dynident.reports.section import Section
from dynident.version import __version__

_PACKAGES = ("casadi", "numpy", "scipy", "pin", "pyarrow")


@dataclass(frozen=True)
class ProvenanceContent:
    """Names and values; the commands that make the model again, and the files that these name, with what is in them;
    where it can be looked at, "" where nobody knows."""

    facts: tuple[tuple[str, str], ...]
    commands: tuple[str, ...]
    files: tuple[tuple[str, str], ...] = ()
    address: str = ""


def provenance_section(
    identification: Identification, runs: Sequence[ReportedRun], created: datetime, address: str = ""
) -> Section:
    """How to get the same again."""
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
    told = {run.name: run.said for run in runs if run.said is not None}
    made = commands(identification, [run.recording for run in runs], told)
    files = tuple(metadata_files(told).items())
    return Section("provenance", "Provenance", "provenance", ProvenanceContent(facts, made, files, address))
