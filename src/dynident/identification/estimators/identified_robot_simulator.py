"""Simulate a robot with identified parameters along a recorded motion under joint control.

Holds the bandwidth of that control (15 Hz), and when a robot counts as following its commands (5 % off).

Estimators and validations simulate an identified model on the same virtual robot, with its equation of motion, its
friction at standstill and its controller. They choose only the step and the stiffness of the controller. Estimators
simulate round after round and need positions near the recorded ones. A validation simulates once, and asks whether an
ordinary controller is enough. The reference is the recorded or the commanded motion.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import Column, get_effect, get_role
from dynident.effects.predicted_torque_expressions import ROTOR_INERTIA
from dynident.errors import DynidentError
from dynident.identification.standard_parameters import compute_smallest_inertia_eigenvalue
from dynident.progress import Progress, ignore_progress
from dynident.recordings import Preprocessing, Recording, SampleBlock, filtered_blocks
from dynident.recordings.row_storage import replace_by_command
from dynident.regressors.model_structure import Model
from dynident.robot.robot_model import INERTIAL_NAMES, Robot
from dynident.simulation import (
    Controller,
    Reference,
    Sensors,
    SimulatedRecording,
    TrueEffect,
    VirtualRobot,
    spread_over_joints,
)
from dynident.simulation.true_effects import list_possibly_negative
from dynident.simulation.virtual_robot import LONGEST_STEP

# Share of the motion by which it may differ from the delayed command; above it the robot did not follow.
_FOLLOWED = 0.05
_DELAY_ROUNDS = 3  # Gauss-Newton steps for the delay: it is small, so that few are enough.


@dataclass(frozen=True, eq=False)
class CommandedMotion:
    """The command of every segment, as late as the robot was.

    Parameters
    ----------
    segments : tuple of RecordedMotion
        The delayed command of each segment.
    delay : (n,)
        Delay of each joint in s, which brings the command nearest to the measured motion.
    rest : float
        The rms difference between the two over the size of the motion, for the joint where that is largest.
    """

    segments: tuple[RecordedMotion, ...]
    delay: FloatArray
    rest: float

    @property
    def is_followed(self) -> bool:
        """Whether the robot followed the command but for the delay."""
        return self.rest <= _FOLLOWED


def align_commanded_motion(recording: Recording, smooth: Preprocessing) -> CommandedMotion:
    """Return the commanded motion behind a zero-phase filter, as late as the measured one behind the same filter.

    Parameters
    ----------
    recording : Recording
        With commanded positions.
    smooth : Preprocessing
        Its position filter is used.

    Returns
    -------
    CommandedMotion
        The delayed command, and how well the robot followed it.
    """
    # Both behind the same filter, so that its delay and band cancel in the comparison.
    measured = read_whole_segments(recording, smooth)
    ahead = read_whole_segments(replace_by_command(recording), smooth)
    delay = np.zeros(recording.n)
    for _ in range(_DELAY_ROUNDS):
        late = tuple(_delay_motion(motion, delay) for motion in ahead)
        gap = np.concatenate([m.reference.q - c.reference.q for m, c in zip(measured, late, strict=True)])
        slope = np.concatenate([c.reference.dq for c in late])
        squares = np.sum(slope**2, axis=0)
        # Least squares for a shift in time: to first order the gap between both motions is the velocity times the
        # missing delay.
        delay = delay - np.sum(gap * slope, axis=0) / np.where(squares > 0, squares, np.inf)
    # Commands that are no numbers give no delay: they are reported as not followed.
    if not np.isfinite(delay).all():
        return CommandedMotion(measured, np.zeros(recording.n), np.inf)
    late = tuple(_delay_motion(motion, delay) for motion in ahead)
    gap = np.concatenate([m.reference.q - c.reference.q for m, c in zip(measured, late, strict=True)])
    size = np.std(np.concatenate([m.reference.q for m in measured]), axis=0)
    moving = size > 1e-3 * size.max()
    rest = np.sqrt(np.mean(gap**2, axis=0))[moving] / size[moving]
    return CommandedMotion(late, delay, float(rest.max(initial=0.0)))


def _delay_motion(motion: RecordedMotion, delay: FloatArray) -> RecordedMotion:
    """Return the motion with every joint delayed by so many seconds."""
    reference = motion.reference
    q, dq, ddq = (
        np.column_stack(
            [np.interp(reference.t - late, reference.t, part[:, joint]) for joint, late in enumerate(delay)]
        )
        for part in (reference.q, reference.dq, reference.ddq)
    )
    return replace(motion, reference=replace(reference, q=q, dq=dq, ddq=ddq))


_EVERYTHING = slice(None)
# t, q, dq, ddq, tau and temperature of consecutive samples.
_Rows = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True, eq=False)
class RecordedMotion:
    """Consecutive samples of a recording.

    Parameters
    ----------
    reference : Reference
        The filtered motion.
    tau : (m, n)
        Torque that was measured along it, in N m or N.
    sampling_rate : float
        Rate of the recording in Hz.
    label : str
        Label of its run.
    """

    reference: Reference
    tau: FloatArray
    sampling_rate: float
    label: str


def read_whole_segments(recording: Recording, preprocessing: Preprocessing) -> tuple[RecordedMotion, ...]:
    """Return the motion of every segment from its first sample to its last, inside the windows or not.

    Parameters
    ----------
    recording : Recording
        The recording.
    preprocessing : Preprocessing
        Filters of the recordings.

    Returns
    -------
    tuple of RecordedMotion
        One motion for each segment.

    Raises
    ------
    DynidentError
        For a cut-off above the Nyquist frequency.
    """
    motions = []
    for segment in range(len(recording.segments)):
        blocks = filtered_blocks(recording, preprocessing, segments=[segment])
        motions.append(_join_pieces(recording, segment, [_take_rows(block) for block in blocks]))
    return tuple(motions)


def read_longest_piece(recording: Recording, preprocessing: Preprocessing, longest: float) -> RecordedMotion:
    """Return the longest unbroken piece of used samples, cut to at most `longest` seconds.

    Parameters
    ----------
    recording : Recording
        The recording.
    preprocessing : Preprocessing
        Filters of the recordings.
    longest : float
        In s.

    Raises
    ------
    DynidentError
        Where there are not two such samples.
    """
    segment, rows = max(
        _iterate_pieces(recording, preprocessing), key=lambda piece: _count_rows(piece[1]), default=(0, [])
    )
    if _count_rows(rows) < 2:
        raise DynidentError(
            f"{recording.name} has no consecutive samples inside its windows",
            pointer="/windows",
            title="No motion to simulate",
        )
    return _join_pieces(recording, segment, rows, longest)


def read_pieces(recording: Recording, preprocessing: Preprocessing) -> tuple[RecordedMotion, ...]:
    """Return every unbroken piece of used samples that has at least two of them, in the order of time.

    Parameters
    ----------
    recording : Recording
        The recording.
    preprocessing : Preprocessing
        Filters of the recordings.
    """
    return tuple(
        _join_pieces(recording, segment, rows)
        for segment, rows in _iterate_pieces(recording, preprocessing)
        if _count_rows(rows) > 1
    )


def _iterate_pieces(recording: Recording, preprocessing: Preprocessing) -> Iterator[tuple[int, list[_Rows]]]:
    """Yield the segment and the rows of each unbroken piece of used samples."""
    piece: list[_Rows] = []
    segment = 0
    for block in filtered_blocks(recording, preprocessing):
        if block.starts_segment and piece:
            yield segment, piece
            piece = []
        segment = block.segment
        # A piece may go on from one block to the next.
        borders = np.flatnonzero(np.diff(block.used)) + 1
        for first, last in zip([0, *borders], [*borders, len(block.t)], strict=True):
            if first < last and block.used[first]:
                piece.append(_take_rows(block, slice(first, last)))
            elif piece:
                yield segment, piece
                piece = []
    if piece:
        yield segment, piece


def _count_rows(piece: list[_Rows]) -> int:
    return sum(len(rows[0]) for rows in piece)


def _take_rows(block: SampleBlock, part: slice = _EVERYTHING) -> _Rows:
    heat = np.zeros_like(block.q) if block.temperature is None else block.temperature
    return block.t[part], block.q[part], block.dq[part], block.ddq[part], block.tau[part], heat[part]


def _join_pieces(recording: Recording, segment: int, pieces: list[_Rows], longest: float = np.inf) -> RecordedMotion:
    """Join consecutive pieces of a segment to one motion, cut to at most `longest` seconds."""
    t, q, dq, ddq, tau, heat = (np.concatenate(parts) for parts in zip(*pieces, strict=True))
    inside = t <= t[0] + longest
    temperature = heat[inside] if recording.has_temperature else None
    reference = Reference(t[inside], q[inside], dq[inside], ddq[inside], temperature)
    return RecordedMotion(reference, tau[inside], recording.sampling_rate, recording.name_segment(segment))


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
                "inertias to start with, so no motion can be simulated. Use wls or feasible, or data with more "
                "excitation",
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
    speeds: FloatArray | None = None,
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
    speeds : (n,), optional
        Largest recorded speeds in rad/s or m/s, beyond which friction does not fall.

    Raises
    ------
    DynidentError
        Where no such robot can exist.
    """
    robot = model.robot
    standard = compute_possible_standard(model, values)
    inertias, rotors = model.compute_standard_inertia(values).reshape(-1, 10).copy(), np.zeros(robot.n)
    for k, column in enumerate(model.columns):
        if get_role(column) == "link":
            standard[k] = standard[k] if links is None else links[_locate_parameter(model, column)]
            inertias[_locate_parameter(model, column)] = standard[k]
        elif get_role(column) == "rotor":
            standard[k] = standard[k] if links is None else 0.0
            rotors[robot.joint_names.index(column.link)] = standard[k]
    turning = [rotor for rotor in spread_over_joints(robot, *ROTOR_INERTIA, rotors) if rotor.values[0][1] > 0]
    virtual = VirtualRobot(
        _remove_effort_limits(robot),
        [*turning, *_list_other_effects(model, standard)],
        inertias=inertias if links is None else links,
        controller=controller,
        longest_step=longest_step,
        speeds=speeds,
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
    impossible = np.flatnonzero((standard < 0) & ~np.array(list_possibly_negative(model.columns), dtype=bool))
    standard[impossible] = 0.0
    links = [k for k, column in enumerate(model.columns) if get_role(column) == "link"]
    if len(impossible) and links:
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
