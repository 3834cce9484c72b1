"""Base parameters: group standard parameters by QR on random states; the tolerance of a dependent column (2e-5).

Numerical method of the chapter's appendix 5 (QR on a random observation matrix): a column that depends on columns
already kept is regrouped into them. Columns are taken from the base to the tool, so that the parameters that vanish
are those of the distal link, regrouped into its antecedent, as in the symbolic method of Khalil.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import qr

from dynident.array_types import BoolArray, FloatArray
from dynident.effects import Column, ReferenceParameters, Signals, count_reference_parameters
from dynident.regressors.observation_matrix import FurtherSignals, Observation
from dynident.robot.robot_model import Robot

DEFAULT_TOLERANCE = 2e-5
"""Share of a column that may be left outside the kept ones: above what rounded right angles in a URDF leave behind."""

# A column whose norm is below this share of the largest norm has no effect on the torque.
_NULL = 1e-8
# Or below this share of the largest of its kind: angles written with six digits tilt an axis by less.
_OF_KIND = 1e-6
# Coordinates below this, of columns of unit length, are rounding errors and become zero.
_ROUNDING = 1e-9
# Rows of the random observation matrix for every column: twice as many as would do.
_STATES_PER_COLUMN = 2


@dataclass(frozen=True, eq=False)
class BaseParameters:
    """Which of the columns are kept, and what the others add to them.

    Parameters
    ----------
    names : tuple of str
        Names of all c standard parameters, in the order of the columns.
    kept : tuple of int
        Indices of the b columns that are kept.
    grouping : (b, c)
        Weight of every standard parameter in every base parameter: base = grouping @ standard.
    written : (b, c)
        Which weights are large enough to be part of a formula that somebody reads.
    without_effect : tuple of int
        Indices of the columns that are zero in all states.
    rank : int
        Numerical rank by QR with column pivoting, as a check of b.
    """

    names: tuple[str, ...]
    kept: tuple[int, ...]
    grouping: FloatArray
    written: BoolArray
    without_effect: tuple[int, ...]
    rank: int

    def __repr__(self) -> str:
        return f"BaseParameters({self.count} of {len(self.names)} standard parameters)"

    @property
    def count(self) -> int:
        """Number of base parameters."""
        return len(self.kept)

    @property
    def kept_names(self) -> tuple[str, ...]:
        """The base parameters' names: those of their leading standard parameter."""
        return tuple(self.names[k] for k in self.kept)

    @cached_property
    def groupings(self) -> tuple[str, ...]:
        """Each base parameter written out in standard parameters: "ZZ1 + Ia1 + 0.5 MX2"."""
        return tuple(
            _format_grouping(
                [self.names[k] for k in _order_terms(is_written, lead)], row[_order_terms(is_written, lead)]
            )
            for row, is_written, lead in zip(self.grouping, self.written, self.kept, strict=True)
        )


def find_base_parameters(
    robot: Robot,
    columns: Sequence[Column],
    signals: Signals,
    *,
    tolerance: float = DEFAULT_TOLERANCE,
    seed: int = 0,
    at_rest: bool = False,
) -> BaseParameters:
    """Choose the base parameters of a set of columns.

    Parameters
    ----------
    robot : Robot
        Robot that the columns belong to.
    columns : sequence of Column
        Standard parameters in the order of preference: of dependent columns the earlier one is kept.
    signals : Signals
        The symbols that the columns are made of.
    tolerance : float
        Share of a column's norm that may be left outside the kept ones for it to count as dependent.
    seed : int
        Seed of the random states.
    at_rest : bool
        Whether only what shows while the robot stands is kept.

    Returns
    -------
    BaseParameters
        The kept columns, and how the others group into them.
    """
    observation = Observation.from_columns(robot, columns, signals)
    n_states = _STATES_PER_COLUMN * len(columns) // robot.n + 20
    w = evaluate_at_random_states(observation, n_states, seed, at_rest=at_rest)
    kinds = tuple((column.effect, column.unit) for column in columns)
    return select_base(w, tuple(column.name for column in columns), tolerance, kinds=kinds)


