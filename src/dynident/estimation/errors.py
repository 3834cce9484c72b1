"""How well parameters explain a data set: the one definition of which rows count, and what counts at rest.

Every row of every joint's equation is of one kind. Where the joint *moves*, its row is an equation, and its residual is
the error. At a *reversal* it is one as well, but friction jumps there, at an instant that is known only roughly.
*Beside a halt* it is one only for friction that shows where a joint starts. *At rest* static friction holds the joint,
and the row says that the torque lies in a band. Models are judged and compared where joints move.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.estimation.factors import Reduction


@dataclass(frozen=True, eq=False)
class Errors:
    """How well parameters explain a data set, equation by equation.

    Parameters
    ----------
    squares, measured : (n,)
        Sums of squares of the residual and of Y.
    counts : (n,)
        Numbers of rows.
    """

    squares: FloatArray
    measured: FloatArray
    counts: FloatArray

    def __repr__(self) -> str:
        return f"Errors({len(self.counts)} equations: relative error {self.relative_total:.2%})"

    @property
    def rms(self) -> FloatArray:
        """Root mean square of the residual (n,), N m or N."""
        return np.sqrt(self.squares / np.maximum(self.counts, 1))

    @property
    def relative(self) -> FloatArray:
        """Relative error ||y - ŷ|| / ||y|| (n,); 1 where nothing was measured and something predicted."""
        safe = np.where(self.measured > 0, self.measured, 1.0)
        return np.where(self.measured > 0, np.sqrt(self.squares / safe), np.where(self.squares > 0, 1.0, 0.0))

    @property
    def relative_total(self) -> float:
        """Relative error ||Y - Ŷ|| / ||Y|| over all equations."""
        total = float(self.measured.sum())
        return float(np.sqrt(self.squares.sum() / total)) if total > 0 else 0.0

    @property
    def rms_total(self) -> float:
        """Root mean square of the residual over all equations and samples."""
        return float(np.sqrt(self.squares.sum() / max(float(self.counts.sum()), 1.0)))

    def select(self, equations: BoolArray) -> Errors:
        """Return the errors of only these of the n equations (n,)."""
        return Errors(self.squares[equations], self.measured[equations], self.counts[equations])

    def __add__(self, other: Errors) -> Errors:
        """Return the errors on both sets of rows together."""
        return Errors(self.squares + other.squares, self.measured + other.measured, self.counts + other.counts)


@dataclass(frozen=True, eq=False)
class ErrorsByPhase:
    """Errors by what the joint of a row does.

    Parameters
    ----------
    moving : Errors
        Where each joint moves. An equation that does not keep its rows at rest counts all its rows as moving.
    reversing : Errors
        Where each joint reverses without sticking.
    starting : Errors
        Beside halts, of the motion alone: rows of joints whose model has friction that shows there.
    standing : Errors
        Where each joint stands or is so near to a halt that the filter mixes both: the distance of the torque to the
        band that the static friction of the model holds.
    """

    moving: Errors
    reversing: Errors
    starting: Errors
    standing: Errors

    @property
    def all_rows(self) -> Errors:
        """Errors on all rows, each once: rows beside a halt count as standing."""
        return self.moving + self.reversing + self.standing


def select_judged_errors(moving: Errors, all_rows: Errors) -> Errors:
    """Select the errors that a model is judged and compared by.

    Parameters
    ----------
    moving, all_rows : Errors
        Errors where each joint moves, and on all rows.

    Returns
    -------
    Errors
        Those where each joint moves; those on all rows where no joint ever moves, as in poses at rest.
    """
    return moving if moving.counts.any() else all_rows


def compute_errors_by_phase(reduction: Reduction, values: FloatArray) -> ErrorsByPhase:
    """Return the residual of parameters on the rows of a data set, by what the joint does.

    Parameters
    ----------
    reduction, values : Reduction, (c,)
        The equations as triangular factors, and parameters χ.

    Returns
    -------
    ErrorsByPhase
        Sums of squares and numbers of rows of every equation.
    """
    fitted = compute_fitted_errors(reduction, values)
    reversing, starting, standing = (np.zeros((3, len(reduction.equations))) for _ in range(3))
    for k, equation in enumerate(reduction.equations):
        rest_rows, own = equation.rest_rows, values[equation.columns]
        if rest_rows is None:
            continue
        for sums, rows in ((reversing, equation.rows_at_reversals), (starting, rest_rows.starting)):
            if rows is not None:
                sums[:, k] = rows.sum_squares(own), rows.measured_squares, rows.count
        standing[:, k] = rest_rows.sum_standing_squares(own), rest_rows.standing_measured_squares, rest_rows.n_standing
    # Differences of sums of squares may fall below zero by rounding.
    moving = np.maximum(np.array([fitted.squares, fitted.measured, fitted.counts]) - reversing - starting, 0.0)
    return ErrorsByPhase(Errors(*moving), Errors(*reversing), Errors(*starting), Errors(*standing))


def compute_errors(reduction: Reduction, values: FloatArray) -> Errors:
    """Return the residual of parameters on all rows of a data set, at rest the distance to the band.

    Parameters
    ----------
    reduction, values : Reduction, (c,)
        The equations as triangular factors, and parameters χ.

    Returns
    -------
    Errors
        Sums of squares and numbers of rows of every equation, as in `ErrorsByPhase.all_rows`.
    """
    return compute_errors_by_phase(reduction, values).all_rows


def compute_moving_errors(reduction: Reduction, values: FloatArray) -> Errors:
    """Return the residual of parameters on the rows of every equation where its joint moves.

    Parameters
    ----------
    reduction, values : Reduction, (c,)
        The equations as triangular factors, and parameters χ.

    Returns
    -------
    Errors
        Sums of squares and numbers of rows of every equation, as in `ErrorsByPhase.moving`.
    """
    return compute_errors_by_phase(reduction, values).moving


def compute_fitted_errors(reduction: Reduction, values: FloatArray) -> Errors:
    """Return the residual of parameters χ (c,) on all rows that take part in the fit, each counting alike."""
    squares, measured = compute_weighted_squares(reduction, values), []
    for k, equation in enumerate(reduction.equations):
        own = float(equation.joint_factor[:, -1] @ equation.joint_factor[:, -1])
        if equation.reversal_rows is not None:
            # The factor holds rows at reversals with their weight; add what is missing to a weight of one.
            lacks = 1.0 - equation.reversal_rows.weight
            squares[k] += lacks * equation.reversal_rows.sum_squares(values[equation.columns])
            own += lacks * equation.reversal_rows.measured_squares
        measured.append(own)
    return Errors(squares, np.array(measured), reduction.row_counts)


def compute_weighted_squares(reduction: Reduction, values: FloatArray) -> FloatArray:
    """Return the squared residual (n,) of parameters χ (c,) in every equation, its rows as they are weighted there."""
    rests = (e.joint_factor[:, -1] - e.joint_factor[:, :-1] @ values[e.columns] for e in reduction.equations)
    return np.array([float(rest @ rest) for rest in rests])


def compute_t(gains: FloatArray) -> float:
    """Return t of the gains (s,) in blocks of time; 0 where all gain the same, or there is one alone.

    Parameters
    ----------
    gains : (s,)
        Drop of the squared error in every block.

    Returns
    -------
    float
        The mean gain over its standard error.
    """
    # Blocks, not samples: residuals are correlated within a block.
    spread = float(gains.std(ddof=1)) if len(gains) > 1 else 0.0
    return float(gains.mean() / (spread / np.sqrt(len(gains)))) if spread > 0 else 0.0


def compute_evenness(gains: FloatArray) -> FloatArray:
    """Return t of the mean over blocks of time of the signed roots of gains.

    Of the roots, since a gain is a square: else one block that shows an effect well hides that the others do, too.

    Parameters
    ----------
    gains : (c, s)
        Drop of the squared error in every block, of c models or effects.

    Returns
    -------
    (c,) array
        0 where all blocks gain the same.
    """
    values = compute_signed_roots(gains)
    spread = values.std(axis=-1, ddof=1) / np.sqrt(values.shape[-1])
    return np.asarray(np.divide(values.mean(axis=-1), spread, out=np.zeros_like(spread), where=spread > 0))


def compute_signed_roots(gains: FloatArray) -> FloatArray:
    """Return the roots of the sizes of gains, of any shape, with their signs."""
    return np.asarray(np.sign(gains) * np.sqrt(np.abs(gains)))
