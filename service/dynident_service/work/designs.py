"""Jobs that design an experiment."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

from dynident.excitation import design_experiment
from dynident_service.adapters.designs import describe_design, request_of, write_trajectory
from dynident_service.adapters.meshes import mesh_folders
from dynident_service.jobs.work import Outcome, Task
from dynident_service.models.common import plain
from dynident_service.models.designs import DesignRequest
from dynident_service.storage.meshes import meshes_of
from dynident_service.work.means import recordings_by_id, robot_by_id


def design(task: Task) -> Outcome:
    """Design an experiment."""
    sent_request = DesignRequest.model_validate(task.subject.request)
    robot = robot_by_id(task, sent_request.robot_id)
    earlier = recordings_by_id(task, sent_request.earlier_ids)
    meshes = meshes_of(task.resources.get("robot", sent_request.robot_id))
    # Descriptions name meshes by path, so the stored files are given these names in a temporary folder.
    with mesh_folders({name: task.objects.path(file.key) for name, file in meshes.items()}) as folders:
        request = request_of(sent_request, robot)
        surroundings = replace(request.surroundings, mesh_folders=tuple(map(str, folders)))
        planned = design_experiment(
            robot, replace(request, surroundings=surroundings), task.progress, earlier, task.checkpoints
        )
    with tempfile.TemporaryDirectory() as folder:
        path = write_trajectory(planned, Path(folder) / "trajectory.parquet")
        trajectory = task.keep("trajectory", path, "application/vnd.apache.parquet")
    return Outcome(plain(describe_design(planned)), (trajectory,))
