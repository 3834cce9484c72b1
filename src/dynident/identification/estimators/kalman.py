"""The Kalman-filter estimator (§12.8): run the filter over recordings, choose its noise and its start, find divergence.

The filter passes through the recordings once, and linearises the torque function at every sample.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.effects import Signals, build_columns
from dynident.effects.usual_effect_sizes import get_slowest_velocity
from dynident.errors import DynidentError
from dynident.estimation import (
    EstimationError,
    PriorInformation,
    Reduction,
    Statistics,
    build_prior,
    compute_errors,
    compute_pooled_statistics,
    compute_row_freedom,
    describe_fit,
    solve_weighted,
)
from dynident.estimation.kalman_filter import (
    KalmanFilter,
    KalmanNoise,
    KalmanSample,
    TorqueModel,
    TorqueSlopes,
    compute_recursive_statistics,
)
from dynident.estimation.prior_information import invert_information
from dynident.estimation.qr_decomposition import compute_r_factor
from dynident.identification.equations.reduced_recordings import Data
from dynident.identification.estimation_problem import Fit, Problem
from dynident.number_format import format_percent
from dynident.recordings import Preprocessing, Recording, choose_preprocessing, filtered_blocks
from dynident.recordings.signal_spectra import estimate_spectra
from dynident.regressors.dynamic_model_rows import reduce_recordings
from dynident.regressors.model_structure import Model
from dynident.regressors.qr_accumulation import EquationRows, accumulate_equations
from dynident.regressors.row_phases import RowPhases

# Width of the smooth sign(q̇), as a share of the slowest joint's velocity limit: a filter needs its derivative.
_SIGN_WIDTH = 2e-3


class TorqueFunction:
    """Γ(q, q̇, q̈; χ) = W χ of a model, with its derivatives.

    Raises
    ------
    DynidentError
        For an effect that depends on more than q, q̇ and q̈.
    """

    def __init__(self, model: Model) -> None:
        robot, n = model.robot, model.robot.n
        # The sign of the velocity has no derivative at zero, so a steep smooth function stands in for it.
        signals = Signals(robot, smooth_sign=_SIGN_WIDTH * get_slowest_velocity(robot))
        all_columns = {column.key: column for column in build_columns(model.effects, signals)}
        columns = [all_columns[column.key] for column in model.kept]
        motion = {symbol.name() for part in (signals.q, signals.dq, signals.ddq) for symbol in ca.symvar(part)}
        for column in columns:
            # By their names: the symbols of another set of signals are other objects.
            if {symbol.name() for symbol in ca.symvar(column.torque)} - motion:
                raise DynidentError(
                    f"{column.effect} depends on more than position, velocity and acceleration, so a filter that "
                    "takes one sample at a time cannot compute it. Leave it out, or choose another estimator",
                    pointer="/estimator",
                    title="Effect without a filter",
                )
        w = ca.densify(ca.horzcat(*(column.torque for column in columns)))
        values = ca.SX.sym("chi", len(columns))
        torque = ca.mtimes(w, values)
        slopes = [ca.densify(ca.jacobian(torque, part)) for part in (signals.q, signals.dq, signals.ddq)]
        # One function for all outputs, with common subexpressions evaluated once: it is called for every sample.
        outputs = ca.cse([ca.horzcat(torque, *slopes, w)])
        self._n = n
        self._function = ca.Function("torque", [signals.q, signals.dq, signals.ddq, values], outputs)
        # Buffers are bound once: converting arrays in every call would cost more than the function itself.
        self._buffer, self._evaluate = self._function.buffer()
        self._inputs = [np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(len(columns))]
        self._out = np.zeros((1 + 3 * n + len(columns), n))
        for k, item in enumerate(self._inputs):
            self._buffer.set_arg(k, memoryview(item))  # type: ignore[call-arg, arg-type]  # the stubs are of C
        self._buffer.set_res(0, memoryview(self._out))  # type: ignore[call-arg, arg-type]

    def __call__(self, q: FloatArray, dq: FloatArray, ddq: FloatArray, values: FloatArray) -> TorqueSlopes:
        """Evaluate at q, dq, ddq (n,) with χ (b,)."""
        for item, value in zip(self._inputs, (q, dq, ddq, values), strict=True):
            item[:] = value
        self._evaluate()
        n, outputs = self._n, self._out.T.copy()  # CasADi's matrices stand column by column
        return TorqueSlopes(
            outputs[:, 0],
            outputs[:, 1 : 1 + n],
            outputs[:, 1 + n : 1 + 2 * n],
            outputs[:, 1 + 2 * n : 1 + 3 * n],
            outputs[:, 1 + 3 * n :],
        )


class _TorqueBesideHeld:
    """Torque as a function of the parameters that are not held at known values."""

    def __init__(self, torque: TorqueModel, known: PriorInformation) -> None:
        self._torque, self._known, self._estimated = torque, known, ~known.is_held

    def __call__(self, q: FloatArray, dq: FloatArray, ddq: FloatArray, values: FloatArray) -> TorqueSlopes:
        """Evaluate at q, dq, ddq (n,) with the estimated parameters (f,)."""
        slopes = self._torque(q, dq, ddq, self._known.restore_held(values))
        return replace(slopes, by_parameters=slopes.by_parameters[:, self._estimated])


# Factor on the torque noise of a joint that stands still with friction: its torque tells nothing.
_TELLS_NOTHING = 1e6
# The filter has diverged where squared innovations are so many times the expected ones in so many samples in a row; or
# so many times on average.
_LOST, _LOST_SAMPLES, _LOST_ON_AVERAGE = 1e6, 50, 1e3
# Number of times at which the parameters are recorded.
_RECORDED_TIMES = 200
# Samples whose equations are reduced at a time.
_BLOCK = 1024


@dataclass(frozen=True, eq=False)
class KalmanRun:
    """Record of a filter's pass through recordings.

    Parameters
    ----------
    times : (k,)
        Seconds of data that the filter has seen; the last is the end.
    values : (k, b)
        The parameters then.
    deviations : (k, b)
        Their standard deviations then, by the filter's own covariance.
    rows : Reduction
        The equations of the parameters that the samples make, with noise of size one if it is as assumed, one equation
        a joint with all parameters.
    surprise : float
        Mean ratio of the squared innovations to those that the filter expects.
    """

    times: FloatArray
    values: FloatArray
    deviations: FloatArray
    rows: Reduction
    surprise: float


def run_filter(torque: TorqueModel, model: Model, data: Data, start: PriorInformation, noise: KalmanNoise) -> KalmanRun:
    """Let a filter that begins with a prior on χ run through the recordings.

    Parameters
    ----------
    torque : TorqueModel
        The torque with its derivatives.
    model : Model
        The model, with its base parameters' columns.
    data : Data
        Recordings reduced to the model's columns.
    start : PriorInformation
        Prior on χ.
    noise : KalmanNoise
        Noises of positions, torques and accelerations.

    Returns
    -------
    KalmanRun
        The parameters over time, and the equations of the samples.

    Raises
    ------
    EstimationError
        Where it diverges.
    """
    way = _FilterPass(torque, model, data, start, noise)
    c, n = start.n_columns, model.robot.n
    rows = accumulate_equations(way.iterate_rows, [np.arange(c)] * n, c, data.recordings, in_turn=True)
    if not way.samples:
        raise DynidentError(
            "there are too few consecutive samples for a filter; use a longer recording",
            pointer="/recordings",
            title="Too few samples",
        )
    surprise = way.surprise / way.samples
    # Written so that a value that is no number counts as divergence.
    if not surprise < _LOST_ON_AVERAGE:
        raise divergence_error(f"the variance of its innovations is {surprise:.2g} times the expected value")
    way.record_state()
    times, values, deviations = (np.array(item) for item in zip(*way.kept, strict=True))
    return KalmanRun(times, values, deviations, rows, surprise)


class _FilterPass:
    """State of the filter on its pass through the recordings, and the record of its parameters."""

    def __init__(
        self, torque: TorqueModel, model: Model, data: Data, start: PriorInformation, noise: KalmanNoise
    ) -> None:
        self._torque, self._model, self._data, self._noise = torque, model, data, noise
        # The prior is given as rows; their solution is the mean, the inverse of their normal matrix the covariance.
        self.values: FloatArray = np.asarray(np.linalg.lstsq(start.factor, start.right)[0])
        self.covariance: FloatArray = invert_information(compute_r_factor(start.factor))
        self.seen, self.samples, self.surprise = 0.0, 0, 0.0
        self.kept: list[tuple[float, FloatArray, FloatArray]] = []
        self._gap = max(1, round(sum(recording.n_samples for recording in data.recordings) / _RECORDED_TIMES))
        self._lost = 0
        self.record_state()

    def record_state(self) -> None:
        """Record the parameters and their deviations now."""
        self.kept.append((self.seen, self.values, np.sqrt(np.maximum(np.diag(self.covariance), 0.0))))

    def iterate_rows(self, recording: Recording) -> Iterator[EquationRows]:
        """Yield the equations of χ that the samples of a recording make, block by block."""
        phases = RowPhases.from_recording(self._model.observation, recording, self._data.preprocessing)
        times: list[float] = []
        rows: list[FloatArray] = []
        kalman: KalmanFilter | None = None
        segment = -1
        for now in _iterate_samples(recording, self._data.preprocessing, phases):
            if times and (now.place == 0 or len(times) >= _BLOCK):
                yield self._build_equations(times, rows, segment)
                times, rows = [], []
            # A filter begins anew with every unbroken piece: positions and velocities jump, the parameters go on.
            if now.place == 1:
                segment = now.segment
                kalman = KalmanFilter(self._torque, recording.period, self._noise, self.values, self.covariance)
                kalman.begin(now.before, now.q, now.tau, now.ddq, now.doubt)
            elif now.place > 1:
                assert kalman is not None
                rows.append(self._step(kalman, now, recording).rows)
                times.append(now.t)
        if times:
            yield self._build_equations(times, rows, segment)

    def _build_equations(self, times: list[float], rows: list[FloatArray], segment: int) -> EquationRows:
        """Return a row of the torque and one of the position for every joint and instant."""
        n, samples = self._model.robot.n, np.array(rows)
        both = [samples[:, [joint, n + joint]].reshape(-1, samples.shape[2]) for joint in range(n)]
        return EquationRows(np.repeat(times, 2), both, segment)

    def _step(self, kalman: KalmanFilter, now: _Sample, recording: Recording) -> KalmanSample:
        try:
            step = kalman.step(now.q, now.tau, now.ddq, now.doubt)
        except EstimationError as error:
            raise divergence_error(f"at t = {now.t:.2f} s of {recording.name} {error.detail}") from error
        # A single outlier is no divergence, but many in a row are.
        self._lost = self._lost + 1 if step.surprise > _LOST else 0
        if self._lost > _LOST_SAMPLES or not np.isfinite(kalman.values).all():
            raise divergence_error(f"from t = {now.t:.2f} s of {recording.name} on it no longer follows the motion")
        self.values, self.covariance = kalman.values, kalman.covariance
        self.seen += recording.period
        self.samples += 1
        self.surprise += step.surprise
        if self.samples % self._gap == 0:
            self.record_state()
        return step


class _Sample(NamedTuple):
    """A used sample: its place in its unbroken piece, position of the sample before, q, tau and rough q̈ (n,).

    `doubt` (n,): factor on the noise of a joint's torque; large where the joint stands.
    """

    t: float
    segment: int
    place: int
    before: FloatArray
    q: FloatArray
    tau: FloatArray
    ddq: FloatArray
    doubt: FloatArray


def _iterate_samples(recording: Recording, filters: Preprocessing, phases: RowPhases) -> Iterator[_Sample]:
    """Yield measured positions and torques, unfiltered, with the acceleration of the filtered motion."""
    # Both passes yield the same samples in the same order, so the raw positions are read beside the filtered ones.
    raw = (q for block in filtered_blocks(recording, Preprocessing(None, None)) for q in block.q)
    place = -1
    before = np.zeros(recording.n)
    for block in filtered_blocks(recording, filters):
        if block.starts_segment:
            place = -1
        # A standing joint's static friction takes any value, so that its torque must not move the parameters.
        doubt = np.where(phases.find_used_rows(block.segment, block.t), 1.0, _TELLS_NOTHING)
        for k, used in enumerate(block.used):
            q = next(raw)
            place = place + 1 if used else -1
            if used:
                yield _Sample(float(block.t[k]), block.segment, place, before, q, block.tau[k], block.ddq[k], doubt[k])
            before = q


def divergence_error(how: str) -> EstimationError:
    """Return the error of a filter that does not follow the data."""
    return EstimationError(
        f"the Kalman filter diverged: {how}. Start with better values (the prior description, a longer recording), or "
        "use wls",
        pointer="/estimator",
        title="Divergence",
    )


START_SHARES = (0.25, 0.5, 1.0)
"""Shares of the data for the filter's initial parameters; the first share that determines them is used."""

