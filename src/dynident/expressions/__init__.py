"""Symbolic expressions as machine code over many samples."""

from dynident.expressions.llvm_translation import UnsupportedOperationError
from dynident.expressions.program import Program, Recurrence

__all__ = ["Program", "Recurrence", "UnsupportedOperationError"]
