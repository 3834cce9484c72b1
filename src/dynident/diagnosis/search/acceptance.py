"""Decide which candidates are findings, beyond their significance: a gain above the sensor's noise, and more."""

from __future__ import annotations

import numpy as np

from dynident.array_types import FloatArray
from dynident.diagnosis.candidates.accumulate import PhasedProducts
from dynident.diagnosis.candidates.significance import (
    SMALLEST_GAIN_AT_REVERSALS,
    SMALLEST_GAIN_OVER_NOISE,
    ScoredCandidate,
)
from dynident.diagnosis.search.state import State
from dynident.effects import Effect, get_effect
from dynident.effects.effect_columns import is_lasting_change

VISIBLE = 0.02
"""Share of a column that has to be left beside the model for the data to show its effect at all."""

_LEAST_REACH = 0.25
"""Share of a column left beside the model, times the t of what it gains, that a candidate needs.

On a motion that tells the column from the model's, what its parameter leaves open makes one over this as much torque as
the candidate removes here: four times at most (`benchmarks/smallest_gain.py`). Where a joint moved one way only, the
model says all but a thirtieth of friction that differs with the direction."""

# A sensitivity of which so little is left beside the model reaches far beyond the data: it has to gain much.
_BLURRED, _DROP_OF_BLURRED = 0.2, 0.25
_LEAST_OF_RUNS = 0.5
"""Share of the squared error of the joint that it helps most that an effect of some runs alone has to remove.

The motions of two runs differ, too: what a model lacks shows differently in each, and parameters of one run alone make
up for some of it."""

_LEAST_OF_CHANGE = 0.1
"""The same for what the later runs have: it is asked of these runs alone, not of every group of them."""

_SHADOW = 0.05
"""Share of what an effect of a rough formula explains that anything beside it has to: a curve that is off by a fifth of
itself leaves so much, as such formulas are at the ends of the range, and on the other joints that a cable spans, and it
looks like many things."""

# Share of the error itself that serves where the torque has no noise.
_QUIET = 1e-4

JOINT_DROP = 0.03
"""Share of its own squared error that each joint of a group has to gain."""
JOINT_T = 2.0
"""t of the gain of a joint of a group."""
LARGE_DROP, JOINT_T_OF_LARGE = 0.3, 1.5
"""Where it gains this share of its error, a smaller t will do."""


def is_acceptable(state: State, data: PhasedProducts, scored: ScoredCandidate) -> bool:
    """Return whether a candidate is a finding.

    Parameters
    ----------
    state : State
        The model so far and what was found.
    data : PhasedProducts
        Products of all columns.
    scored : ScoredCandidate
        The candidate.
    """
    return _is_surely_there(state, data, scored) and _explains_enough_of_runs(state, scored)


def is_too_small_for_runs(state: State, data: PhasedProducts, scored: ScoredCandidate) -> bool:
    """Return whether a candidate would be a finding, were it not of some runs and too small for that.

    Parameters
    ----------
    state : State
        The model so far and what was found.
    data : PhasedProducts
        Products of all columns.
    scored : ScoredCandidate
        The candidate.
    """
    return (
        bool(scored.candidate.runs)
        and not _explains_enough_of_runs(state, scored)
        and _is_surely_there(state, data, scored)
    )


def _explains_enough_of_runs(state: State, scored: ScoredCandidate) -> bool:
    """Return whether a candidate explains as much as one of some runs alone has to."""
    if not scored.candidate.runs:
        return True
    return scored.drop >= (
        _LEAST_OF_CHANGE if is_lasting_change(scored.candidate.choice, state.since) else _LEAST_OF_RUNS
    )


def _is_surely_there(state: State, data: PhasedProducts, scored: ScoredCandidate) -> bool:
    effect = get_effect(scored.candidate.effect)
    if scored.separability < VISIBLE or not scored.is_significant or is_too_small(state, data, scored):
        return False
    # A column of which little is left needs a gain that is very sure.
    if scored.separability * scored.t < _LEAST_REACH:
        return False
    if effect.first_order and scored.separability < _BLURRED and scored.drop < _DROP_OF_BLURRED:
        return False
    if any(is_shadowed(scored, finding.judged, state.floor) for finding in state.picks):
        return False
    # What pulls at two joints, and explains one of them alone, is a function of that joint.
    return not effect.pulls_on_each or all(has_gain_on_joint(state, data, scored, j) for j in scored.joints)


