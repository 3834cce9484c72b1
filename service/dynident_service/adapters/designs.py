"""Designs of experiments between the contract and the science, and back where they are stored."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from dynident.effects.catalogue import check_shape, joints_of
from dynident.excitation import CriterionChoice, CriterionValues, Design, DesignRequest, TrajectoryRequest, design_table
from dynident.excitation.checks import check_request
from dynident.excitation.criteria.baseline import Baseline
from dynident.excitation.formats.ros2 import joint_trajectory
from dynident.excitation.nearness import nearest_along
from dynident.identification.shapes.shapes import check_choices
from dynident.motion.surroundings.contacts import Nearest
from dynident.motion.surroundings.obstacles import Wall, block_of
from dynident.recordings.arrow import as_floats, csv_of
from dynident.robot import Robot
from dynident.robot.shapes import Block
from dynident.simulation import Reference
from dynident_service.adapters.answers import known, shown
from dynident_service.adapters.derived import body, taken
from dynident_service.models import designs as wire

ROWS = 65_536
_DIGITS = 5
"""Of lengths in m that a picture shows."""


def request_of(wire_request: wire.DesignRequest, robot: Robot) -> DesignRequest:
    """Take a design off the wire; `DynidentError` where it asks for what cannot be designed for this robot."""
    return _checked(design_request(wire_request), robot)


def random_design(trajectory: wire.Trajectory, robot: Robot, seed: int = 0) -> DesignRequest:
    """A random motion of a family; `DynidentError` where there is none for this robot."""
    return _checked(DesignRequest(kind="random", trajectory=taken(trajectory, TrajectoryRequest), seed=seed), robot)


def _checked(request: DesignRequest, robot: Robot) -> DesignRequest:
    check_request(request)
    check_choices(request.wanted_effects, robot)
    _check_rivals(request.criterion, robot)
    return request


def design_request(wire_request: wire.DesignRequest) -> DesignRequest:
    """Take a design off the wire as it is."""
    return taken(wire_request, DesignRequest)


def _check_rivals(choice: CriterionChoice, robot: Robot) -> None:
    for index, rival in enumerate(choice.effects):
        at = f"/criterion/effects/{index}"
        joints_of(rival, robot, at)
        check_shape(rival, at)


def show_request(request: DesignRequest, robot_id: str) -> wire.DesignRequest:
    """Show what is asked of a design, ready to be posted."""
    return body(wire.DesignRequest, request, robot_id=robot_id)


def describe_design(design: Design) -> wire.DesignResult:
    """Describe a design for the wire."""
    best = design.baseline
    values = (
        None
        if best is None
        else shown(wire.BaselineValues, best, **shown(wire.CriterionValues, best.best).model_dump())
    )
    return shown(wire.DesignResult, design, baseline_values=values)


def write_trajectory(design: Design, path: Path) -> Path:
    """Write the trajectory of a design as it is stored."""
    pq.write_table(design_table(design), path)
    return path


def trajectory_as_csv(path: Path) -> Iterator[bytes]:
    """Give a stored trajectory as CSV, a part at a time."""
    file = pq.ParquetFile(path)
    for index, batch in enumerate(file.iter_batches(ROWS)):
        yield csv_of(pa.Table.from_batches([batch]), header=index == 0)


def trajectory_as_samples(path: Path, joints: list[str]) -> wire.TrajectorySamples:
    """Give a stored trajectory as JSON arrays, [sample][joint]."""
    reference = stored_reference(path, joints)
    return shown(wire.TrajectorySamples, reference, joints=joints)


def trajectory_for_ros2(path: Path, joints: list[str]) -> Iterator[str]:
    """Give a stored trajectory as a JointTrajectory message in YAML, a line or four at a time."""
    reference = stored_reference(path, joints)
    return joint_trajectory(joints, reference.t, reference.q, reference.dq, reference.ddq)


def stored_reference(path: Path, joints: list[str]) -> Reference:
    """Read a stored trajectory."""
    table = pq.read_table(path)

    def matrix(kind: str) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
        return np.column_stack([as_floats(table[f"{kind}_{joint}"]) for joint in joints])

    return Reference(as_floats(table["t"]), matrix("q"), matrix("dq"), matrix("ddq"))


def clearances_of(
    wire_request: wire.DesignRequest, robot: Robot, trajectory: Path, mesh_folders: Sequence[Path], points: int
) -> wire.DesignClearances:
    """What the links are nearest to along a stored trajectory, at about so many of its samples."""
    motion = stored_reference(trajectory, list(robot.joint_names))
    rows = np.unique(np.linspace(0, len(motion.t) - 1, min(points, len(motion.t))).astype(np.intp))
    nearest = nearest_along(robot, design_request(wire_request), motion.q[rows], mesh_folders)
    around = design_request(wire_request).surroundings
    return wire.DesignClearances(
        t=motion.t[rows].tolist(),
        links=[_link_clearances(link) for link in nearest],
        edges=[edge for box in around.boxes for edge in _edges(block_of(box))],
        walls=[_plane(wall) for wall in around.walls],
    )


def _edges(block: Block) -> Iterator[Any]:
    middle, half = block.placement[:3, 3], block.placement[:3, :3] * block.size / 2.0
    for k, (a, b) in product(range(3), product((-1.0, 1.0), repeat=2)):
        midpoint = middle + a * half[:, k - 2] + b * half[:, k - 1]
        yield tuple(np.round([midpoint - half[:, k], midpoint + half[:, k]], _DIGITS).tolist())


def _plane(wall: Wall) -> wire.WallPlane:
    along: Any = np.linalg.svd(np.array([wall.normal]))[2][1:].tolist()
    return wire.WallPlane(point=wall.point, along=along)


def _link_clearances(nearest: Nearest) -> wire.LinkClearances:
    return wire.LinkClearances(
        name=nearest.body.name,
        frame=nearest.body.joint,
        others=[
            wire.Other(name=other.name, frame=None if other.joint < 0 else other.joint) for other in nearest.others
        ],
        **{
            name: np.round(getattr(nearest, name), _DIGITS).tolist() for name in ("distance", "wanted", "here", "there")
        },
        to=nearest.to.tolist(),
    )


def reference_of_design(design: Design) -> Reference:
    """Give the motion of a design."""
    return Reference(design.t, design.q, design.dq, design.ddq)


def design_of(request: Mapping[str, object], result: Mapping[str, object], trajectory: Path) -> Design:
    """Take a stored design: its request, its result, and the file of its trajectory."""
    wire_request, wire_result = wire.DesignRequest.model_validate(request), wire.DesignResult.model_validate(result)
    motion = stored_reference(trajectory, wire_result.joints)
    baseline = wire_result.baseline_values
    return known(
        Design,
        wire_result,
        request=design_request(wire_request),
        t=motion.t,
        q=motion.q,
        dq=motion.dq,
        ddq=motion.ddq,
        baseline=None if baseline is None else known(Baseline, baseline, best=known(CriterionValues, baseline)),
    )
