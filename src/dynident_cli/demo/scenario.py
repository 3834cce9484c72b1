"""The robot, hidden effect and plan of the demonstration; how visible an effect must be."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import Effect, ReferenceParameters, Signals, build_columns, get_effect
from dynident.effects.effect_columns import list_possible_joints
from dynident.effects.usual_effect_sizes import get_largest_torque, get_velocity_scale
from dynident.errors import DynidentError
from dynident.excitation import TrajectoryRequest
from dynident.regressors.observation_matrix import FurtherSignals, Observation
from dynident.robot import Limits, Robot
from dynident.simulation import Sensors, TrueEffect, build_typical_effect, list_drive_effects

# Random states at which an effect's torque is computed.
_STATES = 300
# An effect whose largest torque, over the noise of one sample of the sensor, is below this cannot be found.
_MIN_SIGNAL_TO_NOISE = 2.7


def find_hideable_effects(robot: Robot, effect: str, joint: str) -> list[TrueEffect]:
    """Return an effect of a usual size on every joint where it would show, or on one joint only.

    A friction that grows with the load, for instance, is nothing on a joint that carries none. Refuse an effect that
    cannot be hidden at all, or not on that joint ("" for any).
    """
    effect_class = get_effect(effect, "--effect")
    names = [robot.joint_names[index] for index in list_possible_joints(effect_class, robot)]
    if joint and joint not in names:
        raise DynidentError(f"{effect} cannot act on {joint!r}; it can act on: {', '.join(names)}", pointer="--joint")
    anywhere = effect_class.scope == "robot" or len(effect_class.get_default_joints(robot)) == 1
    joint_names = [joint] if joint else [""] if anywhere else names
    try:
        possible = [build_typical_effect(robot, effect, name) for name in joint_names]
    except DynidentError as error:
        raise DynidentError(
            f"{error.detail}; an effect that every model has, or that needs more than one robot, cannot be hidden",
            pointer="--effect",
            title="Nothing to hide",
        ) from error
    # Where it shows on no joint it is hidden all the same: the demonstration then says that nobody could have seen it.
    return [
        candidate for candidate in possible if compute_signal_to_noise(robot, candidate) > _MIN_SIGNAL_TO_NOISE
    ] or possible


def _get_active_interval(effect: TrueEffect) -> tuple[float, float]:
    """Return the times between which an effect acts, s."""
    shape = dict(effect.shape)
    return shape.get("t0", 0.0), shape.get("t1", 20.0)


def compute_signal_to_noise(robot: Robot, effect: TrueEffect) -> float:
    """Return the largest torque of an effect over random states, over the noise of the torque sensor."""
    assert robot.inertias is not None
    signals = Signals(robot)
    columns = build_columns([effect.choice], signals)
    observation = Observation.from_columns(robot, columns, signals)
    rng = np.random.default_rng(0)
    q = rng.uniform(-2.0, 2.0, (_STATES, robot.n))
    # The third power makes slow states frequent: friction at low speed shows only there.
    dq = rng.uniform(-1.0, 1.0, (_STATES, robot.n)) ** 3 * [get_velocity_scale(robot, j) for j in range(robot.n)]
    entries = observation.evaluate(
        q,
        dq,
        2.0 * dq,
        reference=ReferenceParameters.from_links(robot.inertias, robot.n),
        memory=rng.choice([-1.0, 1.0], (_STATES, observation.n_memory)),
        further=FurtherSignals(
            dddq=4.0 * dq,
            ddddq=8.0 * dq,
            time=rng.uniform(*_get_active_interval(effect), _STATES),
            temperature=rng.uniform(20.0, 45.0, (_STATES, robot.n)),
            runs=np.ones(len(observation.runs)),
        ),
    )
    values = dict(effect.values)
    torque = observation.compute_torque(entries, np.array([values.get(column.parameter, 0.0) for column in columns]))
    noise = Sensors().torque_noise * np.array([get_largest_torque(robot, j) for j in range(robot.n)])
    return float((np.abs(torque).max(axis=0) / noise).max())


NOTHING = "none"
# An arm in its cell turns no joint further than this from its middle.
_RANGE = 2.5
# Effects that are in one recording alone: a load that was taken up for the second, a contact during the first.
_LATER_RUN, _FIRST_RUN = "run2", "run1"
# s between the runs where friction drifts: what the arm does meanwhile is not recorded.
_RUN_INTERVAL = 1500.0
_THIRD_RUN = "run3"
# degC in the cell, and of a joint that works for long; time constant between them in s.
_COLD, _WARM, _WARMING_TIME = 20.0, 45.0, 1200.0
# s of rest before the third run.
_REST_DURATION = 1400.0
_DESIGN_RATE = 200.0
# s in each point of a motion from point to point.
_DWELL = (0.1, 0.6)
_LINK_SPREAD, _DRIVE_SPREAD, _HIDDEN_SPREAD = 0.1, 0.25, 0.2


@dataclass(frozen=True)
class Course:
    """One trajectory of the plan.

    With `points` the motion goes at random from one point to the next and dwells in each, as most users' arms do;
    period and harmonics then have no meaning. The period is in s, the speed a share of the robot's velocity limits.
    """

    name: str
    kind: Literal["optimized", "random"]
    period: float
    harmonics: int
    periods: int
    speed: float
    starts: int = 1
    points: int = 0

    @property
    def trajectory(self) -> TrajectoryRequest:
        """The requested family of motions."""
        return TrajectoryRequest(
            family="point_to_point" if self.points else "fourier",
            duration=self.period,
            harmonics=self.harmonics,
            points=max(self.points, 2),
            dwell=_DWELL if self.points else (0.0, 0.0),
            periods=self.periods,
            sampling_rate=_DESIGN_RATE,
        )


@dataclass(frozen=True)
class Plan:
    """The plan of the experiment: recordings to identify from, the last one to test on; `rate` in Hz."""

    courses: tuple[Course, ...]
    rate: float = 500.0

    def add_third_recording(self) -> Plan:
        """Return the plan with one more fast recording.

        Two moments do not tell a drift with time from a drift with temperature; three do.
        """
        *training, last = self.courses
        return replace(self, courses=(*training, replace(training[0], name=_THIRD_RUN, periods=1), last))


LONG = Plan(
    (
        Course("run1", "optimized", 10.0, 5, 3, 1.0, 2),
        Course("run2", "optimized", 24.0, 8, 1, 0.25, 2),
        Course("validation", "random", 10.0, 5, 1, 1.0, points=6),
    )
)
SHORT = Plan(
    (
        Course("run1", "optimized", 8.0, 5, 2, 1.0, 2),
        Course("run2", "optimized", 20.0, 6, 1, 0.25),
        Course("validation", "random", 10.0, 5, 1, 1.0, points=4),
    )
)


@dataclass(frozen=True, eq=False)
class Scenario:
    """A virtual robot with a hidden effect.

    `robot` is as its description has it, `inertias` (n, 10) are the true ones; `drive` has the true friction and rotor
    inertias.
    """

    robot: Robot
    inertias: FloatArray
    drive: tuple[TrueEffect, ...]
    hidden: TrueEffect | None
    plan: Plan
    seed: int

    @classmethod
    def draw(cls, robot: Robot, effect: str, joint: str, seed: int, quick: bool) -> Scenario:
        """Draw a robot at random and hide an effect in it.

        Refuse an effect that cannot be hidden, or not on that joint, and a robot without inertias.
        """
        if robot.inertias is None:
            raise DynidentError(
                f"the description of {robot.name} gives no inertias, so it cannot be simulated", pointer="--robot"
            )
        rng = np.random.default_rng(seed)
        # One factor a link scales its mass, moments and inertia alike: the link stays physically possible.
        links = 1.0 + rng.uniform(-_LINK_SPREAD, _LINK_SPREAD, (robot.n, 1))
        drive = tuple(_scale_effect(drive_effect, rng, _DRIVE_SPREAD) for drive_effect in list_drive_effects(robot))
        possible = [] if effect == NOTHING else find_hideable_effects(robot, effect, joint)
        hidden = _scale_effect(possible[int(rng.integers(len(possible)))], rng, _HIDDEN_SPREAD) if possible else None
        if hidden is not None:
            hidden = replace(hidden, runs=_get_runs(get_effect(hidden.effect)))
        plan = SHORT if quick else LONG
        # Drift needs a third moment, which other effects do without.
        if hidden is not None and _is_drifting(hidden):
            plan = plan.add_third_recording()
        return cls(robot, robot.inertias * links, drive, hidden, plan, seed)

    @property
    def effects(self) -> tuple[TrueEffect, ...]:
        """All effects that act on the robot besides its links."""
        return self.drive if self.hidden is None else (*self.drive, self.hidden)

    def start_time(self, course: Course) -> float:
        """Return the time of the session at which a course begins, s.

        Without a drift every course is a session of its own and begins at 0.
        """
        if self.hidden is None or not _is_drifting(self.hidden):
            return 0.0
        return _RUN_INTERVAL * self.plan.courses.index(course)

    @property
    def warms_up(self) -> bool:
        """Whether the joints' temperature is recorded."""
        return self.hidden is not None and get_effect(self.hidden.effect).needs_temperature

    def compute_temperature(self, t: FloatArray) -> FloatArray:
        """Return the temperature of the joints over time.

        Times t (m,) of the session in s, temperatures (m,) in degC. The arm works until the second recording is over,
        rests until the third, and works again. So what depends on the temperature does not depend on the time in the
        same way.
        """
        third = next(self.start_time(course) for course in self.plan.courses if course.name == _THIRD_RUN)
        parts = ((0.0, third - _REST_DURATION, _WARM), (third - _REST_DURATION, third, _COLD), (third, np.inf, _WARM))
        part_start, values = _COLD, np.full(len(t), _COLD)
        for begins, ends, goal in parts:
            in_part = (t >= begins) & (t < ends)
            # Each part approaches its own goal exponentially from where the part before it ended.
            values[in_part] = goal + (part_start - goal) * np.exp((begins - t[in_part]) / _WARMING_TIME)
            part_start = goal + (part_start - goal) * float(np.exp((begins - ends) / _WARMING_TIME))
        return values

    def compute_limits(self, course: Course) -> dict[str, Limits]:
        """Return the joint limits of an arm that stands in a cell, at the speed of a course."""
        limits = {}
        for joint in self.robot.joints:
            low, high = joint.reach or (-np.pi, np.pi)
            wide = joint.kind == "revolute" and high - low > 2 * _RANGE
            middle = 0.5 * (low + high)
            speed = joint.limits.velocity
            limits[joint.name] = Limits(
                position=(middle - _RANGE, middle + _RANGE) if wide else None,
                velocity=None if speed is None else course.speed * speed,
            )
        return limits


def _get_runs(effect: Effect) -> tuple[str, ...]:
    """Return the recordings that a hidden effect is in; none named: all."""
    if effect.in_some_runs:
        return (_LATER_RUN,)
    return (_FIRST_RUN,) if effect.is_transient else ()


def _is_drifting(effect: TrueEffect) -> bool:
    """Return whether an effect changes in the course of a session."""
    effect_class = get_effect(effect.effect)
    return effect_class.needs_temperature or effect_class.needs_session


def _scale_effect(effect: TrueEffect, rng: np.random.Generator, spread: float) -> TrueEffect:
    factor = 1.0 + float(rng.uniform(-spread, spread))
    return replace(effect, values=tuple((name, factor * value) for name, value in effect.values))
