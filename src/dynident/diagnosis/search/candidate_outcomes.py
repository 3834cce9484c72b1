"""Decide after the search which reason each rejected candidate gets: all are scored once more beside the findings."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from dynident.diagnosis.candidates.candidate_pool import Candidate, explain_absence
from dynident.diagnosis.candidates.significance import FamilywiseLevels, ScoredCandidate
from dynident.diagnosis.decision_levels import RULES
from dynident.diagnosis.diagnosis_result import DetectionLimit
from dynident.diagnosis.outcome_reasons import CandidateOutcome, Reason, describe_choice
from dynident.diagnosis.residuals.shape_proposals import ShapeProposals
from dynident.diagnosis.search.acceptance_rules import check_significance, find_rejection
from dynident.diagnosis.search.identifiability_and_invisible_effects import list_columns_with_findings
from dynident.diagnosis.search.physical_plausibility import find_impossibility
from dynident.diagnosis.search.search_state import (
    Finding,
    Loss,
    ScoredFamily,
    SearchRecord,
    State,
    score_family,
)
from dynident.effects import CATALOGUE, EffectChoice, get_effect
from dynident.effects.effect_text_format import format_constant
from dynident.regressors.model_structure import Model


@dataclass(frozen=True, eq=False)
class FinalScores:
    """All candidates beside the model with everything that was found.

    Parameters
    ----------
    state : State
        The model with its findings.
    scored : tuple of ScoredCandidate
        The candidates, scored beside it.
    levels : FamilywiseLevels
        What chance reaches among them.
    """

    state: State
    scored: tuple[ScoredCandidate, ...]
    levels: FamilywiseLevels


def score_beside_findings(
    start: State,
    record: SearchRecord,
    findings: Sequence[Finding],
    choices: Sequence[EffectChoice],
    first: ScoredFamily,
) -> FinalScores:
    """Score all candidates of the first round once more, beside the model with everything that was found.

    Parameters
    ----------
    start : State
        The state that the search started from.
    record : SearchRecord
        How it ended.
    findings : sequence of Finding
        What was found in the end.
    choices : sequence of EffectChoice
        What the findings have become.
    first : ScoredFamily
        All candidates, scored beside the model alone.
    """
    last = record.state
    # Where nothing was found, these are the scores; beside a contact that was dropped since they are not.
    if not findings and not start.findings and last.data is start.data:
        return FinalScores(start, first.scored, first.levels)
    base = list_columns_with_findings(start.pool, start.base, choices)
    state = replace(start, data=last.data, base=base, findings=tuple(findings))
    state = state.estimate_noise() if findings else state
    candidates = [scored.candidate for scored in first.scored if not set(scored.candidate.columns) <= set(base)]
    family = score_family(state, candidates, record.family)
    return FinalScores(state, family.scored, family.levels)


def list_outcomes(
    final: FinalScores,
    record: SearchRecord,
    choices: Sequence[EffectChoice],
    first: Sequence[ScoredCandidate],
) -> tuple[tuple[CandidateOutcome, ...], Mapping[Candidate, ScoredCandidate]]:
    """List what became of every effect on every place, with the constants that gain most there by themselves.

    Parameters
    ----------
    final : FinalScores
        All candidates beside everything that was found.
    record : SearchRecord
        What the search found, and why it chose no others.
    choices : sequence of EffectChoice
        What the findings have become, in the order of their ranks.
    first : sequence of ScoredCandidate
        All candidates, scored beside the model alone.

    Returns
    -------
    tuple of CandidateOutcome, mapping of Candidate to ScoredCandidate
        The outcomes, and the scores of their candidates beside the findings.
    """
    beside = {scored.candidate: scored for scored in final.scored}
    best: dict[tuple[str, tuple[str, ...], tuple[str, ...]], ScoredCandidate] = {}
    for scored in first:
        candidate = scored.candidate
        key = candidate.effect, candidate.joints, candidate.runs
        if key not in best or scored.total_gain > best[key].total_gain:
            best[key] = scored
    judge = _Judge(final, record, tuple(choices))
    outcomes = [
        CandidateOutcome(choice, finding.judged.error_drop, Reason.build("accepted", step))
        for step, (finding, choice) in enumerate(zip(final.state.findings, choices, strict=True), 1)
    ]
    for scored in best.values():
        last = beside.get(scored.candidate)
        drop = last.error_drop if last is not None else 0.0
        reason = judge.find_reason(scored, last)
        # What was accepted stands first, with refined constants and all its joints.
        if reason.code != "accepted":
            outcomes.append(CandidateOutcome(scored.candidate.choice, drop, reason))
    return tuple(outcomes), beside


_SMALL = ("not_significant", "too_small")
"""Codes of reasons that a larger effect would not have had."""


def add_limits(outcomes: Sequence[CandidateOutcome], limits: Sequence[DetectionLimit]) -> tuple[CandidateOutcome, ...]:
    """Add the detection limit to the reason of every effect that was too small to be accepted."""
    sizes = {(limit.effect, limit.joints): limit for limit in limits if math.isfinite(limit.size)}
    return tuple(
        replace(outcome, reason=_add_limit(outcome.reason, limit))
        if outcome.reason.code in _SMALL and (limit := sizes.get((outcome.choice.effect, outcome.choice.joints)))
        else outcome
        for outcome in outcomes
    )


def _add_limit(reason: Reason, limit: DetectionLimit) -> Reason:
    values = {**dict(reason.values), "limit": limit.size, "unit": limit.unit}
    if limit.shape:
        # A limit is that of the same effect with these constants: with others it is another one.
        rounded = ((name, float(f"{value:.3g}")) for name, value in limit.shape)
        values["constants"] = ", ".join(format_constant(limit.effect, name, value) for name, value in rounded)
    return Reason.build(reason.code, reason.step, **values)


def list_untried(
    tried: Sequence[CandidateOutcome],
    effects: Sequence[str] | None,
    model: Model,
    leads: ShapeProposals,
    absent: Collection[str] = (),
) -> tuple[CandidateOutcome, ...]:
    """List the effects and joints for which there was no candidate, with the reason.

    Parameters
    ----------
    tried : sequence of CandidateOutcome
        What was tried.
    effects : sequence of str, optional
        Ids of the effects that were to be tried; all where left out.
    model : Model
        The model in which something may be missing.
    leads : ShapeProposals
        What recordings and residual suggest.
    absent : collection of str
        Parts that the robot does not have.
    """
    known = {(outcome.choice.effect, name) for outcome in tried for name in outcome.choice.joints or ("",)}
    untried = []
    for effect in CATALOGUE.values():
        places = ("",) if effect.scope == "robot" else model.robot.joint_names
        for joint in places:
            if effect.is_inertia or (effect.id, joint) in known:
                continue
            is_left_out = effects is not None and effect.id not in effects
            why = "the request does not list it" if is_left_out else explain_absence(effect, joint, model, leads)
            if effects is None and effect.hardware in absent:
                why = f"the robot has no such part (has_not {effect.hardware})"
            choice = EffectChoice(effect.id, (joint,) if joint else ())
            untried.append(CandidateOutcome(choice, 0.0, Reason.build("not_tried", why=why)))
    return tuple(untried)


@dataclass(frozen=True, eq=False)
class _Judge:
    """Finds the reason of each candidate."""

    final: FinalScores
    record: SearchRecord
    choices: tuple[EffectChoice, ...]

    def find_reason(self, alone: ScoredCandidate, last: ScoredCandidate | None) -> Reason:
        """Return the reason of a candidate, from its scores beside the model alone and beside all findings."""
        candidate = alone.candidate
        for step, (finding, choice) in enumerate(zip(self.final.state.findings, self.choices, strict=True), 1):
            if _is_same_place(candidate, choice) and candidate.effect == choice.effect:
                return Reason.build("accepted", step)
            names = {scored.candidate.effect for scored in finding.equal} | set(get_effect(choice.effect).same_function)
            if _is_same_place(candidate, choice) and candidate.effect in names:
                return Reason.build("equivalent", step, by=describe_choice(choice))
        if explained := self._find_explanation(alone, last):
            return explained
        dropped = self._find_dropped(candidate)
        if dropped is not None:
            return dropped
        state = self.final.state
        if last is not None:
            rejection = find_rejection(state, last) or find_impossibility(state, last)
            if rejection is not None:
                return self._number_step(rejection)
        if candidate in self.record.rejections:
            return self._number_step(self.record.rejections[candidate])
        count, most = sum(not finding.is_transient for finding in state.findings), state.rules.max_effects
        return Reason.build("most_effects", most=float(most)) if count >= most else Reason.build("passed_over")

    def _find_explanation(self, alone: ScoredCandidate, last: ScoredCandidate | None) -> Reason | None:
        """Return which finding explains what a candidate would gain by itself; None where none does."""
        gain = last.total_gain if last is not None else 0.0
        loss = self.record.losses.get(alone.candidate.choice)
        if (
            loss is None
            or check_significance(self.final.state, alone) is not None
            or gain >= RULES.still_gains * alone.total_gain
        ):
            return None
        step = self._find_step(loss, alone.candidate)
        choice = loss.finding.judged.candidate.choice if step is None else self.choices[step - 1]
        return Reason.build("explained", step, by=describe_choice(choice), left=max(gain, 0.0) / alone.total_gain)

    def _find_step(self, loss: Loss, candidate: Candidate) -> int | None:
        """Return the rank of what a finding has become where a candidate lost by it; None where it was dropped."""
        mine = loss.finding.judged.candidate
        # A group of joints may have become several findings: that on the candidate's own joints took its gain.
        places = set(mine.joints) & set(candidate.joints) or set(mine.joints)
        steps = [
            step
            for step, choice in enumerate(self.choices, 1)
            if not places or not choice.joints or places & set(choice.joints)
        ]
        # By its own name if it has kept it; otherwise what took its place on these joints.
        named = [step for step in steps if self.choices[step - 1].effect == mine.effect]
        return next(iter(named or steps), None)

    def _find_dropped(self, candidate: Candidate) -> Reason | None:
        """Return why a finding was dropped after the search, by effect and place, whatever its constants."""
        dropped = (
            reason
            for other, reason in self.record.dropped.items()
            if other.effect == candidate.effect and _is_same_place(candidate, other.choice)
        )
        return next(dropped, None)

    def _number_step(self, reason: Reason) -> Reason:
        """Return a reason that names a finding with the rank of that finding."""
        by = dict(reason.values).get("by")
        ranks = {describe_choice(choice): step for step, choice in enumerate(self.choices, 1)}
        return replace(reason, step=ranks.get(str(by))) if by is not None else reason


def _is_same_place(candidate: Candidate, choice: EffectChoice) -> bool:
    """Return whether a candidate acts on joints of a choice alone, in the same runs."""
    same_joints = set(candidate.joints) <= set(choice.joints) and bool(candidate.joints) == bool(choice.joints)
    return same_joints and candidate.runs == choice.runs
