"""Requests of validations: kinds with their fields, and methods that are compared (equation type to prior).

A method is an equation type, a strategy, an estimator and a prior.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import Field, dataclass, fields, make_dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

from dynident.errors import DynidentError
from dynident.schema.fields import LARGEST_SEED, Choice, Request, declare_field, get_description, redescribe_field
from dynident.schema.registry import RegistryEntry

if TYPE_CHECKING:
    from dynident.identification import Identification
    from dynident.progress import Progress
    from dynident.recordings import Recording
    from dynident.validation import (
        BootstrapValidation,
        CollisionValidation,
        DriftValidation,
        FiltersBySimulation,
        InertiaMatrixValidation,
        MethodsValidation,
        PayloadValidation,
        SimulationValidation,
        TorqueValidation,
    )

    TrialResult: TypeAlias = (
        TorqueValidation
        | InertiaMatrixValidation
        | MethodsValidation
        | FiltersBySimulation
        | BootstrapValidation
        | DriftValidation
        | CollisionValidation
        | list[PayloadValidation]
        | list[SimulationValidation]
    )
from typing import get_args

from dynident.identification.estimation_problem_options import ModelName
from dynident.identification.identification_choices import (
    STEPS,
    EstimatorName,
    IdentificationChoices,
    PriorName,
    StrategyName,
)
from dynident.identification.methods.base_classes import ESTIMATORS, MODELS, PRIORS, STRATEGIES, Estimator, StepsName
from dynident.schema.registry import format_kind


@dataclass(frozen=True)
class Method(Request):
    """One way to identify: the rows, the strategy, the estimator, and what is known beforehand.

    Parameters
    ----------
    model : str
        Equation type of the rows of W: "dynamic", "filtered", "power", "energy" or "base_wrench".
    strategy : str
        The order in which parameters are estimated: "global", "sequential" or "separate_friction".
    estimator : str or Estimator
        How they are estimated, by its name or with options of its own.
    prior : str or None
        Prior from the robot's description; None where the data alone count.
    steps : str
        Steps of the sequential strategy, "link_by_link" or "wrist_then_shoulder"; without a meaning for others.
    """

    model: ModelName = declare_field(default="dynamic", kinds=MODELS)
    strategy: StrategyName = declare_field(default="global", kinds=STRATEGIES)
    estimator: EstimatorName | Estimator = declare_field(default="wls", kinds=ESTIMATORS)
    prior: PriorName | None = declare_field(default=None, kinds=PRIORS)
    steps: StepsName = declare_field("Steps of the sequential strategy", default="link_by_link", kinds=STEPS)

    @property
    def words(self) -> str:
        """Name of the method for people."""
        strategy = self.steps if self.strategy == "sequential" else self.strategy
        names = f"{self.model}, {strategy}, {format_kind(self.estimator)}".replace("_", " ")
        return names if self.prior is None else f"{names}, prior from the {PRIORS.get(self.prior).called}"

    def apply_to(self, choices: IdentificationChoices) -> IdentificationChoices:
        """Return these choices with this method."""
        return replace(
            choices,
            model=self.model,
            strategy=self.strategy,
            estimator=self.estimator,
            prior=self.prior,
            # Links without the prior have no meaning where there is none, and would be refused.
            free_links=() if self.prior is None else choices.free_links,
            steps=self.steps,
        )


def get_method(choices: IdentificationChoices) -> Method:
    """Return the method of an identification's choices.

    Parameters
    ----------
    choices : IdentificationChoices
        Options of an identification.

    Returns
    -------
    Method
        Its equation type, strategy, estimator and prior.
    """
    # Of other strategies the steps say nothing. One value for all of them makes equal methods compare equal.
    steps = choices.steps if choices.strategy == "sequential" else "link_by_link"
    return Method(choices.model, choices.strategy, choices.estimator, choices.prior, steps)


def available_methods(choices: IdentificationChoices) -> tuple[Method, ...]:
    """List each equation type with every strategy, and each estimator with and without a prior.

    Parameters
    ----------
    choices : IdentificationChoices
        Their own method comes first; estimators and priors go with their own equation type.

    Returns
    -------
    tuple of Method
        The methods, each once.
    """
    own = get_method(choices)
    methods = [own]
    methods += [
        Method(model, strategy, steps=steps)
        for model in MODELS.names
        for strategy in STRATEGIES.names
        # Both orders of the sequential strategy; the others count once.
        for steps in (get_args(StepsName) if strategy == "sequential" else get_args(StepsName)[:1])
    ]
    methods += [Method(choices.model, "global", estimator) for estimator in ESTIMATORS.names]
    methods += [
        Method(choices.model, "global", estimator.name, prior) for estimator in ESTIMATORS for prior in estimator.priors
    ]
    return tuple(dict.fromkeys(methods))


@dataclass(frozen=True)
class ValidationData:
    """What a validation works on.

    Parameters
    ----------
    model : Identification
        The identified model.
    recordings : sequence of Recording
        Recordings to validate on.
    others : sequence of Recording
        They depend on the kind: data of the fit, or runs without a load.
    progress : Progress
        Called with the fraction done and a message.
    """

    model: Identification
    recordings: Sequence[Recording]
    others: Sequence[Recording]
    progress: Progress


@dataclass(frozen=True)
class Trial(RegistryEntry):
    """A validation; its fields are those that it alone takes.

    `of_model_alone`: it needs no recording. `takes_recordings`: it can be told which ones.
    """

    of_model_alone: ClassVar[bool] = False
    takes_recordings: ClassVar[bool] = True

    def judge(self, tried: ValidationData) -> TrialResult:
        """Make the validation: the result of its kind, or a list of such for several recordings."""
        raise NotImplementedError


@dataclass(frozen=True)
class LimitedTrial(Trial):
    """A validation that passes where a relative error is not above a limit."""

    limit: float | None = declare_field(
        "Largest relative error that passes; 0.15 by default", default=None, at_least=1e-6, at_most=10
    )

    @property
    def largest_error(self) -> float:
        """The limit, or the default where none is given."""
        from dynident.validation import LARGEST_ERROR

        return self.limit or LARGEST_ERROR


@dataclass(frozen=True)
class Direct(LimitedTrial):
    """Errors on the identification's own data."""

    name = "direct"
    words = "The torque error on the data that the model was identified from."
    takes_recordings = False

    def judge(self, tried: ValidationData) -> TorqueValidation:
        """Make the validation."""
        from dynident.validation import validate_direct

        return validate_direct(tried.model, tried.recordings, self.largest_error, tried.progress)


