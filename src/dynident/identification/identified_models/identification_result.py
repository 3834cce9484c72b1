"""Result types: `Estimate` (parameters, covariance), `Identification` (with data, errors, warnings), `LiveEstimate`.

An estimate is enough to predict torque without any data. Reduced data are the recordings as factors, all that later
steps need instead of the recordings.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from math import inf

import numpy as np
from numpy.typing import NDArray

from dynident.array_types import FloatArray
from dynident.effects import EffectChoice, ReferenceParameters, get_role
from dynident.effects.effect_text_format import format_constant
from dynident.errors import KnownNames
from dynident.estimation import (
    Errors,
    Solution,
    Statistics,
    compute_condition_number,
    compute_equilibrated_condition_number,
    compute_row_noise,
    count_effective_rows,
    describe_fit,
)
from dynident.estimation.least_squares import floor_noise
from dynident.estimation.parameter_covariance import find_prior_dominated
from dynident.identification.equations.reduced_recordings import ReducedData
from dynident.identification.identification_choices import IdentificationChoices
from dynident.identification.shape_constant_intervals import ShapeConstant
from dynident.identification.standard_parameters import StandardParameters
from dynident.identification.thresholds import ParameterJudgement, judge_parameter
from dynident.number_format import format_percent
from dynident.parallel import Deferring, defer, single_threaded
from dynident.recordings import Preprocessing
from dynident.regressors.errors_by_phase import compute_moving_errors, select_judged_errors
from dynident.regressors.model_structure import Model
from dynident.regressors.row_cache import CachedRows

_EXACT = 1e-12
"""Relative standard deviation that is none."""


@dataclass(frozen=True)
class IdentifiedParameter(KnownNames):
    """One base parameter with its uncertainty.

    Parameters
    ----------
    name : str
        Name of the parameter.
    value : float
        Its estimate in `unit`.
    unit : str
        Its unit, "-" where it has none.
    standard_deviation : float
        Standard deviation in `unit`. It counts correlated samples for what they are worth, in blocks of time.
    relative_standard_deviation : float
        The standard deviation over the value, a fraction.
    judgement : str
        "determined" by the data, "uncertain" (also where it is known from elsewhere rather than from the data),
        "zero_in_interval", or "held" at a known value, with a standard deviation of 0.
    times_smallest : float
        Its relative standard deviation over the smallest one of all, which §12.7 wants below ten.
    effect : str
        The effect that it belongs to.
    link : str
        The joint whose link or drive it belongs to; "" for the whole robot.
    grouping : str
        The standard parameters that it is a sum of.
    shape : tuple of (name, value)
        Shape constants of the effect.
    interval : tuple of float
        Ends in `unit` of the interval that holds the true value with a probability of 95 %.
    essential : bool
        Whether it is essential; False where it was set to zero as not essential.
    """

    name: str
    value: float
    unit: str
    standard_deviation: float
    relative_standard_deviation: float
    judgement: ParameterJudgement
    times_smallest: float
    effect: str
    link: str
    grouping: str
    shape: tuple[tuple[str, float], ...] = ()
    interval: tuple[float, float] = (-inf, inf)
    essential: bool = True

    def __repr__(self) -> str:
        constants = "".join(f", {format_constant(self.effect, name, value)}" for name, value in self.shape)
        unit = "" if self.unit == "-" else f" {self.unit}"
        return (
            f"IdentifiedParameter({self.name} = {self.value:.4g}{unit}, standard deviation "
            f"{self.standard_deviation:.2g}{unit}; {self.effect} on {self.link or 'the robot'}{constants}; "
            f"{self.judgement if self.essential else 'not essential'})"
        )

    @property
    def well_identified(self) -> bool:
        """Whether the data determine the parameter."""
        return self.judgement == "determined"


@dataclass(frozen=True, eq=False)
class Estimate(Deferring):
    """Estimates of a model's base parameters, and how sure they are.

    Parameters
    ----------
    model : Model
        The robot with the effects that were identified.
    reference : ReferenceParameters
        The parameters that the torque in the model's columns is predicted with.
    solution : Solution
        The estimates (b,), with the factor of W that they come from.
    statistics : Statistics
        Covariance of the estimates.
    noise : (n,)
        Standard deviation of every joint's residual, in N m or N.
    owed_to_known : (b,)
        Which parameters are known for what was known beside the data rather than for the data.
    standard : StandardParameters or None
        The standard parameters, where the estimator solved for these.
    not_essential : tuple of int
        Numbers of the parameters that were set to zero as not essential.
    shape_constants : tuple of ShapeConstant
        Shape constants of the effects, with what the joints' torques say of them.
    speeds : (n,), optional
        Largest recorded speeds, in rad/s or m/s, beyond which friction does not fall in programs.
    """

    model: Model
    reference: ReferenceParameters
    solution: Solution
    statistics: Statistics
    noise: FloatArray
    owed_to_known: NDArray[np.bool_]
    standard: StandardParameters | None = None
    not_essential: tuple[int, ...] = ()
    shape_constants: tuple[ShapeConstant, ...] = field(default_factory=tuple)
    speeds: FloatArray | None = None

    @classmethod
    def from_solution(
        cls,
        model: Model,
        data: ReducedData,
        reference: ReferenceParameters,
        solution: Solution,
        statistics: Statistics,
        *,
        standard: StandardParameters | None = None,
        not_essential: tuple[int, ...] = (),
        shape_constants: tuple[ShapeConstant, ...] = (),
    ) -> Estimate:
        """Return the estimate of a solution, with the noise of every joint and what is owed to prior knowledge.

        Parameters
        ----------
        model : Model
            The robot with the effects that were identified.
        data : ReducedData
            The data that the solution comes from.
        reference : ReferenceParameters
            What the torque in the model's columns was predicted with.
        solution : Solution
            Parameters (b,).
        statistics : Statistics
            Covariance of the parameters.
        standard : StandardParameters, optional
            The standard parameters, where the estimator solved for these.
        not_essential : tuple of int
            Numbers of parameters that were set to zero.
        shape_constants : tuple of ShapeConstant
            Shape constants with their uncertainty.

        Returns
        -------
        Estimate
            The estimate, with the noise of every joint.
        """
        # A joint without rows has no residual, and what is divided by its noise must stay a number.
        noise = floor_noise(compute_row_noise(data.training, solution.values))
        owed = find_prior_dominated(data.equations, solution)
        return cls(
            model, reference, solution, statistics, noise, owed, standard, not_essential, shape_constants, data.speeds
        )

    def __repr__(self) -> str:
        return f"Estimate({self.model.robot.name}: {self.model.n_parameters} base parameters)"

    @property
    def values(self) -> FloatArray:
        """Base parameters χ (b,)."""
        return self.solution.values

    @property
    def parameters(self) -> tuple[IdentifiedParameter, ...]:
        """The base parameters in the order of the model."""
        held = self.solution.is_held
        relative = np.where(held, 0.0, self.statistics.relative_standard_deviations(self.values))
        # A parameter that a prior fixes exactly has no deviation; dividing by it would make all others infinite.
        smallest = max(float(np.min(relative[~held], initial=inf)), _EXACT)
        deviations = self.statistics.standard_deviations
        # Half-widths by Student's t: few independent samples give wider intervals than a normal distribution.
        half = self.statistics.half_widths()
        return tuple(
            IdentifiedParameter(
                name=column.name,
                value=float(self.values[k]),
                unit=column.unit,
                standard_deviation=float(deviations[k]),
                relative_standard_deviation=float(relative[k]),
                judgement="held"
                if held[k]
                else judge_parameter(
                    float(self.values[k]), float(deviations[k]), float(half[k]), bool(self.owed_to_known[k])
                ),
                times_smallest=float(relative[k] / smallest),
                effect=column.effect,
                link=column.link,
                grouping=self.model.base.groupings[k],
                shape=column.shape,
                interval=(float(self.values[k] - half[k]), float(self.values[k] + half[k])),
                essential=k not in self.not_essential,
            )
            for k, column in enumerate(self.model.kept)
        )

    def with_robust_noise(self) -> Estimate:
        """Return the estimate with the noise of its own statistics, where rows without weight do not count."""
        return self.with_changes(noise=floor_noise(self.statistics.noise))

    def standard_inertia(self) -> FloatArray:
        """Return standard inertial parameters (10 n,) that give the same torque.

        They are the feasible ones where the estimator solved for these.
        """
        # Feasible parameters are one of many solutions with the same torque; without them the model chooses one.
        if self.standard is not None and any(get_role(column) == "link" for column in self.model.columns):
            return self.standard.to_inertias(self.model).reshape(-1)
        return self.model.compute_standard_inertia(self.values)

    def next_reference(self) -> ReferenceParameters:
        """Return the parameters that later models' loads and motor torques are predicted with."""
        return self.model.build_reference(self.values)


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
class LadderStep(Deferring):
    """How a model was made from the one below it on the ladder.

    Parameters
    ----------
    parent : Identification or None
        The model below, which may be deferred; None for the first one, to which nothing was done.
    added : tuple of EffectChoice
        Effects that were added to the model below.
    removed : tuple of EffectChoice
        Effects that were taken out of it.
    """

    parent: Identification | None
    added: tuple[EffectChoice, ...] = ()
    removed: tuple[EffectChoice, ...] = ()


