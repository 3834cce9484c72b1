"""The pass of an extended Kalman filter through recordings, and the torque function that it linearises."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import Signals, build_columns
from dynident.effects.usual_sizes import get_slowest_velocity
from dynident.errors import DynidentError
from dynident.estimation import EstimationError, PriorInformation, Reduction
from dynident.estimation.kalman_filter import KalmanFilter, KalmanNoise, KalmanSample, TorqueSlopes
from dynident.estimation.prior_information import invert_information
from dynident.estimation.qr import compute_r_factor
from dynident.identification.equations.reduce_data import Data
from dynident.recordings import Preprocessing, Recording, filtered_blocks
from dynident.regressors.model import Model
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
                    f"{column.effect} depends on more than position, velocity and acceleration: a filter that takes "
                    "one sample at a time has no state for it. Leave it out, or choose another estimator",
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


def run_filter(
    torque: TorqueFunction, model: Model, data: Data, start: PriorInformation, noise: KalmanNoise
) -> KalmanRun:
    """Let a filter that begins with a prior on χ run through the recordings.

    Parameters
    ----------
    torque : TorqueFunction
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
            "there are too few samples in a row for a filter; use a longer recording",
            pointer="/measurement_ids",
            title="Too few samples",
        )
    surprise = way.surprise / way.samples
    # Written so that a value that is no number counts as divergence.
    if not surprise < _LOST_ON_AVERAGE:
        raise divergence_error(f"its innovations vary {surprise:.2g} times as much as its noises say")
    way.record_state()
    times, values, deviations = (np.array(item) for item in zip(*way.kept, strict=True))
    return KalmanRun(times, values, deviations, rows, surprise)


class _FilterPass:
    """State of the filter on its pass through the recordings, and the record of its parameters."""

    def __init__(
        self, torque: TorqueFunction, model: Model, data: Data, start: PriorInformation, noise: KalmanNoise
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
            raise divergence_error(
                f"from t = {now.t:.2f} s of {recording.name} on it does not follow the motion any more"
            )
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
        f"the Kalman filter diverged: {how}. Begin with better values (the prior description, a longer recording), or "
        "use wls",
        pointer="/estimator",
        title="Divergence",
    )
