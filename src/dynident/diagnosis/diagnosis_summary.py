"""The texts of a diagnosis: its summary in sentences, the verdict of a ranked effect, questions about rivals."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.diagnosis.candidates.candidate_pool import Candidate
from dynident.diagnosis.candidates.significance import ScoredCandidate
from dynident.diagnosis.comparison.measured_against_predicted import Comparison
from dynident.diagnosis.decision_levels import RULES
from dynident.diagnosis.diagnosis_result import Adequacy, Conclusion, RankedEffect, UnknownPattern, word_title
from dynident.diagnosis.outcome_reasons import CandidateOutcome, Reason, describe_place
from dynident.diagnosis.search.search_state import Finding
from dynident.effects import EffectChoice, get_effect
from dynident.number_format import format_percent
from dynident.regressors.model_structure import Model
from dynident.robot.joint import join_joint_names
from dynident.robot.limits_and_drives import HARDWARE

# A torque sensor hardly resolves less of the torque: in noiseless simulations what is left has to be more than that.
_QUIET = 1e-3

UNDETERMINED = (
    "This motion does not determine the model: a fit to most of the recording predicts the rest much worse than a "
    "fit to neighbouring blocks predicts a short block. The diagnosis therefore does not name an effect that "
    "would explain the residual. Record a longer or richer motion."
)
"""What is said where a finding was given up for that."""


def word_question(effect: str, has: Collection[str]) -> str:
    """Word the question whether the robot has the part that an effect is of; empty where there is nothing to ask."""
    part = get_effect(effect).hardware
    if part in ("", *has):
        return ""
    return f"Does the robot have {HARDWARE[part]}? The residual looks like that of one."


def rank_findings(
    findings: Sequence[Finding], recommended: Sequence[EffectChoice], has: Collection[str] = ()
) -> tuple[RankedEffect, ...]:
    """Rank the findings in the order of picking."""
    ranked: list[RankedEffect] = []
    for finding, choice in zip(findings, recommended, strict=True):
        # The same effect on other joints is another place, not another name.
        others = {scored.candidate.effect for scored in finding.equal} - {choice.effect}
        twins = tuple(sorted(others | set(get_effect(choice.effect).same_function)))
        why = finding.why or f"Its signature in a residual: {get_effect(choice.effect).signature}."
        if twins:
            why += f" These data cannot distinguish it from: {', '.join(get_effect(twin).title for twin in twins)}."
        if places := _list_other_places(finding, choice):
            why += f" It may equally well act on: {', '.join(places)}."
        scored = _narrow_to_joints(finding.judged, choice)
        rank = len(ranked) + 1
        ranked.append(
            _build_ranked_effect(
                rank,
                scored,
                choice,
                finding.p,
                why,
                equivalent=twins,
                reason=Reason.build("accepted", rank),
                question=word_question(choice.effect, has),
            )
        )
    return tuple(ranked)


def rank_rejected(
    outcomes: Sequence[CandidateOutcome],
    first: Sequence[ScoredCandidate],
    beside: Mapping[Candidate, ScoredCandidate],
    n_findings: int,
) -> tuple[RankedEffect, ...]:
    """Rank the effects that are no findings by what they gain beside the findings, each at its best place.

    The best place is that where the effect gains most by itself: there a finding may explain it.

    Returns
    -------
    tuple of RankedEffect
        Effects with the ranks that follow those of the findings.
    """
    reasons = {outcome.choice: outcome.reason for outcome in outcomes}
    accepted = {outcome.choice.effect for outcome in outcomes if outcome.reason.code == "accepted"}
    best: dict[str, ScoredCandidate] = {}
    for scored in sorted(first, key=lambda scored: -scored.total_gain):
        effect = scored.candidate.effect
        if effect not in accepted and scored.candidate in beside:
            best.setdefault(effect, scored)
    # Their numbers are those beside everything that ranks above, as those of a finding are.
    ordered = sorted((beside[alone.candidate] for alone in best.values()), key=lambda scored: -scored.total_gain)
    return tuple(
        _build_ranked_effect(
            rank,
            scored,
            scored.candidate.choice,
            scored.p,
            reasons[scored.candidate.choice].text,
            equivalent=None,
            reason=reasons[scored.candidate.choice],
        )
        for rank, scored in enumerate(ordered, n_findings + 1)
    )


def _list_other_places(finding: Finding, choice: EffectChoice) -> tuple[str, ...]:
    """Return other joints on which the same effect gains as much by itself.

    Passive joints of a parallelogram turn alike, for example.
    """
    same = [scored.candidate.joints for scored in finding.equal if scored.candidate.effect == choice.effect]
    places = same if get_effect(choice.effect).in_some_runs else [joints for joints in same if len(joints) == 1]
    return tuple(dict.fromkeys(name for joints in places for name in joints if name not in choice.joints))


def _narrow_to_joints(scored: ScoredCandidate, choice: EffectChoice) -> ScoredCandidate:
    """Return a finding on the joints that are recommended in the end: some of a group may have dropped out."""
    candidate = scored.candidate
    if candidate.joints == choice.joints:
        return scored
    joints = scored.joints
    if len(joints) == len(candidate.joints):
        own = tuple(j for j, name in zip(joints, candidate.joints, strict=True) if name in choice.joints)
        # Scores that belong to none of them are those of the joints that they were found on.
        joints = own or joints
    return replace(scored, joints=joints, candidate=replace(candidate, joints=choice.joints))


def _build_ranked_effect(
    rank: int,
    scored: ScoredCandidate,
    choice: EffectChoice,
    p: float,
    why: str,
    *,
    equivalent: tuple[str, ...] | None,
    reason: Reason,
    question: str = "",
) -> RankedEffect:
    """Return one row of the ranking; `equivalent` is None for what is no finding."""
    joints = scored.reported_joints
    measured = np.maximum(scored.measured[joints].sum(), 1e-300)
    before = float(np.sqrt(scored.before[:, joints].sum() / measured))
    after = float(np.sqrt(scored.after[:, joints].sum() / measured))
    ranked = RankedEffect(
        rank=rank,
        choice=choice,
        error_before=before,
        error_after=after,
        error_drop=scored.error_drop,
        t_value=scored.t,
        p_value=p,
        significant=equivalent is not None,
        evidence="",
        equivalent=equivalent or (),
        separability=scored.separability,
        reason=reason,
        question=question,
    )
    return replace(ranked, evidence=_word_evidence(ranked.title, scored, before, after, why))


def _word_evidence(title: str, scored: ScoredCandidate, before: float, after: float, why: str) -> str:
    joints = scored.candidate.joints
    place = "all joints" if 1 < len(joints) == scored.before.shape[1] else describe_place(joints)
    if after >= before:
        return f"{title} on {place} does not improve the prediction of blocks left out of the fit. {why}"
    return (
        f"{title} on {place} lowers the error on blocks left out of the fit from {format_percent(before)} "
        f"to {format_percent(after)} (t = {scored.t:.1f} over {len(scored.gains)} blocks, "
        f"{format_percent(scored.share_improved, decimals=0)} of them better). {why}"
    )


def compute_residual_rms(comparisons: Sequence[Comparison]) -> FloatArray:
    """Return (n,): rms of the residual in the rows that count, N m or N."""
    squares = np.sum([(c.counted_residual**2).sum(axis=0) for c in comparisons], axis=0)
    counts = np.sum([c.counted_rows.sum(axis=0) for c in comparisons], axis=0)
    return np.asarray(np.sqrt(squares / np.maximum(counts, 1)), dtype=np.float64)


def compute_residual_over_noise(comparisons: Sequence[Comparison], floor: FloatArray) -> FloatArray:
    """Return (n,): rms of the residual where each joint moves, over the sensor's noise; 0 where that is zero.

    In a simulation without sensor noise a residual counts against a small share of the torque instead.
    """
    squares = np.sum([np.where(c.moving, c.residual**2, 0.0).sum(axis=0) for c in comparisons], axis=0)
    torque = np.sum([np.where(c.moving, c.measured**2, 0.0).sum(axis=0) for c in comparisons], axis=0)
    rows = np.maximum(np.sum([c.moving.sum(axis=0) for c in comparisons], axis=0), 1)
    noise = np.maximum(floor, _QUIET * np.sqrt(torque / rows))
    return np.asarray(np.sqrt(squares / rows) / np.where(noise > 0.0, noise, np.inf))


def select_verdict(
    recommended: Sequence[EffectChoice], unknown: Sequence[UnknownPattern], above: FloatArray
) -> Adequacy:
    """Return the verdict: a nameable effect is missing, something without a name is left, or nothing is.

    Parameters
    ----------
    recommended : sequence of EffectChoice
        Effects that are recommended.
    unknown : sequence of UnknownPattern
        What the residual depends on.
    above : (n,)
        Ratio of residual to noise, see `compute_residual_over_noise`, of the model with all that is recommended.

    Returns
    -------
    str
        The verdict.
    """
    if recommended:
        return "missing_effect"
    if unknown or (above > RULES.adequate_over_noise).any():
        return "unexplained"
    return "adequate"


def group_patterns(unknown: Sequence[UnknownPattern], joint_names: Sequence[str]) -> list[tuple[str, str, str]]:
    """Group what the residual depends on by the variable, however many joints there are.

    Parameters
    ----------
    unknown : sequence of UnknownPattern
        Dependences of the residual.
    joint_names : sequence of str
        All joints of the robot.

    Returns
    -------
    list of (str, str, str)
        The variable, the joints, and the share of their variance, from the least to the most.
    """
    groups: dict[str, list[UnknownPattern]] = {}
    for pattern in unknown:
        groups.setdefault(pattern.variable.replace("_", " "), []).append(pattern)
    rows = []
    for variable, patterns in groups.items():
        low, high = (format_percent(end(pattern.share for pattern in patterns), decimals=0) for end in (min, max))
        joints = join_joint_names(list(dict.fromkeys(pattern.joint for pattern in patterns)), joint_names)
        rows.append((variable, joints, low if low == high else f"{low} to {high}"))
    return rows


def _list_rivals(ranked: RankedEffect) -> list[str]:
    """List the effects that another motion would tell from a finding."""
    return [name for name in ranked.equivalent if name not in get_effect(ranked.effect).same_function]


def _word_rivals(ranked: RankedEffect, has: Collection[str]) -> str:
    """Return the titles of the rivals of a finding, as they follow its place."""
    return "".join(f", or {word_title(name, word_question(name, has))}" for name in _list_rivals(ranked))


def word_summary(
    verdict: Adequacy,
    conclusion: Conclusion,
    ranked: Sequence[RankedEffect],
    unknown: Sequence[UnknownPattern],
    residual: FloatArray,
    floor: FloatArray,
    model: Model,
    has: Collection[str] = (),
) -> str:
    """Word the verdict in a few sentences.

    Parameters
    ----------
    verdict : Adequacy
        Whether effects are recommended, or a residual is left that no effect explains, from the residual alone.
    conclusion : Conclusion
        What the diagnosis says in all.
    ranked : sequence of RankedEffect
        The ranking.
    unknown : sequence of UnknownPattern
        What the residual still depends on.
    residual : (n,)
        Rms of the residual of each joint, N m or N.
    floor : (n,)
        Noise of the sensors, N m or N.
    model : Model
        The model in which something is missing.
    has : collection of str
        Parts that the robot is known to have.
    """
    significant = [ranked_effect for ranked_effect in ranked if ranked_effect.significant]
    if verdict == "missing_effect":
        # An effect that was found joint by joint is told once.
        places: dict[tuple[str, str], list[str]] = {}
        for ranked_effect in significant:
            places.setdefault((ranked_effect.title, _word_rivals(ranked_effect, has)), []).extend(ranked_effect.joints)
        names = "; ".join(
            f"{title} on "
            f"{join_joint_names(list(dict.fromkeys(joints)), model.robot.joint_names) or 'the whole robot'}{rivals}"
            for (title, rivals), joints in places.items()
        )
        rivals = (word_question(name, has) for ranked_effect in significant for name in _list_rivals(ranked_effect))
        own = (ranked_effect.question for ranked_effect in significant)
        questions = filter(None, dict.fromkeys((*own, *rivals)))
        text = " ".join((f"The model lacks: {names}.", *questions))
    elif verdict == "unexplained" and conclusion.code != "cannot_tell":
        text = "No effect of the catalogue explains the remaining residual."
        if not unknown:
            text += (
                " The residual depends on none of the variables that were tried. If the torque was filtered before "
                "it was recorded, the sensor noise is larger than stated here."
            )
    else:
        text = " ".join((conclusion.headline, *conclusion.why))
    if unknown:
        parts = "; ".join(
            f"{joints} over {variable} ({shares})"
            for variable, joints, shares in group_patterns(unknown, model.robot.joint_names)
        )
        text += f" The residual still depends on: {parts}."
        text += "".join(f" {cause}" for cause in dict.fromkeys(p.cause for p in unknown) if cause and cause not in text)
    # The joint where the residual exceeds the noise most, in multiples, stands for all.
    worst = int(np.argmax(residual / np.maximum(floor, 1e-12)))
    joint = model.robot.joints[worst]
    text += (
        f" The remaining residual is {residual[worst]:.3g} {joint.effort_unit} on {joint.name}; the sensor noise in "
        f"the same band is {floor[worst]:.2g} {joint.effort_unit}."
    )
    return text