# Factor on the initial standard deviations: those of a short recording are unreliable, and the filter sees the same
# samples again.
_DOUBT = 5.0
# Standard deviation of the acceleration over its own size: the filtered acceleration is where the model is linearised,
# and no measurement.
_UNKNOWN = 10.0
# Position noise is not believed to be less than this, rad or m.
_LEAST_NOISE = 1e-6
# Largest torque error at the end, over that of the initial parameters, and in addition to it, for the filter not to
# have diverged.
_WORSE, _ALLOWED = 1.5, 0.01


@dataclass(frozen=True, eq=False)
class _FilterStart:
    """Start of the filter: prior on χ, the share of the data that it comes from, and its residual (n,)."""

    share: float
    known: PriorInformation
    residual: FloatArray


def estimate_by_kalman_filter(problem: Problem) -> Fit:
    """Estimate with an extended Kalman filter: state [q, q̇, χ], measured positions and torques, χ constant.

    Initial parameters come from the beginning of the data by weighted least squares, with widened deviations. Position
    noise is taken from the spectrum of the positions, torque noise from that of the torque and from the residual of the
    initial parameters. The filter goes through all of the data, unfiltered; it is linearised at the acceleration of the
    filtered motion.

    Standard deviations are not those of the filter, which takes its noises for white and known. The residuals of its
    equations of the parameters are judged as those of least squares are, with their correlation in time, joint by
    joint.

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
        Where an effect has no place in the filter, the data do not determine the parameters, or the filter diverges.
    """
    model, data, known = problem.model, problem.data, problem.known
    torque: TorqueModel = TorqueFunction(model)
    estimated = np.ones(model.n_parameters, dtype=bool)
    if known is not None and known.held is not None:
        torque, estimated = _TorqueBesideHeld(torque, known), ~known.is_held
    # The filter is linearised at a filtered acceleration, so there has to be a position filter.
    if data.preprocessing.position_cutoff is None:
        data = replace(data, preprocessing=choose_preprocessing(data.recordings))
    initial = _solve_beginning(model, data, known)
    run = run_filter(torque, model, data, initial.known, estimate_noise(data, initial.residual))
    first, values = (chi if known is None else known.restore_held(chi) for chi in (run.values[0], run.values[-1]))
    before, after = (compute_errors(data.torque, chi).relative_total for chi in (first, values))
    # Written so that an error that is no number counts as divergence.
    if not after <= _WORSE * before + _ALLOWED:
        raise divergence_error(
            f"its final parameters have a torque error of {format_percent(after, decimals=1)}, its initial parameters "
            f"{format_percent(before, decimals=1)}"
        )
    free = None if estimated.all() else np.eye(len(values))[:, estimated]
    solution = describe_fit(data.equations, values, known, free)
    # Every instant has two rows, of the torque and of the position. As the acceleration is unknown, they are worth one.
    uncertainty = compute_recursive_statistics(run.rows, run.values[-1], initial.known)
    worth = 0.5 * uncertainty.effective_rows
    covariance, freedom = np.zeros((len(values), len(values))), np.full(len(values), np.inf)
    covariance[np.ix_(estimated, estimated)] = uncertainty.covariance
    freedom[estimated] = compute_row_freedom(worth, int(estimated.sum()))
    uncertainty = Statistics(covariance, worth, solution.noise, freedom)
    late = _count_changing(run, uncertainty.standard_deviations[estimated])
    return Fit(
        replace(solution, converged=not late),
        uncertainty,
        _list_warnings(run, uncertainty, initial.share, late, estimated),
    )


