"""Rows of the observation matrix W from recordings and effects, accumulated in triangular factors; base parameters."""

from __future__ import annotations

from typing import Literal, get_args

RowModelName = Literal["dynamic", "filtered", "energy", "power"]
ROW_MODELS: tuple[RowModelName, ...] = get_args(RowModelName)
"""Names of the equation types for which a design criterion can be computed."""
