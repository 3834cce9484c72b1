"""Momentum observer: the smallest contact force that it detects, its delay and false alarms; its gain (30/s).

The observer of De Luca and Mattone (2003) needs positions and motor torques, but no accelerations: the momentum
p = M q̇ changes by τ - friction + ∂T/∂q - g + the torque of contacts, and what the model does not explain of the change,
behind a low-pass, is the residual. Positions and torques pass one more low-pass before, the same for both, whose
derivative is the velocity. Thresholds come from the residual on held-out recordings, by joint, apart for joints that
move slowly or have just done so and for three classes of speed: friction at reversals must not blunt the whole motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from dynident.array_types import BoolArray, FloatArray
from dynident.effects.hysteresis_states import MemoryStates
from dynident.errors import DynidentError
from dynident.expressions import Program
from dynident.identification import Estimate, Identification
from dynident.identification.estimators.identified_robot_simulator import read_longest_piece
from dynident.identification.identified_models.equation_of_motion import build_equation_of_motion
from dynident.number_format import format_percent
from dynident.parallel import single_threaded
from dynident.recordings import Recording
from dynident.recordings.joint_phases import SLOW
from dynident.robot import Robot
from dynident.verdict.detectable_loads import (
    FALSE_ALARMS_AN_HOUR,
    FEWEST_BLOCKS,
    SEEN,
    compute_threshold,
    compute_tool_jacobian,
    draw_unit_forces,
)
from dynident.verdict.held_out_evidence import LONGEST

GAIN = 30.0
"""Bandwidth of the residual in 1/s: faster observers follow the noise of positions and torques."""

# Bandwidth of the low-pass before, over that of the residual: it then delays by a quarter of the residual's own time.
_SMOOTHING = 4.0
# Time constants of the residual within which a contact is to show: it has then 80 % of its size.
_WITHIN = 2.0
# Time constants after which a joint that was slow counts as moving, and after which a start is forgotten.
_SETTLED = 3.0
_BLOCK = 1.0
_SPEED_CLASSES = 3
_POSTURES = 200


@dataclass(frozen=True, eq=False)
class ObservedContacts:
    """Residual of a motion.

    Parameters
    ----------
    residual : (m, n)
        Torque of contacts at the joints, in N m or N; positive where it drives q.
    q, dq : (m, n)
        Positions and velocities behind the observer's low-pass.
    slow : (m, n)
        Whether a joint moves slowly or has just done so.
    """

    residual: FloatArray
    q: FloatArray
    dq: FloatArray
    slow: BoolArray


class MomentumObserver:
    """Observer of the torque of contacts, sample by sample or along a motion.

    Parameters
    ----------
    model : Identification or Estimate
        The identified model.
    period : float
        Sampling period in s.
    gain : float
        Bandwidth of the residual in 1/s.

    Raises
    ------
    DynidentError
        For a period or a gain that is not above 0, or effects that depend on time, temperature or the run.

    Examples
    --------
    >>> observer = MomentumObserver(model, period=0.002)      # doctest: +SKIP
    >>> torque = observer.step(q, tau)  # (n,), every sample  # doctest: +SKIP
    """

    def __init__(self, model: Identification | Estimate, period: float, gain: float = GAIN) -> None:
        for name, number in (("period", period), ("gain", gain)):
            if not (np.isfinite(number) and number > 0):
                raise DynidentError(f"{name} is {number}; give a number above 0", pointer=f"/{name}")
        estimate = model.estimate if isinstance(model, Identification) else model
        equation = build_equation_of_motion(estimate)
        if equation.observer_obstacle:
            raise DynidentError(
                f"{equation.observer_obstacle}, which a contact observer does not know", pointer="/effects"
            )
        self.period, self.gain = period, gain
        self._robot, self._memory_signals = equation.robot, estimate.model.observation.memory
        constants = [
            (equation.base, ca.SX(ca.DM(estimate.values))),
            (equation.payload, ca.SX.zeros(equation.payload.numel(), 1)),
        ]
        constants += [(a.symbol, ca.SX(period)) for a in equation.arguments if a.name == "period"]
        terms = equation.build_observer_terms()
        for symbol, value in constants:
            terms = ca.substitute(terms, symbol, value)
        z = [a.symbol for a in equation.arguments if a.name == "z"] or [ca.SX.sym("z", 0)]
        self._terms = Program([equation.get_symbol("q"), equation.get_symbol("dq"), z[0]], terms)
        self._has_memory = any(a.name == "z" for a in equation.arguments)
        self.reset()

    @property
    def within(self) -> float:
        """Seconds within which a contact shows in the residual with four fifths of its size."""
        return _WITHIN / self.gain

    def reset(self) -> None:
        """Begin a new motion, at rest and without contact."""
        self._memory = MemoryStates(self._memory_signals)
        self._before: tuple[FloatArray, FloatArray, FloatArray, FloatArray] | None = None
        self._since_slow = np.zeros(self._robot.n)

    def step(self, q: FloatArray, tau: FloatArray) -> FloatArray:
        """Return the residual (n,) after the next sample: positions q (n,) and motor torques tau (n,)."""
        rows = [np.asarray(values, dtype=np.float64)[None] for values in (q, tau)]
        return np.asarray(self.observe(*rows).residual[0])

    def observe(self, q: FloatArray, tau: FloatArray) -> ObservedContacts:
        """Return the residual of the next m samples of a motion: q and tau (m, n), every `period`."""
        n = self._robot.n
        for name, values in (("q", q), ("tau", tau)):
            if values.ndim != 2 or values.shape[1] != n:
                raise DynidentError(
                    f"{name} has the shape {values.shape}; give (m, {n}), a value a joint", pointer=name
                )
        # Backward differences, y - y' = T w (x - y), which are stable for every period.
        rate, gain = self.period * _SMOOTHING * self.gain, self.period * self.gain
        smoothing, smooth_pole, residual_pole = rate / (1 + rate), 1 / (1 + rate), 1 / (1 + gain)
        q_before, tau_before, p_before, r_before = self._before or (q[0], tau[0], None, np.zeros(n))
        smooth = [
            _run_first_order(smooth_pole, smoothing * values, before)
            for values, before in ((q, q_before), (tau, tau_before))
        ]
        dq = np.diff(smooth[0], axis=0, prepend=q_before[None]) / self.period
        states = self._memory.push(self._robot.positions(smooth[0])) if self._has_memory else np.zeros((len(q), 0))
        terms = self._terms(smooth[0], dq, states)
        p, known = terms[:, :n], terms[:, n:] + smooth[1]
        change = np.diff(p, axis=0, prepend=p[:1] if p_before is None else p_before[None]) - self.period * known
        # The first sample has no momentum before it.
        if p_before is None:
            change[0] = 0.0
        residual = _run_first_order(residual_pole, self.gain * residual_pole * change, r_before)
        self._before = (smooth[0][-1], smooth[1][-1], p[-1], residual[-1])
        return ObservedContacts(residual, smooth[0], dq, self._find_slow(dq))

    def _find_slow(self, dq: FloatArray) -> BoolArray:
        slow, settled = np.empty(dq.shape, dtype=bool), _SETTLED / self.gain
        for k, row in enumerate(np.abs(dq) < SLOW):
            self._since_slow = np.where(row, 0.0, self._since_slow + self.period)
            slow[k] = self._since_slow < settled
        return slow


def _run_first_order(pole: float, inputs: FloatArray, before: FloatArray) -> FloatArray:
    """Return y (m, n) with y[k] = pole y[k - 1] + inputs[k], from y[-1] = before (n,)."""
    # A triangular system of two bands. scipy.signal.lfilter does it too, but its import takes longer than the observer.
    bands = np.stack([np.ones(len(inputs)), np.full(len(inputs), -pole)])
    right_sides = inputs.copy()
    right_sides[0] += pole * before
    return np.asarray(lapack.dtbtrs(bands, right_sides, uplo="L", diag="U")[0])


@dataclass(frozen=True, eq=False)
class ContactDetection:
    """Thresholds of a momentum observer, and the force at the tool that they detect.

    Parameters
    ----------
    force : float
        Force in N at the tool that shows in nearly all postures and directions of the held-out motion.
    within : float
        Seconds within which it shows.
    false_alarms_an_hour : float
        Rate that the thresholds are made for.
    gain : float
        Bandwidth of the observer in 1/s.
    speeds : (n, 2)
        Speeds, in rad/s or m/s, between the three classes of each joint.
    thresholds : (n, 4)
        Thresholds on each joint's residual, in N m or N: where it is slow or has just been, then by class of speed.
        Infinite where the joint was not recorded long enough.
    seconds : float
        Held-out motion in s that they come from.
    """

    force: float
    within: float
    false_alarms_an_hour: float
    gain: float
    speeds: FloatArray
    thresholds: FloatArray
    seconds: float

    def compute_thresholds(self, observed: ObservedContacts) -> FloatArray:
        """Return the threshold (m, n) of every sample."""
        return np.take_along_axis(self.thresholds.T, _find_classes(observed, self.speeds), axis=0)

    def find_contacts(self, observed: ObservedContacts) -> BoolArray:
        """Return whether each joint's residual is beyond its threshold (m, n)."""
        return np.asarray(np.abs(observed.residual) > self.compute_thresholds(observed))

    def describe(self) -> str:
        """Describe what is detected, in a sentence."""
        rate = f"{self.false_alarms_an_hour:g} false alarm{'' if self.false_alarms_an_hour == 1 else 's'} an hour"
        # Two digits, but no power of ten.
        force = float(f"{self.force:.2g}")
        return (
            f"A momentum observer detects {force:g} N at the tool in {1e3 * self.within:.0f} ms, with {rate} (in "
            f"{format_percent(SEEN, decimals=0)} of directions and postures of the held-out motion)."
        )


