"""Measure the random torque that stands for what a model lacks, and how much recorded drift it covers.

Holds the lengths of blocks and the numbers of simulations that both need.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import ndtri, stdtrit

from dynident.array_types import FloatArray
from dynident.diagnosis import compare
from dynident.diagnosis.comparison.measured_against_predicted import Comparison
from dynident.errors import DynidentError
from dynident.export.feasible_links_and_joints import FeasibleLinks
from dynident.export.randomisation import HELD_ROLES, ModelDistribution, TorqueDisturbance
from dynident.identification import Identification
from dynident.identification.estimators.identified_robot_simulator import build_simulator
from dynident.parallel import single_threaded
from dynident.progress import Progress, ignore_progress
from dynident.recordings import Recording
from dynident.validation.open_loop_drift import read_driven_motions, simulate_open_loop

# Correlation times in s to choose from, and the two lengths of blocks whose means it compares.
_TIMES = np.geomspace(0.1, 10.0, 100)
_BLOCKS = (0.2, 1.0)
# Drawn models and starts of a simulated drift.
DRAWS, _STARTS = 20, 40
# Half width of the central 90 % of a normal distribution, in standard deviations that come from so many draws: the 95 %
# quantile of Student's distribution with 19 degrees of freedom.
CENTRAL_90 = 1.7291
# rad or m: what encoders and filters make of a standing joint's position. Smaller drift says nothing about the model.
_POSITION_NOISE = 3e-4


def measure_disturbance(
    identification: Identification, recordings: Sequence[Recording], *, nearest: bool = False
) -> TorqueDisturbance:
    """Return the disturbance that is as large and as slow as the residual along recordings.

    Its means over blocks of 0.2 s and of 1 s have the variance of those of the residual: the drift of a simulation
    depends on the slow part of a torque. It is wider the fewer independent spans the recordings are worth
    (`count_independent_spans`).

    Parameters
    ----------
    identification : Identification
        The identified model.
    recordings : sequence of Recording
        Recordings of the same robot that the model was not fitted to.
    nearest : bool
        As `build_distribution` takes it.

    Returns
    -------
    TorqueDisturbance
        The disturbance, for `build_distribution`.

    Raises
    ------
    DynidentError
        As `build_distribution` does, where no row of a recording is left after filtering, or no segment lasts 1 s.
    """
    # The residual of what draws consist of, which lacks the model's other effects.
    projected = FeasibleLinks.from_model(identification, HELD_ROLES, nearest=nearest).projected
    comparisons = [compare(projected, recording) for recording in recordings]
    blocks = [_compute_block_squares(comparisons, length) for length in _BLOCKS]
    short, long = (squares.mean(axis=0) for squares in blocks)
    ratios = _share_left(_BLOCKS[1] / _TIMES) / _share_left(_BLOCKS[0] / _TIMES)
    closest = np.abs(ratios[:, None] - long / np.maximum(short, 1e-300)).argmin(axis=0)
    time = _TIMES[closest]
    deviation = np.sqrt(short / _share_left(_BLOCKS[0] / time))
    seconds = sum(_measure_seconds(comparison) for comparison in comparisons)
    return TorqueDisturbance(widen_for_short_data(deviation, count_independent_spans(blocks[1], seconds / time)), time)


def count_independent_spans(squares: FloatArray, lengths: FloatArray) -> FloatArray:
    """Return how many independent spans (n,) a recording is worth that a standard deviation is estimated from.

    A residual that is larger in some motions than in others says less about its size in the next motion than one that
    is alike everywhere. The squares of its means over blocks then vary more than those of normal values, and are worth
    as many fewer (Satterthwaite 1946).

    Parameters
    ----------
    squares : (m, n)
        Squares of the residual's means over m blocks of a second.
    lengths : (n,)
        Lengths of the recording in correlation times.
    """
    m = len(squares)
    spans = np.minimum(lengths, m)
    if m < 2:
        return spans
    # One figure for all joints: they make the same motions, and few blocks tell little of each.
    # A joint whose torque was not recorded has no residual, and says nothing.
    means = squares.mean(axis=0)
    has_residual = means > 0
    if not has_residual.any():
        return spans
    variance = float(np.mean((squares[:, has_residual] / means[has_residual]).var(axis=0, ddof=1)))
    # For normal values alike everywhere the expected variance is 2 m / (m + 2), since the mean is theirs as well.
    return np.asarray(spans * min(1.0, 2.0 * m / (m + 2.0) / max(variance, 1e-300)))


def widen_for_short_data(deviation: FloatArray, spans: FloatArray) -> FloatArray:
    """Return deviations (n,) of normal values of which the central 90 % hold 90 % of further values.

    A variance out of a short recording is uncertain. It has about as many degrees of freedom as the recording has
    independent spans, and Student's distribution says how much that widens.

    Parameters
    ----------
    deviation : (n,)
        Estimated standard deviations.
    spans : (n,)
        Numbers of independent spans, as `count_independent_spans` returns them.
    """
    return np.asarray(deviation * stdtrit(np.maximum(spans, 1.0), _UPPER) / ndtri(_UPPER))


# Upper end of the central 90 %, as a probability.
_UPPER = 0.95


def _measure_seconds(comparison: Comparison) -> float:
    segments = np.unique(comparison.segment)
    return float(sum(np.ptp(comparison.t[comparison.segment == number]) for number in segments))


def _share_left(length: FloatArray) -> FloatArray:
    """Return the variance of a mean over so many correlation times, as a share of the variance of the process."""
    return np.asarray(2 * (length - 1 + np.exp(-length)) / length**2)


def _compute_block_squares(comparisons: Sequence[Comparison], length: float) -> FloatArray:
    """Return the squares (m, n) of the residual's means over blocks of so many seconds."""
    squares = []
    for comparison in comparisons:
        for segment in np.unique(comparison.segment):
            rows = comparison.segment == segment
            t, residual = comparison.t[rows], comparison.residual[rows]
            per_block = max(1, round(length / float(np.median(np.diff(t))))) if len(t) > 1 else 1
            count = len(t) // per_block
            blocks = residual[: count * per_block].reshape(count, per_block, residual.shape[1])
            squares.append(blocks.mean(axis=1) ** 2)
    if not sum(map(len, squares)):
        raise DynidentError(
            f"no segment of the recordings is {length:g} s long", pointer="recordings", title="Too short"
        )
    return np.concatenate(squares)


