"""Correlated residuals: by what factor they overstate the number of rows, also pooled over equations.

Covariances are in `parameter_covariance`, autocorrelation figures in diagnosis/comparison/.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynident.array_types import FloatArray
from dynident.estimation.prior_information import Solution
from dynident.estimation.qr_decomposition import WhitenedColumns, compute_r_factor, whiten_columns
from dynident.estimation.residual_errors import compute_residual_noise
from dynident.estimation.triangular_factors import EquationFactors, Reduction

FEWEST_BLOCKS = 5
"""Smallest number of blocks of time: with fewer chance decides how large the scores are, and how estimates scatter."""

# Neighbouring blocks depend on each other where their products' sum is so many standard deviations above zero: of
# independent ones one in forty are joined, which costs degrees of freedom alone.
_BEYOND_CHANCE = 2.0


def compute_correlation_factors(
    reduction: Reduction, solution: Solution, joined: Reduction | None = None
) -> FloatArray:
    """Return by how much the rows of every equation overstate the information in them.

    Parameters
    ----------
    reduction, solution : Reduction, Solution
        The equations, and the estimate whose residuals are taken, with the weights that it was fitted with.
    joined : Reduction, optional
        The same rows in independent blocks; without it, blocks that depend on each other are joined.

    Returns
    -------
    (n,) array
        Numbers of rows over numbers of independent samples, at least 1; 1 where there are too few blocks or rows to
        tell.
    """
    joined = join_dependent_blocks(reduction, solution) if joined is None else joined
    fits = select_fits(joined, solution)
    return np.array(
        [compute_correlation_factor(e, solution.values, fit) for e, fit in zip(joined.equations, fits, strict=True)]
    )


def find_equations_in_few_blocks(reduction: Reduction) -> list[int]:
    """Return the numbers of equations whose rows count as independent, as they lie in too few blocks to tell.

    Only beside others that have enough: the statistics of fewer blocks altogether are pooled.

    Parameters
    ----------
    reduction : Reduction
        The equations.
    """
    blocks = [int(np.count_nonzero(equation.counts)) for equation in reduction.equations]
    has_enough = max(blocks, default=0) >= FEWEST_BLOCKS
    return [k for k, count in enumerate(blocks) if has_enough and 0 < count < FEWEST_BLOCKS]


def count_effective_rows(reduction: Reduction, solution: Solution) -> FloatArray:
    """Return how many independent samples the rows of every equation are worth.

    Parameters
    ----------
    reduction, solution : Reduction, Solution
        As `compute_correlation_factors` takes them.

    Returns
    -------
    (n,) array
        Effective numbers of rows, at most the numbers of rows.
    """
    return reduction.row_counts / compute_correlation_factors(reduction, solution)


def select_fits(reduction: Reduction, solution: Solution) -> list[FloatArray]:
    """Return how a fit to all equations depends on each equation's rows.

    Parameters
    ----------
    reduction, solution : Reduction, Solution
        The data and the estimate from it.

    Returns
    -------
    n of (p_j, p_j)
        M = 2 B / s² - C / σ², with B = `solution.normal_inverse`, C the covariance of the estimates for independent
        rows, s the noise that the equation was weighted by and σ that of its residuals. Independent rows leave the
        scores of blocks with the covariance σ² (δ A_s - A_s M A_t). Where weights are the noise, M is C / σ².
    """
    own = compute_residual_noise(reduction, solution.values)
    bread, covariance = solution.normal_inverse, compute_sandwich_covariance(reduction, solution, np.ones(len(own)))
    fits = []
    for equation, weighted, sigma in zip(reduction.equations, solution.noise, own, strict=True):
        place = np.ix_(equation.columns, equation.columns)
        share = bread[place] / weighted**2
        # A residual of zero says nothing of how the fit depends on it.
        fits.append(2.0 * share - covariance[place] / sigma**2 if sigma > 0 else share)
    return fits


def compute_sandwich_covariance(reduction: Reduction, solution: Solution, inflation: FloatArray) -> FloatArray:
    """Return the covariance (c, c) of estimates from rows of which each equation's overstate the information.

    Parameters
    ----------
    reduction, solution : Reduction, Solution
        The data and the estimate from it.
    inflation : (n,)
        Number of rows over number of independent samples of each equation.
    """
    # B (Σ σⱼ² inflationⱼ WⱼᵀWⱼ) B. It is [12.8] where the weights are the true noise.
    bread = solution.normal_inverse
    meat = np.zeros((reduction.n_columns, reduction.n_columns))
    weights = compute_residual_noise(reduction, solution.values) ** 2 * inflation / solution.noise**4
    for equation, weight in zip(reduction.equations, weights, strict=True):
        w = equation.whole_factor[:, :-1]
        meat[np.ix_(equation.columns, equation.columns)] += weight * (w.T @ w)
    if solution.known is not None:
        # Rows of prior knowledge are in units of their own deviation, so their variance is one.
        meat += solution.known.factor.T @ solution.known.factor
    covariance = bread @ meat @ bread
    # Rounding leaves the product slightly asymmetric.
    return np.asarray(0.5 * (covariance + covariance.T))


def compute_correlation_factor(equation: EquationFactors, values: FloatArray, fit: FloatArray) -> float:
    """Return by how much the rows of one equation overstate the information in them, at least 1.

    Parameters
    ----------
    equation : EquationFactors
        The rows of one equation, by blocks of time.
    values : (c,)
        Parameters χ at which the residuals are taken.
    fit : (p, p)
        Covariance M of this equation's parameters in the fit that the residuals are of, over the variance σ² of its
        rows: A⁻¹ for a fit to these rows alone.

    Returns
    -------
    float
        Number of rows over number of independent samples; 1 where there are too few blocks or rows to tell.

    Notes
    -----
    With g_s = W_sᵀρ_s the score of block s and A = WᵀW: Σ g_sᵀ A⁻¹ g_s over what it would be for independent
    residuals of the same size, σ² (p - Σ tr(A⁻¹A_s M A_s)); the second term is what the fit itself removes. Joints
    share most of their parameters, so that a fit to all joints removes much less of each than one to its rows alone.
    """
    rows = float(equation.counts.sum())
    if not _is_determined(equation.factors[:, :, :-1], rows):
        return 1.0
    # Residuals of the factors, not of the rows: Wᵀρ and ρᵀρ of a block are the same for both.
    return _compute_overstatement_of_whitened(equation.whitened_columns, compute_rests(equation, values), rows, fit)


def compute_rests(equation: EquationFactors, values: FloatArray) -> FloatArray:
    """Return the residuals of the factors of each block.

    Parameters
    ----------
    equation : EquationFactors
        The rows of one equation, by blocks of time.
    values : (c,)
        Parameters χ.

    Returns
    -------
    (s, m) array
        W_sᵀρ_s and ρ_sᵀρ_s are those of the rows.
    """
    return np.asarray(equation.factors[:, :, -1] - equation.factors[:, :, :-1] @ values[equation.columns])


def compute_scores(columns: FloatArray, rests: FloatArray) -> FloatArray:
    """Return the scores of the blocks of an equation.

    Parameters
    ----------
    columns, rests : (s, m, p), (s, m)
        Columns of W or of the instruments, and ρ, in each of s blocks.

    Returns
    -------
    (s, p) array
        Columns times ρ.
    """
    return np.asarray((rests[:, None, :] @ columns)[:, 0])


def count_correlation_freedoms(reduction: Reduction, solution: Solution) -> FloatArray:
    """Return the degrees of freedom (n,) with which the factors of `compute_correlation_factors` are known.

    Parameters
    ----------
    reduction, solution : Reduction, Solution
        As `compute_correlation_factors` takes them.
    """
    joined = join_dependent_blocks(reduction, solution)
    fits = select_fits(joined, solution)
    return np.array([count_correlation_freedom(e, fit) for e, fit in zip(joined.equations, fits, strict=True)])


def count_correlation_freedom(equation: EquationFactors, fit: FloatArray) -> float:
    """Return the degrees of freedom with which an equation's correlation factor is known, at least 1.

    Parameters
    ----------
    equation : EquationFactors
        The rows of one equation, by blocks of time.
    fit : (p, p)
        Covariance of its parameters as `compute_correlation_factor` takes it.

    Returns
    -------
    float
        (tr Ω)² / tr Ω² (Satterthwaite), Ω the form in the residuals that the sum of the scores' squares is; 1 where
        there are too few blocks or rows to tell.
    """
    columns = equation.whitened_columns
    if columns is None or not _is_determined(equation.factors[:, :, :-1], float(equation.counts.sum())):
        return 1.0
    grams = columns.grams
    # The residuals are those of a fit, which takes its own part out of every block's score: of blocks s and t together
    # these are δ G_s - G_s M G_t.
    taken = grams @ grams @ columns.express_fit(fit)
    overlap = taken.sum(axis=0)
    trace = columns.count - float(np.trace(overlap))
    cubes, crossed = float(np.sum(taken * grams)), float(np.sum(overlap * overlap.T))
    spread = float(np.trace(columns.squares))
    return max(1.0, trace**2 / max(spread - 2.0 * cubes + crossed, np.finfo(float).tiny))


def pool_correlation_factors(own: FloatArray, freedom: FloatArray, of_noise: float) -> FloatArray:
    """Return the correlation factors of equations as all of them together tell: nearer to their mean, and to noise.

    Factors from a dozen blocks of time are by chance up to twice too large or too small. What a model leaves that lacks
    nothing is white noise behind the filters, whose factor is known. The mean of the logarithms keeps what it has above
    that beyond chance, and each equation what it has beside the mean.

    Parameters
    ----------
    own, freedom : (n,), (n,)
        Factor of each equation, and the degrees of freedom that it is known with.
    of_noise : float
        Factor of white noise behind the filters.

    Returns
    -------
    (n,) array
        The factors.
    """
    logarithms, variances, weights = _weigh_factors(own, freedom)
    # No residual is whiter than the noise in it.
    above = max(float(logarithms.mean() - np.log(of_noise)), 0.0)
    excess = _compute_shares_beyond_chance(np.array([above]), variances.mean(keepdims=True) / len(own)) * above
    return np.asarray(of_noise * np.exp(excess - logarithms.mean() + weights @ logarithms))


def count_pooled_freedom(own: FloatArray, freedom: FloatArray) -> float:
    """Return the degrees of freedom of the worst known of the factors that `pool_correlation_factors` makes of these.

    What is known of noise does not count.

    Parameters
    ----------
    own, freedom : (n,), (n,)
        As `pool_correlation_factors` takes them.
    """
    if not len(own):
        return 1.0
    _, variances, weights = _weigh_factors(own, freedom)
    return float(2.0 / (weights**2 @ variances).max())


def _weigh_factors(own: FloatArray, freedom: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return logarithms (n,) of factors, their variances by chance, and weights (n, n) that draw them to their mean."""
    # The variance of the logarithm of a mean square is 2 over its degrees of freedom.
    logarithms, variances, n = np.log(own), 2.0 / freedom, len(own)
    # The mean is of the same values, so that a mean square about it is too small by one part in n.
    away = np.sqrt(n / max(n - 1, 1)) * (logarithms - logarithms.mean())
    shares = _compute_shares_beyond_chance(away, variances)
    return logarithms, variances, np.diag(shares) + (1.0 - shares)[:, None] / n