@single_threaded
def calibrate_contact_detection(
    identification: Identification,
    recordings: Sequence[Recording],
    *,
    false_alarms_an_hour: float = FALSE_ALARMS_AN_HOUR,
    gain: float = GAIN,
) -> ContactDetection | None:
    """Find thresholds for a momentum observer on held-out recordings, and the force at the tool that they detect.

    Parameters
    ----------
    identification : Identification
        The identified model.
    recordings : sequence of Recording
        Held-out recordings without contacts.
    false_alarms_an_hour : float
        False alarms an hour, of all joints together, that the thresholds are to keep to with a confidence of 95 %.
    gain : float
        Bandwidth of the observer in 1/s.

    Returns
    -------
    ContactDetection or None
        None where the recordings are too short for any threshold, or no joint feels a force at the tool.

    Raises
    ------
    DynidentError
        As `MomentumObserver` does; or for a rate that is not above 0.
    """
    if not (np.isfinite(false_alarms_an_hour) and false_alarms_an_hour > 0):
        raise DynidentError(
            f"false_alarms_an_hour is {false_alarms_an_hour}; give a number above 0", pointer="/false_alarms_an_hour"
        )
    robot = identification.model.robot
    observed = [_observe_recording(identification, recording, gain) for recording in recordings]
    runs = [run for run in observed if run is not None]
    if not runs:
        return None
    speeds = np.array([_split_speeds([run for run, _ in runs], joint) for joint in range(robot.n)])
    # Every joint has its share of the false alarms, and pays it in every class: rates are those a second of its own.
    share = false_alarms_an_hour / 3600.0 * _BLOCK / robot.n
    thresholds = np.array([_compute_joint_thresholds(runs, speeds, joint, share) for joint in range(robot.n)])
    seconds = float(sum(len(run.residual) * period for run, period in runs))
    silent = ContactDetection(np.inf, _WITHIN / gain, false_alarms_an_hour, gain, speeds, thresholds, seconds)
    force = _compute_force(robot, runs, silent)
    return None if force is None else replace(silent, force=force)


