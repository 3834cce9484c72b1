"""Bytes of a text file, decompressed or rewritten while they are read, with a limit."""

from __future__ import annotations

import codecs
import io
import re
from abc import abstractmethod
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import IO, TYPE_CHECKING

import pyarrow as pa

from dynident.recordings.file_size_limits import (
    LARGEST_MESSAGE,
    MOST_TEXT,
    TITLE,
    UnpackedSize,
    make_damaged_error,
)
from dynident.recordings.recording_metadata import RecordingError
from dynident.recordings.time_columns import is_time_name
from dynident.text_encoding import decode_unmarked_text

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer


class ProducedStream(io.RawIOBase):
    """A readable stream; a subclass produces the next bytes."""

    @abstractmethod
    def read_part(self, size: int) -> bytes:
        """Return the next bytes, at most `size`; none at the end."""

    def readable(self) -> bool:
        """Return True."""
        return True

    def readinto(self, buffer: WriteableBuffer, /) -> int:
        """Put the next bytes into a buffer; return how many."""
        view = memoryview(buffer)
        part = self.read_part(len(view))
        view[: len(part)] = part
        return len(part)


_COMPRESSIONS = ((b"\x1f\x8b", "gzip"), (b"\x28\xb5\x2f\xfd", "zstd"), (b"BZh", "bz2"), (b"\x04\x22\x4d\x18", "lz4"))
"""First bytes, and what Arrow calls the compression."""


class TextContent:
    """A file of text that can be read from its beginning as often as needed.

    Parameters
    ----------
    path : path
        Where it lies; compressed with gzip, zstd, bzip2 or lz4 it is unpacked as it is read.
    member : callable, optional
        Opens a part of the file instead of all of it.
    """

    def __init__(self, path: Path, member: Callable[[], IO[bytes]] | None = None) -> None:
        self._path, self._member = path, member
        self.compression = None if member is not None else detect_compression(path)

    @property
    def plain_path(self) -> Path | None:
        """The path of the file if its bytes are the text, else None."""
        return self._path if self._member is None and self.compression is None else None

    def open(self) -> IO[bytes]:
        """Open the text; decompressing to more than such files do raises `RecordingError` while it is read."""
        if self._member is not None:
            return self._member()
        if self.compression is None:
            return self._path.open("rb")
        # In large pieces: a call of the decompressor for every line would take most of the time.
        return io.BufferedReader(_DecompressedStream(self._path, self.compression), 1 << 20)

    def replace_text(self, open_text: Callable[[], IO[bytes]]) -> TextContent:
        """Return the file with another text, which is opened by a function; its name stays."""
        return TextContent(self._path, open_text)

    def read_start(self, size: int) -> bytes:
        """Return the first bytes."""
        with self.open() as file:
            return file.read(size)


def detect_compression(path: Path) -> str | None:
    """Return the compression of a file by its first bytes; None if there is none."""
    with path.open("rb") as file:
        start = file.read(4)
    return next((name for first, name in _COMPRESSIONS if start.startswith(first)), None)


class _DecompressedStream(ProducedStream):
    """Decompresses a file, and counts the bytes."""

    def __init__(self, path: Path, compression: str) -> None:
        super().__init__()
        self._compression = compression
        self._size = UnpackedSize(path.stat().st_size, MOST_TEXT)
        self._file = pa.CompressedInputStream(pa.OSFile(str(path)), compression)

    def read_part(self, size: int) -> bytes:
        """Decompress the next bytes."""
        try:
            part: bytes = self._file.read(size)
        except (OSError, ValueError) as error:
            raise make_damaged_error(self._compression, error) from error
        # Counted as it comes: what a file unpacks to is not known before.
        self._size.add(len(part))
        return part

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        super().close()


_READ_BYTES = 1 << 18
_ITEM = r"[+-]?(?:\d+(?:\.\d*)?|\.\d+|nan|NaN|inf)(?:[eE][+-]?\d+)?"
_LIST = re.compile(
    r'(?P<before>^|[,;\t|])[ ]*"?(?:(?:[A-Za-z.]+\()?[\[(](?:\[(?=[^\[\]]*\]\s*\]))?'
    r'(?=\s*[\])]|[^\[\](){}]*(?:[\'",]|(?<![A-Za-z_\d])\d|[Nn]a[Nn]|inf))'
    r'(?P<items>[^\[\](){}]*)[\])](?:\s*\])?(?:\s*,[^\[\](){}"\n]*\))?\)?'
    rf"|\{{[ ]*(?P<numbers>{_ITEM}(?:[,; \t]+{_ITEM})*)[,; \t]*\}})"
    r'"?(?=[ ]*(?:[,;\t|]|\r?$))',
    re.MULTILINE,
)
"""A cell that is a list: `[0.1, 0.2]`, `"(0.1, 0.2)"`, `{0.1, 0.2}`, `[0.1 0.2]` over several lines,
`array([0.1, 0.2])`, `tensor([[0.1, 0.2]], device='cuda:0')`. Words alone, `[ready]`, are a state. In braces other
cells have objects, or flags: there numbers alone are a list."""
_BETWEEN = re.compile(r"[\s,;]+")
_MARK = "\1"
_TRIES = 64
"""Ends of lines that are tried for one at which all lists are closed."""