def _compute_shares_beyond_chance(away: FloatArray, variances: FloatArray) -> FloatArray:
    """Return the shares (n,) of distances from a centre to keep (empirical Bayes; Efron and Morris 1975).

    The true distances have as large a variance as the mean square has beyond that of chance.
    """
    between = max(float(np.mean(away**2 - variances)), 0.0)
    return np.asarray(between / (between + variances))


def compute_overstatement(
    w: FloatArray, rests: FloatArray, rows: float, fit: FloatArray, observed: FloatArray
) -> float:
    """Return the correlation factor of columns and residuals, as `compute_correlation_factor` does.

    Parameters
    ----------
    w : (s, m, p)
        Columns of s blocks: of W, or of the instruments.
    rests : (s, m)
        Residuals in the same rows.
    rows : float
        Number of rows that they stand for together.
    fit : (k, k)
        Covariance of the parameters in the fit, over the variance of the rows.
    observed : (s, m, k)
        Columns of W, which the fit's parameters belong to.

    Returns
    -------
    float
        At least 1.
    """
    if not _is_determined(w, rows):
        return 1.0
    columns = whiten_columns(w, compute_r_factor(w.reshape(-1, w.shape[2])), observed)
    return _compute_overstatement_of_whitened(columns, rests, rows, fit)