@dataclass(frozen=True)
class Cross(LimitedTrial):
    """Errors on data that the model has not seen."""

    name = "cross"
    words = "The torque error on held-out data."

    def judge(self, tried: ValidationData) -> TorqueValidation:
        """Make the validation."""
        from dynident.validation import validate_cross

        return validate_cross(tried.model, tried.recordings, self.largest_error, tried.progress)


@dataclass(frozen=True)
class InertiaMatrix(Trial):
    """A search for the posture where the inertia matrix is least positive."""

    name = "inertia_matrix"
    label = "inertia matrix"
    words = "A search for the posture where the inertia matrix is least positive."
    of_model_alone = True
    takes_recordings = False

    seed: int = declare_field("Seed of what is drawn at random", default=0, at_least=0, at_most=LARGEST_SEED)

    def judge(self, tried: ValidationData) -> InertiaMatrixValidation:
        """Make the validation."""
        from dynident.validation import validate_inertia_matrix

        return validate_inertia_matrix(tried.model, seed=self.seed, progress=tried.progress)


@dataclass(frozen=True)
class Payload(Trial):
    """A known load found from runs with it."""

    name = "payload"
    label = "known load"
    words = "A recording with a known load: does the model find its mass?"

    mass: float | None = declare_field(
        "The known mass, if the recordings do not state it", default=None, unit="kg", at_least=1e-6, at_most=1e6
    )

    def judge(self, tried: ValidationData) -> list[PayloadValidation]:
        """Make the validation on each recording with the load; `others` are those without."""
        from dynident.validation import validate_payload

        validations = []
        for index, loaded in enumerate(tried.recordings):
            tried.progress(index / len(tried.recordings), "weighing the load")
            validations.append(validate_payload(tried.model, tried.others, loaded, self.mass))
        return validations


