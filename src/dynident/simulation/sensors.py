"""Sensors of a virtual robot: quantisation, noise, sampling jitter, and effects on the measurement (gains, delays).

Such effects are drive gains, delayed torque and positions that are not those of the links. They do not change the
motion. A sensor shows the torque of the motors and what these effects add to it at the measured position. Delayed
torque is the torque of an earlier instant, jumps included.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from dynident.array_types import FloatArray, IndexArray
from dynident.effects import ReferenceParameters, get_effect
from dynident.effects.hysteresis_states import MemoryStates
from dynident.errors import DynidentError
from dynident.expressions import Program
from dynident.robot.robot_model import Robot
from dynident.simulation.reference_motion import Reference
from dynident.simulation.simulated_recording import Truth
from dynident.simulation.simulated_signals import SensorSignals, SimulatedSignals
from dynident.simulation.true_effects import TrueEffect, build_reference, build_true_columns
from dynident.simulation.virtual_robot_request import Sensors

# Hz: links behind elastic gears do not follow what is faster.
_ELASTIC_BAND = 25.0
_ORDER = 3
# Rounds of Newton's method in which the torque of the motors is recovered, and share of the largest torque that may be
# left: a gain needs one round.
_RECOVERY_ROUNDS, _RECOVERED = 25, 1e-9
# Place of the torque of the motors among the inputs of what sensors add.
_MOTOR = 9


@dataclass(frozen=True, eq=False)
class SensorEffects:
    """Effects of the sensors of one virtual robot.

    Parameters
    ----------
    robot : Robot
    effects : tuple of TrueEffect
        Effects that add torque to what a sensor shows.
    delay : float
        Delay of the torque, s.
    added : Program or None
        The added torque; None where no effect adds any.
    signals : SensorSignals
    """

    robot: Robot
    effects: tuple[TrueEffect, ...]
    delay: float
    added: Program | None
    signals: SensorSignals

    @classmethod
    def from_effects(
        cls, effects: Sequence[TrueEffect], inertias: FloatArray, inside: SimulatedSignals
    ) -> SensorEffects:
        """Select those of all effects that do not take part in the motion.

        Parameters
        ----------
        effects : sequence of TrueEffect
            All effects of the robot.
        inertias : (n, 10)
        inside : SimulatedSignals
            Signals of the steps, which tell what takes part in the motion.

        Returns
        -------
        SensorEffects
            Those effects, as one function of the motion.
        """
        robot, signals = inside.robot, SensorSignals(inside.robot)
        # An effect belongs to the sensors when one of its columns needs what is not known within a step, such as the
        # derivatives of the acceleration or the measured motor torque.
        sensor_effects = tuple(
            effect
            for effect in effects
            if not all(
                inside.is_part_of_motion(column.torque)
                for column in build_true_columns([effect], inside, effects).columns
            )
        )
        others = [effect for effect in sensor_effects if not _list_delay_parameters(effect)]
        delay = sum(
            dict(effect.values).get(name, 0.0) for effect in sensor_effects for name in _list_delay_parameters(effect)
        )
        reference = build_reference(robot, effects, inertias)
        added = _build_added_torque(signals, others, reference) if others else None
        return cls(robot, tuple(others), delay, added, signals)

    def compute_torque(self, t: FloatArray, truth: Truth, temperature: FloatArray, run: str) -> FloatArray:
        """Return the torque (m, n) that the sensors show, without noise, at times t (m,) of the run with that label.

        Parameters
        ----------
        t : (m,)
            Times of the samples, s.
        truth : Truth
            The motion and torque without sensors.
        temperature : (m, n)
            Temperatures of the joints, degC; zeros where none is prescribed.
        run : str
            Label of the run.
        """
        torque = truth.tau
        if self.added is not None:
            torque = torque + self.added(*self._list_inputs(t, truth, temperature, run))
        # The delay comes last: it holds for all that the sensor shows, the added torque included.
        if self.delay:
            torque = np.column_stack([np.interp(t - self.delay, t, column) for column in torque.T])
        return torque

    def recover_motor_torque(self, motion: Reference, tau: FloatArray, run: str) -> FloatArray:
        """Return the torque (m, n) of the motors with which the sensors show the torque `tau` along a motion.

        Errors of the drive gains and a delay belong to the sensors: they do not move the robot.

        Parameters
        ----------
        motion : Reference
            The motion; temperatures are zero where it has none.
        tau : (m, n)
            The torque that the sensors show.
        run : str
            Label of the run.

        Raises
        ------
        DynidentError
            Where no torque of the motors is found with which the sensors show this one.
        """
        t, torque = motion.t, tau
        if self.delay:
            torque = np.column_stack([np.interp(t + self.delay, t, column) for column in torque.T])
        if self.added is None:
            return torque
        temperature = np.zeros_like(tau) if motion.temperature is None else motion.temperature
        inputs = self._list_inputs(t, Truth(motion.q, motion.dq, motion.ddq, tau), temperature, run)
        motor = torque
        scale = float(np.abs(torque).max(initial=np.finfo(float).tiny))
        # What a sensor adds to a joint's torque depends on the motor of that joint alone, so one slope a joint will do.
        step = 1e-3 * scale
        for _ in range(_RECOVERY_ROUNDS):
            here, beside = (self.added(*inputs[:_MOTOR], at, *inputs[_MOTOR + 1 :]) for at in (motor, motor + step))
            difference, slope = motor + here - torque, 1.0 + (beside - here) / step
            # Where more torque shows as less, another torque of the motors shows the same.
            if np.abs(difference).max(initial=0.0) <= _RECOVERED * scale and (slope > 0).all():
                return motor
            with np.errstate(all="ignore"):
                motor = motor - difference / slope
        raise DynidentError(
            "no torque of the motors shows as the recorded one; an error of a drive is too large",
            pointer="/effects",
        )

    def _list_inputs(self, t: FloatArray, truth: Truth, temperature: FloatArray, run: str) -> list[FloatArray]:
        """Return the inputs of `added`, with the torque of `truth` as that of the motors."""
        third, fourth = _differentiate_twice(t, truth.ddq)
        memory = MemoryStates(self.signals.memory_signals).push(self.signals.robot.positions(truth.q))
        present = np.array([float(effect.is_in(run)) for effect in self.effects])
        clock, period = t[:, None], np.array([_compute_period(t)])
        state = (truth.q, truth.dq, truth.ddq, third, fourth)
        return [*state, clock, period, temperature, memory, truth.tau, present]


def _list_delay_parameters(effect: TrueEffect) -> list[str]:
    """Return the names of the parameters by which an effect delays torque."""
    return [spec.name for spec in get_effect(effect.effect).parameters if spec.role == "delay"]


def _build_added_torque(
    signals: SensorSignals, effects: Sequence[TrueEffect], reference: ReferenceParameters
) -> Program:
    """Return (q, dq, ddq, dddq, ddddq, t, T, temperature, z, motor torque, presence of each effect) -> torque."""
    n, motor = signals.robot.n, signals.predicted.motor
    present = ca.SX.sym("present", len(effects))
    of_motion, of_torque = ca.SX.zeros(n, 1), ca.SX.zeros(n, 1)
    for k, effect in enumerate(effects):
        truth = build_true_columns([effect], signals)
        for column, value in zip(truth.columns, truth.parameters, strict=True):
            torque = _set_all_runs(column.torque, signals) * float(value) * present[k]
            if ca.depends_on(torque, motor):
                of_torque += torque
            else:
                of_motion += torque
    # Motors give the torque that the motion takes, and the gains belong to all of it.
    of_torque = ca.substitute(of_torque, motor, motor + of_motion)
    total = ca.substitute(of_motion + of_torque, signals.reference, ca.SX(ca.DM(reference.vector)))
    inputs = [
        signals.q,
        signals.dq,
        signals.ddq,
        signals.dddq,
        signals.ddddq,
        signals.time,
        signals.period,
        signals.temperature,
        signals.memory_symbols,
        motor,
        present,
    ]
    return Program(inputs, ca.densify(total))


def _set_all_runs(torque: ca.SX, signals: SensorSignals) -> ca.SX:
    """Return the torque with all run signals at 1: the presence of an effect multiplies all of its columns."""
    runs = [signals.in_runs(run) for run in signals.find_run_signals(torque)]
    return ca.substitute(torque, ca.vertcat(*runs), ca.SX.ones(len(runs), 1)) if runs else torque


def _differentiate_twice(t: FloatArray, ddq: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the third and fourth derivative (m, n) of the positions from ddq (m, n), as elastic gears pass them."""
    period = _compute_period(t)
    # Filters need an even clock, and the samples may have jitter.
    even: FloatArray = t[0] + period * np.arange(len(t))
    regular = np.column_stack([np.interp(even, t, column) for column in ddq.T])
    # Differentiating twice would amplify the corners of friction without limit. The band also stays below half the
    # sampling rate.
    # Importing it takes half a second, so that only those who need it do.
    from scipy import signal

    sections = signal.butter(_ORDER, min(_ELASTIC_BAND, 0.2 / period), fs=1 / period, output="sos")
    smooth = signal.sosfiltfilt(sections, regular, axis=0, padlen=min(len(t) - 1, 6 * _ORDER))
    third = np.gradient(smooth, period, axis=0)
    return third, np.gradient(third, period, axis=0)


