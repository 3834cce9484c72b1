"""Report sections on a design, and on its predictions against what was achieved (marked from a ratio of 3)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from dynident.excitation import Design
from dynident.identification import Identification
from dynident.motion import Margin
from dynident.number_format import format_count, format_number, format_percent
from dynident.reports.figures.design import draw_design
from dynident.reports.reported_data import Section
from dynident.robot import Robot


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
        The experiment that the data come from.
    identification : Identification
        The identified model, with the data of its fit.

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


_MAX_MARGINS = 12
_UNITS = {"position_min": "", "position_max": "", "velocity": "/s", "acceleration": "/s²", "jerk": "/s³"}


@dataclass(frozen=True)
class MarginRow:
    """One limit and the share of it that is used."""

    joint: str
    limit: str
    value: str
    bound: str
    share: str


@dataclass(frozen=True)
class RunRow:
    """One test motion of a set; `number` is its segment in the trajectory."""

    number: int
    label: str
    joints: str
    start: str
    end: str


@dataclass(frozen=True)
class DesignContent:
    """The content of the section; `rows` compare the design with random trajectories.

    A row has a name, a condition number and a smallest singular value.
    """

    kind: str
    length: str
    rows: tuple[tuple[str, str, str], ...]
    margins: tuple[MarginRow, ...]
    runs: tuple[RunRow, ...]
    notes: tuple[str, ...]
    figure: Markup


def build_design_section(design: Design, robot: Robot) -> Section:
    """Return the section on the designed trajectory.

    Parameters
    ----------
    design : Design
        The experiment that the data come from.
    robot : Robot
        The robot that the model is of.

    Returns
    -------
    Section
        Criteria, limits, test motions and the figure.
    """
    values, baseline = design.criterion_values, design.baseline
    rows = [("this trajectory", format_number(values.condition_number), format_number(values.smallest_singular_value))]
    if baseline is not None:
        best = baseline.best
        name = f"best of {format_count(baseline.count, 'random motion')}"
        rows.append((name, format_number(best.condition_number), format_number(best.smallest_singular_value)))
        # The best of many random motions is a lucky one: the median says what to expect of any.
        rows.append(("median of these motions", format_number(baseline.median_condition_number), "–"))
    # A robot has dozens of limits. Those that are nearly reached are the interesting ones.
    nearest = sorted(design.margins, key=lambda margin: -margin.share)[:_MAX_MARGINS]
    content = DesignContent(
        design.request.kind.replace("_", " "),
        f"{format_number(design.duration)} s from rest to rest, {format_count(design.n_samples, 'sample')} at "
        f"{format_number(design.sampling_rate, 4)} Hz",
        tuple(rows),
        tuple(
            MarginRow(
                margin.joint,
                margin.limit.replace("_", " "),
                f"{format_number(margin.value)} {_get_limit_unit(robot, margin)}",
                f"{format_number(margin.bound)} {_get_limit_unit(robot, margin)}",
                format_percent(margin.share),
            )
            for margin in nearest
        ),
        tuple(
            RunRow(index + 1, run.label, ", ".join(run.joints), format_number(run.start, 4), format_number(run.end, 4))
            for index, run in enumerate(design.runs)
        ),
        design.notes,
        draw_design(design, robot),
    )
    return Section("design", "The experiment", "design", content)


def _get_limit_unit(robot: Robot, margin: Margin) -> str:
    """Return the unit of a limit."""
    if margin.limit in ("clearance", "tool_min", "tool_max"):
        return "m"
    if margin.limit == "condition":
        return ""
    if margin.limit == "power":
        return "W"
    described = robot.tree.joints[robot.tree.joint_names.index(margin.joint)]
    if margin.limit == "torque":
        return described.effort_unit
    return ("rad" if described.kind == "revolute" else "m") + _UNITS[margin.limit]
