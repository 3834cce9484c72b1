"""The section on the model: its effects with their formulas."""

from __future__ import annotations

from dataclasses import dataclass

from markupsafe import Markup

from dynident.effects import EffectChoice, get_effect
from dynident.effects.catalogue import find_joints
from dynident.identification import Identification
from dynident.reports.figures.svg import draw_formula
from dynident.reports.numbers import format_number
from dynident.reports.section import Section
from dynident.reports.words import format_shape_constants
from dynident.robot import Robot


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

    Returns
    -------
    Section
    """
    robot = identification.model.robot
    choices = identification.choices
    strategy = choices.strategy if choices.strategy != "sequential" else f"sequential, {choices.steps}"
    added = {choice for rung in identification.ladder() for choice in rung.step.added}
    content = ModelContent(
        tuple(_build_effect_row(choice, robot, choice in added) for choice in choices.effects),
        (
            ("model", choices.model),
            ("strategy", strategy.replace("_", " ")),
            ("estimator", choices.solver.name_with_options.upper()),
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
