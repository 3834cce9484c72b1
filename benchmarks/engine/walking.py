"""Walking robots that another engine moves: a quadruped and a humanoid on their feet in MuJoCo, with contacts.

The description is read by MuJoCo from the maker's URDF; nothing of the program under test is used. Masses, centres,
inertias, friction and rotors of the robot that moves are drawn, so that they differ from those of the description. A
whole-body controller tracks a swaying centre of mass and trunk while the feet stand, or are lifted one after the
other; it knows the robot that it moves, and finds forces of the feet of least norm.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from dynident.known_robots import list_stock_robots

FloatArray = NDArray[np.float64]

STEP = 1e-3
"""Of the engine, s; the controller computes a torque every second step."""
_CONTROL_EVERY = 2
_FRICTION = "0.9999 0.9999 0.001 0.5 2"
_SETTLE = 1.0
_SWING = 0.9
"""Duration of a lift, s."""
_PYRAMID = np.array([[0.5, 0, 1], [-0.5, 0, 1], [0, 0.5, 1], [0, -0.5, 1]], dtype=np.float64)
"""Edges of the forces that the controller asks of a foot: it pushes, and does not slip."""


@dataclass(frozen=True)
class Kind:
    """A stock robot: its file, posture and feet.

    Parameters
    ----------
    name : str
        The robot in example-robot-data.
    posture : dict of str to float
        Positions of joints whose names end so, rad; others are zero.
    feet : dict of str to tuple of points
        Centres of the balls under each foot, in the frame of its link, m.
    ball : float
        Their radius, m.
    contacts : tuple of str
        How a user names the feet.
    shanks : tuple of str
        Links of which one is loaded.
    sway : tuple of float
        Sizes of the motion: centre of mass (x, y), height (m), turns of the trunk, other joints (rad).
    shift : float
        Duration of a shift of the weight before a foot is lifted, s.
    """

    name: str
    posture: dict[str, float]
    feet: dict[str, tuple[tuple[float, float, float], ...]]
    ball: float
    contacts: tuple[str, ...]
    shanks: tuple[str, ...]
    torso: str
    sway: tuple[float, float, float, float]
    shift: float


_SOLE = ((-0.05, 0.025, -0.03), (-0.05, -0.025, -0.03), (0.12, 0.03, -0.03), (0.12, -0.03, -0.03))
_LEGS = ("FL", "RR", "FR", "RL")
KINDS = {
    "quadruped": Kind(
        "go2",
        {"thigh_joint": 0.8, "calf_joint": -1.6},
        {f"{leg}_calf": ((0.0, 0.0, -0.213),) for leg in _LEGS},
        0.022,
        tuple(f"{leg}_calf@0,0,-0.213,0.022^0.015" for leg in _LEGS),
        tuple(f"{leg}_calf" for leg in _LEGS),
        "base",
        (0.04, 0.04, 0.2, 0.0),
        0.9,
    ),
    "humanoid": Kind(
        "g1_29dof_rev_1_0",
        {
            "hip_pitch_joint": -0.5,
            "knee_joint": 1.0,
            "ankle_pitch_joint": -0.5,
            "left_shoulder_roll_joint": 0.4,
            "right_shoulder_roll_joint": -0.4,
            "elbow_joint": 0.8,
        },
        {f"{side}_ankle_roll_link": _SOLE for side in ("left", "right")},
        0.005,
        ("left_ankle_roll_link^0.03", "right_ankle_roll_link^0.03"),
        ("left_knee_link", "right_knee_link"),
        "torso_link",
        (0.02, 0.04, 0.12, 0.5),
        1.8,
    ),
}


@dataclass(frozen=True, eq=False)
class Log:
    """A recording: t (m,), pose of the base (m, 7: position, quaternion x y z w), q and tau (m, n), feet that touch."""

    t: FloatArray
    pose: FloatArray
    q: FloatArray
    tau: FloatArray
    touching: NDArray[np.bool_]
    joints: tuple[str, ...]


@dataclass(eq=False)
class Walker:
    """A robot in MuJoCo whose links, friction and rotors are drawn by a seed."""

    kind: Kind
    model: mujoco.MjModel
    joints: tuple[str, ...]
    loads: list[str] = field(default_factory=list)

    @property
    def mass(self) -> float:
        """Mass of all links, kg."""
        return float(self.model.body_mass.sum())

    def load_link(self, link: str, mass: float, place: FloatArray) -> None:
        """Fix a small ball to a link, at a place in its frame (m)."""
        model, k = self.model, self.model.body(link).id
        old, centre = float(model.body_mass[k]), model.body_ipos[k].copy()
        turn = np.empty(9)
        mujoco.mju_quat2Mat(turn, model.body_iquat[k])
        tensor = turn.reshape(3, 3) @ np.diag(model.body_inertia[k]) @ turn.reshape(3, 3).T
        new = (old * centre + mass * place) / (old + mass)
        for part, at in ((old, centre), (mass, place)):
            arm = at - new
            tensor = tensor + part * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        tensor += 0.4 * mass * 0.03**2 * np.eye(3)
        self._set_link(k, old + mass, new, tensor)
        self.loads.append(link)

    def _set_link(self, k: int, mass: float, centre: FloatArray, tensor: FloatArray) -> None:
        values, vectors = np.linalg.eigh(tensor)
        vectors[:, 0] *= np.sign(np.linalg.det(vectors))
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(vectors).reshape(-1))
        model = self.model
        model.body_mass[k], model.body_ipos[k], model.body_inertia[k] = mass, centre, values
        model.body_iquat[k] = quaternion
        mujoco.mj_setConst(model, mujoco.MjData(model))


def find_description(kind: Kind) -> Path:
    """Return the URDF of a stock robot."""
    return list_stock_robots()[kind.name]


def build_walker(kind: Kind, seed: int, spread: float = 0.15) -> Walker:
    """Return a robot whose links differ from the description by `spread`."""
    tree = ElementTree.parse(find_description(kind)).getroot()
    for parent in list(tree.iter()):
        for child in list(parent):
            if child.tag in ("visual", "collision", "gazebo", "transmission"):
                parent.remove(child)
    if not any(joint.get("type") == "floating" for joint in tree.iter("joint")):
        children = {joint.find("child").get("link") for joint in tree.iter("joint")}  # type: ignore[union-attr]
        root = next(link.get("name") for link in tree.iter("link") if link.get("name") not in children)
        ElementTree.SubElement(tree, "link", name="world_of_root")
        joint = ElementTree.SubElement(tree, "joint", name="root", type="floating")
        ElementTree.SubElement(joint, "parent", link="world_of_root")
        ElementTree.SubElement(joint, "child", link=str(root))
    head = ElementTree.SubElement(tree, "mujoco")
    ElementTree.SubElement(head, "compiler", fusestatic="true", balanceinertia="true")
    spec = mujoco.MjSpec.from_string(ElementTree.tostring(tree, encoding="unicode"))
    spec.option.timestep = STEP
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 0.1], friction=[0.9, 0, 0], condim=3)
    for link, points in kind.feet.items():
        for point in points:
            spec.body(link).add_geom(
                type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[kind.ball, 0, 0], pos=point, mass=0.0,
                friction=[0.9, 0, 0], condim=3, solref=[0.005, 1.0], group=3,
            )  # fmt: skip
    model = spec.compile()
    # The controller knows no ends of joints, and would press against their stops, which no description tells.
    model.jnt_limited[:] = 0
    # Feet touch the floor alone.
    model.geom_contype[:], model.geom_conaffinity[:] = 2, 1
    model.geom_contype[0], model.geom_conaffinity[0] = 1, 2
    joints = tuple(model.joint(k).name for k in range(model.njnt) if model.jnt_type[k] == mujoco.mjtJoint.mjJNT_HINGE)
    walker = Walker(kind, model, joints)
    rng = np.random.default_rng([seed, 3])
    for k in range(1, model.nbody):
        if model.body_mass[k] <= 0:
            continue
        turn = np.empty(9)
        mujoco.mju_quat2Mat(turn, model.body_iquat[k])
        factor = float(np.clip(rng.normal(1.0, spread), 0.6, 1.5))
        tensor = factor * turn.reshape(3, 3) @ np.diag(model.body_inertia[k]) @ turn.reshape(3, 3).T
        centre = model.body_ipos[k] * (1.0 + rng.normal(0.0, spread, 3))
        walker._set_link(k, factor * float(model.body_mass[k]), centre, tensor)
    own = slice(6, None)
    size = model.jnt_actfrcrange[1:, 1].copy()
    effort = np.where(size > 0, size, 30.0)
    model.dof_frictionloss[own] = 0.01 * effort * rng.uniform(0.7, 1.5, model.nv - 6)
    model.dof_damping[own] = 0.003 * effort * rng.uniform(0.7, 1.5, model.nv - 6)
    model.dof_armature[own] = 0.0004 * effort * rng.uniform(0.7, 1.5, model.nv - 6)
    model.dof_solref[own] = [2 * STEP, 1.0]
    model.dof_solimp[own] = [float(text) for text in _FRICTION.split()]
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return walker


def _draw_sines(rng: np.random.Generator, size: FloatArray, slowest: float, fastest: float) -> FloatArray:
    """Return amplitude, angular frequency and phase (n, 4, 3) of sums of sines."""
    n = len(size)
    frequency = rng.uniform(slowest, fastest, (n, 4))
    share = rng.uniform(0.3, 1.0, (n, 4)) / (1.0 + frequency)
    share *= size[:, None] / share.sum(axis=1, keepdims=True)
    return np.stack([share, 2 * np.pi * frequency, rng.uniform(0, 2 * np.pi, (n, 4))], axis=2)


def _evaluate_sines(sines: FloatArray, t: float) -> FloatArray:
    """Return value, rate and acceleration (3, n), rising smoothly from rest."""
    size, rate, phase = np.moveaxis(sines, 2, 0)
    x = (size * np.sin(rate * t + phase)).sum(axis=1)
    dx = (size * rate * np.cos(rate * t + phase)).sum(axis=1)
    ddx = -(size * rate**2 * np.sin(rate * t + phase)).sum(axis=1)
    w, dw, ddw = _blend(t, 2.0)
    return np.array([w * x, dw * x + w * dx, ddw * x + 2 * dw * dx + w * ddx])


def _blend(t: float, duration: float) -> FloatArray:
    """Return a smooth rise from 0 to 1 in a duration, its rate and its acceleration."""
    s = min(max(t / duration, 0.0), 1.0)
    rate, acceleration = 30 * (s * (1 - s)) ** 2, 60 * s * (1 - s) * (1 - 2 * s)
    return np.array([s**3 * (10 - 15 * s + 6 * s * s), rate / duration, acceleration / duration**2])


class _Controller:
    """Torques that track references of the centre of mass, the trunk, the feet and the posture."""

    def __init__(self, walker: Walker, seed: int, *, stepping: bool, duration: float, pace: float) -> None:
        self.walker, self.stepping, self.duration = walker, stepping, duration
        kind, model = walker.kind, walker.model
        self.data = mujoco.MjData(model)
        rng = np.random.default_rng([seed, 5])
        self.posture = np.zeros(model.nv - 6)
        for k, name in enumerate(walker.joints):
            for end, angle in kind.posture.items():
                if name.endswith(end):
                    self.posture[k] = angle
        self.links = [model.body(link).id for link in kind.feet]
        self.feet = [np.array(points) for points in kind.feet.values()]
        self.is_point = len(self.feet[0]) == 1
        xy, height, turn, arms = kind.sway
        share = 0.5 if stepping else 1.0
        size = np.array([xy, 0.8 * xy, height, turn, turn, turn])
        self.sway = _draw_sines(rng, share * size, 0.15 * pace, 0.8 * pace)
        self.limbs = _draw_sines(rng, np.full(model.nv - 6, arms), 0.15 * pace, 0.9 * pace)
        self.swing = _draw_sines(rng, np.full(6, 1.0), 0.8, 2.2)
        self._place()

    def _place(self) -> None:
        """Put the robot on its feet, and remember where they are."""
        data, model = self.data, self.walker.model
        data.qpos[:3], data.qpos[3:7], data.qpos[7:] = 0.0, [1, 0, 0, 0], self.posture
        mujoco.mj_kinematics(model, data)
        lowest = min(self._find_points(k)[:, 2].min() for k in range(len(self.links)))
        data.qpos[2] = self.walker.kind.ball - lowest - 2e-4
        mujoco.mj_forward(model, data)
        self.home = [self._find_points(k).mean(axis=0) for k in range(len(self.links))]
        self.home_turn = [data.xmat[link].reshape(3, 3).copy() for link in self.links]
        self.centre, self.height = data.subtree_com[1].copy(), float(data.qpos[2])
        # The centre of mass stands over the middle of the feet.
        self.centre[:2] = np.mean(self.home, axis=0)[:2]

    def _find_points(self, foot: int) -> FloatArray:
        data, link = self.data, self.links[foot]
        return np.asarray(data.xpos[link] + self.feet[foot] @ data.xmat[link].reshape(3, 3).T)

    def _plan(self, t: float) -> tuple[FloatArray, int, float]:
        """Return where the weight goes (3, 2: place, rate, acceleration), which foot is lifted, how far its lift is."""
        cycle = self.walker.kind.shift + _SWING + 0.2
        middle = np.mean(self.home, axis=0)[:2]
        if not self.stepping or t < _SETTLE:
            return np.array([middle, 0 * middle, 0 * middle]), -1, 0.0
        number, phase = divmod(t - _SETTLE, cycle)
        n = len(self.links)
        foot, before = int(number) % n, (int(number) - 1) % n if number else -1
        # A lift that the recording would cut off is left out.
        if _SETTLE + (number + 1) * cycle > self.duration:
            foot = -1
        goal, last = (
            middle if k < 0 else np.mean([home for i, home in enumerate(self.home) if i != k], axis=0)[:2]
            for k in (foot, before)
        )
        s = _blend(phase, self.walker.kind.shift)
        lift = (phase - self.walker.kind.shift) / _SWING
        place = s[:, None] * (goal - last) + np.array([last, 0 * last, 0 * last])
        return place, foot if 0.0 <= lift < 1.0 and foot >= 0 else -1, lift

    def compute_torque(self, t: float) -> FloatArray:
        """Return the torques of the joints (n,) at the state of `data`."""
        model, data = self.walker.model, self.data
        nv = model.nv
        place, lifted, lift = self._plan(t)
        sway, limbs = _evaluate_sines(self.sway, t), _evaluate_sines(self.limbs, t)
        rows, targets = [], []

        def add(jacobian: FloatArray, acceleration: FloatArray, weight: float) -> None:
            rows.append(weight * jacobian)
            targets.append(weight * acceleration)

        mass = np.zeros((nv, nv))
        mujoco.mj_fullM(model, data, mass)
        jacobian = np.zeros((3, nv))
        mujoco.mj_jacSubtreeCom(model, data, jacobian, 1)
        wanted = place + sway[:, :2]
        error = wanted[0] - data.subtree_com[1][:2]
        add(jacobian[:2], 60.0 * error + 15.0 * (wanted[1] - jacobian[:2] @ data.qvel) + wanted[2], 3.0)
        row = np.zeros((1, nv))
        row[0, 2] = 1.0
        add(
            row,
            np.array([100 * (self.height + sway[0, 2] - data.qpos[2]) + 20 * (sway[1, 2] - data.qvel[2]) + sway[2, 2]]),
            3.0,
        )
        goal, error3 = np.empty(4), np.empty(3)
        mujoco.mju_euler2Quat(goal, np.ascontiguousarray(sway[0, 3:]), "XYZ")
        mujoco.mju_subQuat(error3, goal, data.qpos[3:7])
        turning = np.zeros((3, nv))
        turning[:, 3:6] = np.eye(3)
        add(turning, 100 * error3 + 20 * (sway[1, 3:] - data.qvel[3:6]) + sway[2, 3:], 3.0)
        contact = []
        for k, link in enumerate(self.links):
            where = self._find_points(k).mean(axis=0)
            linear, angular = np.zeros((3, nv)), np.zeros((3, nv))
            mujoco.mj_jac(model, data, linear, angular, where, link)
            goal_place, goal_rate = self.home[k].copy(), np.zeros(3)
            turn, stiffness = self.home_turn[k], 400.0
            if k == lifted:
                bell, rate = np.sin(np.pi * lift) ** 2, np.pi / _SWING * np.sin(2 * np.pi * lift)
                wave = _evaluate_sines(self.swing, t + 2.0)
                reach = np.array([0.05, 0.03, 0.0])
                goal_place += bell * (reach * wave[0, :3] + np.array([0, 0, 0.07]))
                goal_rate = rate * (reach * wave[0, :3] + np.array([0, 0, 0.07])) + bell * reach * wave[1, :3]
                if not self.is_point:
                    axis = 0.25 * bell * wave[0, 3:] * np.array([0.5, 1.0, 1.0])
                    turning_goal, spin = np.empty(9), np.empty(4)
                    mujoco.mju_euler2Quat(spin, axis, "XYZ")
                    mujoco.mju_quat2Mat(turning_goal, spin)
                    turn = turning_goal.reshape(3, 3) @ turn
            add(linear, stiffness * (goal_place - where) + 40 * (goal_rate - linear @ data.qvel), 10.0)
            if not self.is_point:
                own = data.xmat[link].reshape(3, 3)
                gap = turn @ own.T
                vector = 0.5 * np.array([gap[2, 1] - gap[1, 2], gap[0, 2] - gap[2, 0], gap[1, 0] - gap[0, 1]])
                add(angular, stiffness * vector - 40 * (angular @ data.qvel), 10.0)
            if k != lifted:
                for point in self._find_points(k):
                    part = np.zeros((3, nv))
                    mujoco.mj_jac(model, data, part, None, point - [0, 0, self.walker.kind.ball], link)
                    contact.append(_PYRAMID @ part)
        joints = np.zeros((nv - 6, nv))
        joints[:, 6:] = np.eye(nv - 6)
        q, dq = data.qpos[7:], data.qvel[6:]
        add(joints, 200 * (self.posture + limbs[0] - q) + 28 * (limbs[1] - dq) + limbs[2], 0.1)
        acceleration = np.linalg.lstsq(np.vstack(rows), np.concatenate(targets), rcond=None)[0]
        needed = mass @ acceleration + data.qfrc_bias
        feet = np.vstack(contact)
        # Nearly the least forces, pushing ones alone.
        small = 1e-3 * np.eye(len(feet))
        force, _ = nnls(np.vstack([feet[:, :6].T, small]), np.concatenate([needed[:6], np.zeros(len(feet))]))
        friction = model.dof_frictionloss * np.tanh(data.qvel / 0.05) + model.dof_damping * data.qvel
        return np.asarray((needed + friction)[6:] - feet[:, 6:].T @ force)


@dataclass(frozen=True)
class Instruments:
    """Standard deviations of noise: position (m) and turn (rad) of the base, joints (rad), share of a torque's own."""

    position: float = 3e-4
    turn: float = 5e-4
    joint: float = 1e-4
    torque: float = 0.01


