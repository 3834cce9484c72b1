"""y = W χ: solvers and statistics on triangular factors. Knows nothing of robots."""

from dynident.estimation.beside import Apart, Beside, BesideAccumulator, distance_to_band
from dynident.estimation.bootstrap import Bootstrap, Drawing, bootstrap
from dynident.estimation.correlation import correlation_factor, effective_rows
from dynident.estimation.essential import Elimination, EliminationPath, eliminate
from dynident.estimation.factors import EquationFactors, FactorAccumulator, Reduction, concatenate, told_apart
from dynident.estimation.information import Information, known_values
from dynident.estimation.instrumental import InstrumentalSolution, instrumental
from dynident.estimation.least_squares import (
    Errors,
    EstimationError,
    Solution,
    condition_number,
    equilibrated_condition_number,
    errors,
    moving_errors,
    noise_levels,
    noise_of_rows,
    ordinary,
    share_of_measured,
    solve,
    weighted,
    weighted_factor,
)
from dynident.estimation.linearised import Linearised, linearised
from dynident.estimation.outlying_spans import OutlyingSpan, OutlyingSpans, find_outlying_spans
from dynident.estimation.statistics import CovarianceName, Statistics, freedom_of_rows, statistics
from dynident.estimation.turned import Turned
from dynident.estimation.turning_noise import turning_weights

__all__ = [
    "Apart",
    "Beside",
    "BesideAccumulator",
    "Bootstrap",
    "CovarianceName",
    "Drawing",
    "Elimination",
    "EliminationPath",
    "EquationFactors",
    "Errors",
    "EstimationError",
    "FactorAccumulator",
    "Information",
    "InstrumentalSolution",
    "Linearised",
    "OutlyingSpan",
    "OutlyingSpans",
    "Reduction",
    "Solution",
    "Statistics",
    "Turned",
    "bootstrap",
    "concatenate",
    "condition_number",
    "correlation_factor",
    "distance_to_band",
    "effective_rows",
    "eliminate",
    "equilibrated_condition_number",
    "errors",
    "find_outlying_spans",
    "freedom_of_rows",
    "instrumental",
    "known_values",
    "linearised",
    "moving_errors",
    "noise_levels",
    "noise_of_rows",
    "ordinary",
    "share_of_measured",
    "solve",
    "statistics",
    "told_apart",
    "turning_weights",
    "weighted",
    "weighted_factor",
]