def _observe_recording(
    identification: Identification, recording: Recording, gain: float
) -> tuple[ObservedContacts, float] | None:
    """Return the residual along the longest segment, without its beginning, and the sampling period."""
    # The observer has filters of its own, which see no future samples.
    raw = replace(identification.preprocessing, position_cutoff=None)
    motion = read_longest_piece(recording, raw, LONGEST)
    observer = MomentumObserver(identification, 1.0 / recording.sampling_rate, gain)
    observed = observer.observe(motion.reference.q, motion.tau)
    first = int(np.ceil(2 * _SETTLED / gain * recording.sampling_rate))
    if len(observed.residual) <= first:
        return None
    later = ObservedContacts(observed.residual[first:], observed.q[first:], observed.dq[first:], observed.slow[first:])
    return later, observer.period


def _split_speeds(runs: Sequence[ObservedContacts], joint: int) -> FloatArray:
    """Return the speeds (2,) that split the samples in which a joint moves into three classes of equal size."""
    moving = np.concatenate([np.abs(run.dq[~run.slow[:, joint], joint]) for run in runs])
    if not len(moving):
        return np.full(_SPEED_CLASSES - 1, np.inf)
    return np.asarray(np.quantile(moving, np.arange(1, _SPEED_CLASSES) / _SPEED_CLASSES))


