"""Type aliases of numpy arrays (`FloatArray`, `IndexArray`, …)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
# The type that numpy's searches and sorts return: positions in another array.
IndexArray = NDArray[np.intp]
