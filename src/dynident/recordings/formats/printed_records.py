"""Text that a program printed in place of a table, rewritten as an object of JSON a line while it is read.

Four kinds are known: dictionaries and objects as Python and Rust print them, messages as ROS prints them (a part of
YAML), lines of names with values that begin again with the same name, and messages of protobuf as text.
"""

from __future__ import annotations

import io
import itertools
import json
import re
from collections.abc import Iterator, Sequence
from typing import IO, Any, Literal

from dynident.recordings.file_size_limits import DEEPEST, LARGEST_MESSAGE, MOST_TIMES, TITLE
from dynident.recordings.formats.packed_messages import find_labels
from dynident.recordings.formats.text_streams import ProducedStream, TextContent
from dynident.recordings.recording_metadata import RecordingError

Kind = Literal["python", "messages", "items", "protobuf"]

_LOOKED_AT = 1 << 16
_PYTHON = re.compile(
    r"^\s*(?:\{\s*'|[(\[]\s*(?:[(\[]\s*[-+.\d]|[-+.\d]+\s*,\s*(?:array)?[(\[])"
    r"|[A-Za-z_][\w.:]*(?:\(\w+=|\s?\{\s*\w+\s?:\s?\S[^\n]*\}))"
)
"""How dictionaries begin, tuples of numbers and lists, and objects on one line: State(t=0.1), State { t: 0.1 }."""
_PROTOBUF = re.compile(
    r"^\s*+(?:\w++\s*+:[^\n]*+\n\s*+){0,9}\w++\s*+\{"
    r"(?:[^\S\n]*+\n\s*+(?:\w++\s*+:\s*+[^\s{]|\w++\s*+\{[^\S\n]*+\n)"
    r"|\s*+(?:\w++\s*+\{\s*+)*+\w++\s*+:\s*+(?:\"[^\"\n]*+\"|[^\s,{}\"]++)\s++\w[^\n]*\}"
    r"[^\S\n]*+\n\s*+(?:\}|\w++\s*+[:{]))"
)
"""Messages with a field a line, or with several fields on one line and no commas between them."""
_ENTRY = re.compile(r"^(?P<name>[A-Za-z_][\w./ ]{0,63}?)\s?:(?:\s+(?P<value>\S.*))?$")
"""A name, and behind the colon its value, if it does not stand in the lines below."""
_COMMA = re.compile(r"^([A-Za-z_][\w./]{0,63})\s?,\s{0,9}(?=\[|[-+.\d][-+.\deE]{0,40}$)")
"""A name with a comma in place of the colon, before one number or a list: what `print(name, value, sep=",")` does."""
_VALUE = r"(?:[-+]?(?:\d++(?:\.\d*+)?|\.\d++)(?:[eE][-+]?\d++)?|(?i:nan|-?inf))"
_SPACED = re.compile(rf"^([A-Za-z_]\w{{0,63}})[,;\s]{{1,9}}({_VALUE}(?:[,;\s]{{1,9}}{_VALUE})*+)[,;\s]{{0,9}}$")
"""A name and numbers, as where each signal of a sample is printed on a line of its own."""
_NAME = re.compile(r"[A-Za-z_][\w.:]*")
_SEPARATOR = "---"
_ITEM = "- "


def find_printed_kind(content: TextContent) -> Kind | None:
    """Return how a program printed its records; None where the text is no such printout.

    Parameters
    ----------
    content : TextContent
        The file, of which the beginning is read.

    Returns
    -------
    str or None
        "python" for dictionaries and objects, "messages" for lines of names with values, "items" for a list of those,
        "protobuf" for messages as `gz topic --echo` prints them.
    """
    text = content.read_start(_LOOKED_AT).decode("utf-8-sig", errors="replace")
    if _PROTOBUF.match(text):
        return "protobuf"
    if _PYTHON.match(text) and _goes_on(text):
        return "python"
    # The last line may be cut off.
    whole = text.splitlines()[:-1]
    # A table whose numbers have words before them may begin with the level of the log: INFO: t=0.1 q=0.2.
    if find_labels(whole) is not None:
        return None
    if _come_in_turn(whole):
        whole = list(map(_put_brackets, whole))
    lines = [line.rstrip() for line in _join_brackets(map(_put_colon, whole)) if line.strip()]
    if lines and lines[0].startswith(_SEPARATOR):
        lines = lines[1:]
    return _find_kind(lines) or _find_kind(list(_find_items(iter(lines))))


def _put_colon(line: str) -> str:
    return _COMMA.sub(r"\1: ", line.rstrip())


