"""What a diagnosis leaves open: effects that may be another one, and effects that the data could not have shown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dynident.diagnosis.result import Invisible
from dynident.diagnosis.search.state import Finding
from dynident.effects import CATALOGUE, EffectChoice, effect_by_id
from dynident.robot.model import Robot

_MOST_RIVALS = 3
# Of what most arms have, most often missed first.
_COMMON = ("presliding", "load_dependent_friction", "stribeck", "torque_ripple", "viscous_nonlinear", "torque_delay")


@dataclass(frozen=True)
class Doubt:
    """An effect that was found, or that could not be seen, and what else it may be: its rivals, hardest first.

    `beside` are the other effects that the data asks for.
    """

    suspect: EffectChoice
    rivals: tuple[EffectChoice, ...] = ()
    beside: tuple[EffectChoice, ...] = ()


def doubts_of(
    picks: Sequence[Finding], recommended: Sequence[EffectChoice], invisible: Sequence[Invisible], robot: Robot
) -> tuple[Doubt, ...]:
    """What a diagnosis leaves open: picks that have equals, then effects that the data could not have shown."""
    doubts = []
    for finding, choice in zip(picks, recommended, strict=True):
        same = {choice.effect, *effect_by_id(choice.effect).same_function}
        rivals: dict[str, EffectChoice] = {}
        for judged in finding.equal:
            if judged.candidate.effect not in same:
                rivals.setdefault(judged.candidate.effect, judged.candidate.choice)
        if rivals:
            beside = tuple(other for other in recommended if other is not choice)
            doubts.append(Doubt(choice, tuple(rivals.values())[:_MOST_RIVALS], beside))
    hidden: dict[str, list[str]] = {}
    for item in invisible:
        hidden.setdefault(item.effect, []).extend(item.joints)
    order = [*(name for name in _COMMON if name in hidden), *(name for name in hidden if name not in _COMMON)]
    doubts += [Doubt(_unseen(name, hidden[name], robot), (), tuple(recommended)) for name in order]
    return tuple(doubts)


def _unseen(effect: str, joints: Sequence[str], robot: Robot) -> EffectChoice:
    """An effect that could not be seen, with the shape constants in the middle of those worth trying."""
    names = tuple(dict.fromkeys(joints))
    first = robot.joint_names.index(names[0]) if names else 0
    grid = CATALOGUE[effect].grid(robot, first)
    shape = grid[len(grid) // 2] if grid else {}
    return EffectChoice(effect, names, tuple(sorted((name, float(value)) for name, value in shape.items())))
