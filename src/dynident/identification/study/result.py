"""The result of an identification: an estimate, its errors, and the data that further steps start from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

from dynident.array_types import FloatArray
from dynident.blas_threads import single_threaded
from dynident.effects import EffectChoice
from dynident.estimation import (
    Errors,
    Statistics,
    compute_condition_number,
    compute_moving_errors,
    count_effective_rows,
)
from dynident.identification.choices import IdentificationChoices
from dynident.identification.shapes.shape_constants import ShapeConstant
from dynident.identification.study.estimate import Estimate, IdentifiedParameter
from dynident.identification.study.reduced_data import ReducedData
from dynident.recordings import Preprocessing
from dynident.regressors.model import Model
from dynident.regressors.row_cache import CachedRows


@dataclass(frozen=True, eq=False)
class RowsInMemory:
    """Filtered rows of W that are still in memory: a model that extends theirs evaluates its new columns alone.

    There are none of data that are too long to be kept, of a model out of a file, and of one that effects were taken
    out of. All that is computed without them is the same, one pass over the samples later.

    Parameters
    ----------
    training : CachedRows or None
        Rows of the data of the fit.
    held_out : CachedRows or None
        Rows of the held-out data.
    """

    training: CachedRows | None = None
    held_out: CachedRows | None = None

    def __repr__(self) -> str:
        return f"RowsInMemory({self.training}, held out {self.held_out})"


NONE_IN_MEMORY = RowsInMemory()


@dataclass(frozen=True, eq=False)
class LadderStep:
    """How a model was made from the one below it on the ladder.

    Parameters
    ----------
    parent : Identification or None
        The model below; None for the first one, to which nothing was done.
    added : tuple of EffectChoice
        Effects that were added to the model below.
    removed : tuple of EffectChoice
        Effects that were taken out of it.
    """

    parent: Identification | None = None
    added: tuple[EffectChoice, ...] = ()
    removed: tuple[EffectChoice, ...] = ()


FIRST = LadderStep()
"""Of a model that was identified from recordings."""


@dataclass(frozen=True, eq=False)
class Identification:
    """An identified model: what was estimated, from what, and how well it fits.

    Parameters
    ----------
    estimate : Estimate
        The model with its parameters, enough to predict torque.
    choices : IdentificationChoices
        What was identified, and how.
    data : ReducedData
        What the recordings became, which further steps start from.
    fit : Errors
        Errors on all rows of the joints' torques in the data of the fit; at rest the distance to what static friction
        may hold.
    held_out : Errors or None
        The same on held-out data; None where there is none.
    worst_inertia_eigenvalue : float
        Smallest eigenvalue of the inertia matrix scaled to a unit diagonal, over many postures.
    warnings : tuple of str
        What is doubtful about the result, most important first.
    step : LadderStep
        The step from the model below it on the ladder.
    in_memory : RowsInMemory
        No result, but what makes an extension quicker.
    """

    estimate: Estimate
    choices: IdentificationChoices
    data: ReducedData
    fit: Errors
    held_out: Errors | None
    worst_inertia_eigenvalue: float
    warnings: tuple[str, ...]
    step: LadderStep = FIRST
    in_memory: RowsInMemory = NONE_IN_MEMORY

    def __repr__(self) -> str:
        held_out = "no held-out data" if self.held_out is None else f"held out {self.held_out.relative_total:.2%}"
        return (
            f"Identification({self.model.robot.name}: {self.model.n_parameters} base parameters, {self.choices.model} "
            f"model, {self.choices.solver.name_with_options}; error of the fit {self.fit.relative_total:.2%}, "
            f"{held_out})"
        )

    @property
    def model(self) -> Model:
        """The robot with the effects that were identified, and its base parameters' columns."""
        return self.estimate.model

    @property
    def values(self) -> FloatArray:
        """Base parameters χ (b,)."""
        return self.estimate.values

    @property
    def statistics(self) -> Statistics:
        """Uncertainty of the parameters: covariance, standard deviations, intervals."""
        return self.estimate.statistics

    @property
    def parameters(self) -> tuple[IdentifiedParameter, ...]:
        """The base parameters in the order of the model."""
        return self.estimate.parameters

    @property
    def shape_constants(self) -> tuple[ShapeConstant, ...]:
        """The constants inside the effects' columns, and what the joints' torques say of them."""
        return self.estimate.shape_constants

    @property
    def noise(self) -> FloatArray:
        """Standard deviation of every joint's residual (n,), N m or N."""
        return self.estimate.noise

    @property
    def preprocessing(self) -> Preprocessing:
        """Filters that the recordings went through."""
        return self.data.preprocessing

    @cached_property
    def fit_moving(self) -> Errors:
        """The errors of the fit where each joint moves."""
        return compute_moving_errors(self.data.training, self.values)

    @cached_property
    def held_out_moving(self) -> Errors | None:
        """The errors on held-out data where each joint moves."""
        return None if self.data.held_out is None else compute_moving_errors(self.data.held_out, self.values)

    @property
    def converged(self) -> bool:
        """Whether the iterations of the estimator have settled."""
        return self.estimate.solution.converged

    @cached_property
    def condition_number(self) -> float:
        """Condition number of W of the chosen model."""
        return single_threaded(compute_condition_number)(self.data.equations)

    @property
    def n_equations(self) -> int:
        """Number of rows r of W of the chosen model."""
        return self.data.equations.n_rows

    @property
    def equations_per_parameter(self) -> float:
        """Rows per parameter, r / b; §12.7 asks for 500."""
        return self.n_equations / max(self.model.n_parameters, 1)

    @property
    def effective_rows(self) -> FloatArray:
        """Number of independent samples that the torque rows of every joint are worth (n,)."""
        if self.data.is_fitted_to_torque:
            return self.statistics.effective_rows
        return count_effective_rows(self.data.training, self.values)

    @property
    def inertia_matrix_positive_definite(self) -> bool:
        """Whether the inertia matrix is positive definite in every posture that was looked at."""
        return self.worst_inertia_eigenvalue > 0

    def ladder(self) -> Iterator[Identification]:
        """Yield the models that led to this one, the first one first."""
        if self.step.parent is not None:
            yield from self.step.parent.ladder()
        yield self
