"""The rules that a candidate must pass to become a finding, each with its reason, and stability selection.

Holds the number of resamplings (200); the levels of the rules are in `decision_levels`.

Stability: the same name is found where blocks of time are drawn anew, and where each run is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from dynident.array_types import FloatArray, IndexArray
from dynident.diagnosis.candidates.significance import ScoredCandidate, compute_least_t
from dynident.diagnosis.decision_levels import RULES
from dynident.diagnosis.outcome_reasons import Reason, build_too_small, describe_choice
from dynident.diagnosis.search.search_state import State
from dynident.effects import Effect, get_effect

# Resamplings: a share of 0.9 is then known to within 0.02.
_DRAWS = 200
_SEED = 21


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
    share = _compute_share_ahead(margins, _draw_counts(s))
    runs = np.unique(run)
    if len(runs) < 2:
        return share
    without = np.array([run != left_out_run for left_out_run in runs], dtype=np.float64)
    # Leaving out a run is the harder test: blocks of one run resemble each other.
    return min(share, _compute_share_ahead(margins, without))


@lru_cache(4)
def _draw_counts(n_blocks: int) -> FloatArray:
    """Return (draws, s): how often each block is in each draw, which is the same for all candidates."""
    drawn = np.random.default_rng(_SEED).multinomial(n_blocks, np.full(n_blocks, 1.0 / n_blocks), size=_DRAWS)
    return drawn.astype(np.float64)


def _compute_share_ahead(margins: FloatArray, counts: FloatArray) -> float:
    """Return the share of draws (d, s) in which any name is ahead of all rivals, from margins (f, r, s)."""
    return float((margins @ counts.T >= 0.0).all(axis=1).any(axis=0).mean())


def is_other_name(chosen: ScoredCandidate, rival: ScoredCandidate) -> bool:
    """Return whether a candidate would be another name: another effect that is not known to be the same function."""
    mine, theirs = get_effect(chosen.candidate.effect), get_effect(rival.candidate.effect)
    if theirs.id == mine.id:
        return False
    return theirs.id not in mine.same_function and mine.id not in theirs.covers and theirs.id not in mine.covers


def _compute_margin(chosen: ScoredCandidate, rival: ScoredCandidate) -> FloatArray:
    """Return (s,): how much each block speaks for the chosen candidate; below zero in sum it would not be chosen."""
    if rival.complexity > chosen.complexity:
        return np.asarray(chosen.gains - (1.0 - RULES.more_for_parameters) * rival.gains)
    return np.asarray(chosen.gains - rival.gains)


def find_rejection(state: State, scored: ScoredCandidate) -> Reason | None:
    """Return the first rule that a candidate fails, as a reason; None where it passes them all."""
    rules = (
        _check_visibility,
        check_significance,
        _check_size,
        _check_reach,
        _check_shadows,
        _check_each_joint,
        _check_runs,
    )
    return next((reason for rule in rules if (reason := rule(state, scored)) is not None), None)


def _check_visibility(state: State, scored: ScoredCandidate) -> Reason | None:
    if scored.separability >= state.rules.least_separability:
        return None
    return Reason.build("not_determined", share=scored.separability, least=state.rules.least_separability)


def check_significance(state: State, scored: ScoredCandidate) -> Reason | None:
    """Check that a gain is no chance, among all that was tried and by itself, and large enough to notice.

    By itself, what it gains where it was not fitted has to be above zero: scores alone are of the data that it was.
    """
    if scored.p > state.level:
        return Reason.build("not_significant", p=scored.p, level=state.level)
    if scored.drop < state.rules.least_drop:
        return build_too_small("squared_error", scored.drop, state.rules.least_drop)
    if scored.error_drop < state.rules.least_error_drop:
        return build_too_small("error", scored.error_drop, state.rules.least_error_drop)
    least_t = compute_least_t(len(scored.gains), state.level)
    if scored.t < least_t:
        return Reason.build("not_significant", p=scored.p, level=state.level, t=scored.t, least_t=least_t)
    return None


def _check_size(state: State, scored: ScoredCandidate) -> Reason | None:
    gain, least = _compute_largest_gain(state, scored), get_least_gain(get_effect(scored.candidate.effect))
    return build_too_small("noise", gain, least) if gain < least else None


def _check_reach(state: State, scored: ScoredCandidate) -> Reason | None:
    # A column of which little is left needs a gain that is very sure.
    least = state.rules.least_reach / max(scored.t, np.finfo(float).tiny)
    if scored.separability >= least:
        return None
    return Reason.build("not_determined", share=scored.separability, least=min(least, 1.0))


def find_least_drops(separability: float, t: FloatArray) -> FloatArray:
    """Return (d,): the share of the squared error that a candidate has to remove; infinite where no share is enough.

    Parameters
    ----------
    separability : float
        Share of its column that is left beside the model.
    t : (d,)
        t of its gain.
    """
    if separability < RULES.least_separability:
        return np.full_like(t, np.inf)
    return np.where(separability * t < RULES.least_reach, np.inf, RULES.least_drop)


def _check_shadows(state: State, scored: ScoredCandidate) -> Reason | None:
    for finding in state.findings:
        if is_shadowed(scored, finding.judged, state.floor):
            size = compute_explained_error(scored, state.floor) / compute_explained_error(finding.judged, state.floor)
            return Reason.build("explained", by=describe_choice(finding.judged.candidate.choice), left=size)
    return None


def _check_each_joint(state: State, scored: ScoredCandidate) -> Reason | None:
    """Check that what pulls at two joints explains both: what explains one alone is a function of that joint."""
    if not get_effect(scored.candidate.effect).pulls_on_each:
        return None
    idle = [joint for joint in scored.joints if not has_gain_on_joint(state, scored, joint)]
    if not idle:
        return None
    before = scored.before[:, idle].sum(axis=0)
    shares = 1.0 - scored.after[:, idle].sum(axis=0) / np.maximum(before, np.finfo(float).tiny)
    return build_too_small("joint", float(shares.min()), state.rules.joint_drop)


def _check_runs(state: State, scored: ScoredCandidate) -> Reason | None:
    """Check that an effect of some runs alone explains as much of them as it has to."""
    if not scored.candidate.runs:
        return None
    is_lasting = state.pool.is_change(scored.candidate)
    least = state.rules.least_drop_of_change if is_lasting else state.rules.least_drop_in_runs
    return build_too_small("runs", scored.drop, least) if scored.drop < least else None


def _compute_largest_gain(state: State, scored: ScoredCandidate) -> float:
    return max(compute_gain_over_floor(state, scored, j) for j in scored.joints)


def has_gain_on_joint(state: State, scored: ScoredCandidate, joint: int) -> bool:
    """Return whether a candidate that acts on several joints lowers the error of one of them enough, and evenly."""
    # In units of the noise of this joint alone, whatever the others gain.
    before = scored.before[:, joint] / state.noise[joint] ** 2
    gain = before - scored.after[:, joint] / state.noise[joint] ** 2
    share = float(gain.sum()) / max(float(before.sum()), np.finfo(float).tiny)
    spread = float(gain.std(ddof=1)) / np.sqrt(len(gain))
    even = float(gain.mean()) >= state.rules.clear_t * spread
    large = compute_gain_over_floor(state, scored, joint) >= get_least_gain(get_effect(scored.candidate.effect))
    return share >= state.rules.joint_drop and even and large


def is_shadowed(scored: ScoredCandidate, finding: ScoredCandidate, floor: FloatArray) -> bool:
    """Return whether a candidate is so small beside an effect of a rough formula that it may be what that one leaves.

    What friction leaves is on its own joint; where else a cable pulls is not known.
    """
    rough = get_effect(finding.candidate.effect)
    if not rough.is_rough or (rough.is_friction and not set(scored.joints) <= set(finding.joints)):
        return False
    return compute_explained_error(scored, floor) < RULES.shadow * compute_explained_error(finding, floor)


def compute_explained_error(scored: ScoredCandidate, floor: FloatArray) -> float:
    """Return the squared error that a candidate removes, in units of the sensors' noise (n,)."""
    removed = (scored.before - scored.after).sum(axis=0)
    unit = np.maximum(floor**2, RULES.quiet * scored.before.mean(axis=0))
    return float((removed / np.maximum(unit, np.finfo(float).tiny)).sum())


def get_least_gain(effect: Effect) -> float:
    """Return the share of the sensor noise's power that an effect has to remove."""
    at_reversals = any(spec.resolved_by is not None for spec in effect.shapes)
    return RULES.least_gain_at_reversals if at_reversals else RULES.least_gain_over_noise


def compute_gain_over_floor(state: State, scored: ScoredCandidate, joint: int) -> float:
    """Return the squared error that a candidate removes on a joint, over that of the sensor's noise."""
    removed = float((scored.before - scored.after)[:, joint].sum()) / max(
        float(state.data.count_rows(scored.candidate.columns)[:, joint].sum()), 1.0
    )
    return removed / max(float(state.floor[joint]) ** 2, np.finfo(float).tiny)
