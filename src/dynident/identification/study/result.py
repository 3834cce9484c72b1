"""What an identification gives: parameters with their uncertainty, residuals, held-out errors, warnings."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from math import inf

import numpy as np

from dynident.arrays import FloatArray
from dynident.effects import EffectChoice, role_of
from dynident.effects.written import constant_in_words
from dynident.estimation import Errors, Solution, Statistics, effective_rows, moving_errors, noise_levels
from dynident.estimation.deviations import owed_to_known
from dynident.identification.choices import IdentificationChoices
from dynident.identification.parameters.judgement import ParameterJudgement, judged
from dynident.identification.parameters.standard import StandardParameters
from dynident.identification.shapes.shape_constants import ShapeConstant
from dynident.identification.study.in_memory import NONE_IN_MEMORY, RowsInMemory
from dynident.identification.study.reduced_data import ReducedData
from dynident.recordings import Preprocessing
from dynident.regressors.model import Model

_EXACT = 1e-12
"""Relative standard deviation that is none."""


@dataclass(frozen=True)
class IdentifiedParameter:
    """One base parameter; `relative_standard_deviation` is a fraction, `grouping` its standard parameters.

    `interval`: where the true value lies with a probability of 95 %; the deviation that it rests on counts correlated
    samples for what they are worth, in blocks of time. `essential` False: set to zero as not essential. `judgement`:
    whether the data determine it, leave it uncertain (or known from elsewhere rather), or do not tell it from zero;
    `times_smallest`: its relative standard deviation over the smallest one of all, which §12.7 wants below ten.
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
        constants = "".join(f", {constant_in_words(self.effect, name, value)}" for name, value in self.shape)
        unit = "" if self.unit == "-" else f" {self.unit}"
        return (
            f"IdentifiedParameter({self.name} = {self.value:.4g}{unit}, standard deviation "
            f"{self.standard_deviation:.2g}{unit}; {self.effect} on {self.link or 'the robot'}{constants}; "
            f"{self.judgement if self.essential else 'not essential'})"
        )

    @property
    def well_identified(self) -> bool:
        """Whether the data determine it."""
        return self.judgement == "determined"


@dataclass(frozen=True, eq=False)
class LadderStep:
    """How a model was made from the one below it on the ladder: what was added to that one, or taken out of it.

    `parent` is the model below; None for the first one, to which nothing was done.
    """

    parent: Identification | None = None
    added: tuple[EffectChoice, ...] = ()
    removed: tuple[EffectChoice, ...] = ()


FIRST = LadderStep()
"""Of a model that was identified from recordings."""


@dataclass(frozen=True, eq=False)
class Identification:
    """An identified model.

    `reference` (10 n,) are the standard inertial parameters that predicted loads were computed with; `data` what the
    recordings became, which further steps start from; `fit` and `held_out` the errors on all rows of the joints'
    torques in it, at rest the distance to what static friction may hold; `step` from the model below it on the ladder;
    `standard` the standard parameters where the estimator solved for these; `not_essential` numbers of the parameters
    that were set to zero as such; `shape_constants` those of the effects, with what the joints' torques say of them;
    `in_memory` no result but what makes an extension quicker.
    """

    model: Model
    choices: IdentificationChoices
    reference: FloatArray
    data: ReducedData
    solution: Solution
    statistics: Statistics
    fit: Errors
    held_out: Errors | None
    condition_number: float
    inertia_matrix_positive_definite: bool
    worst_inertia_eigenvalue: float
    warnings: tuple[str, ...]
    step: LadderStep = FIRST
    standard: StandardParameters | None = None
    not_essential: tuple[int, ...] = ()
    shape_constants: tuple[ShapeConstant, ...] = ()
    in_memory: RowsInMemory = NONE_IN_MEMORY

    def __repr__(self) -> str:
        held_out = "no held-out data" if self.held_out is None else f"held out {self.held_out.relative_total:.2%}"
        return (
            f"Identification({self.model.robot.name}: {self.model.n_parameters} base parameters, {self.choices.model} "
            f"model, {self.choices.solver.in_words}; error of the fit {self.fit.relative_total:.2%}, {held_out})"
        )

    @property
    def preprocessing(self) -> Preprocessing:
        """How the recordings were filtered."""
        return self.data.preprocessing

    @property
    def values(self) -> FloatArray:
        """Base parameters χ (b,)."""
        return self.solution.values

    @cached_property
    def fit_moving(self) -> Errors:
        """The errors of the fit where each joint moves."""
        return moving_errors(self.data.training, self.values)

    @cached_property
    def held_out_moving(self) -> Errors | None:
        """The errors on held-out data where each joint moves."""
        return None if self.data.held_out is None else moving_errors(self.data.held_out, self.values)

    @property
    def converged(self) -> bool:
        """Whether the rounds that the estimator takes have settled."""
        return self.solution.converged

    @property
    def n_equations(self) -> int:
        """Number of rows r of W, of the chosen model."""
        return self.data.equations.n_rows

    @property
    def equations_per_parameter(self) -> float:
        """r / b; §12.7 asks for 500."""
        return self.n_equations / max(self.model.n_parameters, 1)

    @property
    def effective_rows(self) -> FloatArray:
        """(n,): how many independent samples the torque rows of every joint are worth."""
        if self.data.fitted_to_torque:
            return self.statistics.effective_rows
        return effective_rows(self.data.training, self.values)

    @property
    def noise(self) -> FloatArray:
        """(n,): standard deviation of every joint's residual, N m or N."""
        if self.data.fitted_to_torque:
            return self.statistics.noise
        return noise_levels(self.data.training, self.values)

    @property
    def parameters(self) -> tuple[IdentifiedParameter, ...]:
        """The base parameters in the order of the model."""
        relative = self.statistics.relative_standard_deviations(self.values)
        owed = owed_to_known(self.data.equations, self.solution)
        smallest = max(float(np.min(relative, initial=inf)), _EXACT)
        deviations = self.statistics.standard_deviations
        half = self.statistics.half_widths()
        return tuple(
            IdentifiedParameter(
                name=column.name,
                value=float(self.values[k]),
                unit=column.unit,
                standard_deviation=float(deviations[k]),
                relative_standard_deviation=float(relative[k]),
                judgement=judged(float(self.values[k]), float(deviations[k]), float(half[k]), bool(owed[k])),
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

    def standard_inertia(self) -> FloatArray:
        """Standard inertial parameters (10 n,) that give the same torque; feasible ones where they were solved for."""
        if self.standard is not None and any(role_of(column) == "link" for column in self.model.columns):
            return self.standard.inertias(self.model).reshape(-1)
        return self.model.standard_inertia(self.values)

    def next_reference(self) -> FloatArray:
        """What later models' loads and motor torques are predicted with (14 n,), from these parameters."""
        return self.model.reference(self.values)

    def ladder(self) -> Iterator[Identification]:
        """The models that led here, the first one first."""
        if self.step.parent is not None:
            yield from self.step.parent.ladder()
        yield self
