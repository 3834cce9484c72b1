"""What an effect is: a named block of columns of the observation matrix, with parameters, units and a source."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Literal

import casadi as ca

from dynident.effects.signals import Signals
from dynident.robot.model import Robot


@dataclass(frozen=True)
class ParameterSpec:
    """One parameter of an effect. `unit` is for a revolute joint; `prismatic_unit` where it differs."""

    name: str
    unit: str
    description: str
    prismatic_unit: str = ""

    def unit_on(self, kind: str) -> str:
        """The parameter's unit on a joint of this kind."""
        return self.prismatic_unit if kind == "prismatic" and self.prismatic_unit else self.unit


@dataclass(frozen=True)
class ShapeSpec:
    """A constant inside an effect's columns, searched for rather than solved for.

    `default` is used where nobody chose a value. `proposal` says where candidates come from: a fixed grid (`grid`), or
    lines in the spectrum of the residual over the joint's angle. A constant is above zero unless it is `signed`; it is
    not searched for below `least`. `resolved_by` names what a filtered position must still resolve for the constant to
    show: the displacement or the speed around a reversal.
    """

    name: str
    unit: str
    description: str
    default: float
    proposal: Literal["grid", "angle_spectrum"] = "grid"
    relative_to_velocity: bool = False
    signed: bool = False
    least: float = 0.0
    resolved_by: Literal["displacement", "speed"] | None = None

    def admits(self, value: float) -> bool:
        """Whether a value makes sense for this constant."""
        return math.isfinite(value) and (value != 0 if self.signed else value > 0)


@dataclass(frozen=True, eq=False)
class Column:
    """One column of W: the torque (n, 1) on every joint for a unit value of its parameter.

    `name` is the parameter's name with the joint's number behind it, as in [12.1] ("ZZ2", "Fc3"). `energy` gives the
    row (1, 1) of stored energy, where the effect stores any: called only by models that need it.
    """

    effect: str
    parameter: str
    name: str
    link: str
    unit: str
    torque: ca.SX
    shape: tuple[tuple[str, float], ...] = ()
    energy: Callable[[], ca.SX] | None = None


@dataclass(frozen=True)
class EffectChoice:
    """An effect that somebody chose, on some joints (all that it may sit on where empty), with shape constants."""

    effect: str
    joints: tuple[str, ...] = ()
    shape: tuple[tuple[str, float], ...] = field(default=())

    @property
    def shape_values(self) -> dict[str, float]:
        """The chosen shape constants by name."""
        return dict(self.shape)


class Effect(ABC):
    """A physical cause of joint torque, linear in its parameters once its shape constants stand.

    `confused_with` names effects that leave much the same residual; `same_function` those that are the same function
    of the motion, so that no data can tell them apart.
    """

    id: ClassVar[str]
    title: ClassVar[str]
    formula: ClassVar[str]
    parameters: ClassVar[tuple[ParameterSpec, ...]]
    signature: ClassVar[str]
    sources: ClassVar[tuple[str, ...]]
    confused_with: ClassVar[tuple[str, ...]] = ()
    same_function: ClassVar[tuple[str, ...]] = ()
    shapes: ClassVar[tuple[ShapeSpec, ...]] = ()
    scope: ClassVar[Literal["joint", "robot"]] = "joint"
    is_friction: ClassVar[bool] = False
    needs_load: ClassVar[bool] = False

    @abstractmethod
    def columns(self, signals: Signals, joints: Sequence[int], shape: Mapping[str, float]) -> list[Column]:
        """Columns of this effect on the joints with these indices (ignored where the scope is the robot)."""

    def applicable(self, robot: Robot) -> tuple[int, ...]:
        """Indices of the joints that the effect may sit on."""
        return tuple(range(robot.n))

    def grid(self, robot: Robot, joint: int) -> list[Mapping[str, float]]:
        """Shape constants worth trying on a joint, most plausible first."""
        return [{spec.name: spec.default for spec in self.shapes}]

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
        described = signals.robot.joints[joint]
        rows = ca.SX(signals.robot.n, 1)
        rows[joint] = torque
        return Column(
            effect=self.id,
            parameter=parameter.name,
            name=f"{parameter.name}{joint + 1}",
            link=described.name,
            unit=parameter.unit_on(described.kind),
            torque=ca.sparsify(rows),
            shape=tuple(sorted((shape or {}).items())),
            energy=energy,
        )


def geometric_grid(first: float, last: float, factor: float) -> list[float]:
    """Values from `first` to at most `last`, each `factor` times the one before."""
    values = [first]
    while values[-1] * factor <= last * (1 + 1e-9):
        values.append(values[-1] * factor)
    return values
