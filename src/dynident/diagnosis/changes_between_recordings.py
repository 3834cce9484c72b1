"""Compare an earlier and a later set of recordings: identify on both, list changes and differences of friction.

How large each change is, is in `change_sizes`; changes over more than two days are in `monitoring`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from scipy.special import stdtrit

from dynident.array_types import FloatArray
from dynident.diagnosis.change_sizes import Estimates, describe_carrier, yield_changes
from dynident.diagnosis.comparison.data_leakage import find_overlaps
from dynident.diagnosis.comparison.measured_against_predicted import Comparison
from dynident.diagnosis.diagnosis_result import Change, FrictionDifference, RankedEffect
from dynident.diagnosis.disturbances import UndisturbedData, leave_out_disturbances
from dynident.diagnosis.search.search_state import Finding
from dynident.effects import Column, EffectChoice, get_effect
from dynident.effects.catalogue import get_role
from dynident.effects.effect_columns import is_lasting_change
from dynident.errors import DynidentError
from dynident.identification import Identification, identify_model, reidentify
from dynident.identification.equations.model_and_data_checks import check_runs, check_temperature
from dynident.identification.equations.reduced_recordings import split_friction_tests
from dynident.identification.identification_choices import PriorName
from dynident.identification.identified_models.add_effects import extend_at_once
from dynident.number_format import format_percent
from dynident.progress import Progress, ignore_progress
from dynident.recordings import Recording
from dynident.robot.joint import Joint
from dynident.robot.robot_model import Robot


def add_friction_differences(
    grown: Identification, since: tuple[str, ...], recordings: Sequence[Recording]
) -> Identification:
    """Extend the model so that the friction of every joint may differ in the later runs.

    Friction is hardly ever the same on two days. Where the model has no parameters for differences too small to be
    findings, the values of the findings make up for them, and their intervals do not say so.

    Returns
    -------
    Identification
        The extended model; where nothing is lacking or determined, the model that was given.
    """
    lacking = [
        EffectChoice(effect, joints, (), since) for effect, joints in _list_lacking_friction(grown, since).items()
    ]
    if not lacking:
        return grown
    # At once where that works: a joint fit of all differences is one identification instead of many.
    with suppress(DynidentError):
        return extend_at_once(grown, lacking, recordings)
    # What the motions do not determine of one joint is no reason to say nothing of the others.
    for choice in lacking:
        for joint in choice.joints:
            with suppress(DynidentError):
                grown = extend_at_once(grown, [replace(choice, joints=(joint,))], recordings)
    return grown


def compute_friction_differences(
    grown: Identification, since: tuple[str, ...], later: Sequence[Comparison]
) -> tuple[FrictionDifference, ...]:
    """Compute by how much the friction of every joint that moves is larger in the later runs.

    Coulomb and viscous friction make up for each other: their sum at the joint's speed is known far better than either,
    and
    is what people feel.

    Parameters
    ----------
    grown : Identification
        The model with all findings, and with friction that may differ.
    since : tuple of str
        Labels of the later runs.
    later : sequence of Comparison
        The later recordings with a model of them.

    Returns
    -------
    tuple of FrictionDifference
        One for each joint that moves and whose friction may differ.
    """
    # At least one row: a joint that never moves then has the speed zero, and no difference.
    rows = np.maximum(np.sum([comparison.moving.sum(axis=0) for comparison in later], axis=0), 1)
    # Mean speed of the rows where the joint moves: the friction there is what the data know best.
    speeds = np.sum([(np.abs(comparison.dq) * comparison.moving).sum(axis=0) for comparison in later], axis=0) / rows
    friction_torque = np.sum([_compute_dissipation(comparison) for comparison in later], axis=0) / rows
    return tuple(
        replace(difference, before=float(friction_torque[j]) - difference.value)
        for j, joint in enumerate(grown.model.robot.joints)
        for difference in _yield_difference_at_speed(grown, since, joint, float(speeds[j]))
    )


def _compute_dissipation(comparison: Comparison) -> FloatArray:
    """Return (n,): the sum of the torque along the motion beside the rigid body's."""
    return np.asarray(
        # The sign of the velocity makes dissipated torque add up; torque that only holds the joint changes sign with
        # it.
        (np.sign(comparison.dq) * (comparison.predicted - comparison.load) * comparison.moving).sum(axis=0)
    )


