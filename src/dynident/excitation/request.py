"""What is asked of a design."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, get_args

from dynident.effects import DEFAULT_EFFECTS, JOINT_FRICTION, EffectChoice
from dynident.excitation.criteria.choice import CriterionChoice
from dynident.excitation.observation.row_models import RowModelName
from dynident.excitation.surroundings.obstacles import Surroundings
from dynident.robot import Limits

Kind = Literal["optimized", "random", "sequential", "constant_velocity", "slow_sweep", "reversals"]
KINDS: tuple[str, ...] = get_args(Kind)
JOINT_BY_JOINT = ("constant_velocity", "slow_sweep", "reversals")
"""Kinds in which one joint moves at a time, with the friction of the joints for its default effects."""
FAMILIES = ("fourier", "b_spline", "point_to_point")
DEFAULT_STARTS = 4

_SPEEDS = (0.02, 0.05, 0.1, 0.2, 0.4, 0.7)
_REVERSAL_SPEEDS = (0.01,)
_AMPLITUDES = (0.004, 0.008, 0.016, 0.032, 0.064)


@dataclass(frozen=True)
class TrajectoryRequest:
    """The motion wanted.

    Parameters
    ----------
    family : str
        "fourier", "b_spline" or "point_to_point".
    duration : float
        One period in s (of a point-to-point sequence a result, not a wish); for constant velocity the longest stroke;
        for a slow sweep the way from one end of a joint's range to the other.
    harmonics : int
        Of a Fourier series: of the fundamental frequency 1 / duration.
    intervals : int
        Of a B-spline: between its knots, evenly spaced. A joint has as many free coefficients; a Fourier series has
        2 harmonics - 1.
    points : int
        Of a point-to-point sequence: where the arm comes to rest in a round. They, and the shares of the velocity and
        acceleration limits of every move, are free.
    dwell : tuple of two floats
        Of a point-to-point sequence: the shortest and the longest rest in a point, in s; each is drawn between them.
    sets : str
        For sequential designs, the test motions: "link_by_link" from the terminal link, "wrist_then_shoulder", or
        "vandanjon": inertia, centrifugal coupling, inertial coupling, gravity. Each run takes about the duration.
    periods : int
        How often the period (the set of strokes) is repeated.
    sampling_rate : float
        Hz.
    speeds : tuple of float, optional
        For constant velocity and reversals: shares of each joint's velocity limit.
    amplitudes : tuple of float, optional
        For reversals: how far a joint goes back and forth, in rad or m.
    joints : tuple of str
        Those that move; all where empty. In an optimised or random trajectory the others are locked at home, and the
        parameters are those that this shows.
    paces : tuple of float
        For Fourier trajectories: the same path is run at each of these shares of its speed, one after the other.
    """

    family: str = "fourier"
    duration: float = 10.0
    harmonics: int = 5
    intervals: int = 9
    points: int = 12
    dwell: tuple[float, float] = (0.0, 0.0)
    sets: str = "vandanjon"
    periods: int = 1
    sampling_rate: float = 100.0
    speeds: tuple[float, ...] | None = None
    amplitudes: tuple[float, ...] | None = None
    joints: tuple[str, ...] = ()
    paces: tuple[float, ...] = (1.0,)


@dataclass(frozen=True)
class DesignRequest:
    """An experiment wanted.

    Parameters
    ----------
    kind : str
        One of `KINDS`. "optimized" and "random" move all joints at once; "sequential" runs a set of test motions, some
        joints at a time; of the others, "constant_velocity" runs every joint
        there and back at several speeds, "slow_sweep" slowly over its whole range, "reversals" back and forth by small
        amplitudes.
    effects : tuple of EffectChoice, optional
        What is to be identified; links, rotors, Coulomb and viscous friction where not given (for motions of one joint
        at a time: friction and offset).
    criterion, trajectory
        See there.
    limits : mapping of joint name to Limits
        Tighter ones than the robot's, for this experiment.
    home : tuple of float, optional
        Posture (n,) at which the experiment begins and ends.
    time_budget : float, optional
        Seconds of optimisation; the best so far is returned.
    starts : int, optional
        Starts of the optimisation: as many as the time allows, or 4 where none of the two is given. The same number
        of starts, completed, gives the same answer for the same seed.
    random_trajectories : int
        How many random trajectories stand beside the result.
    seed : int
    model : str
        The identification model whose rows the criterion is computed from, for a periodic trajectory: "dynamic",
        "filtered", "energy" or "power".
    noise : mapping of joint name to N m or N
        Standard deviation of a sample of the joint's torque. With it, the criteria about variances weigh the joints,
        and the standard deviations of the parameters are predicted.
    torque_margin : float
        By what share the torque of the real arm may be larger than predicted: the limits of torque and power are
        divided by 1 more than it.
    surroundings : Surroundings
        What the robot must not touch; itself, where nothing else is stated.
    """

    kind: str = "optimized"
    effects: tuple[EffectChoice, ...] | None = None
    criterion: CriterionChoice = field(default_factory=CriterionChoice)
    trajectory: TrajectoryRequest = field(default_factory=TrajectoryRequest)
    limits: Mapping[str, Limits] = field(default_factory=dict)
    home: tuple[float, ...] | None = None
    time_budget: float | None = None
    starts: int | None = None
    random_trajectories: int = 100
    seed: int = 0
    noise: Mapping[str, float] = field(default_factory=dict)
    torque_margin: float = 0.0
    surroundings: Surroundings = field(default_factory=Surroundings)
    model: RowModelName = "dynamic"

    @property
    def wanted_effects(self) -> tuple[EffectChoice, ...]:
        """The effects, with the default of the kind."""
        if self.effects is not None:
            return self.effects
        return JOINT_FRICTION if self.kind in JOINT_BY_JOINT else DEFAULT_EFFECTS

    @property
    def wanted_speeds(self) -> tuple[float, ...]:
        """Shares of the velocity limits, with the default of the kind."""
        if self.trajectory.speeds is not None:
            return self.trajectory.speeds
        return _REVERSAL_SPEEDS if self.kind == "reversals" else _SPEEDS

    @property
    def wanted_amplitudes(self) -> tuple[float, ...]:
        """Amplitudes of reversals in rad or m."""
        return _AMPLITUDES if self.trajectory.amplitudes is None else self.trajectory.amplitudes

    @property
    def wanted_starts(self) -> int | None:
        """Number of starts; `None`: as many as the time allows."""
        if self.starts is None and self.time_budget is None:
            return DEFAULT_STARTS
        return self.starts
