"""Metadata of a recording, its revisions, and checks (`Check`) with their cures: types and request fields.

They are in one module because each needs the next: impossible metadata raise a `RecordingError`, which carries the
checks that led to it; a check carries the revision that would cure it; and a revision changes the metadata.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import partial
from math import isfinite
from typing import Any, Literal, TypedDict, get_args

from dynident.errors import DynidentError, Remedy
from dynident.schema.fields import Choice, OneOf, Request, declare_field, redeclare_field

Status = Literal["ok", "warning", "error"]
Windows = tuple[tuple[float, float], ...]
Format = Literal[
    "csv", "parquet", "feather", "jsonl", "npy", "npz", "mat", "hdf5", "rosbag", "rosbag2", "mcap", "rsi", "zip",
    "diadem",
]  # fmt: skip
Role = Literal["identification", "validation", "friction", "payload"]
ROLES = OneOf(
    Choice("identification", "identification"),
    Choice("validation", "validation (held out)"),
    Choice("friction", "friction"),
    Choice("payload", "payload"),
)
Axis = Literal["q", "tau"]
EffortKind = Literal[
    "motor_current",
    "motor_torque",
    "joint_torque",
    "position_command",
    "gravity_compensated",
    "external",
    "commanded",
    "unknown",
]
"""What "effort" is: a motor's current or torque, a joint's torque, a servo's command, or no measurement of it."""

EFFORT_KINDS = OneOf(
    Choice("motor_current", "current of the motors"),
    Choice("motor_torque", "torque of the motors"),
    Choice("joint_torque", "torque of the joints"),
    Choice("position_command", "not recorded: drive gain x (command - position) of position servos"),
    Choice("gravity_compensated", "torque without gravity: not a measurement"),
    Choice("external", "external torque: not a measurement"),
    Choice("commanded", "commanded torque: not a measurement"),
    Choice("unknown", "not known"),
)

ConditioningStep = Literal[
    "registers",
    "held_samples",
    "idle_drives",
    "frozen_signals",
    "corrupted_samples",
    "wrapped_angles",
    "full_duty",
]
"""What is put right in a recording unless it is said that it is right."""

DELAY = "torque_delay"
"""Name of the check, and of the field, that is about the torque's delay against the positions."""

COMMANDED = "commanded_torque"
"""Name of the check that finds a command instead of a measurement."""

NO_MEASUREMENT = {
    "gravity_compensated": "the gravity torque was subtracted from it, so it does not show the masses of the links",
    "external": "the torque of the robot's own dynamics was subtracted from it",
    "commanded": "a controller computed it; it is not the torque that the robot needed",
}
"""Kinds of torque that nothing can be identified from, and why."""


