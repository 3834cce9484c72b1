"""What a diagnosis leaves open: effects that may be another one, and effects that the data could not have shown."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from dynident.diagnosis.candidates.gate import JudgedCandidate
from dynident.diagnosis.residuals.stretches import t_of
from dynident.diagnosis.result import Invisible
from dynident.diagnosis.search.state import Finding
from dynident.effects import CATALOGUE, EffectChoice, effect_by_id
from dynident.robot.model import Robot

_MOST_RIVALS = 3
_CLOSE, _NEAR, _NEAR_T = 0.95, 0.8, 2.0
"""A rival is one that gains so much of what the pick gains (`_CLOSE`), or less (`_NEAR`) where stretches disagree which
of the two gains more (t of the difference below `_NEAR_T`). What a simulated model gets wrong elsewhere shifts gains by
some percent: a spring passed for a gravity compensator with 0.699 against 0.705 of the error explained."""
_NEAR_IN_NAME = 0.7
"""The same for effects that the catalogue says are confused with each other: candidates are judged at the few shape
constants of a grid, and a power law of the speed that no grid value met took Stribeck's name at 0.78 of its gain."""


@dataclass(frozen=True)
class Doubt:
    """An effect that was found, or that could not be seen, and what else it may be: its rivals, hardest first.

    `beside` are the other effects that the data asks for.
    """

    suspect: EffectChoice
    rivals: tuple[EffectChoice, ...] = ()
    beside: tuple[EffectChoice, ...] = ()


def doubts_of(
    picks: Sequence[Finding],
    recommended: Sequence[EffectChoice],
    invisible: Sequence[Invisible],
    robot: Robot,
    judged: Sequence[JudgedCandidate] = (),
    asked: Sequence[str] = (),
) -> tuple[Doubt, ...]:
    """What a diagnosis leaves open, what decides about the first recommendation first.

    Picks that may be another effect come in the order in which they are recommended; then what somebody asked about, or
    most arms have, and the data could not have shown.

    Parameters
    ----------
    picks, recommended : of equal length
        What was found, and how it is recommended.
    invisible : sequence of Invisible
    robot : Robot
    judged : sequence of JudgedCandidate
        All candidates beside the model that was diagnosed: among them are rivals that come near a pick.
    asked : sequence of effect ids
        Those that somebody named; the others were only tried because they are in the catalogue.
    """
    doubts = []
    for finding, choice in zip(picks, recommended, strict=True):
        beside = tuple(other for other in recommended if other is not choice)
        # What came near matters where nothing is equal: with equals there is a plainer question to ask.
        rivals = _rivals(choice, finding.equal)
        found = Doubt(choice, rivals, beside) if rivals else _near_doubt(choice, beside, judged)
        doubts += [found] if found else []
    hidden: dict[str, list[str]] = {}
    for item in invisible:
        hidden.setdefault(item.effect, []).extend(item.joints)
    taken = {choice.effect for choice in recommended}
    wondered = [name for name in dict.fromkeys((*asked, *_often_missed())) if name in hidden and name not in taken]
    doubts += [Doubt(_unseen(name, hidden[name], robot), (), tuple(recommended)) for name in wondered]
    return tuple(doubts)


def _often_missed() -> list[str]:
    """What most arms have, most often missed first.

    Whether anything else is there, that no data hint at, is not worth anybody's time on the robot: nobody doubted it.
    """
    ranks = {name: effect.often_missed for name, effect in CATALOGUE.items() if effect.often_missed is not None}
    return sorted(ranks, key=ranks.__getitem__)


def _rivals(choice: EffectChoice, others: Iterable[JudgedCandidate]) -> tuple[EffectChoice, ...]:
    """Other names for an effect, one choice each; of what some runs have, other links that it may as well sit on.

    Not those that are the same function of every motion, nor those so general that they can say the effect as well: no
    motion tells a special case from what includes it.
    """
    same = {choice.effect, *effect_by_id(choice.effect).same_function}
    found: dict[object, EffectChoice] = {}
    for item in others:
        name = item.candidate.effect
        if _elsewhere(item.candidate.choice, choice):
            found.setdefault(item.candidate.joints, item.candidate.choice)
        elif name not in same and choice.effect not in effect_by_id(name).covers:
            found.setdefault(name, item.candidate.choice)
    return tuple(found.values())[:_MOST_RIVALS]


