"""Assign a file's columns to signals of joints, by names and metadata, with conversion to SI units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynident.array_types import FloatArray, IntArray
from dynident.errors import Remedy
from dynident.recordings.metadata_revisions import ColumnArrangement
from dynident.recordings.recording import WRENCH_NAMES, JointKind, RecordedJoints
from dynident.recordings.recording_metadata import UNKNOWN_COLUMNS, Check, RecordingError, RecordingMetadata
from dynident.recordings.units import JOINT_KINDS, KINDS, find_conversion, find_unit

NOT_RECORDED = "none"
"""What the torque of a joint is mapped to that was not recorded."""


@dataclass(frozen=True)
class Column:
    """One column of the file, and its conversion: ours = factor x theirs + offset.

    Parameters
    ----------
    source : str
        The file's name of the column.
    factor : float
        Factor to our unit, with sign, scale and drive gain.
    offset : float
        What is added after the factor, in our unit.
    """

    source: str
    factor: float = 1.0
    offset: float = 0.0

    def convert(self, values: FloatArray) -> FloatArray:
        """Return the values in SI units (temperature in degC)."""
        # Most columns are in SI units already: these are not copied.
        if self.factor == 1.0 and self.offset == 0.0:
            return values
        return values * self.factor + self.offset


@dataclass(frozen=True)
class Layout:
    """The columns that are read: one of q and tau per joint, the optional kinds for all joints or for none.

    Parameters
    ----------
    t : Column
        The time.
    segment : Column or None
        Numbers that tell runs apart.
    q, tau : tuple of Column
        Positions and torques of the n joints.
    dq, ddq, q_command, temperature : tuple of Column
        Optional signals of the n joints; empty if there are none.
    wrench : tuple of Column
        The six columns of the base's reaction; empty if there are none.
    mixing : (n, n), optional
        What the columns of tau are multiplied by from the right, where motors act on several joints.
    without_torque : tuple of int
        Indices of the joints whose torque was not recorded; it is read as zero.
    n_base : int
        Number of leading joints that are coordinates of the base, which have no torque of their own.
    servo_gains : (n,), optional
        Torque of position servos over their position error, N m/rad or N/m; the columns of tau are then commands.
    """

    t: Column
    segment: Column | None
    q: tuple[Column, ...]
    tau: tuple[Column, ...]
    dq: tuple[Column, ...] = ()
    ddq: tuple[Column, ...] = ()
    q_command: tuple[Column, ...] = ()
    temperature: tuple[Column, ...] = ()
    wrench: tuple[Column, ...] = ()
    mixing: FloatArray | None = None
    without_torque: tuple[int, ...] = ()
    n_base: int = 0
    servo_gains: FloatArray | None = None

    @property
    def kinds(self) -> tuple[str, ...]:
        """The kinds of signals that are stored, in the order of their columns."""
        optional = tuple(kind for kind in ("dq", "ddq", "q_command", "wrench", "temperature") if getattr(self, kind))
        return ("q", "tau", *optional)

    @property
    def columns(self) -> tuple[Column, ...]:
        """The columns of all signals, kind by kind."""
        return tuple(column for kind in self.kinds for column in getattr(self, kind))

    @property
    def needed_columns(self) -> IntArray:
        """Which of `columns` have to hold a number in every row: q, tau and the wrench."""
        needed = [kind in ("q", "tau", "wrench") for kind in self.kinds for _ in getattr(self, kind)]
        return np.flatnonzero(needed)

    @property
    def has_own_torque_columns(self) -> bool:
        """Whether each torque is a column of the file, times a factor, and not made of several columns."""
        return self.mixing is None and self.servo_gains is None

    def make_torques(self, values: FloatArray) -> None:
        """Make torques of the joints of the columns of tau, in place, where these are something else.

        Parameters
        ----------
        values : (m, c)
            All columns of the layout.
        """
        rows = values[:, self.columns_of_kind("tau")]
        if self.mixing is not None:
            # Motors that act on several joints: their torques are turned into the joints' torques row by row.
            rows = rows @ self.mixing
        if self.servo_gains is not None:
            rows = self.servo_gains * compute_servo_error(rows, values[:, self.columns_of_kind("q")])
        values[:, self.columns_of_kind("tau")] = rows

    def columns_of_kind(self, kind: str) -> slice:
        """Return the slice of a kind's columns among all; empty if there are none."""
        first = 0
        for other in self.kinds:
            if other == kind:
                break
            first += len(getattr(self, other))
        return slice(first, first + len(getattr(self, kind)))


