"""The best model that a file format can hold: its own effects, fitted to the data again; and what that costs.

Leaving terms out of a model is not the same as doing without them. Where presliding or a curved viscous law is in the
model, Coulomb and viscous friction have only their share of the torque; a file that kept just this share would predict
worse than the model that one began with.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

from dynident.arrays import FloatArray
from dynident.effects import EffectChoice, Role, effect_by_id
from dynident.estimation import Errors, moving_errors
from dynident.identification import Identification, reidentify

FREE = 1.05
"""Relative error with bodies that can exist, over that without this limit, up to which the limit costs nothing that a
user would notice: two models of one robot from two recordings differ by more."""
NOTABLE = 1.25
"""Relative error of a file, over that of the model in it, from which on another format is to be looked at."""


def choices_held(identification: Identification, held: Collection[Role]) -> tuple[EffectChoice, ...]:
    """Give the effects of a model that a format can hold, which has words for parameters with the roles `held`."""
    effects = identification.choices.effects
    return tuple(choice for choice in effects if not choice.runs and effect_by_id(choice.effect).held_in(held))


def project(identification: Identification, held: Collection[Role]) -> Identification:
    """Fit what a format can hold of a model to the model's data again; the model itself where that is all of it.

    Since the model is a least-squares fit, this is also the nearest to its torque along these data.

    Parameters
    ----------
    identification : Identification
    held : collection of Role
        Roles of the parameters that the format has words for.
    """
    held_effects, choices = choices_held(identification, held), identification.choices
    if not held_effects or held_effects == choices.effects:
        return identification
    estimator = choices.estimator if choices.solver.from_reduced else "wls"
    return reidentify(identification, replace(choices, effects=held_effects, strategy="global", estimator=estimator))


def is_free(identification: Identification, values: FloatArray) -> bool:
    """Tell whether other base parameters (b,) predict held-out data as well; False where there are no such data."""
    if identification.data.held_out is None:
        return False
    before = moving_errors(identification.data.held_out, identification.values).relative_total
    return moving_errors(identification.data.held_out, values).relative_total <= FREE * before


@dataclass(frozen=True)
class Cost:
    """The errors where joints move of a model and of a file with what a format can hold of it, on the same data.

    `is_held_out`: on data that no parameter saw; else on those of the fit.
    """

    joints: tuple[str, ...]
    model: Errors
    file: Errors
    is_held_out: bool

    @classmethod
    def of(cls, identification: Identification, projected: Identification, values: FloatArray) -> Cost:
        """Compare a model with base parameters (b,) of its projection."""
        own_data, projected_data = identification.data.held_out, projected.data.held_out
        is_held_out = own_data is not None and projected_data is not None
        if own_data is None or projected_data is None:
            own_data, projected_data = identification.data.training, projected.data.training
        joints = identification.model.robot.joint_names
        return cls(
            joints, moving_errors(own_data, identification.values), moving_errors(projected_data, values), is_held_out
        )

    @property
    def is_notable(self) -> bool:
        """Whether the file is so much worse than the model that its reader has to know."""
        return self.file.relative_total > NOTABLE * self.model.relative_total

    def notes(self) -> tuple[str, ...]:
        """Say it in sentences, the joints apart."""
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
