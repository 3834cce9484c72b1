"""Fit the effects that a file format can hold to the data again, and compare the errors before and after.

Dropping terms from a fitted model is not the same as fitting a model without them. Where presliding or a nonlinear
viscous law is in the model, Coulomb and viscous friction have only part of the friction torque. A file with only that
part would predict worse than a model that was fitted without the other effects.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

from dynident.arrays import FloatArray
from dynident.effects import EffectChoice, Role, get_effect
from dynident.estimation import Errors, compute_moving_errors
from dynident.identification import Identification, reidentify

MOST_FREE_ERROR_RATIO = 1.05
"""Ratio of the relative errors with and without the constraint of feasible bodies, up to which the constraint costs
nothing that a user would notice: two models of one robot from two recordings differ by more."""
NOTABLE_ERROR_RATIO = 1.25
"""Ratio of the relative errors of a file and of its model, above which a warning recommends another format."""


def select_held_effects(identification: Identification, held: Collection[Role]) -> tuple[EffectChoice, ...]:
    """Return the chosen effects of a model that a format for parameters with the roles `held` can hold."""
    effects = identification.choices.effects
    return tuple(choice for choice in effects if not choice.runs and get_effect(choice.effect).fits_roles(held))


def project_model(identification: Identification, held: Collection[Role]) -> Identification:
    """Return a model with only the effects that a format can hold, fitted to the same data again.

    Where the format holds all effects, that is the model itself. Since the model is a least-squares fit, the new one is
    also the nearest to its torque along these data.

    Parameters
    ----------
    identification : Identification
    held : collection of Role
        Roles of the parameters that the format has words for.
    """
    held_effects, choices = select_held_effects(identification, held), identification.choices
    if not held_effects or held_effects == choices.effects:
        return identification
    estimator = choices.estimator if choices.solver.from_reduced else "wls"
    return reidentify(identification, replace(choices, effects=held_effects, strategy="global", estimator=estimator))


def predicts_as_well(identification: Identification, values: FloatArray) -> bool:
    """Return whether other base parameters (b,) predict held-out data as well; False if there are no such data."""
    if identification.data.held_out is None:
        return False
    before = compute_moving_errors(identification.data.held_out, identification.values).relative_total
    return compute_moving_errors(identification.data.held_out, values).relative_total <= MOST_FREE_ERROR_RATIO * before


@dataclass(frozen=True)
class ProjectionError:
    """Errors of a model and of an exported file where joints move, on the same data.

    `is_held_out`: on held-out data; otherwise on those of the fit.
    """

    joints: tuple[str, ...]
    model: Errors
    file: Errors
    is_held_out: bool

    @classmethod
    def compare_with(
        cls, identification: Identification, projected: Identification, values: FloatArray
    ) -> ProjectionError:
        """Return the comparison of a model with base parameters (b,) of its projection."""
        own_data, projected_data = identification.data.held_out, projected.data.held_out
        is_held_out = own_data is not None and projected_data is not None
        if own_data is None or projected_data is None:
            own_data, projected_data = identification.data.training, projected.data.training
        joints = identification.model.robot.joint_names
        return cls(
            joints,
            compute_moving_errors(own_data, identification.values),
            compute_moving_errors(projected_data, values),
            is_held_out,
        )

    @property
    def is_notable(self) -> bool:
        """Whether the file is so much worse than the model that a warning is needed."""
        return self.file.relative_total > NOTABLE_ERROR_RATIO * self.model.relative_total

    def describe(self) -> tuple[str, ...]:
        """Return sentences with the errors, in total and by joint."""
        data = "held-out data" if self.is_held_out else "the data of the fit (no held-out data were given)"
        total = f"{self.file.relative_total:.2%} ({self.model.relative_total:.2%})"
        subject = f"Relative error of torque where joints move, on {data}, of this file (and of the model)"
        each = ", ".join(
            f"{joint} {file:.2%} ({model:.2%})"
            for joint, file, model in zip(self.joints, self.file.relative, self.model.relative, strict=True)
        )
        errors = f"{subject}: {total}; {each}."
        if not self.is_notable:
            return (errors,)
        lost = f"This file is {self.file.relative_total / self.model.relative_total:.1f} times as wrong as the model"
        return (f"Warning: {lost}; C code, CasADi functions and JSON hold all of it.", errors)
