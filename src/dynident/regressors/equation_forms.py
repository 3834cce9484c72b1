"""The form d/dt(S χ) + D χ = y of the filtered, power, energy and wrench models: S, D and y as expressions.

Every model of the chapter is d/dt(S χ) + D χ = y, with S and D free of accelerations wherever a column has an energy:

* filtered dynamic [12.35]: S = ∂e/∂q̇ (B1), D = ∂u/∂q - ∂e/∂q (B2), y = Γ;
* power [12.51] and, integrated, energy [12.43]: S = h = e + u, y = Γᵀq̇;
* base wrench (§12.8; West, Raucent, Geffard): S = 0, D the reaction of the base, y the measured one.

A column without an energy (friction, a payload's run, a sensitivity) enters D as torque, or as its power.

The six equations of the base show more than the joints' torques do: links' parameters that only load the base. They are
appended to the base parameters of the dynamic model as separate coordinates, so that the base parameters keep their
meaning.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise

import casadi as ca
import numpy as np

from dynident.array_types import FloatArray, IndexArray
from dynident.effects import Column, Signals
from dynident.recordings import SampleBlock
from dynident.recordings.recording import WRENCH_NAMES
from dynident.regressors.base_parameters import DEFAULT_TOLERANCE, evaluate_at_random_states, select_base
from dynident.regressors.model_structure import Model
from dynident.regressors.observation_matrix import Observation
from dynident.robot.robot_model import Robot

# Rows of the random observation matrix for every column: twice as many as would do.
_STATES_PER_COLUMN = 2
# Share of a base parameter that the wrench may leave open: what rounded right angles in a description make of it.
_LEFT_OPEN = 1e-3


@dataclass(frozen=True, eq=False)
class WrenchModel:
    """The equations of the base's wrench for one model.

    Parameters
    ----------
    form : EquationForm
        The six equations in c independent columns.
    coordinates : (c, e + b)
        Gives the parameters of these columns from e that only the wrench shows and, behind these, the model's b base
        parameters.
    n_extra : int
        Number e of parameters that only the wrench shows.
    unseen : tuple of str
        Names of base parameters that the wrench does not show.
    """

    form: EquationForm
    coordinates: FloatArray
    n_extra: int
    unseen: tuple[str, ...]


def build_wrench_model(model: Model, *, tolerance: float = DEFAULT_TOLERANCE) -> WrenchModel:
    """Build the equations of the base's wrench for a model.

    The wrench is that of all links of the model, of the base link and of the sensor's offsets.

    Parameters
    ----------
    model : Model
        The dynamic model whose base parameters are kept.
    tolerance : float
        Share of a column that may be left outside the others for it to count as dependent on them.

    Returns
    -------
    WrenchModel
        The equations, and their parameters in terms of the model's base parameters.
    """
    columns = (*model.columns, *_build_constant_columns(model.robot.n))
    whole = build_wrench_form(model.robot, columns, model.signals)
    names = tuple(column.name for column in columns)
    w = evaluate_at_random_states(whole.observation, _STATES_PER_COLUMN * len(columns) // 6 + 40)
    base = select_base(w, names, tolerance)
    independent = list(base.kept)
    # The six offsets of the sensor belong to no base parameter of the model.
    grouping = np.hstack([model.base.grouping, np.zeros((model.n_parameters, 6))])
    visible = grouping[:, independent]
    norms = np.linalg.norm(w, axis=0)
    unseen = _find_invisible_parameters(grouping, visible @ base.grouping, norms)
    # In columns of equal size, what is at right angles to the base parameters completes them.
    scaled = visible / norms[independent]
    q, _ = np.linalg.qr(scaled.T, mode="complete")
    extra = q[:, model.n_parameters :].T * norms[independent]
    # [extra; visible] leads from the parameters of the independent columns to the coordinates; its inverse leads back.
    coordinates = np.linalg.pinv(np.vstack([extra, visible]) / norms[independent]) / norms[independent][:, None]
    form = build_wrench_form(model.robot, [columns[k] for k in independent], model.signals)
    return WrenchModel(form, coordinates, len(extra), tuple(model.base.kept_names[k] for k in unseen))


def _find_invisible_parameters(grouping: FloatArray, reproduced: FloatArray, norms: FloatArray) -> list[int]:
    """Return the base parameters that are no combination of what the wrench shows, weighed by effect on it."""
    # A standard parameter without any effect on the wrench has infinite weight: if a base parameter holds one, the
    # wrench cannot determine it.
    size = np.where(norms > 0, 1.0 / np.where(norms > 0, norms, 1.0), np.inf)
    gap = np.where(grouping == reproduced, 0.0, np.abs(grouping - reproduced))
    with np.errstate(invalid="ignore"):
        whole = np.where(grouping == 0, 0.0, np.abs(grouping) * size)
        missing = np.where(gap == 0, 0.0, gap * size)
    finite = np.where(np.isfinite(whole), whole, 0.0).max(axis=1, initial=0.0)
    return [int(k) for k in np.flatnonzero(missing.max(axis=1, initial=0.0) > _LEFT_OPEN * finite)]


def _build_constant_columns(n: int) -> list[Column]:
    """Return one constant column for each component: the weight of the base link and the offsets of the sensor."""
    units = ("N",) * 3 + ("N m",) * 3
    return [
        Column("", name, name, "", unit, ca.SX(n, 1), wrench=partial(_build_unit_wrench, k))
        for k, (name, unit) in enumerate(zip(WRENCH_NAMES, units, strict=True))
    ]


def _build_unit_wrench(component: int) -> ca.SX:
    rows = ca.SX(6, 1)
    rows[component] = 1.0
    return rows


Measured = Callable[[SampleBlock], FloatArray]
"""What the equations' right-hand side is at the samples of a block: (m, number of equations)."""


