"""From chosen effects and a robot to columns: the joints that they act on, and their shape constants, checked.

On machines with dependent joints, also the signals of the tree that carries the links.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial

import casadi as ca

from dynident.effects.catalogue import UnknownEffectError, get_effect
from dynident.effects.dependent_joint_dynamics import TreeMotion
from dynident.effects.effect import Column, Effect, ShapeSpec
from dynident.effects.effect_choices import EffectChoice
from dynident.effects.effect_signals import MemorySignal, RunSignal, Signals
from dynident.effects.predicted_torque_expressions import DRIVE_PARAMETERS
from dynident.errors import describe_missing_joint
from dynident.expressions.sines_and_cosines import substitute_angles
from dynident.robot.robot_model import Robot


class TreeSignals(Signals):
    """Signals of the tree that carries a machine's links; `columns` projects results to the driven joints.

    Parameters
    ----------
    owner : Signals
        Signals of the driven joints; time, runs, hysteresis states and directions of friction are shared with it.
    """

    def __init__(self, owner: Signals) -> None:
        linkage = owner.robot.linkage
        assert linkage is not None
        # Symbols of its own for the motion of the tree; `to_driven` puts the motion of the driven joints in their
        # place.
        super().__init__(linkage.tree)
        self._owner = owner
        self.time, self.period = owner.time, owner.period
        count = linkage.tree.n
        # Temperatures are recorded for driven joints. Any other joint takes that of the first one that moves it.
        movers = [min(linkage.get_movers(j), default=0) for j in range(count)]
        self.temperature = owner.temperature[movers]
        prediction = owner.predicted
        # Motors sit on the driven joints alone: the other joints' drive parameters are zero.
        drives = ca.SX(count, len(DRIVE_PARAMETERS))
        drives[list(linkage.driven), :] = ca.horzcat(
            *(prediction.get_drive_parameter(name) for _, name in DRIVE_PARAMETERS)
        )
        self.reference = ca.vertcat(prediction.inertia, ca.vec(drives))
        self.motion = TreeMotion(linkage, (owner.q, owner.dq, owner.ddq, owner.dddq, owner.ddddq))
        # Hysteresis states count joints in the order of `Robot.positions`: the driven ones first.
        places = [*linkage.driven, *linkage.passive]
        self._place = [places.index(j) for j in range(count)]

    @classmethod
    def for_machine(cls, owner: Signals) -> TreeSignals:
        """Return the tree's signals for the machine of `owner`; they are built once."""
        if owner.of_tree is None:
            owner.of_tree = cls(owner)
        assert isinstance(owner.of_tree, cls)
        return owner.of_tree

    def to_driven(self, expression: ca.SX) -> ca.SX:
        """Return an expression of the tree's motion as an expression of the driven joints' motion."""
        used = {symbol.name() for symbol in ca.symvar(expression)}
        names = ("dq", "ddq", "dddq", "ddddq")
        used_names = [name for name in names if any(s.name() in used for s in ca.symvar(getattr(self, name)))]
        symbols = [getattr(self, name) for name in used_names]
        # Positions with their cosines and sines, which the closed loops have computed already.
        if any(s.name() in used for s in ca.symvar(self.q)):
            expression = substitute_angles(expression, self.q, self.motion.turns)
        if not symbols:
            return expression
        # Only derivatives that occur are substituted: the others, up to the fourth, need not even be built.
        value: ca.SX = ca.substitute(
            [expression], symbols, [ca.densify(getattr(self.motion, name)) for name in used_names]
        )[0]
        return value

    def sign_of(self, velocity: ca.SX) -> ca.SX:
        """Return the direction of friction at a relative velocity of the tree's joints."""
        return self._owner.sign_of(self.to_driven(velocity))

    def in_runs(self, signal: RunSignal) -> ca.SX:
        """Return the symbol SX (1, 1) that is 1 in the signal's runs."""
        return self._owner.in_runs(signal)

    def memory(self, signal: MemorySignal) -> ca.SX:
        """Return the symbol SX (1, 1) of a hysteresis state."""
        # The state of a path does not depend on who asks: it is kept by the machine's own signals.
        return self._owner.memory(replace(signal, joint=self._place[signal.joint]))

    def project_columns(self, tree_columns: Sequence[Column]) -> list[Column]:
        """Return columns of the tree as columns of the driven joints."""
        # All columns at once: they share most of their subexpressions.
        if not tree_columns:
            return []
        torques = self.motion.project_torque(self.to_driven(ca.horzcat(*(column.torque for column in tree_columns))))
        return [
            replace(
                column,
                torque=ca.sparsify(torque),
                energy=None if column.energy is None else partial(self._to_driven_part, column.energy),
                wrench=None if column.wrench is None else partial(self._to_driven_part, column.wrench),
            )
            for column, torque in zip(tree_columns, ca.horzsplit(torques), strict=True)
        ]

    def _to_driven_part(self, part: Callable[[], ca.SX]) -> ca.SX:
        return self.to_driven(part())


