"""Validation by bootstrap: do computed standard deviations agree with drawn ones? Holds its pass levels.

The standard deviations of an identification are computed, not drawn: by the jackknife over blocks, with the weights of
the equations and the columns of shape constants as they are at the estimate. Draws weigh the equations anew. Both are
from the same blocks, which know a deviation to a share of 1 / sqrt(2 ν), with the ν degrees of freedom of its variance:
where they differ by more than twice that, the deviation depends on how it is computed. Blocks that depend on their
neighbours make a computed deviation larger, and draws of single blocks leave that out: by so much, drawn ones may be
smaller. Drawn ones of less than half are named beside the verdict: of those the draws confirm only the smaller part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynident.array_types import FloatArray
from dynident.estimation import Bootstrap, Drawing, Reduction, Solution, Statistics, bootstrap_estimates
from dynident.estimation.block_bootstrap import DRAWS
from dynident.estimation.parameter_covariance import estimate_cluster_covariance, find_occupied_blocks
from dynident.estimation.residual_correlation import FEWEST_BLOCKS
from dynident.identification import Identification
from dynident.identification.shape_constant_intervals import linearise_shapes
from dynident.identification.shape_refinement import list_shape_variables
from dynident.identification.thresholds import ValidationOutcome
from dynident.parallel import single_threaded
from dynident.progress import Progress, ignore_progress

# Deviations differ where their ratio is off by more than so many of its own standard deviations.
_TWICE = 2.0
_MOST_OUTSIDE = 0.1
"""Share of the parameters that may be outside: of deviations known so well, one in twenty would be by chance."""

_CONFIRMED = 0.5
"""Ratio of drawn over computed deviations below which three quarters of the variance are not from single blocks."""

# Share of the draws that may be lost before the rest is no fair sample of them.
_MOST_LOST = 0.1


@dataclass(frozen=True)
class DrawnParameter:
    """A parameter, or a shape constant in the units of its search (its logarithm where that is in equal ratios).

    Parameters
    ----------
    name : str
        Name of the parameter; of a shape constant its name and joints, with "ln" before a logarithm.
    unit : str
        Unit of the value and of both deviations, "-" where there is none.
    told : float
        Standard deviation that the identification computed.
    drawn : float
        Standard deviation over the draws.
    low : float
        Smallest ratio of `drawn` over `told` that so few blocks of time, and the correlation of neighbours, explain.
    high : float
        Largest such ratio.
    """

    name: str
    unit: str
    told: float
    drawn: float
    low: float
    high: float

    @property
    def ratio(self) -> float:
        """`drawn` over `told`."""
        return self.drawn / self.told if self.told > 0 else float("inf") if self.drawn > 0 else 1.0

    @property
    def outside(self) -> bool:
        """Whether the two differ by more than so few blocks explain."""
        return not self.low <= self.ratio <= self.high


@dataclass(frozen=True)
class BootstrapValidation:
    """Computed standard deviations beside those of a bootstrap.

    Parameters
    ----------
    parameters : tuple of DrawnParameter
        The parameters and behind them the shape constants; empty where nothing was drawn.
    kind : str or None
        How was drawn: "wild" with random weights for the residuals, else blocks with replacement; None where nothing
        was drawn.
    stretches : int
        Number of blocks of time that hold rows.
    draws : int
        Number of draws.
    lost : int
        Draws that did not determine all parameters and were left out.
    judged : ValidationOutcome
        Whether the deviations agree, and the reason.
    """

    parameters: tuple[DrawnParameter, ...]
    kind: Drawing | None
    stretches: int
    draws: int
    lost: int
    judged: ValidationOutcome


@single_threaded
def validate_bootstrap(
    identification: Identification, *, draws: int = DRAWS, seed: int = 0, progress: Progress = ignore_progress
) -> BootstrapValidation:
    """Draw blocks of time anew and compare the deviations with those of the identification.

    Only reduced data are used: no recording is read.

    Parameters
    ----------
    identification : Identification
        The identified model.
    draws : int
        How often blocks are drawn.
    seed : int
        Of the random numbers.
    progress : Progress
        Called with the fraction done and a message.

    Returns
    -------
    BootstrapValidation
        Deviations by drawing beside the computed ones; not evaluated where the model cannot be drawn.
    """
    # Blocks without rows cannot be drawn from, and do not count.
    stretches = int(find_occupied_blocks(identification.data.equations).sum())
    why = _find_obstacle(identification, stretches)
    if why:
        return BootstrapValidation((), None, stretches, 0, 0, ValidationOutcome("not_evaluated", why))
    progress(0.0, "resampling blocks of time")
    # Shape constants are drawn together with the parameters: their errors are correlated.
    names, units, reduction, solution, statistics = _select_bootstrap_inputs(identification)
    result = bootstrap_estimates(reduction, solution, draws=draws, seed=seed)
    # Two sources let the ratio scatter: the deviation itself, known to 1 / sqrt(2 ν) of its value, and the finite
    # number of draws.
    error = 1.0 / np.sqrt(2.0 * draws)
    width = _TWICE * np.sqrt(1.0 / (2.0 * statistics.freedom) + error**2)
    computed = statistics.standard_deviations
    low = _compute_share_of_single_blocks(identification, reduction, solution, computed) / (1.0 + width)
    parameters = tuple(
        DrawnParameter(name, unit, *map(float, values))
        for name, unit, *values in zip(names, units, computed, result.deviations, low, 1.0 + width, strict=True)
    )
    judged = _judge_deviations(parameters, result, stretches)
    return BootstrapValidation(parameters, result.kind, stretches, draws, result.lost, judged)


def _compute_share_of_single_blocks(
    identification: Identification, reduction: Reduction, solution: Solution, computed: FloatArray
) -> FloatArray:
    """Return what is left of the computed deviations (c,) where no block depends on its neighbours, 1 at most."""
    kind = identification.choices.covariance
    if kind == "independent":
        return np.ones(len(computed))
    single = estimate_cluster_covariance(reduction, solution, kind).covariance
    deviations = np.sqrt(np.maximum(np.diag(single), 0.0))
    return np.minimum(np.divide(deviations, computed, out=np.ones_like(computed), where=computed > 0), 1.0)


def _find_obstacle(identification: Identification, stretches: int) -> str:
    """Return why the model cannot be drawn; "" where it can."""
    if not identification.choices.is_least_squares_of_torque:
        return (
            "The bootstrap needs parameters from least squares of the joint torques (the dynamic model, the "
            "strategy global, the estimators ols, wls and feasible)."
        )
    if identification.estimate.not_essential:
        return "Parameters were set to zero as not essential: validate the model before that step."
    if stretches < FEWEST_BLOCKS:
        return f"There are {stretches} blocks of time; the bootstrap needs at least {FEWEST_BLOCKS}."
    return ""


def _select_bootstrap_inputs(
    identification: Identification,
) -> tuple[list[str], list[str], Reduction, Solution, Statistics]:
    """Return names, units, data, estimate and statistics of what is drawn, shape constants behind the parameters."""
    estimate, data, model = identification.estimate, identification.data, identification.model
    names, units = [column.name for column in model.kept], [column.unit for column in model.kept]
    shapes = None
    if data.shaped is not None:
        shapes = linearise_shapes(model, estimate.solution, identification.choices.covariance, data.shaped)
    # Without shape constants to look at, or where the data do not tell them, the parameters alone are drawn.
    if shapes is None:
        return names, units, data.equations, estimate.solution, estimate.statistics
    for place in list_shape_variables(model.effects):
        joints = "+".join(model.effects[place.choice].joints)
        names.append(f"{'ln ' if place.search.in_octaves else ''}{place.spec.name}{' on ' + joints if joints else ''}")
        units.append("-" if place.search.in_octaves else place.spec.unit)
    return names, units, shapes.reduction, shapes.solution, shapes.statistics


def _judge_deviations(parameters: tuple[DrawnParameter, ...], result: Bootstrap, stretches: int) -> ValidationOutcome:
    how = "with Webb's weights for the residuals" if result.kind == "wild" else "with replacement"
    drawn = f"{result.draws} draws of {stretches} blocks of time {how}"
    # Lost draws are those with unlucky blocks. Leaving many of them out would make deviations look small.
    if result.lost > _MOST_LOST * result.draws:
        return ValidationOutcome(
            "not_evaluated",
            f"Of {drawn}, {result.lost} do not determine all parameters: only a few blocks contain information about "
            "some of them.",
        )
    outside = [parameter for parameter in parameters if parameter.outside]
    ratios = np.array([parameter.ratio for parameter in parameters])
    middle = (
        f"in {drawn} the standard deviations are {np.median(ratios):.2f} times those of the identification (median)"
    )
    if len(outside) <= _MOST_OUTSIDE * len(parameters):
        few = f"; the small number of blocks does not explain those of {_name_worst(outside)}" if outside else ""
        return ValidationOutcome("pass", f"{middle[0].upper()}{middle[1:]}{few}.{_word_unconfirmed(parameters)}")
    return ValidationOutcome(
        "fail",
        f"{middle[0].upper()}{middle[1:]}; {len(outside)} of {len(parameters)} differ by more than the small number "
        f"of blocks explains: {_name_worst(outside)}. Use their intervals with care.{_word_unconfirmed(parameters)}",
    )


def _word_unconfirmed(parameters: tuple[DrawnParameter, ...]) -> str:
    """Return a sentence on the deviations that draws of single blocks cannot confirm; "" if there are none."""
    small = [parameter for parameter in parameters if not parameter.outside and parameter.ratio < _CONFIRMED]
    if not small:
        return ""
    return (
        f" For {len(small)} of {len(parameters)} they are less than {_CONFIRMED:g} times: most of the computed "
        "variance comes from the dependence of neighbouring blocks, which draws of single blocks do not confirm: "
        f"{_name_worst(small)}."
    )


def _name_worst(outside: list[DrawnParameter]) -> str:
    # By the logarithm of the ratio, so that half as much and twice as much count alike.
    worst = sorted(outside, key=lambda parameter: -abs(np.log(max(parameter.ratio, 1e-9))))[:6]
    more = f" and {len(outside) - len(worst)} more" if len(outside) > len(worst) else ""
    return ", ".join(f"{parameter.name} ({parameter.ratio:.2f})" for parameter in worst) + more
