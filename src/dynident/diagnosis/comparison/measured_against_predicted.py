"""Compare measured with predicted torque along a recording, joint by joint, and list the worst intervals.

Holds how long an interval is (0.5 s), and how many are reported (12).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dynident.array_types import BoolArray, FloatArray, IndexArray
from dynident.effects import get_role
from dynident.errors import DynidentError
from dynident.estimation import Errors, compute_band_distance
from dynident.estimation.parameter_covariance import NORMAL_95
from dynident.identification import Identification
from dynident.identification.identified_models.gravity_from_poses import evaluate_at_rest
from dynident.identification.identified_models.torque_prediction import compute_prediction_deviation
from dynident.number_format import format_percent
from dynident.parallel import single_threaded
from dynident.progress import Progress, ignore_progress
from dynident.recordings import Recording, SampleBlock
from dynident.recordings.all_checks import StopReason
from dynident.recordings.joint_phases import Phase, PhaseArray
from dynident.recordings.low_pass_decimation import filter_in_parallel
from dynident.recordings.pose_recordings import has_poses, read_pose_rows
from dynident.recordings.recording import JointLimits
from dynident.regressors.dynamic_model_rows import SampleFunction
from dynident.regressors.observation_matrix import Observation, RegressorInputs
from dynident.regressors.row_phases import RowPhases, changes_at_rest

# Length of an interval, s, and number of those that are reported.
_INTERVAL = 0.5
_WORST = 12
_CONTACT, _BANDS, _CONTACT_ROWS = 0.1, 3.0, 3
"""Share of a joint's torque limit that a model may be wrong by at most where nothing is touched, also in multiples of
its 95 % band; filtered rows in a row that are beyond both."""


@dataclass(frozen=True)
class WorstInterval:
    """An interval of time in which a joint's residual is large.

    Parameters
    ----------
    joint : str
        Name of the joint.
    start : float
        Start of the interval, s.
    end : float
        End of the interval, s.
    rms : float
        Rms of the residual in it, N m or N.
    ratio : float
        Ratio of that to the joint's rms over the whole recording.
    time : float
        Time at which the residual is largest, s.
    pose : (n,)
        Positions of all joints at that time, rad or m.
    speed : (n,)
        Velocities of all joints at that time, rad/s or m/s.
    """

    joint: str
    start: float
    end: float
    rms: float
    ratio: float
    time: float
    pose: tuple[float, ...]
    speed: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Comparison:
    """Filtered, decimated signals of one recording with the model's prediction.

    Parameters
    ----------
    joint_names : tuple of str
        Names of the n joints.
    units : tuple of str
        Unit of each joint's torque, N m or N.
    t : (m,)
        Times, s.
    segment : (m,)
        Number of the segment of each row.
    measured : (m, n)
        Measured torque behind the filter.
    predicted : (m, n)
        Torque that the model predicts.
    lower : (m, n)
        Lower end of the band that static friction may hold where a joint stands; the prediction elsewhere.
    upper : (m, n)
        Upper end of that band.
    deviation : (m, n)
        Standard deviation of the prediction that the uncertainty of the parameters causes.
    q : (m, n)
        Positions, rad or m.
    dq : (m, n)
        Velocities, rad/s or m/s.
    ddq : (m, n)
        Accelerations, rad/s² or m/s².
    load : (m, n)
        Part of the prediction that the rigid bodies make.
    noise : (n,)
        Standard deviation of the model's residual.
    phase : (m, n)
        Phase of each joint's motion, a `Phase`.
    off_halts : (m, n)
        Rows in which the joint moves, also those nearer to a halt than the filter's width.
    remembering : (n,)
        Joints whose friction remembers the path in this model.
    free : (n,)
        Joints that never stick where they reverse.
    temperature : (m, n), optional
        Temperatures, degC, where they were measured.
    """

    joint_names: tuple[str, ...]
    units: tuple[str, ...]
    t: FloatArray
    segment: FloatArray
    measured: FloatArray
    predicted: FloatArray
    lower: FloatArray
    upper: FloatArray
    deviation: FloatArray
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    load: FloatArray
    noise: FloatArray
    phase: PhaseArray
    off_halts: BoolArray
    remembering: BoolArray
    free: BoolArray
    temperature: FloatArray | None = None

    def __repr__(self) -> str:
        return (
            f"Comparison({len(self.joint_names)} joints, {len(self.t)} rows: relative error "
            f"{format_percent(self.errors.relative_total)}, "
            f"{format_percent(self.moving_errors.relative_total)} where joints move)"
        )

    @property
    def raw_residual(self) -> FloatArray:
        """Measured minus predicted torque (m, n), also at standstill, where the prediction has no sign of friction."""
        return self.measured - self.predicted

    @cached_property
    def residual(self) -> FloatArray:
        """Measured minus predicted torque (m, n); at standstill the distance to the band; 0 without known torque."""
        standing = self.phase == Phase.STANDING
        residual = np.where(standing, compute_band_distance(self.measured, self.lower, self.upper), self.raw_residual)
        # Rows without recorded torque count for nothing: zero keeps them out of every sum.
        return np.where(self.has_torque, residual, 0.0)

    @property
    def has_torque(self) -> BoolArray:
        """Rows (m, n) whose torque was recorded, and may be compared with the model's."""
        return np.asarray(self.phase != Phase.NO_TORQUE)

    @property
    def moving(self) -> BoolArray:
        """Rows (m, n) where the joint moves."""
        return np.asarray(self.phase == Phase.MOVING)

    @property
    def counted_rows(self) -> BoolArray:
        """Rows (m, n) that count for a diagnosis: also at reversals where the joint's friction has a path memory."""
        return np.asarray(self.moving | ((self.phase == Phase.REVERSING) & self.remembering))

    @cached_property
    def counted_residual(self) -> FloatArray:
        """Residual (m, n) on the rows that count for a diagnosis, zero elsewhere."""
        return np.where(self.counted_rows, self.residual, 0.0)

    @property
    def band(self) -> FloatArray:
        """Half-width (m, n) of the 95 % band of the residual, from parameters and residual noise."""
        return np.asarray(NORMAL_95 * np.sqrt(self.deviation**2 + self.noise**2))

    @cached_property
    def errors(self) -> Errors:
        """Errors on the whole recording, by joint."""
        return self._compute_errors(self.residual, self.has_torque)

    @cached_property
    def moving_errors(self) -> Errors:
        """Errors where each joint moves."""
        return self._compute_errors(self.residual, self.moving)

    @cached_property
    def raw_errors(self) -> Errors:
        """Errors on the whole recording, without a band at standstill."""
        return self._compute_errors(self.raw_residual, self.has_torque)

    def _compute_errors(self, residual: FloatArray, rows: BoolArray) -> Errors:
        squares, measured = (residual**2 * rows).sum(axis=0), (self.measured**2 * rows).sum(axis=0)
        return Errors(squares, measured, rows.sum(axis=0).astype(np.float64))

    @cached_property
    def worst(self) -> tuple[WorstInterval, ...]:
        """Half-second intervals with the largest residual relative to the joint's own rms."""
        # Intervals are cut by the clock, so that gaps in the rows do not shift them.
        borders = np.flatnonzero(np.diff(np.floor((self.t - self.t[0]) / _INTERVAL)) != 0) + 1
        parts = [part for part in np.split(np.arange(len(self.t)), borders) if len(part) >= 2]
        rms = self.errors.rms
        local = np.array([np.sqrt((self.residual[part] ** 2).mean(axis=0)) for part in parts]).reshape(-1, len(rms))
        # Relative to each joint's own rms: else the joints of large torque would take all places.
        ratios = np.divide(local, rms, out=np.zeros_like(local), where=rms > 0)
        order = np.argsort(-ratios, axis=None, kind="stable")[:_WORST]
        places = zip(*np.unravel_index(order, ratios.shape), strict=True)
        return tuple(
            self._build_worst_interval(parts[k], int(j), float(local[k, j]), float(ratios[k, j])) for k, j in places
        )

    def _build_worst_interval(self, rows: IndexArray, joint: int, rms: float, ratio: float) -> WorstInterval:
        worst = rows[int(np.argmax(np.abs(self.residual[rows, joint])))]
        return WorstInterval(
            joint=self.joint_names[joint],
            start=float(self.t[rows[0]]),
            end=float(self.t[rows[-1]]),
            rms=rms,
            ratio=ratio,
            time=float(self.t[worst]),
            pose=tuple(self.q[worst].tolist()),
            speed=tuple(self.dq[worst].tolist()),
        )