@dataclass(frozen=True)
class Methods(Trial):
    """All methods on the same data."""

    name = "methods"
    words = "All equation types, strategies and estimators on the same data: do they agree?"

    methods: tuple[Method, ...] | None = declare_field(
        "Methods to compare; all that are available if left out", default=None, fewest=1, most=100, option="-"
    )

    def judge(self, tried: ValidationData) -> MethodsValidation:
        """Make the validation: `others` are the data of the fit, `recordings` are held out."""
        from dynident.validation import validate_methods

        return validate_methods(tried.model, tried.others, tried.recordings, self.methods, tried.progress)


LONGEST_SIMULATED = 20.0
"""Seconds of a recording that are simulated at most."""


@dataclass(frozen=True)
class Simulation(LimitedTrial):
    """A simulated robot against the recorded one."""

    name = "simulation"
    words = "A simulated robot with these parameters makes the recorded motion: does it need the recorded torque?"

    longest: float | None = declare_field("Longest time to simulate", default=None, unit="s", at_least=0.1, at_most=300)

    def judge(self, tried: ValidationData) -> list[SimulationValidation]:
        """Make the validation on each recording."""
        from dynident.progress import scale_progress
        from dynident.validation import validate_simulation

        longest, n = self.longest or LONGEST_SIMULATED, len(tried.recordings)
        return [
            validate_simulation(
                tried.model, recording, self.largest_error, longest, scale_progress(tried.progress, k / n, (k + 1) / n)
            )
            for k, recording in enumerate(tried.recordings)
        ]


HORIZONS = (0.1, 0.5, 2.0)
"""Seconds: a few samples of a controller, a quick move, and a whole motion from point to point."""


@dataclass(frozen=True)
class DriftTrial(Trial):
    """A simulated robot without a controller, started again and again from measured states."""

    name = "drift"
    words = "A simulated robot starts from many measured states under the measured torque alone: how far does it drift?"

    horizons: tuple[float, ...] | None = declare_field(
        "Times of simulation after which the drift is given; 0.1, 0.5 and 2 s by default",
        default=None,
        unit="s",
        at_least=0.01,
        at_most=10.0,
        fewest=1,
        most=10,
    )

    def judge(self, tried: ValidationData) -> DriftValidation:
        """Make the validation over all recordings."""
        from dynident.validation import validate_drift

        return validate_drift(tried.model, tried.recordings, self.horizons or HORIZONS, tried.progress)


@dataclass(frozen=True)
class CollisionTrial(Trial):
    """Contact detection by a momentum observer: force, time, and rate of false alarms."""

    name = "collision"
    label = "collision detection"
    words = "Which force at the tool does a momentum observer detect, how fast, and with how many false alarms?"

    false_alarms_per_hour: float | None = declare_field(
        "False alarms an hour that the thresholds are made for; 1 by default", default=None, at_least=1e-3, at_most=3600
    )

    def judge(self, tried: ValidationData) -> CollisionValidation:
        """Make the validation over all recordings."""
        from dynident.validation.contact_detection import FALSE_ALARMS_AN_HOUR, validate_collision

        rate = self.false_alarms_per_hour or FALSE_ALARMS_AN_HOUR
        return validate_collision(tried.model, tried.recordings, rate, tried.progress)


@dataclass(frozen=True)
class Filters(Trial):
    """Cut-off frequencies chosen by simulating the identification."""

    name = "filters"
    words = "Recordings like these are simulated and identified with many filters: were the right filters chosen?"

    cutoffs: tuple[float, ...] | None = declare_field(
        "Position cut-offs to try", default=None, unit="Hz", at_least=1e-4, at_most=1e6, fewest=1, most=20
    )
    longest: float | None = declare_field("Longest time to simulate", default=None, unit="s", at_least=0.1, at_most=300)
    seed: int = declare_field("Seed of the simulated noise", default=0, at_least=0, at_most=LARGEST_SEED)

    def judge(self, tried: ValidationData) -> FiltersBySimulation:
        """Make the validation on the first recording."""
        from dynident.validation import filters_by_simulation
        from dynident.validation.filter_choice import LONGEST

        return filters_by_simulation(
            tried.model,
            tried.recordings[0],
            cutoffs=self.cutoffs,
            longest=self.longest or LONGEST,
            seed=self.seed,
            progress=tried.progress,
        )


