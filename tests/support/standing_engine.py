"""Robots on their feet in MuJoCo: balls under the soles, a floor, and a position servo for each joint."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from dynident.excitation import Design

FloatArray = NDArray[np.float64]
STIFFNESS, DELAY = 8000.0, 0.02
"""Of position servos in MuJoCo: N m/rad, and s by which their damping makes them late. The trunk sways on soft legs."""


def build_engine(urdf: str, feet: dict[str, FloatArray], radius: float, joints: tuple[str, ...]) -> mujoco.MjModel:
    """Return a robot with balls under its soles on a floor, with a position servo for each joint."""
    tree = ET.fromstring(urdf)
    for parent in list(tree.iter()):
        for child in list(parent):
            if child.tag in ("visual", "collision", "mujoco"):
                parent.remove(child)
    roots = {link.get("name") for link in tree.iter("link")} - {child.get("link") for child in tree.iter("child")}
    ET.SubElement(tree, "link", name="world_of_root")
    joint = ET.SubElement(tree, "joint", name="root", type="floating")
    ET.SubElement(joint, "parent", link="world_of_root")
    ET.SubElement(joint, "child", link=str(roots.pop()))
    ET.SubElement(ET.SubElement(tree, "mujoco"), "compiler", fusestatic="true", balanceinertia="true")
    spec = mujoco.MjSpec.from_string(ET.tostring(tree, encoding="unicode"))
    spec.option.timestep = 1e-3
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 0.1], friction=[0.5, 0, 0], condim=3)
    for link, points in feet.items():
        for point in points:
            spec.body(link).add_geom(
                type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0], pos=point, mass=0.0,
                friction=[0.5, 0, 0], condim=3, solref=[0.005, 1.0],
            )  # fmt: skip
    for name in joints:
        servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.set_to_position(kp=STIFFNESS, kv=DELAY * STIFFNESS)
    model = spec.compile()
    # Rotors, without which the light wrists of a humanoid would be too quick for the step; no saturation.
    model.dof_armature[6:], model.jnt_actfrclimited[:] = 0.01, 0
    model.geom_contype[:], model.geom_conaffinity[:] = 2, 1
    model.geom_contype[0], model.geom_conaffinity[0] = 1, 2
    return model


def play(
    model: mujoco.MjModel, design: Design, up: FloatArray, lowest: float, bodies: tuple[str, ...] = ()
) -> tuple[float, float]:
    """Return the largest turn (rad) and move (m) of bodies, or of the trunk, while servos follow a design."""
    data = mujoco.MjData(model)
    turn = pin.Quaternion.FromTwoVectors(up, np.array([0.0, 0.0, 1.0]))
    data.qpos[2], data.qpos[3:7] = -lowest, [turn.w, turn.x, turn.y, turn.z]
    places = [int(model.joint(name).qposadr[0]) for name in design.joint_names]
    data.qpos[places] = design.q[0]
    for _ in range(500):  # settles on its soles
        data.ctrl[:] = design.q[0]
        mujoco.mj_step(model, data)
    watched = [model.body(name).id for name in bodies] or [1]
    turned, moved = data.xquat[watched].copy(), data.xpos[watched].copy()
    largest_turn = largest_move = 0.0
    for t in np.arange(0.0, design.t[-1], model.opt.timestep):
        data.ctrl[:] = [np.interp(t + DELAY, design.t, design.q[:, j]) for j in range(len(places))]
        mujoco.mj_step(model, data)
        cosines = np.abs((turned * data.xquat[watched]).sum(axis=1)).min()
        largest_turn = max(largest_turn, 2 * float(np.arccos(min(1.0, cosines))))
        largest_move = max(largest_move, float(np.linalg.norm(data.xpos[watched] - moved, axis=1).max()))
    return largest_turn, largest_move
