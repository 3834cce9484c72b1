"""Machines with tied joints and closed loops as robot documents, and MuJoCo's and Pinocchio's view of them."""

from __future__ import annotations

import re
from functools import cache
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from dynident.robot import Robot, to_pinocchio
from dynident.robot.modified_dh import robot_from_modified_dh

FloatArray = NDArray[np.float64]


def bar(length: float, mass: float, off: float = 0.01) -> dict[str, Any]:
    """Mass properties of a bar along x, a little to the side."""
    i = mass * length**2 / 12
    return {
        "mass": mass,
        "center_of_mass": [length / 2, off, 0.005],
        "inertia": [0.002 + 0.02 * i, 0.0, 0.0, i + 0.001, 0.0, i + 0.0025],
    }


def five_bar() -> dict[str, Any]:
    """Two driven cranks on the base, two passive rods that meet in a pin, in a vertical plane."""
    return {
        "gravity": [0, -9.81, 0],
        "joints": [
            {"name": "left", "antecedent": "base", "start": 2.2, "limits": {"position": [1.7, 2.6]}}
            | {"mass_properties": bar(0.3, 1.8)},
            {"name": "left_rod", "d": 0.3, "passive": True, "start": -1.2, "mass_properties": bar(0.4, 2.4)},
            {"name": "right", "antecedent": "base", "d": 0.25, "start": 0.9, "limits": {"position": [0.5, 1.4]}}
            | {"mass_properties": bar(0.3, 1.8)},
            {"name": "right_rod", "d": 0.3, "passive": True, "start": 1.2, "mass_properties": bar(0.4, 2.4)},
        ],
        "loops": [
            {
                "name": "tip",
                "kind": "planar",
                "between": [{"joint": "left_rod", "at": [0.4, 0, 0]}, {"joint": "right_rod", "at": [0.4, 0, 0]}],
            }
        ],
    }


def palletiser(crank: float = 0.25, rod: float = 0.8) -> dict[str, Any]:
    """The second motor on the yawing base moves the forearm by a lever and a rod: a parallelogram with the arm."""
    return {
        "joints": [
            {"name": "yaw", "limits": {"position": [-2.0, 2.0]}, "mass_properties": bar(0.4, 30.0)},
            {"name": "arm", "d": 0.15, "alpha": "pi/2", "start": 1.4, "limits": {"position": [0.8, 2.0]}}
            | {"mass_properties": bar(0.8, 20.0)},
            {"name": "forearm", "d": 0.8, "passive": True, "start": -1.6, "mass_properties": bar(0.9, 12.0)},
            {"name": "lever", "antecedent": "yaw", "d": 0.15, "alpha": "pi/2", "start": 2.9}
            | {"limits": {"position": [2.5, 3.5]}, "mass_properties": bar(0.25, 5.0)},
            {"name": "rod", "antecedent": "lever", "d": crank, "passive": True, "start": -1.5}
            | {"mass_properties": bar(0.8, 4.0)},
            {"name": "flange", "antecedent": "forearm", "d": 0.9, "alpha": "-pi/2", "mass_properties": bar(0.1, 2.0)}
            | {"limits": {"position": [-2.0, 2.0]}},
        ],
        "loops": [
            {
                "name": "parallelogram",
                "kind": "planar",
                "between": [{"joint": "rod", "at": [rod, 0, 0]}, {"joint": "forearm", "at": [-crank, 0, 0]}],
            }
        ],
    }


def delta() -> dict[str, Any]:
    """Three driven arms, three rods with ball joints, and a platform that does not turn (three sliders)."""
    joints: list[dict[str, Any]] = []
    for k in range(3):
        joints += [
            {"name": f"arm{k}", "antecedent": "base", "gamma": 2 * np.pi * k / 3, "alpha": "-pi/2", "d": 0.2}
            | {"start": 0.5, "limits": {"position": [0.1, 0.9]}, "mass_properties": bar(0.2, 0.6)},
            {"name": f"swing{k}", "d": 0.2, "passive": True, "start": 1.779, "mass_properties": bar(0.1, 0.1)},
            {"name": f"rod{k}", "alpha": "pi/2", "passive": True, "mass_properties": bar(0.5, 0.3)},
        ]
    small = {"mass": 0.05, "center_of_mass": [0, 0, 0], "inertia": [1e-4, 0, 0, 1e-4, 0, 1e-4]}
    turned = {"gamma": "pi/2", "alpha": "pi/2", "sigma": 1, "passive": True}
    joints += [
        {"name": "x", "antecedent": "base", "mass_properties": small} | turned,
        {"name": "y", "mass_properties": small} | turned,
        {"name": "z", "start": -0.4754, "mass_properties": bar(0.05, 0.4)} | turned,
    ]
    loops = [
        {
            "name": f"ball{k}",
            "kind": "point",
            "between": [
                {"joint": f"rod{k}", "at": [0.5, 0, 0]},
                {"joint": "z", "at": [0.05 * np.cos(2 * np.pi * k / 3), 0.05 * np.sin(2 * np.pi * k / 3), 0]},
            ],
        }
        for k in range(3)
    ]
    return {"joints": joints, "loops": loops}


