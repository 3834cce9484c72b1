"""Motion of a base that moves, and forces on the robot from outside: from columns of a file to coordinates and torques.

A file states the pose of the base by its position and a unit quaternion. The quaternion becomes the angles yaw, pitch
and roll, R = Rz Ry Rx, which are singular at a pitch of 90°: rows near it are left out (`STEEPEST`). In place of a
position, an accelerometer is integrated twice: the equations contain only the acceleration of the base. Its bias is
found by what cannot be: a base that is held does not become ever faster.

Measured wrenches of the surroundings on links, as of foot sensors and force plates, are torques Jᵀw of all joints that
move the link, those of the base among them. They are added to what the motors give: W χ = τ + Σ Jᵀw.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pyarrow as pa

from dynident.array_types import FloatArray
from dynident.recordings.arrow_tables import from_numbers
from dynident.recordings.columns_to_signals import Column, Layout
from dynident.recordings.conditioning.angle_wrapping import (
    compute_base_angles,
    compute_quaternion,
    compute_rotation,
    unwrap_on,
)
from dynident.recordings.file_source import FileSource, RawRows, RawSource, to_float_column
from dynident.recordings.recording import JointLimits, RecordedJoints
from dynident.recordings.recording_metadata import RecordingError, RecordingMetadata
from dynident.recordings.units import find_conversion, find_unit

_MIXED = 1e-9
"""Share of a joint's torque in the projected equations of others from which on they count as mixed."""
_ANGLES = ("base_yaw", "base_pitch", "base_roll")
POSITION = ("base_x", "base_y", "base_z")
QUATERNION = ("base_qx", "base_qy", "base_qz", "base_qw")
ACCELERATION = ("base_acc_x", "base_acc_y", "base_acc_z")
"""What an accelerometer at the origin of the root link measures along its axes, m/s²: 9.81 upwards at rest."""
_SENSORS = ("odom", "odometry", "mocap", "imu", "accelerometer")
_BODIES = ("base", "root", "pelvis", "trunk", "torso", "body", "floating", *_SENSORS)
"""Words by which loggers call the base, the most usual first; those of sensors only where no other part is named."""
_OF_NO_PART = frozenset(
    {"data", "raw", "filtered", "measured", "main", "state", "states", "lowstate", "low", "msg", "message", "topic"}
    | {"sensor", "sensors", "robot", "pose", "link", "joint", "frame", "base", "root", "floating", *_SENSORS}
)
"""Words that name no part of a robot beside its base."""
_NO_POSE = frozenset(
    {"vel", "velocity", "lin", "linear", "ang", "angular", "twist", "omega", "gyro", "acc", "accel", "acceleration"}
    | {"rate", "force", "torque", "wrench", "cmd", "command", "desired", "target", "ref", "covariance"}
    | {"accelerometer", "gyroscope", "magnetometer", "mag"}
)
"""Words of names that are no pose, or none that was measured."""
_ACCELERATION = r"_?(?:lin_|linear_)?(?:acc|accel|acceleration|accelerometer)"
_ACCELERATION_NAME = re.compile(_ACCELERATION + r"_?([xyz]|[012])(?:_g|_m_s_?2?)?$")
_IN_G = re.compile(r"[^a-z0-9]g[^a-z0-9]*$")
_LINEAR = frozenset({"lin", "linear", "acc", "accel", "acceleration", "accelerometer"})
_GRAVITY = np.array([0.0, 0.0, -9.81])
_G = 9.80665
_LARGEST_BIAS, _GAINED = 1.0, 2.0
"""m/s², which no accelerometer in use has, and m/s by which a base may be faster at the end."""
_TURNED = 0.3
"""Mean of a rotation, as a singular value, below which a bias along that axis has no mean in the world."""
_POSITION_NAME = re.compile(r"_(?:pos|position|p|translation|xyz)?_?([xyz]|[012])$")
_ORIENTATION_NAME = re.compile(r"_(?:quat|quaternion|orientation|ori|rot|rotation|q)_?([xyzw])$")
COMPONENTS = ("fx", "fy", "fz", "mx", "my", "mz")


def _split_name(name: str) -> str:
    return re.sub(r"[^a-z0-9]+", "_", name.casefold()).strip("_")


