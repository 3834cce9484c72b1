"""A simulator of the robot with identified parameters, which follows recorded motions under joint control.

Estimators and validations simulate an identified model on the same virtual robot, with its equation of motion, its
friction at standstill and its controller. They choose only the step and the stiffness of the controller. Estimators
simulate round after round and need positions near the recorded ones. A validation simulates once, and asks whether an
ordinary controller is enough.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import Column, get_effect, get_role
from dynident.effects.prediction import ROTOR_INERTIA
from dynident.errors import DynidentError
from dynident.identification.estimators.reference_motion import RecordedMotion
from dynident.identification.parameters.inertia_matrix import compute_smallest_inertia_eigenvalue
from dynident.progress import Progress, ignore_progress
from dynident.recordings import Recording, SampleBlock
from dynident.regressors.model import Model
from dynident.robot.model import INERTIAL_NAMES, Robot
from dynident.simulation import Controller, Sensors, SimulatedRecording, TrueEffect, VirtualRobot, spread_over_joints
from dynident.simulation.ground_truth import may_be_negative
from dynident.simulation.virtual_robot import LONGEST_STEP

BANDWIDTH = 15.0
"""Natural frequency in Hz of the simulated joint control; the links' torque is fed forward."""

_CONTROLLER = Controller(bandwidth=BANDWIDTH, largest_lag=5e-4)
# s: positions are within 1e-5 rad of those with the finest step, in a third of the computing time.
_STEP = 1e-3


@dataclass(frozen=True, eq=False)
class SimulatedMotion:
    """The simulated motion along a recording.

    Parameters
    ----------
    recording : Recording
        The recording.
    segments : tuple of (q, dq, ddq)
        Positions, velocities and accelerations (m, n) of each segment, sample for sample.
    """

    recording: Recording
    segments: tuple[tuple[FloatArray, FloatArray, FloatArray], ...]

    def replace_motion(self, measured: SampleBlock) -> SampleBlock:
        """Return a block of the recording with the simulated motion in place of the measured one."""
        # The simulated motion has all samples of the segment; the block's time says which of them it needs.
        rate = self.recording.sampling_rate
        first = round((measured.t[0] - self.recording.segments[measured.segment].start_time) * rate)
        rows = slice(first, first + len(measured.t))
        q, dq, ddq = self.segments[measured.segment]
        dddq = np.gradient(ddq, axis=0) * rate
        ddddq = np.gradient(dddq, axis=0) * rate
        return replace(measured, q=q[rows], dq=dq[rows], ddq=ddq[rows], dddq=dddq[rows], ddddq=ddddq[rows])


def build_movable_simulator(model: Model, values: FloatArray) -> Simulator:
    """Return a simulator with these base parameters (b,), or with links that can move.

    Where the inertia matrix is not positive definite, the links of the description are used instead.

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    values : (b,)
        Base parameters.

    Raises
    ------
    DynidentError
        Where neither the parameters nor the description make a robot that can move.
    """
    # Without a positive definite inertia matrix the equation of motion has no solution that a controller could
    # follow.
    links = None
    if not compute_smallest_inertia_eigenvalue(model, values) > 0:
        links = model.robot.inertias
        if links is None:
            raise DynidentError(
                "the inertia matrix of the first estimate is not positive definite, and the description has no "
                "inertias to begin with: no motion can be simulated. Use wls or feasible, or data that excite the "
                "robot more",
                pointer="/estimator",
                title="No simulation",
            )
    return build_simulator(model, values, links=links, controller=_CONTROLLER, longest_step=_STEP)


def simulate_recording(
    simulator: Simulator, recording: Recording, motions: Sequence[RecordedMotion]
) -> SimulatedMotion:
    """Let the simulated robot follow the motion of a recording's segments.

    Parameters
    ----------
    simulator : Simulator
        A robot with the identified parameters.
    recording : Recording
        The recording.
    motions : sequence of RecordedMotion
        One for each segment.

    Raises
    ------
    DynidentError
        Where it does not follow.
    """
    truths = [simulator.follow(motion).truth for motion in motions]
    return SimulatedMotion(recording, tuple((truth.q, truth.dq, truth.ddq) for truth in truths))


@dataclass(frozen=True, eq=False)
class Simulator:
    """A virtual robot, and the base parameters that it really has.

    They are the identified ones, but for friction and rotors below zero, which no robot has: these are zero.

    Parameters
    ----------
    robot : VirtualRobot
        The virtual robot.
    values : (b,)
        Its base parameters.
    """

    robot: VirtualRobot
    values: FloatArray

    def follow(self, motion: RecordedMotion, progress: Progress = ignore_progress) -> SimulatedRecording:
        """Let the robot follow a recorded motion, sampled like it and without noise.

        Parameters
        ----------
        motion : RecordedMotion
            The motion to follow.
        progress : Progress
            Called with the fraction done and a message.

        Returns
        -------
        SimulatedRecording
            Positions, torques and the true motion.

        Raises
        ------
        DynidentError
            Where it cannot.
        """
        sensors = Sensors(motion.sampling_rate, None, torque_noise=0.0)
        return self.robot.measure(motion.reference, sensors, run=motion.label, progress=progress)


