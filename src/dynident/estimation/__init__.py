"""y = W χ: solvers and statistics on triangular factors. Knows nothing of robots."""

from dynident.estimation.factors import EquationFactors, FactorAccumulator, Reduction, concatenate
from dynident.estimation.least_squares import (
    Errors,
    EstimationError,
    Solution,
    errors,
    noise_levels,
    ordinary,
    solve,
    weighted,
    weighted_factor,
)
from dynident.estimation.statistics import Statistics, correlation_factor, statistics

__all__ = [
    "EquationFactors",
    "Errors",
    "EstimationError",
    "FactorAccumulator",
    "Reduction",
    "Solution",
    "Statistics",
    "concatenate",
    "correlation_factor",
    "errors",
    "noise_levels",
    "ordinary",
    "solve",
    "statistics",
    "weighted",
    "weighted_factor",
]
