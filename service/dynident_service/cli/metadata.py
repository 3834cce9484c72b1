"""What is said of a file in a file of its own, as `dynident inspect --out` writes it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_args

from dynident.errors import DynidentError
from dynident.identification.imports import EffortKind, Inspection
from dynident_service.cli.files import check_readable

NEEDED_FOR_GAINS = "drives"
_FIELDS = ("columns", "units", "windows", "effort_kind", "questions", "name", "format")


@dataclass(frozen=True)
class Said:
    """Columns, units and windows of a file, and what its efforts are."""

    columns: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    windows: tuple[tuple[float, float], ...] = ()
    effort_kind: str | None = None


def proposed(found: Inspection) -> dict[str, Any]:
    """The metadata that are proposed, with what is still to be answered."""
    assert found.proposal is not None
    return {
        "format": found.format,
        "columns": dict(found.proposal.columns),
        "units": dict(found.proposal.units),
        "windows": [],
        "effort_kind": found.proposal.effort_kind,
        "questions": [{"field": one.field, "detail": one.detail} for one in found.proposal.questions],
    }


def as_proposed(path: Path, found: Inspection, *, has_gains: bool) -> Said:
    """The proposal as it is.

    Raises
    ------
    DynidentError
        Where there is a question that has not been answered: taken as proposed would be a guess.
    """
    assert found.proposal is not None
    open_ones = [one for one in found.proposal.questions if not (has_gains and one.field == NEEDED_FOR_GAINS)]
    if open_ones:
        told = "".join(f"\n  {one.field}: {one.detail}" for one in open_ones)
        raise DynidentError(
            f"{path.name} cannot be taken as proposed; to be answered:{told}\nWrite the proposal with "
            f"`dynident inspect {path} --robot ROBOT --out {path.stem}.json`, answer there (and empty its questions), "
            "and give it as "
            "--metadata.",
            pointer=str(path),
            title="Open questions",
        )
    return Said(found.proposal.columns, found.proposal.units, effort_kind=found.proposal.effort_kind)


def read_metadata(given: Sequence[str], names: Sequence[str]) -> dict[str, Said]:
    """Metadata by the name of the measurement: FILE for all of them, NAME=FILE for one.

    Raises
    ------
    DynidentError
        For a file that is none, or holds open questions.
    """
    found: dict[str, Said] = {}
    for text in given:
        name, sign, path = text.partition("=")
        if sign and name in names:
            found[name] = _read(Path(path))
        else:
            found |= dict.fromkeys(names, _read(Path(text)))
    return found


def _read(path: Path) -> Said:
    check_readable(path)
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise DynidentError(f"{path.name} is no JSON: {error}", pointer=str(path)) from error
    if not isinstance(document, dict) or not set(document) <= set(_FIELDS):
        raise DynidentError(f"{path.name} is no metadata: give an object of {', '.join(_FIELDS)}", pointer=str(path))
    asked = [one for one in document.get("questions") or () if one.get("field") != NEEDED_FOR_GAINS]
    if asked:
        raise DynidentError(
            f"{path.name} holds an open question: {asked[0].get('detail', '')} Answer it and empty its questions.",
            pointer=str(path),
            title="Open questions",
        )
    columns, units = document.get("columns") or {}, document.get("units") or {}
    if not all(isinstance(one, dict) and all(isinstance(v, str) for v in one.values()) for one in (columns, units)):
        raise DynidentError(f"{path.name}: columns and units have to map names to names", pointer=str(path))
    try:
        windows = tuple((float(start), float(end)) for start, end in document.get("windows") or ())
    except (TypeError, ValueError) as error:
        raise DynidentError(f"{path.name}: windows have to be pairs of numbers", pointer=str(path)) from error
    effort_kind = document.get("effort_kind")
    if effort_kind is not None and effort_kind not in get_args(EffortKind):
        raise DynidentError(
            f"{path.name}: effort_kind is {effort_kind!r}; there are {', '.join(get_args(EffortKind))}",
            pointer=str(path),
        )
    return Said(columns, units, windows, effort_kind)
