"""The rules that a candidate has to pass, each of which gives its reason; and stable selection.

Stability: the same name is found where blocks of time are drawn anew, and where each run is left out.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynident.array_types import FloatArray, IndexArray
from dynident.diagnosis.candidates.accumulate import PhasedProducts
from dynident.diagnosis.candidates.pool import Candidate
from dynident.diagnosis.candidates.significance import (
    SMALLEST_DROP,
    SMALLEST_ERROR_DROP,
    SMALLEST_GAIN_AT_REVERSALS,
    SMALLEST_GAIN_OVER_NOISE,
    ScoredCandidate,
    compute_least_t,
)
from dynident.diagnosis.reasons import Reason, build_too_small, describe_choice
from dynident.diagnosis.search.state import State
from dynident.effects import Effect, get_effect
from dynident.effects.effect_columns import is_lasting_change

FOUND_AGAIN = 0.9
"""In so many of the resamplings a name has to come first again."""

# Resamplings: a share of 0.9 is then known to within 0.02.
_DRAWS = 200
_SEED = 21

_MORE = 0.2
"""A candidate with more parameters takes the place of a simpler one if it gains so much more."""


def compute_stability(names: Sequence[ScoredCandidate], rivals: Sequence[ScoredCandidate], run: IndexArray) -> float:
    """Return the share of resamplings in which one of these names for a finding is not overtaken by another.

    Parameters
    ----------
    names : sequence of ScoredCandidate
        The names that the data do not tell apart, the chosen one first.
    rivals : sequence of ScoredCandidate
        Candidates that would take its place, beside which nothing of it is left.
    run : (s,)
        Number of the run of each block: without any one of several runs, the name has to stand as well.

    Returns
    -------
    float
        Share from 0 to 1.
    """
    if not rivals:
        return 1.0
    # Gains are sums over blocks, so that the margin of a resample is a weighted sum of these.
    margins = np.array([[_compute_margin(name, rival) for rival in rivals] for name in names])
    s = len(names[0].gains)
    # Bootstrap: how often each block is drawn stands for the block itself, since gains are sums over blocks.
    drawn = np.random.default_rng(_SEED).multinomial(s, np.full(s, 1.0 / s), size=_DRAWS).astype(np.float64)
    share = _compute_share_ahead(margins, drawn)
    runs = np.unique(run)
    if len(runs) < 2:
        return share
    without = np.array([run != left_out_run for left_out_run in runs], dtype=np.float64)
    # Leaving out a run is the harder test: blocks of one run resemble each other.
    return min(share, _compute_share_ahead(margins, without))


def _compute_share_ahead(margins: FloatArray, counts: FloatArray) -> float:
    """Return the share of draws (d, s) in which any name is ahead of all rivals, from margins (f, r, s)."""
    return float((margins @ counts.T >= 0.0).all(axis=1).any(axis=0).mean())


def is_other_name(chosen: ScoredCandidate, rival: ScoredCandidate) -> bool:
    """Return whether a candidate would be another name: another effect that is not known to be the same function.

    Parameters
    ----------
    chosen, rival : ScoredCandidate
        The candidates to compare.
    """
    mine, theirs = get_effect(chosen.candidate.effect), get_effect(rival.candidate.effect)
    if theirs.id == mine.id:
        return False
    return theirs.id not in mine.same_function and mine.id not in theirs.covers and theirs.id not in mine.covers


def _compute_margin(chosen: ScoredCandidate, rival: ScoredCandidate) -> FloatArray:
    """Return (s,): how much each block speaks for the chosen candidate; below zero in sum it would not be chosen."""
    if rival.complexity > chosen.complexity:
        return np.asarray(chosen.gains - (1.0 - _MORE) * rival.gains)
    return np.asarray(chosen.gains - rival.gains)


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


def find_rejection(state: State, data: PhasedProducts, scored: ScoredCandidate) -> Reason | None:
    """Return the first rule that a candidate fails, as a reason; None where it passes them all.

    Parameters
    ----------
    state : State
        The model so far and what was found.
    data : PhasedProducts
        Products of all columns.
    scored : ScoredCandidate
        The candidate.
    """
    rules = (
        _check_visibility,
        _check_significance,
        _check_size,
        _check_reach,
        _check_blur,
        _check_shadows,
        _check_each_joint,
        _check_runs,
    )
    return next((reason for rule in rules if (reason := rule(state, data, scored)) is not None), None)


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
    rejection = find_rejection(state, data, scored)
    # The size in its runs is checked last: all other rules passed where that is what a candidate fails.
    return rejection is not None and dict(rejection.values).get("measure") == "runs"


def _check_visibility(_state: State, _data: PhasedProducts, scored: ScoredCandidate) -> Reason | None:
    if scored.separability >= VISIBLE:
        return None
    return Reason.build("not_determined", share=scored.separability, least=VISIBLE)


def _check_significance(state: State, _data: PhasedProducts, scored: ScoredCandidate) -> Reason | None:
    """Check that a gain is no chance, among all that was tried and by itself, and large enough to notice."""
    if scored.p > state.level:
        return Reason.build("not_significant", p=scored.p, level=state.level)
    if scored.drop < SMALLEST_DROP:
        return build_too_small("squared_error", scored.drop, SMALLEST_DROP)
    if scored.error_drop < SMALLEST_ERROR_DROP:
        return build_too_small("error", scored.error_drop, SMALLEST_ERROR_DROP)
    least_t = compute_least_t(len(scored.gains), state.level)
    if scored.t < least_t:
        return Reason.build("not_significant", p=scored.p, level=state.level, t=scored.t, least_t=least_t)
    return None


def _check_size(state: State, data: PhasedProducts, scored: ScoredCandidate) -> Reason | None:
    gain, least = _compute_largest_gain(state, data, scored), get_least_gain(get_effect(scored.candidate.effect))
    return build_too_small("noise", gain, least) if gain < least else None


def _check_reach(_state: State, _data: PhasedProducts, scored: ScoredCandidate) -> Reason | None:
    # A column of which little is left needs a gain that is very sure.
    least = _LEAST_REACH / max(scored.t, np.finfo(float).tiny)
    return _check_share(scored, least)


def _check_blur(_state: State, _data: PhasedProducts, scored: ScoredCandidate) -> Reason | None:
    is_first_order = get_effect(scored.candidate.effect).first_order
    return _check_share(scored, _BLURRED) if is_first_order and scored.drop < _DROP_OF_BLURRED else None


def _check_share(scored: ScoredCandidate, least: float) -> Reason | None:
    if scored.separability >= least:
        return None
    return Reason.build("not_determined", share=scored.separability, least=min(least, 1.0))


def find_least_drops(candidate: Candidate, separability: float, t: FloatArray) -> FloatArray:
    """Return (d,): the share of the squared error that a candidate has to remove; infinite where no share is enough.

    Parameters
    ----------
    candidate : Candidate
        The candidate.
    separability : float
        Share of its column that is left beside the model.
    t : (d,)
        t of its gain.
    """
    if separability < VISIBLE:
        return np.full_like(t, np.inf)
    is_blurred = get_effect(candidate.effect).first_order and separability < _BLURRED
    least = _DROP_OF_BLURRED if is_blurred else SMALLEST_DROP
    return np.where(separability * t < _LEAST_REACH, np.inf, least)


def _check_shadows(state: State, _data: PhasedProducts, scored: ScoredCandidate) -> Reason | None:
    for finding in state.picks:
        if is_shadowed(scored, finding.judged, state.floor):
            size = compute_explained_error(scored, state.floor) / compute_explained_error(finding.judged, state.floor)
            return Reason.build("explained", by=describe_choice(finding.judged.candidate.choice), left=size)
    return None


def _check_each_joint(state: State, data: PhasedProducts, scored: ScoredCandidate) -> Reason | None:
    """Check that what pulls at two joints explains both: what explains one alone is a function of that joint."""
    if not get_effect(scored.candidate.effect).pulls_on_each:
        return None
    idle = [joint for joint in scored.joints if not has_gain_on_joint(state, data, scored, joint)]
    if not idle:
        return None
    before = scored.before[:, idle].sum(axis=0)
    shares = 1.0 - scored.after[:, idle].sum(axis=0) / np.maximum(before, np.finfo(float).tiny)
    return build_too_small("joint", float(shares.min()), JOINT_DROP)


def _check_runs(state: State, _data: PhasedProducts, scored: ScoredCandidate) -> Reason | None:
    """Check that an effect of some runs alone explains as much of them as it has to."""
    if not scored.candidate.runs:
        return None
    is_lasting = is_lasting_change(scored.candidate.choice, state.since)
    least = _LEAST_OF_CHANGE if is_lasting else _LEAST_OF_RUNS
    return build_too_small("runs", scored.drop, least) if scored.drop < least else None


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
    return _check_size(state, data, scored) is not None


def _compute_largest_gain(state: State, data: PhasedProducts, scored: ScoredCandidate) -> float:
    return max(compute_gain_over_floor(scored, j, state.floor, data) for j in scored.joints)


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
