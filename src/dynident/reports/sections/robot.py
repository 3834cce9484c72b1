"""The section on the robot: joints, limits, drives, and its number of base parameters."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from dynident.identification import Identification
from dynident.reports.numbers import format_number, format_range
from dynident.reports.section import Section
from dynident.robot import Joint, Robot


@dataclass(frozen=True)
class JointRow:
    """One joint, in words."""

    number: int
    name: str
    kind: str
    antecedent: str
    position: str
    velocity: str
    acceleration: str
    jerk: str
    effort: str
    drive_gain: str


@dataclass(frozen=True)
class RobotContent:
    """The content of the section; `counts` are the base parameters of each effect."""

    robot: Robot
    joints: tuple[JointRow, ...]
    gravity: str
    locked: tuple[str, ...]
    n_parameters: int
    n_standard: int
    counts: tuple[tuple[str, int], ...]


def build_robot_section(identification: Identification) -> Section:
    """Return the section on the robot that was identified.

    Parameters
    ----------
    identification : Identification

    Returns
    -------
    Section
    """
    robot = identification.model.robot
    content = RobotContent(
        robot,
        tuple(_build_joint_row(robot, index) for index in range(robot.n)),
        f"({', '.join(format_number(float(value)) for value in robot.gravity)}) m/s²",
        tuple(f"{name} at {format_number(value)}" for name, value in robot.locked_joints.items()),
        identification.model.n_parameters,
        len(identification.model.columns),
        tuple(Counter(column.effect for column in identification.model.kept).items()),
    )
    return Section("robot", "The robot", "robot", content)


def _build_joint_row(robot: Robot, index: int) -> JointRow:
    joint = robot.joints[index]
    unit = "rad" if joint.kind == "revolute" else "m"
    limits = joint.limits
    gain = robot.drives[index].gain
    return JointRow(
        index + 1,
        joint.name,
        joint.kind,
        robot.joint_names[joint.parent] if joint.parent >= 0 else "base",
        format_range(*limits.position, unit) if limits.position else "–",
        _format_limit(limits.velocity, f"{unit}/s"),
        _format_limit(limits.acceleration, f"{unit}/s²"),
        _format_limit(limits.jerk, f"{unit}/s³"),
        _format_limit(limits.effort, joint.effort_unit),
        "–" if gain is None else f"{format_number(gain, 4)} {_get_gain_unit(joint)}",
    )


def _format_limit(value: float | None, unit: str) -> str:
    return "–" if value is None else f"{format_number(value)} {unit}"


def _get_gain_unit(joint: Joint) -> str:
    return f"{joint.effort_unit}/A"
