"""Inputs that jobs share: stored robots, recordings and models."""

from __future__ import annotations

from collections.abc import Sequence

from dynident.identification import Identification, from_bytes
from dynident.recordings import Recording
from dynident.robot import Robot
from dynident_service.adapters.measurements import recording_of
from dynident_service.adapters.robots import robot_of
from dynident_service.jobs.work import Task


def robot_by_id(task: Task, identifier: str) -> Robot:
    """Return a stored robot, from the cache if possible."""
    return task.memory.recall(Robot, identifier, lambda: robot_of(task.resources.get("robot", identifier).request))


def recording_by_id(task: Task, identifier: str) -> Recording:
    """Open a stored measurement."""
    # Not cached: a recording is opened lazily and reads its file block by block.
    return recording_of(task.resources.get("measurement", identifier), task.objects)


def recordings_by_id(task: Task, identifiers: Sequence[str]) -> list[Recording]:
    """Open stored measurements."""
    return [recording_by_id(task, identifier) for identifier in identifiers]


def model_by_id(task: Task, identifier: str) -> Identification:
    """Return a stored model, from the cache if possible."""

    def read() -> Identification:
        stored = task.resources.get("identification", identifier)
        return from_bytes(task.objects.get(stored.objects["model"].key))

    return task.memory.recall(Identification, identifier, read)
