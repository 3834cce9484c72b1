"""What goes wrong for a reason that the user can mend."""

from __future__ import annotations


class DynidentError(ValueError):
    """Input that cannot be used as it is; the message says what is wrong, where, and what would be right.

    Parameters
    ----------
    detail : str
        The sentence for the user.
    pointer : str
        Where: a JSON pointer into the request ("/drives/joint2/drive_gain"), a column of a file ("q3"), or "".
    title : str
        A few words for the kind of problem, the same for every instance of it.
    """

    def __init__(self, detail: str, *, pointer: str = "", title: str = "Unusable input") -> None:
        super().__init__(detail)
        self.detail = detail
        self.pointer = pointer
        self.title = title

    def __reduce__(self) -> tuple[object, ...]:
        # Crosses process borders with its fields (jobs run in child processes).
        return (_rebuild, (type(self), self.detail, self.pointer, self.title))


class Cancelled(Exception):
    """Raised by a progress callback to stop a computation that the user no longer wants."""


def _rebuild(kind: type[DynidentError], detail: str, pointer: str, title: str) -> DynidentError:
    error = kind.__new__(kind)
    DynidentError.__init__(error, detail, pointer=pointer, title=title)
    return error
