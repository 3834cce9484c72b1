"""`Recording`: signals in SI units by joint, in segments of even sampling; where its samples come from."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.errors import KnownNames
from dynident.recordings.recording_metadata import Check, Windows
from dynident.text_encoding import escape_surrogates

JointKind = Literal["revolute", "prismatic"]

# In any unit; fourth powers of it can still be taken.
_LARGEST_READING = 1e30


@dataclass(frozen=True)
class JointLimits:
    """What the checks know of a joint: its kind and, where known, its limits.

    Parameters
    ----------
    kind : "revolute" or "prismatic"
        Kind of the joint.
    position : pair of float, optional
        Lowest and highest position in rad, or m.
    velocity : float, optional
        Largest speed in rad/s, or m/s.
    effort : float, optional
        Largest torque in N m, or force in N.
    """

    kind: JointKind = "revolute"
    position: tuple[float, float] | None = None
    velocity: float | None = None
    effort: float | None = None

    @property
    def torque_unit(self) -> str:
        """Unit of the joint's torque, or of its force."""
        return "N" if self.kind == "prismatic" else "N m"


WrenchProjection = Callable[[str, FloatArray, FloatArray, bool], FloatArray]


@dataclass(frozen=True, eq=False)
class RecordedJoints:
    """The joints that the columns of a file are of, in the robot's order, and what is known of them.

    Parameters
    ----------
    names : sequence of str
        Names of the n joints, in the robot's order.
    limits : sequence of JointLimits, optional
        Limits of the joints. What is not given is not checked against; joints then count as revolute.
    gains : sequence of float or None, optional
        Drive gains [12.17] in N m (N) per unit of current, `None` where one is not known.
    coupling : (n, n), optional
        As `dynident.robot.coupling_matrix` gives it, where motors act on several joints.
    n_base : int
        Number of leading joints that are coordinates of a base that moves. Columns with numbers count the others.
    links : sequence of str, optional
        Links of a robot whose base moves, on which wrenches may be measured; the root link first.
    project_wrench : function, optional
        Returns torques Jᵀw (m, n) of a link's wrench: called with its name, positions (m, n), the wrench (m, 6), and
        whether that is along the axes of the world about its origin.
    project_contacts : function, optional
        Returns torques (m, n) without what unknown contact forces add, of positions and torques (m, n).

    Raises
    ------
    ValueError
        For another number of limits or gains than of names.
    """

    names: Sequence[str]
    limits: Sequence[JointLimits] | None = None
    gains: Sequence[float | None] | None = None
    coupling: FloatArray | None = None
    n_base: int = 0
    links: Sequence[str] = ()
    project_wrench: WrenchProjection | None = None
    project_contacts: Callable[[FloatArray, FloatArray], FloatArray] | None = None

    def __post_init__(self) -> None:
        counts = [len(values) for values in (self.limits, self.gains) if values is not None]
        if any(count != self.n for count in counts):
            raise ValueError(
                f"{self.n} joints, but {' and '.join(map(str, counts))} limits or gains: the numbers must agree"
            )

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.names)

    def name_columns(self, kind: str, joint: int) -> tuple[str, ...]:
        """Return our names of the column of a joint's signal: q_elbow and q3, or q_base_x and base_x."""
        name = self.names[joint]
        if joint < self.n_base:
            return (f"{kind}_{name}", *((name,) if kind == "q" else ()))
        return f"{kind}_{name}", f"{kind}{joint + 1 - self.n_base}"

    @property
    def further_columns(self) -> frozenset[str]:
        """Our names of columns that only robots have whose base moves: its pose, and wrenches on links."""
        if not self.n_base:
            return frozenset()
        pose = {f"base_{component}" for component in ("qx", "qy", "qz", "qw", "acc_x", "acc_y", "acc_z")}
        places = [f"{frame}{link}" for frame in ("", "world_") for link in ("base", *self.links)]
        return frozenset(pose | {f"{place}_{kind}{axis}" for place in places for kind in "fm" for axis in "xyz"})

    @property
    def known_limits(self) -> tuple[JointLimits, ...]:
        """The limits of all joints, empty ones where none were given."""
        return (JointLimits(),) * self.n if self.limits is None else tuple(self.limits)

    @property
    def known_gains(self) -> tuple[float | None, ...]:
        """The drive gains of all joints."""
        return (None,) * self.n if self.gains is None else tuple(self.gains)


