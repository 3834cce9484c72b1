"""Every effect that the product knows: ours in an order for readers, then any other file of this room, then others'."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property

import casadi as ca

from dynident.effects.choices import EffectChoice
from dynident.effects.disturbances import BaseVibration, ExternalContact, Payload
from dynident.effects.drive import DriveGainError, DriveGainSaturation, RotorCoupling, TorqueDelay
from dynident.effects.effect import Column, Effect, ParameterSpec, Role, ShapeSpec
from dynident.effects.friction import (
    Coulomb,
    CoulombAsymmetric,
    LoadDependentFriction,
    PositionDependentFriction,
    Stribeck,
    Viscous,
    ViscousAsymmetric,
    ViscousNonlinear,
)
from dynident.effects.friction_in_time import TemperatureFriction, WarmUpFriction
from dynident.effects.gears import Backlash, JointElasticity
from dynident.effects.geometry import EncoderZeroError, KinematicError
from dynident.effects.plugins import effects_in_this_room, installed_effects
from dynident.effects.presliding import BreakAway, Presliding
from dynident.effects.rigid_body import RigidBody, RotorInertia
from dynident.effects.signals import RunSignal, Signals
from dynident.effects.springs import CableForce, GravityCompensator
from dynident.effects.structure import BaseTilt, JointSpring, Offset, TorqueRipple, TransmissionCoupling
from dynident.effects.tree_signals import TreeSignals
from dynident.errors import DynidentError
from dynident.robot.model import Robot

_OURS: tuple[Effect, ...] = (
    RigidBody(),
    RotorInertia(),
    Coulomb(),
    Viscous(),
    Offset(),
    CoulombAsymmetric(),
    ViscousAsymmetric(),
    Stribeck(),
    ViscousNonlinear(),
    LoadDependentFriction(),
    TemperatureFriction(),
    WarmUpFriction(),
    TorqueRipple(),
    PositionDependentFriction(),
    Presliding(),
    BreakAway(),
    Backlash(),
    JointElasticity(),
    JointSpring(),
    GravityCompensator(),
    BaseTilt(),
    Payload(),
    TransmissionCoupling(),
    RotorCoupling(),
    DriveGainError(),
    DriveGainSaturation(),
    TorqueDelay(),
    EncoderZeroError(),
    KinematicError(),
    ExternalContact(),
    BaseVibration(),
    CableForce(),
)


class Catalogue(Mapping[str, Effect]):
    """Effects by id. Those of other distributions are loaded when first asked for: they import this package."""

    @cached_property
    def _effects(self) -> dict[str, Effect]:
        ours = {effect.id: effect for effect in _OURS}
        ours |= {effect.id: effect for effect in effects_in_this_room() if effect.id not in ours}
        return ours | {effect.id: effect for effect in installed_effects(ours)}

    @contextmanager
    def with_one_more(self, effect: Effect) -> Iterator[None]:
        """The catalogue with an effect that is not installed, or another one in place of that of the same id."""
        before = dict(self._effects)
        self._effects[effect.id] = effect
        try:
            yield
        finally:
            self._effects.clear()
            self._effects.update(before)

    def __getitem__(self, identifier: str) -> Effect:
        return self._effects[identifier]

    def __iter__(self) -> Iterator[str]:
        return iter(self._effects)

    def __len__(self) -> int:
        return len(self._effects)


CATALOGUE = Catalogue()


class UnknownEffectError(DynidentError):
    """An effect, joint or shape constant that does not exist, or an effect where it cannot sit."""


def effect_by_id(identifier: str, pointer: str = "") -> Effect:
    """The effect of that id; `UnknownEffectError` names those there are."""
    try:
        return CATALOGUE[identifier]
    except KeyError:
        known = ", ".join(CATALOGUE)
        raise UnknownEffectError(
            f"there is no effect {identifier!r}; the catalogue has: {known}", pointer=pointer, title="Unknown effect"
        ) from None


def spec_of(column: Column) -> ParameterSpec | None:
    """What its effect says of a column's parameter; None for a column of no effect, as the offsets of a sensor are."""
    effect = CATALOGUE.get(column.effect)
    return next((spec for spec in effect.parameters if spec.name == column.parameter), None) if effect else None


def role_of(column: Column) -> Role | None:
    """What a column's parameter is to others than its effect."""
    spec = spec_of(column)
    return None if spec is None else spec.role


def joints_of(choice: EffectChoice, robot: Robot, pointer: str = "") -> tuple[int, ...]:
    """Indices of the joints that a choice sits on; where none is named all it may sit on, or those usual for it.

    They count the joints of the tree: where some of them follow others, what is usual for an effect of joints is to sit
    on the driven ones.
    """
    effect = effect_by_id(choice.effect, pointer)
    whole, robot = robot, robot.tree
    possible = effect.applicable(robot)
    if not possible:
        raise UnknownEffectError(f"{choice.effect} can sit on no joint of {robot.name}", pointer=pointer)
    if effect.scope == "robot":
        return possible
    if not choice.joints:
        usual = effect.unless_named(robot)
        if whole.linkage is None or effect.sits_on == "link":
            return usual
        return tuple(j for j in usual if j in whole.linkage.driven) or usual
    indices = []
    for name in choice.joints:
        if name not in robot.joint_names:
            known = ", ".join(robot.joint_names)
            raise UnknownEffectError(
                f"there is no joint {name!r}; {robot.name} has: {known}", pointer=pointer, title="Unknown joint"
            )
        index = robot.joint_names.index(name)
        if index not in possible:
            fitting = ", ".join(robot.joint_names[j] for j in possible)
            raise UnknownEffectError(
                f"{choice.effect} cannot sit on {name}; it can on: {fitting}", pointer=pointer, title="Unfit joint"
            )
        if whole.linkage is not None and index not in whole.linkage.driven and effect.sits_on == "motor":
            raise UnknownEffectError(
                f"{choice.effect} is a matter of motors, and {name} has none; driven joints: "
                f"{', '.join(whole.joint_names)}",
                pointer=pointer,
                title="Unfit joint",
            )
        indices.append(index)
    return tuple(sorted(set(indices)))


