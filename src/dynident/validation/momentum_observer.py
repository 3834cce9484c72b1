"""Momentum observer: the torque of contacts from positions and motor torques; its gain (30/s) and its delay.

The observer of De Luca and Mattone (2003) needs positions and motor torques, but no accelerations: the momentum
p = M q̇ changes by τ - friction + ∂T/∂q - g + the torque of contacts, and what the model does not explain of the change,
behind a low-pass, is the residual. Positions and torques pass one more low-pass before, the same for both, whose
derivative is the velocity.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from scipy.linalg import lapack

from dynident.array_types import BoolArray, FloatArray
from dynident.effects.hysteresis_states import MemoryStates
from dynident.errors import DynidentError
from dynident.expressions import Program
from dynident.identification import Estimate, Identification
from dynident.identification.estimators.identified_robot_simulator import read_pieces
from dynident.identification.identified_models.equation_of_motion import build_equation_of_motion
from dynident.recordings import Recording
from dynident.recordings.joint_phases import SLOW

GAIN = 30.0
"""Bandwidth of the residual in 1/s: faster observers follow the noise of positions and torques."""

# Bandwidth of the low-pass before, over that of the residual: it then delays by a quarter of the residual's own time.
SMOOTHING = 4.0
# Time constants of the residual within which a contact is to show: it has then 80 % of its size.
WITHIN = 2.0
# Time constants after which a joint that was slow counts as moving, and after which a start is forgotten.
SETTLED = 3.0


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
        return WITHIN / self.gain

    def reset(self) -> None:
        """Begin a new motion, at rest and without contact."""
        self._memory = MemoryStates(self._memory_signals)
        self._before: tuple[FloatArray, FloatArray, FloatArray, FloatArray] | None = None
        self._since_slow = np.zeros(self._robot.n, dtype=np.intp)  # rows

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
        if q.shape != tau.shape or not len(q):
            raise DynidentError(
                f"q has {len(q)} samples and tau {len(tau)}; give as many of both, at least one", pointer="tau"
            )
        # Backward differences, y - y' = T w (x - y), which are stable for every period.
        rate, gain = self.period * SMOOTHING * self.gain, self.period * self.gain
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
        rows = np.arange(len(dq))[:, None]
        last_slow = np.maximum.accumulate(np.where(np.abs(dq) < SLOW, rows, -1 - self._since_slow))
        self._since_slow = rows[-1] - last_slow[-1]
        return (rows - last_slow) * self.period < SETTLED / self.gain


def _run_first_order(pole: float, inputs: FloatArray, before: FloatArray) -> FloatArray:
    """Return y (m, n) with y[k] = pole y[k - 1] + inputs[k], from y[-1] = before (n,)."""
    # A triangular system of two bands. scipy.signal.lfilter does it too, but its import takes longer than the observer.
    bands = np.stack([np.ones(len(inputs)), np.full(len(inputs), -pole)])
    right_sides = inputs.copy()
    right_sides[0] += pole * before
    return np.asarray(lapack.dtbtrs(bands, right_sides, uplo="L", diag="U")[0])


Run = tuple[ObservedContacts, float]
"""The residual of an uninterrupted motion, and its sampling period in s."""


def observe_recording(identification: Identification, recording: Recording, gain: float = GAIN) -> list[Run]:
    """Return the residual along every unbroken piece of a recording, without its beginning.

    There is none of a recording that lacks the torque of a joint of the model: it is stored as 0, which would look like
    a contact that lasts.

    Parameters
    ----------
    identification : Identification
        The identified model.
    recording : Recording
        The recording.
    gain : float
        Bandwidth of the observer in 1/s.
    """
    if set(recording.joints_without_torque) - set(identification.model.robot.joints_without_torque):
        return []
    # The observer has filters of its own, which see no future samples.
    raw = replace(identification.preprocessing, position_cutoff=None)
    observer = MomentumObserver(identification, 1.0 / recording.sampling_rate, gain)
    first = int(np.ceil(2 * SETTLED / gain * recording.sampling_rate))
    runs = []
    for motion in read_pieces(recording, raw):
        if len(motion.tau) > first:
            observer.reset()
            whole = observer.observe(motion.reference.q, motion.tau)
            later = ObservedContacts(whole.residual[first:], whole.q[first:], whole.dq[first:], whole.slow[first:])
            runs.append((later, observer.period))
    return runs


def compute_step_response(t: FloatArray, gain: float) -> FloatArray:
    """Return the residual of a constant unit torque that begins at t = 0: two low-passes, one behind the other.

    Parameters
    ----------
    t : (m,)
        Times in s.
    gain : float
        Bandwidth of the residual in 1/s.
    """
    fast = SMOOTHING * gain
    return np.asarray(1.0 - (fast * np.exp(-gain * t) - gain * np.exp(-fast * t)) / (fast - gain))