def record_walk(
    walker: Walker, seed: int, *, stepping: bool, duration: float = 20.0, pace: float = 1.0, rate: float = 200.0,
    instruments: Instruments = Instruments(),
) -> Log:  # fmt: skip
    """Let a robot sway on its feet, or lift them one after the other, and record it at a rate (Hz).

    Raises
    ------
    RuntimeError
        Where it falls.
    """
    controller = _Controller(walker, seed, stepping=stepping, duration=duration, pace=pace)
    model, data = walker.model, controller.data
    rows, torque = [], np.zeros(model.nv - 6)
    for step in range(round((duration + _SETTLE) / STEP)):
        t = step * STEP - _SETTLE
        mujoco.mj_step1(model, data)
        if step % _CONTROL_EVERY == 0:
            torque = controller.compute_torque(max(t, 0.0))
        data.qfrc_applied[6:] = torque
        if t >= 0 and step % round(1.0 / (rate * STEP)) == 0:
            touching = [False] * len(controller.links)
            for pair in data.contact.geom[: data.ncon]:
                body = int(model.geom_bodyid[pair.max()])
                touching[controller.links.index(body)] = True
            rows.append((t, data.qpos.copy(), torque.copy(), touching))
        if not 0.5 * controller.height < data.qpos[2] < 1.5 * controller.height:
            raise RuntimeError(f"{walker.kind.name} fell after {t:.1f} s (seed {seed})")
        mujoco.mj_step2(model, data)
    return _measure(walker, rows, np.random.default_rng([seed, 7]), instruments)


