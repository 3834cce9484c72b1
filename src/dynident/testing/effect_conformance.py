"""`check_effect`: test that an effect of another package keeps all rules."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import cache
from typing import get_args

import casadi as ca
import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import (
    CATALOGUE,
    DEFAULT_EFFECTS,
    Column,
    Effect,
    EffectChoice,
    ExperimentKind,
    ReferenceParameters,
    Signals,
    build_columns,
)
from dynident.effects import get_spec as described
from dynident.errors import DynidentError
from dynident.identification import IdentificationChoices, identify
from dynident.number_format import format_percent
from dynident.robot import Robot, to_pinocchio
from dynident.simulation import TrueEffect, build_typical_effect
from dynident.simulation.true_effects import list_drive_effects
from dynident.testing.trial_arm import ConformanceError, TrialRecordings, build_trial_arm, record_trial, require

_COUNT = 30
_STEP = 1e-4
"""Step of central differences in s, to each side."""
_SESSION = 6.0
"""Longest time of a random state in s."""


@dataclass(frozen=True, eq=False)
class EffectStates:
    """Columns of an effect at m random states, the first of them at rest.

    Attributes
    ----------
    robot : Robot
        The robot that the effect is on.
    signals : Signals
        Symbols of the robot's motion.
    columns : tuple of Column
        Columns of the effect.
    q, dq, ddq : (m, n)
        Positions, velocities and accelerations of the states.
    torque : (m, n, c)
        Torque of each of the c columns for a parameter of 1.
    unknown_symbols : tuple of str
        Symbols that the columns depend on although they are no signals.
    """

    robot: Robot
    signals: Signals
    columns: tuple[Column, ...]
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    torque: FloatArray
    unknown_symbols: tuple[str, ...]

    @classmethod
    def from_effect(cls, robot: Robot, effect: Effect, joints: tuple[int, ...]) -> EffectStates:
        """Return the columns of an effect on joints of a robot at random states, with usual shape constants."""
        usual = effect.usual(robot, joints[0])
        shape = effect.shape_with_defaults({} if usual is None else usual.shape)
        names = tuple(robot.joint_names[j] for j in joints) if effect.scope == "joint" else ()
        signals = Signals(robot)
        columns = tuple(build_columns([EffectChoice(effect.id, names, tuple(sorted(shape.items())))], signals))
        rng = np.random.default_rng(0)
        q, dq, ddq = (rng.uniform(-size, size, (_COUNT, robot.n)) for size in (2.0, 2.5, 6.0))
        # Rest is where signs and divisions by a speed go wrong.
        dq[0] = 0.0
        stacked = ca.horzcat(*(column.torque for column in columns)) if columns else ca.SX(robot.n, 0)
        symbols = _list_symbols(signals)
        strangers = {s.name() for s in ca.symvar(stacked)} - {s.name() for s in ca.symvar(ca.vertcat(*symbols))}
        torque = np.zeros((_COUNT, robot.n, len(columns)))
        # A function of symbols that nobody gives cannot be evaluated: the columns are then refused for that.
        if not strangers:
            function = ca.Function("columns", [signals.q, signals.dq, signals.ddq, *symbols[3:]], [ca.densify(stacked)])
            for k, state in enumerate(zip(q, dq, ddq, strict=True)):
                torque[k] = np.array(function(*state, *_draw_values(signals, rng))).reshape(robot.n, -1)
        return cls(robot, signals, columns, q, dq, ddq, torque, tuple(sorted(strangers)))

    def compute_energy_rate(self, index: int) -> FloatArray:
        """Return the rate (m,) of a column's stored energy along the motion through each state."""
        energy = self.columns[index].energy
        assert energy is not None
        signals = self.signals
        symbols = [signals.q, signals.dq, signals.run_symbols]
        function = ca.Function("energy", symbols, [energy()])
        present = np.ones(signals.run_symbols.shape[0])
        # Central differences along the parabola with the state's velocity and acceleration.
        sides = []
        for step in (_STEP, -_STEP):
            q, dq = self.q + step * self.dq + 0.5 * step**2 * self.ddq, self.dq + step * self.ddq
            sides.append(np.array([float(function(*state, present)) for state in zip(q, dq, strict=True)]))
        return np.asarray((sides[0] - sides[1]) / (2 * _STEP))