def six_axis() -> dict[str, Any]:
    """A six-axis arm whose elbow a parallelogram moves, with a gripper of two fingers on one motor."""
    table = palletiser()
    limits = {"limits": {"position": [-2.0, 2.0]}}
    finger = {"sigma": 1, "mass_properties": bar(0.05, 0.1)}
    table["joints"][5] |= {"name": "roll", "alpha": "-pi/2"}
    table["joints"] += [
        {"name": "pitch", "alpha": "pi/2", "mass_properties": bar(0.1, 1.5)} | limits,
        {"name": "turn", "alpha": "-pi/2", "mass_properties": bar(0.1, 1.0)} | limits,
        {"name": "finger", "antecedent": "turn", "alpha": "pi/2", "limits": {"position": [0.0, 0.04]}} | finger,
        {"name": "other", "antecedent": "turn", "alpha": "-pi/2", "tie": {"finger": 1}} | finger,
    ]
    return table


MACHINES = {"five_bar": five_bar, "palletiser": palletiser, "delta": delta, "six_axis": six_axis}


@cache
def machine(name: str) -> Robot:
    """One of the machines."""
    return robot_from_modified_dh(name, MACHINES[name]())


def states(robot: Robot, count: int, seed: int = 0) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Random q, dq, ddq (count, n) of the driven joints, within their limits."""
    rng = np.random.default_rng(seed)
    low, high = np.array([joint.limits.position or (-1.0, 1.0) for joint in robot.joints]).T
    q = rng.uniform(low, high, (count, robot.n))
    return q, rng.normal(size=q.shape), 3 * rng.normal(size=q.shape)


def mjcf(robot: Robot, *, friction: dict[str, tuple[float, float]] | None = None) -> str:
    """The machine for MuJoCo: bodies of the tree, loops as `connect`, ties as `joint` equalities.

    `friction`: Coulomb friction and damping of joints by name.
    """
    tree, linkage = robot.tree, robot.linkage
    closure = None if linkage is None else linkage.closure
    children: dict[int, list[int]] = {}
    for j, joint in enumerate(tree.joints):
        children.setdefault(joint.parent, []).append(j)
    sites: dict[int, list[tuple[str, FloatArray]]] = {}
    loops = () if closure is None else closure.loops
    for loop in loops:
        for end, side in zip(loop.ends, "ab", strict=True):
            sites.setdefault(end.joint, []).append((f"{loop.name}_{side}", end.frame[:3, 3]))

    def numbers(values) -> str:
        return " ".join(repr(float(value)) for value in values)

    def inside(j: int) -> str:
        text = "".join(f'<site name="{name}" pos="{numbers(at)}"/>' for name, at in sites.get(j, []))
        return text + "".join(body(child) for child in children.get(j, []))

    def body(j: int) -> str:
        joint = tree.joints[j]
        m, mx, my, mz, *tensor = pin_parameters(tree.inertias[j])
        inertia = pin.Inertia.FromDynamicParameters(np.array([m, mx, my, mz, *tensor]))
        i = inertia.inertia
        x, y, z, w = pin.Quaternion(joint.placement[:3, :3]).coeffs()
        coulomb, damping = (friction or {}).get(joint.name, (0.0, 0.0))
        kind = "hinge" if joint.kind == "revolute" else "slide"
        reach = joint.limits.position
        bounded = "" if reach is None else f'range="{numbers(reach)}" '
        return (
            f'<body name="b{j}" pos="{numbers(joint.placement[:3, 3])}" quat="{numbers((w, x, y, z))}">'
            f'<joint name="{joint.name}" type="{kind}" axis="{numbers(joint.axis)}" {bounded}damping="{damping!r}" '
            f'frictionloss="{coulomb!r}" solreffriction="0.0004 1" solimpfriction="0.9999 0.9999 0.001 0.5 2"/>'
            f'<inertial pos="{numbers(inertia.lever)}" mass="{inertia.mass!r}" '
            f'fullinertia="{numbers((i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]))}"/>{inside(j)}</body>'
        )

    hard = 'solref="0.0004 1" solimp="0.9999 0.9999 0.001 0.5 2"'
    equalities = [f'<connect site1="{loop.name}_a" site2="{loop.name}_b" {hard}/>' for loop in loops]
    for name, tie in ({} if linkage is None else linkage.ties).items():
        [(other, ratio)] = tie.ratios.items()
        equalities.append(f'<joint joint1="{name}" joint2="{other}" polycoef="0 {ratio!r} 0 0 0" {hard}/>')
    motors = "".join(f'<motor name="{name}" joint="{name}"/>' for name in robot.joint_names)
    bodies, key = inside(-1), ""
    if linkage is not None and closure is not None:
        at = linkage.ratios @ closure.check() + linkage.offsets
        order = [tree.joint_names.index(name) for name in re.findall(r'<joint name="(\w+)"', bodies)]
        key = f'<keyframe><key qpos="{numbers(at[order])}"/></keyframe>'
    return (
        f'<mujoco><compiler angle="radian" inertiafromgeom="false"/>'
        f'<option gravity="{numbers(robot.gravity)}" timestep="0.0002" integrator="implicitfast" tolerance="1e-14"'
        f' iterations="200" cone="elliptic"/><worldbody>{bodies}</worldbody>{key}'
        f"<equality>{''.join(equalities)}</equality><actuator>{motors}</actuator></mujoco>"
    )


def pin_parameters(inertial: FloatArray) -> FloatArray:
    """Ten parameters in Pinocchio's order."""
    return inertial[[9, 6, 7, 8, 0, 1, 3, 2, 4, 5]]