def _find_classes(observed: ObservedContacts, speeds: FloatArray) -> NDArray[np.intp]:
    """Return (m, n): 0 where a joint is slow or has just been, else 1, 2, 3 by its speed."""
    classes = 1 + (np.abs(observed.dq)[..., None] > speeds).sum(axis=-1)
    return np.where(observed.slow, 0, classes)


def _compute_joint_thresholds(
    runs: Sequence[tuple[ObservedContacts, float]], speeds: FloatArray, joint: int, share: float
) -> FloatArray:
    """Return the thresholds (4,) of a joint, one a class."""
    maxima_by_class: list[list[FloatArray]] = [[] for _ in range(_SPEED_CLASSES + 1)]
    whole: list[FloatArray] = []
    for run, period in runs:
        size, classes = np.abs(run.residual[:, joint]), _find_classes(run, speeds)[:, joint]
        whole.append(_compute_block_maxima(size, period))
        for k, maxima in enumerate(maxima_by_class):
            maxima.append(_compute_block_maxima(size[classes == k], period))
    if sum(len(maxima) for maxima in whole) < FEWEST_BLOCKS:
        return np.full(_SPEED_CLASSES + 1, np.inf)
    of_all = compute_threshold([maxima for maxima in whole if len(maxima)], share)
    # A class with too few seconds has no tail of its own; the joint's as a whole stands for it.
    return np.array(
        [
            compute_threshold([part for part in maxima if len(part)], share)
            if sum(len(part) for part in maxima) >= FEWEST_BLOCKS
            else of_all
            for maxima in maxima_by_class
        ]
    )


def _compute_block_maxima(values: FloatArray, period: float) -> FloatArray:
    """Return the largest value of each whole block of a second, of samples that follow each other in a class."""
    length = max(1, round(_BLOCK / period))
    count = len(values) // length
    return np.asarray(values[: count * length].reshape(count, length).max(axis=1, initial=0.0))


def _compute_force(
    robot: Robot, runs: Sequence[tuple[ObservedContacts, float]], detection: ContactDetection
) -> float | None:
    """Return the force in N that shows within the stated time in nearly all postures and directions."""
    least: list[FloatArray] = []
    each = max(1, _POSTURES // len(runs))
    for run, period in runs:
        window = max(1, round(detection.within / period))
        starts = np.linspace(0, len(run.q) - window - 1, each).astype(np.intp)
        if len(run.q) <= window + 1:
            continue
        jacobian = compute_tool_jacobian(robot, run.q[starts])
        forces = draw_unit_forces(jacobian)
        if forces is None:
            return None
        torque = np.einsum("mdi,mij->mdj", forces, jacobian)
        thresholds = detection.compute_thresholds(run)
        response = _compute_step_response(period * np.arange(1.0, window + 1.0), detection.gain)
        for start, unit in zip(starts, torque, strict=True):
            rows = slice(start + 1, start + 1 + window)
            # The residual is there already, and helps or hinders the force on its way to the threshold.
            margin = thresholds[rows, None, :] - np.sign(unit) * run.residual[rows, None, :]
            with np.errstate(divide="ignore", invalid="ignore"):
                needed = np.maximum(margin, 0.0) / (np.abs(unit) * response[:, None, None])
            least.append(np.nan_to_num(needed, nan=np.inf, posinf=np.inf).min(axis=(0, 2)))
    if not least:
        return None
    # Between two forces that are infinite there is none.
    with np.errstate(invalid="ignore"):
        force = float(np.quantile(np.concatenate(least), SEEN))
    return force if np.isfinite(force) else None


def _compute_step_response(t: FloatArray, gain: float) -> FloatArray:
    """Return the residual of a constant unit torque that begins at t = 0: two low-passes, one behind the other."""
    fast = _SMOOTHING * gain
    return np.asarray(1.0 - (fast * np.exp(-gain * t) - gain * np.exp(-fast * t)) / (fast - gain))
