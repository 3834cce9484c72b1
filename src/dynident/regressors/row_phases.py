"""Decide which rows of each joint's equation are fitted, and which interval a joint at rest may hold.

A joint's phases (moving, reversing, standing) come from the recording; here they are widened by what the filters smear,
and interpreted for the friction columns of one observation matrix.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

import casadi as ca
import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.effects import Column, Signals, get_effect
from dynident.effects.usual_effect_sizes import get_velocity_scale
from dynident.recordings import Preprocessing, Recording
from dynident.recordings.filter_overshoots import find_filtered_phases
from dynident.recordings.joint_phases import (
    SLOW,
    Phase,
    PhaseArray,
    Phases,
    compute_smear_width,
    find_passive_phases,
)
from dynident.regressors.observation_matrix import Observation
from dynident.robot.contacts import find_mixed_joints
from dynident.robot.robot_model import Linkage, Robot

# A velocity of nothing but its direction.
_TOUCH = 1e-9

_SLOWEST, _FASTEST_OF_SLOW = 0.02, 10.0 * SLOW
"""Share of a joint's largest speed at which friction that is steep at rest is taken there, and the most (rad/s or m/s),
since descriptions state limits that no joint reaches. Few rows of motion are slower (none of a TX40's, 0.1 to 19 % of a
UR10e's joints), so that what such a law says below is little more than its continuation."""

_SMEARED = 0.125
"""Share of 1 / cut-off of the position filter by which a halt is longer, at either end, as far as it hides what the
joint does beside it. On clean arms no more is found there than is uncertain, at any margin; the rows are quietest from
here on (`benchmarks/standing_rows.py --only starts`)."""

_TOLD = 0.02
"""Share of what is under a filter that has to be motion for a row to say anything of it."""


@dataclass(frozen=True, eq=False)
class RowPhases:
    """The phases of a recording's rows behind the filters, as far as they matter to an observation matrix.

    Parameters
    ----------
    phases : Phases
        Phases of the joints in the recording.
    width : float
        Seconds that the filters smear a halt, to either side.
    margin : float
        Seconds by which a halt is longer in filtered positions, to either side.
    frictional : (n,)
        Joints whose friction is among the columns; the equation of any other holds at all times.
    remembering : (n,)
        Joints with friction that remembers the path: it shows at their reversals.
    free : (n,)
        Joints that never stick at reversals, so that anything that depends on the speed shows as well.
    starting : (n,)
        Joints with friction that shows where they start and stop.
    jumping : (n,)
        Joints that move passive ones with friction, and whose own friction does nothing but jump at their reversals.
    no_torque : (n,)
        Joints whose equation is left out, since their torque was not recorded here, or in no recording of the model.
    mixed : (n,)
        Joints whose equations are mixed with one another, since contact forces are eliminated from them.
    passive : Phases, optional
        Phases of the joints that follow others, in the order of `Linkage.passive`.
    felt : (n, p), optional
        Which of the passive joints have friction, and which joint moves them.
    """

    phases: Phases
    width: float
    margin: float
    frictional: BoolArray
    remembering: BoolArray
    free: BoolArray
    starting: BoolArray
    jumping: BoolArray
    no_torque: BoolArray
    mixed: BoolArray
    passive: Phases | None = None
    felt: BoolArray | None = None

    @classmethod
    def from_recording(
        cls,
        observation: Observation,
        recording: Recording,
        preprocessing: Preprocessing,
        first: int | None = None,
    ) -> RowPhases:
        """Return the phases of a recording's rows.

        Parameters
        ----------
        observation : Observation
            The matrix whose friction matters.
        recording : Recording
            The data.
        preprocessing : Preprocessing
            Filters, whose smear widens the phases.
        first : int, optional
            Count only the friction of so many leading columns; None: of all.

        Returns
        -------
        RowPhases
            Of all segments of the recording.
        """
        frictional = find_joints_with_friction(observation, first)
        remembering = _find_joints_with_memory(observation)
        width = compute_smear_width(preprocessing, recording.sampling_rate)
        cutoff = preprocessing.position_cutoff
        # A thousandth of a period more, so that rounding does not decide.
        margin = (0.0 if cutoff is None else _SMEARED / cutoff) + 1e-3 * recording.period
        phases = find_filtered_phases(recording, preprocessing)
        starting = find_starting_joints(observation)
        felt = _find_passive_friction(observation, first)
        passive = _find_passive_phases(recording, observation.robot.linkage) if felt.any() else None
        # A joint with presliding or a sharp start changes its friction more slowly than by a jump at its reversals.
        jumping = frictional & felt.any(axis=1) & ~remembering & ~(starting & phases.freely_reversing)
        no_torque = ~recording.has_torque | ~observation.robot.has_torque
        return cls(
            phases,
            width,
            margin,
            frictional,
            remembering,
            phases.freely_reversing,
            starting,
            jumping,
            no_torque,
            find_mixed_joints(observation.robot),
            passive,
            felt,
        )

    def with_friction_of(self, frictional: BoolArray) -> RowPhases:
        """Return the same if these joints (n,) have friction, which may then be of any kind."""
        # Friction of any kind may show at starts, and then nothing is certain to jump alone.
        return replace(self, frictional=frictional, starting=frictional, jumping=np.zeros_like(frictional))

    @property
    def left_out(self) -> tuple[bytes, ...]:
        """Which instants are taken out before the filter: columns with the same may stand side by side."""
        masks = (self.starting, self.jumping, self.frictional, self.felt)
        return tuple(mask.tobytes() for mask in masks if mask is not None)

    @property
    def interrupted_joints(self) -> BoolArray:
        """Joints (n,) out of whose equation instants may be taken before the filter."""
        joints = self.starting | self.jumping
        return joints if self.passive is None or self.felt is None else np.asarray(joints | self.felt.any(axis=1))

    def find_certain_samples(self, segment: int, t: FloatArray) -> BoolArray:
        """Return at which samples, at the full rate, the sign of all friction in a joint's equation is certain.

        With rubbed joints that follow it, it is not within some milliseconds of their halts, nor of where the joint
        itself turns round: filtered positions turn a little earlier or later. A jump is many times the noise, so that
        some milliseconds of the wrong sign would be the largest error in all rows that the filter smears it to.

        Parameters
        ----------
        segment : int
            Number of the segment.
        t : (m,)
            Times of the samples, s.

        Returns
        -------
        (m, n) array of bool
            False near halts of passive joints with friction, and near some reversals.
        """
        unsure = _SMEARED * self.width
        turns = (self.phases.phases_at(segment, t, unsure) == Phase.REVERSING) & self.jumping
        return np.asarray(~turns & ~self._find_follower_halts(segment, t, unsure))

    def find_valid_samples(self, segment: int, t: FloatArray) -> BoolArray:
        """Return at which samples, at the full rate, the equation of a joint with friction at its starts holds.

        At the others it stands: with them set to zero on both sides, the equation may be filtered like any other.

        Parameters
        ----------
        segment : int
            Number of the segment.
        t : (m,)
            Times of the samples, s.

        Returns
        -------
        (m, n) array of bool
            True for all other joints.
        """
        standing = self.phases.phases_at(segment, t, self.margin) == Phase.STANDING
        return np.asarray(~standing | ~self.starting)

    def find_unknown_torques(self, segment: int, t: FloatArray) -> BoolArray:
        """Return (m, n): at which times t (m,) the friction of a joint at rest is in the equations of others.

        False for all joints whose equations are their own.
        """
        rubbed = self.frictional & self.mixed
        if not rubbed.any():
            return np.zeros((len(t), len(rubbed)), dtype=bool)
        return np.asarray((self.phases.phases_at(segment, t, self.margin) == Phase.STANDING) & rubbed)

    def find_partial_rows(self, segment: int, t: FloatArray, phase: PhaseArray, held: FloatArray | None) -> BoolArray:
        """Return (m, n): rows near a halt, of the joint or of one that follows it, that still contain motion.

        Parameters
        ----------
        segment : int
        t : (m,)
            Times of the rows.
        phase : (m, n)
            Phases of the rows.
        held : (m, n), optional
            Share of what is under the filter at which the equation held.
        """
        if held is None:
            return np.zeros(phase.shape, dtype=bool)
        near_halt = (phase == Phase.STANDING) & self.starting
        # A row with less motion than this share under its filter would say next to nothing of the motion.
        return np.asarray((near_halt | (phase == Phase.PASSIVE_HALT)) & (held > _TOLD))

    def _find_follower_halts(self, segment: int, t: FloatArray, before: float, after: float = 0.0) -> BoolArray:
        """Return (m, n): where a passive joint that has friction and is moved by the joint turns round or stands.

        Parameters
        ----------
        before, after : float
            Seconds that a halt is felt to either side, and later on top of that.
        """
        if self.passive is None or self.felt is None:
            return np.zeros((len(t), len(self.frictional)), dtype=bool)
        halts = self.passive.phases_at(segment, t, before, after) != Phase.MOVING
        return np.asarray((halts[:, None, :] & self.felt).any(axis=2))

    def phases_at(self, segment: int, t: FloatArray, after: float = 0.0) -> PhaseArray:
        """Return the phases (m, n) at times t (m,) of a segment.

        Parameters
        ----------
        segment : int
            Number of the segment.
        t : (m,)
            Times of the rows, s.
        after : float
            Seconds that a halt is felt longer than by the filters, by a treatment with a memory.
        """
        phase = self.phases.phases_at(segment, t, self.width, after)
        # The order matters: each line overrides the ones before it. Without friction a halt does no harm; without
        # torque, or with one at its range, nothing else counts.
        phase[:, ~self.frictional] = Phase.MOVING
        phase[self._find_follower_halts(segment, t, self.width, after) & (phase != Phase.STANDING)] = Phase.PASSIVE_HALT
        phase[self.no_torque | self.phases.find_clipped(segment, t, self.width, after)] = Phase.NO_TORQUE
        return phase

    def find_used_rows(self, segment: int, t: FloatArray, after: float = 0.0) -> BoolArray:
        """Return which rows a model is fitted to.

        Parameters
        ----------
        segment : int
            Number of the segment.
        t : (m,)
            Times of the rows, s.
        after : float
            Seconds that a halt is felt longer than by the filters, by a treatment with a memory.

        Returns
        -------
        (m, n) array of bool
            For every row and joint.
        """
        return is_fitted(self.phases_at(segment, t, after))


def is_fitted(phase: PhaseArray) -> BoolArray:
    """Return which rows a model is fitted to: all but those at which the joint, or a passive one that it moves, stands.

    Where it turns round in one sweep, the sign of its friction changes at a known instant, as in W. That of a passive
    joint's friction changes when the speeds of several joints say so, each with its error.
    """
    return np.asarray((phase == Phase.MOVING) | (phase == Phase.REVERSING))


# Phases take a pass over the recording: they are kept as long as it lives.
_known: WeakKeyDictionary[Recording, WeakKeyDictionary[Linkage, Phases]] = WeakKeyDictionary()


def _find_passive_phases(recording: Recording, linkage: Linkage | None) -> Phases | None:
    """Return the phases of the passive joints, computed once for each recording and linkage."""
    if linkage is None:
        return None
    of_linkages = _known.setdefault(recording, WeakKeyDictionary())
    if linkage not in of_linkages:
        places = list(linkage.passive)
        of_linkages[linkage] = find_passive_phases(
            recording, lambda q: linkage.compute_positions(q)[:, places], len(places)
        )
    return of_linkages[linkage]


def _find_passive_friction(observation: Observation, first: int | None = None) -> BoolArray:
    """Return (n, p): which joints move which passive joints, if these have friction in the first columns."""
    robot = observation.robot
    if robot.linkage is None:
        return np.zeros((robot.n, 0), dtype=bool)
    names = {c.link for c in observation.columns[:first] if c.effect and get_effect(c.effect).is_friction}
    moves_rubbed = np.zeros((robot.n, len(robot.linkage.passive)), dtype=bool)
    for k, place in enumerate(robot.linkage.passive):
        # One that turns with a single joint halts when that does.
        if robot.tree.joint_names[place] in names and not robot.linkage.follows_one_driven_joint(place):
            moves_rubbed[list(robot.linkage.get_movers(place)), k] = True
    return moves_rubbed


def find_joints_with_friction(observation: Observation, first: int | None = None) -> BoolArray:
    """Return (n,): joints whose friction is among the columns.

    Parameters
    ----------
    observation : Observation
    first : int, optional
        Look at so many leading columns only.
    """
    # Offsets of a base sensor belong to no effect.
    names = {c.link for c in observation.columns[:first] if c.effect and get_effect(c.effect).is_friction}
    has_friction = np.zeros(observation.robot.n, dtype=bool)
    for name in names & set(observation.robot.tree.joint_names):
        has_friction[list(observation.robot.get_movers(name))] = True
    return has_friction


def _find_joints_with_memory(observation: Observation) -> BoolArray:
    """Return (n,): joints with friction that remembers the path."""
    has_memory = np.zeros(observation.robot.n, dtype=bool)
    for signal in observation.memory:
        has_memory[list(observation.robot.get_position_movers(signal.joint))] = True
    return has_memory


def have_same_instants(first: Observation, second: Observation) -> bool:
    """Return whether the same instants are taken out of the equations of two observation matrices of one robot.

    Parameters
    ----------
    first, second : Observation
        Matrices of one robot.

    Returns
    -------
    bool
        Whether rows that were filtered for one can be used for the other.
    """

    def are_equal(*predicates: Callable[[Observation], BoolArray]) -> bool:
        return all(np.array_equal(predicate(first), predicate(second)) for predicate in predicates)

    if not are_equal(find_starting_joints, _find_passive_friction):
        return False
    # What holds a joint at rest is taken out of equations that contain friction of several joints.
    if first.robot.contacts and not are_equal(find_joints_with_friction):
        return False
    # Where a joint turns round is taken out only beside a rubbed one that follows it.
    return not _find_passive_friction(first).any() or are_equal(find_joints_with_friction, _find_joints_with_memory)


def find_starting_joints(observation: Observation) -> BoolArray:
    """Return (n,): joints with friction that shows where they start."""
    return np.asarray(shows_at_starts(observation).any(axis=0))


def shows_at_starts(observation: Observation) -> BoolArray:
    """Return (columns, n): columns of friction that shows at low speed, or shortly after a halt, by joint."""
    names = observation.robot.tree.joint_names
    shows_at_start = np.zeros((observation.n_columns, observation.robot.n), dtype=bool)
    for k, column in enumerate(observation.columns):
        if column.effect and column.link in names and get_effect(column.effect).at_starts(dict(column.shape)):
            shows_at_start[k, list(observation.robot.get_movers(column.link))] = True
    return shows_at_start


def remembers_path(observation: Observation, signals: Signals) -> BoolArray:
    """Find columns of friction that remembers the path, which shows at reversals, by joint.

    Parameters
    ----------
    observation : Observation
        The observation matrix W.
    signals : Signals
        Signals that its columns are expressions of.

    Returns
    -------
    (columns, n)
        True where reversals of the joint show the column.
    """
    has_memory = np.zeros((observation.n_columns, observation.robot.n), dtype=bool)
    if observation.memory:
        entries = [column.torque.nz[:] for column in observation.columns]
        columns = np.repeat(np.arange(len(entries)), [entry.numel() for entry in entries])
        states = ca.vertcat(*(signals.memory(signal) for signal in observation.memory))
        # One pass for all columns: CasADi lists the symbols of each expression as slowly as those of all together.
        rows, numbers = ca.jacobian_sparsity(ca.vertcat(*entries), states).get_triplet()
        for k, number in {(columns[row], number) for row, number in zip(rows, numbers, strict=True)}:
            has_memory[k, list(observation.robot.get_position_movers(observation.memory[number].joint))] = True
    return has_memory


def build_rest_observation(robot: Robot, columns: Sequence[Column], signals: Signals) -> Observation:
    """Build W's columns of friction where each joint is about to move: (2 n, columns), forward, then backward.

    Row j is about joint j alone: it has no speed but a direction, and its path lies all in that direction. Of friction
    are also columns with predicted Coulomb friction in them, which jumps with noise about a speed of zero. No
    other column has an entry: those are the same at rest. A joint with a law that is steep at rest is held by what
    rubs it at a low speed, a share of its largest.

    Parameters
    ----------
    robot : Robot
        Robot that the columns belong to.
    columns : sequence of Column
        One for every parameter.
    signals : Signals
        The symbols that the columns are made of.

    Returns
    -------
    Observation
        With 2 n rows a sample.
    """
    jumps = signals.predicted.get_drive_parameter("Fc")
    friction = [
        place
        for place, c in enumerate(columns)
        if (c.effect != "" and get_effect(c.effect).is_friction) or ca.depends_on(c.torque, jumps)
    ]
    peaking = [place for place in friction if _peaks_at_rest(columns[place])]
    others = [place for place in friction if place not in peaking]
    steep = _is_steep_at_rest(robot, columns)
    rows = []
    memory = {signal: signals.memory(signal) for signal in signals.memory_signals}
    for direction in (1.0, -1.0):
        for j in range(robot.n):
            # Only joint j's own speed, acceleration and hysteresis are set; what the others do stays a symbol. The
            # hysteresis state is at its end of this direction, as after a long way there.
            states = [symbol for signal, symbol in memory.items() if j in robot.get_position_movers(signal.joint)]
            state = ca.vertcat(signals.dq[j], signals.ddq[j], *states)
            speeds = (_TOUCH, min(_SLOWEST * get_velocity_scale(robot, j), _FASTEST_OF_SLOW) if steep[j] else _TOUCH)
            still, slow = (ca.vertcat(direction * v, 0.0, *([direction] * len(states))) for v in speeds)
            row = ca.SX(1, len(columns))
            for speed, places in ((still, peaking), (slow, others)):
                acting = {place: columns[place].torque[j] for place in places if columns[place].torque.has_nz(j, 0)}
                acting = {place: torque for place, torque in acting.items() if not torque.is_zero()}
                if acting:
                    # What becomes zero at rest is an entry still, so that it is known to have changed.
                    at_rest = ca.densify(ca.substitute(ca.vertcat(*acting.values()), state, speed))
                    row[0, list(acting)] = at_rest.T
            rows.append(row)
    return Observation.from_matrix(robot, columns, ca.vertcat(*rows), signals)


def _is_steep_at_rest(robot: Robot, columns: Sequence[Column]) -> BoolArray:
    """Return (n,): joints with a law of the speed among the columns that is steepest at rest."""
    is_steep = np.zeros(robot.n, dtype=bool)
    for c in columns:
        if c.effect and c.link in robot.tree.joint_names and get_effect(c.effect).is_steep_at_rest(dict(c.shape)):
            is_steep[list(robot.get_movers(c.link))] = True
    return is_steep


def _peaks_at_rest(column: Column) -> bool:
    """Return whether a column is friction that is largest where the joint starts, and falls off from there."""
    if not column.effect:
        return False
    effect, shape = get_effect(column.effect), dict(column.shape)
    return effect.at_starts(shape) and not effect.is_steep_at_rest(shape)


def changes_at_rest(at_rest: Observation) -> BoolArray:
    """Return (columns,): columns of which something is different where a joint is about to move."""
    changed = np.zeros(at_rest.n_columns, dtype=bool)
    changed[at_rest.entry_columns] = True
    return changed
