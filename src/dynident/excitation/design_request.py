"""The request of a design: kinds, sets and trajectory families, their fields, defaults and ranges; file formats.

Holds the default number of starts (4), speeds and amplitudes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from dynident.effects.effect_choices import DEFAULT_EFFECTS, JOINT_FRICTION, EffectChoice
from dynident.excitation.criteria.criterion_choice import CriterionChoice
from dynident.motion.collision.surroundings import Standing, Surroundings
from dynident.regressors import ROW_MODELS, RowModelName
from dynident.robot.limits_and_drives import Limits
from dynident.schema.fields import LARGEST_SEED, Choice, OneOf, Request, declare_field

TrajectoryFormat = Literal["csv", "parquet", "json", "ros2"]
TRAJECTORY_FORMATS = OneOf(
    Choice("csv", "CSV: t, q, dq, ddq"),
    Choice("parquet", "Parquet"),
    Choice("json", "JSON"),
    Choice("ros2", "ROS 2 JointTrajectory (YAML)"),
)
LEAST_SPEED = 0.01
"""Least share of the designed speed of a file: below it a motion of a minute takes hours, and joints stick."""


Kind = Literal["optimized", "random", "sequential", "constant_velocity", "slow_sweep", "reversals"]
DESIGN_KINDS = OneOf(
    Choice(
        "optimized", "optimised", "All joints at once, optimised to determine the parameters.", "all joints at once"
    ),
    Choice("random", "random", "All joints at once, the best of random motions.", "the best of random motions"),
    Choice("sequential", "a set of test motions", "Some joints at a time (§12.3.4.2).", "a set of test motions"),
    Choice("constant_velocity", "constant velocity", "Every joint back and forth at several speeds."),
    Choice("slow_sweep", "slow sweep", "Every joint slowly over its whole range."),
    Choice("reversals", "reversals", "Every joint back and forth by small amplitudes."),
)
KINDS = DESIGN_KINDS.names
JOINT_BY_JOINT = ("constant_velocity", "slow_sweep", "reversals")
"""Kinds in which one joint moves at a time, with the friction of the joints as default effects."""
FAMILY_KINDS = OneOf(
    Choice("fourier", "Fourier series", "Sines of a fundamental frequency: periodic."),
    Choice("b_spline", "B-spline", "Free coefficients between even knots: periodic."),
    Choice("point_to_point", "from point to point", "Moves as a controller makes them, from rest to rest."),
)
SET_KINDS = OneOf(
    Choice("link_by_link", "link by link", "Starting from the terminal link."),
    Choice("wrist_then_shoulder", "wrist, then shoulder", "The last three joints, then the others."),
    Choice("vandanjon", "Vandanjon", "Inertia, centrifugal coupling, inertial coupling, gravity."),
)
# Starts of the optimisation where neither their number nor a time is given.
DEFAULT_STARTS = 4
SAMPLES_PER_WAVE = 4
"""Fewest samples of the fastest wave of a periodic motion."""
_MOST_TIMES = 1_000_000
_MOST_HARMONICS = 100
_SLOWEST = 1e-4
"""Smallest share of a speed: ten thousand times slower, a motion of a second takes hours."""

# Defaults: shares of the velocity limits, more of them where friction curves, and amplitudes of reversals in rad or m.
_SPEEDS = (0.02, 0.05, 0.1, 0.2, 0.4, 0.7)
_REVERSAL_SPEEDS = (0.01,)
_AMPLITUDES = (0.004, 0.008, 0.016, 0.032, 0.064)


@dataclass(frozen=True)
class TrajectoryRequest(Request):
    """The family of motions.

    Parameters
    ----------
    family : str
        How the motion is written: Fourier series, B-spline, or moves from point to point.
    duration : float
        One period, s; of a set about one run, of constant velocity the longest stroke, of a slow sweep one way.
    harmonics : int
        Number of harmonics of the fundamental frequency 1 / duration, for Fourier series.
    intervals : int
        Number of intervals between the knots, for B-splines.
    points : int
        Number of points in a round, for moves from point to point.
    dwell : tuple of (float, float)
        Shortest and longest rest in a point, s, for moves from point to point.
    sets : str
        Set of test motions, for sequential designs (§12.3.4.2).
    periods : int
        Number of times that the period, or the set of strokes, is repeated.
    sampling_rate : float
        Sampling rate, Hz.
    speeds : tuple of float or None
        Shares of each joint's velocity limit, for constant velocity and reversals.
    amplitudes : tuple of float or None
        Lengths of the strokes, rad or m, for reversals.
    joints : tuple of str
        Names of the joints that move, the others locked at home; all where empty.
    paces : tuple of float
        Shares of the speed at which the same path is followed, one after the other.
    """

    family: str = declare_field("Family of functions that describes the motion", default="fourier", kinds=FAMILY_KINDS)
    duration: float = declare_field(
        "Duration of one period; for a set, of about one run; for constant velocity, of the longest stroke; for a "
        "slow sweep, of one direction; for point to point, it is a result",
        default=10.0,
        unit="s",
        at_least=0.01,
        at_most=86_400,
    )
    harmonics: int = declare_field(
        "For Fourier series: number of harmonics of the frequency 1 / duration",
        default=5,
        at_least=2,
        at_most=_MOST_HARMONICS,
    )
    intervals: int = declare_field(
        "For B-splines: number of intervals between knots; equals the free coefficients per joint",
        default=9,
        at_least=2,
        at_most=2 * _MOST_HARMONICS,
    )
    points: int = declare_field(
        "From point to point: number of points per round where the arm comes to rest",
        default=12,
        at_least=2,
        at_most=200,
    )
    dwell: tuple[float, float] = declare_field(
        "From point to point: shortest and longest rest in a point; rests are random between them",
        default=(0.0, 0.0),
        unit="s",
        at_least=0,
        at_most=60,
    )
    sets: str = declare_field(
        "For sequential designs: the test motions (§12.3.4.2)", default="vandanjon", kinds=SET_KINDS
    )
    periods: int = declare_field(
        "Number of repetitions of the period or of the set of strokes", default=1, at_least=1, at_most=_MOST_TIMES
    )
    sampling_rate: float = declare_field(
        "Sampling rate", default=100.0, unit="Hz", option="--rate", at_least=0.1, at_most=100_000
    )
    speeds: tuple[float, ...] | None = declare_field(
        "For constant velocity and reversals: speeds, as shares of each joint's velocity limit",
        default=None,
        fewest=1,
        at_least=_SLOWEST,
        at_most=1,
    )
    amplitudes: tuple[float, ...] | None = declare_field(
        "For reversals: lengths of the strokes", default=None, unit="rad or m", fewest=1, at_least=1e-6, at_most=1000
    )
    joints: tuple[str, ...] = declare_field(
        "Joints that move, with the others locked at home; all if empty", default=(), option="--joint"
    )
    paces: tuple[float, ...] = declare_field(
        "For Fourier series and B-splines: repeat the path at each of these shares of its speed",
        default=(1.0,),
        fewest=1,
        at_least=_SLOWEST,
        at_most=1,
    )


def compute_least_sampling_rate(trajectory: TrajectoryRequest) -> float:
    """Return the lowest sampling rate at which a periodic trajectory can be followed, Hz.

    Parameters
    ----------
    trajectory : TrajectoryRequest
        The trajectory.
    """
    # A wave takes two intervals of a spline, or one period of the highest harmonic.
    waves = trajectory.intervals / 2 if trajectory.family == "b_spline" else trajectory.harmonics
    return SAMPLES_PER_WAVE * waves / trajectory.duration


@dataclass(frozen=True)
class DesignRequest(Request):
    """An experiment wanted.

    `effects` None: links, rotors, Coulomb and viscous friction, and for motions of one joint at a time friction and
    offset. `home` (n,). With as many `starts`, completed, the same seed gives the same answer. With the `noise` of the
    joints the criteria about variances weigh them, and the parameters' standard deviations are predicted.

    Parameters
    ----------
    kind : str
        How the joints move, one of `KINDS`.
    effects : tuple of EffectChoice or None
        Effects to be identified; None for the default of the kind.
    criterion : CriterionChoice
        Criterion that the motion is chosen by.
    trajectory : TrajectoryRequest
        Family and length of the motion.
    limits : mapping of str to Limits
        Tighter limits for this experiment by joint name.
    home : tuple of float or None
        Posture at which the motion begins and ends, rad or m.
    time_budget : float or None
        Longest time of the optimisation, s.
    starts : int or None
        Number of starts of the optimisation; as many as the time allows, or 4, where left out.
    random_trajectories : int
        Number of random motions to start from and to compare with.
    seed : int
        Seed of all that is drawn.
    noise : mapping of str to float
        Standard deviation of a sample of each joint's torque by joint name, N m or N.
    torque_margin : float
        Share by which the torque may be larger than predicted.
    surroundings : Surroundings
        What the robot must not touch.
    standing : Standing
        Feet that it stands on; without any its base is held.
    model : RowModelName
        Identification model whose rows the criterion is computed from.
    """

    kind: str = declare_field("How the joints move", default="optimized", kinds=DESIGN_KINDS)
    effects: tuple[EffectChoice, ...] | None = declare_field("Effects to identify", default=None, option="-")
    criterion: CriterionChoice = declare_field(made_by=CriterionChoice)
    trajectory: TrajectoryRequest = declare_field(made_by=TrajectoryRequest)
    limits: Mapping[str, Limits] = declare_field(
        "By joint: tighter limits for this experiment", made_by=dict, option="-"
    )
    home: tuple[float, ...] | None = declare_field(
        "Posture where the motion begins and ends", default=None, unit="rad or m"
    )
    time_budget: float | None = declare_field(
        "Time limit of the optimisation; the best result until then is used",
        default=None,
        unit="s",
        above=0,
        at_most=604_800,
    )
    starts: int | None = declare_field(
        "Number of starts of the optimisation; by default 4, or as many as the time budget allows",
        default=None,
        at_least=1,
        at_most=_MOST_TIMES,
    )
    random_trajectories: int = declare_field(
        "Number of random motions to compare the result with", default=100, at_least=1, at_most=_MOST_TIMES
    )
    seed: int = declare_field("The same seed gives the same result", default=0, at_least=0, at_most=LARGEST_SEED)
    noise: Mapping[str, float] = declare_field(
        "By joint: standard deviation of one torque sample",
        made_by=dict,
        unit="N m or N",
        at_least=1e-9,
        at_most=1e9,
    )
    torque_margin: float = declare_field(
        "Share by which the torque may exceed the prediction; torque limits are reduced accordingly",
        default=0.0,
        at_least=0,
        at_most=100,
    )
    surroundings: Surroundings = declare_field("What the robot must not touch", made_by=Surroundings, option="-")
    standing: Standing = declare_field(made_by=Standing)
    model: RowModelName = declare_field(
        "Rows that the criterion is computed from", default="dynamic", kinds=OneOf(*ROW_MODELS)
    )

    @property
    def effects_or_default(self) -> tuple[EffectChoice, ...]:
        """The effects, with the default of the kind."""
        if self.effects is not None:
            return self.effects
        return JOINT_FRICTION if self.kind in JOINT_BY_JOINT else DEFAULT_EFFECTS

    @property
    def speeds_or_default(self) -> tuple[float, ...]:
        """Shares of the velocity limits, with the default of the kind."""
        if self.trajectory.speeds is not None:
            return self.trajectory.speeds
        return _REVERSAL_SPEEDS if self.kind == "reversals" else _SPEEDS

    @property
    def amplitudes_or_default(self) -> tuple[float, ...]:
        """Amplitudes of reversals, rad or m."""
        return _AMPLITUDES if self.trajectory.amplitudes is None else self.trajectory.amplitudes

    @property
    def starts_or_default(self) -> int | None:
        """Number of starts; None for as many as the time allows."""
        if self.starts is None and self.time_budget is None:
            return DEFAULT_STARTS
        return self.starts


def compute_planned_seconds(request: DesignRequest) -> float:
    """Return the requested duration of the exciting part, s; the design may last longer or shorter."""
    trajectory = request.trajectory
    return float(trajectory.duration * trajectory.periods * sum(1.0 / pace for pace in trajectory.paces))