def torque_of_mujoco(robot: Robot, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
    """Γ (m, n) that moves the tree as q, dq, ddq (m, N) say, with whatever the constraints' forces add.

    M q̈ + h = Sᵀ Γ + Jᵀ λ, with M, h and J from MuJoCo.
    """
    model = mujoco.MjModel.from_xml_string(mjcf(robot))
    data = mujoco.MjData(model)
    order = [model.joint(name).dofadr[0] for name in robot.tree.joint_names]
    driven = [model.joint(name).dofadr[0] for name in robot.joint_names]
    found = []
    for state in zip(q, dq, ddq, strict=True):
        data.qpos[order], data.qvel[order], data.qacc[order] = state
        acceleration = data.qacc.copy()
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        assert np.abs(data.efc_pos[: data.nefc]).max() < 1e-8
        data.qacc[:] = acceleration
        needed = np.zeros(model.nv)
        mujoco.mj_rne(model, data, 1, needed)
        held = data.efc_J.reshape(data.nefc, model.nv) if data.efc_J.size == data.nefc * model.nv else None
        if held is None:
            held = np.zeros((data.nefc, model.nv))
            mujoco.mju_sparse2dense(held, data.efc_J, data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind)
        sides = np.hstack([np.eye(model.nv)[:, driven], held.T])
        found.append(np.linalg.lstsq(sides, needed, rcond=1e-12)[0][: robot.n])
    return np.array(found)


def accelerations_of_pinocchio(robot: Robot, q: FloatArray, dq: FloatArray, tau: FloatArray) -> FloatArray:
    """q̈ (m, N) of the tree by Pinocchio's constrained dynamics for torques (m, N); loops alone."""
    model = to_pinocchio(robot)
    constraints, of_constraints = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
    for loop in robot.linkage.closure.loops:
        ends = [part for end in loop.ends for part in (end.joint + 1, pin.SE3(end.frame))]
        constraints.append(pin.RigidConstraintModel(pin.ContactType.CONTACT_3D, model, *ends))
        of_constraints.append(constraints[-1].createData())
    data = model.createData()
    pin.initConstraintDynamics(model, data, constraints, of_constraints)
    settings = pin.ProximalSettings(1e-14, 1e-6, 1000)
    return np.array(
        [
            pin.constraintDynamics(model, data, *state, constraints, of_constraints, settings).copy()
            for state in zip(q, dq, tau, strict=True)
        ]
    )
