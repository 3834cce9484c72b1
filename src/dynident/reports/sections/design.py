"""Report sections on a design, and on its predictions against what was achieved."""

from __future__ import annotations

from dataclasses import dataclass

from markupsafe import Markup

from dynident.excitation import Design
from dynident.identification import Identification
from dynident.number_format import format_count, format_number
from dynident.presentation.design_tables import build_design_tables, build_promises_table
from dynident.presentation.tables import ReportedTable
from dynident.reports.figures.design import draw_design
from dynident.reports.reported_data import Section
from dynident.robot import Robot


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
    table = build_promises_table(design, identification)
    return None if table is None else Section("promises", "Promised and achieved", "promises", table)


# A robot has dozens of limits. Those that are nearly reached are the interesting ones.
_MAX_MARGINS = 12


@dataclass(frozen=True)
class DesignContent:
    """The content of the section: what kind of motion it is, its tables, notes and figure."""

    kind: str
    length: str
    tables: tuple[ReportedTable, ...]
    has_runs: bool
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
    content = DesignContent(
        design.request.kind.replace("_", " "),
        f"{format_number(design.duration)} s from rest to rest, {format_count(design.n_samples, 'sample')} at "
        f"{format_number(design.sampling_rate, 4)} Hz",
        tuple(build_design_tables(robot, design, most_limits=_MAX_MARGINS)),
        bool(design.runs),
        design.notes,
        draw_design(design, robot),
    )
    return Section("design", "The experiment", "design", content)