def build_simulator(
    model: Model,
    values: FloatArray,
    *,
    links: FloatArray | None = None,
    controller: Controller | None = None,
    longest_step: float = LONGEST_STEP,
) -> Simulator:
    """Build the virtual robot with these base parameters.

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    values : (b,)
        Base parameters.
    links : (n, 10), optional
        Inertial parameters that stand in for those of `values`, the rotors' included.
    controller : Controller, optional
        Joint control; that of the virtual robot by default.
    longest_step : float
        Longest internal step in s.

    Raises
    ------
    DynidentError
        Where no such robot can exist.
    """
    robot = model.robot
    standard = compute_possible_standard(model, values)
    # Links that the model leaves out keep the inertia of the description.
    inertias, rotors = model.compute_standard_inertia(values).reshape(-1, 10).copy(), np.zeros(robot.n)
    for k, column in enumerate(model.columns):
        if get_role(column) == "link":
            standard[k] = standard[k] if links is None else links[_locate_parameter(model, column)]
            inertias[_locate_parameter(model, column)] = standard[k]
        elif get_role(column) == "rotor":
            standard[k] = standard[k] if links is None else 0.0
            rotors[robot.joint_names.index(column.link)] = standard[k]
    # A rotor without inertia would only cost time.
    turning = [rotor for rotor in spread_over_joints(robot, *ROTOR_INERTIA, rotors) if rotor.values[0][1] > 0]
    virtual = VirtualRobot(
        _remove_effort_limits(robot),
        [*turning, *_list_other_effects(model, standard)],
        inertias=inertias if links is None else links,
        controller=controller,
        longest_step=longest_step,
    )
    return Simulator(virtual, model.base.grouping @ standard)


def compute_possible_standard(model: Model, values: FloatArray) -> FloatArray:
    """Return standard parameters (c,) of all columns with these base parameters (b,), as far as signs allow.

    Of rotors and links only sums are determined, so a rotor may have come out below zero: the links take that over.

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    values : (b,)
        Base parameters.
    """
    inertias = model.compute_standard_inertia(values).reshape(-1, 10)
    rotors = model.build_reference(values).rotors
    # Other parameters are base parameters themselves, or were absorbed by others and are zero here.
    own = dict(zip(model.base.kept, values, strict=True))
    standard = np.zeros(len(model.columns))
    for k, column in enumerate(model.columns):
        if get_role(column) == "link":
            standard[k] = inertias[_locate_parameter(model, column)]
        elif get_role(column) == "rotor":
            standard[k] = rotors[model.robot.joint_names.index(column.link)]
        else:
            standard[k] = own.get(k, 0.0)
    impossible = [
        k for k, c in enumerate(model.columns) if standard[k] < 0 and not may_be_negative(c.effect, c.parameter, c.runs)
    ]
    standard[impossible] = 0.0
    links = [k for k, column in enumerate(model.columns) if get_role(column) == "link"]
    if impossible and links:
        # The smallest change of the links that gives the base parameters back, now that some parameters were set to
        # zero.
        gap = values - model.base.grouping @ standard
        standard[links] += np.linalg.pinv(model.base.grouping[:, links], rcond=1e-9) @ gap
    return standard


def _remove_effort_limits(robot: Robot) -> Robot:
    """Return the robot without effort limits: the real one has made the motion, whatever its limits are said to be."""
    return replace(robot, joints=tuple(replace(j, limits=replace(j.limits, effort=None)) for j in robot.joints))


def _locate_parameter(model: Model, column: Column) -> tuple[int, int]:
    return model.robot.tree.joint_names.index(column.link), INERTIAL_NAMES.index(column.parameter)


def _list_other_effects(model: Model, standard: FloatArray) -> list[TrueEffect]:
    """Return what acts on a robot with these standard parameters (c,) besides its links and rotors."""
    effects: dict[TrueEffect, list[tuple[str, float]]] = {}
    # Effects whose columns were absorbed have no value of their own and are in the others.
    for k in model.base.kept:
        column = model.columns[k]
        effect = get_effect(column.effect)
        if not effect.is_inertia:
            joint = column.link if effect.scope == "joint" else ""
            of = TrueEffect(column.effect, joint, (), column.shape, column.runs)
            effects.setdefault(of, []).append((column.parameter, float(standard[k])))
    return [replace(effect, values=tuple(values)) for effect, values in effects.items()]
