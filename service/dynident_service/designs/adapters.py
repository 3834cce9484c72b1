"""Requests of designs and simulations from bodies, their views, trajectories as files, stored designs read back."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import scipy

from dynident.effects.effect_columns import check_shape_constants, find_joints
from dynident.errors import DynidentError, Note
from dynident.excitation import (
    CriterionChoice,
    CriterionValues,
    Design,
    DesignRequest,
    TrajectoryRequest,
    design_table,
    slow_down,
)
from dynident.excitation.criteria.optimality_criteria import Baseline
from dynident.excitation.design_files import format_joint_trajectory
from dynident.excitation.design_result import find_nearest_along
from dynident.excitation.experiment_design import check_request
from dynident.excitation.standing_feet import stand_on_feet
from dynident.identification.shape_search import check_choices
from dynident.motion.collision.exact_distances import Nearest
from dynident.motion.collision.obstacle_geometry import Wall, build_block
from dynident.presentation.design_tables import build_design_tables, build_expected_table
from dynident.recordings.arrow_tables import table_column_to_floats, to_csv
from dynident.robot import Robot
from dynident.robot.collision_shapes import Block
from dynident.simulation import Reference, SimulatedRecording
from dynident_service.designs import wire_types as wire
from dynident_service.problems import show_remedies
from dynident_service.shared.field_by_field import from_view, show_tables, to_body, to_request, to_view
from dynident_service.shared.wire_types import Table

RATE_OF_SAMPLES = 1000.0
"""Sampling rate in Hz of a virtual robot that follows samples."""


def samples_to_reference(samples: wire.Samples) -> Reference:
    """Build a reference trajectory from samples t (m,), s, and q (m, n); missing derivatives are those of a spline.

    Raises `DynidentError` where t does not increase, or rows have different lengths.
    """
    t, q = np.array(samples.t, dtype=np.float64), _to_matrix(samples.q, "q")
    if samples.dq is not None and samples.ddq is not None:
        return Reference(t, q, _to_matrix(samples.dq, "dq"), _to_matrix(samples.ddq, "ddq"))
    # A cubic spline needs four points and increasing times.
    if len(t) != len(q) or not np.all(np.diff(t) > 0) or len(t) < 4:
        detail = "t must increase and have one row of q each, at least four, so that dq and ddq can be computed from q"
        raise DynidentError(detail, pointer="/trajectory/t", title="Unusable trajectory")
    # A cubic has a continuous acceleration, which the torque needs.
    spline = scipy.interpolate.CubicSpline(t, q)
    dq = spline(t, 1) if samples.dq is None else _to_matrix(samples.dq, "dq")
    return Reference(t, q, dq, spline(t, 2) if samples.ddq is None else _to_matrix(samples.ddq, "ddq"))


def describe_simulation(measurement: SimulatedRecording, rate: float) -> wire.SimulationResult:
    """Build the view of a simulated measurement; `rate` in Hz."""
    return to_view(wire.SimulationResult, measurement, sampling_rate=rate)


def _to_matrix(rows: list[list[float]], name: str) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    if len({len(row) for row in rows}) != 1:
        detail = f"the rows of {name} have different lengths; each row needs one value per joint"
        raise DynidentError(detail, pointer=f"/trajectory/{name}", title="Unusable trajectory")
    return np.array(rows, dtype=np.float64)


ROWS = 65_536
"""Rows of a trajectory that are converted to CSV at a time."""
_DIGITS = 5
"""Decimals of lengths in m: a picture shows no more than a hundredth of a millimetre."""


def to_checked_request(wire_request: wire.DesignRequest, robot: Robot) -> DesignRequest:
    """Build a design request from a body; `DynidentError` where it cannot be designed for the robot."""
    return _check_design_request(to_design_request(wire_request), robot)


def build_random_design(trajectory: wire.Trajectory, robot: Robot, seed: int = 0) -> DesignRequest:
    """Build the request for a random motion of a family; `DynidentError` where the robot has none."""
    return _check_design_request(
        DesignRequest(kind="random", trajectory=to_request(trajectory, TrajectoryRequest), seed=seed), robot
    )


def _check_design_request(request: DesignRequest, robot: Robot) -> DesignRequest:
    check_request(request)
    check_choices(request.effects_or_default, robot)
    _check_rivals(request.criterion, robot)
    return request


def to_design_request(wire_request: wire.DesignRequest) -> DesignRequest:
    """Build a design request from a body without checking it against a robot."""
    return to_request(wire_request, DesignRequest)


def _check_rivals(choice: CriterionChoice, robot: Robot) -> None:
    for index, rival in enumerate(choice.effects):
        at = f"/criterion/effects/{index}"
        find_joints(rival, robot, at)
        check_shape_constants(rival, at)


def show_request(request: DesignRequest, robot_id: str) -> wire.DesignRequest:
    """Build the body that asks for a design, ready to be posted."""
    return to_body(wire.DesignRequest, request, robot_id=robot_id)


def describe_design(design: Design) -> wire.DesignResult:
    """Build the view of a design."""
    best = design.baseline
    values = (
        None
        if best is None
        else to_view(wire.BaselineValues, best, **to_view(wire.CriterionValues, best.best).model_dump())
    )
    notes = [note for note in design.notes if isinstance(note, Note)]
    return to_view(
        wire.DesignResult,
        design,
        baseline_values=values,
        warning_codes=[note.code for note in notes if note.code],
        remedies=show_remedies([remedy for note in notes for remedy in note.remedies]),
    )


def write_trajectory(design: Design, path: Path) -> Path:
    """Write the trajectory of a design as Parquet, the form in which it is stored."""
    pq.write_table(design_table(design), path)
    return path


def trajectory_as_csv(path: Path, speed: float = 1.0) -> Iterator[bytes]:
    """Yield a stored trajectory as CSV, some rows at a time, so that it is never in memory as a whole."""
    file = pq.ParquetFile(path)
    # Only the first batch has the line of names above it.
    for index, batch in enumerate(file.iter_batches(ROWS)):
        yield to_csv(slow_down(pa.Table.from_batches([batch]), speed), header=index == 0)


def trajectory_as_parquet(path: Path, speed: float) -> bytes:
    """Return a stored trajectory at a share of its speed as Parquet."""
    sink = pa.BufferOutputStream()
    pq.write_table(slow_down(pq.read_table(path), speed), sink)
    return bytes(sink.getvalue())


def trajectory_as_samples(path: Path, joints: list[str], speed: float) -> wire.TrajectorySamples:
    """Return a stored trajectory as arrays, [sample][joint]."""
    reference = read_reference(path, joints, speed)
    return to_view(wire.TrajectorySamples, reference, joints=joints)


def trajectory_for_ros2(path: Path, joints: list[str], speed: float) -> Iterator[str]:
    """Yield a stored trajectory as a JointTrajectory message in YAML, some lines at a time."""
    reference = read_reference(path, joints, speed)
    return format_joint_trajectory(joints, reference.t, reference.q, reference.dq, reference.ddq)


def read_reference(path: Path, joints: list[str], speed: float = 1.0) -> Reference:
    """Read a stored trajectory at a share of its speed: t (m,), and q, dq, ddq (m, n)."""
    table = slow_down(pq.read_table(path), speed)

    def read_matrix(kind: str) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
        return np.column_stack([table_column_to_floats(table[f"{kind}_{joint}"]) for joint in joints])

    return Reference(table_column_to_floats(table["t"]), read_matrix("q"), read_matrix("dq"), read_matrix("ddq"))


def compute_clearances(
    wire_request: wire.DesignRequest, robot: Robot, trajectory: Path, mesh_folders: Sequence[Path], points: int
) -> wire.DesignClearances:
    """Find what each link is nearest to at some samples of a stored trajectory, and the surroundings to draw."""
    stated = to_design_request(wire_request)
    stated = replace(stated, surroundings=replace(stated.surroundings, mesh_folders=tuple(map(str, mesh_folders))))
    held_robot, request, _ = stand_on_feet(robot, stated)
    motion = read_reference(trajectory, list(held_robot.joint_names))
    # Evenly spread, ends included. Rounding may give a row twice.
    rows = np.unique(np.linspace(0, len(motion.t) - 1, min(points, len(motion.t))).astype(np.intp))
    nearest = find_nearest_along(robot, stated, motion.q[rows], mesh_folders)
    around = request.surroundings
    return wire.DesignClearances(
        t=motion.t[rows].tolist(),
        links=[_show_link_clearances(link) for link in nearest],
        edges=[edge for box in around.boxes for edge in _box_edges(build_block(box))],
        walls=[_wall_plane(wall) for wall in around.walls],
    )


def _box_edges(block: Block) -> Iterator[Any]:
    middle, half = block.placement[:3, 3], block.placement[:3, :3] * block.size / 2.0
    for k, (a, b) in product(range(3), product((-1.0, 1.0), repeat=2)):
        # Four edges are parallel to each axis; the signs of the other two axes tell them apart.
        midpoint = middle + a * half[:, k - 2] + b * half[:, k - 1]
        yield tuple(np.round([midpoint - half[:, k], midpoint + half[:, k]], _DIGITS).tolist())


def _wall_plane(wall: Wall) -> wire.WallPlane:
    # The right singular vectors after the first span the plane at right angles to the normal.
    along: Any = np.linalg.svd(np.array([wall.normal]))[2][1:].tolist()
    return wire.WallPlane(point=wall.point, along=along)


def _show_link_clearances(nearest: Nearest) -> wire.LinkClearances:
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


def design_to_reference(design: Design) -> Reference:
    """Return the motion of a design as a reference trajectory."""
    return Reference(design.t, design.q, design.dq, design.ddq)


def build_tables(request: Mapping[str, object], result: Mapping[str, object], robot: Robot) -> list[Table]:
    """Build the tables of a stored design."""
    design = restore_design(request, result, None)
    expected = [build_expected_table(design.expected)] if design.expected else []
    return show_tables([*build_design_tables(robot, design), *expected])


def restore_design(request: Mapping[str, object], result: Mapping[str, object], trajectory: Path | None) -> Design:
    """Restore a stored design from its request and result; without its trajectory the motion is left out."""
    wire_request, wire_result = wire.DesignRequest.model_validate(request), wire.DesignResult.model_validate(result)
    nothing = np.zeros((0, len(wire_result.joints)))
    motion = (
        Reference(nothing[:, 0], nothing, nothing, nothing)
        if trajectory is None
        else read_reference(trajectory, wire_result.joints)
    )
    baseline = wire_result.baseline_values
    return from_view(
        Design,
        wire_result,
        request=to_design_request(wire_request),
        t=motion.t,
        q=motion.q,
        dq=motion.dq,
        ddq=motion.ddq,
        baseline=None if baseline is None else from_view(Baseline, baseline, best=from_view(CriterionValues, baseline)),
    )