def _elsewhere(other: EffectChoice, choice: EffectChoice) -> bool:
    """Whether it is the same effect, which some runs have, on another link."""
    return (
        other.effect == choice.effect
        and effect_by_id(choice.effect).in_some_runs
        and not set(other.joints) & set(choice.joints)
    )


def _near_doubt(
    choice: EffectChoice, beside: tuple[EffectChoice, ...], judged: Sequence[JudgedCandidate]
) -> Doubt | None:
    """The doubt that a candidate raises which gains nearly as much as a pick, on some of its joints or on all."""
    own = _best_by_place(choice, judged)
    near = [item for item in judged if _nearly_as_good(item, _beside(item, choice, own), _confused(item, choice))]
    for first in sorted(near, key=lambda item: -item.total_gain):
        place = _place(first.candidate.joints, choice)
        at_issue = tuple(name for name in choice.joints if name in place)
        same_place = [item for item in near if _place(item.candidate.joints, choice) == place]
        rivals = _rivals(choice, sorted(same_place, key=lambda item: -item.total_gain))
        if rivals:
            rest = tuple(name for name in choice.joints if name not in place)
            undoubted = (replace(choice, joints=rest),) if rest else ()
            return Doubt(replace(choice, joints=at_issue), rivals, (*beside, *undoubted))
    return None


def _best_by_place(choice: EffectChoice, judged: Sequence[JudgedCandidate]) -> dict[frozenset[str], JudgedCandidate]:
    """The best candidate of a picked effect on all of its joints, and on some of them alone."""
    best: dict[frozenset[str], JudgedCandidate] = {}
    for item in sorted(judged, key=lambda item: -item.total_gain):
        joints = frozenset(item.candidate.joints)
        within = joints <= set(choice.joints) and bool(joints) == bool(choice.joints)
        if item.candidate.effect == choice.effect and within:
            best.setdefault(joints, item)
    return best


def _place(joints: Sequence[str], choice: EffectChoice) -> frozenset[str]:
    """The joints of a pick that a rival is about: its own, or all where one of them is the whole robot."""
    return frozenset(joints) if joints and choice.joints else frozenset(choice.joints)


def _beside(
    item: JudgedCandidate, choice: EffectChoice, own: Mapping[frozenset[str], JudgedCandidate]
) -> JudgedCandidate | None:
    """The candidate of the pick that another one has to be held against; None where they do not compare."""
    if bool(item.candidate.joints) == bool(choice.joints):
        return own.get(frozenset(item.candidate.joints))
    # What is on a joint and what belongs to the whole robot are known to be taken for one another, or they are not.
    return own.get(frozenset(choice.joints)) if _confused(item, choice) else None


def _confused(item: JudgedCandidate, choice: EffectChoice) -> bool:
    """Whether the catalogue warns that one of two effects is taken for the other."""
    name = item.candidate.effect
    return name in effect_by_id(choice.effect).confused_with or choice.effect in effect_by_id(name).confused_with


def _nearly_as_good(item: JudgedCandidate, best: JudgedCandidate | None, confused: bool) -> bool:
    if best is None or item.total_gain <= 0:
        return False
    if item.total_gain >= (_NEAR_IN_NAME if confused else _CLOSE) * best.total_gain:
        return True
    return item.total_gain >= _NEAR * best.total_gain and t_of(best.gains - item.gains) < _NEAR_T


def _unseen(effect: str, joints: Sequence[str], robot: Robot) -> EffectChoice:
    """An effect that could not be seen, with the shape constants in the middle of those worth trying."""
    names = tuple(dict.fromkeys(joints))
    first = robot.movers(names[0])[0] if names else 0
    grid = CATALOGUE[effect].grid(robot, first)
    shape = grid[len(grid) // 2] if grid else {}
    return EffectChoice(effect, names, tuple(sorted((name, float(value)) for name, value in shape.items())))