def find_base_parameters_among(
    base: BaseParameters, observation: Observation, column_indices: Sequence[int], tolerance: float = DEFAULT_TOLERANCE
) -> BaseParameters:
    """Choose the base parameters of some of the columns of a model, from the model's own base parameters.

    Parameters
    ----------
    base : BaseParameters
        Of all columns of the model.
    observation : Observation
        W of these base parameters; no other has to be built.
    column_indices : sequence of int
        Places of the columns in the model, in the order of preference.
    tolerance : float
        As in `find_base_parameters`.

    Returns
    -------
    BaseParameters
        Of these columns alone; indices count among them.
    """
    n_states = _STATES_PER_COLUMN * len(base.names) // observation.robot.n + 20
    # Dependent columns are combinations of the kept ones, so that W of all columns is W of the base times the grouping.
    w = evaluate_at_random_states(observation, n_states) @ base.grouping[:, list(column_indices)]
    return select_base(w, tuple(base.names[k] for k in column_indices), tolerance)


def select_base(
    w: FloatArray,
    names: tuple[str, ...],
    tolerance: float = DEFAULT_TOLERANCE,
    n_known: int = 0,
    kinds: Sequence[tuple[str, str]] | None = None,
) -> BaseParameters:
    """Choose independent columns of an observation matrix, earlier columns first.

    Parameters
    ----------
    w : (r, c)
        Observation matrix at random states.
    names : tuple of str
        One a column.
    tolerance : float
        Share of a column's norm outside the columns before it, up to which it counts as dependent on them.
    n_known : int
        So many leading columns are independent already: they are kept, however little of them these states show.
    kinds : sequence of (str, str), optional
        Effects and units of the parameters. A column has no effect if its share of the largest one of its effect and
        unit is at most 1e-6: as the first moment of a link on a vertical axis that rounding tilts by 1e-7.

    Returns
    -------
    BaseParameters
        The independent columns, and how the others group into them.
    """
    norms = np.linalg.norm(w, axis=0)
    largest = norms.max(initial=0.0)
    # Zeroed before scaling: a column of rounding errors, scaled up, would pass for an independent one.
    null = norms <= _NULL * largest
    for kind in set(kinds or ()):
        alike = np.array([other == kind for other in kinds or ()])
        null |= alike & (norms <= _OF_KIND * norms[alike].max())
    null[:n_known] = norms[:n_known] <= 0.0
    scaled = np.where(null, 0.0, w / np.where(null, 1.0, norms))
    # Gram-Schmidt in the given order, not with pivoting: of dependent columns the earlier one has to stay, so that
    # the base parameters keep their usual names.
    basis = np.empty((w.shape[0], w.shape[1]))
    independent: list[int] = []
    for k in np.flatnonzero(~null):
        remainder = scaled[:, k].copy()
        for _ in range(2):  # twice is enough (Giraud, Langou and Rozložník 2005)
            remainder -= basis[:, : len(independent)] @ (basis[:, : len(independent)].T @ remainder)
        size = float(np.linalg.norm(remainder))
        if size > tolerance or (k < n_known and size > 0.0):
            basis[:, len(independent)] = remainder / size
            independent.append(int(k))
    grouping = np.zeros((len(independent), w.shape[1]))
    written = np.zeros(grouping.shape, dtype=bool)
    if independent:
        # All columns, written in the independent ones: their coordinates in the orthonormal basis decide, which is
        # better conditioned than least squares on w itself.
        q = basis[:, : len(independent)]
        in_kept = np.linalg.solve(q.T @ scaled[:, independent], q.T @ scaled)
        # Back from columns of unit length to the columns' own sizes.
        grouping = in_kept * norms / norms[independent][:, None]
        grouping[np.abs(in_kept) < _ROUNDING] = 0.0
        grouping[:, independent] = np.eye(len(independent))
        # What rounded right angles leave behind belongs to the grouping, but not to a formula that somebody reads.
        written = (np.abs(in_kept) >= 10 * tolerance) & (grouping != 0)
    return BaseParameters(
        names=names,
        kept=tuple(independent),
        grouping=grouping,
        written=written,
        without_effect=tuple(int(k) for k in np.flatnonzero(null)),
        rank=_compute_pivoted_rank(scaled, tolerance),
    )


def _compute_pivoted_rank(scaled: FloatArray, tolerance: float) -> int:
    """Return the numerical rank by QR with column pivoting, as a check of the number of base parameters."""
    if scaled.shape[1] == 0:
        return 0
    diagonal = np.abs(np.diag(qr(scaled, mode="r", pivoting=True)[0]))
    return int(np.count_nonzero(diagonal > tolerance * diagonal[0])) if diagonal[0] > 0 else 0


