"""The identified base parameters with their uncertainty."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from dynident.effects import EffectChoice, effect_by_id
from dynident.estimation import CovarianceName
from dynident.identification import Identification, IdentifiedParameter
from dynident.identification.shapes.shape_constants import ShapeConstant
from dynident.identification.study.dependence import parameter_dependence
from dynident.reports.numbers import estimate, number, percent
from dynident.reports.section import Section
from dynident.reports.words import JUDGED, SHAPES_JUDGED, interval_text, place_text, shape_text
from dynident.robot import Robot

_COUNTED: Mapping[CovarianceName, str] = MappingProxyType(
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
class ParameterRow:
    """One parameter in words, beside the parameter itself."""

    parameter: IdentifiedParameter
    value: str
    deviation: str
    interval: str
    relative: str
    unit: str
    times_smallest: str
    judged: str
    mark: str


@dataclass(frozen=True)
class ShapeRow:
    """A shape constant in words, beside the constant itself."""

    constant: ShapeConstant
    effect: str
    place: str
    value: str
    deviation: str
    interval: str
    unit: str
    judged: str
    mark: str


@dataclass(frozen=True)
class EffectiveRows:
    """How many independent samples the rows of a joint are worth."""

    joint: str
    rows: str
    effective: str
    share: str


@dataclass(frozen=True)
class ParameterGroup:
    """The parameters of one effect with one set of shape constants."""

    effect: str
    shape: str
    rows: tuple[ParameterRow, ...]


@dataclass(frozen=True)
class ParametersContent:
    """Parameters by effect, the number of independent samples behind their deviations, what is known together only.

    `counted`: what of the residuals the deviations take to be correlated, in words.
    """

    groups: tuple[ParameterGroup, ...]
    effective: tuple[EffectiveRows, ...]
    n_uncertain: int
    n_zero: int
    counted: str
    n_parameters: int
    together: tuple[str, ...]
    shapes: tuple[ShapeRow, ...]


def parameters_section(identification: Identification) -> Section:
    """What was identified."""
    parameters = identification.parameters
    content = ParametersContent(
        tuple(_groups(parameters)),
        tuple(_effective(identification)),
        sum(parameter.judgement == "uncertain" for parameter in parameters),
        sum(parameter.judgement == "zero_in_interval" for parameter in parameters),
        _COUNTED[identification.choices.covariance],
        len(parameters),
        parameter_dependence(identification).sentences,
        tuple(_shape_row(one, identification.model.robot) for one in identification.shape_constants),
    )
    return Section("parameters", "Identified parameters", "parameters", content)


def _groups(parameters: Sequence[IdentifiedParameter]) -> Iterator[ParameterGroup]:
    for effect, shape in dict.fromkeys((parameter.effect, parameter.shape) for parameter in parameters):
        rows = tuple(_row(p) for p in parameters if (p.effect, p.shape) == (effect, shape))
        yield ParameterGroup(effect_by_id(effect).title, shape_text(EffectChoice(effect, (), shape)), rows)


def _row(parameter: IdentifiedParameter) -> ParameterRow:
    value, deviation = estimate(parameter.value, parameter.standard_deviation)
    return ParameterRow(
        parameter,
        value,
        deviation,
        " to ".join(estimate(end, parameter.standard_deviation)[0] for end in parameter.interval),
        percent(parameter.relative_standard_deviation, 2),
        "–" if parameter.unit == "-" else parameter.unit,
        number(parameter.times_smallest, 2),
        JUDGED[parameter.judgement].words,
        JUDGED[parameter.judgement].mark,
    )


def _shape_row(one: ShapeConstant, robot: Robot) -> ShapeRow:
    value, deviation = (one.word or number(one.value, 4), "–")
    if one.interval is not None:
        value, deviation = estimate(one.value, one.standard_deviation)
    return ShapeRow(
        one,
        effect_by_id(one.effect).title,
        place_text(one.joints, robot),
        value,
        deviation,
        interval_text(one),
        "–" if one.unit == "-" else one.unit,
        SHAPES_JUDGED[one.judgement].words,
        SHAPES_JUDGED[one.judgement].mark,
    )


def _effective(identification: Identification) -> Iterator[EffectiveRows]:
    equations = identification.data.equations.equations
    names = identification.model.robot.joint_names
    if len(equations) != len(names):
        names = tuple(f"{identification.choices.model} equation {k + 1}" for k in range(len(equations)))
    counts = [equation.counts.sum() for equation in equations]
    for name, rows, effective in zip(names, counts, identification.statistics.effective_rows, strict=True):
        yield EffectiveRows(
            name, f"{int(rows)}", number(float(effective)), percent(float(effective / max(rows, 1.0)), 2)
        )