class ModelChecks(Protocol):
    """What a model of the robot says of a recording, given the user's names of its position and torque columns.

    None where it says nothing.
    """

    def __call__(self, recording: Recording, q: Sequence[str], tau: Sequence[str], /) -> tuple[Check, ...] | None:
        """Check a recording."""


@dataclass(frozen=True)
class Segment:
    """A run of uniformly sampled rows; nothing is filtered across its ends.

    Row k of the segment was sampled at `start_time` + k / sampling rate.

    Parameters
    ----------
    first_row : int
        First of its rows in the stored recording, counted from 0.
    length : int
        Number of its rows.
    start_time : float
        Time of its first row in s.
    label : int
        Value of the user's `segment` column; 0 without one.
    """

    first_row: int
    length: int
    start_time: float
    label: int = 0


WRENCH_NAMES = ("base_fx", "base_fy", "base_fz", "base_mx", "base_my", "base_mz")
"""Columns of the wrench that the base exerts on the robot, along the axes of the base frame and about its origin."""


class StoredRows(NamedTuple):
    """Consecutive stored rows in SI units.

    Parameters
    ----------
    q, tau : (m, n)
        Positions in rad or m, and torques in N m or forces in N.
    temperature : (m, n) or None
        Temperatures of the joints in degC.
    wrench : (m, 6), optional
        Force in N, then moment in N m, of the base on the robot.
    command : (m, n), optional
        Positions that the robot was told to take, in rad or m.
    """

    q: FloatArray
    tau: FloatArray
    temperature: FloatArray | None
    wrench: FloatArray | None = None
    command: FloatArray | None = None


class SampleSource(Protocol):
    """Source of the rows of a recording: a file or arrays."""

    def rows(self, first: int, length: int, block_length: int) -> Iterator[StoredRows]:
        """Yield `length` rows from row `first` on, in blocks of at most about `block_length`."""
        ...


@dataclass(frozen=True, eq=False)
class Recording(KnownNames):
    """A checked recording in SI units and the robot's joint order, uniformly sampled within each segment.

    Parameters
    ----------
    name : str
        What the user calls it.
    joint_names : tuple of str
        Names of the n joints, in the robot's order.
    sampling_rate : float
        Rows a second, in Hz, the same in all segments.
    segments : tuple of Segment
        The runs of rows without a gap.
    source : SampleSource
        Gives the rows: a canonical file, or arrays.
    windows : pairs (from, to)
        Seconds of t to use; empty: all of them.
    role : str, optional
        What it is for: identification, validation, friction, payload or poses.
    payload : mapping, optional
        The known load as it was stated; None: no load.
    has_temperature : bool
        Whether its rows hold temperatures.
    path : path, optional
        Where its canonical file lies; None if it is held in memory.
    has_wrench : bool
        Whether its rows hold the wrench of the base on the robot.
    has_command : bool
        Whether its rows hold commanded positions.
    joints_without_torque : tuple of str
        Joints whose torque was not recorded and is stored as zero: their motion counts, their own equation does not.
    torque_from_commands : bool
        Whether no torque was recorded, and the rows hold what position servos make of their commands.
    torque_ranges : n pairs (low, high)
        Torques at and beyond which a joint's sensor or drive is at its range, infinite where it never is;
        low above high: the ends of a dead zone, within which nothing was measured; empty: none.
    """

    name: str
    joint_names: tuple[str, ...]
    sampling_rate: float
    segments: tuple[Segment, ...]
    source: SampleSource
    windows: Windows = ()
    role: str | None = None
    payload: Mapping[str, Any] | None = None
    has_temperature: bool = False
    path: Path | None = None
    has_wrench: bool = False
    has_command: bool = False
    joints_without_torque: tuple[str, ...] = ()
    torque_from_commands: bool = False
    torque_ranges: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        # The name of its file may be no UTF-8, and Arrow and matplotlib take no text that has no encoding.
        object.__setattr__(self, "name", escape_surrogates(self.name))
        object.__setattr__(self, "joint_names", tuple(escape_surrogates(name) for name in self.joint_names))

    def __repr__(self) -> str:
        runs = f" in {len(self.segments)} runs" if len(self.segments) > 1 else ""
        return (
            f"Recording({self.name}: {self.n} joints, {self.n_samples} samples at {self.sampling_rate:.4g} Hz, "
            f"{self.n_samples * self.period:.4g} s{runs})"
        )

    def __len__(self) -> int:
        return self.n_samples

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @property
    def has_torque(self) -> BoolArray:
        """Which joints (n,) have a recorded torque."""
        return np.array([name not in self.joints_without_torque for name in self.joint_names])

    @property
    def n_samples(self) -> int:
        """Number of samples over all segments."""
        return sum(segment.length for segment in self.segments)

    @property
    def period(self) -> float:
        """Sampling period T in s."""
        return 1.0 / self.sampling_rate

    def name_segment(self, segment: int) -> str:
        """Return the name of a segment: the recording's, with the segment's label if there are several labels."""
        several = len({item.label for item in self.segments}) > 1
        return f"{self.name}#{self.segments[segment].label}" if several else self.name

    @property
    def segment_names(self) -> tuple[str, ...]:
        """The names of its runs, each once."""
        return tuple(dict.fromkeys(self.name_segment(k) for k in range(len(self.segments))))

    def with_windows(self, windows: Windows) -> Recording:
        """Return the same recording with other seconds of t to use."""
        return replace(self, windows=windows)

    def inside_windows(self, t: FloatArray) -> BoolArray:
        """Return which of the times t (m,) lie in a window; all of them if there is none."""
        # Ends of windows are decimal numbers and times of samples are computed: rounding must not decide about a sample
        # on a border.
        return is_inside_windows(t, self.windows, tolerance=1e-6 * self.period)


