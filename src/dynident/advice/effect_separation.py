"""Compute how far recorded data, or a rehearsed motion, tell two effects apart (their separation).

Holds how many samples are taken from the data and from a motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynident.advice.discriminating_experiments import Separation
from dynident.array_types import FloatArray, IndexArray
from dynident.diagnosis.comparison.measured_against_predicted import Comparison
from dynident.estimation.least_squares import floor_noise
from dynident.estimation.residual_correlation import compute_overstatement
from dynident.excitation import Rehearsal
from dynident.excitation.criteria.parameter_variances import compute_diagonal_from_information
from dynident.excitation.design_observation_matrix import DesignModel
from dynident.excitation.experiments.design_task import STANDSTILL_VELOCITY
from dynident.motion.joint_trajectories import Motion
from dynident.recordings import Recording
from dynident.recordings.joint_phases import Phase
from dynident.regressors.model_structure import is_in_run

_MOST_ROWS = 1500
"""Samples that a matrix of inner products is made from: beyond them only its precision grows, not what it says."""

_MOST_DATA_ROWS = 5000
"""Samples of the data at hand: how residuals hang together is seen in neighbours alone, so these are thinned later."""

# Intervals over which correlated residuals are summed: a twentieth of the data, within these seconds.
_WINDOWS, _SHORTEST, _LONGEST = 20, 0.25, 2.0
_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Normal equations in units of the noise: what rows of data tell about the parameters.

    Parameters
    ----------
    matrix : (b, b)
        WᵀW with rows in units of the noise.
    right : (b,)
        Wᵀρ with the residual ρ in units of the noise.
    """

    matrix: FloatArray
    right: FloatArray

    def __add__(self, other: NormalEquations) -> NormalEquations:
        return NormalEquations(self.matrix + other.matrix, self.right + other.right)


@dataclass(frozen=True, eq=False)
class DataRows:
    """Data at hand beside a model with more effects, thinned.

    Parameters
    ----------
    w : (m, n, b)
        Columns of the parameters by sample and joint; zero where a joint stands.
    residual : (m, n)
        Residual of the model without the effects in question, N m or N; zero where a joint stands.
    counts : (n,)
        Number of rows in which each joint moves.
    n_rows : int
        Number of rows of data that these stand for.
    window_rows : int
        Number of consecutive rows that belong together, because their residuals are correlated.
    borders : tuple of int
        Indices of the rows at which recordings begin and end.
    """

    w: FloatArray
    residual: FloatArray
    counts: FloatArray
    n_rows: int
    window_rows: int
    borders: tuple[int, ...]

    @property
    def share(self) -> float:
        """Rows of data that one of these stands for."""
        return self.n_rows / max(len(self.w), 1)

    def compute_normal_equations(self, row_weights: FloatArray) -> NormalEquations:
        """Return the normal equations of these rows.

        Parameters
        ----------
        row_weights : (n,)
            One over the noise of a row of data, by joint.

        Returns
        -------
        NormalEquations
            The equations of all joints together.
        """
        # A thinned row stands for several, so its weight grows with the root of their number.
        weights = row_weights * np.sqrt(self.share)
        weighted = (self.w * weights[:, None]).reshape(-1, self.w.shape[2])
        return NormalEquations(weighted.T @ weighted, weighted.T @ (self.residual * weights).reshape(-1))

    def to_earlier_rows(self, n_rows: float) -> FloatArray:
        """Return rows (b n, b), joint after joint, that stand for these beside W / √N of `n_rows` of an experiment.

        Parameters
        ----------
        n_rows : float
            Number N of rows of the experiment.
        """
        # The triangular factor of a joint's rows has the same normal equations as the rows themselves, in b rows
        # instead of m.
        factors = [np.linalg.qr(self.w[:, j], mode="r") for j in range(self.w.shape[1])]
        most = max(len(factor) for factor in factors)
        padded = [np.pad(factor, ((0, most - len(factor)), (0, 0))) for factor in factors]
        stacked: FloatArray = np.stack(padded, axis=1).reshape(-1, self.w.shape[2])
        return stacked * float(np.sqrt(self.share / n_rows))


