"""True effects of a virtual robot: stated values, or sizes typical of real arms; the size of unknown effects.

An effect without a known usual size gets parameters that give a chosen torque.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import (
    CATALOGUE,
    DEFAULT_EFFECTS,
    DRIVE_ROLES,
    LINKS,
    Column,
    EffectChoice,
    ReferenceParameters,
    Role,
    Signals,
    build_columns,
    get_effect,
    is_plain_friction,
)
from dynident.effects.usual_effect_sizes import get_largest_torque
from dynident.errors import DynidentError
from dynident.robot.robot_model import Robot
from dynident.simulation.simulated_signals import SensorSignals

_STATES = 200


def size_parameters(robot: Robot, effect: str, joint: str, torque: FloatArray) -> dict[str, float]:
    """Return parameters of an effect with which each of them contributes about the torque (n,) on some joint.

    The largest over the joints of rms torque over random states, relative to `torque`, is then 1 for each parameter.

    Parameters
    ----------
    robot : Robot
        The robot, as its description gives it.
    effect : str
        Id of the effect in the catalogue.
    joint : str
        Name of the joint; "" for the whole robot.
    torque : (n,)
        Torque that is wanted on each joint, N m or N.

    Returns
    -------
    dict of str to float
        Value of each parameter by its name.

    Raises
    ------
    DynidentError
        Where the effect gives no torque in any of the states.
    """
    signals = SensorSignals(robot)
    columns = build_columns([EffectChoice(effect, (joint,) if joint else ())], signals)
    stacked = ca.densify(ca.horzcat(*(column.torque for column in columns)))
    # Ranges of a brisk motion of an arm. The seed is fixed, so that sizes are the same in every call.
    rng, n = np.random.default_rng(0), robot.n
    inputs = [
        (signals.q, rng.uniform(-2, 2, (_STATES, n))),
        (signals.dq, rng.uniform(-1, 1, (_STATES, n))),
        (signals.ddq, rng.uniform(-3, 3, (_STATES, n))),
        (signals.dddq, rng.uniform(-8, 8, (_STATES, n))),
        (signals.ddddq, rng.uniform(-20, 20, (_STATES, n))),
        (signals.time, rng.uniform(0, 10, (_STATES, 1))),
        (signals.period, np.full((_STATES, 1), 1e-3)),
        (signals.temperature, rng.uniform(20, 45, (_STATES, n))),
        # Hysteresis that slides fully one way or the other has its largest torque.
        (signals.memory_symbols, rng.choice([-1.0, 1.0], (_STATES, len(signals.memory_signals)))),
        (signals.predicted.motor, torque * rng.uniform(-1, 1, (_STATES, n))),
    ]
    runs = [signals.in_runs(run) for run in signals.find_run_signals(stacked)]
    # What a column refers to, such as the Coulomb friction of its joint, is unknown here: only the links have values.
    known = ca.vertcat(signals.reference, *runs)
    stacked = ca.substitute(stacked, known, ca.vertcat(ca.SX(ca.DM(_build_reference(robot))), ca.SX.ones(len(runs), 1)))
    function = ca.Function("columns", [symbol for symbol, _ in inputs], [stacked]).map(_STATES)
    values_of_states = np.asarray(ca.DM(function(*(values.T for _, values in inputs))), dtype=np.float64)
    rows = values_of_states.reshape(n, _STATES, len(columns))
    # The largest joint counts: an effect on one joint moves torque on others, too, and none of them may exceed what was
    # asked for.
    rms = np.sqrt(np.mean(rows**2, axis=1)) / torque[:, None]
    largest = rms.max(axis=0)
    if not (np.isfinite(largest).all() and (largest > 0).all()):
        raise DynidentError(f"{effect} causes no torque on {robot.name} that can be scaled", pointer="/effect")
    return {column.parameter: float(1 / size) for column, size in zip(columns, largest, strict=True)}


def _build_reference(robot: Robot) -> FloatArray:
    links = np.zeros((robot.tree.n, 10)) if robot.inertias is None else robot.inertias
    return ReferenceParameters.from_links(links, robot.n).vector


# An effect of which nothing is known, as a share of the largest torque.
_UNKNOWN_EFFECT_SHARE = 0.02


def list_drive_effects(robot: Robot) -> tuple[TrueEffect, ...]:
    """Return rotor inertia, Coulomb and viscous friction of every joint in their usual sizes.

    Parameters
    ----------
    robot : Robot
        The robot, as its description gives it.

    Returns
    -------
    tuple of TrueEffect
        Joint by joint, those effects for which a usual size is known.
    """
    effects = []
    for choice in DEFAULT_EFFECTS:
        for j, name in enumerate(robot.joint_names):
            usual = get_effect(choice.effect).usual(robot, j)
            if usual is not None:
                effects.append(TrueEffect(choice.effect, name, tuple(usual.values.items())))
    return tuple(effects)


def build_typical_effect(robot: Robot, effect: str, joint: str = "") -> TrueEffect:
    """Return one more effect of a size as found on real arms.

    Parameters
    ----------
    robot : Robot
        The robot, as its description gives it.
    effect : str
        Id of the effect in the catalogue.
    joint : str
        Name of the joint; "" for the whole robot.

    Returns
    -------
    TrueEffect
        The effect, with a value for each of its parameters.

    Raises
    ------
    DynidentError
        For an unknown effect or joint, or an effect without a typical size (links, rotors, Coulomb, viscous).
    """
    described = get_effect(effect)
    anywhere = described.scope == "robot" or described.in_some_runs
    if not anywhere and joint not in robot.joint_names:
        raise DynidentError(
            f"{effect} needs a joint; {robot.name} has: {', '.join(robot.joint_names)}", pointer="/joint"
        )
    if any(choice.effect == effect for choice in DEFAULT_EFFECTS):
        raise DynidentError(f"{effect} has no typical size", pointer="/effect")
    where = joint if described.scope == "joint" else ""
    usual = described.usual(robot, 0 if anywhere else robot.joint_names.index(joint))
    if usual is not None:
        return TrueEffect(effect, where, tuple(usual.values.items()), tuple(usual.shape.items()))
    torque = np.array([get_largest_torque(robot, j) for j in range(robot.n)])
    parameters = size_parameters(robot, effect, where, _UNKNOWN_EFFECT_SHARE * torque)
    # Each parameter alone would give the torque; shared out, all of them together do about.
    return TrueEffect(effect, where, tuple((name, value / len(parameters)) for name, value in parameters.items()))


_TITLE = "Unusable virtual robot"
_DRIVE_ROWS: dict[Role | None, int] = {role: row for row, role in enumerate(DRIVE_ROLES)}


@dataclass(frozen=True)
class TrueEffect:
    """One effect on one joint, with its parameters and shape constants.

    Parameters
    ----------
    effect : str
        Id of the effect in the catalogue.
    joint : str
        Name of the joint; "" where the effect belongs to the whole robot.
    values : tuple of (name, value)
        Parameters, in the units of the catalogue; those that are not named are zero.
    shape : tuple of (name, value)
        Shape constants; those that are not named have their defaults.
    runs : tuple of str
        Labels of the runs in which it acts; it acts in all of them where there are none.
    """

    effect: str
    joint: str
    values: tuple[tuple[str, float], ...]
    shape: tuple[tuple[str, float], ...] = field(default=())
    runs: tuple[str, ...] = field(default=())

    @property
    def choice(self) -> EffectChoice:
        """The same effect as one chooses it for an identification."""
        return EffectChoice(self.effect, (self.joint,) if self.joint else (), self.shape, self.runs)

    def is_in(self, run: str) -> bool:
        """Return whether the effect acts in the run with that label."""
        return not self.runs or run in self.runs


@dataclass(frozen=True, eq=False)
class TrueColumns:
    """Columns of the true effects and their parameters, in the same order.

    Parameters
    ----------
    columns : tuple of Column
        Columns of all effects.
    parameters : (c,)
        Value of the parameter of each column.
    """

    columns: tuple[Column, ...]
    parameters: FloatArray


def may_be_negative(effect: str, parameter: str, runs: Sequence[str], beside: Iterable[str] = ()) -> bool:
    """Return whether physics allows a parameter below zero.

    The parameter of an effect in some runs alone is a difference from the other runs, and may have either sign. So may
    Coulomb and viscous friction beside other friction of the same joint: they are parts of a sum, which alone resists.

    Parameters
    ----------
    effect : str
        Id of the effect in the catalogue.
    parameter : str
        Name of the parameter.
    runs : sequence of str
        Labels of the runs in which the effect acts; none for all.
    beside : iterable of str
        Ids of all effects on the same joint.

    Returns
    -------
    bool
        True where no law of physics keeps the parameter at zero or above.
    """
    if runs or (is_plain_friction(effect) and has_bent_friction(beside)):
        return True
    return not any(spec.resists for spec in get_effect(effect).parameters if spec.name == parameter)


def list_possibly_negative(columns: Sequence[Column], unbounded: Iterable[str] = ()) -> list[bool]:
    """Return for each column of a model whether physics allows its parameter below zero.

    Parameters
    ----------
    columns : sequence of Column
        The columns.
    unbounded : iterable of str
        Joints at whose speeds the sum of friction cannot be looked at: each part of it must resist by itself.

    Returns
    -------
    list of bool
        One a column.
    """
    apart = set(unbounded)
    by_link: dict[str, set[str]] = {}
    for column in columns:
        by_link.setdefault(column.link, set()).add(column.effect)
    return [may_be_negative(c.effect, c.parameter, c.runs, () if c.link in apart else by_link[c.link]) for c in columns]


def has_bent_friction(effects: Iterable[str]) -> bool:
    """Return whether there is friction other than Coulomb and viscous friction among effects."""
    return any(get_effect(effect).is_friction and not is_plain_friction(effect) for effect in effects)


def spread_over_joints(
    robot: Robot, effect: str, parameter: str, values: Sequence[float] | FloatArray
) -> tuple[TrueEffect, ...]:
    """Return one parameter of one effect on every joint of a robot.

    Parameters
    ----------
    robot : Robot
        The robot, which gives the joints.
    effect, parameter : str
        Id of the effect in the catalogue, and the name of one of its parameters.
    values : (n,)
        Value of the parameter on each joint, in its unit.

    Returns
    -------
    tuple of TrueEffect
        One effect for each joint.

    Raises
    ------
    DynidentError
        Where there are not as many values as joints.
    """
    if len(values) != robot.n:
        raise DynidentError(f"{parameter} has {len(values)} values; {robot.name} has {robot.n} joints", title=_TITLE)
    return tuple(
        TrueEffect(effect, name, ((parameter, float(value)),))
        for name, value in zip(robot.joint_names, values, strict=True)
    )


def select_inertias(robot: Robot, inertias: FloatArray | None) -> FloatArray:
    """Return the inertial parameters of the virtual robot's links; the description's where none are given.

    Parameters
    ----------
    robot : Robot
        The robot, as its description gives it.
    inertias : (n, 10) or None
        Inertial parameters that replace those of the description.

    Returns
    -------
    (n, 10)
        Inertial parameters, a row a link.

    Raises
    ------
    DynidentError
        Where there are none at all, or their shape or values do not fit.
    """
    chosen = robot.inertias if inertias is None else np.asarray(inertias, dtype=np.float64)
    if chosen is None:
        raise DynidentError(
            f"the description of {robot.name} gives no inertial parameters; a virtual robot needs ten per link",
            pointer="/parameters",
            title=_TITLE,
        )
    if chosen.shape != (robot.tree.n, 10) or not np.all(np.isfinite(chosen)):
        raise DynidentError(
            f"inertial parameters have the shape {chosen.shape}; {robot.tree.n} links x 10 finite numbers are needed",
            pointer="/parameters",
            title=_TITLE,
        )
    return chosen


def build_reference(robot: Robot, effects: Sequence[TrueEffect], inertias: FloatArray) -> ReferenceParameters:
    """Return the parameters that torque is predicted with: of the links, and Ia, Fc, Fv and b of all joints.

    Parameters
    ----------
    robot : Robot
        The robot, as its description gives it.
    effects : sequence of TrueEffect
        All effects of the virtual robot.
    inertias : (n, 10)
        Inertial parameters of the links.

    Returns
    -------
    ReferenceParameters
        Parameters of the links and the drives; what no effect gives is zero.
    """
    drives = np.zeros((len(DRIVE_ROLES), robot.n))
    for effect in effects:
        roles = {spec.name: spec.role for spec in get_effect(effect.effect).parameters}
        for name, value in effect.values:
            role = roles.get(name)
            # Hysteresis is Coulomb friction once it slides.
            row = _DRIVE_ROWS.get("dry" if role == "dry_once_sliding" else role)
            # Several effects may have a part in the same role, so values add up.
            if row is not None and effect.joint in robot.joint_names:
                drives[row, robot.joint_names.index(effect.joint)] += value
    return ReferenceParameters(inertias.reshape(-1, 10), *drives)


def build_true_columns(
    effects: Sequence[TrueEffect], signals: Signals, beside: Sequence[TrueEffect] = ()
) -> TrueColumns:
    """Return the columns of the effects on the robot of `signals`, and the values of their parameters.

    Parameters
    ----------
    effects : sequence of TrueEffect
        The effects with their values.
    signals : Signals
        Signals of the robot, which the torque of the columns is an expression of.
    beside : sequence of TrueEffect
        Other effects on the robot, beside which friction may be a part of a sum.

    Returns
    -------
    TrueColumns
        The columns and the values of their parameters.

    Raises
    ------
    DynidentError
        For an unknown effect, joint, parameter or shape constant, a value that is not finite or must not be negative,
        the same effect twice on a joint, or links given as an effect.
    """
    columns: list[Column] = []
    parameters: list[float] = []
    keys: set[tuple[object, ...]] = set()
    known = [effect for effect in (*effects, *beside) if effect.effect in CATALOGUE]
    for index, effect in enumerate(effects):
        pointer = f"/effects/{index}"
        _check_effect(effect, signals.robot, pointer, known)
        try:
            effect_columns = build_columns([effect.choice], signals)
        except DynidentError as error:
            # The catalogue points into an effect; the user needs its place in the list.
            error.pointer = pointer
            raise
        # The completed shape constants, so that a default written out is the same effect as one left out.
        key = (effect.effect, effect.joint, effect_columns[0].shape, effect.runs)
        if key in keys:
            raise DynidentError(
                f"{effect.effect} is given twice on {effect.joint or 'the robot'}; give it once",
                pointer=pointer,
                title=_TITLE,
            )
        keys.add(key)
        values = dict(effect.values)
        columns += effect_columns
        parameters += [float(values.get(column.parameter, 0.0)) for column in effect_columns]
    return TrueColumns(tuple(columns), np.array(parameters, dtype=np.float64))


def _find_joint(effect: TrueEffect, robot: Robot) -> str:
    """Return the joint of an effect, which need not be named where there is only one; "" for the whole robot."""
    joints = get_effect(effect.effect).get_default_joints(robot)
    return effect.joint or (robot.joint_names[joints[0]] if len(joints) == 1 else "")


def _check_effect(effect: TrueEffect, robot: Robot, pointer: str, beside: Sequence[TrueEffect]) -> None:
    described = get_effect(effect.effect, pointer)
    if effect.effect == LINKS.effect:
        raise DynidentError(
            "the links of a virtual robot are given as inertial parameters, not as an effect",
            pointer=pointer,
            title=_TITLE,
        )
    if described.scope == "joint" and not effect.joint and len(described.get_default_joints(robot)) != 1:
        raise DynidentError(
            f"{effect.effect} needs a joint; {robot.name} has: {', '.join(robot.joint_names)}",
            pointer=f"{pointer}/joint",
            title=_TITLE,
        )
    known = [spec.name for spec in described.parameters]
    joint = _find_joint(effect, robot)
    on_joint = [other.effect for other in beside if _find_joint(other, robot) == joint]
    for name, value in effect.values:
        where = f"{pointer}/values/{name}"
        if name not in known:
            raise DynidentError(
                f"{effect.effect} has no parameter {name!r}; it has: {', '.join(known)}", pointer=where, title=_TITLE
            )
        signed = may_be_negative(effect.effect, name, effect.runs, on_joint)
        if not math.isfinite(value) or (value < 0 and not signed):
            raise DynidentError(
                f"{name} of {effect.effect} on {effect.joint or 'the robot'} is {value}; expected a finite number"
                + ("" if signed else ", zero or above"),
                pointer=where,
                title=_TITLE,
            )
    for name, value in effect.shape:
        if not math.isfinite(value):
            raise DynidentError(
                f"shape constant {name} of {effect.effect} is {value}; expected a finite number",
                pointer=f"{pointer}/shape/{name}",
                title=_TITLE,
            )
