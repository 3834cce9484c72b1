"""Motion of a base that moves, and forces on the robot from outside: from columns of a file to coordinates and torques.

A file states the pose of the base by its position and a unit quaternion. The quaternion becomes the angles yaw, pitch
and roll, R = Rz Ry Rx, which are singular at a pitch of 90°: rows near it are left out (`STEEPEST`). In place of a
position, an accelerometer is integrated twice: the equations contain only the acceleration of the base.

Measured wrenches of the surroundings on links, as of foot sensors and force plates, are torques Jᵀw of all joints that
move the link, those of the base among them. They are added to what the motors give: W χ = τ + Σ Jᵀw.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import pi

import numpy as np
import pyarrow as pa

from dynident.array_types import FloatArray
from dynident.recordings.arrow_tables import from_numbers
from dynident.recordings.columns_to_signals import Column, Layout
from dynident.recordings.file_source import FileSource, RawRows, RawSource, to_float_column
from dynident.recordings.recording import RecordedJoints
from dynident.recordings.recording_metadata import Check, RecordingError, RecordingMetadata
from dynident.recordings.units import find_conversion, find_unit

STEEPEST = 75.0 * pi / 180.0
"""Pitch of the base (rad) from which on rows are left out: the rates of yaw and roll are four times the angular
velocity there, and so is their noise."""

_MIXED = 1e-9
"""Share of a joint's torque in the projected equations of others from which on they count as mixed."""
_ANGLES = ("base_yaw", "base_pitch", "base_roll")
POSITION = ("base_x", "base_y", "base_z")
QUATERNION = ("base_qx", "base_qy", "base_qz", "base_qw")
ACCELERATION = ("base_acc_x", "base_acc_y", "base_acc_z")
"""What an accelerometer at the origin of the root link measures along its axes, m/s²: 9.81 upwards at rest."""
_COORDINATES = ((*POSITION, *_ANGLES), ("base_x", "base_y", "base_yaw"))
"""Of a floating and of a planar base."""
_BODIES = ("base", "root", "pelvis", "trunk", "torso", "body", "floating", "odom", "odometry", "mocap", "imu")
"""Words by which loggers call the base, the most usual first."""
_NO_POSE = frozenset(
    {"vel", "velocity", "lin", "linear", "ang", "angular", "twist", "omega", "gyro", "acc", "accel", "acceleration"}
    | {"rate", "force", "torque", "wrench", "cmd", "command", "desired", "target", "ref", "covariance"}
)
"""Words of names that are no pose, or none that was measured."""
_ACCELERATION_NAME = re.compile(r"_?(?:lin_|linear_)?(?:acc|accel|acceleration|accelerometer)_?([xyz]|[012])$")
_LINEAR = frozenset({"lin", "linear", "acc", "accel", "acceleration"})
_GRAVITY = np.array([0.0, 0.0, -9.81])
_POSITION_NAME = re.compile(r"_(?:pos|position|p|translation|xyz)?_?([xyz]|[012])$")
_ORIENTATION_NAME = re.compile(r"_(?:quat|quaternion|orientation|ori|rot|rotation|q)_?([xyzw])$")
COMPONENTS = ("fx", "fy", "fz", "mx", "my", "mz")


def count_base_coordinates(names: Sequence[str]) -> int:
    """Return how many of a robot's leading joints are the coordinates of a base that moves, all of them or none.

    Parameters
    ----------
    names : sequence of str
        Names of its joints, such as gantry axes that somebody called base_x and base_z.
    """
    return max((len(base) for base in _COORDINATES if tuple(names[: len(base)]) == base), default=0)


def _split_name(name: str) -> str:
    return re.sub(r"[^a-z0-9]+", "_", name.casefold()).strip("_")


