"""Report sections on the robot, effects, base parameters and the ladder of models."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from markupsafe import Markup

from dynident.array_types import FloatArray
from dynident.diagnosis import Diagnosis
from dynident.effects import EffectChoice, get_effect
from dynident.effects.effect_columns import find_joints
from dynident.estimation import CovarianceName
from dynident.identification import Identification
from dynident.identification.identified_models.correlated_and_essential_parameters import parameter_dependence
from dynident.number_format import format_number, format_percent, format_range
from dynident.presentation.labels import describe_estimator, format_shape_constants
from dynident.presentation.ladder_tables import (
    build_ladder_joint_table,
    build_ladder_table,
    list_steps,
    select_comparable_errors,
)
from dynident.presentation.model_tables import GROUPING, build_parameter_table, build_shape_table
from dynident.presentation.tables import ReportedTable
from dynident.reports.figures.ladder import draw_models
from dynident.reports.figures.svg import draw_formula
from dynident.reports.reported_data import Section
from dynident.robot import Joint, Robot


@dataclass(frozen=True)
class JointRow:
    """One joint, in words."""

    number: int
    name: str
    kind: str
    antecedent: str
    position: str
    velocity: str
    acceleration: str
    jerk: str
    effort: str
    drive_gain: str


@dataclass(frozen=True)
class RobotContent:
    """The content of the section; `counts` are the base parameters of each effect."""

    robot: Robot
    joints: tuple[JointRow, ...]
    gravity: str
    locked: tuple[str, ...]
    n_parameters: int
    n_standard: int
    counts: tuple[tuple[str, int], ...]


def build_robot_section(identification: Identification) -> Section:
    """Return the section on the robot that was identified.

    Parameters
    ----------
    identification : Identification
        The identified model, with the data of its fit.

    Returns
    -------
    Section
        Joints with their limits, and the number of parameters.
    """
    robot = identification.model.robot
    content = RobotContent(
        robot,
        tuple(_build_joint_row(robot, index) for index in range(robot.n)),
        f"({', '.join(format_number(float(value)) for value in robot.gravity)}) m/s²",
        tuple(f"{name} at {format_number(value)}" for name, value in robot.locked_joints.items()),
        identification.model.n_parameters,
        len(identification.model.columns),
        tuple(Counter(column.effect for column in identification.model.kept).items()),
    )
    return Section("robot", "The robot", "robot", content)


def _build_joint_row(robot: Robot, index: int) -> JointRow:
    joint = robot.joints[index]
    unit = "rad" if joint.kind == "revolute" else "m"
    limits = joint.limits
    gain = robot.drives[index].gain
    return JointRow(
        index + 1,
        joint.name,
        joint.kind,
        robot.joint_names[joint.parent] if joint.parent >= 0 else "base",
        format_range(*limits.position, unit) if limits.position else "–",
        _format_limit(limits.velocity, f"{unit}/s"),
        _format_limit(limits.acceleration, f"{unit}/s²"),
        _format_limit(limits.jerk, f"{unit}/s³"),
        _format_limit(limits.effort, joint.effort_unit),
        "–" if gain is None else f"{format_number(gain, 4)} {_get_gain_unit(joint)}",
    )


def _format_limit(value: float | None, unit: str) -> str:
    return "–" if value is None else f"{format_number(value)} {unit}"


def _get_gain_unit(joint: Joint) -> str:
    return f"{joint.effort_unit}/A"


_COVARIANCE_TEXTS: Mapping[CovarianceName, str] = MappingProxyType(
    {
        "by_time_and_joints": "Standard deviations treat blocks of time as independent of each other. "
        "Within a block, all samples of all joints may be correlated.",
        "by_joint": "Standard deviations account for the correlation of each joint's samples in time, and "
        "treat the joints as independent.",
        "independent": "Standard deviations treat every filtered sample as independent, as [12.6] does: "
        "they are too small.",
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
        The identified model, with the data of its fit.

    Returns
    -------
    Section
        Parameters by effect, and how their standard deviations come about.
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


@dataclass(frozen=True)
class EffectRow:
    """One effect of the model; `drawn` is its formula as a drawing, `formula` the same as LaTeX."""

    identifier: str
    title: str
    formula: str
    drawn: Markup | None
    joints: str
    shape: str
    sources: str
    added: bool


@dataclass(frozen=True)
class ModelContent:
    """The content of the section: the effects and the other choices."""

    effects: tuple[EffectRow, ...]
    choices: tuple[tuple[str, str], ...]


def build_model_section(identification: Identification) -> Section:
    """Return the section on the columns of the observation matrix W.

    Parameters
    ----------
    identification : Identification
        The identified model, with the data of its fit.

    Returns
    -------
    Section
        Effects with their formulas, and the other choices.
    """
    robot = identification.model.robot
    choices = identification.choices
    strategy = choices.strategy if choices.strategy != "sequential" else f"sequential, {choices.steps}"
    # What a step of the ladder added is marked: those effects were found, and not assumed.
    added = {choice for ladder_model in identification.ladder() for choice in ladder_model.step.added}
    content = ModelContent(
        tuple(_build_effect_row(choice, robot, choice in added) for choice in choices.effects),
        (
            ("model", choices.model),
            ("strategy", strategy.replace("_", " ")),
            ("estimator", describe_estimator(identification)),
            ("prior", "none" if choices.belief is None else f"the {choices.belief.called}"),
            ("tolerance of the base parameters", format_number(choices.tolerance)),
        ),
    )
    return Section("model", "The model", "model", content)


def _build_effect_row(choice: EffectChoice, robot: Robot, added: bool) -> EffectRow:
    effect = get_effect(choice.effect)
    places = [robot.tree.joint_names[j] for j in find_joints(choice, robot)]
    everywhere = len(places) == robot.n or effect.scope == "robot"
    return EffectRow(
        effect.id,
        effect.title,
        effect.formula,
        draw_formula(effect.formula),
        "whole robot" if effect.scope == "robot" else "all joints" if everywhere else ", ".join(places),
        format_shape_constants(choice),
        "; ".join(effect.sources),
        added,
    )


@dataclass(frozen=True)
class LadderContent:
    """The content of the section: the models, and their errors per joint."""

    models: ReportedTable
    joints: ReportedTable


@dataclass(frozen=True)
class LadderFigure:
    """The errors of all models as a figure; `kind` says of which data those by joint are."""

    figure: Markup
    kind: str
    has_floor: bool


def build_ladder_figure(identification: Identification, diagnosis: Diagnosis | None) -> LadderFigure:
    """Draw the errors of every model, in total and by joint, with the noise floor where a diagnosis tells it."""
    floor = _compute_relative_floor(identification, diagnosis)
    kind, _ = select_comparable_errors(list_steps(identification))
    return LadderFigure(draw_models(list(identification.ladder()), floor), kind, floor is not None)


def build_ladder_section(identification: Identification, diagnosis: Diagnosis | None) -> Section:
    """Return the section on all models from the first to this one.

    Parameters
    ----------
    identification : Identification
        The identified model, with the data of its fit.
    diagnosis : Diagnosis or None
        Diagnosis that tells the noise floor.

    Returns
    -------
    Section
        A row for each model, and their errors by joint.
    """
    steps, joints = list_steps(identification), identification.model.robot.joint_names
    floor = _compute_relative_floor(identification, diagnosis)
    content = LadderContent(
        build_ladder_table(steps, joints),
        build_ladder_joint_table(steps, joints, None if floor is None else floor.tolist()),
    )
    return Section("ladder", "The ladder of models", "ladder", content)


def _compute_relative_floor(identification: Identification, diagnosis: Diagnosis | None) -> FloatArray | None:
    """Return the noise floor over the rms of the measured torque, (n,); None where it is unknown."""
    if diagnosis is None:
        return None
    is_held_out = all(model.held_out_judged is not None for model in identification.ladder())
    errors = identification.held_out_judged if is_held_out else identification.fit_judged
    assert errors is not None
    # A joint without torque or without rows must not divide by zero.
    measured = np.sqrt(errors.measured / np.maximum(errors.counts, 1.0))
    return np.asarray(diagnosis.noise_floor / np.maximum(measured, np.finfo(float).tiny))
