"""Give joints of a group shape constants of their own: no two gears of an arm are alike."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dynident.diagnosis.candidates.accumulate import PhasedProducts
from dynident.diagnosis.candidates.pool import Candidate, Pool, is_sharper_than_resolved, select_columns_on
from dynident.diagnosis.candidates.significance import ScoredCandidate
from dynident.diagnosis.residuals.resolution import Resolution
from dynident.diagnosis.residuals.time_blocks import compute_t
from dynident.diagnosis.search.state import Finding, State, score_all, score_one
from dynident.effects import EffectChoice, get_effect
from dynident.identification.shapes.shape_search import are_nearly_alike
from dynident.robot import Robot

_OWN_DROP, _OWN_T = 0.1, 2.5
"""Share of what a group's constants leave on a joint that its own have to remove, and by which t over the stretches.

What removes less may be no more than that a group's constants lie between the values of the grid
(`benchmarks/joints_of_a_group.py`).
"""


def split_groups(data: PhasedProducts, pool: Pool, state: State) -> State:
    """Split every group whose joints have shape constants that the data tell apart.

    A group was found with one value for all of its joints. Values are those of the grid still; joints that have the
    same one stay together.

    Parameters
    ----------
    data : PhasedProducts
        Products of all columns.
    pool : Pool
        Model and candidates.
    state : State
        The model so far and what was found.
    """
    picks: list[Finding] = []
    # Group after group, each beside what the earlier ones have become.
    for finding in state.picks:
        parts = _split_finding(data, pool, state, finding)
        columns = tuple(k for part in parts for k in part.columns)
        state = replace(state, base=(*(k for k in state.base if k not in finding.columns), *columns))
        picks += parts
    return replace(state, picks=tuple(picks))


def merge_alike(
    picks: Sequence[Finding], choices: Sequence[EffectChoice], robot: Robot, resolved: Resolution
) -> tuple[tuple[Finding, ...], tuple[EffectChoice, ...]]:
    """Merge findings whose refined constants have come out alike.

    So are slips of one friction that are both too short for the data to tell. The constants are those of the one with
    the most joints.

    Parameters
    ----------
    picks : sequence of Finding
        The findings.
    choices : sequence of EffectChoice
        What each of them has become, with refined constants.
    robot : Robot
        The robot, as its description gives it.
    resolved : Resolution
        What the data can resolve.
    """

    def are_alike(first: EffectChoice, second: EffectChoice) -> bool:
        same = (first.effect, first.runs) == (second.effect, second.runs)
        return are_nearly_alike(first, second) or (
            same and all(is_sharper_than_resolved(choice, robot, resolved) for choice in (first, second))
        )

    merged: list[tuple[Finding, EffectChoice]] = []
    for finding, choice in sorted(zip(picks, choices, strict=True), key=lambda pair: -len(pair[1].joints)):
        alike = next((k for k, (_, other) in enumerate(merged) if are_alike(other, choice)), None)
        if alike is None:
            merged.append((finding, choice))
        else:
            both = {*merged[alike][1].joints, *choice.joints}
            own = tuple(name for name in robot.tree.joint_names if name in both)
            merged[alike] = merged[alike][0], replace(merged[alike][1], joints=own)
    # Merging went from large groups to small; the ranking keeps the order in which things were found.
    order = {id(finding): k for k, finding in enumerate(picks)}
    merged.sort(key=lambda pair: order[id(pair[0])])
    return tuple(finding for finding, _ in merged), tuple(choice for _, choice in merged)


def _split_finding(data: PhasedProducts, pool: Pool, state: State, finding: Finding) -> list[Finding]:
    """Return the finding, or one for every set of constants that its joints have, that of most joints first."""
    group = finding.judged.candidate
    # Without a constant that is refined there is nothing in which joints could differ.
    if len(group.joints) < 2 or all(spec.refined is None for spec in get_effect(group.effect).shapes):
        return [finding]
    each = [_choose_constants(data, pool, state, group, joint) for joint in group.joints]
    shapes = {candidate.shape: [other for other in each if other.shape == candidate.shape] for candidate in each}
    if len(shapes) < 2:
        return [finding]
    rest = tuple(k for k in state.base if k not in finding.columns)
    # Joints that have the same constants stay together.
    whole = [_join_candidates(some) for some in sorted(shapes.values(), key=len, reverse=True)]
    return [
        replace(
            finding, judged=replace(_judge_beside_others(data, pool, state, rest, whole, k), p=finding.p), around=()
        )
        for k in range(len(whole))
    ]


def _choose_constants(data: PhasedProducts, pool: Pool, state: State, group: Candidate, joint: str) -> Candidate:
    """Return the effect on one joint of a group, with its own constants where the data tell them apart."""
    mine = select_columns_on(pool, group, joint)
    same = Candidate(group.effect, (joint,), group.shape, mine, group.runs)
    others = [
        candidate
        for candidate in pool.candidates
        if (candidate.effect, candidate.joints, candidate.runs) == (group.effect, (joint,), group.runs)
        and candidate.columns != mine
    ]
    rest = tuple(k for k in state.base if k not in mine)
    # The group's constants are scored along with the joint's own, beside the same model.
    first, *judged = score_all(data, pool, rest, [same, *others], state.noise)
    best = max(judged, key=lambda scored: scored.total_gain, default=first)
    return best.candidate if _are_distinguishable(first, best) else same


def _are_distinguishable(group: ScoredCandidate, own: ScoredCandidate) -> bool:
    """Return whether a joint's own constants explain clearly more than those of its group, and enough to matter."""
    more = own.gains - group.gains
    return float(more.sum()) >= _OWN_DROP * float(group.after_weighted.sum()) and compute_t(more) >= _OWN_T


def _join_candidates(candidates: list[Candidate]) -> Candidate:
    """Join candidates of an effect on single joints with the same constants into one."""
    first = candidates[0]
    joints = tuple(joint for candidate in candidates for joint in candidate.joints)
    return Candidate(
        first.effect, joints, first.shape, tuple(k for candidate in candidates for k in candidate.columns), first.runs
    )


def _judge_beside_others(
    data: PhasedProducts, pool: Pool, state: State, rest: tuple[int, ...], parts: list[Candidate], k: int
) -> ScoredCandidate:
    """Score one of several candidates beside the others."""
    base = (*rest, *(column for i, part in enumerate(parts) if i != k for column in part.columns))
    return score_one(data, pool, base, parts[k], state.noise)
