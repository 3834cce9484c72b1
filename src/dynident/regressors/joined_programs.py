"""Evaluate an observation matrix that grew by columns: the compiled program of the earlier columns stays in use."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dynident.arrays import FloatArray
from dynident.expressions import Program


class ConcatenatedPrograms:
    """Two programs evaluated together: the entries of the first, then those of the second.

    Parameters
    ----------
    first, second : programs
    widths : widths of the inputs of both together
    picks : one an input
        Which of its columns the second program reads, in its order; the first reads the leading ones.
    """

    def __init__(
        self,
        first: Program | ConcatenatedPrograms,
        second: Program | ConcatenatedPrograms,
        widths: Sequence[int],
        picks: Sequence[NDArray[np.intp] | slice],
    ) -> None:
        self._first, self._second = first, second
        self.widths = tuple(widths)
        self._picks = tuple(picks)
        self.n_outputs: int = first.n_outputs + second.n_outputs

    @property
    def n_instructions(self) -> int:
        """Number of operations a sample."""
        return self._first.n_instructions + self._second.n_instructions

    def __call__(self, *inputs: FloatArray, out: FloatArray | None = None) -> FloatArray:
        """Evaluate on samples, as a `Program` does."""
        if out is None:
            length = next(len(item) for item in inputs if item.ndim == 2)
            out = np.empty((length, self.n_outputs))
        border = self._first.n_outputs
        # Inputs only ever grow at their ends, so that the first program reads the leading columns.
        leading = [item[..., :width] for item, width in zip(inputs, self._first.widths, strict=True)]
        self._first(*leading, out=out[:, :border])
        picked = [item[..., pick] for item, pick in zip(inputs, self._picks, strict=True)]
        self._second(*picked, out=out[:, border:])
        return out
