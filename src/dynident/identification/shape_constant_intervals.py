"""Values and intervals of a model's shape constants, or why there is none (end of the range, no information)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf
from typing import Literal

import numpy as np

from dynident.effects import EffectChoice, ShapeSpec, build_columns, get_effect
from dynident.effects.effect_columns import find_joints
from dynident.effects.effect_text_format import format_constant
from dynident.estimation import (
    CovarianceName,
    EstimationError,
    LinearisedSolution,
    Reduction,
    Solution,
    linearise_constants,
)
from dynident.identification.shape_refinement import ShapeVariable, list_shape_variables
from dynident.identification.shape_search import DOWN, UP
from dynident.identification.thresholds import DETERMINED
from dynident.regressors.model_structure import Model
from dynident.robot.robot_model import Robot

ShapeJudgement = Literal["determined", "uncertain", "not_determined", "at_edge", "elsewhere", "chosen", "not_looked_at"]

_AT_END = 1e-3
"""Share of the end of the range within which a value counts as being at that end."""

_NO_BETTER = 0.7
"""Of the standard deviation of the range that is searched: the data tell no more of a constant than that range."""


@dataclass(frozen=True)
class ShapeConstant:
    """A constant inside an effect's columns, with its uncertainty.

    Parameters
    ----------
    effect : str
        The effect.
    joints : tuple of str
        Names of the joints that it acts on; none for the whole robot.
    name : str
        Name of the constant.
    unit : str
        Unit of the constant, "-" where it has none.
    description : str
        What the constant is, in words.
    value : float
        Its value in the model.
    judgement : str
        The data determine it ("determined"), leave it "uncertain", do not determine it within the range that is
        searched ("not_determined"), have it "at_edge" of that range or "elsewhere" than the model; it is one of a few
        kinds that was "chosen"; or nobody looked ("not_looked_at").
    standard_deviation : float
        Standard deviation in `unit`; infinite where there is none.
    interval : tuple of float or None
        Ends of the interval that holds the true value with a probability of 95 %.
    note : str
        Why there is no number, where there is none.
    """

    effect: str
    joints: tuple[str, ...]
    name: str
    unit: str
    description: str
    value: float
    judgement: ShapeJudgement
    standard_deviation: float = inf
    interval: tuple[float, float] | None = None
    note: str = ""

    def __repr__(self) -> str:
        place = f" on {', '.join(self.joints)}" if self.joints else ""
        unit = "" if self.word or self.unit == "-" else f" {self.unit}"
        value = f"{format_constant(self.effect, self.name, self.value)}{unit}"
        return f"ShapeConstant({self.effect}{place}, {value}, {self.judgement})"

    @property
    def word(self) -> str | None:
        """Name of the kind that the value stands for; None where the constant is a number."""
        known = next((spec for spec in get_effect(self.effect).shapes if spec.name == self.name), None)
        return known.get_word(self.value) if known else None


_LINE_RANGE = 10
"""Times as far as a line is refined it may lie elsewhere: a spectrum is as sharp as the motion is long."""


def linearise_shapes(
    model: Model, solution: Solution, kind: CovarianceName, shaped: Reduction
) -> LinearisedSolution | None:
    """Linearise the joints' torques about the model's parameters and shape constants together.

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    solution : Solution
        The model's, weighted by the noise of the joints' torques.
    kind : str
        Which residuals are taken to be correlated.
    shaped : Reduction
        The joints' torques in the model's columns and, behind them, those of `shape_columns`.

    Returns
    -------
    LinearisedSolution or None
        None where there are no constants to look at.
    """
    ranges = []
    for place in list_shape_variables(model.effects):
        # The range acts as a weak prior, so that a constant that the data do not show keeps a finite uncertainty.
        low, high = get_search_range(place, model.effects[place.choice], model.robot)
        # A constant that may be anywhere in its range has this standard deviation before any data: that of an even
        # distribution.
        ranges.append(place.compute_change(low, high) / np.sqrt(12.0))
    try:
        return linearise_constants(shaped, solution, np.array(ranges), kind) if ranges else None
    # No statement is possible; the model itself is not affected.
    except EstimationError:
        return None


def judge_shape_constants(model: Model, linearisation: LinearisedSolution | None) -> tuple[ShapeConstant, ...]:
    """Return the shape constants of a model, with what the joints' torques say of them.

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    linearisation : LinearisedSolution, optional
        None where nobody looked.

    Returns
    -------
    tuple of ShapeConstant
        All constants, in the order of the effects.
    """
    looked: dict[tuple[int, str], ShapeConstant] = {}
    if linearisation is not None:
        estimates = zip(
            list_shape_variables(model.effects),
            linearisation.steps,
            linearisation.deviations,
            linearisation.half_widths,
            strict=True,
        )
        significant = _find_significant_choices(model, linearisation)
        looked = {
            (p.choice, p.spec.name): _judge_constant(model, p, p.choice in significant, *map(float, numbers))
            for p, *numbers in estimates
        }
    return tuple(
        looked.get((number, spec.name)) or _build_unjudged(choice, spec, model.robot)
        for number, choice in enumerate(model.effects)
        for spec in get_effect(choice.effect).shapes
        if spec.name in choice.shape_values
    )


def _find_significant_choices(model: Model, linearisation: LinearisedSolution) -> set[int]:
    """Return the numbers of the choices with at least one parameter that differs from zero significantly."""
    # With the shape constants uncertain as well: alone, the parameters would look too sure.
    half = linearisation.parameter_statistics.half_widths()
    sure = {
        column.key
        for column, value, width in zip(
            model.kept, linearisation.solution.values[: linearisation.n_own], half, strict=True
        )
        if abs(value) > width
    }
    return {
        number
        for number, choice in enumerate(model.effects)
        if any(column.key in sure for column in build_columns([choice], model.signals))
    }


def _build_constant(
    choice: EffectChoice, spec: ShapeSpec, robot: Robot, judgement: ShapeJudgement, note: str
) -> ShapeConstant:
    alone = get_effect(choice.effect).scope == "robot"
    joints = () if alone else tuple(robot.tree.joint_names[j] for j in find_joints(choice, robot))
    value = choice.shape_values[spec.name]
    return ShapeConstant(choice.effect, joints, spec.name, spec.unit, spec.description, value, judgement, note=note)


def _build_unjudged(choice: EffectChoice, spec: ShapeSpec, robot: Robot) -> ShapeConstant:
    if spec.can_be_refined(choice.shape_values[spec.name]):
        note = "its uncertainty is only known with recordings: identify from them"
        return _build_constant(choice, spec, robot, "not_looked_at", note)
    note = "chosen from a few discrete values"
    if spec.proposal == "burst":
        note = "read from the residual, without an uncertainty"
    return _build_constant(choice, spec, robot, "chosen", note)


def _judge_constant(
    model: Model, place: ShapeVariable, significant: bool, step: float, deviation: float, half: float
) -> ShapeConstant:
    """Judge a constant by its interval; step, deviation and half-width as `ShapeVariable.apply_change` takes them."""
    choice, value, robot = model.effects[place.choice], place.get_value(model.effects), model.robot
    low, high = get_search_range(place, choice, robot)
    data = place.apply_change(value, step)

    def build_constant(judgement: ShapeJudgement, note: str) -> ShapeConstant:
        return _build_constant(choice, place.spec, robot, judgement, note)

    # The derivative by the constant is proportional to the effect's size, so without an effect its constant means
    # nothing.
    if not significant:
        return build_constant("not_determined", "the effect itself is not significantly different from zero")
    ends = place.apply_change(value, step - half), place.apply_change(value, step + half)
    open_ = deviation > _NO_BETTER * place.compute_change(low, high) / np.sqrt(12.0)
    if open_ or (ends[0] <= low and ends[1] >= high):
        return build_constant(
            "not_determined", f"the data do not determine it between {low:.3g} and {high:.3g}, the whole search range"
        )
    if value <= low * (1 + _AT_END) and step <= half and not place.spec.signed:
        return build_constant("at_edge", f"at the lower end of the search range ({low:.3g}): it may be smaller")
    if value >= high * (1 - _AT_END) and step >= -half and not place.spec.signed:
        return build_constant("at_edge", f"at the upper end of the search range ({high:.3g}): it may be larger")
    # A linearisation only holds nearby. A step beyond the interval, and beyond a step of the search, means a new
    # search.
    if abs(step) > max(half, place.to_change(1.0)):
        way = "larger" if step > 0 else "smaller"
        return build_constant(
            "elsewhere", f"the data need a {way} value, by more than its uncertainty: search for it again"
        )
    # In octaves the deviation is that of the logarithm, which is a relative one already.
    sure = deviation <= (DETERMINED if place.search.in_octaves else max(DETERMINED * abs(value), place.to_change(1.0)))
    constant = build_constant("determined" if sure else "uncertain", "")
    # The optimum is elsewhere than the stored value, but near enough for the linearisation to say where.
    if abs(step) > half:
        constant = build_constant("elsewhere", f"the best value for the data is {data:.4g}, the centre of its interval")
    spread = deviation * (value if place.search.in_octaves else 1.0)
    return replace(constant, standard_deviation=spread, interval=ends)


def get_search_range(place: ShapeVariable, choice: EffectChoice, robot: Robot) -> tuple[float, float]:
    """Return the range that a constant is searched in.

    It lies about the effect's grid, or about the value that a spectrum showed.

    Parameters
    ----------
    place : ShapeVariable
        The constant, and how it is searched for.
    choice : EffectChoice
        The effect with its shape constants.
    robot : Robot
        The robot.
    """
    around, wide = [choice.shape_values[place.spec.name]], _LINE_RANGE
    if place.spec.proposal == "grid":
        joint = find_joints(choice, robot)[0]
        around = [shape[place.spec.name] for shape in get_effect(choice.effect).grid(robot.tree, joint)]
        wide = 1
    low = min(place.search.apply_steps(value, -wide * DOWN) for value in around)
    high = max(place.search.apply_steps(value, wide * UP) for value in around)
    return (low if place.spec.signed else max(low, place.spec.least)), high