def find_base_columns(
    names: Sequence[str], metadata: RecordingMetadata, joints: RecordedJoints | None = None
) -> dict[str, str]:
    """Return the columns of a file that state the pose of the base.

    Parameters
    ----------
    names : sequence of str
        The file's columns.
    metadata : RecordingMetadata
        What the user says of the columns; it goes before what their names say.
    joints : RecordedJoints, optional
        The robot's joints and links: what has the name of another one is not the base's.

    Returns
    -------
    dict of str to str
        The file's column by ours: base_x, base_y, base_z, base_qx, base_qy, base_qz, base_qw, as far as they are known.
        Quaternions whose components are numbered are not guessed: the order of the components differs between loggers.
        Without a position, base_acc_x, base_acc_y and base_acc_z of an accelerometer; of several that are as likely,
        none.
    """
    others = _list_other_parts(joints)
    groups: dict[tuple[int, str], dict[str, str]] = {}
    for name in names:
        words = _split_name(name)
        parts = set(words.split("_"))
        patterns = [(_ORIENTATION_NAME, "base_q"), (_POSITION_NAME, "base_")] if not _NO_POSE & parts else []
        patterns += [(_ACCELERATION_NAME, "base_acc_")] if not (_NO_POSE - _LINEAR) & parts else []
        for pattern, prefix in patterns:
            if match := pattern.search(words):
                component = dict(zip("012", "xyz", strict=True)).get(match[1], match[1])
                ours = f"{prefix}{component}"
                if (rank := -1 if name == ours else _rank_body(parts, words[: match.start()], others)) is not None:
                    groups.setdefault((rank, words[: match.start()] + prefix), {})[ours] = name
                break
    pose: dict[str, str] = {}
    sensors = [rank for (rank, _), group in groups.items() if "base_acc_x" in group and len(group) == len(ACCELERATION)]
    for (rank, _), group in sorted(groups.items(), key=lambda item: item[0][0], reverse=True):
        # The most usual name is put last, so that it stands where several would do; half a group says nothing.
        is_one_of_several = "base_acc_x" in group and sensors.count(min(sensors, default=rank)) > 1
        if len(group) == (4 if "base_qx" in group else 3) and not is_one_of_several:
            pose |= group
    known = (*POSITION, *QUATERNION, *ACCELERATION)
    pose |= {ours: source for ours, source in metadata.columns.items() if ours in known}
    # The position is differentiated twice; the accelerometer's bias and place add to it, so that it comes second.
    has_position = "base_x" in pose
    return {ours: source for ours, source in pose.items() if not has_position or ours not in ACCELERATION}


def _list_other_parts(joints: RecordedJoints | None) -> set[str]:
    """Return the words of the names of links and joints, without those of the root link."""
    if joints is None:
        return set()
    root, *links = [set(_split_name(link).split("_")) for link in joints.links or ("base",)]
    names = (set(_split_name(name).split("_")) for name in joints.names[joints.n_base :])
    return set[str]().union(*links, *names) - root - _OF_NO_PART


def _rank_body(parts: set[str], before: str, others: set[str]) -> int | None:
    """Return the rank of the base's name among the words of a name, by those `before` the signal; else None."""
    rank = next((k for k, body in enumerate(_BODIES) if body in parts), None)
    words = {word for word in before.split("_") if word and not word.isdecimal()}
    # A sensor is the base's where nothing says that it is elsewhere: on a foot, in a hand.
    is_sensor = rank is not None and _BODIES[rank] in _SENSORS
    return None if words & others or (is_sensor and words - _OF_NO_PART) else rank


@dataclass(frozen=True)
class _Accelerometer:
    """Columns of an accelerometer, the m/s² of their unit, of the time, its s, and whether anything holds the base."""

    columns: tuple[str, ...]
    factor: float
    time: str
    seconds: float
    is_held: bool


