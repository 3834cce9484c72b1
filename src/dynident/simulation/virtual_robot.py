"""`VirtualRobot`: controller, feed forward and time stepping; the longest step (0.25 ms), and when it is lost.

The controller feeds torque forward; its gains follow from the inertia.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dynident.array_types import FloatArray, IndexArray
from dynident.effects import get_effect
from dynident.errors import DynidentError
from dynident.progress import Progress, ignore_progress
from dynident.robot.robot_model import Robot, compute_currents
from dynident.simulation.reference_motion import Reference, ReferencePath, check_reference
from dynident.simulation.sensors import (
    SensorEffects,
    check_sensors,
    compute_noise_deviation,
    draw_sampling_steps,
    quantise_positions,
)
from dynident.simulation.simulated_recording import SimulatedRecording, Truth
from dynident.simulation.true_effects import TrueEffect, select_inertias
from dynident.simulation.virtual_robot_dynamics import Dynamics, Step, build_dynamics, build_first_state, build_step
from dynident.simulation.virtual_robot_request import FeedForward, Sensors

# States of the trajectory that the gains are derived from.
_STATES = 200
# A joint is never controlled faster than this, rad/s, whatever its friction: internal steps must resolve the control.
_FASTEST = 400.0
# Samples a second of the feed-forward torque, as a robot's own controller has them.
FEED_FORWARD_RATE = 1000.0


@dataclass(frozen=True)
class Controller:
    """Independent joint control with feed-forward.

    The controller knows the links but neither the friction nor any other effect, hence a realistic tracking error.

    Parameters
    ----------
    feed_forward : {"computed_torque", "gravity", "none"}
        What the controller knows of the torque: all that the links need, what holds them against gravity, or nothing.
    bandwidth : float
        Natural frequency of a joint's error, Hz.
    damping_ratio : float
        Damping ratio of a joint's error; 1 is critical damping.
    largest_lag : float
        A joint whose friction would hold it back by more than this (rad or m) is controlled more stiffly.
    """

    feed_forward: FeedForward = "computed_torque"
    bandwidth: float = 15.0
    damping_ratio: float = 1.0
    largest_lag: float = 1.5e-3


@dataclass(frozen=True, eq=False)
class Gains:
    """Stiffness and damping (n,) of the joint controller: N m/rad and N m s/rad, or N/m and N s/m."""

    stiffness: FloatArray
    damping: FloatArray


def compute_joint_gains(controller: Controller, dynamics: Dynamics, path: ReferencePath, times: FloatArray) -> Gains:
    """Return the gains for the mean inertia of each joint along the motion, sampled at times (k,) within it.

    Parameters
    ----------
    controller : Controller
        The joint controller.
    dynamics : Dynamics
        Equation of motion of the robot.
    path : ReferencePath
        The reference at any time.
    times : (k,)
        Times within the motion, s.
    """
    # The gains need a mean over the motion, not every sample: some 200 states are enough.
    sampled_times = times[:: max(1, len(times) // _STATES)]
    q, dq, _ = path.evaluate(sampled_times)
    states = len(sampled_times)
    # Each joint is controlled by itself, so the diagonal of the mass matrix stands for the inertia that it moves.
    inertia = dynamics.mass_diagonal(q).mean(axis=0)
    load = dynamics.rigid(q, np.zeros_like(q), np.zeros_like(q))
    heat = path.evaluate_temperature(sampled_times)
    # Hysteresis fully tensioned and every effect present: the largest resistance that the controller may meet.
    memory = np.ones((states, len(dynamics.signals.memory_signals)))
    still = np.zeros_like(q)
    runs = np.ones((states, len(dynamics.runs)))
    resistance = np.abs(dynamics.rest(q, dq, still, load, memory, sampled_times[:, None], heat, runs)).max(axis=0)
    least_frequency = 2 * np.pi * controller.bandwidth
    # The static error is resistance / stiffness, and stiffness = inertia * frequency².
    frequency = np.clip(
        np.sqrt(resistance / controller.largest_lag / inertia), least_frequency, max(least_frequency, _FASTEST)
    )
    # Stiffness m w² and damping 2 d m w: the gains of a second-order system of inertia m, frequency w and damping ratio
    # d.
    return Gains(inertia * frequency**2, 2 * controller.damping_ratio * inertia * frequency)


def compute_feed_forward_torque(
    controller: Controller, dynamics: Dynamics, path: ReferencePath, t: FloatArray
) -> FloatArray:
    """Return the feed-forward torque (k, n) at times t (k,).

    Parameters
    ----------
    controller : Controller
        The joint controller.
    dynamics : Dynamics
        Equation of motion of the robot.
    path : ReferencePath
        The reference at any time.
    t : (k,)
        Times, s.
    """
    q, dq, ddq = path.evaluate(t)
    if controller.feed_forward == "none":
        return np.zeros_like(q)
    if controller.feed_forward == "gravity":
        return dynamics.rigid(q, np.zeros_like(q), np.zeros_like(q))
    return dynamics.rigid(q, dq, ddq)


LONGEST_STEP = 0.25e-3
"""Longest internal step, s."""

_CHUNK = 1000
_FREE_CHUNK = 256
"""Steps that free motions from many starts take at once; their samples are kept for so long."""
# A joint this far from its reference (rad or m) is not following it any more.
_LOST = 0.5


class VirtualRobot:
    """A robot with known parameters and any effects of the catalogue, under joint control.

    The torque of its drives is that of M(q) ddq + c(q, dq) + all effects. It is what is measured, except for
    effects of the measurement, such as a delayed torque.

    Parameters
    ----------
    robot : Robot
        The robot, as its description gives it.
    effects : sequence of TrueEffect
        What acts besides the links, such as friction and rotor inertia.
    inertias : (n, 10), optional
        Inertial parameters of the links; those of the description where none are given.
    controller : Controller
        The joint controller; the default one where left out.
    longest_step : float
        Longest internal step in s.
    speeds : (n,), optional
        Speeds in rad/s or m/s beyond which friction does not fall, since no recording shows it there.

    Raises
    ------
    DynidentError
        For effects or inertial parameters that do not fit the robot.
    """

    def __init__(
        self,
        robot: Robot,
        effects: Sequence[TrueEffect] = (),
        *,
        inertias: FloatArray | None = None,
        controller: Controller | None = None,
        longest_step: float = LONGEST_STEP,
        speeds: FloatArray | None = None,
    ) -> None:
        robot.require_fixed_base("simulation")
        self.robot = robot
        self.effects = tuple(effects)
        self.inertias = select_inertias(robot, inertias)
        self.controller = Controller() if controller is None else controller
        self.longest_step = longest_step
        self.dynamics: Dynamics = build_dynamics(robot, self.effects, self.inertias, speeds)
        self.sensing = SensorEffects.from_effects(self.effects, self.inertias, self.dynamics.signals)

    def measure(
        self,
        reference: Reference,
        sensors: Sensors | None = None,
        *,
        run: str = "",
        seed: int = 0,
        progress: Progress = ignore_progress,
    ) -> SimulatedRecording:
        """Let the robot follow a trajectory and record it.

        Parameters
        ----------
        reference : Reference
            It should begin at rest; the robot begins on it. Its time is that of the session.
        sensors : Sensors
            The sensors; the default ones where left out.
        run : str
            Label of this run: effects that act in some runs alone act in it where they name it.
        seed : int
            Of the noise and the jitter.
        progress : Progress
            Called a few times a simulated second; may raise to cancel.

        Returns
        -------
        SimulatedRecording
            What the sensors show, beside what really happened.

        Raises
        ------
        DynidentError
            Where trajectory or sensors do not fit the robot, or it cannot follow the trajectory.
        """
        sensors = Sensors() if sensors is None else sensors
        check_reference(reference, self.robot)
        check_sensors(sensors, self.robot)
        self._check_temperature(reference)
        rng = np.random.default_rng(seed)
        period = 1.0 / sensors.sampling_rate
        # The tolerance keeps a period that is a whole number of steps from rounding up to one more.
        steps_per_sample = max(1, int(np.ceil(period / self.longest_step - 1e-9)))
        n_samples = int(np.floor(reference.duration / period + 1e-9)) + 1
        steps = draw_sampling_steps(sensors, steps_per_sample, n_samples, rng)
        path = ReferencePath(reference)
        samples = self._follow(path, reference, period / steps_per_sample, steps, run, progress)
        n = self.robot.n
        truth = Truth(*(np.ascontiguousarray(samples[:, k * n : (k + 1) * n]) for k in range(4)))
        t = reference.t[0] + steps * (period / steps_per_sample)
        noise = compute_noise_deviation(sensors, self.robot, truth.tau)
        sensor_torque = self.sensing.compute_torque(t, truth, path.evaluate_temperature(t), run)
        # The order of the draws, jitter before noise, is part of what a seed means: another order would give other
        # recordings.
        tau = sensor_torque + noise * rng.standard_normal(sensor_torque.shape)
        return SimulatedRecording(
            robot=self.robot,
            t=t,
            q=quantise_positions(sensors, self.robot, truth.q),
            tau=tau,
            current=compute_currents(self.robot, tau) if sensors.current else None,
            temperature=None if reference.temperature is None else path.evaluate_temperature(t),
            truth=truth,
            noise=noise,
            tracking_error=np.abs(truth.q - path.evaluate(t)[0]).max(axis=0),
        )

    def move_freely(
        self,
        starts: Sequence[Reference],
        tau: FloatArray,
        h: float,
        *,
        memory: FloatArray | None = None,
        runs: Sequence[str] = (),
        returned: IndexArray | None = None,
        progress: Progress = ignore_progress,
    ) -> tuple[FloatArray, FloatArray]:
        """Integrate the equation of motion under given torques, without a controller, from k starts side by side.

        Parameters
        ----------
        starts : sequence of Reference
            Time, position, velocity and acceleration to begin with are those of the first sample of each; the
            temperature of the joints stays what it is there.
        tau : (m, k, n)
            Torque of the drives at every step, the first one at the start.
        h : float
            Length of a step in s.
        memory : (k, z), optional
            States of the hysteresis at the starts, in the order of the model's signals; relaxed where left out.
        runs : sequence of str, optional
            Label of the run of each, for effects that act in some runs alone.
        returned : (r,), optional
            Numbers of the steps to return, ascending; all by default.
        progress : Progress
            Called with the fraction done and a message.

        Returns
        -------
        q, dq : (r, k, n) arrays
            Positions and velocities.
        """
        n, (steps, count) = self.robot.n, tau.shape[:2]
        returned = np.arange(steps) if returned is None else returned
        states = np.array([build_first_state(self.dynamics, s.q[0], s.dq[0], s.ddq[0], h) for s in starts])
        if memory is not None:
            # The state is [q, v, a, q_last, z, directions], so that the hysteresis follows four entries a joint.
            states[:, 4 * n : 4 * n + memory.shape[1]] = memory
        first = np.array([start.t[0] for start in starts])
        warm = np.array([np.zeros(n) if start.temperature is None else start.temperature[0] for start in starts])
        present = np.array([self._mark_present_runs(run) for run in runs or [""] * count])
        out = np.empty((len(returned), count, 2 * n))
        # Chunks bound the memory of the samples, and report progress.
        for begin in range(0, steps, _FREE_CHUNK):
            progress(begin / steps, "simulating without a controller")
            chunk = tau[begin : begin + _FREE_CHUNK]
            inputs = np.zeros((len(chunk), count, 4 * n + 1 + self._n_runs))
            # With gains of zero the reference does not matter, and the torque takes the place of the feed-forward.
            inputs[:, :, 2 * n : 3 * n] = chunk
            inputs[:, :, 3 * n] = first + h * np.arange(begin, begin + len(chunk))[:, None]
            inputs[:, :, 3 * n + 1 : 4 * n + 1], inputs[:, :, 4 * n + 1 :] = warm, present
            states, samples = self._step.run_many(states, inputs, h, np.zeros(n), np.zeros(n))
            ends = np.searchsorted(returned, [begin, begin + len(chunk)])
            out[slice(*ends)] = samples[returned[slice(*ends)] - begin, :, : 2 * n]
        return out[:, :, :n], out[:, :, n:]

    @property
    def _n_runs(self) -> int:
        return len(self.dynamics.runs)

    def _mark_present_runs(self, run: str) -> FloatArray:
        """Return (runs,): 1 for every run signal that the run with that label has."""
        return np.array([float(not signal.runs or run in signal.runs) for signal in self.dynamics.runs])

    @cached_property
    def _step(self) -> Step:
        return build_step(self.dynamics)

    def _follow(
        self, path: ReferencePath, reference: Reference, h: float, steps: IndexArray, run_label: str, progress: Progress
    ) -> FloatArray:
        """Return samples [q, dq, ddq, tau] (m, 4 n) at the internal steps `steps` (m,)."""
        start, n_steps = float(reference.t[0]), int(steps[-1]) + 1
        # A robot's controller computes its feed-forward torque at its own rate and interpolates. Two periods more than
        # the motion lasts leave no gap at its end.
        coarse = np.arange(0.0, reference.duration + 2 / FEED_FORWARD_RATE, 1 / FEED_FORWARD_RATE) + start
        gains: Gains = compute_joint_gains(self.controller, self.dynamics, path, coarse)
        feed_forward = compute_feed_forward_torque(self.controller, self.dynamics, path, coarse)
        q, dq, ddq = (values[0] for values in path.evaluate(np.array([start])))
        state = build_first_state(self.dynamics, q, dq, ddq, h)
        present = self._mark_present_runs(run_label)
        out = np.empty((len(steps), 4 * self.robot.n))
        done = 0
        # Chunks bound the memory, report progress, and find a robot that does not follow early.
        for first in range(0, n_steps, _CHUNK):
            t: FloatArray = np.arange(first, first + _CHUNK, dtype=np.float64) * h + start
            q, dq, _ = path.evaluate(t)
            torque = np.column_stack([np.interp(t, coarse, feed_forward[:, j]) for j in range(self.robot.n)])
            runs = np.broadcast_to(present, (_CHUNK, len(present)))
            inputs = np.hstack([q, dq, torque, t[:, None], path.evaluate_temperature(t), runs])
            state, rows = self._step.run(state, inputs, h, gains.stiffness, gains.damping)
            chunk_steps = steps[done : int(np.searchsorted(steps, first + _CHUNK))] - first
            out[done : done + len(chunk_steps)] = rows[chunk_steps]
            done += len(chunk_steps)
            # The last chunk runs on behind the end of the motion; only the steps within it are judged and reported.
            last = min(_CHUNK, n_steps - first)
            self._check_tracking(t[:last], q[:last], rows[:last, : self.robot.n])
            progress(min(1.0, (first + last) / n_steps), f"simulated {t[last - 1] - start:.1f} s")
        return out

    def _check_temperature(self, reference: Reference) -> None:
        heated = [effect.effect for effect in self.effects if get_effect(effect.effect).needs_temperature]
        if heated and reference.temperature is None:
            raise DynidentError(
                f"{heated[0]} needs the temperature of the joints: let the robot warm up along the trajectory",
                pointer="/temperature",
                title="Temperature needed",
            )

    def _check_tracking(self, t: FloatArray, reference: FloatArray, q: FloatArray) -> None:
        # Not with > _LOST: this form is also true for NaN, where the integration has diverged.
        lost = np.argwhere(~(np.abs(q - reference) < _LOST))
        if not len(lost):
            return
        row, joint = int(lost[0, 0]), int(lost[0, 1])
        described = self.robot.joints[joint]
        unit = "rad" if described.kind == "revolute" else "m"
        limit = described.limits.effort
        cause = "" if limit is None else f"; its effort limit is {limit:g} {described.effort_unit}"
        raise DynidentError(
            f"the virtual robot cannot follow the trajectory: {described.name} is off by more than {_LOST} {unit} at "
            f"t = {t[row]:.3f} s{cause}. Slow the trajectory down, or check friction and limits",
            pointer="/trajectory",
            title="Trajectory cannot be followed",
        )
