"""A diagnosis in a robotics engineer's words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dynident.arrays import FloatArray
from dynident.diagnosis.candidates.gate import JudgedCandidate
from dynident.diagnosis.result import Adequacy, RankedEffect, UnknownPattern
from dynident.diagnosis.search.state import Finding
from dynident.effects import EffectChoice, effect_by_id
from dynident.regressors.model import Model


def rank_all(
    picks: Sequence[Finding], first: Sequence[JudgedCandidate], recommended: Sequence[EffectChoice]
) -> tuple[RankedEffect, ...]:
    """Every family at its best place: what was picked in the order of picking, then the others by their gain."""
    ranked: list[RankedEffect] = []
    for finding, choice in zip(picks, recommended, strict=True):
        others = {item.candidate.effect for item in finding.equal} - {choice.effect}
        twins = tuple(sorted(others | set(effect_by_id(choice.effect).same_function)))
        why = finding.why or f"Its mark in a residual: {effect_by_id(choice.effect).signature}."
        if twins:
            why += f" This data cannot tell it from: {', '.join(twins)}."
        places = [item.candidate.joints for item in finding.equal if item.candidate.effect == choice.effect]
        if places and effect_by_id(choice.effect).in_some_runs:
            why += f" It may as well be on: {', '.join(name for joints in places for name in joints)}."
        item = _narrowed(finding.judged, choice)
        ranked.append(_ranked(len(ranked) + 1, item, choice, finding.p, why, twins))
    picked = {choice.effect for choice in recommended}
    best: dict[str, JudgedCandidate] = {}
    for item in first:
        effect = item.candidate.effect
        if effect not in picked and (effect not in best or item.total_gain > best[effect].total_gain):
            best[effect] = item
    for item in sorted(best.values(), key=lambda judged: -judged.total_gain):
        # It may have passed on its own at first; what was picked then explained the same part of the residual.
        better = "What ranks above it explains the same part of the residual, or nature does not allow it."
        why = better if item.passes else "That is not enough."
        ranked.append(_ranked(len(ranked) + 1, item, item.candidate.choice, item.p, why, None))
    return tuple(ranked)


def _narrowed(item: JudgedCandidate, choice: EffectChoice) -> JudgedCandidate:
    """A finding on those joints that are recommended in the end: of a group, some may have dropped out."""
    candidate = item.candidate
    if candidate.joints == choice.joints:
        return item
    kept = item.joints
    if len(kept) == len(candidate.joints):
        kept = tuple(j for j, name in zip(kept, candidate.joints, strict=True) if name in choice.joints)
    return replace(item, joints=kept, candidate=replace(candidate, joints=choice.joints))


def _ranked(
    rank: int,
    item: JudgedCandidate,
    choice: EffectChoice,
    p: float,
    why: str,
    equivalent: tuple[str, ...] | None,
) -> RankedEffect:
    """One row of the ranking; `equivalent` None: not a finding."""
    joints = item.told_of
    measured = np.maximum(item.measured[joints].sum(), 1e-300)
    before = float(np.sqrt(item.before[:, joints].sum() / measured))
    after = float(np.sqrt(item.after[:, joints].sum() / measured))
    return RankedEffect(
        rank=rank,
        choice=choice,
        error_before=before,
        error_after=after,
        error_drop=item.error_drop,
        t_value=item.t,
        p_value=p,
        significant=equivalent is not None,
        evidence=_evidence(item, before, after, why),
        equivalent=equivalent or (),
        separability=item.separability,
    )


def _evidence(item: JudgedCandidate, before: float, after: float, why: str) -> str:
    effect = effect_by_id(item.candidate.effect)
    place = ", ".join(item.candidate.joints) or "the whole robot"
    if after >= before:
        return f"{effect.title} on {place} does not improve the prediction of stretches left out of the fit."
    return (
        f"{effect.title} on {place} lowers the error on stretches left out of the fit from {before:.2%} to {after:.2%} "
        f"(t = {item.t:.1f} over {len(item.gains)} stretches, {item.share_improved:.0%} of them better). {why}"
    )


def verdict_of(recommended: Sequence[EffectChoice], unknown: Sequence[UnknownPattern]) -> Adequacy:
    """The verdict: something nameable is missing, something is left that has no name, or nothing is."""
    if recommended:
        return "missing_effect"
    if unknown:
        return "unexplained"
    return "adequate"


def summary(
    verdict: Adequacy,
    ranked: Sequence[RankedEffect],
    unknown: Sequence[UnknownPattern],
    residual: FloatArray,
    floor: FloatArray,
    model: Model,
) -> str:
    """The verdict in a few sentences."""
    found = [item for item in ranked if item.significant]
    if verdict == "missing_effect":
        names = "; ".join(
            f"{effect_by_id(item.effect).title} on {', '.join(item.joints) or 'the whole robot'}" for item in found
        )
        text = f"The model lacks: {names}."
    elif verdict == "unexplained":
        text = "No effect of the catalogue explains what is left."
    else:
        text = "Nothing is missing that this data could show."
    if unknown:
        parts = "; ".join(f"{p.joint} over {p.variable.replace('_', ' ')} ({p.share:.0%})" for p in unknown[:4])
        text += f" The residual still depends on: {parts}."
    worst = int(np.argmax(residual / np.maximum(floor, 1e-12)))
    joint = model.robot.joints[worst]
    text += (
        f" The residual left is {residual[worst]:.3g} {joint.effort_unit} on {joint.name}, against a sensor noise of "
        f"{floor[worst]:.2g} {joint.effort_unit} in the same band."
    )
    return text
