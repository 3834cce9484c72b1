"""Base class of effects: columns, parameters; which values, and changes between identifications, are plausible."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar, Literal

import casadi as ca

from dynident.effects.effect_signals import Signals
from dynident.effects.usual_effect_sizes import UsualSize
from dynident.robot.robot_model import Robot


@dataclass(frozen=True)
class Estimate:
    """An estimated parameter with its uncertainty.

    Parameters
    ----------
    value : float
        Estimate, in the parameter's unit.
    doubt : float
        Twice its standard deviation, in the same unit.
    """

    value: float
    doubt: float


Role = Literal[
    "link", "load", "rotor", "dry", "dry_once_sliding", "damping", "constant", "stiffness", "at_zero", "delay"
]
"""What code outside of an effect has to know of a parameter.

An inertial parameter of a `link`, or of a `load` that a link carries; inertia of a `rotor`, in q̈; `dry` friction, in
sign(q̇), or the same `dry_once_sliding`; `damping`, in q̇; a `constant` torque; the `stiffness` of a spring, in
q, and its torque `at_zero`; the `delay` of the torque."""

DRIVE_ROLES: tuple[Role, ...] = ("rotor", "dry", "damping", "constant")
"""Roles of the parameters that a motor's torque consists of beside the load."""

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
"""Experiments that show an effect or distinguish it from others.

In this order: constant speeds both ways, slow and fast; a slow sweep over the range, both ways; slow motion back and
forth with growing amplitudes; all joints over the whole range; the same with an added load left on; one path at several
paces; one motion without and with a payload; one motion cold and warm; one motion repeated."""


@dataclass(frozen=True)
class ParameterSpec:
    """One parameter of an effect.

    Parameters
    ----------
    name, unit, description : str
        Symbol, SI unit on a revolute joint, and meaning in a few words.
    prismatic_unit : str
        Unit on a prismatic joint, where it differs.
    positive : bool
        The parameter cannot be negative in nature.
    least, most : float
        A size below `least` is not noticeable, one above `most` does not occur.
    most_change : float
        Largest difference between two days.
    resists : bool
        Its torque opposes the motion: a robot with a negative value would run away and cannot be simulated.
    role : Role, optional
        Meaning for code that writes models down or predicts torque.
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

    def admits(self, estimate: Estimate) -> bool:
        """Return whether sign and size of an estimate are possible in nature, within its uncertainty."""
        # Limits give way by the estimate's uncertainty: noise alone must not make a true effect impossible.
        return (
            not (self.positive and estimate.value < -estimate.doubt)
            and abs(estimate.value) <= self.most + estimate.doubt
        )

    def admits_change(self, difference: Estimate) -> bool:
        """Return whether an estimated difference between two days, of either sign, is of a possible size."""
        return abs(difference.value) <= self.most_change + difference.doubt

    def get_unit(self, kind: str) -> str:
        """Return the parameter's unit on a joint of this kind."""
        return self.prismatic_unit if kind == "prismatic" and self.prismatic_unit else self.unit


Proposal = Literal["grid", "angle_spectrum", "time_spectrum", "burst"]


@dataclass(frozen=True)
class Refinement:
    """Steps of the search for a shape constant around a first value: equal ratios (in octaves) or equal steps.

    Parameters
    ----------
    step : float
        Size of a step: in octaves, or in the constant's unit.
    in_octaves : bool
        Whether steps multiply the value, by 2 to the power of `step`, instead of adding to it.
    """

    step: float
    in_octaves: bool = False

    def apply_steps(self, value: float, steps: float) -> float:
        """Return the value `steps` steps further."""
        return value * 2.0 ** (self.step * steps) if self.in_octaves else value + self.step * steps


RATIO = Refinement(0.25, in_octaves=True)
"""Steps of a quarter of an octave."""


