"""What is raised where something does not keep to the rules."""

from __future__ import annotations


class ConformanceError(AssertionError):
    """An effect or an estimator does not keep to what others rely on; the message says how."""


def expect(holds: object, message: str) -> None:
    """Raise `ConformanceError` with that message unless it holds."""
    if not holds:
        raise ConformanceError(message)
