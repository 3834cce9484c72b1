"""Fast reading of bag messages that are alike, the message types that are known, and lines of text that are messages.

All messages of a topic are usually of one length, with the same names in the same places. Such a message is written
again by the package of its format twice, with numbers that mark their places; of all others only the numbers are read,
many at once.
"""

from __future__ import annotations

import re
import struct
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import Field, dataclass, replace
from functools import partial
from itertools import pairwise, takewhile
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from dynident.array_types import BoolArray, FloatArray, IntArray
from dynident.recordings.formats.text_streams import is_in_most_lines
from dynident.recordings.recording_metadata import RecordingError
from dynident.recordings.units import are_times

if TYPE_CHECKING:
    from rosbags.interfaces.typing import Fielddefs
from typing import NamedTuple

JOINT_STATES = "sensor_msgs/msg/JointState"
WRENCHES = ("geometry_msgs/msg/WrenchStamped", "geometry_msgs/msg/Wrench")
DYNAMIC_STATES = "control_msgs/msg/DynamicJointState"
CONTROLLER_STATES = (
    "control_msgs/msg/JointTrajectoryControllerState",
    "control_msgs/msg/JointControllerState",
)
_LBR = {
    "measured_joint_position": "position",
    "measured_torque": "torque",
    "commanded_joint_position": "commanded_position",
    "commanded_torque": "commanded_torque",
    "external_torque": "external_torque",
}
ARRAYS: dict[str, dict[str, str]] = {
    "franka_msgs/msg/FrankaState": {
        "q": "position",
        "dq": "velocity",
        "tau_J": "torque",
        "q_d": "commanded_position",
        "tau_J_d": "commanded_torque",
        "tau_ext_hat_filtered": "external_torque",
    },
    "lbr_fri_msgs/msg/LBRState": _LBR,
    "lbr_fri_idl/msg/LBRState": _LBR,
}
"""Fields with a number a joint, and what they are called here, of messages that name no joints."""
FRANKA_ROBOT = "franka_msgs/msg/FrankaRobotState"
KNOWN = (JOINT_STATES, *WRENCHES, DYNAMIC_STATES, *CONTROLLER_STATES, *ARRAYS, FRANKA_ROBOT)


class PackedMessage(NamedTuple):
    """A message as it is stored; `definition` is the text of its type where the file gives it."""

    topic: str
    type: str
    definition: str
    stamp: int
    data: bytes


def normalise_type(type_name: str) -> str:
    """Return the type's name as ROS 2 writes it: sensor_msgs/JointState of ROS 1 is sensor_msgs/msg/JointState."""
    return type_name if "/msg/" in type_name else type_name.replace("/", "/msg/", 1)


MessageT = TypeVar("MessageT", bound="Message")

Content = tuple[Sequence[str], Sequence[float] | FloatArray, tuple[int, int] | None]
"""Names and values of a message, and its stamp in whole seconds and nanoseconds."""

_FLOAT_MARKS = (0x4111_1111_1111_0000, 0x4222_2222_2222_0000)
_WORD_MARKS = (0x1111_0000, 0x2222_0000)
_OTHER_MARKS = (1, 2)
_MOST = 0x7FFF


@dataclass(frozen=True, eq=False)
class Layout:
    """How messages of one kind are laid out: bytes (size,) that all of them have in common, where `common` is true.

    `places` (c,) and `stamp` are where the values lie, as float64, and whole seconds and nanoseconds, as uint32.
    """

    like: NDArray[np.uint8]
    common: BoolArray
    names: tuple[str, ...]
    places: IntArray
    stamp: tuple[int, int] | None

    def read(self, messages: Sequence[bytes]) -> tuple[BoolArray, FloatArray, FloatArray]:
        """Read messages of this length.

        Parameters
        ----------
        messages : sequence of bytes
            Packed messages of one length.

        Returns
        -------
        alike : (m,) of bool
            Which of them are laid out like this.
        times : (k,)
            Stamps of these in s, 0 without one.
        values : (k, c)
            Their values, as float64.
        """
        size = len(self.like)
        whole = np.frombuffer(b"".join(messages), dtype=np.uint8).reshape(len(messages), size)
        # A message may have this length by chance, with other names in it: all bytes but the numbers have to be equal.
        alike = (whole[:, self.common] == self.like[self.common]).all(axis=1)
        whole = whole[alike]
        times = np.zeros(len(whole))
        if self.stamp is not None:
            seconds, nanoseconds = (_extract_numbers(whole, np.array([place]), "<u4")[:, 0] for place in self.stamp)
            times = seconds + nanoseconds * 1e-9
        return alike, times, _extract_numbers(whole, self.places, "<f8").astype(np.float64)