@dataclass(frozen=True)
class ShapeSpec:
    """A constant inside an effect's columns, searched for rather than solved for.

    Parameters
    ----------
    name, unit, description : str
        Symbol, SI unit ("-" for a number) and meaning in a few words.
    default : float
        Used where nobody chose a value.
    proposal : {"grid", "angle_spectrum", "time_spectrum", "burst"}
        Source of candidates: a fixed grid; lines in the spectrum of the residual over the joint's angle or over time;
        or the interval of time in which the residual is far above the rest.
    relative_to_velocity : bool
        The constant is a velocity, which scales with the joint's limit.
    signed, may_be_zero : bool
        A constant is positive unless it is signed or may be zero.
    least : float
        The search does not go below.
    resolved_by : {"displacement", "travel", "speed"}, optional
        What a filtered position must still resolve for the constant to show: the displacement around a reversal, the
        travel since a halt, or the speed.
    refined : Refinement, optional
        How a first value is improved.
    is_whole : bool
        Up to `least` only whole numbers make sense.
    natural : tuple of float
        Values that are preferred if they fit as well.
    words : tuple of (float, str)
        Meaning of values, for a constant that is a choice between kinds and not a quantity.
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

    def get_word(self, value: float) -> str | None:
        """Return the meaning of a value if the constant is a choice between kinds; None if it is a number."""
        # The nearest meaning: a value that was computed, or read from text, need not be exact.
        return min(self.words, key=lambda meaning: abs(meaning[0] - value))[1] if self.words else None

    def format_value(self, value: float) -> str:
        """Return the constant as text for people: "d0 = 0.002 rad", "law: dahl"."""
        word = self.get_word(value)
        if word is not None:
            return f"{self.name}: {word}"
        return f"{self.name} = {value:.3g}{'' if self.unit == '-' else ' ' + self.unit}"

    def list_allowed_values(self, value: float) -> tuple[float, ...]:
        """Return the value, or the whole numbers on both sides of it where only whole numbers make sense."""
        if not self.is_whole or value > self.least:
            return (value,)
        # A value that is whole already has itself on both sides; it is listed once.
        return tuple(dict.fromkeys((float(math.floor(value)), float(math.ceil(value)))))

    def can_be_refined(self, value: float) -> bool:
        """Return whether the search looks for better values around this one."""
        return self.refined is not None and not (self.is_whole and value <= self.least)

    def admits(self, value: float) -> bool:
        """Return whether a value makes sense for this constant."""
        if value == 0:
            return self.may_be_zero
        return math.isfinite(value) and (self.signed or value > 0)


@dataclass(frozen=True, eq=False)
class Column:
    """One column of W: the torque on every joint for a unit value of its parameter.

    A pickled column has no expressions: functions are compiled from them before it is sent to another process.

    Parameters
    ----------
    effect, parameter : str
        Id of the effect, empty for a column of none, such as a sensor's offset; name in the effect ("ZZ", "Fc").
    name : str
        The parameter's name followed by the joint's number, as in [12.1] ("ZZ2", "Fc3").
    link : str
        Name of the joint or link that the parameter belongs to; empty for one of the whole robot.
    unit : str
        Unit of the parameter.
    torque : SX (n, 1)
        Torque of every joint, N m or N for one unit of the parameter.
    shape : tuple of (str, float)
        Shape constants by name, sorted.
    energy : callable, optional
        Returns the stored energy SX (1, 1), where the effect stores any; only models that need it call it.
    runs : tuple of str
        Labels of the runs that the effect is in; empty for all.
    wrench : callable, optional
        Returns the reaction SX (6, 1) of the base, where it is known; only models that need it call it.
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
        """Key that is unique among the columns of one robot."""
        return (self.effect, self.name, self.shape, self.runs)


