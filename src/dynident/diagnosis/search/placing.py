"""On which link something sits that some of the runs have: looked for once it is known which runs these are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dynident.diagnosis.candidates.gate import JudgedCandidate, indistinguishable
from dynident.diagnosis.candidates.gathering import gather
from dynident.diagnosis.candidates.pool import pool_of
from dynident.diagnosis.search.state import Finding, judge_all
from dynident.effects import EffectChoice, ReferenceParameters, effect_by_id
from dynident.identification import Identification
from dynident.recordings import Recording

_NOTHING = 1.0
"""A difference of squared errors in units of the noise that says nothing: what is not there gains as much."""


def placed(
    identification: Identification,
    picks: Sequence[Finding],
    recordings: Sequence[Recording],
    reference: ReferenceParameters,
) -> tuple[Finding, ...]:
    """The picks, those of what some runs have on the link that gains most; the outer one where data do not decide."""
    loose = [k for k, pick in enumerate(picks) if effect_by_id(pick.judged.candidate.effect).in_some_runs]
    if not loose:
        return tuple(picks)
    model = identification.model
    places = {k: _places(picks[k].judged.candidate.choice, model.robot.joint_names) for k in loose}
    choices = [pick.judged.candidate.choice for pick in picks] + [choice for own in places.values() for choice in own]
    pool = pool_of(model, choices)
    data = gather(
        pool.observation, model.signals, recordings, identification.preprocessing, reference, model.n_parameters
    )
    placed_findings = list(picks)
    for k in loose:
        others = [pool.candidate(pick.judged.candidate.choice) for i, pick in enumerate(placed_findings) if i != k]
        base = (*range(pool.n_base), *(column for other in others if other for column in other.columns))
        candidates = [candidate for choice in places[k] if (candidate := pool.candidate(choice))]
        judged = judge_all(data, pool, base, candidates, identification.noise)
        placed_findings[k] = _at_its_place(placed_findings[k], judged, model.robot.joint_names)
    return tuple(placed_findings)


def _as_good(best: JudgedCandidate, other: JudgedCandidate) -> bool:
    """Whether data do not tell another place from the best: the same function of the motion, solved for otherwise.

    Rounding, and which of the columns are left out as dependent, makes a difference that is small but always has the
    same sign.
    """
    return indistinguishable(best, other) or float((best.gains - other.gains).sum()) < _NOTHING


def _places(choice: EffectChoice, joints: Sequence[str]) -> list[EffectChoice]:
    return [replace(choice, joints=(joint,)) for joint in joints]


def _at_its_place(pick: Finding, judged: Sequence[JudgedCandidate], joints: Sequence[str]) -> Finding:
    best = max(judged, key=lambda scored: scored.total_gain)
    alike = [scored for scored in judged if scored is best or _as_good(best, scored)]
    outer = max(alike, key=lambda scored: joints.index(scored.candidate.joints[0]))
    outer_scored = replace(outer, p=pick.p)
    return replace(
        pick, judged=outer_scored, equal=(*pick.equal, *(scored for scored in alike if scored is not outer)), around=()
    )