def _extract_numbers(whole: NDArray[np.uint8], places: IntArray, kind: str) -> FloatArray:
    """Return the numbers (m, c) of a kind at places of bytes (m, size)."""
    width = np.dtype(kind).itemsize
    chunks = whole[:, places[:, None] + np.arange(width)]
    return np.asarray(np.ascontiguousarray(chunks).view(kind)[..., 0])


class Message(Protocol):
    """A message that was unpacked: a dataclass of a type with a name."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]
    __msgtype__: ClassVar[str]


def learn_layout(
    data: bytes,
    message: MessageT,
    fields: Callable[[str], Fielddefs],
    written: Callable[[MessageT], bytes],
    content: Callable[[MessageT], Content],
) -> Layout | None:
    """Learn the layout of a message.

    Parameters
    ----------
    data : bytes
        A packed message.
    message : object
        The same, unpacked: a dataclass of the types that `fields` knows.
    fields : callable
        Gives the fields of a type: pairs of their name, and of what kind they are.
    written : callable
        Packs a message.
    content : callable
        What is read of a message.

    Returns
    -------
    Layout or None
        None if its numbers are not found again, as of types that are rare.
    """
    marked = [_NumberMarker(fields, which).mark_message(message) for which in (0, 1)]
    first, second = (np.frombuffer(written(copy), dtype=np.uint8) for copy in marked)
    own = np.frombuffer(data, dtype=np.uint8)
    if not len(first) == len(second) == len(own):
        return None
    # No byte of a mark is alike in the two versions: bytes that are equal hold no numbers.
    common = first == second
    if not np.array_equal(own[common], first[common]):
        return None
    names, values, stamp = content(marked[0])
    raw = first.tobytes()
    # Each mark is a number of its own: its bytes tell the place of its value.
    places = [raw.find(struct.pack("<d", value)) for value in values]
    words = None if stamp is None else tuple(raw.find(struct.pack("<I", number)) for number in stamp)
    all_places = [*places, *(words or ())]
    if min(all_places, default=-1) < 0 or len(set(all_places)) < len(all_places):
        return None
    where = None if words is None else (words[0], words[1])
    return Layout(own, common, tuple(names), np.array(places), where)


class _NumberMarker:
    """Replaces the numbers of a message by marks: each a number of its own, in two versions no byte alike."""

    def __init__(self, fields: Callable[[str], Fielddefs], which: int) -> None:
        self._fields, self._which, self._count = fields, which, 0

    def mark_message(self, message: MessageT) -> MessageT:
        kinds = dict(self._fields(message.__msgtype__))
        return replace(
            message, **{name: self._mark_value(getattr(message, name), kind) for name, kind in kinds.items()}
        )

    def _mark_value(self, value: Any, kind: Any) -> Any:
        node, of = kind
        if node.name == "NAME":
            return self.mark_message(value)
        if node.name == "BASE":
            return self._mark_number(value, of[0])
        inner = of[0]
        if isinstance(value, np.ndarray):
            return np.array([self._mark_number(element, inner[1][0]) for element in value], dtype=value.dtype)
        return [self._mark_value(element, inner) for element in value]

    def _mark_number(self, value: Any, kind: str) -> Any:
        """Return the mark in place of a number; strings stay, which all messages share."""
        if kind in ("string", "wstring"):
            return value
        self._count = count = min(self._count + 1, _MOST)
        count = count if self._which == 0 else ~count & 0xFFFF
        if kind == "float64":
            return struct.unpack("<d", struct.pack("<Q", _FLOAT_MARKS[self._which] + count))[0]
        if kind in ("int32", "uint32"):
            return _WORD_MARKS[self._which] + count
        if kind in ("int64", "uint64"):
            return int.from_bytes(bytes([_OTHER_MARKS[self._which]]) * 8, "little")
        if kind == "bool":
            return bool(self._which)
        if kind == "float32":
            return np.frombuffer(bytes([0x11 * (self._which + 1)]) * 4, dtype=np.float32)[0]
        width = {"int16": 2, "uint16": 2}.get(kind, 1)
        return int.from_bytes(bytes([_OTHER_MARKS[self._which]]) * width, "little")


_FIELDS_OF_JOINTS = {1: ("position",), 2: ("numbers1", "numbers2"), 3: ("position", "velocity", "effort")}
"""Arrays of a message of joint states by their number; of two it is not said which are left empty."""


def name_value_columns(words: Sequence[Sequence[str | None]]) -> tuple[str, ...] | None:
    """Name the columns of rows of a time, a signal's name and its value, which have no line of names.

    Parameters
    ----------
    words : sequence of sequences
        The cells of the first two rows; None for a number.

    Returns
    -------
    tuple of str or None
        None for other files.
    """
    if len(words) < 2 or any(len(row) != len(_OF_VALUES) or not row[1] or row[2] is not None for row in words):
        return None
    return _OF_VALUES if all(row[0] is None or (row[0] and are_times([row[0]])) for row in words) else None


_OF_VALUES = ("time", "signal", "value")


def name_message_columns(words: Sequence[Sequence[str | None]]) -> tuple[str, ...] | None:
    """Name the columns of joint states without a line of names, as `ros2 topic echo --csv` writes them.

    A row has the stamp's seconds and nanoseconds, the frame, the joints' names, and their positions, velocities and
    efforts.

    Parameters
    ----------
    words : sequence of sequences
        The cells of the first two rows; None for a number.

    Returns
    -------
    tuple of str or None
        None for other files.
    """
    if len(words) < 2 or len(words[0]) != len(words[1]):
        return None
    # Names of joints are the same in every row, and there are fewer of them than of numbers.
    if words[0] != words[1] or sum(map(bool, words[0])) * 2 > len(words[0]):
        return None
    places = [place for place, cell in enumerate(words[0]) if cell]
    if not places or places != list(range(places[0], places[-1] + 1)):
        return None
    # The frame stands before the joints' names: a word of its own, or an empty cell.
    begin = places[0] if places[0] and words[0][places[0] - 1] == "" else places[0] + 1
    n = places[-1] + 1 - begin
    arrays = _FIELDS_OF_JOINTS.get((len(words[0]) - places[-1] - 1) // n) if n > 0 else None
    joints = set(words[0][begin : places[-1] + 1])
    if arrays is None or len(joints) < n or (len(words[0]) - places[-1] - 1) % n or begin < 2:
        return None
    before = [f"column{place + 1}" for place in range(begin - 1)]
    if begin == 3:
        before = ["sec", "nanosec"]
    return (*before, "frame", *(f"{name}{joint + 1}" for name in ("name", *arrays) for joint in range(n)))


_PROPERTY = re.compile(r"(?P<word>[A-Za-z]\w*): ?(?P<value>.*)")


def have_words_alike(words: Sequence[Sequence[str | None]], first: str) -> bool:
    """Return whether two lines, None for their numbers, are both rows with words at the same places.

    Names may be numbers as well: whole ones, or three and more with fractions that rise from column to column.
    """
    comma = "," if re.search("[;\t|]", first) else ""
    values = [float(cell.replace(",", ".")) for cell in re.findall(rf"[+-]?\d+[.{comma}]\d+", first)]
    are_names = not values or (len(values) > 2 and values == sorted(set(values)))
    places = [[word is None for word in line] for line in words[:2]]
    return words[0] == words[1] or (places[0] == places[1] and not are_names)


def put_word_before(cells: Sequence[str]) -> list[str]:
    """Return a row with the word before the values of all its cells, `Unit: deg`, in place of its first cell.

    Parameters
    ----------
    cells : sequence of str
        The row. One of other cells is returned as it is.
    """
    hits = [_PROPERTY.fullmatch(cell) for cell in cells if cell]
    words = {hit["word"] if hit else None for hit in hits}
    if len(hits) < 2 or len(words) != 1 or (word := words.pop()) is None:
        return list(cells)
    return [word, *(cell.partition(":")[2].strip() for cell in cells[1:])]


def check_message_kinds(words: Sequence[str]) -> None:
    """Refuse messages of several kinds that alternate between the rows.

    Parameters
    ----------
    words : sequence of str
        First cells of the rows.

    Raises
    ------
    RecordingError
        Where a word stands again behind another one.
    """
    changes = sum(before != after for before, after in pairwise(words))
    if changes >= len(kinds := dict.fromkeys(words)) > 1:
        raise RecordingError(
            f"The rows are messages of several kinds ({', '.join(list(kinds)[:4])}) with as many cells: keep those of "
            "one kind, or write a first line with the names of the columns.",
            title="Unreadable file",
        )


_LABELLED = re.compile(r"(?<![\w.])(?P<label>[A-Za-z_][\w.]*(?:\[\d+\])?)[ ]*[:=][ ]*(?:[\[({][ ]*)?(?=[+-]?[.\d])")
_BARE = re.compile(r"(?<![\w.])(?P<label>[A-Za-z_]\w*)[ ]+(?=[+-]?[.\d])")
"""A word before numbers with a sign between, and with spaces alone."""
_FREE_NUMBER = re.compile(r"(?<![\w.])[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?(?![\w.])")
_BRACES = re.compile(r"\w[ ]*+[:=][ ]*+\{[ ]*+[+-]?[.\d]")
_TIME_OF_DAY = re.compile(r"(?<![\w:.])(\d{1,2}):([0-5]\d):([0-5]\d(?:[.,]\d+)?)(?![\w:.])")


def _write_seconds(text: str, label: re.Pattern[str]) -> str:
    """Return the text with times of day as numbers in s with a word before them, as the other numbers have."""
    sign = "=" if label is _LABELLED else " "

    def write(clock: re.Match[str]) -> str:
        seconds = 3600 * int(clock[1]) + 60 * int(clock[2]) + float(clock[3].replace(",", "."))
        return f"time{sign}{seconds:.9g}"

    return _TIME_OF_DAY.sub(write, text)


def name_labelled_numbers(line: str, label: re.Pattern[str] = _LABELLED) -> tuple[str, ...]:
    """Return names for the numbers of a line in which words stand before them, `q: 0.1 0.2 tau=3`: q1, q2, tau."""
    line = _write_seconds(line, label)
    words: list[str] = []
    label_end, word = 0, "column"
    labels = label.finditer(line)
    following = next(labels, None)
    # Labels and numbers come in the order of the line: each of both is passed once.
    for number in _FREE_NUMBER.finditer(line):
        while following is not None and following.start() <= number.start():
            label_end, word = following.end(), following["label"]
            following = next(labels, None)
        # Indices within labels are no numbers of their own.
        if number.start() >= label_end:
            words.append(word)
    counts, seen = Counter(words), Counter[str]()
    names = []
    for word in words:
        seen[word] += 1
        joint = "_" if word[-1].isdecimal() else ""
        names.append(word if counts[word] == 1 and word != "column" else f"{word}{joint}{seen[word]}")
    return tuple(names)


def find_labels(lines: list[str]) -> re.Pattern[str] | None:
    """Return how words stand before the numbers of lines that are no table, the same in nearly all; None of others."""
    rows = [line for line in lines if line.strip()][-_LABELLED_LINES:]
    # Braces behind words hold their numbers; others, and quotes, are those of objects.
    if len(rows) < 2 or '"' in rows[-1] or rows[-1].count("{") > len(_BRACES.findall(rows[-1])):
        return None
    # Words and numbers between other signs than spaces are cells of a table.
    for label in (_LABELLED,) if set(",;\t|") & set(rows[-1]) else (_LABELLED, _BARE):
        words = {match["label"] for match in label.finditer(rows[-1])}
        names = [name_labelled_numbers(row, label) for row in rows if len(words) > 1]
        usual = names[-1] if names else ()
        # Without a sign they may be so as well: what has lists behind several words is no table.
        known = set(usual)
        has_lists = sum(f"{word}2" in known or f"{word}_2" in known for word in words) > 1
        if len(usual) > 2 and (label is _LABELLED or has_lists) and names.count(usual) >= 0.8 * len(names):
            return label
    return None


def keep_numbers(text: str, label: re.Pattern[str] = _LABELLED) -> str:
    """Return the numbers of each line alone, with commas between them."""
    lines = []
    for line in _write_seconds(text, label).splitlines():
        plain = label.sub(" ", line)
        lines.append(",".join(match[0] for match in _FREE_NUMBER.finditer(plain)) if label.search(line) else "")
    return "\n".join([*lines, ""])


_SAMPLE = r"\d+(?:\.\d+)?:[+-]?[\d.]+(?:[eE][+-]?\d+)?"
_PLOTTED = re.compile(rf"(?m)^>?([A-Za-z_][\w. /-]*):({_SAMPLE}(?:;{_SAMPLE})*);?(?:§[^|\n]*)?(?:\|\w*)?\r?$")
"""A line of a plotter of values, `>q1:1700000000123:0.12;1700000000133:0.13`: a name, times and values."""


def separate_plotted(text: str) -> str:
    """Return lines that a plotter takes as rows of time, name and value; behind them the others as single cells."""
    rows, others = [], []
    for line in text.splitlines():
        if plotted := _PLOTTED.match(line):
            rows += [f"{time},{plotted[1]},{sample}\n" for time, sample in re.findall("([^;:]+):([^;]+)", plotted[2])]
        elif line.strip():
            # A reader counts and reports rows with another number of cells.
            others.append(re.sub('[,"]', " ", line) + "\n")
    return "".join([*rows, *others])


_GROUP = re.compile(r"[\[({]\s*([+-]?[.\d][^\[\](){}]*)[\])}]")


def name_grouped_numbers(line: str) -> tuple[str, ...]:
    """Return names for the numbers of a line in which brackets group them, `12 (0.1 0.2) [ok] (3 4)`; none of others.

    Between the brackets stand words and spaces: what commas separate are cells of a table.
    """
    parts = _GROUP.split(line)
    between, groups = parts[::2], parts[1::2]
    if len(groups) < 2 or any(sign in text for text in between for sign in ",;\t|"):
        return ()
    names = [f"column{number + 1}" for number in range(len(_FREE_NUMBER.findall(between[0])))]
    for number, items in enumerate(groups, start=1):
        names += [f"group{number}_{place + 1}" for place in range(len(_FREE_NUMBER.findall(items)))]
    return tuple(names)


def keep_grouped_numbers(text: str, n: int) -> str:
    """Return the numbers of each line alone, with commas between them; lines with other than `n` are empty."""
    rows = []
    for line in text.splitlines():
        parts = _GROUP.split(line)
        numbers = _FREE_NUMBER.findall(" ".join(parts[:1] + parts[1::2]))
        rows.append(",".join(numbers) if len(numbers) == n else "")
    return "\n".join([*rows, ""])


LineForm = tuple[tuple[str, ...], Callable[[str], str], str]


def find_line_form(lines: list[str]) -> LineForm | None:
    """Return the columns of lines that are no table, what makes one of them, and a remark on it; None of tables."""
    if (label := find_labels(lines)) is not None:
        remark = "The lines are numbers with words before them: the words are taken for the names of columns."
        return name_labelled_numbers(lines[-1], label), partial(keep_numbers, label=label), remark
    rows = [name_grouped_numbers(line) for line in lines if line.strip()][-_LABELLED_LINES:]
    if len(rows) > 1 and rows[-1] and rows.count(rows[-1]) >= 0.8 * len(rows):
        remark = "The lines are numbers in brackets: they are called by the brackets' number and their place in them."
        return rows[-1], partial(keep_grouped_numbers, n=len(rows[-1])), remark
    if is_in_most_lines(_PLOTTED, "\n".join(lines)):
        return ("time", "variable", "value"), separate_plotted, "Each line is a name, a time and a value of it."
    return None


_LABELLED_LINES = 50


def count_properties(lines: Sequence[list[str]], is_number: Callable[[str], bool]) -> int:
    """Return how many lines below the names, of words before values, say what the columns have, as LabVIEW's do."""
    rows = [put_word_before(line) for line in lines]
    begins = [row[0].casefold() for row in rows]
    n_words = sum(takewhile(bool, is_word := [begin[:1].isalpha() and not is_number(begin) for begin in begins]))
    are_properties = [not _PROPERTIES.isdisjoint(re.split("[^a-z]+", begin)) for begin in begins[:n_words]]
    # A word may say where the rows begin, in the first of them.
    is_row = n_words and not are_properties[-1] and all(map(is_number, rows[n_words - 1][1:]))
    n_words -= bool(is_row and begins[n_words : n_words + 1] == [""])
    has_rows = n_words > 1 and len(begins) > 2 * n_words and not any(is_word[n_words + 1 :])
    return n_words if has_rows and any(are_properties) else 0


_PROPERTIES = frozenset({"unit", "units", "length", "samples", "increment", "delta", "type", "interp"})
"""One of these words at least stands before such lines."""
