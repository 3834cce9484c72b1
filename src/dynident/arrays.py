"""Kinds of array, by what is in them; their shapes stand where they are used."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
# What numpy's own searches and sorts give: positions in another array.
IndexArray = NDArray[np.intp]
