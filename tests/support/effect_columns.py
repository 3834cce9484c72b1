"""Columns of effects as numbers, at random states of an arm."""

from __future__ import annotations

import casadi as ca
import numpy as np
from support.oracles import FloatArray, pinocchio_rows, random_states

from dynident.effects import Column, EffectChoice, RunSignal, Signals, build_columns
from dynident.robot import Robot

COUNT = 40
PUBLISHED = (
    "rigid_body", "rotor_inertia", "coulomb", "viscous", "offset", "coulomb_asymmetric", "viscous_asymmetric",
    "stribeck", "viscous_nonlinear", "load_dependent_friction", "temperature_friction", "warm_up_friction",
    "torque_ripple", "position_dependent_friction", "presliding", "break_away", "backlash", "joint_elasticity",
    "joint_spring", "gravity_compensator", "base_tilt", "payload", "transmission_coupling", "rotor_coupling",
    "drive_gain_error", "drive_gain_saturation", "torque_delay", "encoder_zero_error", "kinematic_error",
    "external_contact", "base_vibration", "cable_force",
)  # fmt: skip


class Evaluated:
    """Columns of choices on an arm at random states, with the states and the predicted load beside them.

    The first state is at rest. `time` is that of a session of ten minutes, the first half of it within the first second
    and a half; `runs` are in the order of `run_signals`.
    """

    def __init__(self, robot: Robot, *choices: EffectChoice, smooth_sign: float = 0.0, seed: int = 0) -> None:
        self.robot = robot
        self.signals = s = Signals(robot, smooth_sign=smooth_sign)
        self.columns: list[Column] = build_columns(choices, s)
        rng = np.random.default_rng(seed)
        self.q, self.dq, self.ddq = random_states(robot, COUNT, seed)
        self.dq[0] = 0.0
        self.dddq, self.ddddq = rng.uniform(-20, 20, (COUNT, robot.n)), rng.uniform(-80, 80, (COUNT, robot.n))
        self.time = np.where(np.arange(COUNT) < COUNT // 2, rng.uniform(0, 1.5, COUNT), rng.uniform(0, 600, COUNT))
        self.temperature = rng.uniform(10, 50, (COUNT, robot.n))
        assert robot.inertias is not None
        self.inertia = (robot.inertias + rng.uniform(0.02, 0.1, (robot.n, 10))).ravel()
        self.drives = rng.uniform(0.5, 1.5, (4, robot.n))
        self.reference = np.concatenate([self.inertia, self.drives.ravel()])
        self.z = rng.uniform(-1, 1, (COUNT, len(s.memory_signals)))
        self.load = pinocchio_rows(robot, self.q, self.dq, self.ddq) @ self.inertia
        stacked = ca.densify(ca.horzcat(*(column.torque for column in self.columns)))
        self.run_signals: tuple[RunSignal, ...] = s.find_run_signals(stacked)
        self.runs = rng.integers(0, 2, (COUNT, len(self.run_signals))).astype(float)
        present = ca.vertcat(*(s.in_runs(run) for run in self.run_signals)) if self.run_signals else ca.SX(0, 1)
        state = [s.q, s.dq, s.ddq, s.dddq, s.ddddq, s.time, s.temperature, s.memory_symbols, present]
        function = ca.Function("c", [*state, s.period, s.reference], [stacked])
        rows = zip(
            self.q, self.dq, self.ddq, self.dddq, self.ddddq, self.time, self.temperature, self.z, self.runs,
            strict=True,
        )  # fmt: skip
        self.values = np.array([np.array(function(*row, 1e-3, self.reference)).reshape(robot.n, -1) for row in rows])

    def column(self, name: str) -> FloatArray:
        """(COUNT, n)."""
        return self.values[:, :, [column.name for column in self.columns].index(name)]
