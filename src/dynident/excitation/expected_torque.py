"""Upper bound of the torque that an identified model predicts for a planned motion (95 % interval)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import casadi as ca
import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import Column, EffectChoice, ReferenceParameters, Signals, build_columns, get_role
from dynident.errors import DynidentError
from dynident.estimation.parameter_covariance import Statistics
from dynident.expressions import Program
from dynident.regressors.model_structure import Model
from dynident.robot.json_fields import join_names
from dynident.robot.robot_model import Robot

JUMP_TIME = 0.02
"""Time over which jumps in a column are spread, s: filtering does the same to data."""


class IdentifiedModel(Protocol):
    """An identified model: effects, base parameters, and how sure they are."""

    @property
    def model(self) -> Model:
        """The robot with the effects that were identified."""

    @property
    def values(self) -> FloatArray:
        """Base parameters (b,)."""

    @property
    def reference(self) -> ReferenceParameters:
        """The parameters that loads in the columns are predicted with."""

    @property
    def noise(self) -> FloatArray:
        """Standard deviation (n,) of every joint's residual, N m or N."""

    @property
    def statistics(self) -> Statistics:
        """Covariance of the base parameters."""


@dataclass(frozen=True, eq=False)
class ExpectedTorque:
    """Torque of a motion by an identified model, away from zero by half of its 95 % interval.

    The interval is that of the uncertain parameters and of the residual noise. Hysteresis counts with its state in
    steady motion, in which its torque is largest. A model without links is completed by the links of the description.

    Parameters
    ----------
    robot : Robot
        The robot that shall move.
    identified : IdentifiedModel
        Its identified model.
    has_loads : bool
        Whether effects of some runs alone, such as a payload, act in the motion.
    """

    robot: Robot
    identified: IdentifiedModel
    has_loads: bool = False

    def __post_init__(self) -> None:
        names = self.identified.model.robot.joint_names
        if names != self.robot.joint_names:
            raise DynidentError(
                f"the model is of a robot with the joints {join_names(names)}; this robot has "
                f"{join_names(self.robot.joint_names)}: give a model of this robot",
                pointer="/identification_id",
                title="Model of another robot",
            )

    @cached_property
    def has_links(self) -> bool:
        """Whether the model has inertial parameters of links."""
        return any(get_role(column) == "link" for column in self.identified.model.columns)

    @property
    def complete_note(self) -> str | None:
        """The note, or None where nobody knows the weight of the links, and torque cannot be checked."""
        return self.note if self.has_links or self.robot.inertias is not None else None

    @cached_property
    def _usable(self) -> tuple[int, ...]:
        """Indices of the base parameters whose columns a motion determines."""
        signals = self.identified.model.signals
        absent = ca.vertcat(signals.time, signals.temperature, signals.dddq, signals.ddddq)
        if not self.has_loads:
            absent = ca.vertcat(absent, signals.run_symbols)
        return tuple(k for k, column in enumerate(self.identified.model.kept) if not _depends_on(column, absent))

    @property
    def note(self) -> str:
        """What the torque is predicted from, and what is left out, in words for the user."""
        kept = self.identified.model.kept
        left_out = [column.name for k, column in enumerate(kept) if k not in self._usable]
        links = "" if self.has_links else ", with the links of the robot's description"
        missing = f" It leaves out {join_names(left_out)}, which need more than the motion." if left_out else ""
        return (
            f"Torque is predicted by the identified model{links}, at the outer end of its 95 % interval (uncertain "
            f"parameters and residual noise).{missing}"
        )

    def build_expression(self, signals: Signals) -> ca.SX:
        """Return the torque (n, 1) as an expression of the motion."""
        identified = self.identified
        usable = list(self._usable)
        rows = ca.horzcat(
            *(column.torque for column in _rebuild(identified.model, usable, signals)), ca.SX(signals.robot.n, 0)
        )
        memory = signals.find_memory_signals(rows)
        for item in memory:
            # Followers have no velocity of their own here: their state counts as positive.
            steady = signals.sign[item.joint] if item.joint < signals.robot.n else ca.SX(1)
            rows = ca.substitute(rows, signals.memory(item), steady)
        rows = ca.substitute(rows, signals.reference, ca.DM(identified.reference.vector))
        rows = ca.substitute(rows, signals.period, JUMP_TIME)
        rows = ca.substitute(rows, signals.run_symbols, ca.DM.ones(signals.run_symbols.numel()))
        torque = ca.mtimes(rows, ca.DM(identified.values[usable]))
        if not self.has_links and self.robot.inertias is not None:
            torque += ca.mtimes(signals.mechanics.rows, ca.DM(self.robot.inertias.reshape(-1)))
        covariance = identified.statistics.covariance[np.ix_(usable, usable)]
        return ca.vertcat(
            *(
                torque[joint] + ca.sign(torque[joint]) * self._build_half_width(rows[joint, :], covariance, joint)
                for joint in range(self.robot.n)
            )
        )

    def _build_half_width(self, row: ca.SX, covariance: FloatArray, joint: int) -> ca.SX:
        """Return half of the interval of one joint's torque, as an expression."""
        columns = row.sparsity().get_triplet()[1]
        of_parameters, of_noise = self.identified.statistics.prediction_quantiles()
        square = ca.SX((of_noise * float(self.identified.noise[joint])) ** 2)
        if columns:
            # A square root of the covariance by eigenvalues: it may be singular, and rounding may make it indefinite.
            eigenvalues, vectors = np.linalg.eigh(covariance[np.ix_(columns, columns)])
            root = of_parameters * vectors * np.sqrt(np.maximum(eigenvalues, 0.0))
            square += ca.sumsqr(ca.mtimes(ca.densify(row[:, columns]), ca.DM(root)))
        return ca.sqrt(square)

    @cached_property
    def _program(self) -> Program:
        signals = Signals(self.robot)
        return Program([signals.q, signals.dq, signals.ddq], ca.densify(self.build_expression(signals)))

    def torque(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        """Return the torque (m, n) at q, q̇, q̈ (m, n)."""
        return self._program(q, dq, ddq)


class ExpectedTorqueGradient:
    """Expected torque (N, n) at samples, and its transposed derivative.

    Parameters
    ----------
    expected : ExpectedTorque
        The torque.
    smooth_sign : float
        Velocity (rad/s, m/s) over which sign(q̇) is rounded.
    """

    def __init__(self, expected: ExpectedTorque, smooth_sign: float) -> None:
        signals = Signals(expected.robot, smooth_sign=smooth_sign)
        self._n = expected.robot.n
        torque = ca.densify(expected.build_expression(signals))
        state, seeds = ca.vertcat(signals.q, signals.dq, signals.ddq), ca.SX.sym("seeds", self._n)
        self._forward = Program([state], torque)
        self._reverse = Program([state, seeds], ca.densify(ca.jtimes(torque, state, seeds, True)))
        self._state = np.zeros((0, 3 * self._n))

    def evaluate(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        """Return the torque (N, n) at q, q̇, q̈ (N, n)."""
        self._state = np.concatenate([q, dq, ddq], axis=1)
        return self._forward(self._state)

    def pull_back(self, gradient: FloatArray) -> list[FloatArray]:
        """Return ∂/∂q, ∂/∂q̇, ∂/∂q̈ (N, n) from the derivative by the torque (N, n) of the last `evaluate`."""
        swept = self._reverse(self._state, np.ascontiguousarray(gradient))
        return [swept[:, part * self._n : (part + 1) * self._n] for part in range(3)]


def _rebuild(model: Model, indices: list[int], signals: Signals) -> list[Column]:
    """Return base columns of a model, made from other symbols."""
    effects: tuple[EffectChoice, ...] = model.effects
    by_key = {column.key: column for column in build_columns(effects, signals)}
    return [by_key[model.kept[k].key] for k in indices]


def _depends_on(column: Column, symbols: ca.SX) -> bool:
    return bool(ca.depends_on(column.torque, symbols))