def _count_changing(run: KalmanRun, deviations: FloatArray) -> int:
    """Return how many parameters changed by more than a standard deviation over the last tenth of the data."""
    before = run.values[int(0.9 * len(run.times))]
    change = np.abs(run.values[-1] - before) / np.maximum(deviations, np.finfo(float).tiny)
    return int(np.count_nonzero(change > 1.0))


def estimate_noise(data: Data, residual: FloatArray) -> KalmanNoise:
    """Return the noises from the spectra of the recordings, and from the residual (n,) of the initial parameters."""
    spectra_of_all = [estimate_spectra(recording) for recording in data.recordings]
    # White noise of density S over the band up to half the rate has the variance S times that band.
    position = np.max([np.sqrt(spectrum.noise * 0.5 * spectrum.rate) for spectrum in spectra_of_all], axis=0)
    # The torque's noise is the floor of its spectrum at high frequencies, where no motion is left.
    floors = [
        np.sqrt(np.median(spectrum.torque[spectrum.frequency > 0.3 * spectrum.rate], axis=0) * 0.5 * spectrum.rate)
        for spectrum in spectra_of_all
    ]
    blocks = [block for recording in data.recordings for block in filtered_blocks(recording, data.preprocessing)]
    squares = np.sum([np.sum(block.ddq[block.used] ** 2, axis=0) for block in blocks], axis=0)
    used = sum(int(np.count_nonzero(block.used)) for block in blocks)
    return KalmanNoise(
        np.maximum(position, _LEAST_NOISE),
        # What the model leaves counts as noise, too: the filter would otherwise trust the torque too much.
        np.maximum(np.max(floors, axis=0), residual),
        _UNKNOWN * np.sqrt(squares / max(used, 1)),
    )


