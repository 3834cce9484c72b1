"""Warnings about an identified model, in sentences for the user."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dynident.effects import DEFAULT_EFFECTS, OFFSETS, get_role
from dynident.estimation import compute_equilibrated_condition_number, find_outlying_spans
from dynident.identification.thresholds import (
    DETERMINED,
    EQUATIONS_PER_PARAMETER,
    LARGEST_CONDITION_NUMBER,
    OVERFIT,
)

if TYPE_CHECKING:
    from dynident.identification.study.estimate import Estimate
    from dynident.identification.study.result import Identification

_MISFIT = 0.2
"""Share of the torque left by the fit, above which the data are doubted; sound arms leave 3 to 15 %."""

_MOST_NAMED = 12
"""Uncertain parameters that are named; the others are counted."""


def list_warnings(identification: Identification) -> tuple[str, ...]:
    """Return all that is doubtful about a result, most important first.

    Parameters
    ----------
    identification : Identification
        The identified model.

    Returns
    -------
    tuple of str
        Sentences for the user.
    """
    sentences = []
    # Poses at rest have no inertia matrix; their eigenvalue is not a number and says nothing.
    if not identification.inertia_matrix_positive_definite and np.isfinite(identification.worst_inertia_eigenvalue):
        sentences.append(
            "The inertia matrix is not positive definite in every posture: the parameters are not physically possible "
            "as they stand, so use them for prediction near the recorded motion only."
        )
    sentences += _warn_of_disturbance(identification)
    sentences += _warn_of_misfit(identification)
    sentences += _warn_of_unsettled(identification)
    sentences += _warn_of_other_equations(identification)
    sentences += _warn_of_excitation(identification)
    sentences += _warn_of_overfit(identification)
    sentences += _warn_of_friction_signs(identification)
    sentences += _warn_of_missing_torque(identification)
    # Effects that dissolved in others are still in the torque, but have no parameter of their own.
    absorbed = [f"{column.effect} ({column.name})" for column in identification.model.absorbed_columns]
    if absorbed:
        sentences.append(f"Not separable from other parameters, and therefore left out: {', '.join(absorbed)}.")
    return tuple(sentences)


def _warn_of_missing_torque(identification: Identification) -> list[str]:
    """Say what is not known of joints whose torque was not recorded."""
    model = identification.model
    if not model.robot.joints_without_torque:
        return []
    hidden = ", ".join(column.name for column in model.hidden_columns)
    return [
        f"No recording has the torque of {', '.join(model.robot.joints_without_torque)}. The motion is used; what only "
        f"the joint's own equation would show is not identifiable from this data{f' ({hidden})' if hidden else ''}, "
        "and what the model says of such a torque is that of the links alone, and was held against no data."
    ]


def _warn_of_disturbance(identification: Identification) -> list[str]:
    """Warn of seconds in which something else than the robot acted.

    They shift all parameters, and show in no error by themselves.
    """
    return [
        f"From {span.start:.1f} to {span.end:.1f} s of the data something else acted: there the residual is "
        f"{np.sqrt(span.ratio):.0f} times that of all other rows once they are solved without it. A contact, a load "
        "that was picked up, a brake, a collision, or a clock that jumped? Diagnose: it says what, and when exactly. "
        "Leave these seconds out."
        for span in find_outlying_spans(identification.data.training).spans
    ]


def _warn_of_misfit(identification: Identification) -> list[str]:
    """Warn of a fit that leaves much of the torque it was made from: mostly the data are wrong, not the effects."""
    share = identification.fit.relative_total
    if not identification.choices.rows.by_joint or share <= _MISFIT:
        return []
    # The joint with the largest residual in N m: it tells where to look.
    worst = identification.model.robot.joint_names[int(np.argmax(identification.fit.rms))]
    return [
        f"Even in the fit {share:.0%} of the torque is left unexplained, most on {worst}: look at the order, signs and "
        "units of the columns, at the joints' axes and gravity in the description, for loads that it lacks, and for "
        "joints that give."
    ]


def _warn_of_unsettled(identification: Identification) -> list[str]:
    """Warn of iterations that have not settled, where the estimator does not say so itself."""
    if identification.converged or identification.choices.solver.tells_convergence:
        return []
    return [
        f"The rounds of weighing ({identification.choices.solver.name}) have not settled: the estimates still move "
        "from one to the next. Few rows for many parameters, or joints without residual, cause that; compare with ols."
    ]


def _warn_of_other_equations(identification: Identification) -> list[str]:
    """Say what the errors of torque mean where the torques were not what was fitted."""
    model = identification.choices.model
    if model in ("energy", "power"):
        return [
            f"The {model} model has one equation and does not minimise the errors of torque (§12.6): judge it by "
            "these, on validation data, beside the dynamic model's."
        ]
    if model == "base_wrench":
        sentence = (
            "The base's wrench shows the links alone: friction and rotors are not in this model, so the errors of "
            "torque contain all of these. The small reaction of turning rotors counts as the links'."
        )
        if not identification.inertia_matrix_positive_definite:
            sentence += (
                " Check the sign of the wrench: it is that of the base on the robot, so at rest its force points up."
            )
        return [sentence]
    return []


def _warn_of_excitation(identification: Identification) -> list[str]:
    sentences = []
    condition = compute_equilibrated_condition_number(
        identification.data.equations, identification.estimate.solution.noise
    )
    # Columns of equal size: otherwise the units of the parameters decide, and not the motion.
    if condition > LARGEST_CONDITION_NUMBER:
        help_is = "Record an exciting trajectory (a design)"
        help_is += "." if identification.choices.prior else ' or use a prior (prior: "description").'
        sentences.append(
            f"The condition number of W with columns of equal size is {condition:.0f}: the motion alone does not "
            f"determine the model well. {help_is}"
        )
    at_rest = identification.model.is_at_rest
    if not at_rest and identification.equations_per_parameter < EQUATIONS_PER_PARAMETER:
        sentences.append(
            f"There are {identification.equations_per_parameter:.0f} equations per parameter after decimation; "
            f"{EQUATIONS_PER_PARAMETER:.0f} are recommended (§12.7). A longer recording helps."
        )
    return sentences + _warn_of_uncertain(identification.estimate)


def _warn_of_uncertain(estimate: Estimate) -> list[str]:
    """Warn of parameters that the data do not determine; those that may as well be zero do no harm by it."""
    parameters = estimate.parameters
    unsure = [p.name for p in parameters if p.judgement == "uncertain"]
    zero = sum(p.judgement == "zero_in_interval" for p in parameters)
    if not unsure:
        return []
    names = ", ".join(unsure[:_MOST_NAMED]) + (
        f" and {len(unsure) - _MOST_NAMED} more" if len(unsure) > _MOST_NAMED else ""
    )
    others = f" {zero} more are not told from zero." if zero else ""
    return [
        f"{len(unsure)} of {len(parameters)} parameters are uncertain (standard deviation above {DETERMINED:.0%} of "
        f"the value, or known from elsewhere rather than from the data): {names}.{others}"
    ]


def _warn_of_overfit(identification: Identification) -> list[str]:
    if identification.held_out is None:
        return ["No validation data was given: the errors are those of the fit itself and flatter the model."]
    # A model may fit noise as well. Held-out data show it, because their noise is another.
    if identification.held_out.relative_total > OVERFIT * identification.fit.relative_total:
        return [
            f"The error on validation data is {identification.held_out.relative_total:.1%} against "
            f"{identification.fit.relative_total:.1%} in the fit: the data do not determine the model, or the "
            "validation motion shows what the identification motion did not."
        ]
    return []


def _warn_of_friction_signs(identification: Identification) -> list[str]:
    """Warn of negative friction, which would drive the motion: a sign or the order of joints is probably wrong.

    Beside other friction effects a negative part is possible, so only plain models are judged.
    """
    if any(choice.effect not in _PLAIN for choice in identification.choices.effects):
        return []
    return [
        f"{parameter.name} on {parameter.link} is negative ({parameter.value:.3g} {parameter.unit}): check the sign of "
        "its torque and the order of the torque columns."
        for parameter, column in zip(identification.parameters, identification.model.kept, strict=True)
        if get_role(column) in ("dry", "damping")
        and not column.runs
        # Three standard deviations: noise alone takes hardly any of a dozen parameters that far below zero.
        and parameter.value < -3.0 * parameter.standard_deviation
    ]


_PLAIN = {choice.effect for choice in (*DEFAULT_EFFECTS, OFFSETS)}
