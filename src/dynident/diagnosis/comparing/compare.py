"""Measured against predicted torque along a recording: where the model fails, joint by joint."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.errors import DynidentError
from dynident.estimation import Errors
from dynident.estimation.statistics import NORMAL_95
from dynident.identification import Identification
from dynident.identification.prediction import prediction_deviation
from dynident.progress import Progress, silent
from dynident.recordings import Recording, SampleBlock
from dynident.regressors.stream import SampleFunction, parallel_filtered
from dynident.robot.model import FloatArray
from dynident.threads import single_threaded

IntArray = NDArray[np.intp]

_STRETCH = 0.5
_WORST = 12


@dataclass(frozen=True)
class WorstStretch:
    """A stretch of time where a joint's residual is large; `rms` in N m or N, `ratio` over the joint's own rms.

    `time` is when it is largest, `pose` and `speed` (n,) the positions and velocities of all joints at that moment.
    """

    joint: str
    start: float
    end: float
    rms: float
    ratio: float
    time: float
    pose: tuple[float, ...]
    speed: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Comparison:
    """Filtered, decimated signals of one recording beside the model's prediction.

    t, segment (m,); measured, predicted, deviation, q, dq, ddq, load (m, n). `deviation` is the standard deviation of
    the prediction that the parameters' uncertainty causes; `load` the rigid-body part of the prediction. `noise` (n,)
    is the standard deviation of the model's residual; temperature (m, n) in degC, or None where none was measured.
    """

    joint_names: tuple[str, ...]
    units: tuple[str, ...]
    t: FloatArray
    segment: FloatArray
    measured: FloatArray
    predicted: FloatArray
    deviation: FloatArray
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    load: FloatArray
    noise: FloatArray
    temperature: FloatArray | None = None

    @property
    def residual(self) -> FloatArray:
        """(m, n): measured minus predicted."""
        return self.measured - self.predicted

    @property
    def band(self) -> FloatArray:
        """(m, n): half-width of the 95 % band of the residual, from parameters and residual noise."""
        return np.asarray(NORMAL_95 * np.sqrt(self.deviation**2 + self.noise**2))

    @cached_property
    def errors(self) -> Errors:
        """The errors of the whole recording, per joint."""
        squares = (self.residual**2).sum(axis=0)
        return Errors(squares, (self.measured**2).sum(axis=0), np.full(len(squares), float(len(self.t))))

    @cached_property
    def worst(self) -> tuple[WorstStretch, ...]:
        """Half-second stretches with the largest residual, measured by the joint's own rms."""
        borders = np.flatnonzero(np.diff(np.floor((self.t - self.t[0]) / _STRETCH)) != 0) + 1
        parts = [part for part in np.split(np.arange(len(self.t)), borders) if len(part) >= 2]
        rms = self.errors.rms
        local = np.array([np.sqrt((self.residual[part] ** 2).mean(axis=0)) for part in parts]).reshape(-1, len(rms))
        ratios = np.divide(local, rms, out=np.zeros_like(local), where=rms > 0)
        order = np.argsort(-ratios, axis=None, kind="stable")[:_WORST]
        places = zip(*np.unravel_index(order, ratios.shape), strict=True)
        return tuple(self._stretch(parts[k], int(j), float(local[k, j]), float(ratios[k, j])) for k, j in places)

    def _stretch(self, rows: IntArray, joint: int, rms: float, ratio: float) -> WorstStretch:
        worst = rows[int(np.argmax(np.abs(self.residual[rows, joint])))]
        return WorstStretch(
            joint=self.joint_names[joint],
            start=float(self.t[rows[0]]),
            end=float(self.t[rows[-1]]),
            rms=rms,
            ratio=ratio,
            time=float(self.t[worst]),
            pose=tuple(self.q[worst].tolist()),
            speed=tuple(self.dq[worst].tolist()),
        )

    def signal(self, name: str) -> FloatArray:
        """(m,): a signal by name: t, or q_, dq_, ddq_, load_, tau_, temperature_ followed by a joint's name.

        Raises
        ------
        DynidentError
            For a signal that there is not.
        """
        if name in ("t", "time"):
            return self.t
        kind, _, joint = name.partition("_")
        arrays = {"q": self.q, "dq": self.dq, "ddq": self.ddq, "load": self.load, "tau": self.measured}
        if self.temperature is not None:
            arrays["temperature"] = self.temperature
        if kind in arrays and joint in self.joint_names:
            return np.asarray(arrays[kind][:, self.joint_names.index(joint)])
        raise DynidentError(
            f"there is no signal {name!r}; there are t and {', '.join(f'{one}_' for one in arrays)} with one of: "
            f"{', '.join(self.joint_names)}",
            pointer="/x",
            title="Unknown signal",
        )


@single_threaded
def compare(identification: Identification, recording: Recording, progress: Progress = silent) -> Comparison:
    """Predict the torque along a recording and hold it against what was measured.

    Raises
    ------
    DynidentError
        Where no row of the recording is left after filtering.
    """
    robot = identification.model.robot
    n = robot.n
    parts = list(_parts(identification, recording, progress))
    if not parts:
        raise DynidentError(
            f"no rows of {recording.name} are left after filtering; use a longer recording or wider windows",
            pointer="/measurement_id",
            title="Too few samples",
        )
    t, segment, signals = (np.concatenate(items) for items in zip(*parts, strict=True))
    measured, predicted, deviation, q, dq, ddq, load, *more = (
        signals[:, k * n : (k + 1) * n] for k in range(signals.shape[1] // n)
    )
    return Comparison(
        joint_names=robot.joint_names,
        units=tuple(joint.effort_unit for joint in robot.joints),
        t=t,
        segment=segment,
        measured=measured,
        predicted=predicted,
        deviation=deviation,
        q=q,
        dq=dq,
        ddq=ddq,
        load=load,
        noise=identification.noise,
        temperature=more[0] if more else None,
    )


def _parts(
    identification: Identification, recording: Recording, progress: Progress
) -> Iterator[tuple[FloatArray, FloatArray, FloatArray]]:
    """Times, segment numbers and the signals side by side, as they leave the filter."""
    observation = identification.model.observation
    entries = SampleFunction(observation, identification.reference, recording)
    rigid = np.array([column.effect in ("rigid_body",) for column in observation.columns])
    load_values = np.where(rigid, identification.values, 0.0)
    covariance = identification.statistics.covariance
    n_entries, n = len(observation.entry_rows), observation.robot.n

    def values(block: SampleBlock) -> FloatArray:
        more = [] if block.temperature is None else [block.temperature]
        return np.hstack([entries(block), block.tau, block.q, block.dq, block.ddq, *more])

    end = recording.segments[-1].start_time + recording.segments[-1].length * recording.period
    start = recording.segments[0].start_time
    for segment, t, rows in parallel_filtered(recording, identification.preprocessing, values):
        w = rows[:, :n_entries]
        predicted = observation.torque(w, identification.values)
        load = observation.torque(w, load_values)
        deviation = prediction_deviation(observation, w, covariance)
        measured = rows[:, n_entries : n_entries + n]
        motion, more = rows[:, n_entries + n : n_entries + 4 * n], rows[:, n_entries + 4 * n :]
        progress(min(1.0, (t[-1] - start) / max(end - start, 1e-9)), f"predicting {recording.name}")
        yield t, np.full(len(t), float(segment)), np.hstack([measured, predicted, deviation, motion, load, more])