def list_possible_joints(effect: Effect, robot: Robot) -> tuple[int, ...]:
    """Return the indices of the joints that an effect can act on, without the coordinates of a base that moves.

    Of these only the last one moves a link, which is the base's; none has a motor, friction or a spring.

    Parameters
    ----------
    effect : Effect
        The effect.
    robot : Robot
        A tree of joints that all move by themselves.

    Returns
    -------
    tuple of int
        Ascending.
    """
    first = robot.n_massless if effect.sits_on == "link" else robot.n_base
    return tuple(joint for joint in effect.applicable(robot) if joint >= first)


def find_joints(choice: EffectChoice, robot: Robot, pointer: str = "") -> tuple[int, ...]:
    """Return the joints that a chosen effect acts on, as indices of the tree's joints.

    Where the choice names no joints, they are the effect's default ones: of these only the driven joints, where some
    joints follow others, unless the effect belongs to links.

    Parameters
    ----------
    choice : EffectChoice
        The effect and, where any are named, its joints.
    robot : Robot
        The robot that it acts on.
    pointer : str
        JSON pointer to the choice in the caller's request.

    Returns
    -------
    tuple of int
        Ascending, none twice.

    Raises
    ------
    UnknownEffectError
        If the choice names an unknown joint, or one on which the effect cannot act.
    """
    effect = get_effect(choice.effect, pointer)
    # Effects act on any joint of the tree, though only the driven ones have data of their own.
    whole, robot = robot, robot.tree
    possible = list_possible_joints(effect, robot)
    if not possible:
        raise UnknownEffectError(f"{choice.effect} cannot act on any joint of {robot.name}", pointer=pointer)
    # An effect of the whole robot acts on all joints that it can act on, whatever the choice names.
    if effect.scope == "robot":
        return possible
    if not choice.joints:
        usual = tuple(joint for joint in effect.get_default_joints(robot) if joint in possible)
        if whole.linkage is None or effect.sits_on == "link":
            return usual
        # If the effect fits none of the driven joints, let it act on those of the others that it fits.
        return tuple(j for j in usual if j in whole.linkage.driven) or usual
    # Joints that the user names are taken at their word, or refused with those that would be possible.
    indices = []
    for name in choice.joints:
        if name not in robot.joint_names:
            raise UnknownEffectError(
                describe_missing_joint(name, robot.joint_names), pointer=pointer, title="Unknown joint"
            )
        index = robot.joint_names.index(name)
        if index not in possible:
            fitting = ", ".join(robot.joint_names[j] for j in possible)
            raise UnknownEffectError(
                f"{choice.effect} cannot act on {name}; choose from: {fitting}", pointer=pointer, title="Unfit joint"
            )
        if whole.linkage is not None and index not in whole.linkage.driven and effect.sits_on == "motor":
            raise UnknownEffectError(
                f"{choice.effect} acts on driven joints, but {name} has no motor; driven joints: "
                f"{', '.join(whole.joint_names)}",
                pointer=pointer,
                title="Unfit joint",
            )
        indices.append(index)
    # Columns follow the order of joints, in whatever order the request names them.
    return tuple(sorted(set(indices)))


def is_lasting_change(choice: EffectChoice, since: tuple[str, ...]) -> bool:
    """Return whether a choice is a lasting change of the robot: from one of the runs `since` a baseline to the last.

    Events within a run, such as a contact, are no such change.

    Parameters
    ----------
    choice : EffectChoice
        The choice, with the runs that it is in.
    since : tuple of str
        Labels of the runs after the baseline, in the order of time.

    Returns
    -------
    bool
        Whether its runs are the last of `since`, and the effect may change from day to day.
    """
    lasts = bool(choice.runs) and choice.runs == since[-len(choice.runs) :]
    return lasts and get_effect(choice.effect).may_change


def check_shape_constants(choice: EffectChoice, pointer: str = "") -> None:
    """Raise an error if a choice has a shape constant that its effect lacks, or an impossible value.

    Parameters
    ----------
    choice : EffectChoice
        The effect and its shape constants.
    pointer : str
        JSON pointer to the choice in the caller's request.

    Raises
    ------
    UnknownEffectError
        The message says which constants there are, or which values are possible.
    """
    effect = get_effect(choice.effect, pointer)
    constants = {spec.name: spec for spec in effect.shapes}
    for name, value in choice.shape:
        if name not in constants:
            raise UnknownEffectError(
                f"{choice.effect} has no shape constant {name!r}; it has: {', '.join(constants) or 'none'}",
                pointer=pointer,
            )
        if not constants[name].admits(value):
            raise UnknownEffectError(
                f"{name} of {choice.effect} is {value}; {_describe_expected(constants[name])}",
                pointer=f"{pointer}/shape/{name}",
                title="Impossible shape constant",
            )


