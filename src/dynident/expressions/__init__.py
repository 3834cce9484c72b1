"""Symbolic expressions as machine code over many samples."""

from dynident.expressions.program import Program
from dynident.expressions.recurrence import Recurrence
from dynident.expressions.translation import UnsupportedOperationError

__all__ = ["Program", "Recurrence", "UnsupportedOperationError"]
