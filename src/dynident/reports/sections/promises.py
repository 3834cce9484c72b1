"""The section that compares the parameters' predicted standard deviations with the achieved ones."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dynident.excitation import Design
from dynident.identification import Identification
from dynident.reports.numbers import format_number
from dynident.reports.section import Section


@dataclass(frozen=True)
class PromiseRow:
    """One parameter: predicted and achieved standard deviation as text, and the achieved one over the predicted."""

    name: str
    unit: str
    promised: str
    achieved: str
    ratio: str
    worse: bool


@dataclass(frozen=True)
class PromisesContent:
    """The content of the section: the parameters of both design and model, and the median of the ratios."""

    rows: tuple[PromiseRow, ...]
    median: str


# Above this ratio of achieved to predicted standard deviation a row is marked as worse.
_WORSE_RATIO = 3.0


def build_promises_section(design: Design, identification: Identification) -> Section | None:
    """Return the section on predicted and achieved standard deviations.

    Parameters
    ----------
    design : Design
    identification : Identification

    Returns
    -------
    Section or None
        None where the design predicted none of the parameters.
    """
    compared = list(_compare_deviations(design, identification))
    if not compared:
        return None
    rows = tuple(
        PromiseRow(
            name,
            unit,
            format_number(promised),
            format_number(achieved),
            format_number(achieved / promised, 2),
            achieved > _WORSE_RATIO * promised,
        )
        for name, unit, promised, achieved in compared
    )
    median = float(np.median([achieved / promised for _, _, promised, achieved in compared]))
    return Section("promises", "Promised and achieved", "promises", PromisesContent(rows, format_number(median, 2)))


def _compare_deviations(design: Design, identification: Identification) -> Iterator[tuple[str, str, float, float]]:
    """Yield name, unit, predicted and achieved standard deviation of the parameters that both have."""
    promised = {expected.name: expected.standard_deviation for expected in design.expected}
    for parameter in identification.parameters:
        deviation = promised.get(parameter.name)
        # Columns with shape constants may differ between design and model, so their parameters are not comparable.
        if deviation and np.isfinite(deviation) and not parameter.shape:
            yield parameter.name, parameter.unit, deviation, parameter.standard_deviation
