"""The robust estimator: reweighted least squares with Huber's or Tukey's weights.

Holds its rounds, and when a row counts as given up.

A contact or a glitch of the torque is no noise: squared, a hundredth of the rows can outweigh all others. Every row of
every joint's torque gets a weight from its own residual (`estimation.row_weights`), from Huber's function to
convergence and then from the bisquare. The last solution is that of least squares on pseudo-observations ŷ + ψ(e) /
mean ψ'. Its cluster-robust covariance is that of the robust estimate: residuals stay correlated and are not counted as
independent.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.errors import DynidentError
from dynident.estimation import PriorInformation, Reduction, compute_noise_levels, solve, solve_weighted, statistics
from dynident.estimation.least_squares import compute_correlated_noise, floor_noise
from dynident.estimation.row_weights import BISQUARE, HUBER, Influence, estimate_robust_scale
from dynident.identification.equations.reduced_recordings import Data
from dynident.identification.estimation_problem import Fit, Problem
from dynident.number_format import format_percent
from dynident.recordings import Recording
from dynident.regressors.dynamic_model_rows import FilteredSamples, reduce_recordings, stream_filtered_samples
from dynident.regressors.model_structure import Model
from dynident.regressors.row_phases import RowPhases

_MOST_ROUNDS = 15
# A round that moves no parameter by more than this share of its standard deviation is the last.
_SETTLED = 0.05
# A row with less weight than this counts as given up.
_REJECTED = 0.1
# Share of rows given up from which on the user is told.
_NOTABLE = 0.002
# Intervals that are named, at most, and the gap in s that one may have.
_MOST_SPANS, _GAP = 3, 0.5


def estimate_robustly(problem: Problem) -> Fit:
    """Return robust estimates from the rows of all joints' torques.

    Parameters
    ----------
    problem : Problem
        Equations of the data, and prior knowledge.

    Returns
    -------
    Fit
        The estimates with their uncertainty, and warnings.

    Raises
    ------
    DynidentError
        Where the equations are not the rows of the joints' torques, or no recording is at hand to go through again.
    """
    model, data, known = problem.model, problem.data, problem.known
    _check_data(data)
    passes = _Passes(model, data)
    first = solve_weighted(data.equations, known)
    # Against a prior, correlated rows must not count as independent samples: their noise is raised to what they are
    # worth.
    share = np.ones(len(first.noise))
    if known is not None and known.has_rows:
        share = compute_correlated_noise(data.equations, first) / compute_noise_levels(data.equations, first.values)
    values, converged = first.values, True
    # Huber's function has a single minimum, so it finds the start for the bisquare, which has several but ignores
    # outliers.
    for influence in (HUBER, BISQUARE):
        values, converged = _reweight_until_settled(passes, values, influence, share, known)
    sigma = estimate_robust_scale(passes.compute_residuals(values))
    pseudo = passes.reduce_pseudo_observations(values, sigma, BISQUARE)
    solution = replace(solve(pseudo, floor_noise(sigma) * share, known), converged=converged)
    return Fit(solution, statistics(pseudo, solution, problem.covariance), passes.list_warnings(values, sigma))


def _reweight_until_settled(
    passes: _Passes, values: FloatArray, influence: Influence, share: FloatArray, known: PriorInformation | None
) -> tuple[FloatArray, bool]:
    """Reweight until χ settles, in at most fifteen rounds; return it, and whether it settled."""
    for _ in range(_MOST_ROUNDS):
        sigma = floor_noise(estimate_robust_scale(passes.compute_residuals(values)))
        rows = passes.reduce_weighted(values, sigma, influence)
        solution = solve(rows, sigma * share, known)
        moved = np.abs(solution.values - values)
        values = solution.values
        if np.all(moved <= _SETTLED * np.sqrt(np.diag(solution.normal_inverse))):
            return values, True
    return values, False


def _check_data(data: Data) -> None:
    if data.equations is not data.torque:
        raise DynidentError(
            "irls gives each row of the joint torques its own weight, but these equations combine many rows; choose "
            "the dynamic model with the global strategy, or another estimator",
            pointer="/estimator",
            title="Choices that do not fit",
        )
    if not data.recordings:
        raise DynidentError(
            "irls needs the samples of the recordings, but only their reduced data are available; identify from the "
            "recordings, or choose ols, wls or feasible",
            pointer="/estimator",
            title="Recordings needed",
        )


@dataclass(frozen=True, eq=False)
class _Passes:
    """Passes through the filtered rows of all recordings, from memory where they are kept."""

    model: Model
    data: Data

    def compute_residuals(self, values: FloatArray) -> FloatArray:
        """Return y - ŷ of all rows (m, n) for parameters (b,), NaN where a row is left out."""
        residuals = [
            self._compute_counted_residuals(recording, samples, values)
            for recording in self.data.recordings
            for samples in self._iterate_samples(recording)
        ]
        return np.concatenate(residuals) if residuals else np.zeros((0, self.model.robot.n))

    def _compute_counted_residuals(
        self, recording: Recording, samples: FilteredSamples, values: FloatArray
    ) -> FloatArray:
        """Return the residuals (m, n); NaN where a joint stands or reverses, whose rows are left out."""
        rest = self._compute_residual(samples, values)
        phases = RowPhases.from_recording(self.model.observation, recording, self.data.preprocessing)
        rest[~phases.find_used_rows(samples.segment, samples.t)] = np.nan
        return rest

    def reduce_weighted(self, values: FloatArray, sigma: FloatArray, influence: Influence) -> Reduction:
        """Return the equations with every row times the root of its weight at parameters (b,) and scales (n,)."""
        rows = self.model.observation.entry_rows

        def weigh(samples: FilteredSamples) -> FilteredSamples:
            root = np.sqrt(influence.weight(self._compute_residual(samples, values) / sigma))
            return replace(samples, values=samples.values * root[:, rows], tau=samples.tau * root)

        return self._reduce(weigh)

    def reduce_pseudo_observations(self, values: FloatArray, sigma: FloatArray, influence: Influence) -> Reduction:
        """Return the equations of the pseudo-observations ŷ + ψ(e) / mean ψ', with weights 1."""
        safe = floor_noise(sigma)
        slope = influence.slope(self.compute_residuals(values) / safe)
        counted = np.isfinite(slope)
        slope = np.where(counted, slope, 0.0).sum(axis=0) / np.maximum(counted.sum(axis=0), 1)

        def replace_torque(samples: FilteredSamples) -> FilteredSamples:
            rest = self._compute_residual(samples, values)
            # A small mean slope would blow up the pseudo-observations, so it is bounded from below.
            influenced = influence.weight(rest / safe) * rest / np.maximum(slope, 0.1)
            return replace(samples, tau=samples.tau - rest + influenced)

        return self._reduce(replace_torque)

    def list_warnings(self, values: FloatArray, sigma: FloatArray) -> tuple[str, ...]:
        """Return a warning that names the rows that were given up; nothing where they are few."""
        safe = floor_noise(sigma)
        weights, times = [], []
        for recording in self.data.recordings:
            for samples in self._iterate_samples(recording):
                weights.append(
                    BISQUARE.weight(self._compute_counted_residuals(recording, samples, values) / safe) < _REJECTED
                )
                times.append([(recording.name, float(t)) for t in samples.t])
        rejected = np.concatenate(weights)
        shares = rejected.mean(axis=0)
        if float(rejected.any(axis=1).mean()) < _NOTABLE:
            return ()
        names = self.model.robot.joint_names
        joints = ", ".join(
            f"{names[j]} {format_percent(shares[j], decimals=1)}" for j in np.argsort(-shares) if shares[j] >= _NOTABLE
        )
        when = [place for part in times for place in part]
        spans = _find_spans([when[k] for k in np.flatnonzero(rejected.any(axis=1))])
        return (
            f"The model does not explain some rows, and they have no weight: {joints}; most at {', '.join(spans)}.",
        )

    def _reduce(self, change: Callable[[FilteredSamples], FilteredSamples]) -> Reduction:
        data = self.data
        return reduce_recordings(
            self.model.observation,
            data.inputs,
            samples_of=lambda recording: (change(samples) for samples in self._iterate_samples(recording)),
        )

    def _iterate_samples(self, recording: Recording) -> Iterator[FilteredSamples]:
        in_memory = None if self.data.rows is None else self.data.rows.find_samples(recording, self.data.preprocessing)
        if in_memory is not None:
            yield from in_memory
            return
        data = self.data
        phases = RowPhases.from_recording(self.model.observation, recording, data.preprocessing)
        yield from stream_filtered_samples(
            self.model.observation, recording, data.preprocessing, data.reference, phases=phases
        )

    def _compute_residual(self, samples: FilteredSamples, values: FloatArray) -> FloatArray:
        return np.asarray(samples.tau - self.model.observation.compute_torque(samples.values, values))


def _find_spans(places: list[tuple[str, float]]) -> list[str]:
    """Return the intervals that hold most of these places (recording, time), the fullest first."""
    spans: list[tuple[int, str, float, float]] = []
    for name, time in places:
        if spans and spans[-1][1] == name and 0 <= time - spans[-1][3] <= _GAP:
            count, _, start, _ = spans.pop()
            spans.append((count + 1, name, start, time))
        else:
            spans.append((1, name, time, time))
    most = sorted(spans, key=lambda span: -span[0])[:_MOST_SPANS]
    return [f"{start:.1f} to {end:.1f} s of {name}" for _, name, start, end in most]
