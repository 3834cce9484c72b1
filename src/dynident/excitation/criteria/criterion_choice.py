"""The criteria by name, as a request chooses them, with their options and checks; computes nothing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from dynident.effects.effect_choices import EffectChoice
from dynident.errors import DynidentError
from dynident.schema.fields import Choice, OneOf, Request, declare_field

NAMES = OneOf(
    Choice(
        "condition_number", "condition number", "Largest over smallest singular value of W [12.12]. The usual choice."
    ),
    Choice(
        "equilibrated",
        "equilibrated condition number",
        "Condition number plus the largest over the smallest entry [12.13].",
    ),
    Choice("condition_plus_inverse_sigma", "condition number and smallest singular value", "[12.14]"),
    Choice("weighted", "weighted", "[12.15]"),
    Choice("d_optimal", "D-optimal", "The volume of the ellipsoid of uncertainty."),
    Choice("a_optimal", "A-optimal", "The sum of the variances."),
    Choice("e_optimal", "E-optimal", "The largest variance."),
    Choice("parameters", "chosen parameters", "The variances of the named parameters."),
    Choice(
        "prediction",
        "predicted torque",
        "The variance of the predicted torque over all that the limits allow, or over a stated region.",
    ),
    Choice("separation", "separation", "Distinguishes effects from the rest of the model and from each other."),
)
# Smallest weight and a-priori value: one that is smaller is zero but for rounding.
_SMALLEST = 1e-12
REGION_SPEED = 0.5
"""Share of the limits of velocity and acceleration up to which torque is to be predicted, where nothing is stated."""
CRITERIA = NAMES.names
"""Names of the criteria."""


@dataclass(frozen=True)
class CriterionChoice(Request):
    """How exciting a motion is (§12.3.4.1).

    Parameters
    ----------
    name : str
        Name of the criterion, one of `CRITERIA`.
    weight : float
        Factor k1 of [12.13] or k2 of [12.14], the latter in the unit of the smallest singular value.
    a_priori : mapping of str to float
        Magnitudes |Z| of [12.15] by parameter name; those of the robot's description where left out.
    parameters : tuple of str
        Names of the parameters whose variances count, for the criterion "parameters".
    effects : tuple of EffectChoice
        Effects to be told from the rest of the model and from each other, for the criterion "separation".
    """

    name: str = declare_field(
        "Measure of the information in a motion (§12.3.4.1)",
        default="condition_number",
        kinds=NAMES,
        option="--criterion",
    )
    weight: float = declare_field(
        "k1 of [12.13], k2 of [12.14] (in the unit of the smallest singular value)",
        default=1.0,
        option="--weight",
        at_least=_SMALLEST,
        at_most=1e12,
    )
    a_priori: Mapping[str, float] = declare_field(
        "|Z| of [12.15] by parameter, to which variances are relative; by default the value of the robot's description",
        made_by=dict,
    )
    parameters: tuple[str, ...] = declare_field("For the criterion parameters: those whose variances count", default=())
    effects: tuple[EffectChoice, ...] = declare_field(
        "For separation: the effects to distinguish from the rest of the model and from each other",
        default=(),
        option="-",
    )

    @property
    def is_sample_dependent(self) -> bool:
        """Whether the value belongs to the samples that W is taken at, and to no others.

        The smallest entry of W [12.13] is where a sample happens to come nearest to a zero: between the samples there
        are zeros.
        """
        return self.name == "equilibrated"


def check_criterion(choice: CriterionChoice) -> None:
    """Raise `DynidentError` for an a-priori value that nothing can be relative to.

    Parameters
    ----------
    choice : CriterionChoice
        The criterion with its a-priori values.
    """
    for name, value in choice.a_priori.items():
        # Variances are divided by the square of these values, so that zero would make one parameter count infinitely.
        if abs(value) < _SMALLEST:
            raise DynidentError(
                f"the a-priori value of {name} is {value}; it must be a number other than zero",
                pointer="/criterion/a_priori",
            )


def check_criterion_targets(choice: CriterionChoice) -> None:
    """Raise `DynidentError` where a criterion needs names that are not stated."""
    if choice.name == "parameters" and not choice.parameters:
        raise DynidentError("name the parameters whose variances count", pointer="/criterion/parameters")
    if choice.name == "separation" and not choice.effects:
        raise DynidentError("name the effects to separate", pointer="/criterion/effects")
