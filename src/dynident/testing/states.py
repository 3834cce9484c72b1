"""Columns of one effect as numbers, at random states of an arm."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from dynident.arrays import FloatArray
from dynident.effects import Column, Effect, EffectChoice, ReferenceParameters, Signals, build_columns
from dynident.robot import Robot

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
    robot, signals, columns
        The robot, its signals, and the columns of the effect.
    q, dq, ddq : ndarray (m, n)
    torque : ndarray (m, n, number of columns)
        For unit parameters.
    strangers : tuple of str
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
        dq[0] = 0.0
        stacked = ca.horzcat(*(column.torque for column in columns)) if columns else ca.SX(robot.n, 0)
        symbols = _list_symbols(signals)
        strangers = {s.name() for s in ca.symvar(stacked)} - {s.name() for s in ca.symvar(ca.vertcat(*symbols))}
        torque = np.zeros((_COUNT, robot.n, len(columns)))
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
