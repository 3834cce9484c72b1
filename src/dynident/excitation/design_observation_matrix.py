"""W of a planned motion with its gradient by q, dq, ddq; locked joints and the parameters that they leave.

With locked joints (§12.3.4.2) there are fewer parameters and fewer equations. At a fixed number of samples, a reverse
sweep leads from ∂/∂W back to ∂/∂(q, q̇, q̈).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from dynident.array_types import BoolArray, FloatArray, IndexArray
from dynident.effects import LINKS, Column, EffectChoice, ReferenceParameters, Signals, build_columns, get_role
from dynident.effects.hysteresis_states import PathMemory
from dynident.errors import DynidentError
from dynident.excitation.expected_torque import JUMP_TIME, ExpectedTorque
from dynident.expressions import Program
from dynident.motion.joint_trajectories import Motion
from dynident.regressors.base_parameters import BaseParameters, find_base_parameters, select_base
from dynident.regressors.observation_matrix import FurtherSignals, Observation
from dynident.robot.json_fields import join_names
from dynident.robot.robot_model import INERTIAL_NAMES, Robot


class ObservationGradient:
    """W (N, n, c) of all base parameters of a design model at N samples of a period, and its transposed derivative.

    Parameters
    ----------
    model : DesignModel
        Model of the design.
    n_samples : int
        Number of samples N.
    smooth_sign : float
        Velocity (rad/s, m/s) over which sign(q̇) is rounded: W then changes without jumps, which a line search needs.
    """

    def __init__(self, model: DesignModel, n_samples: int, smooth_sign: float) -> None:
        self.n, self.n_samples = model.robot.n, n_samples
        signals = Signals(model.robot, smooth_sign=smooth_sign)
        columns = _rebuild_columns(model, signals)
        self.n_columns = len(columns)
        matrix = ca.horzcat(*(column.torque for column in columns))
        # Most entries of W are zero for every motion; only the others are evaluated.
        rows, at = matrix.sparsity().get_triplet()
        self._places = np.array(rows, dtype=np.intp) * self.n_columns + np.array(at, dtype=np.intp)
        memory = signals.find_memory_signals(matrix)
        states = ca.vertcat(*(signals.memory(item) for item in memory))
        derivatives = [signals.q, signals.dq, signals.ddq]
        if ca.depends_on(matrix, ca.vertcat(signals.dddq, signals.ddddq)):
            derivatives += [signals.dddq, signals.ddddq]
        self._n_derivatives = len(derivatives)
        state = ca.vertcat(*derivatives, states)
        entries = ca.substitute(ca.vec(matrix.nz[:]), signals.reference, ca.DM(model.reference.vector))
        entries = ca.substitute(entries, signals.period, JUMP_TIME)
        runs = signals.run_symbols
        entries = ca.substitute(entries, runs, ca.DM.ones(runs.numel())) if runs.numel() else entries
        seeds = ca.SX.sym("seeds", entries.numel())
        # Reverse mode: one sweep gives the gradient by all states of a sample, however many entries W has.
        swept = ca.densify(ca.jtimes(entries, state, seeds, True))
        self._memory = PathMemory(memory)
        # These arrays are used again by every evaluation, so that one object belongs to one thread.
        self._state = np.zeros((n_samples, self._n_derivatives * self.n + len(memory)))
        self._seeds = np.zeros((n_samples, entries.numel()))
        self._entries = np.zeros_like(self._seeds)
        self._swept = np.zeros_like(self._state)
        self._w = np.zeros((n_samples, self.n * self.n_columns))
        self._forward = Program([state], entries)
        self._reverse = Program([state, seeds], swept)

    def evaluate(self, *derivatives: FloatArray) -> FloatArray:
        """Return W (N, n, c) at q and its derivatives (N, n), as many as the columns need.

        The array is used again by the next call.
        """
        for part, values in enumerate(derivatives[: self._n_derivatives]):
            self._state[:, part * self.n : (part + 1) * self.n] = values
        if self._memory.signals:
            self._state[:, self._n_derivatives * self.n :] = self._memory.compute_states(derivatives[0], periodic=True)
        self._forward(self._state, out=self._entries)
        self._w[:, self._places] = self._entries
        return self._w.reshape(self.n_samples, self.n, self.n_columns)

    def pull_back(self, gradient: FloatArray) -> list[FloatArray]:
        """Return ∂/∂q, ∂/∂q̇, ∂/∂q̈, … (N, n) from ∂/∂W (N, n, c), at the states of the last `evaluate`."""
        np.take(gradient.reshape(self.n_samples, -1), self._places, axis=1, out=self._seeds)
        self._reverse(self._state, self._seeds, out=self._swept)
        n = self.n
        end = self._n_derivatives * n
        gradients = [self._swept[:, part * n : (part + 1) * n] for part in range(self._n_derivatives)]
        if self._memory.signals:
            of_path = self._memory.pull_back(self._state[:, :n], self._state[:, end:], self._swept[:, end:])
            # Positions act on W directly and through the hysteresis states; the two add up.
            gradients[0] = gradients[0] + of_path
        return gradients


def _rebuild_columns(model: DesignModel, signals: Signals) -> list[Column]:
    """Return the model's base columns, made from other symbols."""
    by_key = {column.key: column for column in build_columns(model.choices, signals)}
    return [by_key[column.key] for column in model.base_columns]


