"""Encode any text to bytes and XML: lone surrogates and control characters are replaced."""

from __future__ import annotations

import codecs
import re

NOT_XML = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ufffe\uffff]")
"""Characters that no XML document may hold, not even escaped."""


def replace_control_characters(text: str) -> str:
    """Replace all characters that an XML document may not hold by U+FFFD, the replacement character.

    Parameters
    ----------
    text : str
        Any text.

    Returns
    -------
    str
        A text of the same length.
    """
    # Replaced, not removed: positions in the text stay what they are.
    return NOT_XML.sub("\ufffd", text)


def decode_document(data: bytes) -> str:
    """Return the text of a document in UTF-8 or UTF-16, with or without a mark of its encoding; XML also in Latin 1.

    Raises
    ------
    UnicodeDecodeError
        For other bytes.
    """
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        # In XML nothing but comments and names of files has other letters than ASCII as a rule.
        if not data.lstrip().startswith(b"<"):
            raise
        return data.decode("cp1252", errors="replace")


_JAPANESE_WORD = re.compile(rb"(?:[\x81-\x9f][\x40-\x7e\x80-\xfc]){2,}")
"""Two or more letters of Shift-JIS in a row; most begin below A0, where western text has single signs and letters."""

_SIGNS = b"\xb0\xb2\xb3\xb5\xb7"
"""Degree, square, cube, micro and the point between units: the same in the code pages of the west and of Cyrillic."""


def decode_unmarked_text(data: bytes) -> tuple[str, str]:
    """Return text that is no UTF-8, and its encoding: of Japan, Cyrillic, Korea, China, else of western Europe.

    Parameters
    ----------
    data : bytes
        The beginning of a text; the last character may be cut off.

    Returns
    -------
    text, encoding : str
        The text, and the name of its codec.
    """
    runs = _find_high_runs(data)
    n_high = sum(map(len, runs))
    paired = sum(len(run) % 2 == 0 for run in runs) > 0.9 * len(runs)
    # Signs are left out only where they cannot be halves of pairs.
    letters = runs if paired else _find_high_runs(data.translate(None, _SIGNS))
    n_letters = sum(map(len, letters))
    words = [run for run in runs if len(run) >= 4]
    candidates = []
    if 2 * sum(byte >= 0x80 for byte in b"".join(_JAPANESE_WORD.findall(data))) >= n_high:
        candidates = ["cp932", "gb18030"]
    elif sum(byte >= 0xC0 for byte in b"".join(letters)) > 0.95 * n_letters and n_letters > 2 * len(letters):
        candidates = ["cp1251"]
    # Words of Korea and China are pairs of bytes above A0; western text has two such letters in a row, but not four.
    elif paired and len(words) > 1 and 2 * sum(map(len, words)) >= n_high:
        # Korean letters begin with B0 to C8.
        korean = all(0xB0 <= byte <= 0xC8 for run in runs if len(run) % 2 == 0 for byte in run[::2])
        candidates = ["cp949", "gb18030"] if korean else ["gb18030", "cp949"]
    for encoding in candidates:
        try:
            return codecs.getincrementaldecoder(encoding)().decode(data), encoding
        except UnicodeDecodeError:
            continue
    return data.decode("cp1252", errors="replace"), "cp1252"


def _find_high_runs(data: bytes) -> list[bytes]:
    """Find all runs of bytes that are not ASCII."""
    return re.findall(rb"[\x80-\xff]+", data)


def encode_text(text: str) -> bytes:
    r"""Encode a text as UTF-8; write halves of surrogate pairs, which have no code, as escapes: "\ud800".

    Names of files that are no UTF-8 hold such halves, and so may JSON.

    Parameters
    ----------
    text : str
        Any text, lone surrogates included.

    Returns
    -------
    bytes
        UTF-8.
    """
    return text.encode("utf-8", "backslashreplace")


def escape_surrogates(text: str) -> str:
    """Return a text with its lone surrogates escaped as by `encode_text`, for writers that encode by themselves.

    Parameters
    ----------
    text : str
        Any text, lone surrogates included.

    Returns
    -------
    str
        A text that every UTF-8 writer takes.
    """
    return encode_text(text).decode("utf-8")