@dataclass(frozen=True, eq=False)
class EquationForm:
    """d/dt(S χ) + D χ = y of one set of columns.

    Parameters
    ----------
    observation : Observation
        Rows of S, then those of D, `n_equations` each.
    n_equations : int
        Number of equations: one a joint, one, or six.
    measured : function
        Gives y (m, n_equations) of a block of m samples.
    """

    observation: Observation
    n_equations: int
    measured: Measured

    @property
    def has_rates(self) -> bool:
        """Whether anything is differentiated."""
        return self.n_stored > 0

    @cached_property
    def n_stored(self) -> int:
        """Number of entries of an evaluation that belong to S: the first ones."""
        # CasADi lists entries column by column, and the columns of S stood before those of D: see `_build_form`.
        return int(np.count_nonzero(self.observation.entry_rows < self.n_equations))

    @property
    def n_entries(self) -> int:
        """Number of entries of dS/dt + D: those of S in their order, then those that D alone has."""
        return len(self._places) - len(self.shared_entries[0])

    @cached_property
    def shared_entries(self) -> tuple[IndexArray, IndexArray]:
        """Entries of an evaluation that belong to D where S has one as well, and their places in dS/dt + D."""
        stored = self._places[: self.n_stored]
        # Where the sorted places of S have each shared place of D: its entry is added to that of dS/dt.
        order = np.argsort(stored)
        selected = self.n_stored + np.flatnonzero(np.isin(self._places[self.n_stored :], stored))
        return selected, order[np.searchsorted(stored, self._places[selected], sorter=order)]

    @cached_property
    def separate_entries(self) -> IndexArray:
        """Entries of an evaluation that belong to D where S has none."""
        return np.setdiff1d(np.arange(self.n_stored, len(self._places)), self.shared_entries[0])

    @property
    def layout(self) -> list[tuple[IndexArray, IndexArray]]:
        """For every equation: where its entries stand, and their columns, in ascending order."""
        places = np.concatenate([self._places[: self.n_stored], self._places[self.separate_entries]])
        order = np.argsort(places)
        rows, columns = places[order] // self._width, places[order] % self._width
        borders = np.searchsorted(rows, np.arange(self.n_equations + 1))
        return [(order[first:last], columns[first:last]) for first, last in pairwise(borders)]

    @property
    def _width(self) -> int:
        return max(1, self.observation.n_columns)

    @cached_property
    def _places(self) -> IndexArray:
        """For every entry of an evaluation: row and column in dS/dt + D, as one number."""
        places = self.observation.entry_rows % self.n_equations * self._width + self.observation.entry_columns
        return np.asarray(places, dtype=np.intp)