def _cut_beginning(recordings: tuple[Recording, ...], share: float) -> tuple[Recording, ...]:
    """Return the first share of the data in seconds."""
    spans = [(recording, start, end) for recording in recordings for start, end in _iterate_spans(recording)]
    remaining = share * sum(end - start for _, start, end in spans)
    windows: dict[int, list[tuple[float, float]]] = {}
    for recording, start, end in spans:
        # Spans are used up in their order until the share is reached.
        cut = min(end, start + remaining)
        remaining = max(0.0, remaining - (end - start))
        if cut - start > recording.period:
            windows.setdefault(id(recording), []).append((start, cut))
    return tuple(r.with_windows(tuple(windows[id(r)])) for r in recordings if id(r) in windows)


def _iterate_spans(recording: Recording) -> Iterator[tuple[float, float]]:
    """Yield the first and last time of the used part of every segment, s."""
    for segment in recording.segments:
        start, end = segment.start_time, segment.start_time + segment.length * recording.period
        for low, high in recording.windows or ((start, end),):
            if min(end, high) > max(start, low):
                yield max(start, low), min(end, high)


def _solve_beginning(model: Model, data: Data, known: PriorInformation | None) -> _FilterStart:
    """Solve the beginning of the data by weighted least squares; a prior keeps its certainty."""
    # As little of the data as determines the parameters: the filter shall learn from the rest.
    for share in START_SHARES:
        first = _cut_beginning(data.recordings, share)
        try:
            beginning = reduce_recordings(model.observation, replace(data.inputs, recordings=first))
            solution = solve_weighted(beginning, known)
            break
        except EstimationError:
            if share == START_SHARES[-1]:
                raise
    # The filter needs a covariance of full rank, which one from blocks of time may not have.
    uncertainty = compute_pooled_statistics(beginning, solution)
    estimated = ~solution.is_held
    c = int(estimated.sum())
    covariance = uncertainty.covariance[np.ix_(estimated, estimated)]
    start = build_prior(solution.values[estimated], covariance * _DOUBT**2, np.arange(c), c)
    if known is not None:
        # Widening divides the prior's rows by the factor, too. Adding this much of them gives them their full weight
        # again.
        undoubted = np.sqrt(1.0 - 1.0 / _DOUBT**2)
        rows = known.remove_held()
        start = start.combine_with(PriorInformation(undoubted * rows.factor, undoubted * rows.right))
    return _FilterStart(share, start, uncertainty.noise)


def _list_warnings(
    run: KalmanRun, uncertainty: Statistics, share: float, changing: int, estimated: BoolArray
) -> tuple[str, ...]:
    own = np.maximum(run.deviations[-1], np.finfo(float).tiny)
    whole = f"The Kalman filter used the first {format_percent(share, decimals=0)} of the data for its initial values"
    sentences = [f"{whole}, and processed {run.times[-1]:.1f} s."]
    if estimated.any():
        ratio = np.median(uncertainty.standard_deviations[estimated] / own)
        sentences[0] += f" Its standard deviations are {ratio:.2g} times those of its own covariance (median), which "
        sentences[0] += "assumes that its residuals are white noise of the expected size."
    if changing:
        sentences.append(
            f"{changing} parameters still changed by more than a standard deviation over the last "
            "tenth of the data: the filter has not converged; a longer recording helps."
        )
    return tuple(sentences)
