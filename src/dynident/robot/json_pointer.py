"""JSON pointers (RFC 6901), lists of names for messages, and texts that can be written down."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable

from dynident.errors import DynidentError

_CONTROL = ("Cc", "Cs", "Zl", "Zp")
"""Control characters, halves of characters, and separators of lines and paragraphs."""


def make_pointer(*tokens: object, within: str = "") -> str:
    """Join `tokens` to the pointer `within`, escaping what RFC 6901 asks to escape."""
    escaped = (str(token).replace("~", "~0").replace("/", "~1") for token in tokens)
    return within + "".join(f"/{token}" for token in escaped)


def join_names(names: Iterable[str]) -> str:
    """Return names joined for a sentence: 'a, b, c', or 'none' if there are none."""
    return ", ".join(names) or "none"


def check_unicode(text: str, at: str, title: str) -> None:
    """Refuse a text with half of a character (a lone surrogate), which no file and no response can hold.

    Parameters
    ----------
    text : str
        The text.
    at : str
        JSON pointer to it in the caller's request.
    title : str
        Title of errors.

    Raises
    ------
    DynidentError
        With the line.
    """
    try:
        text.encode()
    except UnicodeEncodeError as error:
        line = text.count("\n", 0, error.start) + 1
        detail = f"line {line}: {text[error.start]!a} is half of a character; write the text as UTF-8."
        raise DynidentError(detail, pointer=at, title=title) from None


def check_name(name: str, at: str, title: str) -> None:
    """Refuse a name with line breaks or other control characters: names are used in table headers and messages.

    Parameters
    ----------
    name : str
        The name.
    at : str
        JSON pointer to the description in the caller's request.
    title : str
        Title of errors.

    Raises
    ------
    DynidentError
        With the name and the character.
    """
    control = next((character for character in name if unicodedata.category(character) in _CONTROL), None)
    if control is not None:
        detail = f"The name {name[:80]!a} holds {control!a}; names are of one line, without control characters."
        raise DynidentError(detail, pointer=at, title=title)
