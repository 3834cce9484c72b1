"""The section on the identified base parameters and their uncertainty."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from dynident.estimation import CovarianceName
from dynident.identification import Identification
from dynident.identification.study.dependence import parameter_dependence
from dynident.reports.numbers import format_number, format_percent
from dynident.reports.parameter_tables import GROUPING, build_parameter_table, build_shape_table
from dynident.reports.section import Section
from dynident.reports.tables import ReportedTable

_COVARIANCE_TEXTS: Mapping[CovarianceName, str] = MappingProxyType(
    {
        "by_time_and_joints": "Standard deviations take stretches of time for independent and nothing within them, "
        "of all joints together.",
        "by_joint": "Standard deviations account for the correlation of each joint's samples in time, and take the "
        "joints for independent.",
        "independent": "Standard deviations take every filtered sample for independent, as [12.6] does: they are "
        "too small.",
    }
)


@dataclass(frozen=True)
class EffectiveRows:
    """How many independent samples the rows of a joint are worth."""

    joint: str
    rows: str
    effective: str
    share: str


@dataclass(frozen=True)
class ParametersContent:
    """The content of the section: parameters by effect, and how their standard deviations come about.

    `counted` says which residuals the deviations take for correlated; `together` names parameters that the data
    determine only in combination.
    """

    parameters: ReportedTable
    groupings: tuple[tuple[str, str], ...]
    effective: tuple[EffectiveRows, ...]
    n_uncertain: int
    n_zero: int
    counted: str
    n_parameters: int
    together: tuple[str, ...]
    shapes: ReportedTable | None


def build_parameters_section(identification: Identification) -> Section:
    """Return the section on the identified parameters.

    Parameters
    ----------
    identification : Identification

    Returns
    -------
    Section
    """
    parameters, constants = identification.parameters, identification.shape_constants
    content = ParametersContent(
        build_parameter_table("Base parameters", parameters).drop_columns(GROUPING),
        tuple((base_parameter.name, base_parameter.grouping) for base_parameter in parameters),
        tuple(_build_effective_rows(identification)),
        sum(base_parameter.judgement == "uncertain" for base_parameter in parameters),
        sum(base_parameter.judgement == "zero_in_interval" for base_parameter in parameters),
        _COVARIANCE_TEXTS[identification.choices.covariance],
        len(parameters),
        parameter_dependence(identification).sentences,
        build_shape_table(constants, identification.model.robot.joint_names) if constants else None,
    )
    return Section("parameters", "Identified parameters", "parameters", content)


def _build_effective_rows(identification: Identification) -> Iterator[EffectiveRows]:
    equations = identification.data.equations.equations
    names = identification.model.robot.joint_names
    # Equation types such as energy or base wrench do not have one equation for each joint.
    if len(equations) != len(names):
        names = tuple(f"{identification.choices.model} equation {k + 1}" for k in range(len(equations)))
    counts = [equation.counts.sum() for equation in equations]
    for name, rows, effective in zip(names, counts, identification.statistics.effective_rows, strict=True):
        yield EffectiveRows(
            name, f"{int(rows)}", format_number(float(effective)), format_percent(float(effective / max(rows, 1.0)), 2)
        )