def join_open_lists(lines: list[str]) -> list[str]:
    """Join lines between which a list in brackets goes on."""
    whole: list[str] = []
    for line in lines:
        if whole and whole[-1].count("[") > whole[-1].count("]"):
            whole[-1] += f" {line}"
        else:
            whole.append(line)
    return whole


def has_lists(lines: list[str]) -> bool:
    """Return whether cells of the rows below the first line are lists."""
    return sum(1 for line in lines[1:32] if _LIST.search(line)) >= 2


def flatten_lists(text: str) -> str:
    """Return the text with the items of lists in cells of their own."""
    return _LIST.sub(lambda cell: _rewrite_cell(cell, lambda items, mark: mark.join(items)), text)


def count_list_items(line: str, delimiter: str) -> list[int]:
    """Return the number of items of every cell of a row; 1 for a cell that is no list."""
    marked = _LIST.sub(lambda cell: _rewrite_cell(cell, lambda items, _: f"{_MARK}{max(len(items), 1)}"), line)
    return [int(cell.strip()[1:]) if cell.strip().startswith(_MARK) else 1 for cell in marked.split(delimiter)]


def _rewrite_cell(cell: re.Match[str], write: Callable[[list[str], str], str]) -> str:
    before = cell["before"]
    items = [item.strip("'\" ") for item in _BETWEEN.split((cell["numbers"] or cell["items"]).strip())]
    if items and not items[-1]:
        items.pop()  # the comma of a tuple of one
    return before + write(items, before or ",")


_SPACED_QUOTE = re.compile(r'(?m)(^|[,;\t|])[ ]+(?=")')
"""Spaces before the quotes of cells, with which these would not be quotes."""
_FORTRAN = re.compile(r"(?<=[\d.])[dD](?=[+-]\d{1,3}(?!\w))")
"""The exponent of a number as Fortran writes it: 1.5D+02."""
_POINTS = re.compile(r"(?<![\w.,])([+-]?\d{1,3}(?:\.\d{3})+)(?=[,;\t|\s\"]|$)")
_COMMAS = re.compile(r"(?<![\w.,])([+-]?\d{1,3}(?:,\d{3})+)(?![\d,])")
_QUOTED_COMMAS = re.compile(r'(?<=")([+-]?\d{1,3}(?:,\d{3})+)(?=[."])')
"""Signs between thousands: 1.234,5, and 1,234.5, in quotes alone where commas separate the columns."""


_SIGN = re.compile("[\u2212\u2013](?=[.\\d])")
_APOSTROPHES = re.compile("(?<=\\d)['\u2019\u00a0\u2009\u202f](?=\\d{3}(?!\\d))")
"""Signs between thousands that no number is without."""


def has_typographic_signs(text: str) -> bool:
    """Return whether numbers have a minus, or signs between thousands, as print has them."""
    return _SIGN.search(text) is not None or _APOSTROPHES.search(text) is not None


def replace_typographic_signs(text: str) -> str:
    """Return the text with the minus of a keyboard, and nothing between thousands."""
    return _APOSTROPHES.sub("", _SIGN.sub("-", text))


_QUOTED_DECIMAL = re.compile(r'"([+-]?\d+),(\d+(?:[eE][+-]?\d+)?)"')
_OPEN_QUOTE = re.compile(r'"[^"]*"')


def has_quoted_decimals(text: str) -> bool:
    """Return whether cells in quotes have decimal commas; three digits behind all of them are thousands."""
    cells = _QUOTED_DECIMAL.findall(text)
    return any(len(decimals) != _OF_THOUSANDS or whole.lstrip("+-") == "0" for whole, decimals in cells)


def replace_quoted_decimals(text: str) -> str:
    """Return the text with points in numbers in quotes that have commas."""
    return _QUOTED_DECIMAL.sub(r"\1.\2", text)


def has_names_on_lines(text: str) -> bool:
    """Return whether the first line ends within a quoted name, which goes on below."""
    return text.lstrip().partition("\n")[0].count('"') % 2 == 1