def _describe_expected(spec: ShapeSpec) -> str:
    if spec.words:
        return f"give {' or '.join(f'{value:g} ({word})' for value, word in spec.words)}"
    return f"its {spec.description} must be a finite number{_describe_range(spec)}"


def _describe_range(spec: ShapeSpec) -> str:
    if spec.signed:
        return "" if spec.may_be_zero else " other than zero"
    return ", zero or above" if spec.may_be_zero else " above zero"


def build_columns(choices: Iterable[EffectChoice], signals: Signals) -> list[Column]:
    """Return the columns of all chosen effects on one robot, in their order.

    Parameters
    ----------
    choices : iterable of EffectChoice
        The chosen effects, in the order of their columns.
    signals : Signals
        The symbols that the columns are made of.

    Returns
    -------
    list of Column
        One for every parameter of every effect on every joint that it acts on.

    Raises
    ------
    UnknownEffectError
        If a choice does not fit the catalogue or the robot.
    """
    columns: list[Column] = []
    for index, choice in enumerate(choices):
        choice_columns = build_columns_for_all_runs(choice, signals, f"/effects/{index}")
        # An effect that only some runs have, such as a payload, is in the runs that are marked so where none is named.
        if choice.runs or get_effect(choice.effect).in_some_runs:
            present = signals.in_runs(RunSignal(choice.runs))
            choice_columns = [_restrict_to_runs(column, present, choice.runs) for column in choice_columns]
        columns += choice_columns
    return columns


def build_columns_for_all_runs(choice: EffectChoice, signals: Signals, pointer: str = "") -> list[Column]:
    """Return the columns of a choice as if it were in all runs.

    Parameters
    ----------
    choice : EffectChoice
        The effect, its joints and its shape constants.
    signals : Signals
        The symbols that the columns are made of.
    pointer : str
        JSON pointer to the choice in the caller's request.

    Returns
    -------
    list of Column
        Joint by joint, parameter by parameter.

    Raises
    ------
    UnknownEffectError
        If the choice does not fit the catalogue or the robot.
    """
    check_shape_constants(choice, pointer)
    joints = find_joints(choice, signals.robot, pointer)
    effect = get_effect(choice.effect)
    linkage, shape = signals.robot.linkage, choice.shape_values

    def build() -> tuple[tuple[Column, ...], ca.SX]:
        if linkage is None:
            columns = effect.columns(signals, joints, shape)
        else:
            columns = _build_dependent_columns(effect, signals, linkage.driven, joints, choice)
        return tuple(columns), ca.horzcat(*(column.torque for column in columns))

    # The effect itself, because one of the user's own may have been registered anew under its id.
    return list(signals.build_once((effect, replace(choice, runs=())), build))


def _build_dependent_columns(
    effect: Effect, signals: Signals, driven: Sequence[int], joints: Sequence[int], choice: EffectChoice
) -> list[Column]:
    """Return the columns on a machine some of whose joints follow others, numbered like the tree's joints.

    An effect on a driven joint depends on that joint's load and motor torque; an effect on links or on another joint
    depends on the signals of the tree.
    """
    shape = choice.shape_values
    tree = TreeSignals.for_machine(signals)
    if effect.sits_on == "link":
        return tree.project_columns(effect.columns(tree, joints, shape))
    columns: list[Column] = []
    # An effect may fit a joint of the tree but not the driven robot, whose joints have other neighbours.
    fitting = list_possible_joints(effect, signals.robot)
    on_driven = [driven.index(j) for j in joints if j in driven and driven.index(j) in fitting]
    if on_driven or effect.scope == "robot":
        driven_columns = effect.columns(signals, on_driven, shape)
        columns += [_number_column(column, signals.robot, driven) for column in driven_columns]
    others = [j for j in joints if j not in driven or driven.index(j) not in fitting]
    if others and effect.scope == "joint":
        columns += tree.project_columns(effect.columns(tree, others, shape))
    return columns


def _number_column(column: Column, robot: Robot, driven: Sequence[int]) -> Column:
    """Return the column of a driven joint with the joint's number in the tree in its name."""
    if column.link not in robot.joint_names:
        return column
    # Effects number their columns by the robot that they were built for; elsewhere numbers are those of the tree.
    j = robot.joint_names.index(column.link)
    if column.name != f"{column.parameter}{j + 1}":
        return column
    return replace(column, name=f"{column.parameter}{driven[j] + 1}")


def _restrict_to_runs(column: Column, present: ca.SX, runs: tuple[str, ...]) -> Column:
    """Return the column multiplied by `present`, which is 1 in some runs and 0 in the others."""
    # Functions, not expressions: energies and wrenches are large, and most models never ask for them.
    energy, wrench = column.energy, column.wrench
    return replace(
        column,
        torque=column.torque * present,
        runs=runs,
        energy=None if energy is None else lambda: present * energy(),
        wrench=None if wrench is None else lambda: present * wrench(),
    )
