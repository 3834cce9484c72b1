"""Robots from bodies, their views and geometry; uploaded meshes; triangles that a page gets (9,000)."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from dynident.array_types import FloatArray
from dynident.errors import DynidentError
from dynident.robot import Description, Drive, Joint, Limits, Robot, robot_from_description
from dynident.robot.collision_reader import BASE, collision_geometry, list_collision_meshes
from dynident.robot.collision_shapes import Capsule, enclose_shape
from dynident.robot.cut_joint import Loop
from dynident.robot.description_and_json import set_base
from dynident.robot.forward_kinematics import joint_frames
from dynident.robot.link_meshes import (
    Surface,
    find_mesh_file,
    link_mesh_files,
    match_mesh_files,
    read_surface,
    thin_surface,
)
from dynident_service.robots import wire_types as wire
from dynident_service.robots.wire_types import GeometryView
from dynident_service.shared.field_by_field import to_body, to_requests


@contextmanager
def place_mesh_files(files: Mapping[str, Path]) -> Iterator[tuple[Path, ...]]:
    """Place mesh files in a temporary folder under the names of the description; yield it, if there are files."""
    if not files:
        yield ()
        return
    with TemporaryDirectory() as name:
        link_mesh_files(Path(name), files)
        yield (Path(name),)


def assign_mesh_files(robot: Robot, sent: Mapping[str, Path]) -> dict[str, str]:
    """Return the name of the uploaded file of each mesh of a robot's description, and check that each can be read.

    Raises `DynidentError` where the description names no meshes, no file matches, or a file is no mesh.
    """
    needed = list_collision_meshes(robot)
    if not needed:
        raise DynidentError(
            "the robot's description names no meshes in its <collision> elements, so the service accepts none for it",
            pointer="/files",
            title="No meshes named",
        )
    files_by_mesh = match_mesh_files(needed, list(sent))
    if not files_by_mesh:
        raise DynidentError(
            f"none of the {len(sent)} files has the name of a mesh of the description; it names: "
            f"{', '.join(list(needed)[:8])}",
            pointer="/files",
            title="Unknown mesh",
        )
    with place_mesh_files({name: sent[file] for name, file in files_by_mesh.items()}) as folders:
        for name, file in files_by_mesh.items():
            placed = find_mesh_file(name, folders)
            assert placed is not None
            # Scale and placement do not matter here: reading it is the test.
            try:
                read_surface(placed, np.ones(3), np.eye(4))
            except ValueError as error:
                detail = f"{file} cannot be read as a mesh: {error}; send STL, OBJ, DAE or PLY"
                raise DynidentError(detail, pointer="/files", title="Unreadable mesh") from None
    return files_by_mesh


def describe_geometry_with_meshes(robot: Robot, files: Mapping[str, Path]) -> GeometryView:
    """Build the view of a robot's geometry with the files of its meshes, by name."""
    with place_mesh_files(files) as folders:
        return describe_geometry(robot, folders)


MOST_TRIANGLES_ON_PAGE = 9000
"""Triangles of a whole robot: a page still turns so many fluently."""
FEWEST_TRIANGLES_OF_MESH = 120
"""Triangles that a small mesh keeps, whatever its neighbours have."""
DIGITS = 5
"""Of coordinates in m: a hundredth of a millimetre is less than a picture shows."""


def describe_geometry(robot: Robot, mesh_folders: Sequence[Path] = ()) -> wire.GeometryView:
    """Build the view of a robot's links: frames, capsules, surfaces and closed loops."""
    collision = collision_geometry(robot.tree, mesh_folders=mesh_folders)
    # Counted first: how much each mesh is thinned depends on all of them.
    number = sum(len(surface.triangles) for body in collision.bodies for surface in body.surfaces)
    closure = robot.linkage.closure if robot.linkage else None
    # All meshes are thinned by the same share, so that a detailed link keeps more triangles than a plain one.
    share = min(1.0, MOST_TRIANGLES_ON_PAGE / max(number, 1))
    return wire.GeometryView(
        joints=list(robot.joint_names),
        frames=[_show_frame(robot, place) for place in range(robot.tree.n)],
        capsules=[
            _show_capsule(body.joint, enclose_shape(shape)) for body in collision.bodies for shape in body.shapes
        ],
        surfaces=[_show_surface(body.joint, surface, share) for body in collision.bodies for surface in body.surfaces],
        loops=[_show_loop(loop) for loop in closure.loops] if closure else [],
        closed=closure.check().tolist() if closure else [],
        notes=list(collision.notes),
    )


def describe_poses(robot: Robot, q: FloatArray) -> wire.PosesView:
    """Compute the frames of a robot in postures q (m, n), rad or m (None where a loop does not close)."""
    tree, positions, lost = robot.tree, q, np.zeros((len(q), robot.tree.n), dtype=np.bool_)
    if robot.linkage is not None:
        passive, is_closed = np.zeros((len(q), 0)), np.ones(len(q), dtype=np.bool_)
        if robot.linkage.closure:
            passive, is_closed = robot.linkage.closure.follow_branch(q)
        positions = np.hstack([q, passive]) @ robot.linkage.ratios.T + robot.linkage.offsets
        # Where a loop cannot be closed, the passive positions are meaningless, and so are all frames that depend on
        # them: those of passive joints, and of every joint that a passive one carries. Parents come before children.
        loose = (robot.linkage.ratios[:, robot.n :] != 0.0).any(axis=1)
        for place, joint in enumerate(tree.joints):
            loose[place] |= joint.parent >= 0 and loose[joint.parent]
        lost = ~is_closed[:, None] & loose
    poses = np.round(joint_frames(tree, positions)[:, :, :3].reshape(len(q), tree.n, 12), DIGITS).tolist()
    for posture, frame in np.argwhere(lost):
        poses[posture][frame] = None
    return wire.PosesView(poses=poses)