# Random states per column, and the largest velocity, acceleration, jerk and its derivative in them (rad, s).
_STATES_PER_COLUMN = 2
_VELOCITY, _ACCELERATION, _JERK, _SNAP = 2.0, 5.0, 20.0, 80.0


def lock_model(model: DesignModel, posture: FloatArray, moving: BoolArray) -> DesignModel:
    """Return the model of the arm whose other joints are locked at a posture: fewer parameters, fewer equations.

    The base parameters are those that the equations of the moving joints determine. The torque of a locked joint is
    held by its brake or against an unknown stiction: its equations do not count.

    Parameters
    ----------
    model : DesignModel
        Model of all joints.
    posture : (n,)
        Positions of the locked joints, rad or m; those of the others do not matter.
    moving : (n,)
        Which joints move.

    Returns
    -------
    DesignModel
        The model of the moving joints.

    Raises
    ------
    DynidentError
        The moving joints determine none of the parameters.
    """
    # Which parameters show is found numerically, from random states of the moving joints.
    w = model.sample_observation(posture, moving)
    names = [column.name for column in model.columns]
    visible = select_base(
        w[:, moving, : model.n_chosen].reshape(-1, model.n_chosen), tuple(names[: model.n_chosen])
    ).kept
    if not visible:
        raise DynidentError(
            "the moving joints determine none of the parameters; choose other joints or effects",
            pointer="/trajectory/joints",
        )
    # The parameters to identify come first, so that base selection keeps them before those that only predict torque.
    order = [*visible, *(k for k in range(len(names)) if k not in visible)]
    base = select_base(w[:, :, order].reshape(-1, len(order)), tuple(names[k] for k in order))
    columns = tuple(model.columns[k] for k in order)
    return replace(model, columns=columns, n_chosen=len(visible), base=base, counted=moving)


def note_locked_joints(names: Sequence[str], moving: BoolArray) -> str:
    """Return the note that names the locked joints.

    Parameters
    ----------
    names : sequence of str
        Names of the joints.
    moving : (n,)
        Which joints move.
    """
    still = [name for name, moves in zip(names, moving, strict=True) if not moves]
    return (
        f"Locked at home: {join_names(still)}. W contains the equations of the moving joints, and the parameters "
        "that these equations determine."
    )


# Inertial parameters of a link where a load torque is needed and the description gives none: 3 kg, 10 cm off.
_PLAUSIBLE_LINK = (0.05, 0.0, 0.0, 0.05, 0.0, 0.05, 0.1, 0.1, 0.1, 3.0)