def _is_determined(w: FloatArray, rows: float) -> bool:
    n_blocks, _, k = w.shape
    return bool(n_blocks >= FEWEST_BLOCKS and k > 0 and rows > k)


def _compute_overstatement_of_whitened(
    columns: WhitenedColumns | None, rests: FloatArray, rows: float, fit: FloatArray
) -> float:
    if columns is None:
        return 1.0
    share = columns.express_fit(fit)
    variance = float(np.sum(rests * rests)) / max(rows - float(np.trace(share)), 1.0)
    expected = variance * (columns.count - float(np.sum(share * columns.squares)))
    # A fit that leaves nothing of the scores to judge by is judged by its own part alone, or not at all.
    if expected <= 0:
        expected = variance * (columns.count - float(np.trace(columns.squares)))
    if expected <= 0 or variance == 0:
        return 1.0
    # With whitened columns A is one, so that the score's weighted square is a plain sum of squares.
    scores = columns.compute_scores(rests)
    # Below one would mean that rows hold more than their own number of samples: it is chance, and is not used.
    return float(max(1.0, np.sum(scores * scores) / expected))


def join_dependent_blocks(reduction: Reduction, solution: Solution) -> Reduction:
    """Join blocks of time in pairs, and again, while the residuals of neighbouring blocks depend on each other.

    All statistics over blocks take these for independent. Slow residuals, of a motor that warms up or a cable that
    drags, last for longer than a block.

    Parameters
    ----------
    reduction, solution : Reduction, Solution
        The data and the estimate from it.

    Returns
    -------
    Reduction
        At least five blocks; the same data where neighbours do not depend on each other.
    """
    while reduction.n_blocks >= 2 * FEWEST_BLOCKS - 1 and _do_neighbours_depend(reduction, solution):
        reduction = reduction.merge_block_pairs()
    return reduction


