"""Figure data of each ranked effect: the residual over the variable that the effect depends on, and the fitted effect.

Holds how many effects have a figure (12), and how many bins it has (48).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from dynident.array_types import FloatArray
from dynident.diagnosis.diagnosis_result import RankedEffect
from dynident.effects import Column, EffectChoice, ReferenceParameters, build_columns, get_role
from dynident.effects.effect_columns import find_joints
from dynident.estimation import Reduction, build_weighted_factor
from dynident.identification import Identification
from dynident.number_format import format_percent
from dynident.parallel import single_threaded
from dynident.progress import Progress, ignore_progress, scale_progress
from dynident.recordings import Recording
from dynident.recordings.low_pass_decimation import filter_in_parallel
from dynident.regressors.dynamic_model_rows import (
    FilteredSamples,
    reduce_recordings,
    stream_filtered_samples,
)
from dynident.regressors.observation_matrix import Observation, RegressorInputs
from dynident.regressors.row_phases import RowPhases
from dynident.robot import Robot

Axis = Literal["position", "velocity", "acceleration", "load", "time", "travel since reversal", "phase"]

MOST = 12
"""So many of the ranked effects are shown."""
# Bins of a figure, fewest rows in a bin, and number of entries up to which rows are kept in memory.
_BINS = 48
_FEWEST = 8
_KEPT_VALUES = 4_000_000
# Difference of the explained shares at which two variables count as equally good, and share of the largest singular
# value below which a direction is dependent.
_AMBIGUOUS = 0.02
_DEPENDENT = 1e-9


@dataclass(frozen=True, eq=False)
class Evidence:
    """One joint's residual and a fitted effect, in bins that hold equally many samples.

    Parameters
    ----------
    rank : int
        Rank of the effect.
    effect : str
        Id of the effect.
    joint : str
        Name of the joint.
    variable : Axis
        The variable that shows the effect best.
    unit : str
        Unit of the variable.
    x : (k,)
        Mean of the variable in each bin.
    residual : (k,)
        Mean of the residual of the model without the effect, N m or N.
    spread : (k,)
        Standard deviation of that residual.
    fitted : (k,)
        Mean of what the effect adds to the prediction once all parameters are fitted anew.
    count : (k,)
        Number of samples in each bin.
    explained : float
        Share of the squares of this joint's residual that the curve removes where it was fitted, beside the model
        alone: it tells which of an effect's joints the figure is to show.
    error_drop : float
        What the effect explains, as the ranking tells it: the share of the error on left-out blocks that it removes on
        its joints beside all that ranks above it.
    """

    rank: int
    effect: str
    joint: str
    variable: Axis
    unit: str
    x: FloatArray
    residual: FloatArray
    spread: FloatArray
    fitted: FloatArray
    count: FloatArray
    explained: float
    error_drop: float

    def __repr__(self) -> str:
        return (
            f"Evidence({self.effect} on {self.joint} over {self.variable}: explains "
            f"{format_percent(self.error_drop, decimals=1)})"
        )


@dataclass(frozen=True, eq=False)
class _CandidateRows:
    """All rows together: t (m,); q, dq, ddq, load and residual (m, n); and (m, n) for each candidate.

    `fitted` is by how much its fit changes the prediction, `own` its own part of the torque, what the other parameters
    give up to it included.
    """

    t: FloatArray
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    load: FloatArray
    residual: FloatArray
    fitted: tuple[FloatArray, ...]
    own: tuple[FloatArray, ...]


@single_threaded
def evidence(
    identification: Identification,
    candidates: Sequence[RankedEffect],
    recordings: Sequence[Recording],
    progress: Progress = ignore_progress,
) -> tuple[Evidence, ...]:
    """Fit each of the first ranked effects beside a model, and bin what it explains joint by joint.

    Parameters
    ----------
    identification : Identification
        The identified model.
    candidates : sequence of RankedEffect
        Those up to rank `MOST` are fitted.
    recordings : sequence of Recording
        Recordings that the effects are fitted to.
    progress : Progress
        Called with the fraction done and a message; may raise to cancel.

    Returns
    -------
    tuple of Evidence
        Best rank first, one for each joint that the effect acts on.
    """
    top_candidates = [candidate for candidate in candidates if candidate.rank <= MOST]
    if not top_candidates:
        return ()
    robot = identification.model.robot
    choices = [candidate.choice for candidate in top_candidates]
    rows = _compute_rows(identification, choices, recordings, progress)
    figures = []
    for number, (candidate, choice) in enumerate(zip(top_candidates, choices, strict=True)):
        places = [robot.tree.joint_names[j] for j in find_joints(choice, robot)]
        for joint in sorted({j for name in places for j in robot.get_movers(name)}):
            figure = _bin_for_joint(candidate, number, joint, robot, rows)
            if figure is not None:
                figures.append(figure)
    return tuple(figures)


def _bin_for_joint(
    ranked: RankedEffect, number: int, joint: int, robot: Robot, rows: _CandidateRows
) -> Evidence | None:
    effort = robot.joints[joint].effort_unit
    residual, curve, own = rows.residual[:, joint], rows.fitted[number][:, joint], rows.own[number][:, joint]
    total = float((residual**2).sum())
    # Nothing to draw: the joint has no residual, or the effect does not act on it.
    if not total > 0 or not curve.any():
        return None
    angle = "rad" if effort == "N m" else "m"
    options: list[tuple[Axis, str, FloatArray]] = [
        ("velocity", f"{angle}/s", rows.dq[:, joint]),
        ("position", angle, rows.q[:, joint]),
        ("load", effort, rows.load[:, joint]),
        ("acceleration", f"{angle}/s²", rows.ddq[:, joint]),
        ("travel since reversal", angle, _compute_travel(rows.q[:, joint], rows.dq[:, joint])),
        ("time", "s", rows.t),
    ]
    # A ripple is a function of the phase of its cycles; over the position its waves would be averaged away.
    cycles = dict(ranked.choice.shape).get("k")
    if cycles:
        options.insert(0, ("phase", "rad", np.mod(cycles * rows.q[:, joint], 2.0 * np.pi)))
    # By the effect's own torque: what the other parameters give up to it depends on other variables.
    shares = [_compute_explained_share(values, own) for _, _, values in options]
    # Of axes that show it equally well the first: they are in the order in which people think of them.
    variable, unit, values = options[next(k for k, s in enumerate(shares) if s >= max(shares) - _AMBIGUOUS)]
    bins = _number_bins(values)
    counts = np.bincount(bins).astype(np.float64)
    if len(counts) < 3 or counts.min() < _FEWEST:
        return None
    means = [np.bincount(bins, weights=w) / counts for w in (values, residual, residual**2, curve)]
    return Evidence(
        rank=ranked.rank,
        effect=ranked.effect,
        joint=robot.joint_names[joint],
        variable=variable,
        unit=unit,
        x=means[0],
        residual=means[1],
        spread=np.sqrt(np.maximum(means[2] - means[1] ** 2, 0.0)),
        fitted=means[3],
        count=counts,
        explained=1.0 - float(((residual - curve) ** 2).sum()) / total,
        error_drop=ranked.error_drop,
    )


def _number_bins(values: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """Return (m,): the number of each value's bin; bins hold about equally many."""
    # Quantiles of a signal that stays at one value are equal; each edge once.
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, _BINS + 1)[1:-1]))
    which = np.searchsorted(edges, values, side="right")
    return np.asarray(np.unique(which, return_inverse=True)[1])


