"""Errors whose cause the user can remove."""

from __future__ import annotations


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
    """

    def __init__(self, detail: str, *, pointer: str = "", title: str = "Unusable input") -> None:
        super().__init__(detail)
        self.detail = detail
        self.pointer = pointer
        self.title = title

    def __reduce__(self) -> tuple[object, ...]:
        # Jobs run in child processes. By default an exception is pickled with its `args` alone, which would lose
        # pointer and title.
        return (_rebuild, (type(self), self.detail, self.pointer, self.title))


class Cancelled(Exception):
    """Raised by a progress callback to stop a computation that the user no longer wants."""


def _rebuild(kind: type[DynidentError], detail: str, pointer: str, title: str) -> DynidentError:
    # Subclasses have constructors with further parameters. Only the fields of this class cross the border.
    error = kind.__new__(kind)
    DynidentError.__init__(error, detail, pointer=pointer, title=title)
    return error