@dataclass(frozen=True)
class RecordingMetadata(Request):
    """What the user says about a file.

    Kinds of signals are "q", "q_command", "dq", "ddq", "tau", "current", "temperature", "base_force", "base_moment" and
    "t"; columns are ours ("q3", "q_elbow", "base_fx"). Columns and units are applied before the permutation, the signs
    and the scale.

    Parameters
    ----------
    name : str
        What the recording is called.
    format : str, optional
        Format of the file; told from its first bytes where not given.
    columns : mapping of str to str
        The file's name of a column by ours. A torque that was not recorded is the column "none".
    units : mapping of str to str
        Units by kind of signal or by column; SI where nothing is said, degC of temperatures. "counts:4096" are counts
        of an encoder, 4096 a turn, "counts:4096@2048" with zero at 2048.
    role : str, optional
        What the recording is for: identification, validation, friction or payload.
    windows : pairs (from, to)
        Seconds of t to use; empty: all of them.
    payload : mapping, optional
        The known load, kept as it came.
    torque_delay : float
        Seconds by which the torque of a row is read later than its positions.
    accept : tuple of str
        Names of checks whose errors count as warnings: the user knows better.
    skip : tuple of str
        Steps of conditioning that are not taken.
    permutation : mapping of str to tuple of int
        By "q" or "tau": at place k the number, from 1, of the column that is joint k's, such as {"tau": (2, 1, 3)}.
    signs : mapping of str to float
        Sign, 1 or -1, by which positions or torques are multiplied; "q2" or "q_<joint>" means one joint and "q" all of
        them.
    scale : mapping of str to float
        Positive factors of positions or torques, by the same keys.
    zeros : mapping of str to float
        Positions in rad or m, with signs and factors, at which the description has 0, by the same keys of positions.
    exclude : pairs (from, to)
        Seconds of t to leave out.
    effort_kind : str, optional
        What the torque or current columns hold (not `NO_MEASUREMENT`); "position_command": there are only commands.
    rate : float, optional
        Rows a second in Hz, evenly spaced, of a file without time.

    Raises
    ------
    RecordingError
        For a window or a delay that cannot be, or a torque that is said to be no measurement (`NO_MEASUREMENT`).
    """

    name: str = declare_field("Name of the recording", default="recording")
    format: Format | None = declare_field("Detected from the file if not given", default=None)
    columns: Mapping[str, str] = declare_field(
        'From the standard name to the name in the file: {"q1": "shoulder_angle"}', made_by=dict
    )
    units: Mapping[str, str] = declare_field(
        'Units by kind of signal or by column: {"q": "deg"}; SI if not given', made_by=dict
    )
    role: Role | None = declare_field(
        "Purpose of the recording; friction: constant velocity, one joint at a time; payload: with a load",
        default=None,
        kinds=ROLES,
    )
    windows: Windows = declare_field("Windows of t to use in s, [from, to]; [] for all", default=())
    payload: Mapping[str, Any] | None = declare_field(
        'The known load: {"mass": kg, "centre": [x, y, z] in m}', default=None
    )
    torque_delay: float = declare_field(
        "Delay of the torque in the file", default=0.0, unit="s", at_least=-5, at_most=5
    )
    accept: tuple[str, ...] = declare_field("Names of checks whose errors count as warnings", default=())
    skip: tuple[ConditioningStep, ...] = declare_field(
        "Conditioning steps to leave out, because samples that look like unsigned registers, held, switched off, "
        "corrupted, wrapped or at the full voltage of servos are right",
        default=(),
    )
    permutation: Mapping[Axis, tuple[int, ...]] = declare_field(
        'Order of the columns of "q" (with velocities and commands) or "tau" (or currents): entry k is the number, '
        "from 1, of the column of joint k",
        made_by=dict,
        at_least=1,
    )
    signs: Mapping[str, float] = declare_field(
        'Factor 1 or -1 for the positions or torques of a joint: {"tau2": -1}; "tau" means all joints',
        made_by=dict,
        at_least=-1,
        at_most=1,
        nonzero=True,
    )
    scale: Mapping[str, float] = declare_field(
        'Positive factors for the positions or torques of a joint: {"tau2": 0.1}', made_by=dict, above=0
    )
    zeros: Mapping[str, float] = declare_field(
        'Position of a joint, after sign and factor, where the description has 0, in rad or m: {"q3": 1.5708}',
        made_by=dict,
    )
    exclude: Windows = declare_field("Windows of t to leave out in s, [from, to]; [] for none", default=())
    effort_kind: EffortKind | None = declare_field(
        "Signal in the torque or current columns; position_command: torque is drive gain (N m/rad) x (q_command - q)",
        default=None,
        kinds=EFFORT_KINDS,
    )
    rate: float | None = declare_field(
        "Sampling rate of a file without a time column; it replaces a column t",
        default=None,
        unit="Hz",
        at_least=1e-3,
        at_most=1e6,
    )

    def __post_init__(self) -> None:
        if isinstance(self.effort_kind, str) and self.effort_kind in NO_MEASUREMENT:
            raise RecordingError(
                f"The torque is declared as {self.effort_kind.replace('_', '-')}: {NO_MEASUREMENT[self.effort_kind]}. "
                "Give columns with the measured torque, or current, of the motors.",
                pointer="/effort_kind",
                title="No measured torque",
            )
        try:
            super().__post_init__()
        except DynidentError as error:
            raise RecordingError(error.detail, pointer=error.pointer) from None
        unknown = [name for name in self.skip if name not in get_args(ConditioningStep)]
        if unknown:
            raise RecordingError(
                f"skip names {unknown[0]!r}, which is not a step that can be left out; choose from "
                f"{', '.join(get_args(ConditioningStep))}.",
                pointer="/skip",
            )
        if self.rate is not None and self.columns.get("t", "t") != "t":
            raise RecordingError(
                f"Both a rate and a time column, {self.columns['t']!r}, are given: leave one of them out.",
                pointer="/rate",
            )
        for name, pairs in (("windows", self.windows), ("exclude", self.exclude)):
            for index, (start, end) in enumerate(pairs):
                if not (isfinite(start) and isfinite(end) and start < end):
                    raise RecordingError(
                        f"Window {index + 1} runs from {start} s to {end} s; the end must be later than the start.",
                        pointer=f"/{name}/{index}",
                    )


_BY_KEY = ("columns", "units", "permutation", "signs", "scale", "zeros")


