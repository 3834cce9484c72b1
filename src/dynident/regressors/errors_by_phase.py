"""Errors of a model on recordings by phase: moving, reversing, standing; which errors judge a model.

Every row of every joint's equation is of one kind. Where the joint *moves*, its row is an equation, and its residual is
the error. At a *reversal* it is one as well, but dry friction changes its sign there. A model in which it jumps is
wrong by many times the noise: the instant is known only within some milliseconds, and real friction does not jump. A
few of these rows could outweigh all others where the motion is small, so they have a weight of their own in the fit.

*Beside a halt* a row holds both the halt and motion next to it. It is an equation of that motion, for friction that
shows where a joint starts. *At rest* static friction holds the joint. Its equation becomes two inequalities: the torque
lies in the band between what the model predicts for either direction of friction. Models are judged and compared where
joints move.

For the estimation these kinds are groups of rows (`estimation.row_groups`), whatever made them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from dynident.array_types import FloatArray
from dynident.estimation import Errors, Reduction
from dynident.estimation.residual_errors import compute_errors_by_group
from dynident.estimation.triangular_factors import RowGroupName

FittedPhase = Literal["moving", "reversing", "starting"]
"""What a joint does in a row that takes part in the fit."""

GROUPS: dict[FittedPhase, RowGroupName] = {"moving": "plain", "reversing": "weighted", "starting": "counted"}
"""The group of rows that the estimation knows each of them by; `dynamic_model_rows` makes the groups in this order."""


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


def compute_errors_by_phase(reduction: Reduction, values: FloatArray) -> ErrorsByPhase:
    """Compute the residual of parameters on the rows of a data set, by what the joint does.

    Parameters
    ----------
    reduction : Reduction
        The equations as triangular factors.
    values : (c,)
        Parameters χ.

    Returns
    -------
    ErrorsByPhase
        Sums of squares and numbers of rows of every equation.
    """
    errors = compute_errors_by_group(reduction, values)
    return ErrorsByPhase(errors.plain, errors.weighted, errors.counted, errors.interval)


def compute_moving_errors(reduction: Reduction, values: FloatArray) -> Errors:
    """Compute the residual of parameters on the rows of every equation where its joint moves.

    Parameters
    ----------
    reduction : Reduction
        The equations as triangular factors.
    values : (c,)
        Parameters χ.

    Returns
    -------
    Errors
        Sums of squares and numbers of rows of every equation, as in `ErrorsByPhase.moving`.
    """
    return compute_errors_by_phase(reduction, values).moving


def compute_phase_squares(reduction: Reduction, values: FloatArray, phase: FittedPhase) -> FloatArray:
    """Compute the sum of squared residuals in every block of time, on rows of one phase.

    Rows at reversals and beside halts that are not known by blocks of time count as moving.

    Parameters
    ----------
    reduction : Reduction
        The equations as triangular factors, by s blocks of time.
    values : (c,)
        Parameters χ.
    phase : {"moving", "reversing", "starting"}
        What the joint does.

    Returns
    -------
    (n, s) array
        Sums of squares, (N m)² or N².
    """
    return np.array([equation.sum_group_squares(GROUPS[phase], values) for equation in reduction.equations])


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