FIRST = LadderStep(None)
"""Of a model that was identified from recordings."""


@dataclass(frozen=True, eq=False)
class Identification(Deferring):
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
        judged = self.held_out_judged
        held_out = "no held-out data" if judged is None else f"held out {format_percent(judged.relative_total)}"
        return (
            f"Identification({self.model.robot.name}: {self.model.n_parameters} base parameters, {self.choices.model} "
            f"model, {self.choices.solver.name_with_options}; error of the fit "
            f"{format_percent(self.fit_judged.relative_total)}, {held_out})"
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
    def fit_judged(self) -> Errors:
        """The errors of the fit that models are judged and compared by: where each joint moves.

        Where no joint moves at all, those of all rows.
        """
        return select_judged_errors(self.fit_moving, self.fit)

    @property
    def held_out_judged(self) -> Errors | None:
        """The held-out errors that models are judged and compared by: where each joint moves.

        Where no joint moves in the held-out data, those of all rows.
        """
        if self.held_out is None or self.held_out_moving is None:
            return self.held_out
        return select_judged_errors(self.held_out_moving, self.held_out)

    @property
    def converged(self) -> bool:
        """Whether the iterations of the estimator have settled."""
        return self.estimate.solution.converged

    @cached_property
    def condition_number(self) -> float:
        """Condition number of W of the chosen model, [12.12]; parameters of other units change it."""
        return single_threaded(compute_condition_number)(self.data.equations)

    @cached_property
    def equilibrated_condition_number(self) -> float:
        """Condition number of W with rows over their noise and columns of unit norm: units do not change it."""
        noise = self.estimate.solution.noise
        return single_threaded(compute_equilibrated_condition_number)(self.data.equations, noise)

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
        solution = self.estimate.solution
        fit = describe_fit(self.data.training, self.values, solution.known, solution.free)
        return count_effective_rows(self.data.training, fit)

    @property
    def inertia_matrix_positive_definite(self) -> bool:
        """Whether the inertia matrix is positive definite in every posture that was looked at."""
        return self.worst_inertia_eigenvalue > 0

    def with_warnings(self, more: tuple[str, ...]) -> Identification:
        """Return the model with more warnings before its own."""
        return self.with_changes(warnings=defer(lambda: more + self.warnings)) if more else self

    def ladder(self) -> Iterator[Identification]:
        """Yield the models that led to this one, the first one first."""
        if self.step.parent is not None:
            yield from self.step.parent.ladder()
        yield self


@dataclass(frozen=True, eq=False)
class LiveEstimate:
    """What a recording under way tells so far.

    Parameters
    ----------
    seconds : float
        Length of the recording so far, s.
    n_samples : int
        Number of its samples.
    n_rows : int
        Number of filtered rows that the estimate rests on, over all joints.
    estimate : Estimate or None
        The parameters so far; None where the rows do not determine them yet.
    reason : str
        Why there are none; "" where there are some.
    fit : Errors or None
        What they leave of the torque of these rows, joint by joint.
    predicted : (n,) or None
        Relative error by joint at which the estimate before predicted the torque of the newest rows, which it was not
        fitted to; None before there are any.
    identification : Identification or None
        The model of the whole recording, as `identify` gives it; None while the recording is under way.
    """

    seconds: float
    n_samples: int
    n_rows: int
    estimate: Estimate | None
    reason: str = ""
    fit: Errors | None = None
    predicted: FloatArray | None = None
    identification: Identification | None = None
