"""IDIM-IV and DIDIM: estimators whose instruments or regressors come from a simulation of the identified robot.

Holds when instruments are too weak.

The simulated robot follows the motion of the recordings under closed loop (Gautier, Janot and Vandanjon 2013), so that
its positions are near the true ones and free of the encoders' noise. Where a recording has no commanded motion, the
robot follows the measured positions behind a low-pass filter.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.errors import DynidentError
from dynident.estimation import PriorInformation, Reduction, solve_instrumental, solve_weighted, statistics
from dynident.identification.equations.reduced_recordings import Data
from dynident.identification.estimation_problem import Fit, Problem
from dynident.identification.estimators.identified_robot_simulator import (
    BANDWIDTH,
    RecordedMotion,
    SimulatedMotion,
    align_commanded_motion,
    build_movable_simulator,
    read_whole_segments,
    simulate_recording,
)
from dynident.number_format import format_percent
from dynident.recordings import Preprocessing, Recording, SampleBlock, choose_preprocessing, find_motion_band
from dynident.recordings.low_pass_decimation import filter_in_parallel
from dynident.regressors.dynamic_model_rows import SampleFunction, reduce_recordings
from dynident.regressors.model_structure import Model
from dynident.regressors.qr_accumulation import EquationRows, accumulate_equations
from dynident.regressors.row_phases import RowPhases

# Times the band of the motion that the reference of instruments keeps: noise that remains in it biases the estimate.
_HARMONICS = 4.0
# Largest cut-off of a filter as a share of the Nyquist frequency.
_NYQUIST_SHARE = 0.7
# Change of the estimates, in their standard deviations, below which they have settled; and rounds at most.
_SETTLED, _ROUNDS = 0.05, 10
# Smallest correlation between simulated and measured columns for instruments that are not weak.
_STRONG = 0.7


def estimate_by_instrumental_variables(problem: Problem) -> Fit:
    """Estimate by instrumental variables [Gautier, Janot and Vandanjon 2013]: Z from simulation, W measured.

    All are filtered alike. Simulation and estimate alternate until the estimates change by less than a twentieth of a
    standard deviation.

    Noise that adds to W is removed from the estimates. What it does beyond that is not: the sign of a velocity that is
    mostly noise is a smaller column of friction, whatever the instruments. Positions need a filter behind which the
    noise of velocities is small beside velocities; that of accelerations may be large. Standard deviations are on the
    safe side there: the noise in W is less correlated than independent samples would be, and counts as these.

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
        Where nothing can be simulated, or the simulated motion is no instrument for the measured one.
    """
    model, data, known = problem.model, problem.data, problem.known
    references = _choose_references(data, _HARMONICS * find_motion_band(data.recordings))
    # Closures pass the figures of the last round out to the summary.
    strength = 1.0

    def solve(both: Reduction) -> Fit:
        nonlocal strength
        instrumented = solve_instrumental(both, known, problem.covariance)
        strength = instrumented.strength
        return Fit(instrumented.solution, instrumented.statistics)

    settled = _alternate(model, data, references, known, solve)
    summary = (
        f"Instrumental variables from a simulated robot ({BANDWIDTH:g} Hz of control bandwidth) that follows "
        f"{references.words}; converged after {settled.rounds} iterations; the weakest correlation between simulated "
        f"and measured columns is {strength:.3f}."
    )
    warnings = (summary, *references.warnings, *settled.warnings)
    if strength < _STRONG:
        warnings += ("The instruments are weak in some directions: the standard deviations there are inaccurate.",)
    return Fit(settled.fit.solution, settled.fit.statistics, warnings)


def estimate_by_output_error(problem: Problem) -> Fit:
    """Estimate by DIDIM, closed-loop output error on the torque: min over χ of |Y - W(q_s(χ)) χ|, q_s simulated.

    The Gauss-Newton step takes the simulated positions for fixed, as they hardly depend on χ under closed loop. So each
    step is a weighted least-squares solution with the columns of the simulated motion alone: only Y is measured.

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
        Where nothing can be simulated.
    """
    model, data, known = problem.model, problem.data, problem.known
    references = _choose_references(data, choose_preprocessing(data.recordings).position_cutoff)
    c = model.n_parameters
    error = 0.0

    def solve(both: Reduction) -> Fit:
        nonlocal error
        # The simulated columns stand first; the measured ones behind them are for instruments only.
        simulated = both.select_columns(np.arange(c))
        solution = solve_weighted(simulated, known)
        uncertainty = statistics(simulated, solution, problem.covariance)
        error = float(np.sqrt(np.mean(uncertainty.noise**2)))
        return Fit(solution, uncertainty)

    settled = _alternate(model, data, references, known, solve)
    summary = (
        f"Output error: torque simulated along {references.words} under a control bandwidth of {BANDWIDTH:g} Hz; "
        f"converged after {settled.rounds} iterations at a simulated torque error of {error:.3g} rms."
    )
    return Fit(settled.fit.solution, settled.fit.statistics, (summary, *references.warnings, *settled.warnings))


@dataclass(frozen=True, eq=False)
class _References:
    """References of simulated robots: the segments of every recording, a description in words, and warnings."""

    motions: list[tuple[RecordedMotion, ...]]
    words: str
    warnings: tuple[str, ...]


def _choose_references(data: Data, measured: float | None) -> _References:
    """Return the commanded motions where they are recorded and were followed, else the measured ones.

    These are filtered below `measured` Hz. Commands hold no noise of encoders, and may be taken up to what the data's
    own filter leaves.
    """
    # Measured positions hold noise, so they are cut lower than commands.
    cutoff, wide = _limit_cutoff(data, measured), _limit_cutoff(data, None)
    motions, warnings, delays = [], [], []
    for recording in data.recordings:
        command = align_commanded_motion(recording, Preprocessing(wide, None, 1)) if recording.has_command else None
        if command is not None and command.is_followed:
            motions.append(command.segments)
            delays.append(float(np.abs(command.delay).max()))
            continue
        motions.append(read_whole_segments(recording, Preprocessing(cutoff, None, 1)))
        if command is not None:
            how = (
                "even with a delay they differ from the measured positions by "
                f"{format_percent(command.rest, decimals=0)} of the motion"
            )
            why = how if np.isfinite(command.rest) else "not all of them are numbers"
            warnings.append(f"The commanded positions of {recording.name} are not used: {why}.")
    words = []
    if delays:
        words.append(f"the commanded positions, delayed by up to {1e3 * max(delays):.0f} ms like the robot")
    if len(delays) < len(motions):
        words.append(f"the measured positions below {cutoff:.2g} Hz")
    return _References(motions, " or ".join(words), tuple(warnings))


@dataclass(frozen=True, eq=False)
class _AlternationResult:
    fit: Fit
    rounds: int
    warnings: tuple[str, ...]


def _alternate(
    model: Model, data: Data, references: _References, known: PriorInformation | None, solve: Callable[[Reduction], Fit]
) -> _AlternationResult:
    """Simulate with the last estimates, solve with the simulated motion, and repeat until the estimates settle."""
    values = _solve_first(model, data, known)
    change = np.inf
    fitted: Fit | None = None
    for number in range(1, _ROUNDS + 1):
        fitted = solve(
            _reduce_with_simulated(model, data, _simulate_recordings(model, data, references.motions, values))
        )
        deviations = np.maximum(fitted.statistics.standard_deviations, np.finfo(float).tiny)
        change = float(np.max(np.abs(fitted.solution.values - values) / deviations))
        values = fitted.solution.values
        # A further round would move the estimates by less than their uncertainty.
        if change < _SETTLED:
            return _AlternationResult(fitted, number, ())
    # Unsettled estimates are still the best there are; the warning says that they are not final.
    assert fitted is not None
    unsettled = (
        f"The estimates did not converge in {_ROUNDS} iterations of simulation: the last one changed an estimate by "
        f"{change:.2g} of its standard deviations."
    )
    restless = replace(fitted, solution=replace(fitted.solution, converged=False))
    return _AlternationResult(restless, _ROUNDS, (unsettled,))


def _solve_first(model: Model, data: Data, known: PriorInformation | None) -> FloatArray:
    """Solve by weighted least squares behind the filters that the data ask for: good enough to simulate with.

    With filters that leave much noise, which is what instruments are for, the first robot would be too light to
    control.
    """
    own = choose_preprocessing(data.recordings)
    if own.position_cutoff == data.preprocessing.position_cutoff:
        return solve_weighted(data.equations, known).values
    return solve_weighted(reduce_recordings(model.observation, replace(data.inputs, preprocessing=own)), known).values


def _simulate_recordings(
    model: Model, data: Data, motions: list[tuple[RecordedMotion, ...]], values: FloatArray
) -> list[SimulatedMotion]:
    simulator = build_movable_simulator(model, values)
    pairs = zip(data.recordings, motions, strict=True)
    try:
        return [simulate_recording(simulator, recording, own) for recording, own in pairs]
    except DynidentError as error:
        raise DynidentError(
            f"the robot with the estimated parameters cannot be simulated along the recordings: {error.detail}. Use "
            "wls or feasible, or data with more excitation",
            pointer="/estimator",
            title="No simulation",
        ) from error


def _reduce_with_simulated(model: Model, data: Data, motions: list[SimulatedMotion]) -> Reduction:
    """Return rows [Z | W | Y], Z of the simulated motion, all behind the same filters; 2 b columns."""
    observation, b = model.observation, model.n_parameters
    layout = [observation.joint_entries(joint) for joint in range(observation.robot.n)]
    n_entries = len(observation.entry_rows)
    of_recording = dict(zip(map(id, data.recordings), motions, strict=True))

    def iterate_rows(recording: Recording) -> Iterator[EquationRows]:
        simulated = SampleFunction(observation, data.reference, recording)
        measured = SampleFunction(observation, data.reference, recording)
        motion = of_recording[id(recording)]
        phases = RowPhases.from_recording(observation, recording, data.preprocessing)

        # Simulated and measured columns go through the filters together, so that the instruments have the same delay
        # and band.
        def values(block: SampleBlock) -> FloatArray:
            return np.hstack([simulated(motion.replace_motion(block)), measured(block), block.tau])

        for segment, t, rows in filter_in_parallel(recording, data.preprocessing, values, width=2 * n_entries):
            z, w, tau = rows[:, :n_entries], rows[:, n_entries : 2 * n_entries], rows[:, 2 * n_entries :]
            equations = [
                np.hstack([z[:, positions], w[:, positions], tau[:, joint : joint + 1]])
                for joint, (positions, _) in enumerate(layout)
            ]
            yield EquationRows(t, equations, segment, phases.find_used_rows(segment, t))

    columns = [np.concatenate([own, own + b]) for _, own in layout]
    return accumulate_equations(iterate_rows, columns, 2 * b, data.recordings)


def _limit_cutoff(data: Data, wish: float | None) -> float:
    """Return the wished cut-off in Hz (None: all), but below what the sampling rate and the position filter leave."""
    rate = min(recording.sampling_rate for recording in data.recordings)
    own = data.preprocessing.position_cutoff
    return float(min(np.inf if wish is None else wish, _NYQUIST_SHARE * 0.5 * rate, np.inf if own is None else own))
