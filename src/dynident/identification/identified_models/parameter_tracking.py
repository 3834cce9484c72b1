"""Track a payload or friction while a robot moves: the other parameters are those of a known model.

The same filter as for a recording under way, with exponential forgetting.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import FloatArray, IndexArray
from dynident.effects import Column, EffectChoice
from dynident.errors import DynidentError
from dynident.estimation import Reduction, compute_errors, solve_weighted, statistics
from dynident.identification.equations.model_and_data_checks import check_recordings
from dynident.identification.identified_models.identification_result import Identification
from dynident.identification.identified_models.recursive_identification import GrowingFactors
from dynident.parallel import single_threaded
from dynident.recordings import Recording
from dynident.regressors.model_structure import build_model
from dynident.regressors.observation_matrix import RegressorInputs

PAYLOAD = "payload"


@dataclass(frozen=True, eq=False)
class TrackedEstimate:
    """Parameters that change, as they are now.

    Parameters
    ----------
    seconds : float
        Length of the recording so far, s.
    time : float
        Time of the newest row that the estimate rests on, s; not a number before there is one.
    columns : tuple of Column
        What each parameter is: `name`, `unit`, `effect`, `link`.
    values, standard_deviations : (k,) or None
        The parameters in their units; None where the rows that are remembered do not determine them.
    reason : str
        Why there are none; "" where there are some.
    error : (n,) or None
        Relative error of the torque by joint that model and parameters leave of the rows that are remembered.
    """

    seconds: float
    time: float
    columns: tuple[Column, ...]
    values: FloatArray | None = None
    standard_deviations: FloatArray | None = None
    reason: str = ""
    error: FloatArray | None = None

    def __getitem__(self, name: str) -> float:
        """Return the value of a parameter by its name, such as "Mp"; not a number where it is not determined."""
        places = [k for k, column in enumerate(self.columns) if name in (column.name, column.parameter)]
        if not places:
            raise KeyError(f"{name}; the parameters are {', '.join(column.name for column in self.columns)}")
        return float("nan") if self.values is None else float(self.values[places[0]])


class ParameterTracker:
    """Tracks parameters of a robot that change; all others are held at the values of a known model.

    Standard deviations are those of the tracked parameters alone: they do not contain the uncertainty of the model.

    Parameters
    ----------
    known : Identification
        The model, identified without what is tracked.
    track : sequence of str
        "payload", for a load on the last link beside what the model knows, and ids of effects of the model, such as
        "coulomb" and "viscous".
    memory : float
        Rows count the less the older they are, exp(-age / memory), s.

    Raises
    ------
    DynidentError
        For what is neither, and a model with effects that need a predicted load.
    """

    def __init__(self, known: Identification, track: Sequence[str] = (PAYLOAD,), memory: float = 5.0) -> None:
        if not 0.0 < memory < np.inf:
            raise DynidentError(f"memory is {memory!r}; give seconds above zero", pointer="memory")
        self._known, self._memory, model = known, memory, known.model
        effects = [column.effect for column in model.kept]
        unknown = [name for name in track if name != PAYLOAD and name not in effects]
        if unknown or not track:
            raise DynidentError(
                f'{", ".join(map(repr, unknown)) or "nothing"} cannot be tracked; name "payload" or effects of the '
                f"model: {', '.join(dict.fromkeys(effects))}",
                pointer="track",
            )
        if model.needs_load:
            raise DynidentError(
                "the model has effects that depend on the load, which changes while it is tracked; identify one "
                "without them",
                pointer="known",
            )
        # Of the load all that can be told from a motion at all, as of a link of its own.
        robot, signals = model.robot, model.signals
        load = build_model(robot, [EffectChoice(PAYLOAD)], signals=signals).kept if PAYLOAD in track else ()
        self._observation = model.observation.extend(load, signals)
        tracked = [k for k, name in enumerate(effects) if name in track]
        self._tracked: IndexArray = np.array([*tracked, *(len(effects) + np.arange(len(load)))], dtype=np.intp)
        self._values = np.concatenate([known.values, np.zeros(len(load))])
        self._factors: GrowingFactors | None = None
        self._recording: Recording | None = None

    @property
    def columns(self) -> tuple[Column, ...]:
        """What is tracked."""
        return tuple(self._observation.columns[k] for k in self._tracked)

    @single_threaded
    def push(self, recording: Recording) -> None:
        """Take the recording so far; what was pushed before is not read again."""
        check_recordings(self._known.model.robot, [recording], ())
        # The payload's columns count in recordings that are marked as carrying one.
        recording = replace(recording, payload=recording.payload or {})
        self._recording = recording
        if self._factors is None or not self._factors.is_continued_by(recording):
            inputs = RegressorInputs([recording], self._known.preprocessing, self._known.estimate.reference)
            self._factors = GrowingFactors(self._observation, None, inputs, self._memory)
        self._factors.push(recording)

    @single_threaded
    def estimate(self) -> TrackedEstimate:
        """Solve for the tracked parameters by the rows that are remembered."""
        recording, factors = self._recording, self._factors
        seconds = 0.0 if recording is None else recording.n_samples * recording.period
        if factors is not None:
            factors.fold()
        remembered = None if factors is None else factors.weighted_factors
        if remembered is None:
            return TrackedEstimate(seconds, np.nan, self.columns, reason="No row is complete yet.")
        time, rest = float(remembered.spans[-1, 1]), self._subtract_known(remembered)
        try:
            solution = solve_weighted(rest)
        except DynidentError as error:
            return TrackedEstimate(seconds, time, self.columns, reason=error.detail)
        values = self._values.copy()
        values[self._tracked] = solution.values
        return TrackedEstimate(
            seconds,
            time,
            self.columns,
            solution.values,
            statistics(rest, solution).standard_deviations,
            error=compute_errors(remembered, values).relative,
        )

    def _subtract_known(self, reduction: Reduction) -> Reduction:
        """Return the rows of the tracked columns alone, with the torque that the known parameters leave."""
        numbers = {int(k): place for place, k in enumerate(self._tracked)}
        equations = []
        for equation in reduction.equations:
            own = [place for place, k in enumerate(equation.columns) if int(k) in numbers]
            held = [place for place, k in enumerate(equation.columns) if int(k) not in numbers]
            change = np.zeros((len(equation.columns) + 1, len(own) + 1))
            change[own, np.arange(len(own))] = 1.0
            change[held, -1] = -self._values[equation.columns[held]]
            change[-1, -1] = 1.0
            chosen = np.array([numbers[int(equation.columns[place])] for place in own], dtype=np.intp)
            equations.append(equation.mix_columns(change, chosen))
        return Reduction(len(self._tracked), tuple(equations), reduction.spans)
