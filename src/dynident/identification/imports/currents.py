"""What has to be known of currents before torques can be made of them."""

from __future__ import annotations

from collections.abc import Sequence

from dynident.arrays import FloatArray
from dynident.identification.imports.effort import is_as_described
from dynident.identification.imports.fits import Fits
from dynident.identification.imports.proposal import Question

_BY_THE_CONTROLLER = ("MACur",)
"""Currents that makers' handbooks give in per cent of the largest one, and much software takes for A."""


def question_of_gains(
    shown: str, unit: str | None, gains: Sequence[float | None], fits: Fits, columns: tuple[FloatArray, FloatArray]
) -> Question | None:
    """Ask for drive gains, or whether they are per unit of these currents; None where neither is needed.

    `shown` are the currents' names, `unit` what these state, `columns` positions (m, n) in SI and currents (m, n).
    """
    known = all(gain is not None for gain in gains)
    if any(word in shown for word in _BY_THE_CONTROLLER):
        per = "A, or per cent of the largest current if the controller sends that, as its handbook says"
        if not known:
            return Question("drives", f"{shown} are currents: give the drive gains of the joints in N m/{per}.")
        if is_as_described(fits, *columns, gains):
            return None
        return Question(
            "drives",
            f"{shown} are in {per}: are the robot's drive gains in N m per unit of that? With them they are not the "
            "torque that the description's inertias need.",
        )
    if known:
        return None
    if unit in ("permille", "percent"):
        return Question("drives", f"{shown} are in {unit}: give the drive gains in N m per {unit}.")
    return Question("drives", f"{shown} are currents: give the drive gains of the joints in N m/A.")
