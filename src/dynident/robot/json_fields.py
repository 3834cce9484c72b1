"""Read fields of JSON: numbers, also as text ("pi/2"), names, depth; errors point to their place (JSON pointers)."""

from __future__ import annotations

import json
import math
import re
import reprlib
import unicodedata
from collections.abc import Iterable, Mapping, Sequence

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
        detail = f"line {line}: {text[error.start]!a} is an incomplete character; save the text as UTF-8."
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
        detail = f"The name {name[:80]!a} contains {control!a}; a name must be one line without control characters."
        raise DynidentError(detail, pointer=at, title=title)


DEEPEST = 64
"""Largest depth of nested lists and objects; a table of a robot with loops has six."""
_NUMBER = r"(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?"
_EXPRESSION = re.compile(rf"([+-]?)\s*(?:({_NUMBER})\s*\*\s*)?(pi|π)\s*(?:/\s*({_NUMBER}))?")


def parse_json(text: str, at: str, title: str) -> object:
    """Return the value of a JSON text.

    Parameters
    ----------
    text : str
        The text.
    at : str
        JSON pointer to it in the caller's request.
    title : str
        Title of errors.

    Returns
    -------
    object
        Of dicts, lists, texts, numbers, truth values and None.

    Raises
    ------
    DynidentError
        With line and column, where the text is malformed or nested too deeply.
    """
    try:
        value: object = json.loads(text)
    except json.JSONDecodeError as error:
        detail = f"line {error.lineno}: The JSON is malformed at column {error.colno}: {error.msg}."
        raise DynidentError(detail, pointer=at, title=title) from None
    # Python's parser works by recursion, and gives up on texts that are nested some thousand times.
    except RecursionError:
        raise _make_depth_error(at, title) from None
    except ValueError as error:  # a number of thousands of digits
        raise DynidentError(f"The JSON cannot be read: {error}.", pointer=at, title=title) from None
    _check_value(value, at, title)
    return value


def _check_value(value: object, at: str, title: str) -> None:
    """Refuse a value that is nested deeper than any description, or whose texts are not Unicode."""
    # Go through the value level by level instead of by recursion, so that a deep value cannot exhaust the stack.
    level: list[object] = [value]
    for _ in range(DEEPEST):
        below: list[object] = []
        for item in level:
            if isinstance(item, str):
                check_unicode(item, at, title)
            elif isinstance(item, dict):
                below += [*item.keys(), *item.values()]
            elif isinstance(item, list):
                below += item
        level = below
    if level:
        raise _make_depth_error(at, title)


def _make_depth_error(at: str, title: str) -> DynidentError:
    detail = f"The JSON is nested too deeply; at most {DEEPEST} levels are allowed."
    return DynidentError(detail, pointer=at, title=title)


def expect_mapping(value: object, allowed: Iterable[str], at: str, title: str) -> Mapping[str, object]:
    """Return a value as an object that has no unknown keys.

    Parameters
    ----------
    value : object
        A JSON value.
    allowed : iterable of str
        The keys that it may have.
    at : str
        JSON pointer to it in the caller's request.
    title : str
        Title of errors.

    Returns
    -------
    mapping of str to object
        The value itself.

    Raises
    ------
    DynidentError
        For any other value or key.
    """
    allowed = tuple(allowed)
    if not isinstance(value, Mapping):
        raise DynidentError(f"Expected an object with {join_names(allowed)}.", pointer=at, title=title)
    for key in value:
        if key not in allowed:
            detail = f"Unknown field '{key}'; expected {join_names(allowed)}."
            raise DynidentError(detail, pointer=make_pointer(key, within=at), title=title)
    return value


def expect_text(value: object, at: str, title: str) -> str:
    """Return a value as a text that is not empty.

    Parameters
    ----------
    value : object
        A JSON value.
    at : str
        JSON pointer to it in the caller's request.
    title : str
        Title of errors.

    Returns
    -------
    str
        The value itself.

    Raises
    ------
    DynidentError
        For any other value.
    """
    if not isinstance(value, str) or not value.strip():
        raise DynidentError("Expected a non-empty text.", pointer=at, title=title)
    return value


def expect_number(value: object, at: str, title: str) -> float:
    """Return a finite number, also from texts such as "0.5", "pi/2" and "-3*pi/4".

    Parameters
    ----------
    value : object
        A JSON value.
    at : str
        JSON pointer to it in the caller's request.
    title : str
        Title of errors.

    Returns
    -------
    float
        Finite.

    Raises
    ------
    DynidentError
        For any other value.
    """
    number = math.nan
    # To Python, JSON's true and false are whole numbers.
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        number = _to_float(value)
    elif isinstance(value, str):
        number = _evaluate_expression(value.strip())
    if not math.isfinite(number):
        detail = f'{reprlib.repr(value)} is not a number; expected one such as 0.5, "pi/2" or "-3*pi/4".'
        raise DynidentError(detail, pointer=at, title=title)
    return number


def expect_numbers(value: object, count: int, at: str, title: str) -> tuple[float, ...]:
    """Return a list of finite numbers.

    Parameters
    ----------
    value : object
        A JSON value.
    count : int
        How many there have to be.
    at : str
        JSON pointer to it in the caller's request.
    title : str
        Title of errors.

    Returns
    -------
    tuple of float
        As many as `count`.

    Raises
    ------
    DynidentError
        For any other value.
    """
    if not isinstance(value, (list, tuple)) or len(value) != count:
        raise DynidentError(f"Expected a list of {count} numbers.", pointer=at, title=title)
    return tuple(expect_number(item, make_pointer(index, within=at), title) for index, item in enumerate(value))


def _to_float(value: float) -> float:
    try:
        return float(value)
    except OverflowError:
        # A whole number of hundreds of digits has no float; it counts as infinite, and is refused.
        return math.inf


def _evaluate_expression(text: str) -> float:
    if re.fullmatch(rf"[+-]?{_NUMBER}", text):
        return float(text)
    match = _EXPRESSION.fullmatch(text)
    if match is None or (match[4] is not None and float(match[4]) == 0.0):
        return math.nan
    value = float(match[2] or 1) * math.pi / float(match[4] or 1)
    return -value if match[1] == "-" else value


def expect_names(value: object, at: str, title: str) -> list[str]:
    """Return a value as a list of texts that are not empty.

    Parameters
    ----------
    value : object
        A JSON value.
    at : str
        JSON pointer to it in the caller's request.
    title : str
        Title of errors.

    Returns
    -------
    list of str

    Raises
    ------
    DynidentError
        For any other value.
    """
    if not isinstance(value, Sequence) or isinstance(value, str):
        raise DynidentError("Expected a list of names.", pointer=at, title=title)
    return [expect_text(name, f"{at}/{k}", title) for k, name in enumerate(value)]
