"""Reduce one day's recordings to inner products of the model and all possible changes, and store them.

The file of stored days makes one more day cost its own recordings alone.
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

from dynident.array_types import FloatArray
from dynident.diagnosis.candidates.candidate_pool import list_change_candidates
from dynident.diagnosis.comparison.noise_floor import estimate_sensor_noise
from dynident.diagnosis.residuals.shape_proposals import ShapeProposals
from dynident.effects import CATALOGUE, Column, Effect, EffectChoice, ReferenceParameters, get_effect
from dynident.effects.effect_columns import build_columns_for_all_runs, list_possible_joints
from dynident.errors import DynidentError
from dynident.estimation import EquationFactors, Reduction
from dynident.identification import Identification
from dynident.identification.equations.model_and_data_checks import check_runs, check_temperature
from dynident.identification.equations.reduced_recordings import split_friction_tests
from dynident.progress import Progress, ignore_progress
from dynident.recordings import Preprocessing, Recording
from dynident.regressors.dynamic_model_rows import reduce_recordings
from dynident.regressors.model_structure import Model
from dynident.regressors.observation_matrix import Observation, RegressorInputs
from dynident.text_encoding import escape_surrogates

_FORMAT, _FORMER = "dynident days 2", "dynident days 1"
"""Format that is written, and one that is read as well: its factors are square."""


def days_to_bytes(measure: Measure, days: Sequence[Day]) -> bytes:
    """Write days as the bytes of an .npz file, with the digest of their measure.

    Parameters
    ----------
    measure : Measure
        Columns that the days were reduced to.
    days : sequence of Day
        Days in their order.

    Returns
    -------
    bytes
        Content of the file.
    """
    header = {
        "format": _FORMAT,
        "measure": measure.digest,
        "equations": len(days[0].reduction.equations) if days else 0,
        "days": [{"name": day.name, "source": day.source} for day in days],
    }
    # An .npz file holds nothing but arrays, so that the JSON text is stored as bytes.
    arrays: dict[str, Any] = {"header": np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)}
    for number, day in enumerate(days):
        arrays |= {f"{number}/floor": day.floor, f"{number}/spans": day.reduction.spans}
        for k, equation in enumerate(day.reduction.equations):
            arrays |= {
                f"{number}/{k}/columns": equation.columns,
                f"{number}/{k}/factors": equation.factors,
                f"{number}/{k}/counts": equation.counts,
            }
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def days_from_bytes(measure: Measure, content: bytes) -> tuple[Day, ...]:
    """Read stored days.

    Raises
    ------
    DynidentError
        Where this is no such file, or the days were reduced for another model.
    """
    header = _read_header(content)
    if header["measure"] != measure.digest:
        raise DynidentError(
            "these days were reduced for another model, or without the temperatures; reduce the recordings again",
            title="Days of another model",
        )
    with np.load(io.BytesIO(content), allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    return tuple(
        Day(
            entry["name"],
            Reduction(
                measure.observation.n_columns,
                tuple(_read_equation(arrays, f"{number}/{k}") for k in range(header["equations"])),
                arrays[f"{number}/spans"],
            ),
            arrays[f"{number}/floor"],
            measure.digest,
            entry["source"],
        )
        for number, entry in enumerate(header["days"])
    )


def load_days(identification: Identification, content: bytes) -> tuple[Measure, tuple[Day, ...]]:
    """Read the stored days of a model together with their measure, with temperatures or without.

    Parameters
    ----------
    identification : Identification
        The model that the days were reduced for.
    content : bytes
        Content of the file.

    Returns
    -------
    tuple of Measure, tuple of Day
        The measure that fits the file, and the days.

    Raises
    ------
    DynidentError
        Where this is no such file, or the days were reduced for another model.
    """
    # The file does not say whether the days have temperatures; the digest of the measure tells.
    measure = build_measure(identification)
    if _read_header(content)["measure"] != measure.digest:
        measure = build_measure(identification, with_temperature=True)
    return measure, days_from_bytes(measure, content)


def check_days(content: bytes) -> None:
    """Raise `DynidentError` where this is no file of days that this version reads."""
    _read_header(content)


def _read_header(content: bytes) -> dict[str, Any]:
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            header = json.loads(file["header"].tobytes())
        known = header["format"] in (_FORMAT, _FORMER) and "measure" in header
    # Whatever file somebody gives, the answer is a sentence.
    except (ValueError, KeyError, OSError, TypeError, zipfile.BadZipFile) as error:
        raise DynidentError("this is not a file of days", title="Unusable file") from error
    if not known:
        raise DynidentError(f"this is not a file of days: its format is {header['format']!r}", title="Unusable file")
    return dict(header)


def _read_equation(arrays: dict[str, Any], name: str) -> EquationFactors:
    columns = arrays[f"{name}/columns"].astype(np.intp)
    return EquationFactors(columns, arrays[f"{name}/factors"], arrays[f"{name}/counts"].astype(np.intp))


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
    names = tuple(model.robot.joint_names[j] for j in list_possible_joints(effect, model.robot))
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
            "the model has effects that act in some runs only; use a model without them",
            pointer="/identification_id",
            title="Effects of single runs",
        )
    ordinary, _ = split_friction_tests(recordings)
    check_runs(effects, ordinary)
    check_temperature(effects, ordinary, ())
    check_temperature([possible.choice for possible in measure.lasting], ordinary, ())
    reduction = reduce_recordings(
        measure.observation, RegressorInputs(ordinary, measure.preprocessing, measure.reference), progress
    )
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