def _put_brackets(line: str) -> str:
    """Return a line of a name and numbers with a colon behind the name, and several as a list; others unchanged."""
    signal = _SPACED.match(line)
    if signal is None:
        return line
    numbers = _BETWEEN.split(signal[2])
    return f"{signal[1]}: [{','.join(numbers)}]" if len(numbers) > 1 else f"{signal[1]}: {numbers[0]}"


def _come_in_turn(lines: Sequence[str]) -> bool:
    """Return whether signals stand on lines of their own, always in one order; other words say states of rows."""
    entries = [_ENTRY.match(_put_brackets(_put_colon(line))) for line in lines if line.strip()]
    values = [None if entry is None else _parse_scalar(entry["value"] or "-") for entry in entries]
    # One number is a signal's where others have several, such as the time.
    if not any(isinstance(value, list) for value in values):
        return False
    pairs = zip(entries, values, strict=True)
    signals = [entry["name"] for entry, value in pairs if entry and isinstance(value, int | float | list)]
    period = len(set(signals))
    in_order = all(name == signals[k % period] for k, name in enumerate(signals))
    return len(signals) == len(entries) and 1 < period < len(signals) and in_order


def _goes_on(text: str) -> bool:
    """Return whether a printed object goes on, or its name comes again, below its first line: a title's does not."""
    first, *others = itertools.islice((line for line in text.splitlines() if line.strip()), 2)
    name = _NAME.match(first.lstrip())
    if name is None or not others:
        return True
    return others[0].lstrip().startswith(name[0]) if first.rstrip()[-1] in ")}" else others[0][0].isspace()


def _find_kind(lines: Sequence[str]) -> Kind | None:
    if not lines:
        return None
    is_list = lines[0].startswith(_ITEM)
    first = _ENTRY.match(lines[0].removeprefix(_ITEM))
    if first is None:
        return None
    entries = [_ENTRY.match(line.removeprefix(_ITEM).lstrip() if is_list else line) for line in lines]
    names = [entry["name"] for entry in entries if entry is not None]
    # Rows of a table are no part of a record, however far they are indented: names stand above them.
    is_inside = [(line[:1].isspace() or line.startswith("-")) and not _is_table_row(line) for line in lines]
    # All lines have this form, the first name comes again, and others stand between.
    is_printout = (
        all(entry or inside for entry, inside in zip(entries, is_inside, strict=True))
        and names.count(first["name"]) >= 2
        and len(set(names)) >= 2
    )
    return ("items" if is_list else "messages") if is_printout else None


_MOST_ABOVE = 100
"""Lines that may stand above a list of records."""


def _find_items(lines: Iterator[str]) -> Iterator[str]:
    """Yield the lines of a list of records that stands below a name, without their indentation; others unchanged."""
    above: list[str] = []
    for line in lines:
        text = line.lstrip()
        if not above and text.startswith(_ITEM):
            above.append(line)
            break
        name = _ENTRY.match(above[-1].strip()) if above else None
        if text.startswith(_ITEM) and _ENTRY.match(text[len(_ITEM) :]) and name is not None and name["value"] is None:
            yield from _dedent(line, lines, len(line) - len(text))
            return
        if line.strip():
            above.append(line)
        if len(above) > _MOST_ABOVE or (len(above) > 1 and _ENTRY.match(line.strip()) is None):
            break
    yield from above
    yield from lines


def _dedent(first: str, lines: Iterator[str], indent: int) -> Iterator[str]:
    """Yield the lines of a list, whose first one is indented by `indent`; one that is indented less ends it."""
    yield first[indent:]
    for line in lines:
        if line.strip() and not line[: indent + 1].isspace() and not line.startswith(_ITEM, indent):
            return
        yield line[indent:]


def rewrite_as_json(content: TextContent, kind: Kind) -> TextContent:
    """Return the text of a printout as objects of JSON, one a line.

    Parameters
    ----------
    content : TextContent
        The printout.
    kind : str
        What `find_printed_kind` found.
    """
    return content.replace_text(lambda: io.BufferedReader(_open_as_json(content, kind), 1 << 20))


def _open_as_json(content: TextContent, kind: Kind) -> LineStream:
    file = content.open()
    lines = _read_lines(io.TextIOWrapper(file, encoding="utf-8-sig", errors="replace"))
    if kind == "python":
        return LineStream(file, map(_rewrite_python, _join_dictionaries(lines)))
    return LineStream(file, _rewrite_protobuf(lines) if kind == "protobuf" else _rewrite_entries(lines, kind))