@dataclass(frozen=True, eq=False)
class SampleBlock:
    """Consecutive samples of one segment after the position filter.

    Parameters
    ----------
    segment : int
        Index of the segment.
    t : (m,)
        Times in s.
    q, dq, ddq, dddq, ddddq : (m, n)
        Filtered positions and their four derivatives, in rad, rad/s and so on, or m, m/s and so on.
    tau : (m, n)
        Torques in N m, or forces in N, unfiltered.
    used : (m,) of bool
        True inside the windows and clear of the segment's ends, at which the filter settles.
    temperature : (m, n) or None
        Temperatures of the joints in degC.
    starts_segment : bool
        Whether the first sample is the first one of the segment.
    wrench : (m, 6), optional
        Force in N, then moment in N m, of the base on the robot, unfiltered.
    measured_q : (m, n), optional
        Positions as recorded, at which forces of contacts were taken out of the torques.
    """

    segment: int
    t: FloatArray
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    dddq: FloatArray
    ddddq: FloatArray
    tau: FloatArray
    used: BoolArray
    temperature: FloatArray | None
    starts_segment: bool
    wrench: FloatArray | None = None
    measured_q: FloatArray | None = None

    def split(self, length: int) -> Iterator[SampleBlock]:
        """Yield the samples in consecutive blocks of so many at most; a block without samples as it is."""
        if len(self.t) <= length:
            yield self
            return
        per_sample = {name: each for name, each in vars(self).items() if isinstance(each, np.ndarray)}
        for first in range(0, len(self.t), length):
            parts: dict[str, Any] = {name: each[first : first + length] for name, each in per_sample.items()}
            yield replace(self, **parts, starts_segment=self.starts_segment and first == 0)


def are_readings(values: FloatArray) -> BoolArray:
    """Return which values a sensor could have given: numbers, and not beyond all size."""
    # Comparisons with NaN are false: NaN and infinity are sorted out by the same test.
    readings: BoolArray = np.abs(values) < _LARGEST_READING
    return readings


def is_inside_windows(t: FloatArray, windows: Windows, tolerance: float = 0.0) -> BoolArray:
    """Return which times lie in one of the windows, ends included; all of them if there is none.

    Parameters
    ----------
    t : (m,)
        Times in s.
    windows : pairs (from, to)
        Seconds of t to use.
    tolerance : float
        Seconds by which a time may lie outside a window all the same.

    Returns
    -------
    (m,) of bool
        True inside a window.
    """
    if not windows:
        return np.ones(len(t), dtype=bool)
    is_inside = np.zeros(len(t), dtype=bool)
    for start, end in windows:
        is_inside |= (t >= start - tolerance) & (t <= end + tolerance)
    return is_inside


def count_base_coordinates(names: Sequence[str]) -> int:
    """Return how many of a robot's leading joints are the coordinates of a base that moves, all of them or none.

    Parameters
    ----------
    names : sequence of str
        Names of its joints, such as gantry axes that somebody called base_x and base_z.
    """
    return max((len(base) for base in _COORDINATES if tuple(names[: len(base)]) == base), default=0)


_COORDINATES = (
    ("base_x", "base_y", "base_z", "base_yaw", "base_pitch", "base_roll"),
    ("base_x", "base_y", "base_yaw"),
)
"""Coordinates of a floating and of a planar base."""
