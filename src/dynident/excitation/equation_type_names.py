"""Names of the identification models whose rows a criterion can be computed from."""

from __future__ import annotations

from typing import Literal, get_args

RowModelName = Literal["dynamic", "filtered", "energy", "power"]
ROW_MODELS: tuple[RowModelName, ...] = get_args(RowModelName)
