"""`dynident.identify`, `follow` and `load_model`: models from recordings, while these are made, and from files."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from dynident.api.argument_checks import check_arguments, check_is_file, require
from dynident.api.effect_arguments import resolve_effects
from dynident.api.model import NO_RECORDINGS, Model
from dynident.api.recording_collection import Recordings, SomeRecordings, as_recordings
from dynident.effects import EffectChoice, UnknownEffectError
from dynident.errors import DynidentError, describe_value
from dynident.identification import Identification, IdentificationChoices, from_bytes
from dynident.identification import identify as identify_parameters
from dynident.identification.equations.reduced_recordings import split_friction_tests
from dynident.identification.identification_choices import EstimatorName
from dynident.identification.identified_models.identification_result import LiveEstimate
from dynident.identification.identified_models.parameter_tracking import PAYLOAD, ParameterTracker, TrackedEstimate
from dynident.identification.identified_models.recursive_identification import RecursiveIdentification
from dynident.identification.methods.base_classes import Estimator
from dynident.progress import Progress, ignore_progress
from dynident.recordings import Filters, Preprocessing, Recording, Segment, preprocessing_from_request
from dynident.recordings.recording import StoredRows
from dynident.robot import Robot


@check_arguments
def identify(
    robot: Robot,
    recordings: SomeRecordings,
    *,
    validation: SomeRecordings = (),
    effects: str | EffectChoice | Iterable[str | EffectChoice] | None = None,
    estimator: EstimatorName | Estimator | None = None,
    filters: Filters | Preprocessing | None = None,
    choices: IdentificationChoices | None = None,
    progress: Progress = ignore_progress,
) -> Model:
    """Identify the base parameters of a robot.

    Parameters
    ----------
    robot : Robot
        The robot that was recorded.
    recordings : recordings
        Recordings to which the parameters are fitted.
    validation : recordings
        Held-out recordings, to which no parameter is fitted; they give the held-out errors.
    effects : texts or choices, optional
        Such as ["default", "offset", "stribeck@joint2:vs=0.05"]. "default" stands for links, rotors, Coulomb and
        viscous friction, and is used if nothing is given. `dynident effects` lists all effects.
    estimator : str or Estimator, optional
        The method that estimates the parameters, by name or as an object with options: see docs/methods.md.
    filters : Filters, optional
        Filters of the recordings, such as `dy.Filters(torque_cutoff=15.0)`. Filters that are not given are chosen from
        the data. `model.filters` gives those of a model; you can use them for another model.
    choices : IdentificationChoices, optional
        All options: equation type, strategy, prior and the rest. The other arguments take precedence over it.
    progress : function, optional
        Called with the fraction done and a message.

    Returns
    -------
    Model
        The model, with its recordings.

    Raises
    ------
    DynidentError
        If the choices do not fit each other or the robot, or if the data do not determine the parameters.

    Examples
    --------
    >>> import dynident as dy
    >>> robot = dy.load_robot("scara")
    >>> runs = dy.read_recordings("run1.csv", "run2.csv", robot=robot)
    >>> model = dy.identify(robot, runs[:1], validation=runs[1:])
    >>> model.held_out.relative_total < 0.05
    True
    >>> robust = dy.identify(robot, runs[:1], effects=["default", "stribeck@elbow"], estimator="irls")
    >>> len(robust.parameters) - len(model.parameters)
    1
    """
    # Arguments of their own override the options, so that a stored set of options can be varied in one call.
    all_choices = choices or IdentificationChoices()
    if effects is not None:
        all_choices = replace(all_choices, effects=resolve_effects(effects))
    if estimator is not None:
        all_choices = replace(all_choices, estimator=estimator)
    fit_recordings, held_out = as_recordings(recordings), as_recordings(validation)
    if filters is not None:
        all_choices = replace(all_choices, preprocessing=_resolve_filters(filters, fit_recordings))
    identification = identify_parameters(robot, fit_recordings.recordings, held_out.recordings, all_choices, progress)
    return Model(identification, fit_recordings, held_out)


def _resolve_filters(filters: Filters | Preprocessing, recordings: Recordings) -> Preprocessing:
    if isinstance(filters, Preprocessing):
        return filters
    if not isinstance(filters, Filters):
        raise DynidentError(
            f"filters is {filters!r:.60}; give dy.Filters(…), such as dy.Filters(torque_cutoff=15.0) in Hz",
            pointer="filters",
            title="Impossible preprocessing",
        )
    # Tests of friction at constant velocity say nothing about the bandwidth of the motion.
    motions, _ = split_friction_tests(recordings.recordings)
    return preprocessing_from_request(filters, motions)


class _GrowingArrays:
    """Rows of a recording under way, in the blocks in which they came."""

    def __init__(self, robot: Robot, name: str) -> None:
        self._robot, self._name = robot, name
        self._blocks: list[StoredRows] = []
        self._starts: list[int] = []
        self._count = 0
        self._segments: list[Segment] = []
        self._period, self._steps = 0.0, np.empty(0)
        self._last_time = -np.inf

    def append(self, block: Mapping[str, ArrayLike]) -> None:
        """Append a block of rows, evenly sampled; where time is missing a new segment begins."""
        _check_names(block)
        if self._blocks and ("temperature" in block) != (self._blocks[0].temperature is not None):
            raise _block_error("temperature is in some blocks and not in others; give it in all, or in none")
        try:
            t, q, tau = (np.asarray(block[kind], dtype=np.float64) for kind in ("t", "q", "tau"))
            heat = None if "temperature" not in block else np.asarray(block["temperature"], dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise _block_error(f"it contains something else than numbers: {error}") from error
        shape = len(t) if t.ndim == 1 else -1, self._robot.n
        if any(values is not None and values.shape != shape for values in (q, tau, heat)):
            raise _block_error(f"t has to be (m,), and q, tau and temperature (m, {self._robot.n})")
        if not len(t):
            return
        if not all(np.isfinite(values).all() for values in (t, q, tau, heat) if values is not None):
            raise _block_error("it contains a value that is not a finite number")
        times = np.append(self._last_time, t) if np.isfinite(self._last_time) else t
        steps = np.diff(times)
        if (steps <= 0.0).any():
            raise _block_error("its times have to increase, also from the block before")
        if not self._period:
            if len(t) < _FEWEST_FIRST:
                raise _block_error(f"the first one needs at least {_FEWEST_FIRST} rows, to determine the sampling rate")
            self._period = float(np.median(steps))
        # The usual step of the newest rows: single steps are off by jitter, or gaps.
        recent = np.append(self._steps, steps)
        usual, self._steps = float(np.median(recent)), recent[1 - _FEWEST_FIRST :]
        if abs(usual / self._period - 1.0) > _OFF_RATE:
            detail = f"rows come every {usual:.4g} s now, those of the first one came every {self._period:.4g} s"
            raise _block_error(f"{detail}; the sampling rate has to stay the same")
        gaps = np.flatnonzero(steps > 1.5 * self._period) + (0 if len(times) > len(t) else 1)
        for start in [*([] if self._segments else [0]), *gaps.tolist()]:
            self._segments.append(Segment(self._count + start, 0, float(t[start])))
        self._starts.append(self._count)
        self._blocks.append(StoredRows(q, tau, heat))
        self._count += len(t)
        self._last_time = float(t[-1])

    def rows(self, first: int, length: int, block_length: int) -> Iterator[StoredRows]:
        """Yield `length` rows from row `first` on."""
        for k in range(bisect_right(self._starts, first) - 1, len(self._starts)):
            block, start = self._blocks[k], self._starts[k]
            part = slice(max(first - start, 0), first + length - start)
            if part.stop <= 0:
                return
            heat = None if block.temperature is None else block.temperature[part]
            yield StoredRows(block.q[part], block.tau[part], heat)

    def to_recording(self) -> Recording:
        """Return the recording so far."""
        ends = [*(segment.first_row for segment in self._segments[1:]), self._count]
        segments = tuple(
            replace(segment, length=end - segment.first_row) for segment, end in zip(self._segments, ends, strict=True)
        )
        heat = all(block.temperature is not None for block in self._blocks)
        names = self._robot.joint_names
        return Recording(self._name, names, 1.0 / self._period, segments, self, has_temperature=heat)


_FEWEST_FIRST = 10
"""Rows of the first block, at least: their median step is the sampling period."""
_OFF_RATE = 0.2
"""Share by which the usual step of ten rows may differ from the sampling period: those of a shaky clock differ so."""


def _check_names(block: object) -> None:
    if not isinstance(block, Mapping):
        raise _block_error(f"it is {describe_value(block)}; give dictionaries of arrays t, q and tau")
    if not {"t", "q", "tau"} <= set(block) <= {"t", "q", "tau", "temperature"}:
        raise _block_error(f"it has {', '.join(sorted(map(str, block)))}; give t, q, tau, and temperature if known")


def _block_error(detail: str) -> DynidentError:
    return DynidentError(f"this is not a block of a recording: {detail}", pointer="blocks", title="Unusable block")


@check_arguments
def follow(
    robot: Robot,
    blocks: Iterable[Mapping[str, ArrayLike]],
    *,
    model: Model | Identification | None = None,
    track: Sequence[str] = (PAYLOAD,),
    memory: float | None = None,
    every: float = 1.0,
    choices: IdentificationChoices | None = None,
) -> Iterator[LiveEstimate | TrackedEstimate]:
    """Estimate parameters from a recording while it is made, or track those that change.

    Without a model, all base parameters are estimated, and the last estimate is the model that `identify` gives for
    the whole recording (unless `memory` is given). With a model, its parameters are taken as known, and a payload or
    friction is tracked; the newest rows have the largest weight.

    Parameters
    ----------
    robot : Robot
        The robot that is recorded.
    blocks : iterable of mapping
        New rows, in order: {"t": (m,), "q": (m, n), "tau": (m, n)} in s, rad (m) and N m (N), evenly sampled, and
        "temperature" in degC if known. A gap in time begins a new run.
    model : Model, optional
        The model of the robot whose changes are tracked.
    track : sequence of str
        What is tracked with a model: "payload", and ids of its effects such as "coulomb" and "viscous".
    memory : float, optional
        Time constant in s with which older rows lose weight, exp(-age / memory). By default all rows have the same
        weight without a model, and the time constant is 5 s with a model.
    every : float
        Seconds of the recording between two estimates.
    choices : IdentificationChoices, optional
        Without a model: effects, filters and the rest, as for `identify`.

    Yields
    ------
    LiveEstimate or TrackedEstimate
        The estimate from the rows so far.

    Raises
    ------
    DynidentError
        If a block does not contain evenly sampled rows of this robot, or if something cannot be tracked.

    Examples
    --------
    >>> import numpy as np
    >>> q = dy.read_recordings("run1.csv", robot=robot)[0].to_frame()
    >>> t, n = q["t"].to_numpy(), robot.n
    >>> rows = {"t": t, "q": q.filter(regex="^q_").to_numpy()[:, :n], "tau": q.filter(regex="^tau_").to_numpy()[:, :n]}
    >>> blocks = ({name: values[k : k + 100] for name, values in rows.items()} for k in range(0, len(t), 100))
    >>> last = list(dy.follow(robot, blocks))[-1]
    >>> last.identification is not None
    True
    """
    if not every > 0:
        raise DynidentError(f"every is {every!r}; give seconds above zero", pointer="every")
    if model is not None:
        tracker = ParameterTracker(as_model(model).identification, track, 5.0 if memory is None else memory)
        return _follow_tracked(robot, blocks, tracker, every)
    return _follow_robot(robot, blocks, RecursiveIdentification(robot, choices, memory=memory), every, memory is None)


def _follow_tracked(
    robot: Robot, blocks: Iterable[Mapping[str, ArrayLike]], tracker: ParameterTracker, every: float
) -> Iterator[TrackedEstimate]:
    for recording in _grow(robot, blocks, every):
        tracker.push(recording)
        yield tracker.estimate()


def _follow_robot(
    robot: Robot, blocks: Iterable[Mapping[str, ArrayLike]], live: RecursiveIdentification, every: float, ends: bool
) -> Iterator[LiveEstimate]:
    has_rows = False
    for recording in _grow(robot, blocks, every):
        live.push(recording)
        has_rows = True
        yield live.estimate()
    if ends and has_rows:
        yield live.finish()


def _grow(robot: Robot, blocks: Iterable[Mapping[str, ArrayLike]], every: float) -> Iterator[Recording]:
    """Yield the recording so far, every so many seconds and at the end."""
    growing, seconds = _GrowingArrays(robot, "live"), 0.0
    recording: Recording | None = None
    for block in blocks:
        growing.append(block)
        recording = growing.to_recording()
        now = recording.n_samples * recording.period
        if now - seconds >= every - 0.5 * recording.period:
            seconds = now
            yield recording
            recording = None
    if recording is not None:
        yield recording


@check_arguments
def load_model(path: str | Path) -> Model:
    """Read a model that `Model.save` or `dynident identify --out` wrote.

    The file does not hold its recordings. `Model.with_data` adds them for methods that need them.

    Parameters
    ----------
    path : path
        An .npz file.

    Returns
    -------
    Model
        The model, with the models that led to it, and without recordings.

    Raises
    ------
    DynidentError
        Where there is no such file, or it holds no model that this version can read.

    Examples
    --------
    >>> dy.identify(robot, runs[:1]).save("model.npz")
    >>> model = dy.load_model("model.npz").with_data(runs[:1])
    >>> model.robot.name
    'scara'
    """
    path = Path(path)
    check_is_file(path, "model")
    try:
        return Model(from_bytes(path.read_bytes()), NO_RECORDINGS, NO_RECORDINGS)
    except DynidentError as error:
        # The reader sees bytes alone, so the name of the file is added here.
        own = isinstance(error, UnknownEffectError)
        hint = ". An effect of your own is registered before a model with it is read: dy.register(…)" if own else ""
        raise DynidentError(f"{path.name}: {error.detail}{hint}", pointer=str(path), title=error.title) from error


def as_model(model: Model | Identification) -> Model:
    """Return a model without data where the library's identification is given, else the model itself.

    Parameters
    ----------
    model : Model or Identification
        What a function was given as a model.

    Returns
    -------
    Model
        The same model, in the form that the methods of this package need.

    Raises
    ------
    DynidentError
        For anything else, such as the path of its file.
    """
    require(
        isinstance(model, (Model, Identification)),
        model,
        "model",
        'give one model, as identify(…) gives it or load_model("model.npz") reads it; dy.Ladder((a, b)) compares two',
    )
    return model if isinstance(model, Model) else Model(model, NO_RECORDINGS, NO_RECORDINGS)