def evaluate_at_random_states(
    observation: Observation, n_states: int, seed: int = 0, *, at_rest: bool = False
) -> FloatArray:
    """Evaluate the observation matrix at random states, as a dense matrix: small, for its structure alone.

    Parameters
    ----------
    observation : Observation
        The matrix W to evaluate.
    n_states : int
        Number of states.
    seed : int
        Seed of the random states.
    at_rest : bool
        Whether the robot stands in all states.

    Returns
    -------
    (n_states · n_rows, c)
        Rows of joints without torque are zero.
    """
    rng = np.random.default_rng(seed)
    robot = observation.robot
    n = robot.n
    low, high = np.full(n, -np.pi), np.full(n, np.pi)
    for j, joint in enumerate(robot.joints):
        if joint.kind == "prismatic":
            # Angles repeat after a turn, lengths do not: their columns grow with the range.
            low[j], high[j] = joint.reach or (-1.0, 1.0)
    # With closed loops not every joint position is possible: random ones have to close the loops.
    closure = None if robot.linkage is None else robot.linkage.closure
    q = rng.uniform(low, high, (n_states, n)) if closure is None else closure.draw_postures(rng, n_states)
    dq, ddq = rng.uniform(-2, 2, (n_states, n)), rng.uniform(-5, 5, (n_states, n))
    dddq, ddddq = rng.uniform(-20, 20, (n_states, n)), rng.uniform(-80, 80, (n_states, n))
    # A quarter of the states nearly at rest: what depends on position alone must not hide behind large accelerations.
    dq[::4] *= 0.05
    ddq[::4] = 0.0
    if at_rest:
        dq, ddq, dddq, ddddq = (np.zeros((n_states, n)) for _ in range(4))
    times, temperature = _draw_times(observation, n_states, rng), rng.uniform(15, 45, (n_states, n))
    entries = observation.evaluate(
        q,
        dq,
        ddq,
        # Any state in range will do, whether or not a path leads there: only independence of the columns is asked for.
        memory=rng.uniform(-1, 1, (n_states, observation.n_memory)),
        reference=ReferenceParameters.from_vector(rng.uniform(0.5, 1.5, count_reference_parameters(robot)), robot),
        further=FurtherSignals(
            dddq=dddq,
            ddddq=ddddq,
            time=times,
            temperature=temperature,
            runs=rng.integers(0, 2, (n_states, len(observation.runs))).astype(np.float64),
        ),
    )
    dense = np.zeros((n_states, observation.n_rows, observation.n_columns))
    dense[:, observation.entry_rows, observation.entry_columns] = entries
    if observation.n_rows == n:
        # What only the equation of a joint without torque would show is no base parameter.
        dense[:, ~robot.has_torque] = 0.0
    return dense.reshape(n_states * observation.n_rows, observation.n_columns)


def _draw_times(observation: Observation, n_states: int, rng: np.random.Generator) -> FloatArray:
    """Return times (n_states,) of the session; half of them inside the windows that columns are limited to."""
    # A window of a few seconds in an hour would be hit by no random time, and its columns would seem to have no effect.
    times = rng.uniform(0, 3600, n_states)
    windows = [dict(column.shape) for column in observation.columns if {"t0", "t1"} <= dict(column.shape).keys()]
    for k, state in enumerate(range(0, n_states, 2) if windows else ()):
        window = windows[k % len(windows)]
        times[state] = rng.uniform(window["t0"], window["t1"])
    return times


def _order_terms(is_written: BoolArray, lead: int) -> list[int]:
    """Return the parameters of a grouping, the leading one first."""
    return [lead, *(int(k) for k in np.flatnonzero(is_written) if k != lead)]


def _format_grouping(names: list[str], weights: FloatArray) -> str:
    """Return a grouping as a formula."""
    text = names[0]
    for name, weight in zip(names[1:], weights[1:], strict=True):
        size = abs(float(weight))
        factor = "" if abs(size - 1) < 1e-6 else f"{size:.4g} "
        text += f" {'+' if weight > 0 else '-'} {factor}{name}"
    return text
