"""Identified parameters and shape constants as tables, for the command line, reports and the page."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from math import isfinite

from dynident.effects import EffectChoice, get_effect
from dynident.identification import IdentifiedParameter
from dynident.identification.shapes.shape_constants import ShapeConstant
from dynident.identification.study.essential_parameters import EssentialPath
from dynident.reports.labels import (
    PARAMETER_JUDGEMENTS,
    SHAPE_JUDGEMENTS,
    format_joints,
    format_shape_constants,
    format_shape_interval,
)
from dynident.reports.number_format import format_estimate, format_number
from dynident.reports.report_tables import Cell, ReportedTable, make_number_cell, make_percent_cell, make_text_cells

GROUPING, TIMES_SMALLEST = "in standard parameters", "times smallest"


def build_parameter_table(title: str, parameters: Iterable[IdentifiedParameter]) -> ReportedTable:
    """Return a table of parameters, grouped by effect; parameters that are not essential are left out.

    Parameters
    ----------
    title : str
        Heading of the table.
    parameters : iterable of IdentifiedParameter
        Base parameters with their uncertainty.

    Returns
    -------
    ReportedTable
        A row for each essential parameter, its effect as the heading above it.
    """
    essential = [parameter for parameter in parameters if parameter.essential]
    groups = {(parameter.effect, parameter.shape): "" for parameter in essential}
    for effect, shape in groups:
        constants = format_shape_constants(EffectChoice(effect, (), shape))
        # An effect may be in the model several times, with other shape constants each: both make its heading.
        groups[effect, shape] = ", ".join(filter(None, (get_effect(effect).title, constants)))
    # Groups are in the order of their first parameter, and so are the parameters within each.
    ordered = [parameter for group in groups for parameter in essential if (parameter.effect, parameter.shape) == group]
    return ReportedTable(
        title,
        (
            *("parameter", "joint", "value", "standard deviation", "95 % interval", "unit", "relative"),
            *(TIMES_SMALLEST, "determined", GROUPING),
        ),
        tuple(_build_parameter_row(parameter) for parameter in ordered),
        numbers_from=2,
        groups=tuple(groups[parameter.effect, parameter.shape] for parameter in ordered),
    )


def _build_parameter_row(parameter: IdentifiedParameter) -> tuple[Cell, ...]:
    value, deviation = format_estimate(parameter.value, parameter.standard_deviation)
    # A parameter that the data do not determine has an infinite interval, which is shown as "–".
    ends = [format_estimate(end, parameter.standard_deviation)[0] for end in parameter.interval if isfinite(end)]
    judgement = PARAMETER_JUDGEMENTS[parameter.judgement]
    return (
        *make_text_cells(parameter.name, parameter.link or "whole robot"),
        Cell(value, parameter.value),
        Cell(deviation, parameter.standard_deviation),
        Cell(" to ".join(ends) or "–", is_figures=True),
        Cell(parameter.unit),
        make_percent_cell(parameter.relative_standard_deviation, 2),
        Cell(format_number(parameter.times_smallest, 2), is_figures=True),
        Cell(judgement.words, mark=judgement.mark),
        Cell(parameter.grouping),
    )


def build_shape_table(constants: Sequence[ShapeConstant], joints: Sequence[str]) -> ReportedTable:
    """Return a table of shape constants.

    Parameters
    ----------
    constants : sequence of ShapeConstant
        Shape constants with their uncertainty.
    joints : sequence of str
        Names of all joints of the robot.

    Returns
    -------
    ReportedTable
        A row for each constant.
    """
    columns = ("effect", "joint", "constant", "value", "standard deviation", "95 % interval", "unit", "determined")
    rows = tuple(_build_constant_row(constant, joints) for constant in constants)
    return ReportedTable("Shape constants: inside the columns, found by search", columns, rows, numbers_from=3)


def _build_constant_row(constant: ShapeConstant, joints: Sequence[str]) -> tuple[Cell, ...]:
    value, deviation = constant.word or format_number(constant.value, 4), "–"
    if constant.interval is not None:
        value, deviation = format_estimate(constant.value, constant.standard_deviation)
    judgement = SHAPE_JUDGEMENTS[constant.judgement]
    return (
        *make_text_cells(get_effect(constant.effect).title, format_joints(constant.joints, joints)),
        Cell(constant.name, note=constant.description),
        Cell(value, constant.value),
        Cell(deviation, constant.standard_deviation if constant.interval is not None else None),
        Cell(format_shape_interval(constant), is_figures=True),
        Cell("–" if constant.unit == "-" else constant.unit),
        Cell(judgement.words, mark=judgement.mark, note=constant.note),
    )


def build_essential_tables(path: EssentialPath) -> Iterator[ReportedTable]:
    """Yield the steps of a backward elimination and the remaining parameters as tables.

    Parameters
    ----------
    path : EssentialPath
        The steps of the elimination, and the model that is left.

    Yields
    ------
    ReportedTable
        The steps, if there are any, then the essential parameters.
    """
    rows = tuple(
        (
            Cell(step.name),
            make_percent_cell(step.relative_deviation, 2),
            make_number_cell(step.p_value, 2),
            make_percent_cell(step.fit.relative_total),
            make_percent_cell(None if step.held_out is None else step.held_out.relative_total),
        )
        for step in path.steps
    )
    if rows:
        yield ReportedTable("Backward elimination", ("taken out", "relative deviation", "p", "fit", "held out"), rows)
    yield build_parameter_table("Essential parameters", path.identification.parameters)
