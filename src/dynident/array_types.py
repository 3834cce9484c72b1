"""Type aliases for numpy arrays by the type of their elements; shapes stand in the docstrings of their users."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
# The type that numpy's searches and sorts return: positions in another array.
IndexArray = NDArray[np.intp]