def is_change(choice: EffectChoice, since: tuple[str, ...]) -> bool:
    """Whether a choice is something that a robot may come to have, from one of the runs `since` a baseline to the last.

    What happens in a run, a touch, is none.
    """
    lasts = bool(choice.runs) and choice.runs == since[-len(choice.runs) :]
    return lasts and effect_by_id(choice.effect).may_change


def check_shape(choice: EffectChoice, pointer: str = "") -> None:
    """Raise where a choice gives a shape constant that its effect does not have, or one that makes no sense."""
    effect = effect_by_id(choice.effect, pointer)
    known = {spec.name: spec for spec in effect.shapes}
    for name, value in choice.shape:
        if name not in known:
            raise UnknownEffectError(
                f"{choice.effect} has no shape constant {name!r}; it has: {', '.join(known) or 'none'}", pointer=pointer
            )
        if not known[name].admits(value):
            raise UnknownEffectError(
                f"{name} of {choice.effect} is {value}; {_expected(known[name])}",
                pointer=f"{pointer}/shape/{name}",
                title="Impossible shape constant",
            )


def _expected(spec: ShapeSpec) -> str:
    if spec.words:
        return f"it has to be {' or '.join(f'{value:g} ({word})' for value, word in spec.words)}"
    return f"its {spec.description} has to be a finite number{_besides(spec)}"


def _besides(spec: ShapeSpec) -> str:
    if spec.signed:
        return "" if spec.may_be_zero else " other than zero"
    return ", zero or above" if spec.may_be_zero else " above zero"


def columns_of(choices: Iterable[EffectChoice], signals: Signals) -> list[Column]:
    """Columns of all choices on one robot, in their order."""
    columns: list[Column] = []
    for index, choice in enumerate(choices):
        made = columns_everywhere(choice, signals, f"/effects/{index}")
        if choice.runs or effect_by_id(choice.effect).in_some_runs:
            present = signals.in_runs(RunSignal(choice.runs))
            made = [_in_runs(column, present, choice.runs) for column in made]
        columns += made
    return columns


def columns_everywhere(choice: EffectChoice, signals: Signals, pointer: str = "") -> list[Column]:
    """Columns of a choice as if it were in all runs, whichever it is in."""
    check_shape(choice, pointer)
    joints = joints_of(choice, signals.robot, pointer)
    effect = effect_by_id(choice.effect)
    if signals.robot.linkage is None:
        return effect.columns(signals, joints, choice.shape_values)
    return _of_linked(effect, signals, signals.robot.linkage.driven, joints, choice)


def _of_linked(
    effect: Effect, signals: Signals, driven: Sequence[int], joints: Sequence[int], choice: EffectChoice
) -> list[Column]:
    """Columns on a machine some of whose joints follow others, numbered like the tree's joints.

    What sits on a driven joint has its load and its motor's torque; what sits elsewhere, or on links, is the tree's.
    """
    shape = choice.shape_values
    tree = TreeSignals.of(signals)
    if effect.sits_on == "link":
        return tree.columns(effect.columns(tree, joints, shape))
    made: list[Column] = []
    fitting = effect.applicable(signals.robot)
    on_driven = [driven.index(j) for j in joints if j in driven and driven.index(j) in fitting]
    if on_driven or effect.scope == "robot":
        own = effect.columns(signals, on_driven, shape)
        made += [_numbered(column, signals.robot, driven) for column in own]
    others = [j for j in joints if j not in driven or driven.index(j) not in fitting]
    if others and effect.scope == "joint":
        made += tree.columns(effect.columns(tree, others, shape))
    return made


def _numbered(column: Column, robot: Robot, driven: Sequence[int]) -> Column:
    """The column of a driven joint with the number of that joint on the tree in its name."""
    if column.link not in robot.joint_names:
        return column
    j = robot.joint_names.index(column.link)
    if column.name != f"{column.parameter}{j + 1}":
        return column
    return replace(column, name=f"{column.parameter}{driven[j] + 1}")


def _in_runs(column: Column, present: ca.SX, runs: tuple[str, ...]) -> Column:
    """The column in the runs where `present` is 1, and nothing in the others."""
    energy, wrench = column.energy, column.wrench
    return replace(
        column,
        torque=column.torque * present,
        runs=runs,
        energy=None if energy is None else lambda: present * energy(),
        wrench=None if wrench is None else lambda: present * wrench(),
    )