def join_names_on_lines(text: str) -> str:
    """Return the text with quoted cells on one line each."""
    return _OPEN_QUOTE.sub(lambda cell: " ".join(cell[0].split()), text)


_OF_THOUSANDS = 3
_CELL_BEGINS, _CELL_ENDS = r"(?m)(^|[,;\t|])[ ]*", r"[ ]*(?=[,;\t|]|\r?$)"
_IN_BRACKETS = re.compile(rf"{_CELL_BEGINS}\(((?:\d[\d.,]*|[.,]\d+)(?:[eE][+-]?\d+)?)\){_CELL_ENDS}")
_MINUS_BEHIND = re.compile(rf"{_CELL_BEGINS}((?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][+-]?\d+)?)-{_CELL_ENDS}")
_MINUS_BEFORE = re.compile(rf"{_CELL_BEGINS}-[.,]?\d")


def has_minus_elsewhere(text: str) -> bool:
    """Return whether negative numbers are in brackets, or have the minus behind them, and none before them."""
    elsewhere = _IN_BRACKETS.search(text) or _MINUS_BEHIND.search(text)
    return elsewhere is not None and _MINUS_BEFORE.search(text) is None


def put_minus_before(text: str) -> str:
    """Return the text with the minus before its numbers."""
    return _MINUS_BEHIND.sub(r"\1-\2", _IN_BRACKETS.sub(r"\1-\2", text))


_NO_CELLS = re.compile(r"(?m)^[;,\t|]{2,}[ ]*(?=\r?$)")
"""Rows of separators alone, which count as none if their lines are empty."""


_STAMP_OF_DIGITS = re.compile(
    r"(?m)(^|[,;\t| \"])((?:19|20)\d\d(?:0[1-9]|1[0-2])(?:0[1-9]|[12]\d|3[01]))"
    r"((?:[01]\d|2[0-3])[0-5]\d[0-5]\d)(\d{0,9})(?=[,;\t| \"]|\r?$)"
)
"""20250506102030005: date, time of day and fraction in one number, which has more digits than a number keeps."""
_MARKED_ROW = re.compile(r"(?m)^[ \t]*[#%]+[ \t]*(?=[-+.]?\d)")
"""The sign of a remark in front of a row of numbers."""
_MOST_LINES = 0.9


def has_stamps_of_digits(text: str) -> bool:
    """Return whether nearly all lines have a date and a time of day in one number."""
    return is_in_most_lines(_STAMP_OF_DIGITS, text)


def separate_stamps(text: str) -> str:
    """Return the text with a T between date and time, and a point before the fraction."""
    return _STAMP_OF_DIGITS.sub(
        lambda stamp: f"{stamp[1]}{stamp[2]}T{stamp[3]}{'.' if stamp[4] else ''}{stamp[4]}", text
    )


def has_marked_rows(text: str) -> bool:
    """Return whether nearly all lines are numbers behind the sign of a remark."""
    return is_in_most_lines(_MARKED_ROW, text)


def unmark_rows(text: str) -> str:
    """Return the text without the signs of remarks in front of rows of numbers."""
    return _MARKED_ROW.sub("", text)


def is_in_most_lines(pattern: re.Pattern[str], text: str) -> bool:
    """Return whether nearly all lines have a pattern."""
    n_lines = text.count("\n")
    return n_lines > 2 and len(pattern.findall(text)) > _MOST_LINES * n_lines


def _replace(pattern: re.Pattern[str], by: str) -> tuple[Callable[[str], bool], Callable[[str], str]]:
    """Return whether a text has a pattern, and the text with something else in its place."""
    return lambda text: pattern.search(text) is not None, partial(pattern.sub, by)


CHANGES_OF_CELLS = (
    (has_marked_rows, unmark_rows),
    (has_stamps_of_digits, separate_stamps),
    (has_minus_elsewhere, put_minus_before),
    _replace(_NO_CELLS, ""),
    (has_names_on_lines, join_names_on_lines),
    (has_quoted_decimals, replace_quoted_decimals),
    _replace(_SPACED_QUOTE, r"\1"),
    _replace(_FORTRAN, "E"),
    (has_typographic_signs, replace_typographic_signs),
)
"""What cells may have that numbers are read without: whether a text has it, and the text without it."""


def join_thousands(text: str, decimal_point: str, delimiter: str) -> str:
    """Return the text with numbers whose thousands are not set apart."""
    if decimal_point == ",":
        return _POINTS.sub(lambda number: number[1].replace(".", ""), text)
    return (_QUOTED_COMMAS if delimiter == "," else _COMMAS).sub(lambda number: number[1].replace(",", ""), text)


