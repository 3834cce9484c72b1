"""Designed motions of arms as their makers describe them, held against another program's meshes: Pinocchio and coal."""

from __future__ import annotations

import sys
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest

from dynident.excitation import Design, DesignRequest, TrajectoryRequest, design_experiment
from dynident.motion import Surroundings
from dynident.robot import robot_from_urdf

STOCK = next(Path(sys.prefix).glob("lib*/python3*/site-packages/cmeel.prefix/share/example-robot-data/robots"), None)
ARMS = {
    "ur3": "ur_description/urdf/ur3_robot.urdf",
    "ur5": "ur_description/urdf/ur5_robot.urdf",
    "ur10": "ur_description/urdf/ur10_robot.urdf",
    "ur3 with gripper": "ur_description/urdf/ur3_gripper.urdf",
    "ur5 with gripper": "ur_description/urdf/ur5_gripper.urdf",
    "kinova": "kinova_description/robots/kinova.urdf",
    "z1": "z1_description/urdf/z1.urdf",
    "xarm7": "xarm_description/urdf/xarm7.urdf",
    "panda": "panda_description/urdf/panda.urdf",
    "so101": "so_arm_description/urdf/so101.urdf",
}
POSTURES, SEED = 100, 0
# Depth (m) up to which bodies count as touching: meshes overlap a little where they are joined.
TOUCHING = 1e-3


class Oracle:
    """The arm with its meshes in Pinocchio, and a floor below it."""

    def __init__(self, file: Path) -> None:
        assert STOCK is not None
        self.model = pin.buildModelFromUrdf(str(file))
        folder = str(STOCK.parents[1])
        self.geometry = pin.buildGeomFromUrdf(self.model, str(file), pin.GeometryType.COLLISION, package_dirs=folder)
        n = len(self.geometry.geometryObjects)
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.5]))
        floor = self.geometry.addGeometryObject(pin.GeometryObject("floor", 0, place, coal.Box(20.0, 20.0, 1.0)))
        parent = [self.geometry.geometryObjects[k].parentJoint for k in range(n)]
        for i in range(n):
            near = {parent[i], *self._ancestors(parent[i])}
            for j in range(i):
                # Neighbours, and theirs, touch where they are joined.
                if parent[j] not in near:
                    self.geometry.addCollisionPair(pin.CollisionPair(j, i))
            # Only the first link may reach the floor.
            if parent[i] > 1:
                self.geometry.addCollisionPair(pin.CollisionPair(i, floor))
        self.data, self.found = self.model.createData(), pin.GeometryData(self.geometry)

    def _ancestors(self, joint: int) -> tuple[int, int]:
        above = int(self.model.parents[joint])
        return above, int(self.model.parents[above])

    def positions(self, names: tuple[str, ...], q: np.ndarray) -> np.ndarray:
        """Positions (nq,) with joints that the design does not move at their neutral ones."""
        full = pin.neutral(self.model)
        for name, value in zip(names, q, strict=True):
            joint = self.model.joints[self.model.getJointId(name)]
            if joint.nq == 2:
                full[joint.idx_q : joint.idx_q + 2] = np.cos(value), np.sin(value)
            else:
                full[joint.idx_q] = value
        return full

    def colliding(self, q: np.ndarray) -> set[tuple[str, str]]:
        """Pairs of bodies that go into each other by more than a touch."""
        pin.updateGeometryPlacements(self.model, self.data, self.geometry, self.found, q)
        pin.computeCollisions(self.geometry, self.found, False)
        names = [item.name for item in self.geometry.geometryObjects]
        return {
            (names[pair.first], names[pair.second])
            for pair, result in zip(self.geometry.collisionPairs, self.found.collisionResults, strict=True)
            if result.isCollision() and _depth(result) > TOUCHING
        }


def _depth(result: coal.CollisionResult) -> float:
    return max(abs(result.getContact(k).penetration_depth) for k in range(result.numContacts()))


def design_of(file: Path) -> Design:
    robot = robot_from_urdf(file.stem, file.read_text(encoding="utf-8"))
    request = DesignRequest(
        kind="random",
        trajectory=TrajectoryRequest(duration=6.0, harmonics=4, sampling_rate=50.0),
        random_trajectories=6,
        surroundings=Surroundings(mesh_folders=(str(STOCK.parent),)),
    )
    return design_experiment(robot, request)


@pytest.mark.slow
@pytest.mark.sweep
@pytest.mark.parametrize("name", ARMS)
def test_a_motion_is_neither_below_the_floor_nor_through_the_arm_and_what_is_unchecked_is_a_warning(name: str) -> None:
    if STOCK is None:
        pytest.skip("NO STOCK ROBOTS: pip install example-robot-data")
    file = STOCK / ARMS[name]
    design, oracle = design_of(file), Oracle(file)
    rng = np.random.default_rng(SEED)
    drawn = rng.uniform(design.q.min(axis=0) - 1.0, design.q.max(axis=0) + 1.0, (POSTURES, design.q.shape[1]))
    # Bodies that overlap in most postures do so by construction.
    counts: dict[tuple[str, str], int] = {}
    for q in drawn:
        for pair in oracle.colliding(oracle.positions(design.joint_names, q)):
            counts[pair] = counts.get(pair, 0) + 1
    always = {pair for pair, count in counts.items() if count > 0.5 * POSTURES}
    hits = {pair for q in design.q[::2] for pair in oracle.colliding(oracle.positions(design.joint_names, q))} - always
    assert hits == set(), (hits, design.notes)
    assert "NOTHING BUT A FLOOR" in design.warnings[-1]
    assert design.notes[-1] == design.warnings[-1]
