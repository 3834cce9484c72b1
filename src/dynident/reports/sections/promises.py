"""What the experiment had promised of the parameters, beside what was achieved."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dynident.excitation import Design
from dynident.identification import Identification
from dynident.reports.numbers import number
from dynident.reports.section import Section


@dataclass(frozen=True)
class PromiseRow:
    """One parameter: standard deviations in words, and the achieved one over the promised."""

    name: str
    unit: str
    promised: str
    achieved: str
    ratio: str
    worse: bool


@dataclass(frozen=True)
class PromisesContent:
    """The parameters that both know, and the median of the ratios."""

    rows: tuple[PromiseRow, ...]
    median: str


_MUCH_WORSE = 3.0


def promises_section(design: Design, identification: Identification) -> Section | None:
    """Promised and achieved standard deviations; None where the design promised none of the parameters."""
    compared = list(_compared(design, identification))
    if not compared:
        return None
    rows = tuple(
        PromiseRow(name, unit, number(promised), number(achieved), number(achieved / promised, 2), worse)
        for name, unit, promised, achieved, worse in ((*one, one[3] > _MUCH_WORSE * one[2]) for one in compared)
    )
    median = float(np.median([achieved / promised for _, _, promised, achieved in compared]))
    return Section("promises", "Promised and achieved", "promises", PromisesContent(rows, number(median, 2)))


def _compared(design: Design, identification: Identification) -> Iterator[tuple[str, str, float, float]]:
    """Name, unit, promised and achieved standard deviation of the parameters that both have."""
    promised = {one.name: one.standard_deviation for one in design.expected}
    for parameter in identification.parameters:
        deviation = promised.get(parameter.name)
        if deviation and np.isfinite(deviation) and not parameter.shape:
            yield parameter.name, parameter.unit, deviation, parameter.standard_deviation