@single_threaded
def compare(identification: Identification, recording: Recording, progress: Progress = ignore_progress) -> Comparison:
    """Predict the torque along a recording and compare it with the measured one.

    Parameters
    ----------
    identification : Identification
        The identified model.
    recording : Recording
        The recording.
    progress : Progress
        Called with the fraction done and a message; may raise to cancel.

    Returns
    -------
    Comparison
        Measured and predicted torque, row by row.

    Raises
    ------
    DynidentError
        Where no row of the recording is left after filtering.
    """
    robot = identification.model.robot
    n = robot.n
    parts = list(_yield_parts(identification, recording, progress))
    if not parts:
        raise DynidentError(
            f"no rows of {recording.name} are left after filtering; use a longer recording or wider windows",
            pointer="/recordings",
            title="Too few samples",
        )
    t, segment, signals = (np.concatenate(items) for items in zip(*parts, strict=True))
    # The parts hold all signals side by side in this order, n columns each; temperatures come last where there are any.
    measured, predicted, lower, upper, deviation, q, dq, ddq, load, phase, off_halts, *more = (
        signals[:, k * n : (k + 1) * n] for k in range(signals.shape[1] // n)
    )
    phases = RowPhases.from_recording(identification.model.observation, recording, identification.preprocessing)
    return Comparison(
        joint_names=robot.joint_names,
        units=tuple(joint.effort_unit for joint in robot.joints),
        t=t,
        segment=segment,
        measured=measured,
        predicted=predicted,
        lower=lower,
        upper=upper,
        deviation=deviation,
        q=q,
        dq=dq,
        ddq=ddq,
        load=load,
        noise=identification.noise,
        phase=phase.astype(np.int8),
        off_halts=off_halts > 0,
        remembering=phases.remembering,
        free=phases.free,
        temperature=more[0] if more else None,
    )


def predict_again(
    comparison: Comparison, observation: Observation, values: FloatArray, inputs: RegressorInputs
) -> Comparison:
    """Return a comparison with the prediction of other columns, where its joint moves; at rest it stays as it was.

    Parameters
    ----------
    comparison : Comparison
        The comparison.
    observation : Observation
        The columns W.
    values : (b,)
        Their parameters.
    inputs : RegressorInputs
        The recording that is compared, the model's filters, and what torque is predicted with.
    """
    (recording,) = inputs.recordings
    phases = RowPhases.from_recording(observation, recording, inputs.preprocessing)
    entries = SampleFunction(observation, inputs.reference, recording, phases)
    pieces = filter_in_parallel(recording, inputs.preprocessing, entries, width=len(observation.entry_rows))
    predicted = np.concatenate([observation.compute_torque(rows, values) for _, _, rows in pieces])
    return replace(comparison, predicted=predicted, remembering=phases.remembering, free=phases.free)


def _yield_parts(
    identification: Identification, recording: Recording, progress: Progress
) -> Iterator[tuple[FloatArray, FloatArray, FloatArray]]:
    """Yield times, segment numbers and the signals side by side, as they leave the filter."""
    # Poses at rest have no motion that could be filtered.
    if has_poses(recording):
        yield _compare_poses(identification, recording)
        return
    observation, at_rest = identification.model.observation, identification.model.at_rest
    phases = RowPhases.from_recording(observation, recording, identification.preprocessing)
    entries = SampleFunction(observation, identification.estimate.reference, recording, phases)
    resting = SampleFunction(at_rest, identification.estimate.reference, recording)
    looked_at = phases.with_friction_of(phases.frictional)
    rigid = np.array([get_role(column) == "link" for column in observation.columns])
    load_values = np.where(rigid, identification.values, 0.0)
    # At standstill friction holds anything between its two directions. So the prediction is split into what does not
    # depend on the direction and the effects that do, taken both ways.
    unchanged = np.where(changes_at_rest(at_rest), 0.0, identification.values)
    covariance = identification.statistics.covariance
    n_entries, n = len(observation.entry_rows), observation.robot.n
    first = n_entries + len(at_rest.entry_rows)

    # Columns, torque and motion pass the same filter side by side, so that no delay comes between them.
    def values(block: SampleBlock) -> FloatArray:
        more = [] if block.temperature is None else [block.temperature]
        w = entries(block)
        return np.hstack([w, resting(block), entries.read_torque(block), block.q, block.dq, block.ddq, *more])

    end = recording.segments[-1].start_time + recording.segments[-1].length * recording.period
    start = recording.segments[0].start_time
    for segment, t, rows in filter_in_parallel(recording, identification.preprocessing, values, width=first + 4 * n):
        w = rows[:, :n_entries]
        predicted = observation.compute_torque(w, identification.values)
        load = observation.compute_torque(w, load_values)
        deviation = compute_prediction_deviation(observation, w, covariance)
        phase = phases.phases_at(int(segment), t)
        off_halts = looked_at.find_valid_samples(int(segment), t)
        base, either = (
            observation.compute_torque(w, unchanged),
            at_rest.compute_torque(rows[:, n_entries:first], identification.values),
        )
        # Both directions of friction; which of them is the larger torque depends on the sign of the parameters.
        band = [np.where(phase == Phase.STANDING, base + way, predicted) for way in (either[:, n:], either[:, :n])]
        lower, upper = np.minimum(*band), np.maximum(*band)
        # Behind the entries of both sets of columns stand torque and motion, in the order of `values`.
        measured = rows[:, first : first + n]
        motion, more = rows[:, first + n : first + 4 * n], rows[:, first + 4 * n :]
        progress(min(1.0, (t[-1] - start) / max(end - start, 1e-9)), f"predicting {recording.name}")
        yield (
            t,
            np.full(len(t), float(segment)),
            np.hstack([measured, predicted, lower, upper, deviation, motion, load, phase, off_halts, more]),
        )


def _compare_poses(identification: Identification, recording: Recording) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the same for poses at rest, whose rows are equations as they are."""
    t, q, measured = read_pose_rows(recording)
    model, still = identification.model, np.zeros_like(q)
    entries = evaluate_at_rest(model, q)
    predicted = model.observation.compute_torque(entries, identification.values)
    rigid = np.array([get_role(column) == "link" for column in model.kept])
    load = model.observation.compute_torque(entries, np.where(rigid, identification.values, 0.0))
    deviation = compute_prediction_deviation(model.observation, entries, identification.statistics.covariance)
    # Poses at rest are equations of the model as they are, and count like rows that move.
    rows = np.full_like(q, float(Phase.MOVING))
    parts = [measured, predicted, predicted, predicted, deviation, q, still, still, load, rows, still + 1.0]
    return t, np.zeros(len(t)), np.hstack(parts)


def find_contacts(comparison: Comparison, limits: Sequence[JointLimits]) -> list[StopReason]:
    """Return the joints whose torque a model does not explain by far: something was touched, or is mounted unsaid.

    Parameters
    ----------
    comparison : Comparison
        A recording against a model that was identified before it.
    limits : sequence of JointLimits
        Limits of the n joints. Where the torque's is not known, the largest measured torque counts as it.

    Returns
    -------
    list of StopReason
        One for each joint, the one with the earliest contact first.
    """
    excess, contacts = np.abs(comparison.counted_residual), []
    for j, (name, limit) in enumerate(zip(comparison.joint_names, limits, strict=True)):
        largest = limit.effort or float(np.abs(comparison.measured[:, j]).max(initial=0.0))
        beyond = excess[:, j] > np.maximum(_CONTACT * largest, _BANDS * comparison.band[:, j])
        runs = np.convolve(beyond, np.ones(_CONTACT_ROWS), mode="valid") == _CONTACT_ROWS
        if runs.any():
            k = int(np.argmax(runs))
            worst = float(excess[k : k + _CONTACT_ROWS, j].max())
            detail = (
                f"From {comparison.t[k]:.2f} s on, the torque of {name} is {worst:.3g} "
                f"{comparison.units[j]} off what the model of the earlier runs predicts: did it touch something?"
            )
            contacts.append((comparison.t[k], StopReason("contact", name, detail)))
    return [reason for _, reason in sorted(contacts, key=lambda contact: contact[0])]