def compute_servo_error(command: FloatArray, position: FloatArray) -> FloatArray:
    """Return what positions in rad or m are behind their commands.

    Parameters
    ----------
    command, position : (m, ...)
        Positions that servos are to take, and those that they have.
    """
    # No joint is half a turn behind: there, one of the two angles has begun a new turn.
    with np.errstate(invalid="ignore"):
        return np.asarray(np.remainder(command - position + np.pi, 2.0 * np.pi) - np.pi)


def find_columns(
    names: Sequence[str],
    joints: RecordedJoints,
    metadata: RecordingMetadata,
) -> tuple[Layout, Check]:
    """Match a file's columns with the robot's joints.

    Parameters
    ----------
    names : sequence of str
        The file's columns.
    joints : RecordedJoints
        Joint torque = gain x current [12.17]; a gain is needed only where a joint has no torque column. With motor
        torques τ (gain x current) the joints' are couplingᵀ τ; torque columns are joint torques.
    metadata : RecordingMetadata
        What the user says of the file, of which `columns`, `units`, `permutation`, `signs`, `scale` and `zeros` are
        used.

    Returns
    -------
    layout : Layout
        The columns of all signals, with their conversion to SI.
    check : Check
        Says what torque is made from.

    Raises
    ------
    RecordingError
        For a missing column, a missing drive gain, an unknown unit or a mapping to a column that is not there.
    """
    finder = _ColumnFinder(names, joints, metadata)
    n, gains, coupling = joints.n, joints.known_gains, joints.coupling
    tau, from_current, unused, without_torque = [], list[str](), list[str](), list[int]()
    mixing = np.eye(n)
    servo_gains = np.zeros(n) if metadata.effort_kind == "position_command" else None
    for joint in range(n):
        # Nothing acts on the base but what measured wrenches add.
        is_free = joint < joints.n_base and finder.find("tau", joint) is None
        if is_free or finder.has_no_torque(joint):
            tau.append(mark_not_recorded(finder.find_needed("q", joint)))
            without_torque += [] if is_free else [joint]
            continue
        if servo_gains is not None:
            tau.append(finder.find_needed("q_command", joint))
            gain = _require_gain(f"{tau[-1].source} is a command", joints.names[joint], gains[joint], "N m/rad")
            servo_gains[joint] = gain * finder.arrangement.factor("tau", joint)
            continue
        torque, current = finder.find("tau", joint), finder.find("current", joint)
        if metadata.effort_kind == "motor_current":
            # The user knows better than the name of a column what is in it.
            torque, current = None, current or torque
        # A torque that the file holds goes before one that is computed from the current.
        if torque is not None:
            tau.append(torque)
            unused += [current.source] if current is not None else []
        elif current is not None:
            tau.append(_convert_current(current, joints.names[joint], gains[joint]))
            from_current.append(current.source)
            if coupling is not None:
                # Only motor torques are mixed: a column of joint torque stays as it is (a row of the identity).
                mixing[joint] = coupling[joint]
        else:
            raise finder.missing_column_error(
                "tau", joint, f", and no current {_name_alternatives('current', joints, joint)} instead"
            )
    layout = Layout(
        t=finder.find_needed("t", None),
        segment=finder.find_plain("segment"),
        q=tuple(finder.find_needed("q", joint) for joint in range(n)),
        tau=tuple(tau),
        dq=finder.find_all("dq"),
        ddq=finder.find_all("ddq"),
        q_command=finder.find_all("q_command"),
        temperature=finder.find_all("temperature"),
        # Of a base that moves, the wrench is one of several that links may have: `find_reactions`.
        wrench=() if joints.n_base else finder.find_wrench(),
        mixing=None if np.array_equal(mixing, np.eye(n)) else mixing,
        without_torque=tuple(without_torque),
        n_base=joints.n_base,
        servo_gains=servo_gains,
    )
    if servo_gains is not None:
        return layout, _report_servo_law([column.source for column in tau])
    return layout, _report_torque_source(from_current, unused, layout.mixing is not None)


