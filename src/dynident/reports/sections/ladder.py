"""The section on the ladder of models: what each step added, and how the error fell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from dynident.array_types import FloatArray
from dynident.diagnosis import Diagnosis
from dynident.effects import EffectChoice, get_effect
from dynident.estimation import Errors
from dynident.identification import Identification
from dynident.identification.study.held_out_gain import find_best_step
from dynident.reports.figures.ladder import draw_models
from dynident.reports.labels import describe_best_step, format_joints, format_shape_constants, get_step_mark
from dynident.reports.number_format import format_percent
from dynident.reports.report_data import Section
from dynident.robot import Robot


@dataclass(frozen=True)
class StepRow:
    """One model of the ladder, with its errors where joints move, and on all rows of the held-out data."""

    number: int
    changes: tuple[str, ...]
    n_parameters: int
    fit: float
    fit_text: str
    held_out: float | None
    held_out_text: str
    all_rows_text: str
    mark: str


@dataclass(frozen=True)
class JointRow:
    """One joint's error in every model, the last over the first, and what sensor noise alone would leave."""

    joint: str
    errors: tuple[str, ...]
    change: str
    floor: str


@dataclass(frozen=True)
class LadderContent:
    """The content of the section: the models, their errors per joint, and both as a figure."""

    rungs: tuple[StepRow, ...]
    joints: tuple[JointRow, ...]
    kind: str
    best: str
    has_floor: bool


@dataclass(frozen=True)
class LadderFigure:
    """The errors of all models as a figure; `kind` says of which data those by joint are."""

    figure: Markup
    kind: str
    has_floor: bool


def build_ladder_figure(identification: Identification, diagnosis: Diagnosis | None) -> LadderFigure:
    """Draw the errors of every model, in total and by joint, with the noise floor where a diagnosis tells it."""
    models = list(identification.ladder())
    kind, errors = select_comparable_errors(models)
    floor = _compute_relative_floor(diagnosis, errors[-1])
    return LadderFigure(draw_models(models, floor), kind, floor is not None)


def select_comparable_errors(models: Sequence[Identification]) -> tuple[str, list[Errors]]:
    """Return "held out" and the held-out errors of all models where each has one, else "fit" and those of the fit."""
    held_out_errors = [model.held_out_judged for model in models if model.held_out_judged is not None]
    if len(held_out_errors) == len(models):
        return "held out", held_out_errors
    return "fit", [model.fit_judged for model in models]


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
    models = list(identification.ladder())
    kind, errors = select_comparable_errors(models)
    floor = _compute_relative_floor(diagnosis, errors[-1])
    names = identification.model.robot.joint_names
    best = find_best_step(models)
    content = LadderContent(
        tuple(_build_step_row(k, model, get_step_mark(best, k, len(models))) for k, model in enumerate(models)),
        tuple(_build_joint_row(name, [e.relative[j] for e in errors], floor, j) for j, name in enumerate(names)),
        kind,
        describe_best_step(best, len(models)),
        floor is not None,
    )
    return Section("ladder", "The ladder of models", "ladder", content)


def _build_step_row(index: int, model: Identification, mark: str) -> StepRow:
    held_out = model.held_out_judged.relative_total if model.held_out_judged is not None else None
    robot = model.model.robot
    changes = tuple(format_change(choice, robot) for choice in model.step.added)
    changes += tuple(f"without {format_change(choice, robot)}" for choice in model.step.removed)
    return StepRow(
        index + 1,
        changes,
        model.model.n_parameters,
        model.fit_judged.relative_total,
        format_percent(model.fit_judged.relative_total),
        held_out,
        format_percent(held_out),
        format_percent(model.held_out.relative_total) if model.held_out is not None else "–",
        mark,
    )


def format_change(choice: EffectChoice, robot: Robot) -> str:
    """Return an effect with its joints and shape constants, in words."""
    shape = f" ({format_shape_constants(choice)})" if choice.shape else ""
    return f"{get_effect(choice.effect).title} on {format_joints(choice.joints, robot.joint_names)}{shape}"


def _build_joint_row(name: str, errors: Sequence[float], floor: FloatArray | None, joint: int) -> JointRow:
    # The ratio says what all steps together have brought this joint.
    first, last = float(errors[0]), float(errors[-1])
    return JointRow(
        name,
        tuple(format_percent(float(value)) for value in errors),
        f"× {last / first:.2f}" if len(errors) > 1 and first > 0 else "–",
        format_percent(float(floor[joint])) if floor is not None else "",
    )


def _compute_relative_floor(diagnosis: Diagnosis | None, errors: Errors) -> FloatArray | None:
    """Return the noise floor over the rms of the measured torque, (n,); None where it is unknown."""
    if diagnosis is None:
        return None
    # A joint without torque or without rows must not divide by zero.
    measured = np.sqrt(errors.measured / np.maximum(errors.counts, 1.0))
    return np.asarray(diagnosis.noise_floor / np.maximum(measured, np.finfo(float).tiny))
