"""Tables as rows of text: candidates, changes, detection limits, parameters, shape constants; columns and row order.

Used by the command line, reports and page.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from math import isfinite
from typing import NamedTuple

from dynident.diagnosis import Change, FrictionDifference, RankedEffect
from dynident.diagnosis.diagnosis_result import DetectionLimit
from dynident.effects import EffectChoice, get_effect
from dynident.identification import IdentifiedParameter
from dynident.identification.identified_models.correlated_and_essential_parameters import EssentialPath
from dynident.identification.shape_constant_intervals import ShapeConstant
from dynident.number_format import format_estimate, format_number, format_p_value, format_percent
from dynident.reports.labels import (
    PARAMETER_JUDGEMENTS,
    SHAPE_JUDGEMENTS,
    format_joints,
    format_shape_constants,
    format_shape_interval,
    get_effect_title,
)
from dynident.reports.table_cells import Cell, ReportedTable, make_number_cell, make_percent_cell, make_text_cells
from dynident.robot import Robot

CANDIDATE_COLUMNS = ("rank", "effect", "joints", "error before", "after", "drop", "why, or why not")


def format_candidates(ranked: Iterable[RankedEffect], robot: Robot) -> list[tuple[str, ...]]:
    """Return ranked candidates as rows of text.

    Parameters
    ----------
    ranked : iterable of RankedEffect
        Best first.
    robot : Robot
        The diagnosed robot.

    Returns
    -------
    list of tuples of str
        Rows with the cells of `CANDIDATE_COLUMNS`.
    """
    return [
        (
            str(candidate.rank),
            candidate.title if candidate.question else get_effect_title(candidate.effect),
            format_joints(candidate.joints, robot.joint_names),
            format_percent(candidate.error_before),
            format_percent(candidate.error_after),
            format_percent(candidate.error_drop, 2),
            format_reason(candidate),
        )
        for candidate in ranked
    ]


def format_reason(candidate: RankedEffect) -> str:
    """Return why a candidate is a finding or not, in a few words."""
    if candidate.reason is not None:
        return candidate.reason.brief
    # A diagnosis of an earlier version holds no reasons.
    return "accepted" if candidate.significant else "not accepted"


CHANGE_COLUMNS = ("changed", "joint", "parameter", "before", "difference", "95 % interval", "unit", "p")

FRICTION_COLUMNS = (
    "friction of",
    "at a speed of",
    "before",
    "difference",
    "95 % interval",
    "unit",
    "relative to before",
)


class ChangeCells(NamedTuple):
    """One number that differs, as the cells of `CHANGE_COLUMNS`."""

    title: str
    place: str
    parameter: str
    before: str
    difference: str
    interval: str
    unit: str
    p: str


def format_change(change: Change, robot: Robot) -> Iterator[ChangeCells]:
    """Yield the numbers of a change as rows of text, the main one first; only the main one has a p-value.

    Parameters
    ----------
    change : Change
        The change, with all its parameters.
    robot : Robot
        The robot that has changed.

    Yields
    ------
    ChangeCells
        The cells of one parameter.
    """
    for value in (change.main, *change.more):
        yield ChangeCells(
            get_effect_title(change.choice.effect),
            format_joints(change.choice.joints, robot.joint_names),
            value.parameter,
            "–" if value.before is None else format_number(value.before),
            _format_signed(value.value),
            " to ".join(format_number(end) for end in value.interval),
            "" if value.unit == "-" else value.unit,
            # The test is one of the whole change, not of each of its parameters.
            format_p_value(change.p_value) if value is change.main else "",
        )


class FrictionCells(NamedTuple):
    """The difference of one joint's friction, as the cells of `FRICTION_COLUMNS`."""

    joint: str
    speed: str
    before: str
    difference: str
    interval: str
    unit: str
    share: str


def format_friction_difference(difference: FrictionDifference) -> FrictionCells:
    """Return the difference of one joint's friction as a row of text.

    Parameters
    ----------
    difference : FrictionDifference
        The difference of any joint that moves, significant or not.

    Returns
    -------
    FrictionCells
        The cells of the row.
    """
    return FrictionCells(
        difference.joint,
        f"{format_number(difference.speed)} {'m/s' if difference.unit == 'N' else 'rad/s'}",
        format_number(difference.before),
        _format_signed(difference.value),
        " to ".join(format_number(end) for end in difference.interval),
        difference.unit,
        f"{'+' if difference.value > 0 else ''}{format_percent(difference.value / difference.before, 2)}"
        if difference.before > 0.0
        else "–",
    )


def _format_signed(value: float) -> str:
    return f"{'+' if value > 0 else ''}{format_number(value)}"


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
    return ReportedTable(
        "Shape constants: nonlinear constants of the effects, found by search", columns, rows, numbers_from=3
    )


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
        yield ReportedTable("Backward elimination", ("removed", "relative deviation", "p", "fit", "held out"), rows)
    yield build_parameter_table("Essential parameters", path.identification.parameters)


LIMIT_COLUMNS = ("effect", "would have shown from", "of the usual size", "not in its usual size on")


def format_limits(limits: Sequence[DetectionLimit], robot: Robot) -> list[tuple[str, ...]]:
    """Return one row of text for each effect, whatever the number of joints.

    Parameters
    ----------
    limits : sequence of DetectionLimit
        The detection limits.
    robot : Robot
        The robot that the model is of.

    Returns
    -------
    list of tuple of str
        The cells of `LIMIT_COLUMNS`.
    """
    rows: list[tuple[str, ...]] = []
    for effect in dict.fromkeys(limit.effect for limit in limits):
        own = [limit for limit in limits if limit.effect == effect]
        blind = [name for limit in own if limit.share > 1.0 for name in limit.joints or ("",)]
        where = "" if not blind else "the whole robot" if blind == [""] else format_joints(blind, robot.joint_names)
        rows.append((get_effect_title(effect), _format_sizes(own), _format_range([o.share for o in own]), where or "–"))
    return rows


def format_share(share: float) -> str:
    """Return a limit over the usual size as a percentage or a factor; "–" where no size would have shown."""
    if not math.isfinite(share):
        return "–"
    return format_percent(share, 2) if share < 0.995 else f"{share:.2g} x" if share < 10.0 else f"{share:.0f} x"


def _format_range(shares: Sequence[float]) -> str:
    low, high = format_share(min(shares)), format_share(max(shares))
    return low if low == high else f"{low} to {high if math.isfinite(max(shares)) else 'none'}"


def _format_sizes(limits: Sequence[DetectionLimit]) -> str:
    """Return the smallest and the largest limit with their unit; units of joints of other kinds follow each other."""
    texts = []
    for unit in dict.fromkeys(limit.unit for limit in limits):
        sizes = [limit.size for limit in limits if limit.unit == unit and math.isfinite(limit.size)]
        words = "" if unit == "-" else f" {unit}"
        if sizes:
            low, high = format_number(min(sizes), 2), format_number(max(sizes), 2)
            texts.append(f"{low}{words}" if low == high else f"{low} to {high}{words}")
    return ", ".join(texts) or "no size"