def _list_symbols(signals: Signals) -> list[ca.SX]:
    motion = [signals.q, signals.dq, signals.ddq, signals.dddq, signals.ddddq]
    others = [signals.time, signals.period, signals.temperature, signals.reference]
    return [*motion, *others, signals.memory_symbols, signals.run_symbols]


def _draw_values(signals: Signals, rng: np.random.Generator) -> list[FloatArray]:
    """Return values of the signals beside q, dq, ddq; predicted torque is that of the description."""
    n, links, ones = signals.robot.n, signals.robot.inertias, np.ones(signals.robot.n)
    if links is None:
        links = np.ones((signals.robot.tree.n, 10))
    return [
        rng.uniform(-20, 20, n),
        rng.uniform(-80, 80, n),
        rng.uniform(0, _SESSION, 1),
        np.array([1e-3]),
        rng.uniform(20, 45, n),
        ReferenceParameters(links, ones, ones, ones, ones).vector,
        rng.uniform(-1, 1, signals.memory_symbols.shape[0]),
        np.ones(signals.run_symbols.shape[0]),
    ]


_NEEDED = ("id", "title", "formula", "parameters", "signature", "sources")
_LEAST_VISIBLE, _MOST_UNEXPLAINED, _NEAR_FLOOR = 2.0, 0.5, 1.5
"""Limits on the share of torque that models leave unexplained. An effect shows if the usual model leaves
`_LEAST_VISIBLE` times as much on the trial arm with the effect as on one without. The model with the effect must then
leave at most `_MOST_UNEXPLAINED` of that, or `_NEAR_FLOOR` times what is left on the arm without the effect."""
_LARGER = 8.0
"""Factor by which an effect is enlarged that does not show at its usual size."""


def check_effect(effect: Effect | type[Effect], *, found_again: bool = True) -> tuple[str, ...]:
    """Check an effect on a small arm, whether it is installed or not.

    The check covers its description; the columns, which must have the right shape, be finite and depend on nothing but
    `Signals`, so that the torque is linear in the parameters; the stored energy against the torque by finite
    differences; the columns whose parameters have a `role`, those of links and loads against Pinocchio; the sign of
    friction; the shape constants; and that it explains the recordings of a virtual robot that has it.

    Parameters
    ----------
    effect : Effect or type of Effect
        The effect, or its class.
    found_again : bool
        Whether to simulate and identify as well, which takes some seconds.

    Returns
    -------
    tuple of str
        What was checked, and the results.

    Raises
    ------
    ConformanceError
        If a requirement does not hold; the message tells which.
    """
    tested = effect() if isinstance(effect, type) else effect
    _check_words(tested)
    # Columns, simulations and identifications find effects by their ids: the tested one need not be installed.
    with CATALOGUE.add_temporarily(tested):
        robot = build_trial_arm()
        _check_rivals(tested)
        report = [_check_shapes(tested, robot)]
        possible = tested.applicable(robot)
        if not possible:
            return (*report, "it can act on no joint of the trial arm: the other checks did not run")
        states = EffectStates.from_effect(robot, tested, possible)
        _check_columns(tested, states, possible)
        report += [_check_roles(states), _check_energy(states), _check_friction(tested, states)]
        if found_again:
            report.append(_check_recovery(tested, robot, possible))
    return tuple(report)


