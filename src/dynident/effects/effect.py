"""What an effect is: a named block of columns of the observation matrix, with parameters, units and a source."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar, Literal

import casadi as ca

from dynident.effects.signals import Signals
from dynident.effects.sizes import Usual
from dynident.robot.model import Robot


@dataclass(frozen=True)
class Estimate:
    """A parameter as data ask for it, and by how much it may well be off (twice its standard deviation)."""

    value: float
    doubt: float


Role = Literal[
    "link", "load", "rotor", "dry", "dry_once_sliding", "damping", "constant", "stiffness", "at_zero", "delay"
]
"""What others than its effect have to know of a parameter.

An inertial parameter of a `link`, or of a `load` that a link carries; inertia of a `rotor`, in q̈; `dry` friction, in
sign(q̇), or the same `dry_once_sliding`; `damping`, in q̇; a `constant` torque; the `stiffness` of a spring, in
q, and its torque `at_zero`; the `delay` of the torque."""

DRIVE_ROLES: tuple[Role, ...] = ("rotor", "dry", "damping", "constant")
"""Of what a motor's torque consists beside the load."""

ExperimentKind = Literal[
    "constant_speeds",
    "slow_sweep",
    "reversals",
    "whole_range",
    "as_it_is",
    "paces",
    "with_payload",
    "cold_and_warm",
    "repeated",
]
"""Experiments that show an effect, or tell it from others: constant speeds both ways, slow and fast; a slow sweep over
the range, both ways; slow motion back and forth by growing amplitudes; all joints over the whole range, and the same
with what was added left on; one path at several paces; one motion without and with a payload, cold and warm, or
repeated."""


@dataclass(frozen=True)
class ParameterSpec:
    """One parameter of an effect. `unit` is for a revolute joint; `prismatic_unit` where it differs.

    `positive`: nature allows no other sign. `resists`: its torque opposes the motion; a robot on which it were below
    zero would run away, so that none can be simulated. A size below `least` nobody would notice; one above `most` is
    none that nature makes; between two days it differs by no more than `most_change`. `role`: what it is to those who
    write models down or predict torque; None: no more than a parameter of its effect.
    """

    name: str
    unit: str
    description: str
    prismatic_unit: str = ""
    positive: bool = False
    least: float = 0.0
    most: float = math.inf
    most_change: float = math.inf
    resists: bool = False
    role: Role | None = None

    def admits(self, found: Estimate) -> bool:
        """Whether an estimate has a sign, and is no larger than, nature allows."""
        return not (self.positive and found.value < -found.doubt) and abs(found.value) <= self.most + found.doubt

    def may_change_by(self, found: Estimate) -> bool:
        """Whether an estimated difference between two days, of either sign, is no larger than such a thing changes."""
        return abs(found.value) <= self.most_change + found.doubt

    def unit_on(self, kind: str) -> str:
        """The parameter's unit on a joint of this kind."""
        return self.prismatic_unit if kind == "prismatic" and self.prismatic_unit else self.unit


Proposal = Literal["grid", "angle_spectrum", "time_spectrum", "burst"]


@dataclass(frozen=True)
class Refinement:
    """How a shape constant is searched for around a first value: in equal ratios (step in octaves) or equal steps."""

    step: float
    in_octaves: bool = False

    def moved(self, value: float, steps: float) -> float:
        """The value so many steps on."""
        return value * 2.0 ** (self.step * steps) if self.in_octaves else value + self.step * steps


RATIO = Refinement(0.25, in_octaves=True)
"""Steps of a quarter of an octave."""


@dataclass(frozen=True)
class ShapeSpec:
    """A constant inside an effect's columns, searched for rather than solved for.

    `default` is used where nobody chose a value. `proposal` says where candidates come from: a fixed grid (`grid`), or
    lines in the spectrum of the residual over the joint's angle or over time, or the stretch of time where the residual
    is far above the rest. A constant is above zero unless it is `signed`, and zero only where it
    `may_be_zero`; it is not searched for below `least`. `resolved_by` names what a filtered position must still resolve
    for the constant to show: the displacement around a reversal, the travel since a halt, or the speed.
    `refined`: how a first value is improved; None: it is not. `is_whole`: up to `least` only whole numbers make sense.
    `natural` values are kept where they are as good. `words`: what the values of a constant mean that is no quantity
    but a choice between kinds.
    """

    name: str
    unit: str
    description: str
    default: float
    proposal: Proposal = "grid"
    relative_to_velocity: bool = False
    signed: bool = False
    may_be_zero: bool = False
    least: float = 0.0
    resolved_by: Literal["displacement", "travel", "speed"] | None = None
    refined: Refinement | None = None
    is_whole: bool = False
    natural: tuple[float, ...] = ()
    words: tuple[tuple[float, str], ...] = ()

    def word(self, value: float) -> str | None:
        """What a value means, where the constant is a choice between kinds; None where it is a number."""
        return min(self.words, key=lambda known: abs(known[0] - value))[1] if self.words else None

    def told(self, value: float, digits: str = ".3g") -> str:
        """The constant for people to read: "d0 = 0.002 rad", "law: dahl"."""
        word = self.word(value)
        if word is not None:
            return f"{self.name}: {word}"
        return f"{self.name} = {value:{digits}}{'' if self.unit == '-' else ' ' + self.unit}"

    def sensible(self, value: float) -> tuple[float, ...]:
        """The value, or the whole numbers on either side of it where there is none between."""
        if not self.is_whole or value > self.least:
            return (value,)
        return tuple(dict.fromkeys((float(math.floor(value)), float(math.ceil(value)))))

    def is_refined(self, value: float) -> bool:
        """Whether better values are searched for around this one."""
        return self.refined is not None and not (self.is_whole and value <= self.least)

    def admits(self, value: float) -> bool:
        """Whether a value makes sense for this constant."""
        if value == 0:
            return self.may_be_zero
        return math.isfinite(value) and (self.signed or value > 0)