def _compute_period(t: FloatArray) -> float:
    return float(t[-1] - t[0]) / (len(t) - 1)


_TITLE = "Unusable sensors"


def check_sensors(sensors: Sensors, robot: Robot) -> None:
    """Raise `DynidentError` for a value that no sensor has.

    Parameters
    ----------
    sensors : Sensors
        The sensors and their noise.
    robot : Robot
        The robot, as its description gives it.
    """
    absolute = sensors.torque_noise_absolute
    if absolute is not None and len(absolute) != robot.n:
        raise DynidentError(
            f"torque_noise_absolute is {list(absolute)}; expected {robot.n} numbers, one a joint",
            pointer="/noise/torque_noise_absolute",
            title=_TITLE,
        )
    # Four standard deviations have to fit into one sampling period, or the clipping that keeps samples in order would
    # cut off much of the jitter.
    if 4 * sensors.jitter * sensors.sampling_rate > 1:
        raise DynidentError(
            f"a jitter of {sensors.jitter} s is too much at {sensors.sampling_rate} Hz; at most a quarter of the "
            "sampling period",
            pointer="/noise/jitter",
            title=_TITLE,
        )
    missing = [name for name, drive in zip(robot.joint_names, robot.drives, strict=True) if not drive.gain]
    if sensors.current and missing:
        raise DynidentError(
            f"currents need the drive gain of every joint [12.17]; it is missing for {', '.join(missing)}",
            pointer="/noise/current",
            title=_TITLE,
        )


