"""Ask what has to be known of currents before torques can be computed from them."""

from __future__ import annotations

from collections.abc import Sequence

from dynident.arrays import FloatArray
from dynident.identification.imports.effort import is_as_described
from dynident.identification.imports.fits import DynamicsFits
from dynident.identification.imports.proposal import Question

_BY_THE_CONTROLLER = ("MACur",)
"""Names of currents that makers' handbooks give in per cent of the largest one, and much software takes for A."""


def ask_for_gains(
    names: str,
    unit: str | None,
    gains: Sequence[float | None],
    fits: DynamicsFits,
    columns: tuple[FloatArray, FloatArray],
) -> Question | None:
    """Ask for drive gains, or whether they are per unit of these currents; None where neither is needed.

    Parameters
    ----------
    names : str
        Of the columns.
    unit : str, optional
        What the names state.
    gains : sequence of float or None
        The robot's drive gains.
    fits : Fits
        Of the sample.
    columns : pair of (m, n)
        Positions in SI, and currents.
    """
    known = all(gain is not None for gain in gains)
    if any(word in names for word in _BY_THE_CONTROLLER):
        per = "A, or per cent of the largest current if the controller sends that, as its handbook says"
        if not known:
            return Question("drives", f"{names} are currents: give the drive gains of the joints in N m/{per}.")
        # With gains that fit the description, the unit of the gains is that of the currents, whatever it is called.
        if is_as_described(fits, *columns, gains):
            return None
        return Question(
            "drives",
            f"{names} are in {per}: are the robot's drive gains in N m per unit of that? With them they are not the "
            "torque that the description's inertias need.",
        )
    if known:
        return None
    if unit in ("permille", "percent"):
        return Question("drives", f"{names} are in {unit}: give the drive gains in N m per {unit}.")
    return Question("drives", f"{names} are currents: give the drive gains of the joints in N m/A.")