@single_threaded
def compute_drift_coverage(
    distribution: ModelDistribution,
    identification: Identification,
    recordings: Sequence[Recording],
    horizons: tuple[float, ...] = (0.1, 0.5, 2.0),
    *,
    nearest: bool = False,
    progress: Progress = ignore_progress,
) -> FloatArray:
    """Return how often (h, n) the central 90 % of simulated drift contain the recorded one; NaN where none is as long.

    Drawn models with a drawn disturbance start from recorded states and move under the recorded torque, as in
    `validation.compute_open_loop_drift`.

    Parameters
    ----------
    distribution : ModelDistribution
        The distribution to judge.
    identification : Identification
        The model that it is of.
    recordings : sequence of Recording
        Recordings that neither the model nor the disturbance was fitted to.
    horizons : tuple of float
        Seconds after which the drift is compared.
    nearest : bool
        As `build_distribution` took it.
    progress : Progress
        Called with the fraction done and a message.
    """
    links = FeasibleLinks.from_model(identification, HELD_ROLES, nearest=nearest)
    ratios = _simulate_drift(distribution, links, recordings, horizons, progress)
    missing = np.isnan(ratios)
    inside = np.where(missing, 0.0, ratios <= CENTRAL_90).sum(axis=0)
    count = (~missing).sum(axis=0)
    return np.asarray(np.where(count > 0, inside / np.maximum(count, 1), np.nan))


def _simulate_drift(
    distribution: ModelDistribution,
    links: FeasibleLinks,
    recordings: Sequence[Recording],
    horizons: tuple[float, ...],
    progress: Progress,
) -> FloatArray:
    """Return how far (s, h, n) recorded positions are from the middle of simulated ones, in standard deviations."""
    projected, n = links.projected, len(distribution.disturbance.deviation)
    motions = read_driven_motions(projected, recordings)
    parameters = distribution.draw_base_parameters(DRAWS, seed=1)
    off = []
    for number, values in enumerate(parameters):
        progress(number / DRAWS, "simulating drawn models")
        disturbed = []
        for place, motion in enumerate(motions):
            t = motion.reference.t
            period = float(np.median(np.diff(t)))
            steps = round((t[-1] - t[0]) / period) + 2
            torque = distribution.disturbance.draw(1, steps, period, seed=len(motions) * number + place)[0]
            grid = t[0] + period * np.arange(steps)
            extra = np.column_stack([np.interp(t, grid, torque[:, j]) for j in range(n)])
            disturbed.append(replace(motion, tau=motion.tau + extra))
        outcome = simulate_open_loop(build_simulator(projected.model, values), disturbed, horizons, _STARTS)
        if outcome is None:
            raise DynidentError(
                f"no segment of the recordings is {horizons[0]:g} s long", pointer="/windows", title="Too short"
            )
        off.append(outcome[0])
    # A draw that diverged says nothing about the others' spread.
    drift = np.where(np.isfinite(off), off, np.nan)
    some = np.isfinite(drift).sum(axis=0) > 1
    filled = np.where(some, drift, 0.0)
    spread = np.hypot(np.nanstd(filled, axis=0, ddof=1), _POSITION_NOISE)
    # The middle is known from few draws only.
    return np.asarray(np.where(some, np.abs(np.nanmean(filled, axis=0)) / (spread * np.sqrt(1 + 1 / DRAWS)), np.nan))