def _show_surface(joint: int, surface: Surface, share: float) -> wire.SurfaceView:
    thinned_surface = thin_surface(surface, max(FEWEST_TRIANGLES_OF_MESH, int(share * len(surface.triangles))))
    return wire.SurfaceView(
        frame=None if joint == BASE else joint,
        points=np.round(thinned_surface.points, DIGITS).tolist(),
        triangles=thinned_surface.triangles.tolist(),
    )


def _show_frame(robot: Robot, place: int) -> wire.FrameView:
    joint = robot.tree.joints[place]
    ratios, offset = _frame_ratios(robot, place)
    x, y, z = (float(value) for value in joint.axis)
    return wire.FrameView(
        name=joint.name,
        type=joint.kind,
        parent=None if joint.parent < 0 else joint.parent,
        placement=joint.placement.tolist(),
        axis=(x, y, z),
        ratios=ratios,
        offset=offset,
    )


def _frame_ratios(robot: Robot, place: int) -> tuple[list[float], float]:
    """Return how a frame depends on the joints and passive positions: ratios (n + p,) and an offset."""
    if robot.linkage is None:
        return [float(place == other) for other in range(robot.n)], 0.0
    return robot.linkage.ratios[place].tolist(), float(robot.linkage.offsets[place])


def _show_loop(loop: Loop) -> wire.LoopView:
    first, second = (
        wire.LoopEndView(frame=None if end.joint == BASE else end.joint, placement=end.frame.tolist())
        for end in loop.ends
    )
    return wire.LoopView(name=loop.name, kind=loop.kind, ends=(first, second))


def _show_capsule(joint: int, capsule: Capsule) -> wire.CapsuleView:
    start, end = ((float(x), float(y), float(z)) for x, y, z in (capsule.start, capsule.end))
    return wire.CapsuleView(frame=None if joint == BASE else joint, start=start, end=end, radius=float(capsule.radius))


def restore_robot(stored: Mapping[str, object]) -> Robot:
    """Build the robot of a stored request."""
    return build_robot(wire.RobotRequest.model_validate(stored))


def restore_cached_robot(stored: Mapping[str, object]) -> Robot:
    """Build the robot of a stored request, or return the cached one of the same request."""
    # Dictionaries are not hashable: the key of the cache is the sorted JSON, and a stored robot never changes.
    return _restore_from_text(json.dumps(stored, sort_keys=True))


@lru_cache(maxsize=32)
def _restore_from_text(text: str) -> Robot:
    return restore_robot(json.loads(text))


def build_robot(request: wire.RobotRequest) -> Robot:
    """Build the robot that a request describes; `DynidentError` where the description is unusable."""
    content = request.description.content
    # A table of Denavit and Hartenberg may come as JSON in the body itself.
    text = content if isinstance(content, str) else json.dumps(content)
    robot = robot_from_description(
        request.name,
        Description(request.description.format, text),
        limits=to_requests(request.limits, Limits, "/limits"),
        drives=to_requests(request.drives, Drive, "/drives"),
        locked_joints=request.locked_joints,
        gravity=request.gravity,
        has=request.has,
        has_not=request.has_not,
    )
    return set_base(robot, request.base, request.contacts) if request.base or request.contacts else robot


def describe_robot(robot: Robot, base: wire.BaseParametersView) -> wire.RobotResult:
    """Build the view of a robot with its base parameters."""
    return wire.RobotResult(
        joints=[_show_joint(robot, index, joint) for index, joint in enumerate(robot.joints)],
        base_parameters=base,
        has_inertias=robot.inertias is not None,
        base=robot.base,
        meshes=[wire.MeshView(name=name, links=list(links)) for name, links in list_collision_meshes(robot).items()],
    )


def find_base_parameters(robot: Robot, tolerance: float | None) -> wire.BaseParametersView:
    """Find the inertial base parameters of a robot; `tolerance` is the share of a column left unexplained."""
    # Imported here: CasADi takes a second to load, and the rest of this module does without.
    from dynident.effects import EffectChoice, Signals, build_columns
    from dynident.regressors.base_parameters import DEFAULT_TOLERANCE, find_base_parameters

    signals = Signals(robot)
    columns = build_columns([EffectChoice("rigid_body")], signals)
    base_set = find_base_parameters(robot, columns, signals, tolerance=tolerance or DEFAULT_TOLERANCE)
    return wire.BaseParametersView(
        count=base_set.count, rank=base_set.rank, names=list(base_set.kept_names), groupings=list(base_set.groupings)
    )


def _show_joint(robot: Robot, index: int, joint: Joint) -> wire.JointView:
    return wire.JointView(
        name=joint.name,
        type=joint.kind,
        limits=to_body(wire.Limits, joint.limits),
        antecedent=robot.joint_names[joint.parent] if joint.parent >= 0 else None,
        link=joint.link,
        drive_gain=robot.drives[index].gain,
        coupling=dict(robot.drives[index].coupling),
    )
