"""y = W χ: solvers and statistics on triangular factors. Knows nothing of robots."""

from dynident.estimation.correlation import correlation_factor, effective_rows
from dynident.estimation.essential import Elimination, EliminationPath, eliminate
from dynident.estimation.factors import EquationFactors, FactorAccumulator, Reduction, concatenate
from dynident.estimation.information import Information, known_values
from dynident.estimation.instrumental import InstrumentalSolution, instrumental
from dynident.estimation.least_squares import (
    Errors,
    EstimationError,
    Solution,
    condition_number,
    equilibrated_condition_number,
    errors,
    noise_levels,
    ordinary,
    share_of_measured,
    solve,
    weighted,
    weighted_factor,
)
from dynident.estimation.statistics import Statistics, statistics

__all__ = [
    "Elimination",
    "EliminationPath",
    "EquationFactors",
    "Errors",
    "EstimationError",
    "FactorAccumulator",
    "Information",
    "InstrumentalSolution",
    "Reduction",
    "Solution",
    "Statistics",
    "concatenate",
    "condition_number",
    "correlation_factor",
    "effective_rows",
    "eliminate",
    "equilibrated_condition_number",
    "errors",
    "instrumental",
    "known_values",
    "noise_levels",
    "ordinary",
    "share_of_measured",
    "solve",
    "statistics",
    "weighted",
    "weighted_factor",
]