def evaluate_data_rows(
    model: DesignModel, comparisons: Sequence[Comparison], recordings: Sequence[Recording] = ()
) -> DataRows:
    """Evaluate the columns of a model on the data at hand, thinned to `_MOST_DATA_ROWS`.

    Parameters
    ----------
    model : DesignModel
        Model with the effects in question.
    comparisons : sequence of Comparison
        The data at hand, each with the residual of the identified model.
    recordings : sequence of Recording, optional
        Those of the comparisons: an effect of some runs is then active in these alone, without them in all.

    Returns
    -------
    DataRows
        The columns, and the residual that they have to explain.
    """
    total = sum(len(comparison.t) for comparison in comparisons)
    # Division rounded up, so that no more rows are left than allowed.
    every = max(1, -(-total // _MOST_DATA_ROWS))
    w, residual, borders, seconds, step = [], [], [0], 0.0, 1.0
    n, b = model.robot.n, model.n_parameters
    counts = np.zeros(n)
    for number, comparison in enumerate(comparisons):
        if len(comparison.t) < 2:
            continue
        step = float(np.median(np.diff(comparison.t)))
        seconds += step * len(comparison.t)
        # The columns of elastic gears need the derivative of the acceleration, which recordings do not have.
        jerk = np.gradient(comparison.ddq, step, axis=0)
        motion = Motion(
            step * np.arange(len(comparison.t), dtype=np.float64), comparison.q, comparison.dq, comparison.ddq, jerk
        )
        samples = np.arange(0, len(comparison.t), every)
        runs = _evaluate_run_signals(model, comparison.segment[samples], recordings[number]) if recordings else None
        # As in a fit: the equation of a joint that stands tells nothing but that friction is enough to hold it.
        moves = comparison.phase[samples] != Phase.STANDING
        w.append(model.observe_along(motion, samples, runs).reshape(len(samples), n, b) * moves[:, :, None])
        residual.append(comparison.residual[samples] * moves)
        counts += moves.sum(axis=0)
        borders.append(borders[-1] + len(samples))
    # A block has to be longer than residuals are correlated, and there have to be enough blocks to estimate a variance.
    window_rows = max(1, round(float(np.clip(seconds / _WINDOWS, _SHORTEST, _LONGEST)) / (step * every)))
    return DataRows(np.concatenate(w), np.concatenate(residual), counts, total, window_rows, tuple(borders))


def _evaluate_run_signals(model: DesignModel, segments: FloatArray, recording: Recording) -> FloatArray:
    """Return (m, number of run signals): 1 where a row of these segments (m,) belongs to the signal's runs."""
    signals = model.observation.runs
    known = {
        int(segment): [is_in_run(signal, recording, int(segment)) for signal in signals]
        for segment in np.unique(segments)
    }
    return np.array([known[int(segment)] for segment in segments]).reshape(len(segments), len(signals))


def compute_row_weights(rows: DataRows) -> FloatArray:
    """Return one over the noise that every row would have if rows were independent of each other.

    The noise is what is left once all effects of the model are fitted, those in doubt included: an effect that is
    missing must not count as noise of the experiment that is to show it.

    Parameters
    ----------
    rows : DataRows
        Data at hand beside the model with all effects in question.

    Returns
    -------
    (n,)
        Weight of a row of each joint.
    """
    n, b = rows.w.shape[1:]
    # Each joint pays for its part of the parameters; the bound of one keeps a joint that hardly moved from a negative
    # number.
    freedom = np.maximum(rows.counts - b / n, 1.0)
    noise = floor_noise(np.sqrt((rows.residual**2).sum(axis=0) / freedom))
    rest = rows.residual
    # Weighted least squares by iteration: the fit depends on the joints' noise, and the noise on the residual of the
    # fit.
    for _ in range(_ROUNDS):
        known = rows.compute_normal_equations(1.0 / noise)
        rest = rows.residual - rows.w @ _solve_scaled(known.matrix, known.right)
        noise = floor_noise(np.sqrt((rest**2).sum(axis=0) / freedom))
    inverse = _solve_scaled(known.matrix, np.eye(b))
    overstated = np.array([_compute_overstatement(rows, rest, j, inverse / noise[j] ** 2) for j in range(n)])
    # Correlated residuals make rows worth less than their number says; a larger noise takes that into account.
    return np.asarray(1.0 / (noise * np.sqrt(overstated * rows.share)))


def _compute_overstatement(rows: DataRows, rest: FloatArray, joint: int, fit: FloatArray) -> float:
    """Return by how much these rows of a joint overstate the information in them, at least 1."""
    starts = [
        start
        for first, last in zip(rows.borders, rows.borders[1:], strict=False)
        for start in range(first, last - rows.window_rows + 1, rows.window_rows)
    ]
    if not starts:
        return 1.0
    windows = np.array(starts)[:, None] + np.arange(rows.window_rows)
    w = rows.w[:, joint]
    # Columns that are zero for this joint would make its normal equations singular.
    used = np.flatnonzero((w != 0).any(axis=0))
    columns, rests = w[windows][:, :, used], rest[windows, joint]
    return compute_overstatement(columns, rests, float(np.count_nonzero(rests)), fit[np.ix_(used, used)], columns)


def normal_equations_from_rehearsal(
    model: DesignModel, rehearsal: Rehearsal, row_weights: FloatArray
) -> NormalEquations:
    """Return the normal equations that an experiment would give.

    Parameters
    ----------
    model : DesignModel
        Model with the effects in question.
    rehearsal : Rehearsal
        The motion, and the number of samples that it would be recorded with.
    row_weights : (n,)
        One over the noise of a row, by joint.

    Returns
    -------
    NormalEquations
        The equations, with zero on the right.
    """
    motion = rehearsal.motion
    samples = _spread_samples(len(motion.t))
    w = model.observe_along(motion, samples)
    # A joint that stands has static friction, which any torque within its band satisfies: such rows tell nothing.
    moves = np.abs(motion.dq[samples]) > STANDSTILL_VELOCITY
    weights = (row_weights * moves).reshape(-1) * np.sqrt(rehearsal.n_samples / len(samples))
    weighted = w * weights[:, None]
    # A motion that was not run has no residual: it sharpens the estimate and does not move it.
    return NormalEquations(weighted.T @ weighted, np.zeros(w.shape[1]))


def _spread_samples(count: int) -> IndexArray:
    """Return evenly spread indices of a motion's samples, at most `_MOST_ROWS`."""
    return np.unique(np.linspace(0, count - 1, min(count, _MOST_ROWS)).astype(np.intp))


def fit_amplitudes(equations: NormalEquations, suspect: Sequence[int], rivals: Sequence[int]) -> FloatArray:
    """Fit the suspect's parameters to the residual, beside the model and without its rivals.

    Parameters
    ----------
    equations : NormalEquations
        Of the model with the suspect and its rivals.
    suspect, rivals : sequence of int
        Numbers of their parameters.

    Returns
    -------
    (len(suspect),)
        The values of the suspect's parameters.
    """
    # The rivals are left out: the suspect then takes all of what the two could explain.
    columns = [k for k in range(len(equations.right)) if k not in set(rivals) - set(suspect)]
    solved = _solve_scaled(equations.matrix[np.ix_(columns, columns)], equations.right[columns])
    return np.asarray(solved[[columns.index(k) for k in suspect]])


def _solve_scaled(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Return the shortest solution, with columns scaled to equal size, of equations that may be singular."""
    # Parameters have different units. Without the scaling the cut-off on singular values would drop small columns.
    scale = np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    solved = np.linalg.lstsq(matrix / np.outer(scale, scale), (right.T / scale).T, rcond=1e-9)[0]
    return np.asarray((solved.T / scale).T)


def compute_separation(model: DesignModel, known: NormalEquations, parameter: int, size: float | None) -> Separation:
    """Return how well a parameter is determined beside everything else in the model.

    Parameters
    ----------
    model : DesignModel
        Model with the effects in question.
    known : NormalEquations
        Normal equations of all data that count.
    parameter : int
        Number of the parameter in the model.
    size : float or None
        Amplitude of the parameter in its unit; None where nobody knows it.

    Returns
    -------
    Separation
        Standard deviation of the parameter, and what its column has to itself.
    """
    inverse = compute_diagonal_from_information(known.matrix)
    deviation = float(np.sqrt(inverse.variances[parameter]))
    column = model.base_columns[parameter]
    return Separation(
        parameter=column.name,
        unit=column.unit,
        share=float(inverse.shares[parameter]),
        standard_deviation=deviation,
        t_value=None if size is None else abs(size) / deviation,
    )
