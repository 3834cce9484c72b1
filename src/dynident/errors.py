"""`DynidentError`: errors that a user can remove, with place and remedies; names that are misspelt; `Cancelled`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Remedy:
    """A field of a request with a value that would put right what is wrong.

    Its text, which a sentence quotes, is JSON as over HTTP: `"units": {"q": "deg"}`. Command line and Python write it
    in their own syntax (`word_remedies`).

    Parameters
    ----------
    field : str
        Name of a field of the recording's metadata or of the robot.
    value : object
        The value, of the types of JSON; `...` where only the user can know it.
    """

    field: str
    value: object = ...

    def __str__(self) -> str:
        return f'"{self.field}": {_write_json(self.value)}'


def word_remedies(text: str, remedies: Iterable[Remedy], write: Callable[[Remedy], str]) -> str:
    """Return a sentence with its remedies in another syntax.

    Parameters
    ----------
    text : str
        The sentence, which quotes the remedies.
    remedies : iterable of Remedy
        Those of the check or the error.
    write : function
        Returns a remedy as it is written there.
    """
    for remedy in remedies:
        text = text.replace(str(remedy), write(remedy))
    return text


def _write_json(value: object) -> str:
    # Not by the module json, which knows neither a value to be filled in nor short numbers.
    if isinstance(value, Mapping):
        return "{" + ", ".join(f'"{key}": {_write_json(item)}' for key, item in value.items()) + "}"
    if isinstance(value, (tuple, list)):
        return "[" + ", ".join(map(_write_json, value)) + "]"
    if isinstance(value, str):
        return f'"{value}"'
    return "…" if value is ... else f"{value:g}" if isinstance(value, float) else str(value)


def suggest_names(name: str, known: Iterable[str]) -> str:
    """Return "; did you mean 'stribeck'?" for a name that is none of the known ones; "" where nothing is near.

    Parameters
    ----------
    name : str
        The name that was given.
    known : iterable of str
        The names that there are.
    """
    from difflib import get_close_matches

    near = get_close_matches(name, list(known), n=3, cutoff=0.7)
    return f"; did you mean {' or '.join(map(repr, near))}?" if near else ""


class DynidentError(ValueError):
    """Raised for input that cannot be used as it is; the message says what is wrong, where, and what would be right.

    Parameters
    ----------
    detail : str
        The sentence for the user.
    pointer : str
        The place: a JSON pointer into the request ("/drives/joint2/drive_gain"), a column of a file ("q3"), or "".
    title : str
        A few words for the kind of problem, the same for every instance of it.
    remedies : tuple of Remedy
        Those that the sentence quotes.
    """

    def __init__(
        self, detail: str, *, pointer: str = "", title: str = "Unusable input", remedies: tuple[Remedy, ...] = ()
    ) -> None:
        super().__init__(detail)
        self.detail = detail
        self.pointer = pointer
        self.title = title
        self.remedies = remedies

    def __reduce__(self) -> tuple[object, ...]:
        # Jobs run in child processes. By default an exception is pickled with its `args` alone, which would lose
        # pointer and title.
        return (_rebuild, (type(self), self.detail, self.pointer, self.title, self.remedies))


def check_names(owner: str, given: Iterable[str], known: Iterable[str]) -> None:
    """Check the names of arguments.

    Parameters
    ----------
    owner : str
        The function or class that takes them.
    given, known : iterable of str
        Names that it was given, and those that it takes.

    Raises
    ------
    DynidentError
        For the first that it does not take: says which it takes.
    """
    names = [name for name in known if name not in ("self", "cls")]
    unknown = next((name for name in given if name not in names), None)
    if unknown is None:
        return
    nearest = suggest_names(unknown, names) or "."
    detail = f"{owner} takes no argument {unknown!r}{nearest} Its arguments are: {', '.join(names)}"
    raise DynidentError(detail, pointer=unknown, title="Unknown argument")


class Cancelled(Exception):
    """Raised by a progress callback to stop a computation that the user no longer wants."""


def _rebuild(
    kind: type[DynidentError], detail: str, pointer: str, title: str, remedies: tuple[Remedy, ...]
) -> DynidentError:
    # Subclasses have constructors with further parameters. Only the fields of this class cross the border.
    error = kind.__new__(kind)
    DynidentError.__init__(error, detail, pointer=pointer, title=title, remedies=remedies)
    return error
