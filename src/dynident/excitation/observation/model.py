"""The observation matrix that a design is judged by: chosen effects on a robot, as far as a motion determines them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dynident.arrays import FloatArray, IndexArray
from dynident.effects import LINKS, Column, EffectChoice, ReferenceParameters, Signals, columns_of, role_of
from dynident.errors import DynidentError
from dynident.excitation.observation.path_memory import PathMemory
from dynident.expressions import Program
from dynident.motion.trajectories.motion import Motion
from dynident.regressors.base_parameters import BaseParameters, base_parameters
from dynident.regressors.further_signals import FurtherSignals
from dynident.regressors.observation import Observation
from dynident.robot.model import INERTIAL_NAMES, Robot
from dynident.robot.pointers import listed

JUMP_TIME = 0.02
"""Seconds over which what jumps in a column is spread: a filter does the same to data."""

# Inertial parameters of a link where a load torque is needed and the description gives none: 3 kg, 10 cm off.
_PLAUSIBLE_LINK = (0.05, 0.0, 0.0, 0.05, 0.0, 0.05, 0.1, 0.1, 0.1, 3.0)


@dataclass(frozen=True, eq=False)
class DesignModel:
    """Base parameters of the chosen effects, and the columns of W that belong to them.

    `choices` are the effects that `columns` are made of: the `n_chosen` columns of the effects chosen first, then the
    links' inertial ones where they are not among them, since they predict the torque. `base` is chosen from all of
    them. `reference` are standard inertial parameters for effects that depend on the load, and behind them
    what else predicted torque is made of, zero. Equations of joints that `counted` (n,) leaves out tell nothing.
    """

    robot: Robot
    choices: tuple[EffectChoice, ...]
    signals: Signals
    columns: tuple[Column, ...]
    n_chosen: int
    base: BaseParameters
    reference: ReferenceParameters
    notes: tuple[str, ...]
    counted: NDArray[np.bool_]

    @property
    def kept(self) -> tuple[Column, ...]:
        """Columns of all base parameters, those of the effects first."""
        return tuple(self.columns[k] for k in self.base.kept)

    @property
    def n_parameters(self) -> int:
        """Number of base parameters b of the chosen effects."""
        return sum(k < self.n_chosen for k in self.base.kept)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the base parameters of the chosen effects."""
        return self.base.kept_names[: self.n_parameters]

    @cached_property
    def nominal(self) -> FloatArray:
        """Values of all base parameters as the description's inertias give them; zero for other effects, or (b,) 0."""
        if self.robot.inertias is None:
            return np.zeros(self.base.count)
        standard = np.zeros(len(self.columns))
        for k, column in enumerate(self.columns):
            if role_of(column) == "link":
                link = self.robot.tree.joint_names.index(column.link)
                standard[k] = self.robot.inertias[link, INERTIAL_NAMES.index(column.parameter)]
        values: FloatArray = self.base.grouping @ standard
        return values

    @cached_property
    def observation(self) -> Observation:
        """W for the base parameters of the chosen effects."""
        return Observation.of(self.robot, self.kept[: self.n_parameters], self.signals)

    @property
    def needs_path(self) -> bool:
        """Whether a column depends on the path up to now: W then needs samples close enough to follow it."""
        return self.observation.n_memory > 0

    def memory_along(self, q: FloatArray, *, periodic: bool = False) -> FloatArray:
        """Hysteresis states (m, number of them) along a path q (m, n) from rest, or along one period of many."""
        return PathMemory(self.observation.memory).along(q, periodic=periodic)

    def observe(
        self,
        q: FloatArray,
        dq: FloatArray,
        ddq: FloatArray,
        *,
        dddq: FloatArray | None = None,
        ddddq: FloatArray | None = None,
        memory: FloatArray | None = None,
        runs: FloatArray | None = None,
    ) -> FloatArray:
        """W (m n, b) at m samples, dense; q and its derivatives (m, n), and the hysteresis states if there are any.

        `runs` (m, number of run signals): 1 where a sample is in a signal's runs, which it is where they are left out.
        """
        observation = self.observation
        states = np.zeros((len(q), observation.n_memory)) if memory is None else memory
        entries = observation.evaluate(
            q,
            dq,
            ddq,
            reference=self.reference,
            memory=states,
            further=FurtherSignals(
                dddq=dddq, ddddq=ddddq, runs=np.ones(len(observation.runs)) if runs is None else runs, period=JUMP_TIME
            ),
        )
        w = np.zeros((len(q), self.robot.n, observation.n_columns))
        w[:, observation.entry_rows, observation.entry_columns] = entries
        w[:, ~self.counted] = 0.0
        return w.reshape(-1, observation.n_columns)

    def observe_along(self, motion: Motion, taken: IndexArray, runs: FloatArray | None = None) -> FloatArray:
        """W (m n, b) at the samples `taken` (m,) of a motion that begins at rest; `runs` as for `observe`."""
        step = float(motion.t[1] - motion.t[0]) if len(motion.t) > 1 else 1.0
        snap = np.gradient(motion.dddq, step, axis=0) if len(motion.t) > 1 else np.zeros_like(motion.dddq)
        return self.observe(
            motion.q[taken],
            motion.dq[taken],
            motion.ddq[taken],
            dddq=motion.dddq[taken],
            ddddq=snap[taken],
            memory=self.memory_along(motion.q)[taken],
            runs=runs,
        )

    @cached_property
    def _torque_program(self) -> Program:
        signals, inertias = self.signals, self.robot.inertias
        if inertias is None:
            raise DynidentError("the robot's description gives no inertias to predict torque with")
        torque = ca.mtimes(signals.mechanics.rows, ca.DM(inertias.reshape(-1)))
        return Program([signals.q, signals.dq, signals.ddq], ca.densify(torque))

    def torque(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        """Torque (m, n) of the description's inertias at q, q̇, q̈ (m, n); `DynidentError` where it has none."""
        return self._torque_program(q, dq, ddq)


def design_model(
    robot: Robot,
    effects: Sequence[EffectChoice],
    *,
    signals: Signals | None = None,
    reference: ReferenceParameters | None = None,
    other_runs: bool = False,
) -> DesignModel:
    """Set up the observation matrix of a design.

    `signals` may be those of another model of the robot, whose mechanics need not be derived again; `reference` has the
    parameters that torque is predicted with, where better ones than the description's are known.

    Columns that need a signal which a trajectory alone does not give (temperature, time) are left out, and a note says
    so. So are columns of what is in some runs only (a payload), unless there are `other_runs`: it then is in the run
    that is designed.

    Raises
    ------
    DynidentError
        For an unknown effect, an unfit joint, or where no column is left.
    """
    signals = signals or Signals(robot)
    offered = columns_of(effects, signals)
    known_symbols = _given_by_a_trajectory(signals, other_runs=other_runs)
    chosen = [column for column in offered if _names_in(column.torque) <= known_symbols]
    notes = []
    if len(chosen) < len(offered):
        kept = set(map(id, chosen))
        left_out = listed(column.name for column in offered if id(column) not in kept)
        notes.append(f"The criterion leaves out {left_out}: their columns depend on more than a trajectory gives.")
    if not chosen:
        raise DynidentError(
            "no column of W is left to design for; choose effects that depend on the motion alone",
            pointer="/effects",
        )
    known = ReferenceParameters.of_links(np.tile(np.array(_PLAUSIBLE_LINK), (robot.tree.n, 1)), robot.n)
    if reference is not None:
        known = reference
    elif robot.inertias is not None:
        known = ReferenceParameters.of_links(robot.inertias, robot.n)
    elif any(ca.depends_on(column.torque, signals.reference) for column in chosen):
        notes.append("The load torque is that of links of 3 kg each: the robot's description gives no inertias.")
    choices, columns = tuple(effects), list(chosen)
    if robot.inertias is not None:
        present = {column.name for column in chosen if role_of(column) == "link"}
        links = columns_of([LINKS], signals)
        columns += [column for column in links if column.name not in present]
        choices += (LINKS,)
    base = base_parameters(robot, columns, signals)
    return DesignModel(
        robot, choices, signals, tuple(columns), len(chosen), base, known, tuple(notes), np.full(robot.n, True)
    )


def _given_by_a_trajectory(signals: Signals, *, other_runs: bool) -> set[str]:
    """Names of the symbols that a designed trajectory has values for."""
    motion = (signals.q, signals.dq, signals.ddq, signals.dddq, signals.ddddq)
    given = ca.vertcat(*motion, signals.reference, signals.period, signals.memory_symbols)
    return _names_in(ca.vertcat(given, signals.run_symbols) if other_runs else given)


def _names_in(expression: ca.SX) -> set[str]:
    return {symbol.name() for symbol in ca.symvar(expression)}