@dataclass(frozen=True, eq=False)
class DesignModel:
    """Base parameters of the chosen effects, and the columns of W that belong to them.

    Parameters
    ----------
    robot : Robot
        The robot, as its description gives it.
    choices : tuple of EffectChoice
        Effects that `columns` are made of.
    signals : Signals
        Symbols that the columns are expressions of.
    columns : tuple of Column
        The `n_chosen` columns of the chosen effects, followed by the links' inertial ones where they are not among
        them, since they predict the torque.
    n_chosen : int
        Number of columns of the chosen effects.
    base : BaseParameters
        Selected from all columns.
    reference : ReferenceParameters
        Inertial parameters for effects that depend on the load, followed by zeros for all else that torque is predicted
        from.
    notes : tuple of str
        What was left out or assumed, in words for the user.
    counted : (n,)
        Which joints' equations count; the others tell nothing.
    expected : ExpectedTorque, optional
        Torque by an identified model, for the limits; by the inertias of the description where there is none.
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
    expected: ExpectedTorque | None = None

    @property
    def base_columns(self) -> tuple[Column, ...]:
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
    def nominal_values(self) -> FloatArray:
        """Values (b,) of all base parameters by the description's inertias; zero where these say nothing."""
        if self.robot.inertias is None:
            return np.zeros(self.base.count)
        # A description has values for the links alone; all other parameters count as zero.
        standard = np.zeros(len(self.columns))
        for k, column in enumerate(self.columns):
            if get_role(column) == "link":
                link = self.robot.tree.joint_names.index(column.link)
                standard[k] = self.robot.inertias[link, INERTIAL_NAMES.index(column.parameter)]
        values: FloatArray = self.base.grouping @ standard
        return values

    @cached_property
    def observation(self) -> Observation:
        """W for the base parameters of the chosen effects."""
        return Observation.from_columns(self.robot, self.base_columns[: self.n_parameters], self.signals)

    @property
    def present_entries(self) -> BoolArray:
        """Entries (n, b) of W that are not zero in every motion."""
        present = np.zeros((self.robot.n, self.observation.n_columns), bool)
        present[self.observation.entry_rows, self.observation.entry_columns] = True
        return present

    @property
    def needs_path(self) -> bool:
        """Whether a column depends on the path up to now: W then needs samples close enough to follow it."""
        return self.observation.n_memory > 0

    def compute_memory(self, q: FloatArray, *, periodic: bool = False) -> FloatArray:
        """Return hysteresis states (m, number of them) along a path q (m, n) from rest, or along one period of many.

        Parameters
        ----------
        q : (m, n)
            Positions along the path, rad or m.
        periodic : bool
            Whether the path is one period of many.
        """
        return PathMemory(self.observation.memory).compute_states(q, periodic=periodic)

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
        """Return W (m n, b) at m samples, dense.

        Parameters
        ----------
        q, dq, ddq, dddq, ddddq : (m, n)
            Position and its derivatives.
        memory : (m, k), optional
            Hysteresis states; zero where left out.
        runs : (m, number of run signals), optional
            1 where a sample is in a signal's runs; in all of them where left out.

        Returns
        -------
        (m n, b)
            Rows of W, joint by joint within each sample.
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
        # Rows are zeroed, not removed, so that each sample keeps n rows and row weights stay in place.
        w[:, ~self.counted] = 0.0
        return w.reshape(-1, observation.n_columns)

    def observe_along(self, motion: Motion, samples: IndexArray, runs: FloatArray | None = None) -> FloatArray:
        """Return W (m n, b) at the indices `samples` (m,) of a motion that begins at rest; `runs` as for `observe`.

        Parameters
        ----------
        motion : Motion
            The motion, which begins at rest.
        samples : (m,)
            Indices of the samples to evaluate.
        runs : (m, number of run signals), optional
            1 where a sample is in a signal's runs; in all of them where left out.
        """
        step = float(motion.t[1] - motion.t[0]) if len(motion.t) > 1 else 1.0
        # Motions have three derivatives; elastic gears need the fourth.
        snap = np.gradient(motion.dddq, step, axis=0) if len(motion.t) > 1 else np.zeros_like(motion.dddq)
        return self.observe(
            motion.q[samples],
            motion.dq[samples],
            motion.ddq[samples],
            dddq=motion.dddq[samples],
            ddddq=snap[samples],
            memory=self.compute_memory(motion.q)[samples],
            runs=runs,
        )

    def sample_observation(self, posture: FloatArray, moving: BoolArray) -> FloatArray:
        """Return W (m, n, c) of all columns at random states of the moving joints."""
        # A fixed seed: the same robot has the same base parameters in every run.
        rng = np.random.default_rng(0)
        robot = self.robot
        m = _STATES_PER_COLUMN * len(self.columns) + 20
        low = [-np.pi if joint.kind == "revolute" else (joint.reach or (-1.0, 1.0))[0] for joint in robot.joints]
        high = [np.pi if joint.kind == "revolute" else (joint.reach or (-1.0, 1.0))[1] for joint in robot.joints]
        q = np.where(moving, rng.uniform(low, high, (m, robot.n)), posture)
        largest = np.array([_VELOCITY, _ACCELERATION, _JERK, _SNAP])[:, None, None]
        dq, ddq, dddq, ddddq = moving * largest * rng.uniform(-1, 1, (4, m, robot.n))
        # Some states at rest: what depends on position alone must not hide behind large accelerations.
        dq[::4] *= 0.05
        ddq[::4] = 0.0
        observation = Observation.from_columns(robot, self.columns, self.signals)
        entries = observation.evaluate(
            q,
            dq,
            ddq,
            reference=self.reference,
            memory=rng.uniform(-1, 1, (m, observation.n_memory)),
            further=FurtherSignals(dddq=dddq, ddddq=ddddq, period=JUMP_TIME),
        )
        w = np.zeros((m, robot.n, len(self.columns)))
        w[:, observation.entry_rows, observation.entry_columns] = entries
        return w

    @cached_property
    def _torque_program(self) -> Program:
        signals, inertias = self.signals, self.robot.inertias
        if inertias is None:
            raise DynidentError("the robot's description gives no inertias to predict torque with")
        torque = ca.mtimes(signals.mechanics.rows, ca.DM(inertias.reshape(-1)))
        return Program([signals.q, signals.dq, signals.ddq], ca.densify(torque))

    def torque(self, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        """Return the torque (m, n) that limits are checked with at q, q̇, q̈ (m, n).

        It is that of the identified model, at the outer end of its interval, or of the description's inertias.

        Parameters
        ----------
        q, dq, ddq : (m, n)
            Positions, velocities and accelerations: rad, rad/s, rad/s² (m, m/s, m/s² where prismatic).

        Raises
        ------
        DynidentError
            The description has no inertias, and there is no identified model.
        """
        return (self._torque_program if self.expected is None else self.expected.torque)(q, dq, ddq)


def build_design_model(
    robot: Robot,
    effects: Sequence[EffectChoice],
    *,
    signals: Signals | None = None,
    reference: ReferenceParameters | None = None,
    other_runs: bool = False,
    expected: ExpectedTorque | None = None,
    has_jerk: bool = True,
) -> DesignModel:
    """Set up the observation matrix of a design.

    Columns that need a signal which a trajectory alone does not give (temperature, time) are left out, and a note says
    so. So are columns of effects in some runs only (a payload), unless there are `other_runs`: the effect then acts in
    the run that is designed.

    Parameters
    ----------
    robot : Robot
        The robot, as its description gives it.
    effects : sequence of EffectChoice
        Effects to be identified.
    signals : Signals, optional
        Those of another model of the robot, whose mechanics need not be derived again.
    reference : ReferenceParameters, optional
        Parameters that torque is predicted with, where better ones than the description's are known.
    other_runs : bool
        Whether there are earlier runs.
    expected : ExpectedTorque, optional
        Torque by an identified model.
    has_jerk : bool
        Whether derivatives of the acceleration are known.

    Returns
    -------
    DesignModel
        The columns, their base parameters, and what torque is predicted with.

    Raises
    ------
    DynidentError
        For an unknown effect, an unfit joint, or where no column is left.
    """
    signals = signals or Signals(robot)
    candidates = build_columns(effects, signals)
    known_symbols = _list_trajectory_symbols(signals, other_runs, has_jerk)
    chosen = [column for column in candidates if _list_symbol_names(column.torque) <= known_symbols]
    notes = []
    if len(chosen) < len(candidates):
        chosen_ids = set(map(id, chosen))
        left_out = join_names(column.name for column in candidates if id(column) not in chosen_ids)
        notes.append(
            f"The criterion leaves out {left_out}: their columns depend on signals that a trajectory does not contain."
        )
    if not chosen:
        raise DynidentError(
            "no column of W is left to design for; choose effects that depend on the motion alone",
            pointer="/effects",
        )
    reference_parameters = ReferenceParameters.from_links(
        np.tile(np.array(_PLAUSIBLE_LINK), (robot.tree.n, 1)), robot.n
    )
    if reference is not None:
        reference_parameters = reference
    elif robot.inertias is not None:
        reference_parameters = ReferenceParameters.from_links(robot.inertias, robot.n)
    elif any(ca.depends_on(column.torque, signals.reference) for column in chosen):
        notes.append("The load torque assumes links of 3 kg each: the robot's description gives no inertias.")
    choices, columns = tuple(effects), list(chosen)
    if robot.inertias is not None:
        present = {column.name for column in chosen if get_role(column) == "link"}
        links = build_columns([LINKS], signals)
        # Torque limits need the links' torque also where the links are not identified.
        columns += [column for column in links if column.name not in present]
        choices += (LINKS,)
    # The columns of the effects stand first, and so keep their parameters where columns depend on each other.
    base = find_base_parameters(robot, columns, signals)
    return DesignModel(
        robot,
        choices,
        signals,
        tuple(columns),
        len(chosen),
        base,
        reference_parameters,
        tuple(notes),
        np.full(robot.n, True),
        expected,
    )


def _list_trajectory_symbols(signals: Signals, other_runs: bool, has_jerk: bool) -> set[str]:
    """Return the names of the symbols that a designed trajectory has values for."""
    motion = (signals.q, signals.dq, signals.ddq, *((signals.dddq, signals.ddddq) if has_jerk else ()))
    known = ca.vertcat(*motion, signals.reference, signals.period, signals.memory_symbols)
    return _list_symbol_names(ca.vertcat(known, signals.run_symbols) if other_runs else known)


def _list_symbol_names(expression: ca.SX) -> set[str]:
    return {symbol.name() for symbol in ca.symvar(expression)}
