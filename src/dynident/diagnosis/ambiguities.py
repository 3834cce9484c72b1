"""List what a diagnosis leaves open: rivals of findings, misnamed findings, effects that these data cannot show.

Holds how many rivals a question names.

A wrong name is an effect that leaves more than it explains, or that another function of the position replaces. Findings
that were made beside such a name, and would not have been made without it, go with it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np

from dynident.diagnosis.candidates.significance import ScoredCandidate
from dynident.diagnosis.comparison.measured_against_predicted import Comparison
from dynident.diagnosis.decision_levels import RULES
from dynident.diagnosis.diagnosis_result import Invisible, UnknownPattern, Variable
from dynident.diagnosis.search.acceptance_rules import check_significance
from dynident.diagnosis.search.search_state import Finding, State
from dynident.effects import CATALOGUE, EffectChoice, get_effect
from dynident.robot.robot_model import Robot

_KINDS = ("position", "other_joints")


def find_misnamed(
    findings: Sequence[Finding],
    recommended: Sequence[EffectChoice],
    unknown: Sequence[UnknownPattern],
    final: Sequence[Comparison],
) -> list[int]:
    """Return the numbers of the findings whose joint still depends on what they should have explained.

    Parameters
    ----------
    findings, recommended : sequences of equal length
        The findings, and how they are recommended.
    unknown : sequence of UnknownPattern
        Patterns of the residual that is left once all findings are in the model.
    final : sequence of Comparison
        The comparisons of that model.

    Returns
    -------
    list of int
        Numbers of the findings, ascending.
    """
    names = final[0].joint_names
    squares = np.sum([(c.counted_residual**2).sum(axis=0) for c in final], axis=0)
    wrong = []
    for number, (finding, choice) in enumerate(zip(findings, recommended, strict=True)):
        judged = finding.judged
        effect = get_effect(choice.effect)
        of_position = effect.of_position
        # A mass has no formula that could be another one, and what all recordings leave says nothing of some of them.
        if effect.in_some_runs or (not of_position and len(choice.joints) != 1):
            continue
        # Functions of the position are easily confused, so less of a remainder tells; other effects get the benefit of
        # the doubt.
        least, kinds = (RULES.left_over, _KINDS) if of_position else (RULES.much_left_over, get_args(Variable))
        # An effect across two joints has one name and acts on both.
        here = [j for j in judged.joints if names[j] in choice.joints or (of_position and len(choice.joints) == 1)]
        for j in here:
            removed = float((judged.before - judged.after)[:, j].sum())
            # A pattern's share is one of the residual that is left, so it is turned into a squared error for the
            # comparison.
            remainders = [p.share * squares[j] for p in unknown if p.joint == names[j] and p.variable in kinds]
            if remainders and max(remainders) > least * removed:
                wrong.append(number)
                break
    return wrong


def find_dependent_findings(
    findings: Sequence[Finding], wrong: Sequence[int], start: State, first: Sequence[ScoredCandidate]
) -> list[int]:
    """Return the numbers of the findings on the joints of a wrong name that do not pass without it.

    Beside a wrong curve something else may make up for its errors.

    Parameters
    ----------
    findings : sequence of Finding
        The findings.
    wrong : sequence of int
        Numbers of the wrong names.
    start : State
        The search before anything was found.
    first : sequence of ScoredCandidate
        All candidates, scored before anything was found.

    Returns
    -------
    list of int
        Numbers of the findings that go with the wrong names.
    """
    alone = {scored.candidate: scored for scored in first}
    dependent = []
    for number, finding in enumerate(findings):
        mine = finding.judged
        shares_joint = any(set(findings[k].judged.joints) & set(mine.joints) for k in wrong)
        before = alone.get(mine.candidate)
        if shares_joint and number not in wrong and before is not None and check_significance(start, before):
            dependent.append(number)
    return dependent


# More rivals would make a question that no single experiment decides.
_MOST_RIVALS = 3


@dataclass(frozen=True)
class Doubt:
    """An effect that was found, or could not be seen, and what else it may be.

    Parameters
    ----------
    suspect : EffectChoice
        The effect that was found, or could not be seen.
    rivals : tuple of EffectChoice
        What else it may be, hardest to tell first; none where the effect could not be seen.
    beside : tuple of EffectChoice
        The other effects that the data ask for.
    """

    suspect: EffectChoice
    rivals: tuple[EffectChoice, ...] = ()
    beside: tuple[EffectChoice, ...] = ()


def list_doubts(
    findings: Sequence[Finding],
    recommended: Sequence[EffectChoice],
    invisible: Sequence[Invisible],
    robot: Robot,
    judged: Sequence[ScoredCandidate] = (),
    asked: Sequence[str] = (),
) -> tuple[Doubt, ...]:
    """List what a diagnosis leaves open, first what decides about the first recommendation.

    Findings that may be another effect come in the order in which they are recommended; then effects that somebody
    asked
    about, or most arms have, and the data could not have shown.

    Parameters
    ----------
    findings, recommended : sequences of equal length
        The findings, and how they are recommended.
    invisible : sequence of Invisible
        Effects that the data could not have shown.
    robot : Robot
        The robot, which gives joints and shape constants of unseen effects.
    judged : sequence of ScoredCandidate
        All candidates tried beside the diagnosed model: rivals that come near a finding are among them.
    asked : sequence of str
        Ids of effects that somebody named; the others were only tried because they are in the catalogue.

    Returns
    -------
    tuple of Doubt
        Doubts about findings first, then effects that could not be seen.
    """
    doubts = []
    for finding, choice in zip(findings, recommended, strict=True):
        others = tuple(other for other in recommended if other is not choice)
        rivals = _list_rivals(choice, finding.equal)
        doubt = Doubt(choice, rivals, others) if rivals else _find_near_doubt(choice, others, judged)
        doubts += [doubt] if doubt else []
    # One doubt an effect, with all joints on which it could not be seen.
    hidden: dict[str, list[str]] = {}
    for invisible_effect in invisible:
        hidden.setdefault(invisible_effect.effect, []).extend(invisible_effect.joints)
    recommended_ids = {choice.effect for choice in recommended}
    unseen_ids = [
        name
        for name in dict.fromkeys((*asked, *_list_often_missed()))
        if name in hidden and name not in recommended_ids
    ]
    doubts += [Doubt(_build_unseen_choice(name, hidden[name], robot), (), tuple(recommended)) for name in unseen_ids]
    return tuple(doubts)


def _list_often_missed() -> list[str]:
    """List what most arms have, most often missed first.

    Effects that no data hint at and hardly any arm has are not worth anybody's time on the robot.
    """
    ranks = {name: effect.often_missed for name, effect in CATALOGUE.items() if effect.often_missed is not None}
    return sorted(ranks, key=ranks.__getitem__)


def _list_rivals(choice: EffectChoice, others: Iterable[ScoredCandidate]) -> tuple[EffectChoice, ...]:
    """Return other names for an effect, one choice each; for an effect of some runs, other links that it may be on.

    Left out are effects that are the same function of every motion, and those so general that they include the effect:
    no
    motion tells a special case from what includes it.
    """
    same = {choice.effect, *get_effect(choice.effect).same_function}
    rivals: dict[object, EffectChoice] = {}
    for scored in others:
        name = scored.candidate.effect
        if _is_elsewhere(scored.candidate.choice, choice):
            rivals.setdefault(scored.candidate.joints, scored.candidate.choice)
        elif name not in same and choice.effect not in get_effect(name).covers:
            rivals.setdefault(name, scored.candidate.choice)
    return tuple(rivals.values())[:_MOST_RIVALS]


def _is_elsewhere(other: EffectChoice, choice: EffectChoice) -> bool:
    """Return whether it is the same effect of some runs on another link."""
    return (
        other.effect == choice.effect
        and get_effect(choice.effect).in_some_runs
        and not set(other.joints) & set(choice.joints)
    )


def _find_near_doubt(
    choice: EffectChoice, others: tuple[EffectChoice, ...], judged: Sequence[ScoredCandidate]
) -> Doubt | None:
    """Return the doubt raised by what is easily confused with a finding and gains nearly as much on some of its joints.

    What came near matters where nothing is equal: with equals there is a plainer question to ask.
    """
    best = _find_best_by_place(choice, judged)
    near = [
        scored
        for scored in judged
        if _are_confused(scored, choice)
        and (own := best.get(_get_place(scored.candidate.joints, choice))) is not None
        and scored.total_gain >= RULES.rival_gain * own.total_gain > 0.0
    ]
    # The strongest rival decides which joints are at issue; weaker ones at the same place join it.
    for first in sorted(near, key=lambda scored: -scored.total_gain):
        place = _get_place(first.candidate.joints, choice)
        # A rival may be about some of the joints only: the finding is doubted on these, and stays undoubted on the
        # others.
        at_issue = tuple(name for name in choice.joints if name in place)
        same_place = [scored for scored in near if _get_place(scored.candidate.joints, choice) == place]
        rivals = _list_rivals(choice, sorted(same_place, key=lambda scored: -scored.total_gain))
        if rivals:
            rest = tuple(name for name in choice.joints if name not in place)
            undoubted = (replace(choice, joints=rest),) if rest else ()
            return Doubt(replace(choice, joints=at_issue), rivals, (*others, *undoubted))
    return None


def _find_best_by_place(
    choice: EffectChoice, judged: Sequence[ScoredCandidate]
) -> dict[frozenset[str], ScoredCandidate]:
    """Return the best candidate of the finding's effect on each subset of its joints."""
    best: dict[frozenset[str], ScoredCandidate] = {}
    # Best first, so that the first candidate of each set of joints is the best one.
    for scored in sorted(judged, key=lambda scored: -scored.total_gain):
        joints = frozenset(scored.candidate.joints)
        within = joints <= set(choice.joints) and bool(joints) == bool(choice.joints)
        if scored.candidate.effect == choice.effect and within:
            best.setdefault(joints, scored)
    return best


def _get_place(joints: Sequence[str], choice: EffectChoice) -> frozenset[str]:
    """Return the joints of a finding that a rival is about: its own, or all where one of them is the whole robot."""
    return frozenset(joints) if joints and choice.joints else frozenset(choice.joints)


def _are_confused(scored: ScoredCandidate, choice: EffectChoice) -> bool:
    """Return whether the catalogue warns that one of two effects is taken for the other."""
    name = scored.candidate.effect
    return name in get_effect(choice.effect).confused_with or choice.effect in get_effect(name).confused_with


def _build_unseen_choice(effect: str, joints: Sequence[str], robot: Robot) -> EffectChoice:
    """Return an effect that could not be seen, with shape constants from the middle of its grid."""
    names = tuple(dict.fromkeys(joints))
    # A joint that follows others has no limits of its own: its mover gives the scale of the grid.
    first = robot.get_movers(names[0])[0] if names else 0
    grid = CATALOGUE[effect].grid(robot, first)
    shape = grid[len(grid) // 2] if grid else {}
    return EffectChoice(effect, names, tuple(sorted((name, float(value)) for name, value in shape.items())))