def decode_text(start: bytes) -> tuple[str, str]:
    """Return the first bytes as text, and their encoding."""
    if start.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return start.decode("utf-16", errors="ignore"), "utf-16"
    # Without a mark every second byte of western text is 0.
    for odd, encoding in ((1, "utf-16-le"), (0, "utf-16-be")):
        if len(start) > 2 and start[odd::2].count(0) > 0.9 * len(start[odd::2]) and 0 not in start[1 - odd :: 2]:
            return start.decode(encoding, errors="ignore"), encoding
    if b"\0" in start:
        raise RecordingError(
            "The file is neither Parquet nor text, nor in another known format: save the table as CSV or Parquet, or "
            "its arrays with np.savez.",
            title="Unreadable file",
        )
    try:
        return start.decode("utf-8-sig"), "utf-8"
    except UnicodeDecodeError as error:
        # The last character may be cut off.
        if error.start >= len(start) - 4:
            return start[: error.start].decode("utf-8-sig"), "utf-8"
        text, encoding = decode_unmarked_text(start)
        # Names are read from here, and single bytes in cells break no number: only other letters have to be rewritten.
        return text, "utf-8" if encoding == "cp1252" else encoding


_NO_THOUSANDS = r"(?![1-9]\d{0,2}\.\d{3}(?!\d))"
"""Not before 1.000, which is a thousand to some and one to others."""
_RATE = re.compile(
    r"\b(?:(?:sampl|abtast|log|record|control|cycle)\w*[ _-]?(?:rate|freq\w*)|fs)\b\W{0,4}(?:\[?k?hz\W{1,4})?"
    rf"{_NO_THOUSANDS}(\d+(?:\.\d+)?)\s*(k?hz)\b",
    re.IGNORECASE,
)
_PERIOD = re.compile(
    r"\b(?:(?:sampl\w*|cycle)[ _-]?(?:time|period|interval)|time[ _-]?step|abtastzeit|(?-i:dt|Ts)"
    rf"|wf_increment|delta_x)\b\W{{0,4}}{_NO_THOUSANDS}(\d+(?:\.\d+)?(?:e-?\d+)?)\s*(s|ms|us|µs)\b",
    re.IGNORECASE,
)
_INCREMENTS = ("wf_increment", "delta_x")
"""Before the steps of time of channels, in s without a unit, as LabVIEW writes them."""
_UNITS_OF_RATES = {"hz": 1.0, "khz": 1e3, "s": 1.0, "ms": 1e3, "us": 1e6, "µs": 1e6}
_SLOWEST, _FASTEST, _LONGEST_REMARK = 1.0, 1e5, 300
_MONTH = (
    "(?:jan(?:uar)?y?|feb(?:ruar)?y?|mar(?:ch)?|märz?|mrz|apr(?:il)?|ma[iy]|jun[ei]?|jul[iy]?|aug(?:ust)?|"
    "sept?(?:ember)?|o[ck]t(?:ober)?|nov(?:ember)?|de[cz](?:ember)?)[.]?"
)
_DATE = re.compile(
    rf"\s{{0,9}}(?:(?:\d{{1,2}}[. -]{{1,2}})?{_MONTH}[ -]\d{{1,4}}|\d{{1,2}}[.-]{{1,2}} ?{_MONTH}|"
    r"(?:\d{1,2}/){2}\d{2,4})\s{0,9}$",
    re.IGNORECASE,
)
"""Mar 14, 14. Mrz, 14-Mar, 3/14/2024: what spreadsheets make of 3.14. Other words are messages, such as Error 12."""


def refuse_date(column: str, cell: str) -> None:
    """Refuse a date among the numbers of a column, which a spreadsheet made of a number."""
    if _DATE.match(cell):
        raise RecordingError(
            f"Cells of {column} are dates, such as {cell!r}: a spreadsheet took numbers such as 3.14 for dates as it "
            "opened the file, and the numbers are lost. Take the file as it was recorded; in a spreadsheet, import it "
            "with the columns as text, or with the right decimal sign.",
            pointer=column,
            title="Dates in place of numbers",
        )


def find_stated_rate(start: bytes, n_lines: int) -> float | None:
    """Return the Hz that the lines above the rows say in words, such as "Sampling rate: 250 Hz"; None without."""
    rates = set()
    for line in start.decode("utf-8-sig", errors="replace").splitlines()[:n_lines]:
        remark = line[:_LONGEST_REMARK].replace(",", ".")
        rates |= {float(rate[1]) * _UNITS_OF_RATES[rate[2].casefold()] for rate in _RATE.finditer(remark)}
        periods = ((float(period[1]), _UNITS_OF_RATES[period[2].casefold()]) for period in _PERIOD.finditer(remark))
        rates |= {per_second / length for length, per_second in periods if length > 0.0}
        rates |= {1.0 / step for step in _read_increments(line) if step > 0.0}
    return rates.pop() if len(rates) == 1 and all(_SLOWEST <= rate <= _FASTEST for rate in rates) else None