def _require_gain(what: str, joint_name: str, gain: float | None, unit: str) -> float:
    if gain is None:
        remedy = Remedy("drives", {joint_name: {"drive_gain": ...}})
        raise RecordingError(
            f"Column {what}, and joint {joint_name} has no drive gain; give {remedy} in {unit}, or a torque column.",
            pointer=f"/drives/{joint_name}/drive_gain",
            title="Missing drive gain",
            remedies=(remedy,),
        )
    if not (np.isfinite(gain) and gain != 0.0):
        raise RecordingError(
            f"The drive gain of joint {joint_name} is {gain}; give a number other than 0.",
            pointer=f"/drives/{joint_name}/drive_gain",
            title="Missing drive gain",
        )
    return gain


def _convert_current(current: Column, joint_name: str, gain: float | None) -> Column:
    gain = _require_gain(f"{current.source} is a current", joint_name, gain, "N m/A")
    # The gain acts on the current in A: factor and offset of its unit come before it.
    return Column(current.source, current.factor * gain, current.offset * gain)


def mark_not_recorded(position: Column) -> Column:
    """Return the column of a torque that was not recorded: zero in every row that has the joint's position."""
    return Column(position.source, 0.0)


def check_surplus_columns(names: Sequence[str], n: int, metadata: RecordingMetadata) -> Check | None:
    """Check whether a file has columns of one more joint than the robot.

    Columns are counted in the robot's order: where it lacks a joint of the file that is not the last one, all joints
    behind it would be taken for others.

    Parameters
    ----------
    names : sequence of str
        The file's columns.
    n : int
        Number of the robot's joints.
    metadata : RecordingMetadata
        What the user says of the file.

    Returns
    -------
    Check or None
        A warning that names the columns; None if there are no more than the robot's.
    """
    mapped = {name.casefold() for name in metadata.columns.values()}
    unmapped = {name.casefold(): name for name in names if name.casefold() not in mapped}
    surplus = [unmapped[name] for name in (f"q{n + 1}", f"tau{n + 1}", f"current{n + 1}") if name in unmapped]
    # One such column alone may be anything; two of one number are a joint.
    if len(surplus) < 2:
        return None
    return Check(
        "joint_columns",
        "warning",
        f"The file has {' and '.join(surplus)}, but the robot has {n} joints: columns are matched to joints in the "
        "order of the robot, and the surplus columns are not used. If the joint that the robot does not have is not "
        "the last one of the file, map the columns of the other joints by columns.",
        column=surplus[0],
    )


def _report_servo_law(commands: list[str]) -> Check:
    return Check(
        "torque_source",
        "warning",
        f"The torque was not recorded: it is drive gain x (command - position) of position servos, with the commands "
        f"in {_shorten_names(commands)}. Viscous friction then includes the back-EMF of the motors; late commands "
        "and a D coefficient are in the drive inertia. Drive gains that are wrong by one factor make all masses and "
        "all friction wrong by it, and no error shows it. Heat, and a supply voltage that drops, change the gain.",
    )


def _report_torque_source(from_current: list[str], unused: list[str], coupled: bool) -> Check:
    """Say where the torque comes from; the check names the first column that a drive gain is used for."""
    detail = "The torque comes from the torque columns."
    if from_current:
        detail = f"Torque is drive gain x current [12.17] in {_shorten_names(from_current)}."
    if from_current and coupled:
        detail += " A motor that is coupled to several joints acts on all of them."
    ignored = f" Both torque and current are given: the current ({_shorten_names(unused)}) is not used."
    return Check("torque_source", "ok", detail + ignored if unused else detail, "".join(from_current[:1]))


def _shorten_names(names: list[str]) -> str:
    return ", ".join(names) if len(names) <= 3 else f"{names[0]} … {names[-1]}"


def _name_alternatives(kind: str, joints: RecordedJoints, joint: int) -> str:
    return " or ".join(joints.name_columns(kind, joint))


