"""The conclusion of a diagnosis: something is missing, nothing above the limits is, or the data cannot tell."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from dynident.diagnosis.decision_levels import RULES
from dynident.diagnosis.diagnosis_result import Adequacy, Conclusion, DetectionLimit, UnknownPattern
from dynident.effects import get_effect
from dynident.identification import Identification
from dynident.identification.recording_faults import CAUSES
from dynident.number_format import format_percent
from dynident.recordings import Check
from dynident.recordings.recording_metadata import DELAY
from dynident.robot.joint import MANY_NAMES, join_joint_names

_BEFORE_EFFECTS = (
    *CAUSES,
    DELAY,
    "position_jump",
    "torque_step",
    "joint_columns",
    "position_scale",
    "clock_rate",
    "description_lengths",
)
"""Checks whose findings explain an error better than a missing effect does."""


def point_to_check(checks: Mapping[str, Sequence[Check]]) -> str:
    """Say which check names a cause to correct before missing effects are looked for; "" where none does.

    Parameters
    ----------
    checks : mapping of str to sequence of Check
        The checks by recording.
    """
    for recording, own in checks.items():
        for check in own:
            if check.name in _BEFORE_EFFECTS and check.status != "ok" and not check.is_accepted:
                return (
                    f"First correct what the check {check.name.replace('_', ' ')} of {recording} names: it explains an "
                    "error better than a missing effect does."
                )
    return ""


def compute_held_out_ratio(identification: Identification) -> float:
    """Return the error on held-out data over that of the fit, where joints move, each joint in units of its fit."""
    held_out = identification.held_out_moving
    return math.nan if held_out is None else held_out.compute_ratio_to(identification.fit_moving)


def conclude(
    verdict: Adequacy,
    unknown: Sequence[UnknownPattern],
    limits: Sequence[DetectionLimit] | None,
    ratios: tuple[float, float],
    joint_names: Sequence[str],
    *,
    is_given_up: bool,
) -> Conclusion:
    """Conclude what a diagnosis says in all, and the one next thing to do.

    Parameters
    ----------
    verdict : {"adequate", "missing_effect", "unexplained"}
        Whether effects are recommended, or a residual is left that no effect explains, from the residual alone.
    unknown : sequence of UnknownPattern
        Dependences in the residual that no effect explains.
    limits : sequence of DetectionLimit, optional
        The detection limits; None where they were not computed, so that nothing says what would have shown.
    ratios : tuple of (float, float)
        Error on held-out recordings over that of the fit (NaN where there are none), and error on parts of the motion
        that were left out in a row over that on blocks between others.
    joint_names : sequence of str
        Names of the joints.
    is_given_up : bool
        Whether an effect was not named because the motion does not determine the model.
    """
    if verdict == "missing_effect":
        step = "Add the recommended effects, and diagnose the extended model."
        return Conclusion("something_is_missing", (), step, "extend")
    held_out, part_to_part = ratios
    # A comparison with NaN is false: without held-out data there is nothing to be far above the fit.
    is_far, is_poor = held_out > RULES.part_to_part, part_to_part > RULES.part_to_part or is_given_up
    common = [limit for limit in limits or () if get_effect(limit.effect).often_missed is not None]
    blind = [limit for limit in common if limit.share > 1.0]
    is_blind = len(blind) > RULES.most_blind * len(common)
    if verdict == "adequate" and limits is not None and not (is_far or is_poor or is_blind):
        median = float(np.median([limit.share for limit in common])) if common else math.inf
        words = (
            f"Half of the effects that arms often have would have shown from {format_percent(median, decimals=0)} of "
            "their usual size on."
        )
        known = (words,) if math.isfinite(median) else ()
        return Conclusion("nothing_above_limits", known, "Validate the model on a motion of its use.", "validate")
    if verdict == "unexplained" and not (is_far or is_poor):
        cause = next((pattern.cause for pattern in unknown if pattern.cause), "")
        if cause:
            return Conclusion("something_is_missing", (), cause)
        what = (
            f"{unknown[0].joint} over {unknown[0].variable.replace('_', ' ')}" if unknown else "the residual over time"
        )
        return Conclusion(
            "something_is_missing",
            (),
            f"Look at {what} for what the catalogue lacks, and add it as an effect of your own.",
            "add_own_effect",
        )
    why = []
    if is_far:
        why.append(f"The error on held-out data is {held_out:.1f} times that of the fit.")
    if is_poor:
        why.append("The motion does not determine the model: parts of it do not predict each other.")
    if is_blind:
        why.append(_word_blind(blind, joint_names))
    if not why:
        step = "Diagnose again with detection limits."
        return Conclusion("cannot_tell", ("Detection limits were not computed.",), step)
    experiment = "Record a longer or richer motion, identify the model from it, and diagnose again."
    return Conclusion("cannot_tell", tuple(why), experiment, "record")


def _word_blind(blind: Sequence[DetectionLimit], joint_names: Sequence[str]) -> str:
    """Word which common effects would not have shown at their usual size, a group of joints an effect."""
    places: dict[str, list[str]] = {}
    for limit in blind:
        places.setdefault(limit.effect, []).extend(limit.joints)
    texts = [
        f"{get_effect(effect).title}{f' on {join_joint_names(joints, joint_names, MANY_NAMES)}' if joints else ''}"
        for effect, joints in places.items()
    ]
    return f"These effects would not have shown at their usual size: {'; '.join(texts)}."