def _read_increments(line: str) -> list[float]:
    """Return the steps of time of all channels, where a line has nothing else."""
    line = line.strip(" \t;,#%").replace('"', "")
    name, *cells = re.split(r"[\t;:= ]+" if re.search(r"[\t;:= ]", line) else ",", line)
    if name.casefold() not in _INCREMENTS:
        return []
    try:
        return [float(cell.replace(",", ".")) for cell in cells]
    except ValueError:
        return []


def squeeze_spaces(text: str) -> str:
    """Return the text with single spaces between columns that were aligned by spaces, and none at the ends."""
    return re.sub(r"(?m)^[ ]+|[ ]+(?=\r?$)", "", re.sub(r"[ \t]+", " ", text))


class RewrittenText(ProducedStream):
    """A stream of text in UTF-8, made of one whose lines are rewritten.

    Parameters
    ----------
    file : binary file
        The text as it is stored.
    rewrite : callables
        Each takes whole lines and gives them back changed.
    encoding : str
        Of the file.
    """

    def __init__(self, file: IO[bytes], rewrite: tuple[Callable[[str], str], ...], encoding: str = "utf-8") -> None:
        super().__init__()
        self._file, self._rewrite = file, rewrite
        self._decode = codecs.getincrementaldecoder(encoding)(errors="replace").decode
        self._waiting, self._ready = "", b""
        self._at_end = self.is_ended = False

    def read_part(self, size: int) -> bytes:
        """Return the next bytes of the rewritten text; none once it is said to end."""
        if self.is_ended:
            return b""
        while not self._ready and not self._at_end:
            self._read_more()
        part, self._ready = self._ready[:size], self._ready[size:]
        return part

    def _read_more(self) -> None:
        part = self._file.read(_READ_BYTES)
        self._at_end = not part
        text = self._waiting + self._decode(part, final=self._at_end)
        # Only whole lines are rewritten: a pattern must not be cut by the border of a block.
        end = len(text) if self._at_end else _find_whole_lines(text)
        if not end and len(text) > LARGEST_MESSAGE:
            raise RecordingError("A line of the file has no end, or a list in it is not closed.", title=TITLE)
        lines, self._waiting = text[:end], text[end:]
        for rewrite in self._rewrite:
            lines = rewrite(lines)
        self._ready = lines.encode()

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        super().close()


def _find_whole_lines(text: str) -> int:
    """Return the length of the leading lines that end, and in which every list is closed."""
    end = len(text)
    for _ in range(_TRIES):
        end = text.rfind("\n", 0, end) + 1
        if not end or text.count("[", 0, end) == text.count("]", 0, end):
            return end
        # This line ends inside a list: try the end of the line before it.
        end -= 1
    return 0


def pair_times(names: tuple[str, ...]) -> tuple[tuple[str, ...], dict[str, str]] | None:
    """Return names in which every second one is the time of the next, and these times; None of others."""
    times, signals = names[::2], names[1::2]
    is_paired = len(names) >= 4 and len(times) == len(signals) and len(set(times)) == 1
    if not is_paired or len(set(signals)) < len(signals) or not (is_time_name(times[0]) or times[0][:1] in "xX"):
        return None
    clocks = {signal: f"{signal}.time" for signal in signals}
    return tuple(name for signal in signals for name in (clocks[signal], signal)), clocks


def number_repeated_names(names: tuple[str, ...]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return names that differ, those that stand several times numbered in their order, and a remark on them."""
    repeated = [name for name, count in Counter(names).items() if name and count > 1]
    if not repeated:
        return names, ()
    numbers = dict.fromkeys(repeated, 0)
    numbered = []
    for name in names:
        if name in numbers:
            numbers[name] += 1
            numbered.append(f"{name}_{numbers[name]}")
        else:
            numbered.append(name)
    # A name with a number is that of one joint: one of the two is a mistake, and nothing says which.
    if len(set(numbered)) < len(numbered) or any(name[-1].isdecimal() for name in repeated):
        raise RecordingError(
            f"Column {repeated[0]} occurs more than once in the file; give every column a name of its own.",
            pointer=repeated[0],
        )
    remark = f"Several columns have the same name ({', '.join(repeated[:6])}): they are numbered as they stand there."
    return tuple(numbered), (remark,)
