"""Inputs that jobs share: stored robots, recordings and models."""

from __future__ import annotations

from collections.abc import Sequence

from dynident.identification import Identification, from_bytes
from dynident.recordings import Recording
from dynident.robot import Robot
from dynident_service.adapters.measurements import open_stored_recording
from dynident_service.adapters.robots import restore_robot
from dynident_service.jobs.task import Task


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


def load_stored_model(task: Task, identifier: str) -> Identification:
    """Return a stored model, from the cache if possible."""

    def read_model() -> Identification:
        stored = task.resources.get("identification", identifier)
        return from_bytes(task.objects.get(stored.objects["model"].key))

    return task.memory.get_or_make(Identification, identifier, read_model)