def _compute_explained_share(values: FloatArray, curve: FloatArray) -> float:
    """Return the share of a curve's variance (m,) that its means in bins of a variable (m,) reproduce."""
    bins = _number_bins(values)
    counts = np.bincount(bins)
    means = np.bincount(bins, weights=curve) / counts
    around = float(((curve - curve.mean()) ** 2).sum())
    return float((counts * (means - curve.mean()) ** 2).sum()) / around if around > 0 else 1.0


def _compute_travel(q: FloatArray, dq: FloatArray) -> FloatArray:
    """Return (m,): how far a joint has come since its last reversal, with the sign of its motion."""
    sign = np.sign(dq)
    # A stroke begins wherever the velocity changes its sign.
    starts_stroke = np.concatenate([[True], sign[1:] != sign[:-1]])
    return np.asarray(q - q[np.flatnonzero(starts_stroke)[np.cumsum(starts_stroke) - 1]])


def _compute_rows(
    identification: Identification, choices: Sequence[EffectChoice], recordings: Sequence[Recording], progress: Progress
) -> _CandidateRows:
    """Compute the residual and the fitted effects along all recordings."""
    model, preprocessing = identification.model, identification.preprocessing
    reference = identification.estimate.next_reference()
    new, places = _build_columns(identification, choices)
    whole = model.observation.extend(new, model.signals)
    samples = _SampleCache(whole, recordings, identification, reference)
    reduction = reduce_recordings(
        whole,
        RegressorInputs(recordings, preprocessing, reference),
        scale_progress(progress, 0.0, 0.6),
        samples_of=samples.get_samples,
    )
    base = tuple(range(model.n_parameters))
    start = _fit_values(reduction, base, identification.noise)
    # Each effect is fitted together with all parameters of the model: what it explains is then what the model really
    # lacks.
    fits = [_fit_values(reduction, (*base, *columns), identification.noise) for columns in places]
    rigid = np.array([get_role(column) == "link" for column in whole.columns])
    added = np.arange(whole.n_columns) >= model.n_parameters
    parts: list[list[FloatArray]] = []
    for recording in recordings:
        for piece, motion in zip(
            samples.get_samples(recording), _yield_motions(recording, identification), strict=True
        ):
            predicted = whole.compute_torque(piece.values, start)
            effects = [whole.compute_torque(piece.values, fit) - predicted for fit in fits]
            alone = [whole.compute_torque(piece.values, np.where(added, fit, 0.0)) for fit in fits]
            load = whole.compute_torque(piece.values, np.where(rigid, start, 0.0))
            parts.append([piece.t, motion, load, piece.tau - predicted, *effects, *alone])
    t, motion, load, residual, *drawn = (np.concatenate(items) for items in zip(*parts, strict=True))
    n = model.robot.n
    progress(1.0, "computing what each effect explains")
    return _CandidateRows(
        t=t,
        q=motion[:, :n],
        dq=motion[:, n : 2 * n],
        ddq=motion[:, 2 * n :],
        load=load,
        residual=residual,
        fitted=tuple(drawn[: len(fits)]),
        own=tuple(drawn[len(fits) :]),
    )


