"""The request of an identification: effects, equation type, strategy, estimator, prior, covariance, preprocessing.

Holds which choices exclude each other, and what is chosen by default; also the request field of a known load.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from dynident.effects.effect_choices import DEFAULT_EFFECTS, EffectChoice
from dynident.errors import DynidentError
from dynident.identification.estimation_problem_options import DescriptionTrust, ModelName, RowOptions
from dynident.identification.methods.base_classes import (
    ESTIMATORS,
    MODELS,
    PRIORS,
    STRATEGIES,
    EquationType,
    Estimator,
    Prior,
    StepsName,
    Strategy,
)
from dynident.schema.fields import Choice, OneOf, Request, declare_field
from dynident.schema.registry import get_kind_name

if TYPE_CHECKING:
    from dynident.estimation import CovarianceName
    from dynident.recordings import Preprocessing
    from dynident.regressors.model_structure import Model


@dataclass(frozen=True)
class EssentialChoices(Request):
    """How far the backward elimination of parameters goes."""

    ratio: float = declare_field(
        "Stop when largest over smallest relative standard deviation is below this (§12.7)",
        default=10.0,
        above=1,
        at_most=1e6,
    )


StrategyName = str
EstimatorName = str
PriorName = str

COVARIANCES = OneOf(
    Choice("by_time_and_joints", "all joints, over blocks of time", "All joints together, over blocks of time."),
    Choice("by_joint", "each joint, over time", "Each joint over time; joints are independent of each other."),
    Choice("independent", "no rows", "Every row counts as an independent sample [12.6].", "nothing"),
)
STEPS = OneOf(
    Choice("link_by_link", "link by link", "From the last link to the first [12.22]."),
    Choice(
        "wrist_then_shoulder",
        "wrist, then shoulder",
        "First the last three joints, then the others (§12.7): for links of very different size.",
    ),
)
USUAL_SHARE = 0.2
_UNFIT = "Choices that do not fit"


def _get_default_tolerance() -> float:
    # Imported late: the declaration of the choices must not load the numerics.
    from dynident.regressors.base_parameters import DEFAULT_TOLERANCE

    return DEFAULT_TOLERANCE


@dataclass(frozen=True)
class IdentificationChoices(Request):
    """The model structure of an identification, and how its parameters are solved for.

    Parameters
    ----------
    effects : tuple of EffectChoice
        What acts on the joints, with their joints and shape constants.
    model : str
        Equation type that makes the rows of W; each is a class in
        `identification.methods.equation_strategy_and_prior_options`.
    strategy : str
        Which parameters are solved for at a time.
    estimator : str or Estimator
        How they are solved for: a name, or an estimator with options of its own.
    steps : str
        Steps of the sequential strategy, "link_by_link" or "wrist_then_shoulder".
    prior : str or None
        Prior from the robot's description; None where the data alone count.
    free_links : tuple of str
        Links, named by their joints, that the prior does not hold for, such as the last one where it carries an unknown
        payload.
    prior_error : float
        Share by which the description's inertias are usually off (`robot.pseudo_inertia`, and for the prior
        description_entropic `identification.description_prior`).
    known : mapping of str to float
        Parameters that are known, by their names in the model's table, in SI units: a base parameter has its value,
        which is that of the whole sum that the table writes out. It is held exactly, with a standard deviation of 0.
    known_errors : mapping of str to float
        Standard deviations of known values, which are then weighed against the data.
    pole : float or None
        The a of [12.29] in rad/s, for the filtered model; None where the data decide.
    interval : float or None
        The t_b - t_a of [12.43] in s, for the energy model; None where the data decide.
    preprocessing : Preprocessing or None
        Filters of the recordings; None where the data decide.
    tolerance : float
        Relative size below which a column counts as dependent on others.
    covariance : str
        Which residuals are taken to be correlated (`estimation.statistics`).
    weigh_turns : bool
        Whether rows at reversals count by a noise of their own (`estimation.row_weights`).

    Raises
    ------
    DynidentError
        For an unknown name, a value out of its range, or choices that do not fit each other.
    """

    effects: tuple[EffectChoice, ...] = declare_field("What acts on the joints", default=DEFAULT_EFFECTS, option="-")
    model: ModelName = declare_field("Rows of W", default="dynamic", kinds=MODELS)
    strategy: StrategyName = declare_field(
        "Order in which parameters are estimated", default="global", kinds=STRATEGIES
    )
    estimator: EstimatorName | Estimator = declare_field("Method that estimates χ", default="auto", kinds=ESTIMATORS)
    steps: StepsName = declare_field("Steps of the sequential strategy", default="link_by_link", kinds=STEPS)
    prior: PriorName | None = declare_field(
        "Use of the inertias in the robot's description, weighted by their uncertainty", default=None, kinds=PRIORS
    )
    free_links: tuple[str, ...] = declare_field(
        "Joints whose links the prior does not apply to, such as a link with a load",
        default=(),
        most=100,
        label="Links without prior",
    )
    prior_error: float = declare_field(
        "Usual relative error of the description's inertias",
        default=USUAL_SHARE,
        at_least=1e-6,
        at_most=10,
        label="Error of the description",
    )
    known: Mapping[str, float] = declare_field(
        "Parameters held at a known value, by their names in the model's table, in SI units: a motor's inertia from "
        "its data sheet as Ia3",
        made_by=dict,
        label="Known parameters",
    )
    known_errors: Mapping[str, float] = declare_field(
        "Standard deviations of known parameters, by name; without one a value is held exactly",
        made_by=dict,
        above=0,
        label="Errors of known parameters",
    )
    pole: float | None = declare_field(
        "a of the filtered model's F(s) = a²/(s + a)²; from the data if left out",
        default=None,
        unit="rad/s",
        at_least=1e-3,
        at_most=1e6,
        label="Pole of the filtered model",
    )
    interval: float | None = declare_field(
        "Interval of one equation of the energy model; from the data if left out",
        default=None,
        unit="s",
        at_least=1e-6,
        at_most=86_400,
        label="Interval of the energy model",
    )
    preprocessing: Preprocessing | None = declare_field("Filters; from the data if left out", default=None, option="-")
    tolerance: float = declare_field(
        "Which columns count as dependent", made_by=_get_default_tolerance, option="-", at_least=1e-15, at_most=0.1
    )
    covariance: CovarianceName = declare_field(
        "Which residuals count as correlated: those of all joints over blocks of time, those of each joint over time, "
        "or none",
        default="by_time_and_joints",
        kinds=COVARIANCES,
    )

    weigh_turns: bool = declare_field(
        "For joint torques by weighted or feasible least squares: rows at reversals have their own weight",
        default=True,
        label="Weigh reversals apart",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.estimator, str):
            # An estimator without options of its own is kept by its name alone, so that equal choices compare equal.
            object.__setattr__(self, "estimator", self.estimator.request_value)
        if self.prior is not None:
            self._check_prior()
        elif self.free_links:
            raise DynidentError(
                "free_links are links that the prior does not apply to, but there is no prior; choose the prior "
                "description, or leave free_links out",
                pointer="/free_links",
            )
        self._check_known()

    def __hash__(self) -> int:
        # Mappings have none of their own.
        return hash((self.effects, self.model, self.strategy, self.prior, frozenset(self.known.items())))

    @property
    def solver(self) -> Estimator:
        """The estimator, with its options."""
        return ESTIMATORS.get(self.estimator)

    @property
    def plan(self) -> Strategy:
        """The strategy."""
        return STRATEGIES.get(self.strategy)

    @property
    def rows(self) -> EquationType:
        """The equation type that makes rows of W."""
        return MODELS.get(self.model)

    @property
    def belief(self) -> Prior | None:
        """The prior."""
        return None if self.prior is None else PRIORS.get(self.prior)

    @property
    def row_options(self) -> RowOptions:
        """Options of the rows that are made of recordings."""
        return RowOptions(self.model, self.pole, self.interval, self.tolerance, self.solver.weighted)

    @property
    def trust(self) -> DescriptionTrust:
        """Trust in the inertias of the description."""
        belief = self.belief
        known = tuple((name, value, self.known_errors.get(name, 0.0)) for name, value in self.known.items())
        of_bodies = belief is not None and belief.of_bodies
        return DescriptionTrust(self.prior, self.free_links, self.prior_error, of_bodies, known)

    @property
    def is_least_squares_of_torque(self) -> bool:
        """Whether the parameters are least squares of the joints' torques.

        Only then their covariance can be linearised together with that of the shape constants.
        """
        return self.model == "dynamic" and self.plan.at_once and self.solver.from_reduced

    @property
    def weighs_turns(self) -> bool:
        """Whether rows of the joints' torques count by their noise where a joint turns round."""
        return self.weigh_turns and self.model == "dynamic" and self.solver.weighs_turns

    def keep_known(self, names: Collection[str]) -> IdentificationChoices:
        """Return the choices with what is known of parameters of these names alone."""
        known, errors = (
            {name: number for name, number in numbers.items() if name in names}
            for numbers in (self.known, self.known_errors)
        )
        return replace(self, known=known, known_errors=errors)

    def move_known(self, before: Model, after: Model) -> tuple[IdentificationChoices, tuple[str, ...]]:
        """Return the choices for another model, with what is known of sums that are the same in both, and warnings.

        Terms of a sum that the other model does not have at all count as zero in it, and change no sum.

        Parameters
        ----------
        before : Model
            The model that the known values are of.
        after : Model
            The model that the choices are for.
        """
        if not self.known:
            return self, ()
        old, new, there = _list_sums(before), _list_sums(after), {column.key for column in after.columns}
        key_of = {key[1]: key for key in old}
        counts = Counter(key[1] for key in new)
        lasting, warnings = set(), []
        for name in self.known:
            key = key_of.get(name)
            if key is None or key not in there:
                continue
            same = {term: weight for term, weight in old[key].items() if term in there}
            if counts[name] == 1 and new.get(key) == same:
                lasting.add(name)
            else:
                reason = "another parameter has its name here" if counts[name] > 1 else "its sum has other terms here"
                warnings.append(f"The known {name} is estimated in this model: {reason}.")
        return self.keep_known(lasting), tuple(warnings)

    def _check_prior(self) -> None:
        # The divergence is a barrier: only an estimator that keeps bodies possible can minimise it.
        if self.trust.of_bodies and not self.solver.possible_bodies:
            able = " or ".join(ESTIMATORS.names_with("possible_bodies"))
            raise DynidentError(
                f"the entropic prior needs physically feasible bodies, so it works only with the estimator {able}, "
                f"not {get_kind_name(self.estimator)}; choose that estimator, or the prior description",
                pointer="/prior",
                title=_UNFIT,
            )

    def _check_known(self) -> None:
        for name in self.known_errors:
            if name not in self.known:
                raise DynidentError(
                    f"known_errors has {name!r}, but known has no value of it; give both",
                    pointer="/known_errors",
                    title=_UNFIT,
                )
        # The divergence is one of whole bodies: it has no place for single parameters.
        if self.known and self.trust.of_bodies:
            raise DynidentError(
                "known parameters do not go with the entropic prior, which is about whole bodies; choose the prior "
                "description, or none",
                pointer="/known",
                title=_UNFIT,
            )


