"""Describe which parameters of an identified model are determined only together, and which are not determined."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.array_types import FloatArray
from dynident.blas_threads import single_threaded
from dynident.estimation import Statistics, statistics
from dynident.estimation.collinearity import (
    NOT_DETERMINED,
    Collinearity,
    CorrelatedPair,
    WeakDirection,
    find_collinearity,
)
from dynident.identification.study.result import Identification

MOST_SENTENCES = 10
_MOST_PARTS = 5


@dataclass(frozen=True, eq=False)
class ParameterDependence:
    """Dependence of the parameters of a model.

    Parameters
    ----------
    names : tuple of str
        Names of the base parameters.
    correlation : (b, b)
        Correlation of their estimates, for a heat map.
    sentences : tuple of str
        What is determined only together, worst first.
    dependence : Collinearity
        What the analysis found, in numbers.
    """

    names: tuple[str, ...]
    correlation: FloatArray
    sentences: tuple[str, ...]
    dependence: Collinearity


@single_threaded
def parameter_dependence(identification: Identification, most: int = MOST_SENTENCES) -> ParameterDependence:
    """Say which parameters the motion determines only together.

    Parameters
    ----------
    identification : Identification
        The identified model.
    most : int
        Largest number of sentences.

    Returns
    -------
    ParameterDependence
        The correlation of the parameters, and sentences about the worst of it.
    """
    names = tuple(column.name for column in identification.model.kept)
    analysis = find_collinearity(identification.estimate.solution, _compute_motion_statistics(identification), most)
    sentences = [_describe_direction(direction, names) for direction in analysis.directions]
    sentences += [_describe_pair(pair, names) for pair in analysis.pairs]
    return ParameterDependence(names, analysis.correlation, tuple(sentences[:most]), analysis)


def _compute_motion_statistics(identification: Identification) -> Statistics:
    """Return the statistics that show how the motion couples the estimates."""
    current = identification.statistics
    if identification.choices.covariance != "by_time_and_joints" or identification.estimate.not_essential:
        return current
    # A covariance from a few blocks of time has a low rank and makes up correlations. The covariance by joint is
    # smoother.
    return statistics(identification.data.equations, identification.estimate.solution, "by_joint")


def _describe_pair(pair: CorrelatedPair, names: tuple[str, ...]) -> str:
    first_name, second_name = names[pair.first], names[pair.second]
    # A negative correlation leaves the sum certain, a positive one the difference.
    rather = "their sum" if pair.correlation < 0 else "their difference"
    return (
        f"{first_name} and {second_name} are determined only together (correlation {pair.correlation:.2f}): the motion "
        f"shows {rather}, each in units of its own uncertainty, better than either."
    )


def _describe_direction(direction: WeakDirection, names: tuple[str, ...]) -> str:
    # The largest part leads with the factor one; the others are relative to it.
    text = names[direction.parts[0][0]]
    for number, factor in direction.parts[1:_MOST_PARTS]:
        size = abs(factor)
        text += f" {'+' if factor > 0 else '-'} {'' if abs(size - 1) < 0.005 else f'{size:.2g} '}{names[number]}"
    if len(direction.parts) > _MOST_PARTS:
        text += f" and {len(direction.parts) - _MOST_PARTS} more"
    how = "is not determined" if direction.ratio >= NOT_DETERMINED else "is hardly determined"
    return f"{text} {how}: this motion shows it {direction.ratio:.0f} times less than what it shows best."
