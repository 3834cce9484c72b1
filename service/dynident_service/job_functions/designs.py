"""Job: design an experiment."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

from dynident.excitation import design_experiment
from dynident_service.adapters.designs import describe_design, to_checked_request, write_trajectory
from dynident_service.adapters.robots import place_mesh_files
from dynident_service.job_functions.stored_inputs import load_stored_model, load_stored_robot, open_stored_recordings
from dynident_service.jobs.task_input_output import Outcome, Task
from dynident_service.storage.repository_values import find_mesh_files
from dynident_service.wire_types.designs import DesignRequest
from dynident_service.wire_types.shared_types import to_plain_json


def design(task: Task) -> Outcome:
    """Design an experiment."""
    sent_request = DesignRequest.model_validate(task.subject.request)
    robot = load_stored_robot(task, sent_request.robot_id)
    earlier = open_stored_recordings(task, sent_request.earlier_ids)
    model_id = sent_request.identification_id
    identified = None if model_id is None else load_stored_model(task, model_id).estimate
    meshes = find_mesh_files(task.resources.get("robot", sent_request.robot_id))
    # Descriptions name meshes by path, so the stored files are given these names in a temporary folder.
    with place_mesh_files({name: task.objects.fetch_file(file.key) for name, file in meshes.items()}) as folders:
        request = to_checked_request(sent_request, robot)
        surroundings = replace(request.surroundings, mesh_folders=tuple(map(str, folders)))
        planned = design_experiment(
            robot, replace(request, surroundings=surroundings), task.progress, earlier, task.checkpoints, identified
        )
    with tempfile.TemporaryDirectory() as folder:
        path = write_trajectory(planned, Path(folder) / "trajectory.parquet")
        trajectory = task.store_file("trajectory", path, "application/vnd.apache.parquet")
    return Outcome(to_plain_json(describe_design(planned)), (trajectory,))
