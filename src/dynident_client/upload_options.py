"""What requests take, by the contract: written by `python -m dynident_service.openapi`, not by hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypedDict

from dynident_client.computation_options import Limits


class Drive(TypedDict, total=False):
    """The drive chain of a joint [12.17]: torque = drive_gain x recorded current."""

    amplifier_gain: float | None
    """Current per unit of the recorded signal (-1e+09 to 1e+09)"""
    coupling: Mapping[str, float]
    """Other joints that this motor also moves, each with its motion relative to the motor's own joint; the motor's
    torque acts on them with the same factors (-1e+09 to 1e+09)"""
    drive_gain: float | None
    """Joint torque per unit of current, in N m or N (-1e+09 to 1e+09)"""
    gear_ratio: float | None
    """Turns of the motor per turn of the joint (-1e+09 to 1e+09)"""
    torque_constant: float | None
    """Motor torque per unit of current, in N m (-1e+09 to 1e+09)"""


class MeasurementOptions(TypedDict, total=False):
    """Metadata of an uploaded file."""

    accept: Sequence[str]
    """Names of checks whose errors count as warnings"""
    columns: Mapping[str, str]
    """From the standard name to the name in the file: {"q1": "shoulder_angle"}"""
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
    """Kind of signal in the torque or current columns; signals that are not measurements are rejected"""
    exclude: Sequence[tuple[float, float]]
    """Windows of t to leave out in s, [from, to]; [] for none"""
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
    """Detected from the file if not given"""
    payload: Mapping[str, Any] | None
    """The known load: {"mass": kg, "centre": [x, y, z] in m}"""
    permutation: Mapping[str, Sequence[int]]
    """Order of the columns of "q" (with velocities and commands) or "tau" (or currents): entry k is the number, from 1,
    of the column of joint k (1 to 1e+16)"""
    rate: float | None
    """Sampling rate of a file without a time column; it replaces a column t, in Hz (0.001 to 1e+06)"""
    role: Literal["identification", "validation", "friction", "payload"] | None
    """Purpose of the recording; friction: constant velocity, one joint at a time; payload: with a load"""
    scale: Mapping[str, float]
    """Positive factors for the positions or torques of a joint: {"tau2": 0.1} (above 0 to 1e+16)"""
    signs: Mapping[str, float]
    """Factor 1 or -1 for the positions or torques of a joint: {"tau2": -1}; "tau" means all joints (-1 to 1)"""
    skip: Sequence[Literal["registers", "held_samples", "idle_drives", "corrupted_samples", "wrapped_angles"]]
    """Conditioning steps to leave out, because samples that look like unsigned registers, held, switched off, corrupted
    or wrapped are right"""
    torque_delay: float
    """Delay of the torque in the file, in s (-1 to 1)"""
    units: Mapping[str, str]
    """Units by kind of signal or by column: {"q": "deg"}; SI if not given"""
    windows: Sequence[tuple[float, float]]
    """Windows of t to use in s, [from, to]; [] for all"""
    zeros: Mapping[str, float]
    """Position of a joint, after sign and factor, where the description has 0, in rad or m: {"q3": 1.5708}"""


class RevisionOptions(TypedDict, total=False):
    """Changes to the metadata of a measurement's file, which stays as it is. Fields that are not given stay, too."""

    columns: Mapping[str, str] | None
    """From the standard name to the name in the file: {"q1": "shoulder_angle"}"""
    exclude: Sequence[tuple[float, float]] | None
    """Windows of t to leave out in s, [from, to]; [] for none"""
    name: str | None
    """Name of the recording"""
    permutation: Mapping[str, Sequence[int]] | None
    """Order of the columns of "q" (with velocities and commands) or "tau" (or currents): entry k is the number, from 1,
    of the column of joint k (1 to 1e+16)"""
    rate: float | None
    """Sampling rate of a file without a time column; it replaces a column t, in Hz (0.001 to 1e+06)"""
    role: Literal["identification", "validation", "friction", "payload"] | None
    """Purpose of the recording; friction: constant velocity, one joint at a time; payload: with a load"""
    scale: Mapping[str, float] | None
    """Positive factors for the positions or torques of a joint: {"tau2": 0.1} (above 0 to 1e+16)"""
    signs: Mapping[str, float] | None
    """Factor 1 or -1 for the positions or torques of a joint: {"tau2": -1}; "tau" means all joints (-1 to 1)"""
    skip: Sequence[Literal["registers", "held_samples", "idle_drives", "corrupted_samples", "wrapped_angles"]] | None
    """Conditioning steps to leave out, because samples that look like unsigned registers, held, switched off, corrupted
    or wrapped are right"""
    torque_delay: float | None
    """Delay of the torque in the file, in s (-1 to 1)"""
    units: Mapping[str, str] | None
    """Units by kind of signal or by column: {"q": "deg"}; SI if not given"""
    windows: Sequence[tuple[float, float]] | None
    """Windows of t to use in s, [from, to]; [] for all"""
    zeros: Mapping[str, float] | None
    """Position of a joint, after sign and factor, where the description has 0, in rad or m: {"q3": 1.5708}"""


class RobotOptions(TypedDict, total=False):
    """A request to store a robot."""

    base_parameters_tolerance: float | None
    """Share of a column that other columns may leave unexplained."""
    drives: Mapping[str, Drive]
    """By joint"""
    gravity: tuple[float, float, float] | None
    """m/s² in the base frame"""
    has: Sequence[str]
    """Parts that the robot has"""
    has_not: Sequence[str]
    """Parts that it does not have: diagnoses do not propose their effects"""
    limits: Mapping[str, Limits]
    """By joint; these replace the limits of the description."""
    locked_joints: Mapping[str, float]
    """Joint to position, rad or m"""
    meshes_of: str | None
    """A robot whose uploaded meshes are also used for this one, if their names are the same."""
