"""Recognise motions that are too slow to show inertia, such as slow sweeps: they identify gravity and friction."""

from __future__ import annotations

from collections.abc import Sequence

from dynident.identification.study.result import IdentifiedParameter

LEAST_DETERMINED = 0.1
"""Share of the moments of inertia below which a motion counts as too slow: sweeps at 0.04 to 0.1 rad/s determine none
of an arm's 28, designed motions a third of them."""

_INERTIA, _FIRST_MOMENT = "kg m²", "kg m"


def describe_slow_motion(parameters: Sequence[IdentifiedParameter]) -> str | None:
    """Describe a motion that determines first moments of the links, but hardly any moment of inertia.

    Parameters
    ----------
    parameters : sequence of IdentifiedParameter
        The base parameters of a model.

    Returns
    -------
    str or None
        A sentence; None where the motion shows inertia, or gravity is not determined either.
    """
    inertias, moments = (
        [parameter.judgement == "determined" for parameter in parameters if parameter.unit == unit]
        for unit in (_INERTIA, _FIRST_MOMENT)
    )
    if not inertias or not any(moments) or sum(inertias) >= LEAST_DETERMINED * len(inertias):
        return None
    return (
        f"The motion shows gravity and friction, but hardly any inertia ({sum(inertias)} of {len(inertias)} moments of "
        "inertia are determined): it is too slow or too short."
    )