def is_too_small(state: State, data: PhasedProducts, scored: ScoredCandidate) -> bool:
    """Return whether a candidate removes less of the sensors' noise than its kind has to.

    Parameters
    ----------
    state : State
        The model so far and what was found.
    data : PhasedProducts
        Products of all columns.
    scored : ScoredCandidate
        The candidate.
    """
    most = max(compute_gain_over_floor(scored, j, state.floor, data) for j in scored.joints)
    return most < get_least_gain(get_effect(scored.candidate.effect))


def has_gain_on_joint(state: State, data: PhasedProducts, scored: ScoredCandidate, joint: int) -> bool:
    """Return whether a candidate that acts on several joints lowers the error of one of them enough, and evenly.

    Parameters
    ----------
    state : State
        The model so far and what was found.
    data : PhasedProducts
        Products of all columns.
    scored : ScoredCandidate
        The candidate.
    joint : int
        Index of the joint.
    """
    # In units of the noise of this joint alone, whatever the others gain.
    before = scored.before[:, joint] / state.noise[joint] ** 2
    gain = before - scored.after[:, joint] / state.noise[joint] ** 2
    share = float(gain.sum()) / max(float(before.sum()), np.finfo(float).tiny)
    spread = float(gain.std(ddof=1)) / np.sqrt(len(gain))
    # A large gain may be less even: an effect that shows at few places is there all the same.
    even = float(gain.mean()) >= (JOINT_T if share < LARGE_DROP else JOINT_T_OF_LARGE) * spread
    large = compute_gain_over_floor(scored, joint, state.floor, data) >= get_least_gain(
        get_effect(scored.candidate.effect)
    )
    return share >= JOINT_DROP and even and large


def is_shadowed(scored: ScoredCandidate, finding: ScoredCandidate, floor: FloatArray) -> bool:
    """Return whether a candidate is so small beside an effect of a rough formula that it may be what that one leaves.

    What friction leaves is on its own joint; where else a cable pulls is not known.

    Parameters
    ----------
    scored : ScoredCandidate
        The candidate.
    finding : ScoredCandidate
        The finding whose formula is rough.
    floor : (n,)
        Noise of the sensors, N m or N.
    """
    rough = get_effect(finding.candidate.effect)
    if not rough.is_rough or (rough.is_friction and not set(scored.joints) <= set(finding.joints)):
        return False
    return compute_explained_error(scored, floor) < _SHADOW * compute_explained_error(finding, floor)


def compute_explained_error(scored: ScoredCandidate, floor: FloatArray) -> float:
    """Return the squared error that a candidate removes, in units of the sensors' noise (n,).

    Parameters
    ----------
    scored : ScoredCandidate
        The candidate.
    floor : (n,)
        Noise of the sensors, N m or N.
    """
    removed = (scored.before - scored.after).sum(axis=0)
    unit = np.maximum(floor**2, _QUIET * scored.before.mean(axis=0))
    return float((removed / np.maximum(unit, np.finfo(float).tiny)).sum())


def get_least_gain(effect: Effect) -> float:
    """Return the share of the sensor noise's power that an effect has to remove."""
    at_reversals = any(spec.resolved_by is not None for spec in effect.shapes)
    return SMALLEST_GAIN_AT_REVERSALS if at_reversals else SMALLEST_GAIN_OVER_NOISE


def compute_gain_over_floor(scored: ScoredCandidate, joint: int, floor: FloatArray, data: PhasedProducts) -> float:
    """Return the squared error that a candidate removes on a joint, over that of the sensor's noise.

    Parameters
    ----------
    scored : ScoredCandidate
        The candidate.
    joint : int
        Index of the joint.
    floor : (n,)
        Noise of the sensors, N m or N.
    data : PhasedProducts
        Products of all columns.
    """
    removed = float((scored.before - scored.after)[:, joint].sum()) / max(
        float(data.count_rows(scored.candidate.columns)[:, joint].sum()), 1.0
    )
    return removed / max(float(floor[joint]) ** 2, np.finfo(float).tiny)
