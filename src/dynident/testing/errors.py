"""The error of conformance checks, and a function that raises it."""

from __future__ import annotations


class ConformanceError(AssertionError):
    """Error: an effect or an estimator does not meet a requirement; the message tells which."""


def require(holds: object, message: str) -> None:
    """Raise `ConformanceError` with the message unless `holds` is true."""
    if not holds:
        raise ConformanceError(message)