class LineStream(ProducedStream):
    """A stream of lines that are made of those of a file.

    Parameters
    ----------
    file : binary file
        It is closed with the stream.
    lines : iterator of str
        The lines, without their ends.
    """

    def __init__(self, file: IO[bytes], lines: Iterator[str]) -> None:
        super().__init__()
        self._file, self._lines, self._waiting = file, lines, bytearray()

    def read_part(self, size: int) -> bytes:
        """Return the next bytes, at most `size`; none at the end."""
        while len(self._waiting) < size and (line := next(self._lines, None)) is not None:
            self._waiting += line.encode() + b"\n"
        part = bytes(self._waiting[:size])
        del self._waiting[:size]
        return part

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        super().close()


def _read_lines(file: IO[str]) -> Iterator[str]:
    """Yield the lines of a file; a line that is longer than any record is refused."""
    while line := file.readline(LARGEST_MESSAGE):
        if len(line) == LARGEST_MESSAGE:
            raise RecordingError(f"A line is longer than {LARGEST_MESSAGE >> 20} MB.", title=TITLE)
        yield line.rstrip("\r\n")


_CALL = re.compile(r"\b(?:np\.|numpy\.)?(?:array|float\d*|int\d*|bool_?)\(([^()]*?)(?:,\s*dtype=[\w.']+)?\)")
"""What NumPy prints around numbers: array([0.1, 0.2], dtype=float32), np.float64(0.1)."""
_WORDS = {"None": "null", "True": "true", "False": "false", "nan": "NaN", "inf": "Infinity"}
_WORD = re.compile(r"(?<![\w'\"])(?:None|True|False|nan|inf)(?![\w'\"])")
_STRING = re.compile(r"'([^'\"\\]*)'")
_POINT_AT_END = re.compile(r"(?<![\w.])(\d+)\.(?=[eE][+-]?\d|[\s,)\]}]|$)")
"""A whole number as NumPy prints it, 1., which JSON has not."""


def _join_dictionaries(lines: Iterator[str]) -> Iterator[str]:
    """Yield the lines, those joined that go on with a dictionary, as where an array of NumPy has a line break."""
    parts: list[str] = []
    size = 0
    for line in lines:
        if parts and (_PYTHON.match(line) or size > LARGEST_MESSAGE):
            yield " ".join(parts)
            parts, size = [], 0
        parts.append(line)
        size += len(line) + 1
    yield " ".join(parts)


_OBJECT = re.compile(r"(?<![\w.:])[A-Za-z_][\w.:]*+(?:(?P<call>\()(?=\s*\w+\s*=)|\s?(?=\{))|[()]")
"""The name of an object, with its bracket if that is round; and every other round bracket."""
_KEY = re.compile(r"([{,]\s*)([A-Za-z_]\w*)\s*(?:=|:(?!:))")

_VARIANT = re.compile(r":\s+(?!(?:true|false|null|True|False|None|nan|NaN|inf|Infinity)\b)([A-Za-z_]\w*)(?=\s*[,}])")
"""A value that is a bare word, such as a variant of an enumeration."""


_TEXT = re.compile(r"""('(?:[^'\\]|\\.?)*+(?:'|\Z)|"(?:[^"\\]|\\.?)*+(?:"|\Z))""")
"""A text in quotes, within which nothing else is rewritten."""


def _rewrite_objects(parts: Sequence[str]) -> list[str]:
    """Return objects that are printed with their names, State(t=0.1) or State { t: 0.1 }, as those of JSON.

    The parts are those between texts.
    """
    is_object: list[bool] = []

    def replace_bracket(match: re.Match[str]) -> str:
        if match[0] == ")":
            return "}" if is_object and is_object.pop() else ")"
        if match[0] == "(" or match["call"]:
            is_object.append(match[0] != "(")
            return "{" if is_object[-1] else "("
        return ""

    return [_VARIANT.sub(r': "\1"', _KEY.sub(r'\1"\2": ', _OBJECT.sub(replace_bracket, part))) for part in parts]


def _rewrite_python(line: str) -> str:
    """Return a printed dictionary or object as JSON; what is none stays, and its reader says so."""
    text = _CALL.sub(r"\1", line)
    parts = _TEXT.split(text)
    if _NAME.match(text.lstrip()):
        parts[::2] = _rewrite_objects(parts[::2])
    for k in range(0, len(parts), 2):
        part = _POINT_AT_END.sub(r"\1", _WORD.sub(lambda word: _WORDS[word[0]], parts[k]))
        parts[k] = part.replace("(", "[").replace(")", "]")
    parts[1::2] = [_STRING.sub(r'"\1"', part) for part in parts[1::2]]
    text = "".join(parts).strip()
    # What has no names is counted.
    return f'{{"column": {text}}}' if text.startswith("[") else text


