"""What an arm is built of besides links and drives. Joints are counted from 0."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from engine.physics import Act, Hidden, Live, Plan
from engine.scene import FRICTION, FloatArray, Scene, numbers


@dataclass(frozen=True)
class Spring(Hidden):
    """`stiffness` (q - rest)."""

    joint: int
    stiffness: float
    rest: float

    def build(self, scene: Scene, plan: Plan) -> None:
        scene.joint[self.joint] = f'stiffness="{float(self.stiffness)!r}" springref="{float(self.rest)!r}"'


@dataclass(frozen=True)
class Compensator(Hidden):
    """A spring from a point at `base` from the joint's axis to one at `arm` on the link, `length` when slack.

    The angle between the two points is q - `opposite`.
    """

    joint: int
    stiffness: float
    base: float
    arm: float
    length: float
    opposite: float

    def build(self, scene: Scene, plan: Plan) -> None:
        joint = scene.robot.joints[self.joint]
        u = _across(joint.axis)
        w = np.cross(joint.axis, u)
        # With the angle x between the arm and the line away from the anchor: l² = a² + b² + 2 a b cos x.
        away = -(np.cos(self.opposite) * u + np.sin(self.opposite) * w)
        placement = scene.placements[self.joint]
        anchor = placement[:3, 3] + placement[:3, :3] @ (self.base * away)
        name = f"compensator{self.joint}"
        _add_site(scene, joint.parent, f"{name}_base", anchor)
        _add_site(scene, self.joint, f"{name}_arm", self.arm * u)
        _add_spring(scene, name, self.stiffness, self.length)


@dataclass(frozen=True)
class Cable(Hidden):
    """A taut spring from a point of the link of `first`, `near` in its frame, to one of the link of `last`, `far`."""

    first: int
    last: int
    stiffness: float
    length: float
    near: tuple[float, float, float]
    far: tuple[float, float, float]

    def build(self, scene: Scene, plan: Plan) -> None:
        _add_site(scene, self.first, "cable_start", np.array(self.near))
        _add_site(scene, self.last, "cable_end", np.array(self.far))
        _add_spring(scene, "cable", self.stiffness, self.length)


@dataclass(frozen=True)
class Tilt(Hidden):
    """The base leans about x, then y, rad."""

    about_x: float
    about_y: float

    def build(self, scene: Scene, plan: Plan) -> None:
        (cx, sx), (cy, sy) = ((np.cos(angle), np.sin(angle)) for angle in (self.about_x, self.about_y))
        about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
        about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
        scene.gravity = about_y @ about_x @ scene.gravity


@dataclass(frozen=True)
class Payload(Hidden):
    """A body on the last link in the runs with these numbers: kg, centre in the last frame (m), radius of inertia."""

    mass: float
    centre: tuple[float, float, float]
    radius: float
    runs: tuple[int, ...]

    def build(self, scene: Scene, plan: Plan) -> None:
        if plan.index not in self.runs:
            return
        c = np.array(self.centre)
        tensor = self.mass * ((c @ c + self.radius**2) * np.eye(3) - np.outer(c, c))
        scene.inertias[-1] += [
            tensor[0, 0], tensor[0, 1], tensor[0, 2], tensor[1, 1], tensor[1, 2], tensor[2, 2],
            *(self.mass * c), self.mass,
        ]  # fmt: skip


@dataclass(frozen=True)
class Coupling(Hidden):
    """A motor that turns with q_j + side q_{j+1}: inertia, viscous and dry friction on both joints."""

    joint: int
    side: float
    inertia: float
    viscous: float
    coulomb: float

    def build(self, scene: Scene, plan: Plan) -> None:
        j = self.joint
        scene.tendons.append(
            f'<fixed name="motor{j}" damping="{float(self.viscous)!r}" frictionloss="{float(self.coulomb)!r}" '
            f'armature="{float(self.inertia)!r}" solreffriction="{2 * scene.step!r} 1" solimpfriction="{FRICTION}">'
            f'<joint joint="j{j}" coef="1"/><joint joint="j{j + 1}" coef="{float(self.side)!r}"/></fixed>'
        )


@dataclass(frozen=True)
class Rotor(Hidden):
    """The joint's rotor is a body on the link before, at the joint's axis, that turns `ratio` times as fast."""

    joint: int
    ratio: float

    def build(self, scene: Scene, plan: Plan) -> None:
        j = self.joint
        joint = scene.robot.joints[j]
        inertia = float(scene.rotor[j]) / self.ratio**2
        scene.rotor[j] = 0.0
        placement = scene.placements[j]
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(placement[:3, :3]).reshape(-1))
        # A disc: half as much across its axis.
        tensor = inertia * (0.51 * np.eye(3) + 0.49 * np.outer(joint.axis, joint.axis))
        full = [tensor[0, 0], tensor[1, 1], tensor[2, 2], tensor[0, 1], tensor[0, 2], tensor[1, 2]]
        scene.sites.setdefault(joint.parent, []).append(
            f'<body name="rotor{j}" pos="{numbers(placement[:3, 3])}" quat="{numbers(quaternion)}">'
            f'<inertial pos="0 0 0" mass="1e-6" fullinertia="{numbers(full)}"/>'
            f'<joint name="r{j}" type="hinge" axis="{numbers(joint.axis)}"/></body>'
        )
        scene.rest.append(
            f'<equality><joint joint1="r{j}" joint2="j{j}" polycoef="0 {float(self.ratio)!r} 0 0 0" '
            f'solref="{2 * scene.step!r} 1" solimp="0.9999 0.9999 0.001 0.5 2"/></equality>'
        )

    def start(self, live: Live) -> Act | None:
        k, j = int(live.model.joint(f"r{self.joint}").dofadr[0]), live.dof[self.joint]
        live.q[k] = self.ratio * live.q[j]
        return None


@dataclass(frozen=True)
class Displaced(Hidden):
    """A joint sits elsewhere than the description says, by `shift` (m) in its antecedent's frame."""

    joint: int
    shift: tuple[float, float, float]

    def build(self, scene: Scene, plan: Plan) -> None:
        scene.placements[self.joint, :3, 3] += self.shift


@dataclass(frozen=True)
class Ripple(Hidden):
    """Σ sizes sin(cycles q + phases): torque periodic in the joint's angle."""

    joint: int
    sizes: tuple[float, ...]
    cycles: tuple[float, ...]
    phases: tuple[float, ...]

    def start(self, live: Live) -> Act:
        applied, q, k = live.applied, live.q, live.dof[self.joint]
        waves = tuple(zip(self.sizes, self.cycles, self.phases, strict=True))

        def act(_: int) -> None:
            angle = q[k]
            for size, cycles, phase in waves:
                applied[k] -= size * np.sin(cycles * angle + phase)

        return act


def _across(axis: FloatArray) -> FloatArray:
    """A unit vector at right angles to the axis."""
    least = np.eye(3)[int(np.argmin(np.abs(axis)))]
    u = np.cross(axis, least)
    return np.asarray(u / np.linalg.norm(u))


def _add_site(scene: Scene, body: int, name: str, position: FloatArray) -> None:
    scene.sites.setdefault(body, []).append(f'<site name="{name}" pos="{numbers(position)}"/>')


def _add_spring(scene: Scene, name: str, stiffness: float, length: float) -> None:
    scene.tendons.append(
        f'<spatial name="{name}" stiffness="{float(stiffness)!r}" springlength="{float(length)!r}">'
        f'<site site="{name}_{"base" if name.startswith("comp") else "start"}"/>'
        f'<site site="{name}_{"arm" if name.startswith("comp") else "end"}"/></spatial>'
    )