def _check_words(effect: Effect) -> None:
    missing = [name for name in _NEEDED if not getattr(effect, name, None)]
    require(not missing, f"{type(effect).__name__} does not define its {', '.join(missing)}")
    require(
        re.fullmatch(r"[a-z][a-z0-9_]*", effect.id), f"the id {effect.id!r} is not in small letters and underscores"
    )
    for kind, specs in (("parameters", effect.parameters), ("shape constants", effect.shapes)):
        names = [spec.name for spec in specs]
        require(len(set(names)) == len(names), f"two {kind} of {effect.id} have the same name: {', '.join(names)}")
        unsaid = [spec.name for spec in specs if not spec.unit or not spec.description]
        require(
            not unsaid, f"{', '.join(unsaid)} of {effect.id} has no unit or description; a pure number has the unit -"
        )
    unknown = set(effect.shown_by) - {spec.name for spec in effect.parameters}
    require(not unknown, f"{effect.id} is shown by {', '.join(sorted(unknown))}, which are not among its parameters")
    for spec in effect.parameters:
        require(
            0 <= spec.least < spec.most, f"{spec.name} of {effect.id}: least {spec.least} is not below most {spec.most}"
        )


def _check_rivals(effect: Effect) -> None:
    kinds = get_args(ExperimentKind)
    for kind in (effect.experiment, effect.place_experiment, *effect.told_from):
        require(kind in kinds, f"{effect.id} names the experiment {kind!r}; there are: {', '.join(kinds)}")
    distinguished = [name for names in effect.told_from.values() for name in names]
    for name in (*effect.confused_with, *effect.same_function, *effect.covers, *effect.changes_with, *distinguished):
        require(name in CATALOGUE and name != effect.id, f"{effect.id} names {name!r}, which is not another effect")


def _check_shapes(effect: Effect, robot: Robot) -> str:
    specs = {spec.name: spec for spec in effect.shapes}
    values = [effect.shape_with_defaults({})]
    for joint in effect.applicable(robot):
        grid = [dict(shape) for shape in effect.grid(robot, joint)]
        values += grid
        usual = effect.usual(robot, joint)
        if usual is not None:
            strange = set(usual.values) - {spec.name for spec in effect.parameters}
            require(
                not strange, f"usual() of {effect.id} gives {', '.join(strange)}, which are not among its parameters"
            )
            for spec in effect.parameters:
                least = usual.values.get(spec.name, 0.0)
                require(
                    least >= 0 or not (spec.positive or spec.resists), f"usual() of {effect.id} gives {spec.name} < 0"
                )
            values.append(effect.shape_with_defaults(usual.shape))
            require(
                set(usual.shape) <= set(specs), f"usual() of {effect.id} gives a shape constant that it does not have"
            )
        for shape in grid:
            require(set(shape) == set(specs), f"the grid of {effect.id} gives {sorted(shape)}, not {sorted(specs)}")
    for shape in values:
        for name, value in shape.items():
            require(specs[name].admits(value), f"{name} = {value} of {effect.id} is not admitted by its own ShapeSpec")
            require(
                not specs[name].words or specs[name].get_word(value), f"{name} = {value} of {effect.id} has no word"
            )
    return f"{len(specs)} shape constants, {len(values)} sets of values"