def quantise_positions(sensors: Sensors, robot: Robot, q: FloatArray) -> FloatArray:
    """Return positions (m, n) rounded to the encoders' counts.

    Parameters
    ----------
    sensors : Sensors
        The sensors and their noise.
    robot : Robot
        The robot, as its description gives it.
    q : (m, n)
        Positions, rad or m.
    """
    if not sensors.encoder_counts:
        return q
    turn = np.array([2 * np.pi if joint.kind == "revolute" else 1.0 for joint in robot.joints])
    step = turn / sensors.encoder_counts
    return np.rint(q / step) * step


def compute_noise_deviation(sensors: Sensors, robot: Robot, tau: FloatArray) -> FloatArray:
    """Return the standard deviation (n,) of the torque noise, for a run with the torques tau (m, n).

    Parameters
    ----------
    sensors : Sensors
        The sensors and their noise.
    robot : Robot
        The robot, as its description gives it.
    tau : (m, n)
        Torque of the run, N m or N.
    """
    if sensors.torque_noise_absolute is not None:
        return np.array(sensors.torque_noise_absolute, dtype=np.float64)
    largest = np.abs(tau).max(axis=0)
    limits = [joint.limits.effort for joint in robot.joints]
    # Torque sensors are chosen for the drive, so their noise grows with the effort limit of the joint.
    scale = np.array([peak if limit is None else limit for limit, peak in zip(limits, largest, strict=True)])
    return sensors.torque_noise * scale


def draw_sampling_steps(
    sensors: Sensors, steps_per_sample: int, n_samples: int, rng: np.random.Generator
) -> IndexArray:
    """Return the internal steps (n_samples,) at which samples are taken: regular, shifted by the jitter, ascending.

    Parameters
    ----------
    sensors : Sensors
        The sensors and their noise.
    steps_per_sample : int
        Number of internal steps in a sampling period.
    n_samples : int
        Number of samples.
    rng : np.random.Generator
        Generator of the jitter.
    """
    regular: IndexArray = np.arange(n_samples, dtype=np.intp) * steps_per_sample
    if sensors.jitter == 0:
        return regular
    # The internal steps are the finest clock there is, so the jitter is drawn in steps and rounded to whole ones.
    spread = sensors.jitter * sensors.sampling_rate * steps_per_sample
    # Two neighbouring samples are shifted by less than half a period each, so that their order stays.
    largest = max(0, (steps_per_sample - 1) // 2)
    shift = np.clip(np.rint(rng.normal(0.0, spread, n_samples)), -largest, largest).astype(np.intp)
    # The first sample stays at the start of the trajectory, and no sample may lie behind its end.
    shift[0] = 0
    shifted: IndexArray = np.minimum(regular + shift, regular[-1])
    return shifted