class BasePoseSource(FileSource):
    """A file with the pose of the base under our names: q_base_x, …, and angles made of its quaternion.

    Parameters
    ----------
    source : FileSource
        The user's file.
    columns : mapping of str to str
        Its columns by the names of `find_base_columns`; all four of the quaternion, or none.
    turns : sequence of (str, float), optional
        Columns of yaw, pitch and roll where there is no quaternion, with the rad of their unit; "" for no turn.
    accelerometer : _Accelerometer, optional
        It is integrated in place of a position.
    """

    def __init__(
        self,
        source: FileSource,
        columns: Mapping[str, str],
        turns: Sequence[tuple[str, float]] = (),
        accelerometer: _Accelerometer | None = None,
    ) -> None:
        self._source, self._turns, self._accelerometer = source, turns, accelerometer
        self._quaternion = [columns[name] for name in QUATERNION if name in columns]
        self._positions = {f"q_{name}": columns[name] for name in POSITION if name in columns}
        self.integrals = [f"q_{name}" for name in POSITION] if accelerometer else []
        self._angles = [f"q_{name}" for name in _ANGLES] if self._quaternion else []
        super().__init__([*source.names, *self._positions, *self.integrals, *self._angles], source.units)
        self.sample_rows, self.texts = source.sample_rows, source.texts
        self.has_gaps, self.inner, self.clocks = source.has_gaps, source, source.clocks
        of_pose = (*self._positions.values(), *(accelerometer.columns if accelerometer else ()), *self._quaternion)
        self.own_remarks = (f"The pose of the base is {', '.join(of_pose)}.",) if of_pose else ()

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        turned = any(name in self._angles for name in columns)
        sensor = self._accelerometer if any(name in self.integrals for name in columns) else None
        own = [name for name in columns if name not in (*self._angles, *self.integrals)]
        needed = [self._positions.get(name, name) for name in own]
        needed += self._quaternion if turned else []
        needed += self._list_needed(sensor) if sensor else []
        bias = self._bias if sensor else np.zeros(3)
        last, place, first_row = np.full(len(_ANGLES), np.nan), _DoubleIntegral(3), 0
        for batch in self._source.batches(list(dict.fromkeys(needed))):
            values = {name: batch.column(self._positions.get(name, name)) for name in own}
            if turned:
                angles = unwrap_on(compute_base_angles(_read(batch, self._quaternion, first_row)), last)
                values |= {name: from_numbers(angles[:, k]) for k, name in enumerate(self._angles)}
            if sensor:
                t, turns, force = self._read_sensor(sensor, batch, first_row)
                _, _, positions = place.extend(t, np.einsum("mij,mj->mi", turns, force - bias) + _GRAVITY)
                values |= {name: from_numbers(positions[:, k]) for k, name in enumerate(self.integrals)}
            yield pa.RecordBatch.from_arrays([values[name] for name in columns], names=columns)
            first_row += batch.num_rows

    def _list_needed(self, sensor: _Accelerometer) -> list[str]:
        return [*self._quaternion, *(name for name, _ in self._turns if name), *sensor.columns, sensor.time]

    def _read_sensor(
        self, sensor: _Accelerometer, batch: pa.RecordBatch, row: int
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return times (m,) in s, rotations (m, 3, 3) into the world, and what was measured (m, 3) in m/s²."""
        force, t = _read(batch, sensor.columns, row), _read(batch, [sensor.time], row)[:, 0]
        if self._quaternion:
            quaternion = _read(batch, self._quaternion, row)
        else:
            turns = [_read(batch, [name], row)[:, 0] * size if name else np.zeros(len(t)) for name, size in self._turns]
            quaternion = compute_quaternion(*turns)
        return sensor.seconds * t, compute_rotation(quaternion), sensor.factor * force

    @cached_property
    def _bias(self) -> FloatArray:
        """What the accelerometer (3,) measures too much along its axes, as far as it would make a held base faster."""
        sensor, place, sums, row = self._accelerometer, _DoubleIntegral(12), np.zeros((2, 14)), 0
        if sensor is None or not sensor.is_held:
            return np.zeros(3)
        for batch in self._source.batches(self._list_needed(sensor)):
            t, turns, force = self._read_sensor(sensor, batch, row)
            acceleration = np.einsum("mij,mj->mi", turns, force) + _GRAVITY
            s, v, _ = place.extend(t, np.column_stack([acceleration, turns.reshape(-1, 9)]))
            sums += np.stack([np.ones(len(s)), s]) @ np.column_stack([np.ones(len(s)), s, v])
            row += batch.num_rows
        # Slopes of the lines through the velocities: means over time in which both ends, and swinging, hardly count.
        (n, first, *level), (_, second, *growth) = sums
        spread = n * second - first**2
        slopes = (n * np.array(growth) - first * np.array(level)) / spread if spread > 0.0 else np.zeros(12)
        _check_gravity(slopes[:3] - _GRAVITY, sensor, _LARGEST_BIAS + _GAINED / max(place.seconds, 1e-9))
        return np.asarray(np.linalg.lstsq(slopes[3:].reshape(3, 3), slopes[:3], rcond=_TURNED)[0])


def _read(batch: pa.RecordBatch, names: Sequence[str], row: int) -> FloatArray:
    return np.column_stack([to_float_column(batch, name, row) for name in names])


def _check_gravity(mean: FloatArray, sensor: _Accelerometer, tolerance: float) -> None:
    """Refuse an accelerometer whose mean (3,) along the axes of the world is not what holds a base up."""
    if np.linalg.norm(mean + _GRAVITY) <= tolerance:
        return
    values = f"{', '.join(sensor.columns)} are ({', '.join(f'{value:.2g}' for value in mean)}) m/s² in the mean along"
    values += " the axes of the world; of a base that is held, an accelerometer measures 9.81 upwards"
    record = "the position of the base (base_x, base_y, base_z)"
    if np.linalg.norm(mean + _GRAVITY / _G) < 0.1 * tolerance:
        advice = "they seem to be in g: write [g] behind the names of these columns"
    elif np.linalg.norm(mean) <= tolerance:
        advice = f"these are without gravity: record the raw accelerometer, or {record}"
    else:
        advice = f"record that of the root link along the axes of its frame, in m/s², or {record}"
    raise RecordingError(f"{values}: {advice}.", pointer="/columns/base_acc_x", title="Accelerometer of the base")


class _DoubleIntegral:
    """The place that an acceleration leads to, block by block. It drifts, but only its second derivative is used."""

    def __init__(self, width: int) -> None:
        self._t, self._a = np.zeros(0), np.zeros((0, width))
        self._v, self._p, self.seconds = np.zeros(width), np.zeros(width), 0.0

    def extend(self, t: FloatArray, acceleration: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return seconds passed (m,), velocities and places (m, c) of accelerations (m, c), linear between times t."""
        missing = np.asarray(~np.isfinite(acceleration).all(axis=1))
        a = np.concatenate([self._a, np.where(missing[:, None], 0.0, acceleration)])
        times = np.concatenate([self._t, t])
        # A new run of the file begins where it stands.
        step = np.diff(times)
        step = np.where(np.isfinite(step) & (step > 0.0) & (step < 1.0), step, 0.0)[:, None]

        def add(change: FloatArray) -> FloatArray:
            return np.concatenate([np.zeros((1, change.shape[1])), np.cumsum(change, axis=0)])

        s = self.seconds + add(step)[:, 0]
        v = self._v + add(0.5 * step * (a[1:] + a[:-1]))
        p = self._p + add(step * v[:-1] + step**2 * (2.0 * a[:-1] + a[1:]) / 6.0)
        new, places = slice(len(self._t), None), p[len(self._t) :].copy()
        self._t, self._a, self._v, self._p, self.seconds = times[-1:], a[-1:], v[-1], p[-1], float(s[-1])
        places[missing] = np.nan
        return s[new], v[new], places


def exempt_integrals(limits: Sequence[JointLimits], layout: Layout, file: FileSource) -> tuple[JointLimits, ...]:
    """Return limits without those of positions that were integrated: these drift, and say nothing of units."""
    integrals = file.integrals if isinstance(file, BasePoseSource) else ()
    return tuple(
        replace(limit, position=None, velocity=np.inf) if column.source in integrals else limit
        for limit, column in zip(limits, layout.q, strict=True)
    )


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
    columns = find_base_columns(source.names, metadata, joints)
    angles = [name for name in _ANGLES if name in joints.names[: joints.n_base]]
    stated = {*source.names, *metadata.columns}
    sensor = _find_accelerometer(source, columns, joints, metadata)
    if all(name in columns for name in QUATERNION):
        return BasePoseSource(source, columns, (), sensor)
    if all(name in stated or f"q_{name}" in stated for name in angles):
        positions = {name: own for name, own in columns.items() if name in POSITION}
        turns = [_find_angle(source, name, metadata) if name in angles else ("", 1.0) for name in _ANGLES]
        return BasePoseSource(source, positions, turns, sensor)
    raise RecordingError(
        f"The base of this robot moves, but its orientation is not in the file, which has: "
        f"{', '.join(source.names[:40])}. Name the columns of its unit quaternion, {', '.join(QUATERNION)}, or of its "
        f"angles, {', '.join(angles)}, by columns.",
        pointer="/columns/base_qx",
        title="Missing column",
    )


def _find_angle(source: FileSource, name: str, metadata: RecordingMetadata) -> tuple[str, float]:
    """Return the column of an angle of the base, and the rad of its unit."""
    ours = (f"q_{name}", name)
    unit, key = find_unit(metadata.units, "", ours)
    column = next((metadata.columns[each] for each in ours if each in metadata.columns), None)
    return column or next(each for each in ours if each in source.names), find_conversion("q", "revolute", unit, key)[0]


def _find_accelerometer(
    source: FileSource, columns: Mapping[str, str], joints: RecordedJoints, metadata: RecordingMetadata
) -> _Accelerometer | None:
    names = tuple(columns[name] for name in ACCELERATION if name in columns)
    if len(names) < len(ACCELERATION):
        return None
    unit, key = find_unit(metadata.units, "t", ("t",))
    in_g = all(source.units.get(name) == "g" or _IN_G.search(name.casefold()) for name in names)
    is_held = joints.project_contacts is not None or bool(find_reactions(source.names, joints, metadata))
    seconds = find_conversion("t", None, unit, key)[0]
    return _Accelerometer(names, _G if in_g else 1.0, metadata.columns.get("t", "t"), seconds, is_held)


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