def _check_columns(effect: Effect, states: EffectStates, possible: tuple[int, ...]) -> None:
    robot, names = states.robot, {spec.name for spec in effect.parameters}
    require(states.columns, f"{effect.id} has no column on {robot.name}")
    keys = [column.key for column in states.columns]
    require(len(set(keys)) == len(keys), f"two columns of {effect.id} have the same name and shape constants")
    parameters = {column.parameter for column in states.columns}
    require(
        parameters == names,
        f"the columns of {effect.id} belong to {sorted(parameters)}, its parameters are {sorted(names)}",
    )
    for column in states.columns:
        shape = column.torque.shape
        require(column.effect == effect.id, f"column {column.name} belongs to {column.effect!r}, not to {effect.id}")
        require(shape == (robot.n, 1), f"column {column.name} has the shape {shape}, not ({robot.n}, 1)")
    require(
        not states.unknown_symbols,
        f"the columns of {effect.id} depend on {', '.join(states.unknown_symbols)}: a column is a function of "
        f"Signals and "
        "shape constants alone, or the torque would not be linear in the parameters",
    )
    stacked = ca.vertcat(*(column.torque for column in states.columns))
    for flag, signal, words in (
        ("needs_load", states.signals.reference, "predicted torque (signals.load)"),
        ("needs_temperature", states.signals.temperature, "temperature"),
    ):
        # Without the flag nobody would give the values: the columns would be those of a load of zero.
        require(
            getattr(effect, flag) or not ca.depends_on(stacked, signal),
            f"the columns of {effect.id} depend on the {words}; state {flag} = True in the class",
        )
    bad = [c.name for k, c in enumerate(states.columns) if not np.isfinite(states.torque[:, :, k]).all()]
    require(not bad, f"columns {', '.join(bad)} of {effect.id} are not finite everywhere (standstill included)")
    require(states.torque.any(), f"all columns of {effect.id} are zero everywhere")
    if effect.scope == "joint":
        links = {column.link for column in states.columns}
        require(links == {robot.joint_names[j] for j in possible}, f"columns of {effect.id} sit on {sorted(links)}")


def _check_roles(states: EffectStates) -> str:
    """Check that columns with a role are those of a link, a rotor, friction and so on."""
    roles = 0
    rigid = _compute_pinocchio_rows(states)
    for k, column in enumerate(states.columns):
        spec = described(column)
        # These roles do not fix a column by the state alone.
        if spec is None or spec.role in (None, "delay", "dry_once_sliding"):
            continue
        j = states.robot.joint_names.index(column.link)
        expected = np.zeros_like(states.torque[:, :, k])
        signal_of_role = {"rotor": states.ddq, "damping": states.dq, "dry": np.sign(states.dq), "stiffness": states.q}
        if spec.role in ("link", "load"):
            specs = [parameter.name for parameter in CATALOGUE[column.effect].parameters]
            expected = rigid[:, :, 10 * j + specs.index(column.parameter)]
        else:
            expected[:, j] = signal_of_role[spec.role][:, j] if spec.role in signal_of_role else 1.0
        gap = float(np.abs(states.torque[:, :, k] - expected).max())
        size = max(1.0, float(np.abs(expected).max()))
        require(
            gap <= 1e-9 * size,
            f"{column.name} has the role {spec.role}, but its column differs from that role by {gap:.2g}",
        )
        roles += 1
    return f"{roles} columns are what their roles say, those of links by Pinocchio" if roles else "no roles"


def _compute_pinocchio_rows(states: EffectStates) -> FloatArray:
    """Return Pinocchio's regressor (m, n, 10 n), with columns XX XY XZ YY YZ ZZ MX MY MZ M a link."""
    import pinocchio as pin

    model = to_pinocchio(states.robot)
    data, n = model.createData(), states.robot.n
    # Pinocchio orders the parameters of a link M, MX MY MZ, XX XY YY XZ YZ ZZ.
    order = (10 * np.arange(n)[:, None] + [4, 5, 7, 6, 8, 9, 1, 2, 3, 0]).reshape(-1)
    states_of_motion = zip(states.q, states.dq, states.ddq, strict=True)
    rows = [np.array(pin.computeJointTorqueRegressor(model, data, *state)) for state in states_of_motion]
    return np.array(rows).reshape(len(rows), n, 10 * n)[:, :, order]


def _check_energy(states: EffectStates) -> str:
    """Check by finite differences that stored energy changes by the power of the torque."""
    stored = [k for k, column in enumerate(states.columns) if column.energy is not None]
    for k in stored:
        rate = states.compute_energy_rate(k)
        power = (states.torque[:, :, k] * states.dq).sum(axis=1)
        size = max(float(np.abs(power).max()), float(np.abs(rate).max()), 1e-9)
        gap = float(np.abs(rate - power).max())
        require(
            gap <= 1e-5 * size,
            f"the energy of {states.columns[k].name} does not change by the power of its torque: the relative "
            f"difference is {gap / size:.2g}, by central differences",
        )
    return f"{len(stored)} columns with stored energy, by finite differences"


