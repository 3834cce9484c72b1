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
    asked = DesignRequest.model_validate(task.subject.request)
    robot = robot_by_id(task, asked.robot_id)
    earlier = recordings_by_id(task, asked.earlier_ids)
    meshes = meshes_of(task.resources.get("robot", asked.robot_id))
    with mesh_folders({name: task.objects.path(one.key) for name, one in meshes.items()}) as folders:
        request = request_of(asked, robot)
        around = replace(request.surroundings, mesh_folders=tuple(map(str, folders)))
        found = design_experiment(
            robot, replace(request, surroundings=around), task.progress, earlier, task.checkpoints
        )
    with tempfile.TemporaryDirectory() as folder:
        path = write_trajectory(found, Path(folder) / "trajectory.parquet")
        trajectory = task.keep("trajectory", path, "application/vnd.apache.parquet")
    return Outcome(plain(describe_design(found)), (trajectory,))