def find_base_columns(names: Sequence[str], metadata: RecordingMetadata) -> dict[str, str]:
    """Return the columns of a file that state the pose of the base.

    Parameters
    ----------
    names : sequence of str
        The file's columns.
    metadata : RecordingMetadata
        What the user says of the columns; it goes before what their names say.

    Returns
    -------
    dict of str to str
        The file's column by ours: base_x, base_y, base_z, base_qx, base_qy, base_qz, base_qw, as far as they are known.
        Quaternions whose components are numbered are not guessed: the order of the components differs between loggers.
        Without a position, base_acc_x, base_acc_y and base_acc_z of an accelerometer.
    """
    groups: dict[tuple[int, str], dict[str, str]] = {}
    for name in names:
        words = _split_name(name)
        parts = words.split("_")
        rank = next((k for k, body in enumerate(_BODIES) if body in parts), None)
        is_sensor = (rank is not None or "accelerometer" in parts) and not (_NO_POSE - _LINEAR) & set(parts)
        if is_sensor and (match := _ACCELERATION_NAME.search(words)):
            component = dict(zip("012", "xyz", strict=True)).get(match[1], match[1])
            groups.setdefault((rank or 0, words[: match.start()] + "base_acc_"), {})[f"base_acc_{component}"] = name
        if rank is None or _NO_POSE & set(parts):
            continue
        for pattern, prefix in ((_ORIENTATION_NAME, "base_q"), (_POSITION_NAME, "base_")):
            if match := pattern.search(words):
                component = dict(zip("012", "xyz", strict=True)).get(match[1], match[1])
                groups.setdefault((rank, words[: match.start()] + prefix), {})[f"{prefix}{component}"] = name
                break
    pose: dict[str, str] = {}
    for _, group in sorted(groups.items(), key=lambda item: item[0][0], reverse=True):
        # The most usual name is put last, so that it stands where several would do; half a group says nothing.
        if len(group) == (4 if "base_qx" in group else 3):
            pose |= group
    known = (*POSITION, *QUATERNION, *ACCELERATION)
    pose |= {ours: source for ours, source in metadata.columns.items() if ours in known}
    # The position is differentiated twice; the accelerometer's bias and place add to it, so that it comes second.
    has_position = "base_x" in pose
    return {ours: source for ours, source in pose.items() if not has_position or ours not in ACCELERATION}


class BasePoseSource(FileSource):
    """A file with the pose of the base under our names: q_base_x, …, and angles made of its quaternion.

    Parameters
    ----------
    source : FileSource
        The user's file.
    columns : mapping of str to str
        Its columns by the names of `find_base_columns`; all four of the quaternion, or none; an accelerometer's with
        these alone.
    clock : (str, float)
        Column of the time and its factor to s, for an accelerometer.
    """

    def __init__(self, source: FileSource, columns: Mapping[str, str], clock: tuple[str, float] = ("t", 1.0)) -> None:
        self._source, self._clock = source, clock
        self._quaternion = [columns[name] for name in QUATERNION if name in columns]
        self._accelerometer = [columns[name] for name in ACCELERATION if name in columns]
        self._positions = {f"q_{name}": columns[name] for name in POSITION if name in columns}
        self._integrals = [f"q_{name}" for name in POSITION] if self._accelerometer else []
        self._angles = [f"q_{name}" for name in _ANGLES] if self._quaternion else []
        super().__init__([*source.names, *self._positions, *self._integrals, *self._angles], source.units)
        self.sample_rows, self.texts = source.sample_rows, source.texts
        self.has_gaps, self.inner, self.clocks = source.has_gaps, source, source.clocks
        of_pose = (*self._positions.values(), *self._accelerometer, *self._quaternion)
        self.own_remarks = (f"The pose of the base is {', '.join(of_pose)}.",)

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        turned = any(name in self._angles for name in columns)
        moved = any(name in self._integrals for name in columns)
        own = [name for name in columns if name not in (*self._angles, *self._integrals)]
        needed = [self._positions.get(name, name) for name in own]
        needed += self._quaternion if turned or moved else []
        needed += [*self._accelerometer, self._clock[0]] if moved else []
        last, place, first_row = np.full(len(_ANGLES), np.nan), _DoubleIntegral(), 0
        for batch in self._source.batches(list(dict.fromkeys(needed))):
            values = {name: batch.column(self._positions.get(name, name)) for name in own}

            def read(names: Sequence[str], batch: pa.RecordBatch = batch, row: int = first_row) -> FloatArray:
                return np.column_stack([to_float_column(batch, name, row) for name in names])

            if turned:
                angles = _unwrap(compute_base_angles(read(self._quaternion)), last)
                values |= {name: from_numbers(angles[:, k]) for k, name in enumerate(self._angles)}
            if moved:
                force = _turn(read(self._quaternion), read(self._accelerometer))
                positions = place.extend(self._clock[1] * read([self._clock[0]])[:, 0], force + _GRAVITY)
                values |= {name: from_numbers(positions[:, k]) for k, name in enumerate(self._integrals)}
            yield pa.RecordBatch.from_arrays([values[name] for name in columns], names=columns)
            first_row += batch.num_rows