def _list_sums(model: Model) -> dict[tuple[object, ...], dict[tuple[object, ...], float]]:
    """Return the terms of each base parameter with their weights, by the keys of the columns."""
    base, keys = model.base, [column.key for column in model.columns]
    return {
        column.key: {keys[k]: round(float(weights[k]), 6) for k in is_written.nonzero()[0]}
        for column, weights, is_written in zip(model.kept, base.grouping, base.written, strict=True)
    }


@dataclass(frozen=True)
class KnownLoad(Request):
    """A known load, from which drive gains are identified."""

    mass: float | None = declare_field(
        "Mass of the known load, if the recordings do not state it",
        default=None,
        unit="kg",
        at_least=1e-6,
        at_most=1e6,
    )
    centre: tuple[float, float, float] | None = declare_field(
        "Centre of the known load in the last joint's frame, if known",
        default=None,
        unit="m",
        at_least=-100,
        at_most=100,
    )

    def override_payload(self, own: Mapping[str, object] | None) -> Mapping[str, object] | None:
        """Return the payload of a recording's metadata with the values of this load in place of its own.

        Parameters
        ----------
        own : mapping, optional
            What the recording states.
        """
        stated = {"mass": self.mass, "centre": self.centre}
        present = {name: value for name, value in stated.items() if value is not None}
        return {**(own or {}), **present} if present else own
