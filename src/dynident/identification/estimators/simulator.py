"""The identified robot in simulation, along the motion of its own recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.effects import effect_by_id
from dynident.errors import DynidentError
from dynident.identification.inertia import smallest_inertia_eigenvalue
from dynident.recordings import Preprocessing, Recording, SampleBlock, filtered_blocks
from dynident.regressors.model import Model
from dynident.robot.model import FloatArray
from dynident.simulation import Controller, Reference, Sensors, TrueEffect, VirtualRobot

BANDWIDTH = 15.0
"""Natural frequency in Hz of the simulated joint control; the links' torque is fed forward."""

_CONTROLLER = Controller(bandwidth=BANDWIDTH, largest_lag=5e-4)
# s: positions within 1e-5 rad of those of the finest step, at a third of its time.
_STEP = 1e-3
_INERTIAL = ("rigid_body", "rotor_inertia")
_ONLY_BRAKES = ("rotor_inertia", "coulomb", "viscous", "presliding")


@dataclass(frozen=True, eq=False)
class SimulatedMotion:
    """One recording as the simulated robot makes it: q, dq, ddq (m, n) of each segment, sample for sample."""

    recording: Recording
    segments: tuple[tuple[FloatArray, FloatArray, FloatArray], ...]

    def block(self, measured: SampleBlock) -> SampleBlock:
        """A block of the recording with the simulated motion in place of the measured one."""
        rate = self.recording.sampling_rate
        first = round((measured.t[0] - self.recording.segments[measured.segment].start_time) * rate)
        rows = slice(first, first + len(measured.t))
        q, dq, ddq = self.segments[measured.segment]
        dddq = np.gradient(ddq, axis=0) * rate
        ddddq = np.gradient(dddq, axis=0) * rate
        return replace(measured, q=q[rows], dq=dq[rows], ddq=ddq[rows], dddq=dddq[rows], ddddq=ddddq[rows])


def simulator_of(model: Model, values: FloatArray) -> VirtualRobot:
    """The virtual robot with these base parameters (b,), without limits of torque.

    Friction and rotor inertia below zero, which would drive the motion, count as zero. Where the inertia matrix is not
    positive definite the links of the description stand in.

    Raises
    ------
    DynidentError
        Where neither the parameters nor the description make a robot that can move.
    """
    robot = model.robot
    free = replace(robot, joints=tuple(replace(one, limits=replace(one.limits, effort=None)) for one in robot.joints))
    effects = true_effects(model, values)
    if smallest_inertia_eigenvalue(model, values) > 0:
        inertias = model.standard_inertia(values)
    elif robot.inertias is not None:
        inertias, effects = robot.inertias, tuple(one for one in effects if one.effect != "rotor_inertia")
    else:
        raise DynidentError(
            "the inertia matrix of the first estimate is not positive definite, and the description has no inertias to "
            "begin with: no motion can be simulated. Use wls or feasible, or data that excite the robot more",
            pointer="/estimator",
            title="No simulation",
        )
    braking = [_braking(one) for one in effects]
    return VirtualRobot(
        free, braking, inertias=inertias.reshape(robot.n, 10), controller=_CONTROLLER, longest_step=_STEP
    )


def simulated_motion(virtual: VirtualRobot, recording: Recording, references: Sequence[Reference]) -> SimulatedMotion:
    """Let the simulated robot follow the references of a recording's segments.

    Raises
    ------
    DynidentError
        Where it does not follow.
    """
    sensors = Sensors(recording.sampling_rate, None, torque_noise=0.0)
    segments = []
    for index, reference in enumerate(references):
        truth = virtual.measure(reference, sensors, run=recording.run_label(index)).truth
        segments.append((truth.q, truth.dq, truth.ddq))
    return SimulatedMotion(recording, tuple(segments))


def smoothed_references(recording: Recording, cutoff: float, order: int = 4) -> tuple[Reference, ...]:
    """The measured motion of every segment behind a zero-phase low-pass at `cutoff` (Hz), as a robot would follow it.

    Raises
    ------
    DynidentError
        For a cut-off above the Nyquist frequency.
    """
    found = []
    smooth = Preprocessing(cutoff, None, 1, order)
    for index in range(len(recording.segments)):
        blocks = list(filtered_blocks(recording, smooth, segments=[index]))
        t, q, dq, ddq = (np.concatenate([getattr(b, name) for b in blocks]) for name in ("t", "q", "dq", "ddq"))
        warm = [block.temperature for block in blocks if block.temperature is not None]
        found.append(Reference(t, q, dq, ddq, np.concatenate(warm) if warm else None))
    return tuple(found)


def true_effects(model: Model, values: FloatArray) -> tuple[TrueEffect, ...]:
    """What acts on a robot with these base parameters (b,) besides its links, its rotors with the share that is theirs.

    As they were estimated: friction below zero stays so.
    """
    robot = model.robot
    found: dict[tuple[str, str, tuple[tuple[str, float], ...], tuple[str, ...]], dict[str, float]] = {}
    rotors = model.reference(values)[10 * robot.n : 11 * robot.n]
    for joint, inertia in zip(robot.joint_names, rotors, strict=True):
        if inertia != 0:
            found["rotor_inertia", joint, (), ()] = {"Ia": float(inertia)}
    for column, value in zip(model.kept, values, strict=True):
        if column.effect not in _INERTIAL:
            joint = column.link if effect_by_id(column.effect).scope == "joint" else ""
            parameters = found.setdefault((column.effect, joint, column.shape, column.runs), {})
            parameters[column.parameter] = float(value)
    return tuple(
        TrueEffect(effect, joint, tuple(parameters.items()), shape, runs)
        for (effect, joint, shape, runs), parameters in found.items()
    )


def _braking(effect: TrueEffect) -> TrueEffect:
    """The effect without what would drive the motion."""
    if effect.effect not in _ONLY_BRAKES or effect.runs:
        return effect
    return replace(effect, values=tuple((name, max(value, 0.0)) for name, value in effect.values))