def _build_columns(
    identification: Identification, choices: Sequence[EffectChoice]
) -> tuple[list[Column], list[tuple[int, ...]]]:
    """Return the new columns of all choices, each once, and for every choice their numbers behind the model's own."""
    known_keys = {column.key for column in identification.model.columns}
    where: dict[object, int] = {}
    new: list[Column] = []
    places = []
    for choice in choices:
        own = [
            column for column in build_columns([choice], identification.model.signals) if column.key not in known_keys
        ]
        for column in own:
            if column.key not in where:
                where[column.key] = identification.model.n_parameters + len(new)
                new.append(column)
        places.append(tuple(where[column.key] for column in own))
    return new, places


def _fit_values(reduction: Reduction, columns: Sequence[int], noise: FloatArray) -> FloatArray:
    """Return parameters (c,) with all columns but these at zero; of those that fit equally well the smallest.

    A column may depend on the model's own, which changes nothing in what is predicted.
    """
    factor = build_weighted_factor(reduction.select_columns(columns), noise)
    # Unit columns: which singular values are cut off must not depend on the units of parameters.
    scales = np.linalg.norm(factor[:, :-1], axis=0)
    scales = np.where(scales > 0, scales, 1.0)
    values = np.zeros(reduction.n_columns)
    values[list(columns)] = np.linalg.lstsq(factor[:, :-1] / scales, factor[:, -1], rcond=_DEPENDENT)[0] / scales
    return values


class _SampleCache:
    """Filtered entries of recordings, evaluated once where they are few enough to be kept in memory."""

    def __init__(
        self,
        observation: Observation,
        recordings: Sequence[Recording],
        identification: Identification,
        reference: ReferenceParameters,
    ) -> None:
        self._made = (observation, identification.preprocessing, reference)
        rows = sum(recording.n_samples for recording in recordings) / identification.preprocessing.decimation
        self._keep = rows * len(observation.entry_rows) < _KEPT_VALUES
        self._kept: dict[int, list[FilteredSamples]] = {}

    def get_samples(self, recording: Recording) -> Iterable[FilteredSamples]:
        """Return all pieces of a recording."""
        observation, preprocessing, reference = self._made
        phases = RowPhases.from_recording(observation, recording, preprocessing)
        if id(recording) in self._kept:
            return self._kept[id(recording)]
        pieces = stream_filtered_samples(observation, recording, preprocessing, reference, phases=phases)
        if not self._keep:
            return pieces
        return self._kept.setdefault(id(recording), list(pieces))


def _yield_motions(recording: Recording, identification: Identification) -> Iterator[FloatArray]:
    """Yield (m, 3 n): q, dq, ddq of the rows, piece by piece."""
    for _, _, rows in filter_in_parallel(
        recording, identification.preprocessing, lambda block: np.hstack([block.q, block.dq, block.ddq])
    ):
        yield rows