def build_filtered_form(robot: Robot, columns: Sequence[Column], signals: Signals) -> EquationForm:
    """Build the dynamic model without accelerations, [12.27] and [12.35]-[12.37]: one equation a joint.

    Parameters
    ----------
    robot : Robot
    columns : sequence of Column
        One for every parameter of the model.
    signals : Signals
        The symbols that the columns are made of.

    Returns
    -------
    EquationForm
        S = ∂e/∂q̇ and D = ∂u/∂q - ∂e/∂q, with the torque of columns without an energy in D.
    """
    with_energy = _have_energy(columns)
    h = _stack_energies(columns)
    # The potential energy is what is left of h without velocities: ∂u/∂q - ∂e/∂q = ∂(2u - h)/∂q.
    # Kinetic energy vanishes without velocities.
    u = ca.substitute(h, signals.dq, ca.SX.zeros(robot.n))
    momentum = ca.jacobian(h, signals.dq).T
    force = ca.jacobian(2 * u - h, signals.q).T
    others = [ca.SX(robot.n, 1) if with_energy[k] else column.torque for k, column in enumerate(columns)]
    stored = _insert_empty_columns(momentum, with_energy, robot.n)
    direct = _insert_empty_columns(force, with_energy, robot.n) + ca.horzcat(*others)
    return _build_form(robot, columns, signals, stored, direct, lambda block: block.tau)


def build_power_form(robot: Robot, columns: Sequence[Column], signals: Signals) -> EquationForm:
    """Build the power model [12.50]-[12.51], which is the integrand of the energy model [12.43] too: one equation.

    Parameters
    ----------
    robot : Robot
        Robot that the columns belong to.
    columns : sequence of Column
        One for every parameter of the model.
    signals : Signals
        The symbols that the columns are made of.

    Returns
    -------
    EquationForm
        S = e + u, with the power of columns without an energy in D; of one equation.
    """
    with_energy = _have_energy(columns)
    # Power of a column is its torque times the velocities, where it is not the rate of an energy.
    others = [
        ca.SX(1, 1) if with_energy[k] else ca.mtimes(signals.dq.T, column.torque) for k, column in enumerate(columns)
    ]
    stored = _insert_empty_columns(_stack_energies(columns), with_energy, 1)
    return _build_form(robot, columns, signals, stored, ca.horzcat(*others), _measured_power)


def build_wrench_form(robot: Robot, columns: Sequence[Column], signals: Signals) -> EquationForm:
    """Build the reaction of the base (§12.8): force and moment at the base frame's origin, along its axes.

    Parameters
    ----------
    robot : Robot
        Robot that the columns belong to.
    columns : sequence of Column
        One for every parameter of the model.
    signals : Signals
        The symbols that the columns are made of.

    Returns
    -------
    EquationForm
        D alone; of six equations.

    Raises
    ------
    ValueError
        For a column that has no wrench.
    """
    # Nothing is differentiated, so that S is empty and all of the equation is D.
    reactions = []
    for column in columns:
        if column.wrench is None:
            raise ValueError(f"{column.name} has no wrench")
        reactions.append(column.wrench())
    return _build_form(robot, columns, signals, ca.SX(6, len(columns)), ca.horzcat(*reactions), _measured_wrench)


def _measured_wrench(block: SampleBlock) -> FloatArray:
    """Return the measured wrench (m, 6)."""
    if block.wrench is None:
        raise ValueError("the samples have no wrench")
    return block.wrench


def _measured_power(block: SampleBlock) -> FloatArray:
    """Return the power Γᵀq̇ (m, 1)."""
    return np.asarray(np.einsum("ij,ij->i", block.tau, block.dq)[:, None])


def _have_energy(columns: Sequence[Column]) -> list[bool]:
    return [column.energy is not None for column in columns]


def _stack_energies(columns: Sequence[Column]) -> ca.SX:
    """Return the energies, SX (1, number of columns with an energy)."""
    return ca.horzcat(ca.SX(1, 0), *(column.energy() for column in columns if column.energy is not None))


def _insert_empty_columns(rows: ca.SX, with_energy: Sequence[bool], n_rows: int) -> ca.SX:
    """Return the rows (k, number of columns with an energy) with empty columns for those without one."""
    # The running count of columns with an energy gives each of them its place among the rows that were differentiated.
    numbers = np.cumsum(with_energy) - 1
    return ca.horzcat(
        *(rows[:, int(k)] if has else ca.SX(n_rows, 1) for k, has in zip(numbers, with_energy, strict=True))
    )


def _build_form(
    robot: Robot, columns: Sequence[Column], signals: Signals, stored: ca.SX, direct: ca.SX, measured: Measured
) -> EquationForm:
    # Side by side, so that the entries of S come first; then the rows of D are put under those of S.
    both = Observation.from_matrix(robot, columns, ca.sparsify(ca.horzcat(stored, direct)), signals)
    k, width = stored.shape
    below = both.entry_columns >= width
    observation = replace(
        both,
        entry_rows=both.entry_rows + k * below,
        entry_columns=both.entry_columns - width * below,
        n_rows=2 * k,
    )
    return EquationForm(observation, k, measured)