def _measure(
    walker: Walker,
    rows: list[tuple[float, FloatArray, FloatArray, list[bool]]],
    rng: np.random.Generator,
    tools: Instruments,
) -> Log:
    t, states, torques, touching = (np.array(column) for column in zip(*rows, strict=True))
    position = states[:, :3] + tools.position * rng.standard_normal((len(t), 3))
    quaternion = np.empty((len(t), 4))
    for k, state in enumerate(states):
        turned = state[3:7].copy()
        mujoco.mju_quatIntegrate(turned, tools.turn * rng.standard_normal(3), 1.0)
        quaternion[k] = turned[[1, 2, 3, 0]]
    q = states[:, 7:] + tools.joint * rng.standard_normal((len(t), len(walker.joints)))
    tau = torques + tools.torque * torques.std(axis=0) * rng.standard_normal(torques.shape)
    return Log(t, np.hstack([position, quaternion]), q, tau, touching, walker.joints)


def write_log(path: Path, log: Log) -> Path:
    """Write a log as CSV with the columns that dynident documents."""
    pose = ("base_x", "base_y", "base_z", "base_qx", "base_qy", "base_qz", "base_qw")
    names = ["t", *pose, *(f"q_{name}" for name in log.joints), *(f"tau_{name}" for name in log.joints)]
    table = np.hstack([log.t[:, None], log.pose, log.q, log.tau])
    np.savetxt(path, table, delimiter=",", header=",".join(names), comments="", fmt="%.8g")
    return path
