"""The error of conformance checks, and a function that raises it."""

from __future__ import annotations


class ConformanceError(AssertionError):
    """Error: an effect or an estimator does not meet a requirement; the message tells which."""


def require(holds: object, message: str) -> None:
    """Raise `ConformanceError` with the message unless `holds` is true.

    Parameters
    ----------
    holds : object
        The requirement; true where it is met.
    message : str
        What is wrong, for the author of the effect or estimator.

    Raises
    ------
    ConformanceError
        Where the requirement is not met.
    """
    if not holds:
        raise ConformanceError(message)
