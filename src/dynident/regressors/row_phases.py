"""Which rows of which joint's equation count, and what a joint at rest may hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from dynident.effects import Column, Signals, effect_by_id
from dynident.recordings import Preprocessing, Recording
from dynident.recordings.phases import Phase, PhaseArray, Phases, phases_of, width_of
from dynident.recordings.types import BoolArray
from dynident.regressors.observation import Observation
from dynident.robot.model import FloatArray, Robot

# A velocity of nothing but its direction.
_TOUCH = 1e-9


@dataclass(frozen=True, eq=False)
class RowPhases:
    """The phases of a recording's rows behind the filters, as far as they matter to an observation matrix.

    `frictional` (n,): joints whose friction is among the columns; the equation of any other holds at all times.
    `remembering` (n,): joints with friction that remembers the path: what it does shows where they turn
    round; `free` (n,): joints that never stick there, so that anything that depends on the speed shows as well.
    """

    phases: Phases
    width: float
    frictional: BoolArray
    remembering: BoolArray
    free: BoolArray

    @classmethod
    def of(cls, observation: Observation, recording: Recording, preprocessing: Preprocessing) -> RowPhases:
        """What holds for the rows of a recording."""
        frictional = joints_with_friction(observation)
        remembering = np.zeros(observation.robot.n, dtype=bool)
        remembering[[signal.joint for signal in observation.memory]] = True
        width = width_of(preprocessing, recording.sampling_rate)
        phases = phases_of(recording)
        return cls(phases, width, frictional, remembering, phases.free)

    def about(self, frictional: BoolArray) -> RowPhases:
        """The same where other joints (n,) have friction."""
        return replace(self, frictional=frictional)

    def at(self, segment: int, t: FloatArray, after: float = 0.0) -> PhaseArray:
        """(m, n): phases at times t (m,) of a segment; `after`: seconds that a halt is felt beside the filters."""
        found = self.phases.at(segment, t, self.width, after)
        found[:, ~self.frictional] = Phase.MOVING
        return found

    def used(self, segment: int, t: FloatArray, after: float = 0.0) -> BoolArray:
        """(m, n): which rows a model is fitted to: all but those at which the joint stands.

        Where it turns round in one sweep, the sign of its friction changes at a known instant, as in W.
        """
        found = self.at(segment, t, after)
        return np.asarray(found != Phase.STANDING)


def joints_with_friction(observation: Observation, first: int | None = None) -> BoolArray:
    """(n,): joints whose friction is among the columns, or among the first so many of them."""
    # Offsets of a base sensor belong to no effect.
    names = {c.link for c in observation.columns[:first] if c.effect and effect_by_id(c.effect).is_friction}
    return np.array([name in names for name in observation.robot.joint_names])


def observation_at_rest(robot: Robot, columns: Sequence[Column], signals: Signals) -> Observation:
    """W's columns of friction where each joint is at the point of moving: (2 n, columns), forward, then backward.

    Row j is about joint j alone: it has no speed but a direction, and its path lies all in that direction. Entries of
    columns that are no friction are zero: those are the same at rest.
    """
    friction = [c.effect != "" and effect_by_id(c.effect).is_friction for c in columns]
    rows = []
    memory = {signal: signals.memory(signal) for signal in signals.memory_signals}
    for direction in (1.0, -1.0):
        for j in range(robot.n):
            whole = ca.horzcat(*(c.torque[j] if f else ca.SX(1, 1) for c, f in zip(columns, friction, strict=True)))
            states = [symbol for signal, symbol in memory.items() if signal.joint == j]
            known = ca.vertcat(signals.dq[j], *states)
            still = ca.vertcat(direction * _TOUCH, *([direction] * len(states)))
            rows.append(ca.substitute(whole, known, still))
    return Observation.of_matrix(robot, columns, ca.sparsify(ca.vertcat(*rows)), signals)
