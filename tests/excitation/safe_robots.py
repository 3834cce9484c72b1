"""Robots with collision geometry, and a judge of motions that shares nothing with what designs them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from dynident.motion import Surroundings
from dynident.robot import Robot, library_table, robot_from_library, robot_from_urdf, to_pinocchio

FloatArray = NDArray[np.float64]
_INERTIAL = '<inertial><mass value="{m}"/><inertia ixx=".02" ixy="0" ixz="0" iyy=".03" iyz="0" izz=".02"/></inertial>'
GANTRY = f"""
<robot name="gantry">
  <link name="rail"><collision><origin xyz="0 0 -.06"/><geometry><box size="1.2 .1 .1"/></geometry></collision></link>
  <link name="carriage">{_INERTIAL.format(m=6)}
    <collision><origin xyz="0 0 .1"/><geometry><box size=".2 .2 .2"/></geometry></collision></link>
  <link name="upper">{_INERTIAL.format(m=3)}
    <collision><origin xyz="0 0 .25"/><geometry><cylinder radius=".05" length=".4"/></geometry></collision></link>
  <link name="elbow"/>
  <link name="lower">{_INERTIAL.format(m=2)}
    <collision><origin xyz="0 0 .2" rpy="0 .1 0"/><geometry><capsule radius=".04" length=".3"/></geometry></collision>
  </link>
  <link name="tool">{_INERTIAL.format(m=1)}
    <collision><origin xyz="0 0 .1"/><geometry><sphere radius=".06"/></geometry></collision></link>
  <joint name="slide" type="prismatic"><parent link="rail"/><child link="carriage"/><axis xyz="1 0 0"/>
    <limit lower="-.5" upper=".5" velocity="1" effort="300"/></joint>
  <joint name="shoulder" type="revolute"><parent link="carriage"/><child link="upper"/><origin xyz="0 0 .2"/>
    <axis xyz="0 1 0"/><limit lower="-2.5" upper="2.5" velocity="2" effort="120"/></joint>
  <joint name="mount" type="fixed"><parent link="upper"/><child link="elbow"/><origin xyz="0 .12 .45"/></joint>
  <joint name="elbow" type="revolute"><parent link="elbow"/><child link="lower"/>
    <axis xyz="0 1 0"/><limit lower="-2.8" upper="2.8" velocity="2" effort="60"/></joint>
  <joint name="twist" type="revolute"><parent link="lower"/><child link="tool"/><origin xyz="0 0 .4"/>
    <axis xyz="1 0 0"/><limit lower="-2.5" upper="2.5" velocity="3" effort="20"/></joint>
</robot>"""


@cache
def safe_robot(name: str) -> Robot:
    """The robot "gantry", which slides, with all primitive shapes; or a known arm."""
    return robot_from_urdf("gantry", GANTRY) if name == "gantry" else robot_from_library(name)


@dataclass(frozen=True, eq=False)
class Judge:
    """Pinocchio's model and collision geometry of a robot."""

    robot: Robot
    model: pin.Model
    geometry: pin.GeometryModel

    def torque(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        """Torque (m, n)."""
        data = self.model.createData()
        return np.array([pin.rnea(self.model, data, *state) for state in zip(q, dq, ddq, strict=True)])

    def tool(self, q: FloatArray) -> FloatArray:
        """Origin of the last joint (m, 3)."""
        data = self.model.createData()
        found = []
        for posture in q:
            pin.forwardKinematics(self.model, data, posture)
            found.append(data.oMi[self.model.njoints - 1].translation.copy())
        return np.array(found)

    def nearest(self, q: FloatArray, surroundings: Surroundings, notes: str) -> dict[str, float]:
        """The least distance of every pair that must be kept apart, along postures q (m, n)."""
        geometry = self.geometry.copy()
        bodies = list(geometry.geometryObjects)
        obstacles = (
            [
                pin.GeometryObject(
                    "floor", 0, pin.SE3.Identity(), coal.Halfspace(np.array([0, 0, 1.0]), surroundings.floor)
                )
            ]
            if (surroundings.floor is not None)
            else []
        )
        for wall in surroundings.walls:
            normal = np.array(wall.normal) / np.linalg.norm(wall.normal)
            half = coal.Halfspace(normal, float(normal @ wall.point))
            obstacles.append(pin.GeometryObject(f"wall {wall.name}", 0, pin.SE3.Identity(), half))
        for box in surroundings.boxes:
            placement = pin.SE3(pin.rpy.rpyToMatrix(*box.rpy), np.array(box.center))
            obstacles.append(pin.GeometryObject(f"box {box.name}", 0, placement, coal.Box(*box.size)))
        names: list[str] = []
        for k, b in enumerate(bodies):
            for i, a in enumerate(bodies[:k]):
                if surroundings.self_collision and self._apart(a.parentJoint, b.parentJoint, notes):
                    geometry.addCollisionPair(pin.CollisionPair(i, k))
                    names.append(f"{b.name} – {a.name}")
        for obstacle in obstacles:
            index = geometry.addGeometryObject(obstacle)
            for k, b in enumerate(bodies):
                if b.parentJoint > 0 and f"{self._name(b.parentJoint)} – {_label(obstacle.name)}" not in notes:
                    geometry.addCollisionPair(pin.CollisionPair(k, index))
                    names.append(f"{b.name} – {obstacle.name}")
        data, placed = self.model.createData(), pin.GeometryData(geometry)
        least = np.full(len(names), np.inf)
        for posture in q if names else ():
            pin.computeDistances(self.model, data, geometry, placed, posture)
            least = np.minimum(least, [found.min_distance for found in placed.distanceResults])
        return dict(zip(names, least.tolist(), strict=True))

    def _apart(self, a: int, b: int, notes: str) -> bool:
        """Whether the bodies of two joints are neither one, neighbours, nor said not to be checked."""
        first, second = min(a, b), max(a, b)
        if first == second or self.model.parents[second] == first:
            return False
        return f"{self._name(second)} – {self._name(first)}" not in notes

    def _name(self, joint: int) -> str:
        names = ["base" if self.robot.description.format == "modified_dh" else "rail"]
        names += [joint.link or joint.name for joint in self.robot.joints]
        return names[joint]


def _label(obstacle: str) -> str:
    kind, _, name = obstacle.partition(" ")
    return f"{kind} '{name}'" if name else kind


@cache
def judge_of(name: str) -> Judge:
    """The judge of a robot of `safe_robot`."""
    robot = safe_robot(name)
    if name == "gantry":
        model = pin.buildModelFromXML(GANTRY)
        return Judge(robot, model, pin.buildGeomFromUrdfString(model, GANTRY, pin.GeometryType.COLLISION))
    model, geometry = to_pinocchio(robot), pin.GeometryModel()
    table = json.loads(library_table(name))
    for joint, capsules in enumerate([table["base_capsules"], *(row["capsules"] for row in table["joints"])]):
        for number, capsule in enumerate(capsules):
            start = np.array(capsule["from"])
            way = np.array(capsule.get("to", capsule["from"])) - start
            rotation = pin.Quaternion.FromTwoVectors(
                np.array([0, 0, 1.0]), way + np.array([0, 0, 1e-12])
            ).toRotationMatrix()
            shape = coal.Capsule(capsule["radius"], float(np.linalg.norm(way)))
            placement = pin.SE3(rotation, start + 0.5 * way)
            geometry.addGeometryObject(pin.GeometryObject(f"{joint}.{number}", joint, placement, shape))
    return Judge(robot, model, geometry)