@dataclass(frozen=True)
class Filters(Request):
    """Filters of an identification; what is left at "auto" is chosen from the data.

    Parameters
    ----------
    position_cutoff : float, "auto" or None
        Cut-off frequency in Hz of the filter of the positions; None for no filter.
    torque_cutoff : float, "auto" or None
        Cut-off frequency in Hz of the filter that torque and columns of W go through; None for no filter.
    decimation : int or "auto"
        Every n-th row is kept.
    filter_order : int or "auto"
        Order of one pass of the filter of the positions.

    Raises
    ------
    RecordingError
        For a value that is no number, or out of its range.

    Examples
    --------
    >>> from dynident.recordings import Filters
    >>> Filters(torque_cutoff=15.0)
    Filters(position_cutoff='auto', torque_cutoff=15.0, decimation='auto', filter_order='auto')
    """

    position_cutoff: float | Literal["auto"] | None = declare_field(
        "Cut-off of the position filter", default="auto", unit="Hz", at_least=1e-4, at_most=1e6
    )
    torque_cutoff: float | Literal["auto"] | None = declare_field(
        "Cut-off of the filter of torque and columns", default="auto", unit="Hz", at_least=1e-4, at_most=1e6
    )
    decimation: int | Literal["auto"] = declare_field(
        "Every n-th row is kept", default="auto", at_least=1, at_most=1_000_000
    )
    filter_order: int | Literal["auto"] = declare_field(
        "Order of one pass of the position filter", default="auto", at_least=1, at_most=12
    )

    def __post_init__(self) -> None:
        try:
            super().__post_init__()
        except DynidentError as error:
            raise RecordingError(
                error.detail, pointer=f"/preprocessing{error.pointer}", title="Impossible preprocessing"
            ) from None
        for item in fields(self):
            value = getattr(self, item.name)
            is_none = value is None and item.name.endswith("cutoff")
            is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
            is_whole = is_number and (item.name.endswith("cutoff") or value == value // 1)
            if not (value == "auto" or is_none or is_whole):
                expected = "a number, None for no filter," if item.name.endswith("cutoff") else "a whole number"
                raise RecordingError(
                    f'{item.name} is {value!r:.60}; give {expected} or "auto" to have it chosen from the data',
                    pointer=f"/preprocessing/{item.name}",
                    title="Impossible preprocessing",
                )


@dataclass(frozen=True)
class Revision(Request):
    """What is to be said of a file from now on; None, or an empty mapping: as before.

    Mappings are merged with what was said, key by key; the rest replaces it. The fields mean what they mean in
    `RecordingMetadata`.

    Parameters
    ----------
    windows : pairs (from, to), optional
        Seconds of t to use; empty: all of them.
    exclude : pairs (from, to), optional
        Seconds of t to leave out; empty: none.
    columns : mapping of str to str
        The file's name of a column by ours.
    units : mapping of str to str
        Units by kind of signal or by column.
    permutation : mapping of str to tuple of int
        By "q" or "tau": at place k the number, from 1, of the column that is joint k's.
    signs : mapping of str to float
        Sign, 1 or -1, by which positions or torques are multiplied.
    scale : mapping of str to float
        Positive factors of positions or torques.
    zeros : mapping of str to float
        Positions in rad or m at which the description has 0.
    torque_delay : float, optional
        Seconds by which the torque of a row is read later than its positions.
    role : str, optional
        What the recording is for.
    skip : tuple of str, optional
        Steps of conditioning that are not taken.
    name : str, optional
        What the recording is called.
    rate : float, optional
        Rows a second in Hz, evenly spaced, of a file without time.
    """

    windows: Windows | None = redeclare_field(RecordingMetadata, "windows", default=None)
    exclude: Windows | None = redeclare_field(RecordingMetadata, "exclude", default=None)
    columns: Mapping[str, str] = redeclare_field(RecordingMetadata, "columns", made_by=dict)
    units: Mapping[str, str] = redeclare_field(RecordingMetadata, "units", made_by=dict)
    permutation: Mapping[Axis, tuple[int, ...]] = redeclare_field(RecordingMetadata, "permutation", made_by=dict)
    signs: Mapping[str, float] = redeclare_field(RecordingMetadata, "signs", made_by=dict)
    scale: Mapping[str, float] = redeclare_field(RecordingMetadata, "scale", made_by=dict)
    zeros: Mapping[str, float] = redeclare_field(RecordingMetadata, "zeros", made_by=dict)
    torque_delay: float | None = redeclare_field(RecordingMetadata, DELAY, default=None)
    role: Role | None = redeclare_field(RecordingMetadata, "role", default=None)
    skip: tuple[ConditioningStep, ...] | None = redeclare_field(RecordingMetadata, "skip", default=None)
    name: str | None = redeclare_field(RecordingMetadata, "name", default=None)
    rate: float | None = redeclare_field(RecordingMetadata, "rate", default=None)

    def apply_to(self, metadata: RecordingMetadata) -> RecordingMetadata:
        """Return the metadata after this revision.

        Parameters
        ----------
        metadata : RecordingMetadata

        Returns
        -------
        RecordingMetadata

        Raises
        ------
        RecordingError
            For a window or a delay that cannot be.
        """
        changed: dict[str, Any] = {}
        for item in fields(self):
            value = getattr(self, item.name)
            if item.name in _BY_KEY:
                changed[item.name] = {**getattr(metadata, item.name), **value}
            elif value is not None:
                changed[item.name] = value
        return replace(metadata, **changed)

    @property
    def changes(self) -> tuple[str, ...]:
        """Names of the fields that change anything."""
        return tuple(item.name for item in fields(self) if getattr(self, item.name) not in (None, {}))

    def __str__(self) -> str:
        return ", ".join(f"{name} {_format_value(getattr(self, name))}" for name in self.changes) or "nothing"


@dataclass(frozen=True)
class Check:
    """One thing that was looked at in a recording, what was found, and what to do about it.

    Parameters
    ----------
    name : str
        Name of the check, which the user gives to accept its finding.
    status : "ok", "warning" or "error"
        Whether the recording may be used; an error stops the import.
    detail : str
        The sentence for the user: what was found, where, and what to do.
    column : str
        The column of the user's file; empty where the finding is about several.
    row : int, optional
        Data row of the file, counted from 1; None where the finding has no single place.
    time : float, optional
        Seconds of t; None where the finding has no single place.
    apply : Revision, optional
        What would have to be said of the file instead, where that is known.
    rows : mapping of str to tuple of int
        Data rows, counted from 1, by column, where the finding is about several.
    remedies : tuple of Remedy
        Those that the sentence quotes.
    is_accepted : bool
        Whether the user has said that the recording is right all the same.
    """

    name: str
    status: Status
    detail: str
    column: str = ""
    row: int | None = None
    time: float | None = None
    apply: Revision | None = None
    rows: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    remedies: tuple[Remedy, ...] = ()
    is_accepted: bool = False

    def __str__(self) -> str:
        return f"{self.name.replace('_', ' ')}: {self.detail}"


UNKNOWN_COLUMNS = "Unknown columns"
"""Title of the error for a file in which no joint has a column of a kind, as another logger wrote it."""


class RecordingError(DynidentError):
    """A recording that cannot be used as it is.

    Parameters
    ----------
    detail : str
        The sentence for the user.
    pointer : str
        The place: a column of the file ("q3"), a JSON pointer into the request ("/windows/0"), or "".
    title : str
        A few words for the kind of problem, the same for every instance of it.
    row : int, optional
        Data row of the file, counted from 1.
    time : float, optional
        Seconds of t.
    checks : tuple of Check
        All that was found up to the error.
    remedies : tuple of Remedy
        Those that the sentence quotes.
    """

    def __init__(
        self,
        detail: str,
        *,
        pointer: str = "",
        title: str = "Unusable recording",
        row: int | None = None,
        time: float | None = None,
        checks: tuple[Check, ...] = (),
        remedies: tuple[Remedy, ...] = (),
    ) -> None:
        super().__init__(detail, pointer=pointer, title=title, remedies=remedies)
        self.row = row
        self.time = time
        self.checks = checks

    def __reduce__(self) -> tuple[object, ...]:
        # Pickling keeps no keyword arguments by itself.
        names = ("pointer", "title", "row", "time", "checks", "remedies")
        return (partial(RecordingError, **{name: getattr(self, name) for name in names}), (self.detail,))


class RevisionFields(TypedDict, total=False):
    """The fields of `Revision`, as arguments by keyword."""

    windows: Windows | None
    exclude: Windows | None
    columns: Mapping[str, str]
    units: Mapping[str, str]
    permutation: Mapping[Axis, tuple[int, ...]]
    signs: Mapping[str, float]
    scale: Mapping[str, float]
    zeros: Mapping[str, float]
    torque_delay: float | None
    role: Role | None
    skip: tuple[ConditioningStep, ...] | None
    name: str | None
    rate: float | None


def _format_value(value: object) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{key}: {_format_value(entry)}" for key, entry in value.items())
    if isinstance(value, tuple):
        return (
            " ".join(f"{entry[0]:g}:{entry[1]:g}" if isinstance(entry, tuple) else str(entry) for entry in value)
            or "none"
        )
    return f"{value:g}" if isinstance(value, float) else str(value)