@dataclass(frozen=True, eq=False)
class Column:
    """One column of W: the torque (n, 1) on every joint for a unit value of its parameter.

    `name` is the parameter's name with the joint's number behind it, as in [12.1] ("ZZ2", "Fc3"). `energy` gives the
    row (1, 1) of stored energy, where the effect stores any, and `wrench` the reaction (6, 1) of the base, where it is
    known: both called only by models that need them. In another process it has its names alone: what evaluates it is
    made from the expressions before.
    """

    effect: str
    parameter: str
    name: str
    link: str
    unit: str
    torque: ca.SX
    shape: tuple[tuple[str, float], ...] = ()
    energy: Callable[[], ca.SX] | None = None
    runs: tuple[str, ...] = ()
    wrench: Callable[[], ca.SX] | None = None

    def __getstate__(self) -> dict[str, object]:
        # CasADi's expressions cannot leave their process.
        return {name: value for name, value in vars(self).items() if name not in ("torque", "energy", "wrench")}

    @property
    def key(self) -> tuple[str, str, tuple[tuple[str, float], ...], tuple[str, ...]]:
        """What tells two columns of one robot apart."""
        return (self.effect, self.name, self.shape, self.runs)


class Effect(ABC):
    """A physical cause of joint torque, linear in its parameters once its shape constants stand.

    `is_inertia`: the links' and rotors' own, which are the robot itself. `of_position`: a function of positions and the
    direction. `first_order`: a sensitivity of the predicted torque. `needs_session`: it changes with the time of the
    session. `is_rough`: its formula only resembles what it stands for. `pulls_on_each`: it acts on all joints that it
    reaches, and on each by enough to be seen there. `sits_on`: where some joints follow others,
    links hang on all joints of the tree, motors on the driven ones alone. `in_some_runs`: it is the same function as
    the model itself unless it is in some of the runs only. `holds_at_rest`: all of its one parameter holds a joint that
    stands, whatever its shape constants, of which one says how fast it falls off. `acts_at_rest`: poses at which the
    robot stands tell its parameters, of links those of gravity. `may_change`: a robot gets it, or
    more or less of it, from one day to the next, `changes_with` names effects that then change, too, as a rule;
    `seldom_changes`: what is more usual and says as much takes the name. `shown_by` names parameters of which one at
    least has to act for the effect to be told by. `confused_with` names effects that leave much the same residual,
    `same_function` those that are the same function of the motion, so that no data can tell them apart, `covers` those
    that it is general enough to say as well. `experiment` shows the effect, `place_experiment` where it is, and
    `told_from` gives, by experiment, the effects that it tells this one from: a pair stands with one of the two.
    `often_missed`: its place among what most arms have and models lack, 1 first.
    """

    id: ClassVar[str]
    title: ClassVar[str]
    formula: ClassVar[str]
    parameters: ClassVar[tuple[ParameterSpec, ...]]
    signature: ClassVar[str]
    sources: ClassVar[tuple[str, ...]]
    confused_with: ClassVar[tuple[str, ...]] = ()
    same_function: ClassVar[tuple[str, ...]] = ()
    covers: ClassVar[tuple[str, ...]] = ()
    shapes: ClassVar[tuple[ShapeSpec, ...]] = ()
    scope: ClassVar[Literal["joint", "robot"]] = "joint"
    sits_on: ClassVar[Literal["joint", "link", "motor"]] = "joint"
    is_inertia: ClassVar[bool] = False
    is_friction: ClassVar[bool] = False
    is_rough: ClassVar[bool] = False
    pulls_on_each: ClassVar[bool] = False
    of_position: ClassVar[bool] = False
    first_order: ClassVar[bool] = False
    needs_load: ClassVar[bool] = False
    needs_temperature: ClassVar[bool] = False
    needs_session: ClassVar[bool] = False
    in_some_runs: ClassVar[bool] = False
    holds_at_rest: ClassVar[bool] = False
    acts_at_rest: ClassVar[bool] = False
    may_change: ClassVar[bool] = False
    changes_with: ClassVar[tuple[str, ...]] = ()
    seldom_changes: ClassVar[bool] = False
    shown_by: ClassVar[tuple[str, ...]] = ()
    experiment: ClassVar[ExperimentKind] = "whole_range"
    place_experiment: ClassVar[ExperimentKind] = "whole_range"
    told_from: ClassVar[Mapping[ExperimentKind, tuple[str, ...]]] = MappingProxyType({})
    often_missed: ClassVar[int | None] = None

    @property
    def proposal(self) -> Proposal:
        """Where candidates for its shape constants come from."""
        return self.shapes[0].proposal if self.shapes else "grid"

    @abstractmethod
    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        """Columns of this effect on the joints with these indices (ignored where the scope is the robot)."""

    def applicable(self, robot: Robot) -> tuple[int, ...]:
        """Indices of the joints that the effect may sit on."""
        return tuple(range(robot.n))

    def unless_named(self, robot: Robot) -> tuple[int, ...]:
        """Indices of the joints that it sits on where none is named: all that it may."""
        return self.applicable(robot)

    def grid(self, robot: Robot, joint: int) -> list[Mapping[str, float]]:
        """Shape constants worth trying on a joint, most plausible first."""
        return [{spec.name: spec.default for spec in self.shapes}]

    def at_starts(self, shape: Mapping[str, float]) -> bool:
        """Whether this is friction that shows where its joint starts and stops: at low speed, or after a halt."""
        return False

    def steep_at_rest(self, shape: Mapping[str, float]) -> bool:
        """Whether this is a law of the speed that rises from rest, the steeper the slower the joint moves."""
        return False

    def usual(self, robot: Robot, joint: int) -> Usual | None:
        """How large it is on a joint of a real arm (any, where the scope is the robot); None: nobody knows."""
        return None

    def held_in(self, roles: Collection[Role]) -> bool:
        """Whether a format that has words for parameters with these roles can hold the effect whole."""
        return all(spec.role in roles for spec in self.parameters)

    @property
    def is_transient(self) -> bool:
        """Whether it acts for one stretch of time."""
        return self.proposal == "burst"

    def natural(self, estimates: Mapping[str, Estimate]) -> bool:
        """Whether nature makes an effect on one joint with these parameters, by name, and anybody would notice it.

        Where several parameters have a least size, one of them has to reach its own.
        """
        return self._noticed(estimates) and all(spec.admits(found) for spec, found in self._known(estimates))

    def may_change_so(self, estimates: Mapping[str, Estimate]) -> bool:
        """The same of differences between two days: of either sign, but noticed, and no larger than they come to be."""
        return self._noticed(estimates) and all(spec.may_change_by(found) for spec, found in self._known(estimates))

    def _noticed(self, estimates: Mapping[str, Estimate]) -> bool:
        sizes = [abs(found.value) >= spec.least for spec, found in self._known(estimates) if spec.least > 0]
        return not sizes or any(sizes)

    def _known(self, estimates: Mapping[str, Estimate]) -> list[tuple[ParameterSpec, Estimate]]:
        return [(spec, estimates[spec.name]) for spec in self.parameters if spec.name in estimates]

    def shape_with_defaults(self, given: Mapping[str, float]) -> dict[str, float]:
        """The given shape constants, completed by the defaults."""
        return {spec.name: float(given.get(spec.name, spec.default)) for spec in self.shapes}

    def _column(
        self,
        signals: Signals,
        parameter: ParameterSpec,
        joint: int,
        torque: ca.SX,
        shape: Mapping[str, float] | None = None,
        energy: Callable[[], ca.SX] | None = None,
    ) -> Column:
        """A column whose torque acts on one joint; `torque` is (1, 1)."""
        rows = ca.SX(signals.robot.n, 1)
        rows[joint] = torque
        return self._reaching_column(signals, parameter, joint, rows, shape, energy)

    def _reaching_column(
        self,
        signals: Signals,
        parameter: ParameterSpec,
        joint: int,
        torque: ca.SX,
        shape: Mapping[str, float] | None = None,
        energy: Callable[[], ca.SX] | None = None,
    ) -> Column:
        """A column of one joint's parameter whose torque (n, 1) may act on any joint."""
        described = signals.robot.joints[joint]
        return Column(
            effect=self.id,
            parameter=parameter.name,
            name=f"{parameter.name}{joint + 1}",
            link=described.name,
            unit=parameter.unit_on(described.kind),
            torque=ca.sparsify(torque),
            shape=tuple(sorted((shape or {}).items())),
            energy=energy,
        )

    def _robot_column(
        self,
        parameter: ParameterSpec,
        torque: ca.SX,
        shape: Mapping[str, float] | None = None,
    ) -> Column:
        """A column of the whole robot; `torque` is (n, 1)."""
        return Column(
            effect=self.id,
            parameter=parameter.name,
            name=parameter.name,
            link="",
            unit=parameter.unit,
            torque=ca.sparsify(torque),
            shape=tuple(sorted((shape or {}).items())),
        )


def geometric_grid(first: float, last: float, factor: float) -> list[float]:
    """Values from `first` to at most `last`, each `factor` times the one before."""
    values = [first]
    while values[-1] * factor <= last * (1 + 1e-9):
        values.append(values[-1] * factor)
    return values