def _check_friction(effect: Effect, states: EffectStates) -> str:
    """Check that friction with a positive parameter takes energy from the motion."""
    checked = []
    for k, column in enumerate(states.columns):
        spec = described(column)
        # A column with memory or with the acceleration may give back energy that it has stored before.
        alone = not (
            ca.depends_on(column.torque, states.signals.ddq) or states.signals.find_memory_signals(column.torque)
        )
        if effect.is_friction and spec is not None and spec.positive and alone:
            power = (states.torque[:, :, k] * states.dq).sum(axis=1)
            require(
                power.min() >= -1e-12,
                f"{column.name} is friction with a positive parameter, but its column drives the motion",
            )
            checked.append(column.name)
    return f"{len(checked)} columns of friction take energy" if checked else "no friction of one sign without memory"


def _check_recovery(effect: Effect, robot: Robot, possible: tuple[int, ...]) -> str:
    """Check that the effect explains the recordings of a virtual robot that has it."""
    # An effect of the usual model is in every trial: it is enough that little is left.
    if any(choice.effect == effect.id for choice in DEFAULT_EFFECTS):
        unexplained = _compute_unexplained_share(record_trial(list_drive_effects(robot)))
        require(
            unexplained < 0.02,
            f"the usual model with {effect.id} leaves {format_percent(unexplained, decimals=1)} of the torque "
            "unexplained on an arm that has it",
        )
        return f"the usual model leaves {format_percent(unexplained)} of the torque unexplained"
    on = robot.joint_names[possible[len(possible) // 2]] if effect.scope == "joint" else ""
    try:
        usual = build_typical_effect(robot, effect.id, on)
    except DynidentError as error:
        raise ConformanceError(f"{effect.id} cannot be given a size; write usual(): {error}") from None
    # Filters and the smooth sign of friction leave some torque even without the effect; compare with that.
    floor = _get_plain_error()
    for factor in (1.0, _LARGER):
        values = tuple((name, factor * value) for name, value in usual.values)
        # An effect of some runs is put into the second one alone.
        hidden = replace(usual, values=values, runs=("run2",) if effect.in_some_runs else ())
        trial = record_trial((*list_drive_effects(robot), hidden))
        before = _compute_unexplained_share(trial)
        if before >= _LEAST_VISIBLE * floor:
            break
    else:
        return (
            f"on the trial arm the usual model without this effect leaves only {format_percent(before)} "
            "unexplained: too little to find it"
        )
    after = _compute_unexplained_share(trial, _choose_effect(effect, hidden))
    require(
        after <= max(_MOST_UNEXPLAINED * before, _NEAR_FLOOR * floor),
        f"a virtual robot has {effect.id}, without which the model leaves {format_percent(before)} of the "
        f"torque unexplained; with it the model still leaves {format_percent(after)}: its columns do not "
        "match the torque of the robot",
    )
    return f"found again: {format_percent(before)} of the torque without it, {format_percent(after)} with it"


@cache
def _get_plain_error() -> float:
    """Return the share of the torque that filters and a smooth sign of friction leave without any hidden effect."""
    return _compute_unexplained_share(record_trial(list_drive_effects(build_trial_arm())))


def _choose_effect(effect: Effect, hidden: TrueEffect) -> EffectChoice:
    shape = effect.shape_with_defaults(dict(hidden.shape))
    return EffectChoice(effect.id, hidden.choice.joints, tuple(sorted(shape.items())), hidden.runs)


def _compute_unexplained_share(trial: TrialRecordings, *more: EffectChoice) -> float:
    """Return the share of the torque that a model leaves unexplained."""
    choices = IdentificationChoices(effects=(*DEFAULT_EFFECTS, *more))
    return identify(trial.robot, trial.recordings, [], choices).fit.relative_total
