"""Tables and sentences of designed motions: quality, limits, runs, expected and achieved precision (marked from 3)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from dynident.advice.campaign import CampaignRun
from dynident.advice.campaign_request import MEASURES, CampaignRequest, list_targets
from dynident.effects import EffectChoice
from dynident.excitation import Design
from dynident.excitation.criteria.parameter_variances import ExpectedParameter
from dynident.identification import Identification
from dynident.motion import Margin
from dynident.number_format import choose_time_unit, format_count, format_number, format_percent
from dynident.presentation.labels import format_choice, get_effect_title
from dynident.presentation.tables import Cell, ReportedTable, make_number_cell, make_percent_cell, make_text_cells
from dynident.recordings.base_motion import POSITION
from dynident.robot import Robot
from dynident.robot.description_formats import BASE_JOINTS

# Above this ratio of achieved to predicted standard deviation a row is marked as worse.
_WORSE_RATIO = 3.0
_UNITS = {"position_min": "", "position_max": "", "velocity": "/s", "acceleration": "/s²", "jerk": "/s³"}


def describe_design(design: Design) -> str:
    """Return the length of a motion, its quality beside random motions, and the limit that it comes nearest to."""
    baseline = design.baseline
    random = ""
    if baseline is not None:
        best = f"the best of {format_count(baseline.count, 'random motion')}"
        # A random motion is compared with the others alone: it is the best of them.
        if design.request.kind == "random":
            random = f", {best}, whose median is {format_number(baseline.median_scaled_condition_number)}"
        else:
            random = f"; {best} has {format_number(baseline.best.scaled_condition_number)}"
    # The limit that is used most: it is the one to relax where the motion is too poor.
    nearest = max(design.margins, key=lambda margin: margin.share)
    return (
        f"{format_number(design.duration)} s from rest to rest, {format_count(design.n_samples, 'sample')} at "
        f"{format_number(design.sampling_rate, 4)} Hz. Scaled condition number "
        f"{format_number(design.criterion_values.scaled_condition_number)}{random}. Nearest limit: "
        f"{nearest.limit.replace('_', ' ')} of {nearest.joint}, {format_percent(nearest.share)} used."
        f"{_describe_balance(design)}"
    )


def _describe_balance(design: Design) -> str:
    reached = {margin.limit: margin.value for margin in design.margins}
    if "balance" not in reached:
        return ""
    return (
        f" The centre of pressure stays {format_number(reached['balance'])} m inside the support of the feet, which "
        f"need a coefficient of friction of {format_number(reached['friction'], 2)}."
    )


def build_design_tables(robot: Robot, design: Design, most_limits: int | None = None) -> Iterator[ReportedTable]:
    """Yield the tables of a designed motion: its quality, distance to the limits, and the runs of a set.

    Parameters
    ----------
    robot : Robot
        The robot that shall make the motion.
    design : Design
        The motion.
    most_limits : int, optional
        How many of the nearest limits are listed; all by default.
    """
    yield _build_quality_table(design)
    yield build_limits_table(robot, design.margins, most_limits)
    if design.runs:
        rows = tuple(
            (
                *make_text_cells(str(number), run.label, ", ".join(run.joints)),
                make_number_cell(run.start, 4),
                make_number_cell(run.end, 4),
            )
            for number, run in enumerate(design.runs, start=1)
        )
        columns = ("segment", "purpose", "joints that move", "from (s)", "to (s)")
        yield ReportedTable("The test motions", columns, rows, numbers_from=3, name="runs")


def _build_quality_table(design: Design) -> ReportedTable:
    values, baseline = design.criterion_values, design.baseline
    is_random = design.request.kind == "random" and baseline is not None
    name = f"best of {format_count(baseline.count, 'random motion')}" if baseline is not None else ""
    motions = [(f"this motion, the {name}" if is_random else "this motion", values)]
    if baseline is not None and not is_random:
        motions.append((name, baseline.best))
    cells: list[tuple[Cell, ...]] = [
        (
            Cell(label),
            make_number_cell(of_motion.criterion),
            make_number_cell(of_motion.scaled_condition_number),
            make_number_cell(of_motion.condition_number),
            make_number_cell(of_motion.smallest_singular_value),
        )
        for label, of_motion in motions
    ]
    if baseline is not None:
        # The best of many random motions is a lucky one: the median says what to expect of any.
        medians = map(make_number_cell, (baseline.median_scaled_condition_number, baseline.median_condition_number))
        cells.append((Cell("median of these motions"), Cell("–"), *medians, Cell("–")))
    criterion = f"criterion: {design.request.criterion.name.replace('_', ' ')}"
    columns = (
        "motion",
        criterion,
        "scaled condition number (columns of equal size)",
        "condition number in SI units",
        "smallest singular value of W / √N",
    )
    table = ReportedTable("Quality of the motion", columns, tuple(cells), name="quality")
    # The condition number as the criterion is one column.
    return table.drop_columns(criterion) if design.request.criterion.name == "condition_number" else table


LIMITS_COLUMNS = ("joint", "limit", "reached", "allowed", "used")


def build_limits_table(robot: Robot, margins: Sequence[Margin], most: int | None = None) -> ReportedTable:
    """Return how near a motion comes to its limits, the nearest ones first.

    Parameters
    ----------
    robot : Robot
        The robot that shall make the motion.
    margins : sequence of Margin
        Distance to each limit.
    most : int, optional
        Number of rows; all limits by default.
    """
    rows = tuple(
        (
            *make_text_cells(margin.joint, margin.limit.replace("_", " ")),
            make_number_cell(margin.value, unit=_get_limit_unit(robot, margin)),
            make_number_cell(margin.bound, unit=_get_limit_unit(robot, margin)),
            make_percent_cell(margin.share),
        )
        for margin in sorted(margins, key=lambda margin: -margin.share)[:most]
    )
    title = "Nearest limits, on a grid ten times as fine as the sampling"
    return ReportedTable(title, LIMITS_COLUMNS, rows, numbers_from=2, name="limits")


def _get_limit_unit(robot: Robot, margin: Margin) -> str:
    if margin.limit in ("clearance", "tool_min", "tool_max", "balance"):
        return "m"
    if margin.limit in ("condition", "power", "friction"):
        return "W" if margin.limit == "power" else ""
    if margin.joint in BASE_JOINTS["floating"]:
        # Of a trunk that sways over its feet; the robot itself is one with a fixed base.
        return ("m" if margin.joint in POSITION else "rad") + _UNITS[margin.limit]
    described = robot.tree.joints[robot.tree.joint_names.index(margin.joint)]
    if margin.limit == "torque":
        return described.effort_unit
    return ("rad" if described.kind == "revolute" else "m") + _UNITS[margin.limit]


def build_expected_table(expected: Sequence[ExpectedParameter]) -> ReportedTable:
    """Return the precision with which a motion is expected to determine each parameter."""
    # Without the noise of the torque there is no standard deviation, and a column of dashes says nothing.
    is_stated = any(item.standard_deviation is not None for item in expected)
    rows = tuple(
        (
            *make_text_cells(item.name, item.link or "whole robot", get_effect_title(item.effect)),
            *[make_number_cell(item.standard_deviation, unit=item.unit)] * is_stated,
            make_percent_cell(item.share),
        )
        for item in expected
    )
    hint = "Standard deviations need the noise of each joint's torque: state it among the limits and design again."
    columns = ("parameter", "joint", "effect", *["standard deviation"] * is_stated, "not explained by others")
    title = "Parameters as this motion will determine them"
    return ReportedTable(title, columns, rows, 3, notes=() if is_stated else (hint,), name="expected")


def build_promises_table(design: Design, identification: Identification) -> ReportedTable | None:
    """Return predicted and achieved standard deviations of the parameters that both have; None where there are none.

    Parameters
    ----------
    design : Design
        The experiment that the data come from.
    identification : Identification
        The identified model.
    """
    promised = {expected.name: expected.standard_deviation for expected in design.expected}
    rows, ratios = [], []
    for parameter in identification.parameters:
        deviation = promised.get(parameter.name)
        # Columns with shape constants may differ between design and model, so their parameters are not comparable.
        if deviation and np.isfinite(deviation) and not parameter.shape:
            ratios.append(parameter.standard_deviation / deviation)
            is_worse = ratios[-1] > _WORSE_RATIO
            cells = (make_number_cell(deviation), make_number_cell(parameter.standard_deviation))
            ratio = Cell(format_number(ratios[-1], 2), ratios[-1], "warning" if is_worse else None)
            rows.append((Cell(parameter.name), *cells, Cell(parameter.unit), ratio))
    if not rows:
        return None
    median = format_number(float(np.median(ratios)), 2)
    note = (
        "Before the robot moved, the design predicted these standard deviations from the stated torque noise, for a "
        f"model without other errors. The standard deviations achieved are {median} times those in the median: above 1 "
        "if the residual is larger than that noise, or correlated in time; below 1 if several runs were identified "
        "together. Shaded: more than three times the promised value."
    )
    columns = ("parameter", "promised", "achieved", "unit", "achieved / promised")
    return ReportedTable("Standard deviations", columns, tuple(rows), notes=(note,), name="promises")


def build_campaign_table(
    runs: Sequence[CampaignRun], request: CampaignRequest, joints: tuple[str, ...]
) -> ReportedTable:
    """Return what each run of a campaign promised and brought, as errors of the worst joint, parameter or effect.

    Parameters
    ----------
    runs : sequence of CampaignRun
        The runs so far, in order.
    request : CampaignRequest
        What is to be reached.
    joints : sequence of str
        Names of the robot's joints.
    """
    rows, seconds, targets = [], 0.0, list_targets(request, joints)
    unit, scale = choose_time_unit(sum(run.seconds for run in runs))
    for run in runs:
        seconds += run.seconds
        worst = int(np.argmax(run.errors))
        is_reached = bool(run.errors[worst] <= request.largest_error)
        rows.append(
            (
                Cell(run.name),
                make_number_cell(seconds / scale, 3),
                make_percent_cell(None if run.promised is None else float(run.promised.max())),
                make_percent_cell(None if run.predicted is None else float(run.predicted.max())),
                make_percent_cell(float(run.parameters.max())),
                make_percent_cell(float(run.lacking.max())),
                Cell(format_percent(float(run.errors[worst])), float(run.errors[worst]), "ok" if is_reached else None),
                Cell(targets[worst]),
                Cell(_list_added(run.added, joints)),
            )
        )
    columns = (
        "run", f"robot time so far ({unit})", "promised", "error on this run before it was fitted", "from uncertainty",
        "lacking in the model", "error", MEASURES[request.goal][1], "effects added",
    )  # fmt: skip
    note = f"{MEASURES[request.goal][0]}; the motion promised it before it was made."
    if request.goal == "torque":
        note = (
            "Errors of the predicted torque, over its rms, of the worst joint over the region of the goal. From "
            "uncertainty: with 95 % probability. Lacking: what the residual of all runs has above noise and "
            "uncertainty. Error: both together, which the motion promised before it was made."
        )
    return ReportedTable("Runs of the campaign", columns, tuple(rows), notes=(note,), name="campaign")


def _list_added(added: Sequence[EffectChoice], joints: Sequence[str]) -> str:
    return "; ".join(format_choice(choice, joints) for choice in added) or "–"