class Effect(ABC):
    """A physical cause of joint torque that is linear in its parameters for given shape constants.

    Attributes
    ----------
    id, title, formula, signature, sources
        Name in the catalogue, title, LaTeX formula, what the residual looks like without the effect, literature.
    parameters, shapes
        Specifications of its parameters and shape constants.
    confused_with, same_function, covers
        Effects that leave much the same residual; those that are the same function of the motion, so that no data
        distinguish them; those that this one is general enough to include.
    scope, sits_on
        Whether it belongs to joints or the whole robot; and where some joints follow others, to any joint, to links
        (all joints of the tree) or to motors (the driven joints).
    is_inertia, is_friction
        Inertia of links and rotors, which are the robot itself; friction.
    is_rough
        The formula only resembles the physical cause.
    pulls_on_each
        It acts noticeably on each of the joints that it reaches.
    of_position
        A function of positions and directions of motion only.
    first_order
        A sensitivity of the predicted torque.
    needs_load, needs_temperature, needs_session
        It depends on the predicted load, on the joint's temperature, on the time of the session.
    in_some_runs
        It is the same function as the model itself unless it is in some of the runs only.
    holds_at_rest
        All of its one parameter holds a joint at rest, whatever its shape constants.
    acts_at_rest
        Recordings at rest determine its parameters; of links, those of gravity.
    may_change, changes_with, seldom_changes, shifts_zero
        It may change from day to day; what changes as well; a more usual effect is named instead; it shifts zeros.
    shown_by
        Parameters of which at least one has to act for the effect to be recognised.
    experiment, place_experiment, told_from
        Experiment that shows the effect; one that shows where it is; and by experiment, the effects that it then can be
        distinguished from (each pair is listed with one of the two).
    hardware, appearance
        Part that only some robots have and that the effect is of, by `dynident.robot.stated_settings.HARDWARE`; and
        what the data show of it, whatever its cause.
    often_missed
        Rank among the effects that most arms have and models lack, 1 first.
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
    shifts_zero: ClassVar[bool] = False
    shown_by: ClassVar[tuple[str, ...]] = ()
    experiment: ClassVar[ExperimentKind] = "whole_range"
    place_experiment: ClassVar[ExperimentKind] = "whole_range"
    told_from: ClassVar[Mapping[ExperimentKind, tuple[str, ...]]] = MappingProxyType({})
    hardware: ClassVar[str] = ""
    appearance: ClassVar[str] = ""
    often_missed: ClassVar[int | None] = None

    @property
    def proposal(self) -> Proposal:
        """Where candidates for its shape constants come from."""
        return self.shapes[0].proposal if self.shapes else "grid"

    @abstractmethod
    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        """Return the columns of this effect.

        Parameters
        ----------
        signals : Signals
            CasADi symbols, no arrays over time: `signals.dq[j]` is the velocity of joint j (see `dynident.register`).
        joints : sequence of int
            Indices of joints; ignored where the scope is the robot.
        shape : mapping of name to value
            Shape constants; missing ones have their defaults.

        Returns
        -------
        list of Column
        """

    def applicable(self, robot: Robot) -> tuple[int, ...]:
        """Return the indices of the joints that the effect can act on."""
        return tuple(range(robot.n))

    def get_default_joints(self, robot: Robot) -> tuple[int, ...]:
        """Return the indices of the joints that it acts on where none is named: by default all possible ones."""
        return self.applicable(robot)

    def grid(self, robot: Robot, joint: int) -> list[Mapping[str, float]]:
        """Return shape constants worth trying on a joint, most plausible first."""
        return [{spec.name: spec.default for spec in self.shapes}]

    def at_starts(self, shape: Mapping[str, float]) -> bool:
        """Return whether this is friction that shows where the joint starts and stops: at low speed or after a halt."""
        return False

    def is_steep_at_rest(self, shape: Mapping[str, float]) -> bool:
        """Return whether this is a function of the speed that is steepest at rest."""
        return False

    def usual(self, robot: Robot, joint: int) -> UsualSize | None:
        """Return its usual size on a joint of a real arm (any, if the scope is the robot); None if it is not known."""
        return None

    def fits_roles(self, roles: Collection[Role]) -> bool:
        """Return whether a file format for parameters with these roles can hold the whole effect."""
        return all(spec.role in roles for spec in self.parameters)

    @property
    def is_transient(self) -> bool:
        """Whether it acts in one interval of time only."""
        return self.proposal == "burst"

    def is_plausible(self, estimates: Mapping[str, Estimate], shape: Mapping[str, float]) -> bool:
        """Return whether estimates on one joint, by parameter, are possible in nature and large enough to notice.

        Where several parameters have a least size, one of them has to reach its own. `shape` are the shape constants.
        """
        # Large enough to notice in one of its parameters, and possible in all of them.
        return self._is_noticeable(estimates) and all(
            spec.admits(estimate) for spec, estimate in self._pair_estimates(estimates)
        )

    def is_plausible_change(self, estimates: Mapping[str, Estimate]) -> bool:
        """Return whether differences between two days, by parameter, are noticeable and of possible size."""
        return self._is_noticeable(estimates) and all(
            spec.admits_change(difference) for spec, difference in self._pair_estimates(estimates)
        )

    def _is_noticeable(self, estimates: Mapping[str, Estimate]) -> bool:
        # Parameters without a least size say nothing here: an effect that has no other ones is always noticeable.
        sizes = [
            abs(estimate.value) >= spec.least for spec, estimate in self._pair_estimates(estimates) if spec.least > 0
        ]
        return not sizes or any(sizes)

    def _pair_estimates(self, estimates: Mapping[str, Estimate]) -> list[tuple[ParameterSpec, Estimate]]:
        # Parameters that the data do not determine have no estimate, and are not judged.
        return [(spec, estimates[spec.name]) for spec in self.parameters if spec.name in estimates]

    def shape_with_defaults(self, chosen: Mapping[str, float]) -> dict[str, float]:
        """Return the chosen shape constants, completed by the defaults."""
        return {spec.name: float(chosen.get(spec.name, spec.default)) for spec in self.shapes}

    def _column(
        self,
        signals: Signals,
        parameter: ParameterSpec,
        joint: int,
        torque: ca.SX,
        shape: Mapping[str, float] | None = None,
        energy: Callable[[], ca.SX] | None = None,
    ) -> Column:
        """Return a column whose torque acts on one joint; `torque` is (1, 1)."""
        # An empty SX holds structural zeros: the other joints' entries of W are neither stored nor evaluated.
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
        """Return a column of one joint's parameter whose torque (n, 1) may act on any joint."""
        described = signals.robot.joints[joint]
        # Constants are sorted, so that equal ones make equal keys whatever their order.
        return Column(
            effect=self.id,
            parameter=parameter.name,
            name=f"{parameter.name}{joint + 1}",
            link=described.name,
            unit=parameter.get_unit(described.kind),
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
        """Return a column of the whole robot; `torque` is (n, 1)."""
        return Column(
            effect=self.id,
            parameter=parameter.name,
            name=parameter.name,
            link="",
            unit=parameter.unit,
            torque=ca.sparsify(torque),
            shape=tuple(sorted((shape or {}).items())),
        )


def build_geometric_grid(first: float, last: float, factor: float) -> list[float]:
    """Return values from `first` to at most `last`, each `factor` (above 1) times the one before."""
    values = [first]
    # The tolerance keeps a last value that rounding has moved just beyond the end.
    while values[-1] * factor <= last * (1 + 1e-9):
        values.append(values[-1] * factor)
    return values