@dataclass(frozen=True)
class Bootstrap(Trial):
    """Standard deviations held against draws of the reduced data's blocks of time."""

    name = "bootstrap"
    label = "deviations"
    words = "Blocks of time are resampled (bootstrap): are the standard deviations right?"
    of_model_alone = True
    takes_recordings = False

    draws: int | None = declare_field("Number of resamplings; 999 by default", default=None, at_least=99, at_most=9999)
    seed: int = declare_field("Seed of the resampling", default=0, at_least=0, at_most=LARGEST_SEED)

    def judge(self, tried: ValidationData) -> BootstrapValidation:
        """Make the validation."""
        from dynident.estimation.block_bootstrap import DRAWS
        from dynident.validation import validate_bootstrap

        return validate_bootstrap(tried.model, draws=self.draws or DRAWS, seed=self.seed, progress=tried.progress)


_KINDS: tuple[type[Trial], ...] = (
    Direct, Cross, InertiaMatrix, Simulation, DriftTrial, CollisionTrial, Methods, Filters, Bootstrap, Payload,
)  # fmt: skip


class _Trials:
    """All kinds of validation, by their names."""

    by_name: Mapping[str, type[Trial]] = {kind.name: kind for kind in _KINDS}

    @property
    def names(self) -> tuple[str, ...]:
        """All names, in their order."""
        return tuple(self.by_name)

    @property
    def choices(self) -> tuple[Choice, ...]:
        """The names with their words."""
        return tuple(Choice(kind.name, kind.label or kind.name, kind.words) for kind in self.by_name.values())

    def format_help(self) -> str:
        """Join the names for a line of help."""
        return ", ".join(self.names)


TRIALS = _Trials()


def _build_request_class() -> type:
    """Build the flat request class: the fields of all kinds, each with the kinds that take it in its words."""
    # A field that several kinds take is declared by the first of them; its words name all.
    takers: dict[str, list[str]] = {}
    firsts: dict[str, Field[Any]] = {}
    for kind in TRIALS.by_name.values():
        for field in fields(kind):
            takers.setdefault(field.name, []).append(kind.name)
            firsts.setdefault(field.name, field)
    definitions = [
        (name, field.type, redescribe_field(field, f"{', '.join(takers[name])}: {get_description(field).words}"))
        for name, field in firsts.items()
    ]
    request_class = make_dataclass("Stated", definitions, bases=(Request,), frozen=True)
    request_class.__module__ = __name__
    return request_class


Stated = _build_request_class()
"""What is stated of a validation beside its kind: the fields of all kinds, flat."""


def build_trial(kind: str, stated: Mapping[str, object]) -> Trial:
    """Build the validation of a kind from its fields; None counts as not stated.

    Parameters
    ----------
    kind : str
        Name of a validation, one of `TRIALS.names`.
    stated : mapping of field name to value
        Fields of the request; those that are None count as left out.

    Returns
    -------
    Trial
        The validation, with its fields in their ranges.

    Raises
    ------
    DynidentError
        For a field that the kind does not take, a value out of its range, or a kind that there is not.
    """
    if kind not in TRIALS.by_name:
        raise DynidentError(f"there is no validation {kind!r}; choose from: {', '.join(TRIALS.names)}", pointer="/kind")
    own = {field.name for field in fields(TRIALS.by_name[kind])}
    values = {name: value for name, value in stated.items() if value is not None}
    for name in values:
        # A seed is for all that is drawn; what draws nothing has no use for it, and it does no harm.
        if name not in own and name != "seed":
            raise DynidentError(
                f"the validation {kind} has no option {name}; leave it out", pointer=f"/{name}", title="Unusable input"
            )
    return replace(TRIALS.by_name[kind](), **{name: value for name, value in values.items() if name in own})
