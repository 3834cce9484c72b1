"""Reduce the recordings of one day to the columns of the model and of everything that may change."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property

from dynident.array_types import FloatArray
from dynident.diagnosis.candidates.pool import list_change_candidates
from dynident.diagnosis.comparing.noise import estimate_sensor_noise
from dynident.diagnosis.residuals.shape_proposals import ShapeProposals
from dynident.effects import CATALOGUE, Column, Effect, EffectChoice, ReferenceParameters, get_effect
from dynident.effects.effect_columns import build_columns_for_all_runs
from dynident.encoding import escape_surrogates
from dynident.errors import DynidentError
from dynident.estimation import Reduction
from dynident.identification import Identification
from dynident.identification.equations.checks import check_runs, check_temperature
from dynident.identification.equations.reduce_data import split_friction_tests
from dynident.progress import Progress, ignore_progress
from dynident.recordings import Preprocessing, Recording
from dynident.regressors.filtered_rows import reduce_recordings
from dynident.regressors.model import Model
from dynident.regressors.observation import Observation

_ANY = ("any",)


@dataclass(frozen=True)
class PossibleChange:
    """A change that a robot may undergo.

    Parameters
    ----------
    choice : EffectChoice
        The effect, on its joints.
    columns : tuple of int
        Numbers of its columns in W of the measure.
    """

    choice: EffectChoice
    columns: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Measure:
    """The columns that every day is reduced to, the same for all days.

    Parameters
    ----------
    model : Model
        The model that the robot is compared with.
    observation : Observation
        Columns of the model, and behind them those of all that may change.
    possible : tuple of PossibleChange
        What may differ from some day on.
    lasting : tuple of PossibleChange
        What would be missing in the model on all days alike: the same effects, and those that depend on the
        temperature.
    preprocessing : Preprocessing
        Filters of the model.
    reference : ReferenceParameters
        Parameters that loads are predicted with.
    """

    model: Model
    observation: Observation
    possible: tuple[PossibleChange, ...]
    lasting: tuple[PossibleChange, ...]
    preprocessing: Preprocessing
    reference: ReferenceParameters

    @cached_property
    def digest(self) -> str:
        """Hash of the columns, of what loads are predicted with, and of the filters."""
        columns = [column.key for column in self.observation.columns]
        # Days can be compared only where they were reduced alike: this hash tells whether they were.
        known = hashlib.sha256(repr((columns, asdict(self.preprocessing))).encode())
        known.update(self.reference.vector.tobytes())
        return known.hexdigest()


@dataclass(frozen=True, eq=False)
class Day:
    """The recordings of one day, reduced to the columns of a measure.

    Parameters
    ----------
    name : str
        Name of the day.
    reduction : Reduction
        The recordings, reduced to the columns of a measure.
    floor : (n,)
        Noise of the sensors, N m or N.
    measure : str
        Digest of that measure.
    source : str
        Digest of the recordings' content, where the caller gives it.
    """

    name: str
    reduction: Reduction
    floor: FloatArray
    measure: str
    source: str = ""

    def __post_init__(self) -> None:
        # Names come from files and may hold lone surrogates, which no JSON file takes.
        object.__setattr__(self, "name", escape_surrogates(self.name))


def build_measure(identification: Identification, *, with_temperature: bool = False) -> Measure:
    """Build the columns that a series of days is judged by, for a model.

    Parameters
    ----------
    identification : Identification
        The model, of any strategy and estimator.
    with_temperature : bool
        Whether all recordings have the joints' temperatures: friction that follows them is then told from wear.

    Returns
    -------
    Measure
        The measure.
    """
    model = identification.model
    columns: list[Column] = list(model.kept)
    index = {column.key: k for k, column in enumerate(columns)}

    def number_columns(choices: Sequence[EffectChoice]) -> tuple[PossibleChange, ...]:
        possible_by_columns: dict[tuple[int, ...], PossibleChange] = {}
        for choice in choices:
            new_columns = build_columns_for_all_runs(choice, model.signals)
            numbers = []
            for column in new_columns:
                if not column.torque.nnz():
                    continue
                if column.key not in index:
                    index[column.key] = len(columns)
                    columns.append(column)
                numbers.append(index[column.key])
            # Two choices with the same columns are one change; the first name stands for both.
            if numbers:
                possible_by_columns.setdefault(tuple(numbers), PossibleChange(choice, tuple(numbers)))
        return tuple(possible_by_columns.values())

    # The days are not known yet: any label stands for the later runs.
    leads = ShapeProposals(has_temperature=with_temperature, since=_ANY)
    # What shows where a joint starts, or by a constant of its own, needs rows and rounds that a series does not keep.
    plain = [effect for effect in CATALOGUE.values() if effect.may_change and not effect.shapes]
    changing = [_drop_runs(choice) for effect in plain for choice in list_change_candidates(effect, model, leads)]
    # A model without friction that follows the temperature would take warmth for wear.
    warm = [
        effect for effect in CATALOGUE.values() if with_temperature and effect.needs_temperature and not effect.shapes
    ]
    free = [effect for effect in warm if all(choice.effect != effect.id for choice in model.effects)]
    lasting = [EffectChoice(effect.id, joints) for effect in free for joints in _list_places(effect, model)]
    possible = number_columns(changing)
    # A function that the model lacks on all days shows in each as its motion happens to show it.
    general = [option.choice for option in possible if not _is_known(option, model) and not _in_some_runs(option)]
    added = number_columns([*lasting, *general])
    return Measure(
        model,
        Observation.from_columns(model.robot, columns, model.signals),
        possible,
        added,
        identification.preprocessing,
        identification.estimate.next_reference(),
    )


def _list_places(effect: Effect, model: Model) -> list[tuple[str, ...]]:
    """List every joint that an effect may sit on, and all of them together: an arm gets warm as a whole."""
    names = tuple(model.robot.joint_names[j] for j in effect.applicable(model.robot))
    return [(name,) for name in names] + ([names] if len(names) > 1 else [])


def _is_known(possible: PossibleChange, model: Model) -> bool:
    return max(possible.columns) < model.n_parameters


def _in_some_runs(possible: PossibleChange) -> bool:
    return get_effect(possible.choice.effect).in_some_runs


def _drop_runs(choice: EffectChoice) -> EffectChoice:
    return EffectChoice(choice.effect, choice.joints, choice.shape)


def reduce_day(
    measure: Measure, name: str, recordings: Sequence[Recording], progress: Progress = ignore_progress, source: str = ""
) -> Day:
    """Reduce the recordings of one day; tests of single joints' friction are left out.

    Parameters
    ----------
    measure : Measure
        Columns that the day is reduced to.
    name : str
        Name of the day.
    recordings : sequence of Recording
        Recordings of that day.
    progress : Progress
        Called with the fraction done and a message; may raise to cancel.
    source : str
        A digest of the recordings' content, where the caller has one.

    Returns
    -------
    Day
        The reduced day.

    Raises
    ------
    DynidentError
        Where there is nothing but such tests, a temperature that the model needs is missing, or the model has effects
        of single runs: on another day there are other ones.
    """
    effects = measure.model.effects
    if any(choice.runs for choice in effects):
        raise DynidentError(
            "the model has effects that are in some runs only; take a model without them",
            pointer="/identification_id",
            title="Effects of single runs",
        )
    ordinary, _ = split_friction_tests(recordings)
    check_runs(effects, ordinary)
    check_temperature(effects, ordinary, ())
    check_temperature([possible.choice for possible in measure.lasting], ordinary, ())
    reduction = reduce_recordings(measure.observation, ordinary, measure.preprocessing, measure.reference, progress)
    return Day(name, reduction, estimate_sensor_noise(ordinary, measure.preprocessing), measure.digest, source)


def find_free_name(name: str, days: Sequence[Day]) -> str:
    """Return a name that none of the days has yet: robots often record into files of one name in many folders.

    Parameters
    ----------
    name : str
        The wanted name; a number is put behind it where it is in use.
    days : sequence of Day
        Days that have names already.

    Returns
    -------
    str
        The wanted name, or that name with a number.
    """
    names = {day.name for day in days}
    return next(
        candidate for candidate in (name, *(f"{name} ({k})" for k in range(2, len(days) + 3))) if candidate not in names
    )