class _ColumnFinder:
    def __init__(self, names: Sequence[str], joints: RecordedJoints, metadata: RecordingMetadata) -> None:
        self.names = list(names)
        self.joints, self.joint_names = joints, joints.names
        self.limits = joints.known_limits
        self.metadata = metadata
        self.arrangement = ColumnArrangement(metadata, joints.names, joints.n_base)
        self._check_mapping()

    def find(self, kind: str, joint: int | None) -> Column | None:
        """Return the column of a signal of a joint (None: of a signal that belongs to no joint)."""
        source_joint = None if joint is None else self.arrangement.find_source_joint(kind, joint)
        ours = (kind,) if source_joint is None else self.joints.name_columns(kind, source_joint)
        source = self._find_source(ours)
        if source is None:
            return None
        joint_kind: JointKind | None = None if source_joint is None else self.limits[source_joint].kind
        # A unit of all positions is that of the joints: the pose of a base comes in m and as a quaternion.
        is_of_base = source_joint is not None and source_joint < self.joints.n_base
        unit, key = find_unit(self.metadata.units, "" if is_of_base else kind, ours)
        factor, offset = find_conversion(kind, joint_kind, unit, key)
        # Sign and scale act on the offset of a unit, too: they come after its conversion.
        times = 1.0 if joint is None else self.arrangement.factor(kind, joint)
        zero = 0.0 if joint is None else self.arrangement.zero(kind, joint)
        return Column(source, factor * times, offset * times - zero)

    def has_no_torque(self, joint: int) -> bool:
        """Return whether the user says that the torque of a joint was not recorded."""
        source_joint = self.arrangement.find_source_joint("tau", joint)
        ours = self.joints.name_columns("tau", source_joint)
        # A column of the file may have that word for its name: then the column is meant.
        return self._find_source(ours) == NOT_RECORDED and NOT_RECORDED not in self.names

    def find_needed(self, kind: str, joint: int | None) -> Column:
        """Return a column without which nothing can be read.

        Raises
        ------
        RecordingError
            Where the file lacks it.
        """
        column = self.find(kind, joint)
        if column is None:
            raise self.missing_column_error(kind, joint)
        return column

    def find_plain(self, name: str) -> Column | None:
        """Return a column that has no unit."""
        source = self._find_source((name,))
        return None if source is None else Column(source)

    def find_all(self, kind: str) -> tuple[Column, ...]:
        """Return the columns of an optional signal of every joint; none if one joint lacks it."""
        present = tuple(filter(None, (self.find(kind, joint) for joint in range(len(self.joint_names)))))
        return present if len(present) == len(self.joint_names) else ()

    def find_wrench(self) -> tuple[Column, ...]:
        """Return the six columns of the base's wrench; none if the file has none of them.

        Raises
        ------
        RecordingError
            Where there are some of them.
        """
        sources = [self._find_source((name,)) for name in WRENCH_NAMES]
        absent = [name for name, source in zip(WRENCH_NAMES, sources, strict=True) if source is None]
        if len(absent) == len(sources):
            return ()
        if absent:
            raise RecordingError(
                f"The wrench of the base is incomplete; missing columns: {', '.join(absent)}. Give all of "
                f"{', '.join(WRENCH_NAMES)}, or none.",
                pointer=f"/columns/{absent[0]}",
                title="Missing column",
            )
        columns = []
        for name, source in zip(WRENCH_NAMES, sources, strict=True):
            assert source is not None
            kind = "base_force" if name.startswith("base_f") else "base_moment"
            unit, key = find_unit(self.metadata.units, kind, (name,))
            columns.append(Column(source, *find_conversion(kind, None, unit, key)))
        return tuple(columns)

    def missing_column_error(self, kind: str, joint: int | None, instead: str = "") -> RecordingError:
        """Return the error for a missing column: which one, and what the file holds."""
        expected = kind if joint is None else _name_alternatives(kind, self.joints, joint)
        whose = "" if joint is None else f" of joint {self.joint_names[joint]}"
        signal = {"t": "the time", "q": "the position", "tau": "the torque"}.get(kind, kind)
        available = ", ".join(self.names[:40]) + (", …" if len(self.names) > 40 else "")
        ours, hint = kind if joint is None else self.joints.name_columns(kind, joint)[-1], ""
        from_zero = f"{kind}0" in self.names  # A usual name is then that of another joint.
        remedies = [Remedy("columns", {ours: "…"})]
        if kind == "t":
            remedies.append(Remedy("rate"))
            hint = f" If the file has no time, state {remedies[-1]} in Hz."
        elif kind in ("q", "tau") and not any(name.startswith(kind) for name in self.names):
            hint = " If it is in another file, give both files as one recording, a.csv+b.csv."
        if all(name == f"column{number}" for number, name in enumerate(self.names, start=1)):
            hint += " The file has no column names, so the columns are numbered here."
        elif from_zero:
            hint = f" Joints are counted from 1 here, but the file has {kind}0: map the columns."
        if kind == "tau" and joint is not None and self.find("q_command", joint) is not None:
            remedies.append(Remedy("effort_kind", "position_command"))
            hint += (
                f" If no torque was recorded and position servos follow the commands, state {remedies[-1]}, with drive "
                "gains in N m/rad."
            )
        advice, further = (".", ()) if joint is None else self._advise_without_column(kind, joint)
        names = {each.source for k in range(self.joints.n) if joint is not None and (each := self.find(kind, k))}
        return RecordingError(
            f"There is no column {expected} for {signal}{whose}{instead}. The file has: {available}. Name it by "
            f"{remedies[0]}{advice}{hint}",
            pointer=f"/columns/{ours}",
            title="Missing column" if names - {*self.metadata.columns.values()} and not from_zero else UNKNOWN_COLUMNS,
            remedies=(*remedies, *further),
        )

    def _advise_without_column(self, kind: str, joint: int) -> tuple[str, tuple[Remedy, ...]]:
        """Return the advice for a joint without such a column: it stands, or its torque was not recorded."""
        remedy = Remedy("locked_joints", {self.joint_names[joint]: 0})
        lock = f", or lock the joint if it does not move ({remedy})."
        others = (self.find(other, k) for other in ("tau", "current") for k in range(len(self.joint_names)))
        # Where no joint has a torque it is the kind of column that is missing, and not this joint's.
        if kind != "tau" or not any(others):
            return lock, (remedy,)
        mapping = Remedy("columns", {self.joints.name_columns("tau", joint)[-1]: NOT_RECORDED})
        sentence = f"{lock} If its torque was not recorded, state {mapping}; the motion of the joint is still used."
        return sentence, (remedy, mapping)

    def _find_source(self, ours: tuple[str, ...]) -> str | None:
        # The user's mapping goes before equal names, and these before names in other upper and lower case.
        for sources in (self.metadata.columns, {name: name for name in self.names}):
            for name in ours:
                if name in sources:
                    return sources[name]
        # In reverse: of names that differ in upper and lower case only, the first one is found.
        folded = {name.casefold(): name for name in reversed(self.names)}
        return next((folded[name.casefold()] for name in ours if name.casefold() in folded), None)

    def _check_mapping(self) -> None:
        our_names = {"t", "segment", *WRENCH_NAMES, *self.joints.further_columns}
        for kind in JOINT_KINDS:
            our_names |= {name for joint in range(self.joints.n) for name in self.joints.name_columns(kind, joint)}
        for ours, theirs in self.metadata.columns.items():
            if ours not in our_names:
                turned = (Remedy("columns", {theirs: ours}),) if theirs in our_names else ()
                raise RecordingError(
                    f"columns maps {ours!r}, which is not a standard column; "
                    f"{f'the standard name comes first: {turned[0]}; ' if turned else ''}standard columns are t, "
                    "segment, and q, q_command, dq, ddq, tau, current, temperature with a joint's number (q1) or name "
                    f"(q_{self.joint_names[0]}), and {', '.join(WRENCH_NAMES)}.",
                    pointer=f"/columns/{ours}",
                    title="Unknown column",
                    remedies=turned,
                )
            if theirs not in self.names and not (theirs == NOT_RECORDED and ours.startswith("tau")):
                raise RecordingError(
                    f"columns maps {ours} to {theirs!r}, which is not in the file; the file has: "
                    f"{', '.join(self.names[:40])}.",
                    pointer=f"/columns/{ours}",
                    title="Missing column",
                )
        for key in self.metadata.units:
            if key not in KINDS and key not in our_names:
                raise RecordingError(
                    f"units names {key!r}, neither a kind of signal ({', '.join(KINDS)}) nor a standard column (q1 …).",
                    pointer=f"/units/{key}",
                    title="Unknown unit",
                )