def _do_neighbours_depend(reduction: Reduction, solution: Solution) -> bool:
    """Return whether the scores of neighbouring blocks agree in sign by more than chance explains.

    Products u_sᵀu_{s+1} of neighbours' scores, each equation in units of its own, have the mean zero and are themselves
    uncorrelated where blocks are independent. What the fit takes out, -Σ tr(G_s M G_{s+1}), is added again.
    """
    products = np.zeros(max(reduction.n_blocks - 1, 0))
    for equation, fit in zip(reduction.equations, select_fits(reduction, solution), strict=True):
        columns = equation.whitened_columns if len(equation.counts) > 1 else None
        if columns is None:
            continue
        share = columns.express_fit(fit)
        scores = columns.compute_scores(compute_rests(equation, solution.values))
        variance = float(np.sum(scores * scores)) / max(columns.count - float(np.sum(share * columns.squares)), 1.0)
        if variance > 0:
            # Of a block without rows it takes nothing.
            pairs = np.flatnonzero((equation.counts[:-1] > 0) & (equation.counts[1:] > 0))
            left_out = float(np.sum(share * columns.sum_products[1])) / max(len(pairs), 1)
            products[pairs] += np.sum(scores[pairs] * scores[pairs + 1], axis=1) / variance + left_out
    return bool(products.sum() > _BEYOND_CHANCE * np.linalg.norm(products)) if products.any() else False