_OMITTED = ("sec", "nsec")
"""Numbers of a time, which protobuf does not print where they are 0."""


_FIELD = re.compile(
    r"(?<!\w)(?P<name>\w++)\s*+(?::?\s*+(?P<opens>\{)"
    r"|:\s*+(?P<text>\"(?:[^\"\\]|\\.?)*+(?:\"|\Z)|'(?:[^'\\]|\\.?)*+(?:'|\Z)|\[[^\[\]]*+\]|[^\s{},;]++))|\}"
)
"""A field of a message with its value, the beginning of a message, or the end of one."""


def _rewrite_protobuf(lines: Iterator[str]) -> Iterator[str]:
    """Yield the messages of protobuf that are printed as text; each begins with the name of the first."""
    numbers: dict[tuple[str, ...], set[str]] = {}
    first = before = ""
    stack: list[tuple[str, dict[str, Any]]] = [("", {})]
    size = n_read = n_filled = 0
    for line in lines:
        size += len(line)
        n_read += len(line)
        for field in _FIELD.finditer(line):
            name = field["name"]
            if name is None:
                n_new = _close_message(stack, numbers)
                size, n_filled = size + n_new, n_filled + n_new
                if n_filled > max(LARGEST_MESSAGE, MOST_TIMES * n_read):
                    raise RecordingError("Nearly all numbers of the messages are missing.", title=TITLE)
                continue
            if size > LARGEST_MESSAGE:
                raise RecordingError(f"A message is longer than {LARGEST_MESSAGE >> 20} MB.", title=TITLE)
            if len(stack) == 1:
                if name == first and before != first:
                    yield json.dumps(stack[0][1])
                    stack, size = [("", {})], len(line)
                first, before = first or name, name
            if field["opens"]:
                if len(stack) > DEEPEST:
                    raise RecordingError(f"A message is nested deeper than {DEEPEST} levels.", title=TITLE)
                stack.append((name, {}))
            else:
                _add_field(stack[-1][1], name, _parse_scalar(field["text"]))
    if stack[0][1]:
        yield json.dumps(stack[0][1])


def _close_message(stack: list[tuple[str, dict[str, Any]]], numbers: dict[tuple[str, ...], set[str]]) -> int:
    """Put the innermost message into the one around it; numbers that others of its kind have are 0 where they miss.

    Returns how many characters these take.
    """
    if len(stack) < 2:
        return 0
    path = tuple(name for name, _ in stack)
    name, message = stack.pop()
    known = numbers.setdefault(path, set(_OMITTED) if name == "stamp" else set())
    known |= {key for key, value in message.items() if isinstance(value, (int, float))}
    missing = known - message.keys()
    message.update(dict.fromkeys(missing, 0))
    _add_field(stack[-1][1], name, message)
    return sum(map(len, missing)) + len(missing)


def _add_field(message: dict[str, Any], name: str, value: object) -> None:
    """Add a field to a message; one that comes again is a list."""
    if name not in message:
        message[name] = value
    elif isinstance(message[name], list):
        message[name].append(value)
    else:
        message[name] = [message[name], value]


def _rewrite_entries(lines: Iterator[str], kind: Kind) -> Iterator[str]:
    """Yield the records of lines of names with values."""
    record: list[str] = []
    names: set[str] = set()
    first, size = "", 0
    joined = _join_brackets(_put_brackets(_put_colon(line)) for line in lines)
    for line in _find_items(joined) if kind == "items" else joined:
        line = line.rstrip()
        if not line:
            continue
        begins = kind == "items" and line.startswith(_ITEM)
        if begins:
            line = f"  {line[len(_ITEM) :]}"
        entry = _ENTRY.match(line)
        # A record ends where a line says so, where a name of its own comes again, or that of the first record's begin.
        if begins or line == _SEPARATOR or (entry is not None and entry["name"] in {*names, first}):
            if record:
                yield json.dumps(_parse_lines(record))
            record, names, size = [], set(), 0
        if line == _SEPARATOR:
            first = ""
            continue
        if entry is not None:
            first = first or entry["name"]
            names.add(entry["name"])
        record.append(line)
        size += len(line)
        if size > LARGEST_MESSAGE:
            raise RecordingError(f"A message is longer than {LARGEST_MESSAGE >> 20} MB.", title=TITLE)
    if record:
        yield json.dumps(_parse_lines(record))


