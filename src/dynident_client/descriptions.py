"""What requests take, by the contract: written by `python -m dynident_service.openapi`, not by hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypedDict

from dynident_client.requests import Limits


class Drive(TypedDict, total=False):
    """The drive chain of a joint [12.17]: torque = drive_gain x recorded current."""

    amplifier_gain: float | None
    """Unit of current per unit of what is recorded"""
    coupling: Mapping[str, float]
    """Other joints that this motor turns with, and how far beside its own; its torque acts on them in the same
    shares"""
    drive_gain: float | None
    """N m or N per unit of current"""
    gear_ratio: float | None
    """Turns of the motor in one of the joint"""
    torque_constant: float | None
    """N m per unit of current, of the motor"""


class MeasurementOptions(TypedDict, total=False):
    """Metadata of an uploaded file."""

    accept: Sequence[str]
    """Names of checks whose errors are to count as warnings"""
    columns: Mapping[str, str]
    """Our name to the file's: {"q1": "shoulder_angle"}"""
    effort_kind: Literal[
        "motor_current",
        "motor_torque",
        "joint_torque",
        "gravity_compensated",
        "external",
        "commanded",
        "unknown",
        None,
    ]
    """What the torque or current columns hold; those that are no measurement are refused"""
    exclude: Sequence[tuple[float, float]]
    """Seconds of t to leave out, [from, to]; [] for nothing"""
    format: Literal[
        "csv",
        "parquet",
        "jsonl",
        "npy",
        "npz",
        "mat",
        "hdf5",
        "rosbag",
        "rosbag2",
        "mcap",
        "rsi",
        "zip",
        None,
    ]
    """Told from the file where not given"""
    payload: Mapping[str, Any] | None
    """The known load: {"mass": kg, "centre": [x, y, z] in m}"""
    permutation: Mapping[str, Sequence[int]]
    """Of "q" (with velocities and commands) or "tau" (or currents): at place k the number, from 1, of joint k's
    column"""
    rate: float | None
    """Rows a second, evenly spaced, of a file without time; it replaces a column t, in Hz"""
    role: Literal["identification", "validation", "friction", "payload"] | None
    """What it is for; friction: runs at constant velocity, a joint at a time; payload: with a load"""
    scale: Mapping[str, float]
    """Positive factors of a joint's positions or torques: {"tau2": 0.1}"""
    signs: Mapping[str, float]
    """1 or -1 by which a joint's positions or torques are taken: {"tau2": -1}; "tau" means all joints"""
    skip: Sequence[Literal["registers", "held_samples", "idle_drives", "corrupted_samples", "wrapped_angles"]]
    """Steps of conditioning that are not taken: what looks like a register, held, switched off, corrupted or wrapped is
    right"""
    torque_delay: float
    """Seconds by which the file's torque is late"""
    units: Mapping[str, str]
    """By kind of signal or by column: {"q": "deg"}; SI elsewhere"""
    windows: Sequence[tuple[float, float]]
    """Seconds of t to use, [from, to]; [] for all"""


class RevisionOptions(TypedDict, total=False):
    """Changes to the metadata of a measurement's file, which stays as it is. Fields that are not given stay, too."""

    columns: Mapping[str, str] | None
    """Our name to the file's: {"q1": "shoulder_angle"}"""
    exclude: Sequence[tuple[float, float]] | None
    """Seconds of t to leave out, [from, to]; [] for nothing"""
    name: str | None
    """What it is called"""
    permutation: Mapping[str, Sequence[int]] | None
    """Of "q" (with velocities and commands) or "tau" (or currents): at place k the number, from 1, of joint k's
    column"""
    rate: float | None
    """Rows a second, evenly spaced, of a file without time; it replaces a column t"""
    role: Literal["identification", "validation", "friction", "payload"] | None
    """What it is for; friction: runs at constant velocity, a joint at a time; payload: with a load"""
    scale: Mapping[str, float] | None
    """Positive factors of a joint's positions or torques: {"tau2": 0.1}"""
    signs: Mapping[str, float] | None
    """1 or -1 by which a joint's positions or torques are taken: {"tau2": -1}; "tau" means all joints"""
    skip: Sequence[Literal["registers", "held_samples", "idle_drives", "corrupted_samples", "wrapped_angles"]] | None
    """Steps of conditioning that are not taken: what looks like a register, held, switched off, corrupted or wrapped is
    right"""
    torque_delay: float | None
    """Seconds by which the file's torque is late"""
    units: Mapping[str, str] | None
    """By kind of signal or by column: {"q": "deg"}; SI elsewhere"""
    windows: Sequence[tuple[float, float]] | None
    """Seconds of t to use, [from, to]; [] for all"""


class RobotOptions(TypedDict, total=False):
    """A request to store a robot."""

    base_parameters_tolerance: float | None
    """Share of a column that other columns may leave unexplained."""
    drives: Mapping[str, Drive]
    """By joint"""
    gravity: tuple[float, float, float] | None
    """m/s² in the base frame"""
    limits: Mapping[str, Limits]
    """By joint; these replace the limits of the description."""
    locked_joints: Mapping[str, float]
    """Joint to position, rad or m"""
    meshes_of: str | None
    """A robot whose uploaded meshes are also used for this one, if their names are the same."""