class _DoubleIntegral:
    """The place that an acceleration leads to, block by block. It drifts, but only its second derivative is used."""

    def __init__(self) -> None:
        self._t, self._a = np.zeros(0), np.zeros((0, 3))
        self._v, self._p = np.zeros(3), np.zeros(3)

    def extend(self, t: FloatArray, acceleration: FloatArray) -> FloatArray:
        """Return the places (m, 3) at times t (m,) of accelerations (m, 3), which are linear between the rows."""
        missing = np.asarray(~np.isfinite(acceleration).all(axis=1))
        a = np.concatenate([self._a, np.where(missing[:, None], 0.0, acceleration)])
        times = np.concatenate([self._t, t])
        # A new run of the file begins where it stands.
        step = np.diff(times)
        step = np.where(np.isfinite(step) & (step > 0.0) & (step < 1.0), step, 0.0)[:, None]
        v = self._v + np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * step * (a[1:] + a[:-1]), axis=0)])
        way = step * v[:-1] + step**2 * (2.0 * a[:-1] + a[1:]) / 6.0
        p = self._p + np.concatenate([np.zeros((1, 3)), np.cumsum(way, axis=0)])
        new: FloatArray = p[len(self._t) :].copy()
        self._t, self._a, self._v, self._p = times[-1:], a[-1:], v[-1], p[-1]
        new[missing] = np.nan
        return new


