"""Weighted least squares, moved to the nearest parameters of a robot that can exist where that costs nothing."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.identification.methods.estimators.wls import Weighted


@dataclass(frozen=True)
class Auto(Weighted):
    """Weighted least squares that are feasible where that is free."""

    name = "auto"
    label = "weighted least squares, feasible where free"
    words = "Weighted least squares, moved to bodies that can exist where the fit hardly changes. The usual choice."
    brief = "wls, made feasible where that costs less than 2 % of the error"
    place = 0
    possible_where_free = True