_MOST_CORRELATED = 0.9
"""Largest correlation of neighbouring blocks that counts: with a larger one, a recording is too short to tell."""


def widen_for_neighbours(covariance: FloatArray, followed: Sequence[FloatArray], directions: FloatArray) -> FloatArray:
    """Return a covariance (f, f) widened by what neighbouring blocks that depend on each other add to it.

    Parameters
    ----------
    covariance : (f, f)
        For independent blocks, in coordinates in which the information is one.
    followed : sequence of (s, f)
        How far the estimates move without each block, one block after the other, in the same coordinates; those of
        equations whose blocks do not depend on each other apart.
    directions : (c, f)
        Each parameter as a linear form of unit length (zero for one that is held).

    Notes
    -----
    Blocks are joined while neighbours depend on each other over all parameters together. That is too early for a few
    slow ones, such as offsets, so variances grow direction by direction. The directions are orthonormal and as close to
    the parameters' own as they can be (polar decomposition; Löwdin 1950): neither the order of parameters nor their
    units matter. With each parameter's own direction instead, parameters that are hard to tell apart grow differently,
    and the deviation of a torque that they predict together was 0.4 to 5.7 times as large (six joints). In the
    principal axes of the steps a constant has no direction of its own. Without blocks that are joined, growth alone
    left other parameters too sure.
    """
    turned, _, parameters = np.linalg.svd(directions.T, full_matrices=False)
    axes = turned @ parameters
    growth = compute_neighbour_growth([steps @ axes for steps in followed])
    grow = (axes * np.sqrt(growth)) @ axes.T
    return np.asarray(grow @ covariance @ grow)


def compute_neighbour_growth(followed: Sequence[FloatArray]) -> FloatArray:
    """Return by how much neighbouring blocks that depend on each other raise the variances (f,) of steps.

    Slow residuals (a motor that warms up, a cable that drags) last for longer than a block. The steps count as a
    first-order autoregressive process with the correlation ρ: the variance of their sum is larger by (1 + ρ) / (1 - ρ).

    Parameters
    ----------
    followed : sequence of (s, f)
        Steps in f directions, as `widen_for_neighbours` takes them.
    """
    count = max(sum(map(len, followed)), 1)
    products = np.sum([np.sum(steps[1:] * steps[:-1], axis=0) for steps in followed], axis=0)
    squares = np.sum([np.sum(steps**2, axis=0) for steps in followed], axis=0)
    # The fit takes its own part out of the steps: of independent ones the correlation is -1 / m in the mean.
    correlation = np.divide(products, squares, out=np.zeros_like(squares), where=squares > 0) + 1.0 / count
    # A variance of 1 / m is chance, which is taken off (James and Stein).
    chance = np.divide(1.0, count * correlation, out=np.full_like(correlation, np.inf), where=correlation > 0)
    rho = np.clip(correlation - chance, 0.0, _MOST_CORRELATED)
    return np.asarray((1.0 + rho) / (1.0 - rho))


def count_growth_worth(after: FloatArray, before: FloatArray) -> FloatArray:
    """Return the share of the degrees of freedom that is left where variances grew from `before` to `after`.

    Of a first-order autoregressive process, m samples are worth m (1 - ρ²) / (1 + ρ²) in a variance.

    Parameters
    ----------
    after, before : (c,)
        Variances with what `widen_for_neighbours` adds, and without.
    """
    growth = np.divide(after, before, out=np.ones_like(after), where=before > 0)
    return np.asarray(2.0 * growth / (1.0 + growth**2))
