"""Identified parameters and shape constants as tables: the same on the command line, in reports and on the page."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from math import isfinite

from dynident.effects import EffectChoice, effect_by_id
from dynident.identification import IdentifiedParameter
from dynident.identification.shapes.shape_constants import ShapeConstant
from dynident.identification.study.essential import EssentialPath
from dynident.reports.numbers import estimate, number
from dynident.reports.tables import Cell, ReportedTable, figure, share, words
from dynident.reports.words import JUDGED, SHAPES_JUDGED, interval_text, place_text, shape_text

GROUPING, TIMES_SMALLEST = "in standard parameters", "times smallest"


def parameter_table(title: str, parameters: Iterable[IdentifiedParameter]) -> ReportedTable:
    """Parameters under their effects; those that are not essential are left out."""
    essential = [one for one in parameters if one.essential]
    groups = {(one.effect, one.shape): "" for one in essential}
    for effect, shape in groups:
        constants = shape_text(EffectChoice(effect, (), shape))
        groups[effect, shape] = ", ".join(filter(None, (effect_by_id(effect).title, constants)))
    ordered = [one for group in groups for one in essential if (one.effect, one.shape) == group]
    return ReportedTable(
        title,
        (
            *("parameter", "joint", "value", "standard deviation", "95 % interval", "unit", "relative"),
            *(TIMES_SMALLEST, "determined", GROUPING),
        ),
        tuple(_parameter(one) for one in ordered),
        numbers_from=2,
        groups=tuple(groups[one.effect, one.shape] for one in ordered),
    )


def _parameter(one: IdentifiedParameter) -> tuple[Cell, ...]:
    value, deviation = estimate(one.value, one.standard_deviation)
    ends = [estimate(end, one.standard_deviation)[0] for end in one.interval if isfinite(end)]
    judged = JUDGED[one.judgement]
    return (
        *words(one.name, one.link or "whole robot"),
        Cell(value, one.value),
        Cell(deviation, one.standard_deviation),
        Cell(" to ".join(ends) or "–", is_figures=True),
        Cell(one.unit),
        share(one.relative_standard_deviation, 2),
        Cell(number(one.times_smallest, 2), is_figures=True),
        Cell(judged.words, mark=judged.mark),
        Cell(one.grouping),
    )


def shape_table(constants: Sequence[ShapeConstant], joints: Sequence[str]) -> ReportedTable:
    """The constants inside the effects' columns, of a robot with these joints."""
    columns = ("effect", "joint", "constant", "value", "standard deviation", "95 % interval", "unit", "determined")
    rows = tuple(_constant(one, joints) for one in constants)
    return ReportedTable("Shape constants: inside the columns, found by search", columns, rows, numbers_from=3)


def _constant(one: ShapeConstant, joints: Sequence[str]) -> tuple[Cell, ...]:
    value, deviation = one.word or number(one.value, 4), "–"
    if one.interval is not None:
        value, deviation = estimate(one.value, one.standard_deviation)
    judged = SHAPES_JUDGED[one.judgement]
    return (
        *words(effect_by_id(one.effect).title, place_text(one.joints, joints)),
        Cell(one.name, note=one.description),
        Cell(value, one.value),
        Cell(deviation, one.standard_deviation if one.interval is not None else None),
        Cell(interval_text(one), is_figures=True),
        Cell("–" if one.unit == "-" else one.unit),
        Cell(judged.words, mark=judged.mark, note=one.note),
    )


def essential_tables(found: EssentialPath) -> Iterator[ReportedTable]:
    """What was taken out, step by step, and what is left."""
    rows = tuple(
        (
            Cell(one.name),
            share(one.relative_deviation, 2),
            figure(one.p_value, 2),
            share(one.fit.relative_total),
            share(None if one.held_out is None else one.held_out.relative_total),
        )
        for one in found.steps
    )
    if rows:
        yield ReportedTable("Backward elimination", ("taken out", "relative deviation", "p", "fit", "held out"), rows)
    yield parameter_table("Essential parameters", found.identification.parameters)
