"""In words: which parameters of an identified model are determined only together, and what is not determined."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.arrays import FloatArray
from dynident.estimation import Statistics, statistics
from dynident.estimation.dependence import NEVER, CloseTogether, Dependence, HardlySeen, dependence
from dynident.identification.study.result import Identification
from dynident.threads import single_threaded

MOST_SENTENCES = 10
_MOST_PARTS = 5


@dataclass(frozen=True, eq=False)
class ParameterDependence:
    """For a reader: `sentences`, worst first; for a heat map: `names` (b) and `correlation` (b, b)."""

    names: tuple[str, ...]
    correlation: FloatArray
    sentences: tuple[str, ...]
    found: Dependence


@single_threaded
def parameter_dependence(identification: Identification, most: int = MOST_SENTENCES) -> ParameterDependence:
    """Say which parameters the motion determines only together; at most so many sentences."""
    names = tuple(column.name for column in identification.model.kept)
    found = dependence(identification.estimate.solution, _by_motion(identification), most)
    sentences = [_of_direction(one, names) for one in found.directions]
    sentences += [_of_pair(one, names) for one in found.pairs]
    return ParameterDependence(names, found.correlation, tuple(sentences[:most]), found)


def _by_motion(identification: Identification) -> Statistics:
    """How the motion makes estimates depend on one another; from few stretches of time that is known but roughly."""
    told = identification.statistics
    if identification.choices.covariance != "by_time_and_joints" or identification.estimate.not_essential:
        return told
    return statistics(identification.data.equations, identification.estimate.solution, "by_joint")


def _of_pair(pair: CloseTogether, names: tuple[str, ...]) -> str:
    one, other = names[pair.first], names[pair.second]
    rather = "their sum" if pair.correlation < 0 else "their difference"
    return (
        f"{one} and {other} are determined only together (correlation {pair.correlation:.2f}): the motion shows "
        f"{rather}, each in units of its own uncertainty, better than either."
    )


def _of_direction(direction: HardlySeen, names: tuple[str, ...]) -> str:
    text = names[direction.parts[0][0]]
    for number, factor in direction.parts[1:_MOST_PARTS]:
        size = abs(factor)
        text += f" {'+' if factor > 0 else '-'} {'' if abs(size - 1) < 0.005 else f'{size:.2g} '}{names[number]}"
    if len(direction.parts) > _MOST_PARTS:
        text += f" and {len(direction.parts) - _MOST_PARTS} more"
    how = "is not determined" if direction.ratio >= NEVER else "is hardly determined"
    return f"{text} {how}: this motion shows it {direction.ratio:.0f} times less than what it shows best."
