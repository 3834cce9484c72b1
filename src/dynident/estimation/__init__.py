"""Solvers and statistics of Y = W χ + ρ on triangular factors; knows nothing of robots."""

from dynident.estimation.backward_elimination import Elimination, EliminationPath, eliminate_parameters
from dynident.estimation.block_bootstrap import Bootstrap, Drawing, bootstrap_estimates
from dynident.estimation.instrumental_variables import InstrumentalSolution, solve_instrumental
from dynident.estimation.least_squares import (
    EstimationError,
    build_weighted_factor,
    compute_noise_levels,
    compute_row_noise,
    describe_fit,
    solve,
    solve_ordinary,
    solve_weighted,
)
from dynident.estimation.outlying_spans import OutlyingSpan, OutlyingSpans, find_outlying_spans
from dynident.estimation.parameter_correlation import compute_condition_number, compute_equilibrated_condition_number
from dynident.estimation.parameter_covariance import (
    CovarianceName,
    Statistics,
    compute_pooled_statistics,
    compute_row_freedom,
    statistics,
)
from dynident.estimation.prior_information import PriorInformation, Solution, build_prior
from dynident.estimation.residual_correlation import compute_correlation_factor, count_effective_rows
from dynident.estimation.residual_errors import (
    Errors,
    ErrorsByGroup,
    compute_errors,
    compute_errors_by_group,
    compute_relative_change,
)
from dynident.estimation.row_groups import (
    BlockRows,
    IntervalRowAccumulator,
    IntervalRows,
    RowGroup,
    SeparateRows,
    WeightedRows,
    compute_band_distance,
)
from dynident.estimation.row_weights import estimate_group_weights
from dynident.estimation.shape_constant_uncertainty import LinearisedSolution, linearise_constants
from dynident.estimation.triangular_factors import (
    EquationFactors,
    FactorAccumulator,
    Reduction,
    concatenate_reductions,
    merge_row_groups,
)

__all__ = [
    "BlockRows",
    "Bootstrap",
    "CovarianceName",
    "Drawing",
    "Elimination",
    "EliminationPath",
    "EquationFactors",
    "Errors",
    "ErrorsByGroup",
    "EstimationError",
    "FactorAccumulator",
    "InstrumentalSolution",
    "IntervalRowAccumulator",
    "IntervalRows",
    "LinearisedSolution",
    "OutlyingSpan",
    "OutlyingSpans",
    "PriorInformation",
    "Reduction",
    "RowGroup",
    "SeparateRows",
    "Solution",
    "Statistics",
    "WeightedRows",
    "bootstrap_estimates",
    "build_prior",
    "build_weighted_factor",
    "compute_band_distance",
    "compute_condition_number",
    "compute_correlation_factor",
    "compute_equilibrated_condition_number",
    "compute_errors",
    "compute_errors_by_group",
    "compute_noise_levels",
    "compute_pooled_statistics",
    "compute_relative_change",
    "compute_row_freedom",
    "compute_row_noise",
    "concatenate_reductions",
    "count_effective_rows",
    "describe_fit",
    "eliminate_parameters",
    "estimate_group_weights",
    "find_outlying_spans",
    "linearise_constants",
    "merge_row_groups",
    "solve",
    "solve_instrumental",
    "solve_ordinary",
    "solve_weighted",
    "statistics",
]
