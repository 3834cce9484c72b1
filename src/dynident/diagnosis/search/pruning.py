"""What later findings have made superfluous: whole effects, and joints of groups."""

from __future__ import annotations

from dataclasses import replace

from dynident.diagnosis.candidates.gate import JudgedCandidate
from dynident.diagnosis.candidates.gathering import PhasedProducts
from dynident.diagnosis.candidates.pool import Candidate, Pool
from dynident.diagnosis.search.acceptance import (
    JOINT_DROP,
    JOINT_T,
    JOINT_T_OF_LARGE,
    LARGE_DROP,
    gain_over_floor,
    least_gain,
    shadowed,
)
from dynident.diagnosis.search.state import Finding, State, judge_all
from dynident.effects import effect_by_id

_PRUNE_DROP, _PRUNE_T = 0.03, 2.5


def pruned(data: PhasedProducts, pool: Pool, state: State) -> State:
    """The search without the picks that others have made superfluous, the weakest taken out first.

    Neighbours of coarse shape constants are left out: so many columns more would leave little for anything else.
    """
    around = {k for finding in state.picks for k in finding.around}
    state = replace(
        state,
        picks=tuple(replace(finding, around=()) for finding in state.picks),
        base=tuple(k for k in state.base if k not in around),
    )
    while len(state.picks) > 1:
        judged = [(_again(data, pool, state, finding), finding) for finding in state.picks if _can_be_held_out(finding)]
        weak = [
            (item, finding)
            for item, finding in judged
            if not item.lasts(_PRUNE_DROP, _PRUNE_T)
            or any(shadowed(item, other, state.floor) for other, pick in judged if pick is not finding)
        ]
        if not weak:
            break
        _, superfluous = min(weak, key=lambda pair: pair[0].total_gain)
        state = replace(
            state,
            picks=tuple(finding for finding in state.picks if finding is not superfluous),
            base=tuple(k for k in state.base if k not in superfluous.columns),
        )
    return state


def _can_be_held_out(finding: Finding) -> bool:
    """Whether stretches that an effect shows in can be left out: a contact happened once."""
    return not effect_by_id(finding.judged.candidate.effect).is_transient


def _again(data: PhasedProducts, pool: Pool, state: State, finding: Finding) -> JudgedCandidate:
    """A pick, judged beside all others."""
    base = tuple(k for k in state.base if k not in finding.columns)
    return judge_all(data, pool, base, [finding.judged.candidate], state.noise)[0]


def trimmed(data: PhasedProducts, pool: Pool, state: State) -> list[tuple[str, ...]]:
    """The joints of every pick that still gain from it, each beside all the rest; one of a group at least."""
    base = state.base
    joints = []
    for finding in state.picks:
        candidate = finding.judged.candidate
        kept, gains = list(candidate.joints), {}
        for joint in candidate.joints if len(candidate.joints) > 1 else ():
            own = tuple(k for k in candidate.columns if pool.observation.columns[k].link == joint)
            alone = Candidate(candidate.effect, (joint,), candidate.shape, own, candidate.runs)
            rest = tuple(k for k in base if k not in own)
            item = judge_all(data, pool, rest, [alone], state.noise)[0]
            gains[joint] = item.total_gain
            j = pool.observation.robot.movers(joint)[0]
            large = gain_over_floor(item, j, state.floor, data) >= least_gain(effect_by_id(candidate.effect))
            least_t = JOINT_T if item.drop < LARGE_DROP else JOINT_T_OF_LARGE
            if not (item.lasts(JOINT_DROP, least_t) and large):
                kept.remove(joint)
                base = rest
        best = max(gains, key=lambda name: gains[name], default="")
        joints.append(tuple(kept) or ((best,) if best else ()))
    return joints
