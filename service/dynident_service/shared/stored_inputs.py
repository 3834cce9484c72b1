"""Read stored robots, recordings and models as inputs of jobs."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from dynident.diagnosis.comparison.comparison_files import StoredComparison
from dynident.diagnosis.monitoring.reduced_days import check_days
from dynident.errors import DynidentError
from dynident.identification import Identification, from_bytes
from dynident.recordings import Check, Recording, open_recording
from dynident.robot import Robot
from dynident_service.designs.adapters import restore_design
from dynident_service.diagnoses.wire_types import Evidence
from dynident_service.jobs.task_input_output import Task
from dynident_service.measurements.adapters import open_stored_recording, restore_checks, to_recording_metadata
from dynident_service.measurements.wire_types import MeasurementMetadata, MeasurementResult
from dynident_service.problems import ProblemError
from dynident_service.robots.adapters import restore_robot

Read = Callable[[Mapping[str, Any], Mapping[str, Any], Path], object]


def read_stored(
    kind: str, request: Mapping[str, object], result: Mapping[str, object], files: Mapping[str, str]
) -> str | None:
    """Read a stored resource and its files. Return what cannot be read, and why; None if everything can."""
    if kind == "robot":
        return _find_problem("its description", partial(restore_robot, request))
    for role, path in files.items():
        read = READERS.get((kind, role))
        if read is not None:
            problem = _find_problem(f"its {role}", partial(read, request, result, Path(path)))
            if problem is not None:
                return problem
    return None


def _find_problem(part_name: str, read: Callable[[], object]) -> str | None:
    try:
        read()
    except ProblemError as error:
        return f"{part_name}: {error.problem.detail}"
    except DynidentError as error:
        return f"{part_name}: {error.detail}"
    except Exception as error:  # what damaged or foreign bytes raise is no closed list
        return f"{part_name}: {type(error).__name__}: {error}"
    return None


def _read_evidence(_: Mapping[str, Any], __: Mapping[str, Any], path: Path) -> None:
    for figure in json.loads(path.read_bytes()):
        Evidence.model_validate(figure)


READERS: Mapping[tuple[str, str], Read] = {
    ("measurement", "recording"): lambda request, result, path: open_recording(path),
    ("identification", "model"): lambda request, result, path: from_bytes(path.read_bytes()),
    ("design", "trajectory"): restore_design,
    ("comparison", "signals"): lambda request, result, path: StoredComparison(path),
    ("diagnosis", "evidence"): _read_evidence,
    ("series", "days"): lambda request, result, path: check_days(path.read_bytes()),
}
"""Readers by kind of resource and role of the file; files that only users read have none."""


def load_stored_robot(task: Task, identifier: str) -> Robot:
    """Return a stored robot, from the cache if possible."""
    return task.memory.get_or_make(
        Robot, identifier, lambda: restore_robot(task.resources.get("robot", identifier).request)
    )


def open_recording_by_id(task: Task, identifier: str) -> Recording:
    """Open a stored measurement."""
    # Not cached: a recording is opened lazily and reads its file block by block.
    return open_stored_recording(task.resources.get("measurement", identifier), task.objects)


def open_stored_recordings(task: Task, identifiers: Sequence[str]) -> list[Recording]:
    """Open stored measurements."""
    return [open_recording_by_id(task, identifier) for identifier in identifiers]


def load_stored_checks(task: Task, identifiers: Sequence[str]) -> dict[str, list[Check]]:
    """Return the checks of stored measurements by the recordings' names."""
    checks: dict[str, list[Check]] = {}
    for identifier in identifiers:
        measurement = task.resources.get("measurement", identifier)
        accepted = to_recording_metadata(MeasurementMetadata.model_validate(measurement.request)).accept
        own = restore_checks(MeasurementResult.model_validate(measurement.result).checks)
        name = open_stored_recording(measurement, task.objects).name
        checks.setdefault(name, []).extend(replace(check, is_accepted=check.name in accepted) for check in own)
    return checks


def load_stored_model(task: Task, identifier: str) -> Identification:
    """Return a stored model, from the cache if possible."""

    def read_model() -> Identification:
        stored = task.resources.get("identification", identifier)
        return from_bytes(task.objects.get(stored.objects["model"].key))

    return task.memory.get_or_make(Identification, identifier, read_model)
