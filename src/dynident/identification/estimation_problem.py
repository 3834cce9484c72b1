"""What an estimator gets (`Problem`: reduced data, priors, weights) and what it returns (`Fit`, `ShapeUncertainty`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from dynident.array_types import FloatArray
from dynident.estimation import (
    CovarianceName,
    LinearisedSolution,
    PriorInformation,
    Reduction,
    Solution,
    Statistics,
    compute_noise_levels,
    estimate_group_weights,
)
from dynident.identification.description_prior import build_prior
from dynident.identification.equations.reduced_recordings import Data
from dynident.identification.estimation_problem_options import DescriptionTrust
from dynident.identification.shape_constant_intervals import linearise_shapes
from dynident.identification.standard_parameters import StandardParameters
from dynident.parallel import Deferring, defer
from dynident.regressors.model_structure import Model


@dataclass(frozen=True, eq=False)
class Fit(Deferring):
    """The result of an estimator or a strategy.

    Parameters
    ----------
    solution : Solution
        Estimated base parameters.
    statistics : Statistics
        Their covariance; mostly deferred, since it takes as long as the estimates.
    warnings : tuple of str
        How they came about, as far as the user has to know.
    standard : StandardParameters or None
        The standard parameters, where the estimator solves for these.
    """

    solution: Solution
    statistics: Statistics
    warnings: tuple[str, ...] = ()
    standard: StandardParameters | None = None


class ProblemChoices(Protocol):
    """What a problem needs of `choices.IdentificationChoices`, which names what solves problems."""

    @property
    def trust(self) -> DescriptionTrust:
        """Trust in the inertias of the description."""
        ...

    @property
    def covariance(self) -> CovarianceName:
        """Which residuals are taken to be correlated."""
        ...

    @property
    def weighs_turns(self) -> bool:
        """Whether rows of the joints' torques count by their noise where a joint turns round."""
        ...


@dataclass(frozen=True, eq=False)
class Problem:
    """Equations of data in the columns of a model, and prior knowledge of its parameters.

    Parameters
    ----------
    model : Model
        The model, with its base parameters' columns.
    data : Data
        Recordings reduced to the model's columns.
    known : PriorInformation or None
        What is known of the parameters beside the data; None where that is nothing.
    covariance : str
        Which residuals are taken to be correlated.
    trust : DescriptionTrust
        It decides, for estimators that look for standard parameters, what data and `known` leave open.
    """

    model: Model
    data: Data
    known: PriorInformation | None
    covariance: CovarianceName
    trust: DescriptionTrust

    @classmethod
    def from_choices(cls, model: Model, choices: ProblemChoices, data: Data) -> Problem:
        """Return the problem of all parameters and all data, with the chosen prior and weights.

        Parameters
        ----------
        model : Model
            The model, with its base parameters' columns.
        choices : IdentificationChoices
            What is identified, and how.
        data : Data
            Recordings reduced to the model's columns.

        Returns
        -------
        Problem
            The problem, with rows at reversals weighted where the choices say so.

        Raises
        ------
        DynidentError
            Where the description has nothing that the prior could believe.
        """
        trust = choices.trust
        known = build_prior(model, trust)
        weights = (
            estimate_group_weights(data.torque, known) if choices.weighs_turns else np.ones(len(data.torque.equations))
        )
        return cls(model, data.weighing_turns(weights), known, choices.covariance, trust)


@dataclass(frozen=True, eq=False)
class ShapeUncertainty(Deferring):
    """What the joints' torques say of the shape constants of a fit; nothing is computed before it is asked for.

    Parameters
    ----------
    fitted : Fit
        What was solved from the equations of the data.
    reduction : Reduction or None
        Torques with the columns of the constants; None where nobody can look at these.
    linearisation : LinearisedSolution or None
        Torques linearised about the constants, whatever rows the parameters were solved from.
    """

    fitted: Fit
    reduction: Reduction | None
    linearisation: LinearisedSolution | None

    @classmethod
    def from_fit(
        cls, problem: Problem, fitted: Fit, reduce: Callable[[FloatArray], Reduction | None] | None
    ) -> ShapeUncertainty:
        """Return what is computed of a fit when it is asked for.

        Parameters
        ----------
        problem : Problem
            Equations of the data, and prior knowledge.
        fitted : Fit
            What was solved from them.
        reduce : callable or None
            Gives, for parameters (b,), the torques in the model's columns and, behind them, those of the constants;
            None where nobody can look at these.

        Returns
        -------
        ShapeUncertainty
            With both fields deferred.
        """

        def reduce_torque() -> Reduction | None:
            # These columns are derivatives of the torque, so they need the parameters of the fit.
            reduction = None if reduce is None else reduce(fitted.solution.values)
            return None if reduction is None else reduction.weight_groups(problem.data.reversal_weights)

        def linearise() -> LinearisedSolution | None:
            if shapes.reduction is None:
                return None
            data, solution = problem.data, fitted.solution
            # The noise of power or energy rows says nothing of a torque in N m, so it is estimated from the torque
            # rows.
            if data.equations is not data.torque:
                solution = replace(solution, noise=compute_noise_levels(data.torque, solution.values))
            return linearise_shapes(problem.model, solution, problem.covariance, shapes.reduction)

        shapes = cls(fitted, defer(reduce_torque), defer(linearise))
        return shapes

    @property
    def statistics(self) -> Statistics:
        """Those of the parameters, with the constants uncertain where there are any."""
        return self.fitted.statistics if self.linearisation is None else self.linearisation.parameter_statistics
