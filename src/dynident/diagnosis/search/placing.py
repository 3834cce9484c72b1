"""On which link something sits that some of the runs have: looked for once it is known which runs these are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dynident.diagnosis.candidates.gate import ScoredCandidate, are_indistinguishable
from dynident.diagnosis.candidates.gathering import gather_products
from dynident.diagnosis.candidates.pool import build_pool_of_choices
from dynident.diagnosis.search.state import Finding, score_all
from dynident.effects import EffectChoice, ReferenceParameters, get_effect
from dynident.identification import Identification
from dynident.recordings import Recording

_NOTHING = 1.0
"""A difference of squared errors in units of the noise that says nothing: what is not there gains as much."""


def locate_findings(
    identification: Identification,
    picks: Sequence[Finding],
    recordings: Sequence[Recording],
    reference: ReferenceParameters,
) -> tuple[Finding, ...]:
    """The picks, those of what some runs have on the link that gains most; the outer one where data do not decide."""
    loose = [k for k, pick in enumerate(picks) if get_effect(pick.judged.candidate.effect).in_some_runs]
    if not loose:
        return tuple(picks)
    model = identification.model
    places = {k: _list_places(picks[k].judged.candidate.choice, model.robot.joint_names) for k in loose}
    choices = [pick.judged.candidate.choice for pick in picks] + [choice for own in places.values() for choice in own]
    pool = build_pool_of_choices(model, choices)
    data = gather_products(
        pool.observation, model.signals, recordings, identification.preprocessing, reference, model.n_parameters
    )
    placed_findings = list(picks)
    for k in loose:
        others = [pool.find_candidate(pick.judged.candidate.choice) for i, pick in enumerate(placed_findings) if i != k]
        base = (*range(pool.n_base), *(column for other in others if other for column in other.columns))
        candidates = [candidate for choice in places[k] if (candidate := pool.find_candidate(choice))]
        judged = score_all(data, pool, base, candidates, identification.noise)
        placed_findings[k] = _move_to_best_link(placed_findings[k], judged, model.robot.joint_names)
    return tuple(placed_findings)


def _is_as_good(best: ScoredCandidate, other: ScoredCandidate) -> bool:
    """Whether data do not tell another place from the best: the same function of the motion, solved for otherwise.

    Rounding, and which of the columns are left out as dependent, makes a difference that is small but always has the
    same sign.
    """
    return are_indistinguishable(best, other) or float((best.gains - other.gains).sum()) < _NOTHING


def _list_places(choice: EffectChoice, joints: Sequence[str]) -> list[EffectChoice]:
    return [replace(choice, joints=(joint,)) for joint in joints]


def _move_to_best_link(pick: Finding, judged: Sequence[ScoredCandidate], joints: Sequence[str]) -> Finding:
    best = max(judged, key=lambda scored: scored.total_gain)
    alike = [scored for scored in judged if scored is best or _is_as_good(best, scored)]
    outer = max(alike, key=lambda scored: joints.index(scored.candidate.joints[0]))
    outer_scored = replace(outer, p=pick.p)
    return replace(
        pick, judged=outer_scored, equal=(*pick.equal, *(scored for scored in alike if scored is not outer)), around=()
    )
