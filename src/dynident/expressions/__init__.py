"""Symbolic expressions as machine code over many samples."""

from dynident.expressions.compiled_expressions import Program, Recurrence
from dynident.expressions.llvm_translation import UnsupportedOperationError

__all__ = ["Program", "Recurrence", "UnsupportedOperationError"]
