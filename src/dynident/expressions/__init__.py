"""Symbolic expressions as machine code over many samples."""

from dynident.expressions.llvm_translation import UnsupportedOperationError
from dynident.expressions.program import Program
from dynident.expressions.recurrence import Recurrence

__all__ = ["Program", "Recurrence", "UnsupportedOperationError"]