def _turn(quaternion: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return vectors (m, 3) in the world that quaternions (m, 4: x, y, z, w) turn their frame into."""
    with np.errstate(invalid="ignore", divide="ignore"):
        unit = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
    axis, w = unit[:, :3], unit[:, 3:]
    across = np.cross(axis, vectors)
    return np.asarray(vectors + 2.0 * (w * across + np.cross(axis, across)))


def compute_base_angles(quaternion: FloatArray) -> FloatArray:
    """Return the angles of a frame.

    Parameters
    ----------
    quaternion : (m, 4)
        Its orientation, x, y, z, w; of any length.

    Returns
    -------
    (m, 3)
        Yaw, pitch and roll in rad, R = Rz(yaw) Ry(pitch) Rx(roll); NaN where the quaternion is zero or no number, and
        where the pitch is beyond `STEEPEST`.
    """
    x, y, z, w = quaternion.T
    square = x * x + y * y + z * z + w * w
    with np.errstate(invalid="ignore", divide="ignore"):
        pitch = np.arcsin(np.clip(2.0 * (w * y - z * x) / square, -1.0, 1.0))
        yaw = np.arctan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
        roll = np.arctan2(2.0 * (w * x + y * z), w * w - x * x - y * y + z * z)
        angles = np.column_stack([yaw, pitch, roll])
        # Logs of a state estimator begin with zeros until it runs.
        angles[~(square > 0) | ~(np.abs(pitch) <= STEEPEST)] = np.nan
    return angles


def _unwrap(angles: FloatArray, last: FloatArray) -> FloatArray:
    """Return angles (m, k) without jumps of a turn, going on from `last` (k,), which becomes the last angle."""
    out = angles.copy()
    for k in range(angles.shape[1]):
        finite = np.flatnonzero(np.isfinite(angles[:, k]))
        if not len(finite):
            continue
        values = angles[finite, k]
        before = values[:1] if np.isnan(last[k]) else last[k : k + 1]
        out[finite, k] = np.unwrap(np.concatenate([before, values]))[1:]
        last[k] = out[finite[-1], k]
    return out


def add_base_pose(source: FileSource, joints: RecordedJoints, metadata: RecordingMetadata) -> FileSource:
    """Return a file with the angles of the base where the robot's base moves and the file has its quaternion.

    Parameters
    ----------
    source : FileSource
        The user's file.
    joints : RecordedJoints
        The robot's joints, with the number of the base's coordinates.
    metadata : RecordingMetadata
        What the user says of the columns.

    Returns
    -------
    FileSource
        The same object where nothing is to be added.

    Raises
    ------
    RecordingError
        If the base moves and the file has neither its quaternion nor its angles.
    """
    if not joints.n_base:
        return source
    columns = find_base_columns(source.names, metadata)
    angles = [name for name in _ANGLES if name in joints.names[: joints.n_base]]
    stated = {*source.names, *metadata.columns}
    if all(name in columns for name in QUATERNION):
        return BasePoseSource(source, columns, _find_clock(metadata))
    if all(name in stated or f"q_{name}" in stated for name in angles):
        return BasePoseSource(source, {name: own for name, own in columns.items() if name in POSITION})
    raise RecordingError(
        f"The base of this robot moves, but its orientation is not in the file, which has: "
        f"{', '.join(source.names[:40])}. Name the columns of its unit quaternion, {', '.join(QUATERNION)}, or of its "
        f"angles, {', '.join(angles)}, by columns.",
        pointer="/columns/base_qx",
        title="Missing column",
    )


def _find_clock(metadata: RecordingMetadata) -> tuple[str, float]:
    unit, key = find_unit(metadata.units, "t", ("t",))
    return metadata.columns.get("t", "t"), find_conversion("t", None, unit, key)[0]


@dataclass(frozen=True)
class Reaction:
    """A measured wrench of the surroundings on a link.

    Parameters
    ----------
    link : str
        Name of the link.
    in_world : bool
        Whether it is measured along the axes of the world about its origin, as by a force plate; else along those of
        the link's frame, about its origin.
    columns : tuple of Column
        Force (N), then moment (N m).
    """

    link: str
    in_world: bool
    columns: tuple[Column, ...]


def find_reactions(names: Sequence[str], joints: RecordedJoints, metadata: RecordingMetadata) -> tuple[Reaction, ...]:
    """Return the wrenches on links that a file holds.

    Parameters
    ----------
    names : sequence of str
        The file's columns: <link>_fx … <link>_mz, or world_<link>_fx … world_<link>_mz; base_fx … base_mz are those of
        the root link.
    joints : RecordedJoints
        The robot's joints and links.
    metadata : RecordingMetadata
        What the user says of columns and units.

    Raises
    ------
    RecordingError
        Where some components of a wrench are missing.
    """
    if not joints.n_base:
        return ()
    reactions = []
    for link in joints.links:
        # The root link is called base, too: once, and unless another link has that name.
        is_base = link == joints.links[0] and "base" not in joints.links
        names_of_link = ("base", link) if is_base else (link,)
        for in_world in (False, True):
            for name in names_of_link:
                ours = [f"{'world_' if in_world else ''}{name}_{component}" for component in COMPONENTS]
                sources = [metadata.columns.get(column, column if column in names else None) for column in ours]
                absent = [column for column, source in zip(ours, sources, strict=True) if source is None]
                if 0 < len(absent) < len(ours):
                    raise RecordingError(
                        f"The wrench on {link} is incomplete; missing columns: {', '.join(absent)}. Give all of "
                        f"{', '.join(ours)}, or none.",
                        pointer=f"/columns/{absent[0]}",
                        title="Missing column",
                    )
                if not absent:
                    columns = tuple(
                        _convert(column, str(source), metadata.units)
                        for column, source in zip(ours, sources, strict=True)
                    )
                    reactions.append(Reaction(link, in_world, columns))
    return tuple(reactions)


def _convert(ours: str, source: str, units: Mapping[str, str]) -> Column:
    kind = "base_force" if ours[-2] == "f" else "base_moment"
    unit, key = find_unit(units, kind, (ours,))
    return Column(source, *find_conversion(kind, None, unit, key))


@dataclass(frozen=True)
class _WithReactions(Layout):
    """A layout with further columns behind its own."""

    further: tuple[Column, ...] = ()

    @property
    def columns(self) -> tuple[Column, ...]:
        """The columns of all signals, then the further ones."""
        return (*super().columns, *self.further)


class ReactionSource:
    """A file whose torques contain what measured wrenches on links do: τ + Σ Jᵀw.

    Parameters
    ----------
    source : RawSource
        The file.
    reactions : sequence of Reaction
        The wrenches.
    joints : RecordedJoints
        The robot's joints, which project wrenches.
    """

    def __init__(self, source: RawSource, reactions: Sequence[Reaction], joints: RecordedJoints) -> None:
        self._source, self._reactions, self._joints = source, reactions, joints

    def times(self, layout: Layout) -> Iterator[RawRows]:
        """Yield t and segment alone; values are empty."""
        return self._source.times(layout)

    def rows(self, layout: Layout) -> Iterator[RawRows]:
        """Yield everything that the layout names."""
        project, without_contacts = self._joints.project_wrench, self._joints.project_contacts
        assert project is not None
        further = tuple(column for reaction in self._reactions for column in reaction.columns)
        extended = _WithReactions(**vars(layout), further=further)
        width = len(layout.columns)
        q, tau = layout.columns_of_kind("q"), layout.columns_of_kind("tau")
        for rows in self._source.rows(extended):
            values = rows.values[:, :width].copy()
            for k, reaction in enumerate(self._reactions):
                wrench = rows.values[:, width + 6 * k : width + 6 * k + 6]
                values[:, tau] += project(reaction.link, values[:, q], wrench, reaction.in_world)
            if without_contacts is not None:
                self._check_torques(layout, values[:, q])
                values[:, tau] = without_contacts(values[:, q], values[:, tau])
            yield rows._replace(values=values)

    def _check_torques(self, layout: Layout, q: FloatArray) -> None:
        """Refuse joints without a torque between contacts and the base: the projection needs the torques of all."""
        project = self._joints.project_contacts
        for joint in layout.without_torque:
            alone = np.zeros((len(q), self._joints.n))
            alone[:, joint] = 1.0
            if project is not None and (np.abs(project(q, alone) - alone) > _MIXED).any():
                raise RecordingError(
                    f"There is no torque of {self._joints.names[joint]}, but it holds the robot on its contacts: "
                    "unknown forces there are eliminated by the torques of all joints that move these links. Give the "
                    "torque, or the wrenches on the links in place of contacts.",
                    pointer=f"/columns/tau{joint + 1 - self._joints.n_base}",
                    title="Missing column",
                )


def report_base(joints: RecordedJoints, reactions: Sequence[Reaction]) -> tuple[Check, ...]:
    """Return what acts on the base by the columns of the file; nothing for a fixed base."""
    if not joints.n_base:
        return ()
    if joints.project_contacts is not None:
        detail = "The unknown forces of the contacts are eliminated: torques and equations are projected."
        return (Check("base_forces", "ok", detail),)
    if not reactions:
        detail = (
            "The file has no wrench of the surroundings on a link (columns <link>_fx … <link>_mz): it is read as that "
            "of a robot that nothing touches."
        )
        return (Check("base_forces", "ok", detail),)
    parts = (f"{reaction.link} ({'world' if reaction.in_world else 'link'} frame)" for reaction in reactions)
    sentence = f"The surroundings act on {', '.join(parts)}, as measured, and on nothing else."
    links = [reaction.link for reaction in reactions]
    twice = sorted({link for link in links if links.count(link) > 1})
    if twice:
        sentence += (
            f" The file has several wrenches on {', '.join(twice)}, and their sum is taken: if they are the same one, "
            "such as in another frame, leave it out."
        )
    return (Check("base_forces", "warning" if twice else "ok", sentence),)


_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")
_EXTERNAL_AXIS = re.compile(r"\b(?:ext(?:ernal)? ?(?:axis|axes|joints?)|ei pos|rail|track|linear (?:unit|axis))\b")
"""What loggers call an axis that carries a robot, in words of small letters; EIPos is KUKA's."""
_NUMBERED_AXIS = re.compile(r"(?<![^\W_])E[1-6](?![^\W_])")
"""What controllers call it beside joints A1, A2, … or J1, J2, …; e1, e2, … are the errors of a controller."""
_NO_AXIS_POSITION = frozenset(
    {"torque", "torques", "trq", "tau", "effort", "force", "moment", "load", "current", "cur", "temperature", "temp"}
    | {"error", "errors", "err", "velocity", "vel", "speed", "acceleration", "acc"}
)
_MOVES = 20.0
"""Steps from row to row that an axis at rest stays within."""


def _find_external_axes(names: Sequence[str], layout: Layout) -> list[str]:
    """Return the columns that are positions of external axes by their names, and that no joint uses."""
    used = {column.source for column in (*layout.q, *layout.tau)}
    words = {name: [word.casefold() for word in _WORD.findall(name)] for name in {*names, *used}}
    is_named = {name: _EXTERNAL_AXIS.search(" ".join(own)) is not None for name, own in words.items()}
    # Where a joint of the robot is such an axis, further columns of that name are other signals of it.
    has_axis = any(is_named[column.source] for column in layout.q)
    axes = []
    for name in names:
        if name in used or _NO_AXIS_POSITION & set(words[name]):
            continue
        place = _NUMBERED_AXIS.search(name)
        joint = place and re.compile(re.escape(name[: place.start()]) + r"[AJ]\d")
        if (is_named[name] and not has_axis) or (joint and any(joint.match(column.source) for column in layout.q)):
            axes.append(name)
    return axes


def report_external_axes(file: FileSource, layout: Layout) -> tuple[Check, ...]:
    """Return a warning of the external axes in the file that move, and that the robot has no joint for."""
    names = _find_external_axes(file.names, layout)
    if not names:
        return ()
    axes = Layout(layout.t, None, tuple(Column(name) for name in names), ())
    columns = np.concatenate([rows.values for rows in file.rows(axes)]).T
    travels = {}
    for name, column in zip(names, columns, strict=True):
        values = column[np.isfinite(column)]
        if len(values) > 1 and np.ptp(values) > _MOVES * np.sqrt(np.mean(np.diff(values) ** 2)):
            travels[name] = f"{name} moves by {np.ptp(values):.4g} {file.units.get(name, 'in its own unit')}"
    if not travels:
        return ()
    detail = (
        f"{', '.join(travels.values())}, and the description has no such joint. If it carries the robot, its "
        "acceleration acts on all joints and no effect of the arm explains it: put a sliding joint under the base of "
        "the description, or record with that axis at rest."
    )
    return (Check("joint_columns", "warning", detail, column=next(iter(travels))),)