def _join_brackets(lines: Iterator[str]) -> Iterator[str]:
    """Yield the lines, those joined between which a list in brackets goes on."""
    parts: list[str] = []
    n_open = size = 0
    for line in lines:
        # Brackets within a text open no list.
        if parts or line.partition("[")[0].rstrip()[-1:] in ("", ":", "-"):
            n_open += line.count("[") - line.count("]")
        parts.append(line.strip() if parts else line)
        size += len(line)
        if n_open <= 0 or size > LARGEST_MESSAGE:
            yield " ".join(parts)
            parts, n_open, size = [], 0, 0
    if parts:
        yield " ".join(parts)


def _parse_lines(lines: list[str]) -> object:
    """Return the record that lines of names with values are."""
    indents = [len(line) - len(line.lstrip()) for line in lines]
    return _LineParser([line.strip() for line in lines], indents).parse(indents[0], 0)


class _LineParser:
    """Reads the part of YAML that is printed of messages: names with values, lists, and what stands inside them."""

    def __init__(self, lines: list[str], indents: list[int]) -> None:
        self._lines, self._indents, self._at = lines, indents, 0

    def parse(self, indent: int, depth: int) -> object:
        """Return what begins at the next line, and goes on as long as lines are indented as that."""
        if depth > DEEPEST:
            raise RecordingError(f"A message is nested deeper than {DEEPEST} levels.", title=TITLE)
        if self._lines[self._at].startswith("-") and not _is_scalar(self._lines[self._at]):
            return self._parse_list(indent, depth)
        values: dict[str, object] = {}
        while self._at < len(self._lines) and self._indents[self._at] >= indent:
            entry = _ENTRY.match(self._lines[self._at])
            self._at += 1
            if entry is None:
                continue
            value = entry["value"]
            values[entry["name"]] = self._parse_below(indent, depth) if value is None else _parse_scalar(value)
        return values

    def _parse_below(self, indent: int, depth: int) -> object:
        """Return what stands in the lines below a name; None where it has no value."""
        if self._at >= len(self._lines):
            return None
        own = self._indents[self._at]
        is_list = self._lines[self._at].startswith("-")
        # The items of a list may stand below the first letter of its name.
        return self.parse(own, depth + 1) if own > indent or (own == indent and is_list) else None

    def _parse_list(self, indent: int, depth: int) -> list[object]:
        items: list[object] = []
        while self._at < len(self._lines) and self._indents[self._at] == indent and self._lines[self._at][:1] == "-":
            text = self._lines[self._at][1:]
            rest = text.strip()
            if rest and _ENTRY.match(rest) is None:
                items.append(_parse_scalar(rest))
                self._at += 1
            elif rest:
                # The item is an object that begins behind the dash.
                inner = indent + 1 + len(text) - len(text.lstrip())
                self._lines[self._at], self._indents[self._at] = rest, inner
                items.append(self.parse(inner, depth + 1))
            else:
                self._at += 1
                items.append(self._parse_below(indent, depth))
        return items


_NUMBER = re.compile(r"^[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?$")
_NO_NUMBERS = {"nan": float("nan"), "inf": float("inf"), "-inf": float("-inf")}
_BETWEEN = re.compile(r"[\s,;]+")
_LONGEST_WHOLE = 20
"""Digits of a number that is read without rounding, as nanoseconds since 1970 need."""


def _is_table_row(line: str) -> bool:
    cells = _BETWEEN.split(line.strip())
    return len(cells) > 1 and all(_NUMBER.match(cell) for cell in cells if cell)


def _is_scalar(text: str) -> bool:
    return _NUMBER.match(text) is not None


def _parse_scalar(text: str) -> object:
    """Return a value that stands on one line: a number, a list, or text."""
    if text[0] in "[(" and text[-1] in ")]":
        inner = text[1:-1].strip()
        if inner.startswith(("[", "(", "{")):
            return None  # matrices and lists of objects are no signals of the joints
        return [_parse_scalar(item) for item in _BETWEEN.split(inner) if item]
    if _NUMBER.match(text):
        is_whole = len(text) < _LONGEST_WHOLE and not any(sign in text for sign in ".eE")
        return int(text) if is_whole else float(text)
    bare = text.strip("'\"")
    return _NO_NUMBERS.get(bare.casefold().removeprefix("."), bare)