def _list_lacking_friction(grown: Identification, since: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """Return, by effect, the joints whose friction the model has for all runs and not yet for the later ones."""
    known_places = {(column.effect, column.link) for column in grown.model.kept if column.runs == since}
    lacking: dict[str, tuple[str, ...]] = {}
    for column in grown.model.kept:
        place = (column.effect, column.link)
        if not column.runs and get_role(column) in ("dry", "damping") and place not in known_places:
            lacking[column.effect] = (*lacking.get(column.effect, ()), column.link)
    return lacking


def _yield_difference_at_speed(
    grown: Identification, since: tuple[str, ...], joint: Joint, speed: float
) -> Iterator[FrictionDifference]:
    """Yield the friction difference of one joint at a speed; nothing where it stands or is undetermined."""
    direction = np.array(
        [
            _compute_unit_torque(column, speed) if column.link == joint.name and column.runs == since else 0.0
            for column in grown.model.kept
        ]
    )
    index = np.flatnonzero(direction)
    if not len(index) or speed == 0.0:
        return
    along, statistics = direction[index], grown.statistics
    deviation = np.sqrt(max(float(along @ statistics.covariance[np.ix_(index, index)] @ along), 0.0))
    half = float(stdtrit(statistics.freedom[index].min(), 0.975) * deviation)
    value = float(along @ grown.values[index])
    yield FrictionDifference(joint.name, speed, value, (value - half, value + half), joint.effort_unit, 0.0)


def _compute_unit_torque(column: Column, speed: float) -> float:
    """Return the torque at a speed for a unit of a column's parameter, of Coulomb and viscous friction."""
    role = get_role(column)
    return 1.0 if role == "dry" else speed if role == "damping" else 0.0


def identify_on_both(
    identification: Identification,
    baseline: Sequence[Recording],
    recordings: Sequence[Recording],
    progress: Progress = ignore_progress,
) -> tuple[Identification, tuple[Recording, ...], tuple[str, ...]]:
    """Identify the model on both sets of recordings as if nothing had changed.

    The later recordings get names of their own: runs are told apart by their names. Tests of single joints' friction
    are
    left out, and with them the strategies and estimators that need more than the rows of both.

    Parameters
    ----------
    identification : Identification
        The identified model.
    baseline, recordings : sequence of Recording
        The earlier and the later set.
    progress : Progress
        Called with the fraction done and a message; may raise to cancel.

    Returns
    -------
    (Identification, tuple of Recording, tuple of str)
        The model, all recordings with the baseline first, and the labels of the later runs.

    Raises
    ------
    DynidentError
        Where one of the two sets is nothing but such tests, or a recording is in both.
    """
    # Tests of single joints have their own rows and strategies, which do not combine with those of two sets.
    later = split_friction_tests(recordings)[0]
    try:
        earlier = split_friction_tests(baseline)[0]
    except DynidentError as error:
        raise DynidentError(error.detail, pointer="/baseline_ids", title=error.title) from error
    _check_no_copies(earlier, later)
    earlier_names = {recording.name for recording in earlier}
    # Controllers often name all their recordings alike, and the runs of both days have to be told apart.
    renamed = [
        replace(recording, name=f"{recording.name} (later)") if recording.name in earlier_names else recording
        for recording in later
    ]
    since = tuple(dict.fromkeys(label for recording in renamed for label in recording.segment_names))
    everything = (*earlier, *renamed)
    effects = identification.choices.effects
    check_temperature(effects, everything, ())
    check_runs(effects, everything)
    both = identify_model(
        identification.model,
        everything,
        (),
        replace(
            identification.choices,
            # A global fit by weighted least squares uses nothing but the rows of both sets.
            strategy="global",
            estimator="wls",
            prior=_select_prior(identification.choices.prior),
        ),
        identification.preprocessing,
        identification.estimate.next_reference(),
        progress,
    )
    return both, everything, since


def prepare_undisturbed(
    identification: Identification, recordings: Sequence[Recording], baseline: Sequence[Recording] = ()
) -> tuple[UndisturbedData, tuple[str, ...]]:
    """Prepare what a diagnosis judges, without disturbed seconds.

    Parameters
    ----------
    identification : Identification
        The identified model.
    recordings, baseline : sequence of Recording
        The recordings to judge, and earlier ones to compare them with.

    Returns
    -------
    (UndisturbedData, tuple of str)
        The model, identified without robust weights, and the recordings; the labels of the runs after the baseline.
    """
    recordings, _ = split_friction_tests(recordings)
    since: tuple[str, ...] = ()
    if baseline:
        identification, recordings, since = identify_on_both(identification, baseline, recordings)
    # A push of a few seconds shifts all parameters, and its traces look like missing friction. So disturbed seconds are
    # taken out before anything else.
    return leave_out_disturbances(_reidentify_unweighted(identification), recordings), since


def _reidentify_unweighted(identification: Identification) -> Identification:
    """Identify the model once more with equally weighted rows, by plain least squares, where it was not.

    Missing friction shows where joints reverse, which weights would hide. And what keeps parameters to bodies that can
    exist would be in the residual as if it were missing, too.
    """
    choices, estimate = identification.choices, identification.estimate
    is_held = choices.solver.possible_where_free
    if not (choices.weighs_turns or is_held) or not choices.plan.from_reduced or estimate.not_essential:
        return identification
    estimator = "wls" if is_held else choices.estimator
    return reidentify(identification, replace(choices, weigh_turns=False, estimator=estimator))


def _check_no_copies(earlier: Sequence[Recording], later: Sequence[Recording]) -> None:
    """Raise where the same samples are in both sets: a recording does not differ from itself."""
    copies = [overlap for overlap in find_overlaps(earlier, later) if overlap.kind == "copied"]
    if copies:
        details = "; ".join(
            f"{overlap.held_out} is among the earlier and the later recordings (it holds the same samples as "
            f"{overlap.fitted})"
            for overlap in copies
        )
        raise DynidentError(
            f"{details}: give each recording once, earlier ones as before, later ones as after",
            pointer="/baseline_ids",
            title="One recording on both sides",
        )


def _select_prior(prior: PriorName | None) -> PriorName | None:
    """Return the prior to use: the entropic one goes with the feasible estimator alone, so numbers replace it."""
    return None if prior is None else "description"


def list_changes(
    grown: Identification, findings: Sequence[Finding], ranked: Sequence[RankedEffect], since: tuple[str, ...]
) -> tuple[Change, ...]:
    """List the findings that only the later runs have, joint by joint, with their values in the final model.

    Parameters
    ----------
    grown : Identification
        The model with all findings, and with friction that may differ in the later runs.
    findings, ranked : sequences of equal length
        The findings, and the same findings in the ranking.
    since : tuple of str
        Labels of the later runs.

    Returns
    -------
    tuple of Change
        Changes in the order of the findings.
    """
    estimates = Estimates.from_identification(grown)
    changes: list[Change] = []
    for finding, ranked_effect in zip(findings, ranked, strict=True):
        if is_lasting_change(ranked_effect.choice, since):
            changes += yield_changes(estimates, finding, ranked_effect)
    return tuple(changes)


def word_changes(robot: Robot, changes: Sequence[Change], friction: Sequence[FrictionDifference]) -> str:
    """Word what changed in a sentence, and how much friction may have changed without being seen."""
    bound = _word_friction_bound({joint for change in changes for joint in change.choice.joints}, friction)
    if not changes:
        return f"These recordings show no change since the baseline.{bound}"
    parts = [
        f"{get_effect(change.choice.effect).title}"
        f"{f' on {describe_carrier(robot, change.choice)}' if change.choice.joints else ''} "
        f"({change.main.parameter} {change.main.value:+.3g}{'' if change.main.unit == '-' else f' {change.main.unit}'})"
        for change in changes
    ]
    return f"Changed since the baseline: {'; '.join(parts)}.{bound}"


def _word_friction_bound(changed: Collection[str], friction: Sequence[FrictionDifference]) -> str:
    """Word the least and the most that friction of unchanged joints may differ by."""
    bounds = sorted(
        (max(abs(end) for end in difference.interval) / difference.before, difference.joint)
        for difference in friction
        if difference.joint not in changed and difference.before > 0.0
    )
    if not bounds:
        return ""
    (least, best), (most, worst) = bounds[0], bounds[-1]
    if best == worst:
        return f" The friction of {best} differs by no more than {format_percent(most, decimals=1)}."
    others = "other " if changed else ""
    return (
        f" The friction of each {others}joint differs by no more than {format_percent(least, decimals=1)} ({best}) to "
        f"{format_percent(most, decimals=1)} ({worst})."
    )
