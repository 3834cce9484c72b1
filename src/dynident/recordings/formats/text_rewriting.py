"""Text that is rewritten as it is read, so that every row has its cells between single delimiters."""

from __future__ import annotations

import codecs
import re
from collections.abc import Callable
from typing import IO

from dynident.recordings.file_limits import LARGEST_MESSAGE, TITLE
from dynident.recordings.formats.text_streams import ProducedStream
from dynident.recordings.metadata import RecordingError

_READ_BYTES = 1 << 18
_LIST = re.compile(
    r'(?P<before>^|[,;\t|])[ ]*"?(?:[A-Za-z.]+\()?[\[(](?P<items>[^\[\]()]*)[\])](?:\s*,[^\[\]()"]*\))?\)?"?'
    r"(?=[ ]*(?:[,;\t|]|\r?$))",
    re.MULTILINE,
)
"""A cell that is a list: `[0.1, 0.2]`, `"(0.1, 0.2)"`, `[0.1 0.2]` over several lines, `array([0.1, 0.2])`."""
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
    items = [item.strip("'\" ") for item in _BETWEEN.split(cell["items"].strip())]
    if items and not items[-1]:
        items.pop()  # the comma of a tuple of one
    return before + write(items, before or ",")


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
        self._at_end = False

    def read_part(self, size: int) -> bytes:
        """Return the next bytes of the rewritten text."""
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
            raise RecordingError("A line of the file does not end, or a list in it is not closed.", title=TITLE)
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
