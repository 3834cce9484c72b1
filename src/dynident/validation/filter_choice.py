"""Validation of filters: simulate the identification with other cut-offs, and find better ones (§12.7).

Holds the cut-offs that are tried, and when another one is worth it.

A robot with the identified parameters makes the recorded motion and is measured with the recording's noise. Its
parameters are known, so the error that a choice of filters leaves in them can be seen: the bias of derivatives that
are smoothed too much, or of noise that is let through, and the scatter from one draw of the noise to the next.
The noise of the sensors is estimated from high differences, which no motion of a robot explains.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.errors import DynidentError
from dynident.estimation import compute_relative_change, solve_weighted
from dynident.estimation.row_weights import estimate_robust_scale
from dynident.identification import Identification
from dynident.identification.estimators.identified_robot_simulator import (
    RecordedMotion,
    Simulator,
    build_simulator,
    read_longest_piece,
)
from dynident.identification.thresholds import ValidationOutcome
from dynident.number_format import format_percent
from dynident.parallel import single_threaded
from dynident.progress import Progress, ignore_progress, scale_progress
from dynident.recordings import (
    FurtherColumns,
    Preprocessing,
    Recording,
    filtered_blocks,
    preprocessing_from_request,
    recording_from_arrays,
)
from dynident.regressors.dynamic_model_rows import reduce_recordings
from dynident.regressors.observation_matrix import RegressorInputs
from dynident.simulation import SimulatedRecording

# Of a smooth signal nothing is left after so many differences; white noise of variance σ² leaves C(2k, k) σ².
_DIFFERENCES = 6
_LEFT = 924.0


@dataclass(frozen=True, eq=False)
class SensorNoise:
    """White noise of a recording's sensors.

    Parameters
    ----------
    position : (n,)
        Standard deviation of the noise on positions, in rad or m.
    torque : (n,)
        Standard deviation of the noise on torques, in N m or N.
    """

    position: FloatArray
    torque: FloatArray


def sensor_noise(recording: Recording) -> SensorNoise:
    """Estimate the white noise of a recording from high differences of its unfiltered signals inside the windows.

    Parameters
    ----------
    recording : Recording
        The recording whose noise is estimated.

    Returns
    -------
    SensorNoise
        Standard deviations joint by joint.

    Raises
    ------
    DynidentError
        Where there are too few samples.
    """
    unfiltered = Preprocessing(None, None)
    position: list[FloatArray] = []
    torque: list[FloatArray] = []
    for block in filtered_blocks(recording, unfiltered):
        used = np.flatnonzero(block.used)
        # Differences must not reach across a gap between used samples: the jump there is no noise.
        for run in np.split(used, np.flatnonzero(np.diff(used) > 1) + 1):
            # Short runs have few differences, which all share the same samples.
            if len(run) > 2 * _DIFFERENCES:
                position.append(np.diff(block.q[run], _DIFFERENCES, axis=0))
                torque.append(np.diff(block.tau[run], _DIFFERENCES, axis=0))
    if not position:
        raise DynidentError(
            f"{recording.name} has too few samples inside its windows to estimate its noise", pointer="/recordings"
        )
    joint, effort = np.concatenate(position), np.concatenate(torque)
    # Torque jumps with friction where a joint reverses: the middle of its differences does not see that.
    spread = estimate_robust_scale(effort)
    return SensorNoise(np.sqrt(np.mean(joint**2, axis=0) / _LEFT), np.asarray(spread / np.sqrt(_LEFT)))


LONGEST = 30.0
"""Seconds of a recording that are simulated at most."""

# Draws of the noise: enough to tell bias from scatter, and each costs an identification for every choice of filters.
_DRAWS = 4
# Cut-offs that are tried, as multiples of the identification's own (of a twentieth of the rate where it has none).
_MULTIPLES = (0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8)
_SHARE_OF_RATE = 0.05
# Up to this share of Nyquist filters can be designed.
_HIGHEST = 0.8
# Another choice is only worth while where it lowers the error by more than this factor.
_AS_GOOD = 1.1
# … and where that is more than this share of what the model leaves unexplained.
_NEGLIGIBLE = 0.1


@dataclass(frozen=True)
class FilterTrial:
    """One choice of cut-offs.

    Parameters
    ----------
    preprocessing : Preprocessing
        The filters that were tried.
    error : float or None
        Root mean square over draws of the noise of ||W (χ̂ - χ)|| / ||Y||: the share of the torque that wrong
        parameters cost. None where the choice could not be tried.
    bias : float or None
        The part of `error` that no draw changes.
    worst : str
        Parameter whose mean error is largest in units of the identification's standard deviations.
    worst_bias : float or None
        How large that is.
    problem : str
        Why the choice could not be tried, else "".
    """

    preprocessing: Preprocessing
    error: float | None
    bias: float | None
    worst: str
    worst_bias: float | None
    problem: str = ""


@dataclass(frozen=True, eq=False)
class FiltersBySimulation:
    """All choices of filters that were tried on simulated recordings.

    Parameters
    ----------
    noise : SensorNoise
        Noise of the simulated sensors, as that of the recording.
    trials : tuple of FilterTrial
        All trials, the identification's own filters first.
    used : FilterTrial
        Trial of the filters of the identification.
    chosen : FilterTrial
        Trial with the smallest parameter error.
    judged : ValidationOutcome
        Whether the filters that were used are good, and the reason.
    """

    noise: SensorNoise
    trials: tuple[FilterTrial, ...]
    used: FilterTrial
    chosen: FilterTrial
    judged: ValidationOutcome


@single_threaded
def filters_by_simulation(
    identification: Identification,
    recording: Recording,
    *,
    cutoffs: Sequence[float] | None = None,
    longest: float = LONGEST,
    seed: int = 0,
    progress: Progress = ignore_progress,
) -> FiltersBySimulation:
    """Simulate recordings like the user's, identify them with every choice of filters, and choose the best.

    Position and torque cut-offs are tried together, and the torque's at half and twice the position's.

    Parameters
    ----------
    identification : Identification
        The identified model.
    recording : Recording
        Its longest unbroken segment gives the motion, its noise that of the simulated sensors.
    cutoffs : sequence of float, optional
        Position cut-offs in Hz to try; multiples of the identification's own where none are given.
    longest : float
        Seconds of the recording that are simulated at most.
    seed : int
        Of the first draw of the noise.
    progress : Progress
        Called with the fraction done and a message.

    Returns
    -------
    FiltersBySimulation
        All trials, with the best one and that of the identification's own filters.

    Raises
    ------
    DynidentError
        Where no robot with the identified parameters can make the motion, or a cut-off is impossible.
    """
    # Before the simulation, so that a recording without enough samples is refused at once.
    noise = sensor_noise(recording)
    motion = read_longest_piece(recording, identification.preprocessing, longest)
    progress(0.0, "simulating the recorded motion")
    simulator = build_simulator(identification.model, identification.values, speeds=identification.estimate.speeds)
    truth = _simulate_truth(simulator, motion, scale_progress(progress, 0.0, 0.3))
    # All choices of filters are tried on the same draws of the noise: their differences then hold no luck of the draw.
    draws = [_draw_recording(identification, truth, motion, noise, seed + k) for k in range(_DRAWS)]
    own = identification.preprocessing
    grid = _build_grid(own, recording, cutoffs)
    trials = []
    for number, preprocessing in enumerate(grid):
        share = 0.3 + 0.7 * number / len(grid)
        progress(share, f"cut-offs {_word_cutoffs(preprocessing)}")
        trials.append(_try_filters(identification, simulator.values, preprocessing, draws))
    solved = [trial for trial in trials if trial.error is not None]
    # The own filters come first. If not even these can be tried, there is nothing to compare with.
    if trials[0].error is None or not solved:
        raise DynidentError(f"the simulated recording cannot be identified: {trials[0].problem}", pointer="/kind")
    best = min(solved, key=lambda trial: trial.error or 0.0)
    used = trials[0]
    return FiltersBySimulation(
        noise, tuple(trials), used, best, _judge_filters(used, best, identification.fit.relative_total)
    )


def _simulate_truth(simulator: Simulator, motion: RecordedMotion, progress: Progress) -> SimulatedRecording:
    """Return the motion that the simulated robot makes, without noise."""
    try:
        return simulator.follow(motion, progress)
    except DynidentError as error:
        raise DynidentError(
            f"a robot with the identified parameters cannot make the recorded motion ({error.detail}). Identify with "
            "other filters, a prior or the feasible estimator first",
            pointer="/identification_id",
            title="Identification cannot be simulated",
        ) from error


def _draw_recording(
    identification: Identification, truth: SimulatedRecording, motion: RecordedMotion, noise: SensorNoise, seed: int
) -> Recording:
    """Return the simulated measurement with one draw of the noise, as a recording."""
    rng = np.random.default_rng(seed)
    q = truth.truth.q + noise.position * rng.standard_normal(truth.truth.q.shape)
    tau = truth.tau + noise.torque * rng.standard_normal(truth.tau.shape)
    names = identification.model.robot.joint_names
    heat = truth.temperature
    return recording_from_arrays(
        truth.t, q, tau, joint_names=names, further=FurtherColumns(temperature=heat), name=motion.label
    )


def _build_grid(own: Preprocessing, recording: Recording, cutoffs: Sequence[float] | None) -> list[Preprocessing]:
    """Return the identification's own choice first, then the others, each once."""
    highest = _HIGHEST * 0.5 * recording.sampling_rate
    # The own cut-off is the middle of the search: the best one is seldom far from what the motion and noise ask for.
    middle = own.position_cutoff or own.torque_cutoff or _SHARE_OF_RATE * recording.sampling_rate
    positions = [middle * factor for factor in _MULTIPLES] if cutoffs is None else list(cutoffs)
    for index, cutoff in enumerate(positions):
        if cutoffs is not None and not cutoff < 0.5 * recording.sampling_rate:
            raise DynidentError(
                f"a cut-off of {cutoff} Hz is not possible: {recording.name} is sampled at "
                f"{recording.sampling_rate:.6g} Hz, so give frequencies above 0 and below "
                f"{0.5 * recording.sampling_rate:.6g} Hz",
                pointer=f"/cutoffs/{index}",
            )
    grid = [own]
    for position in positions:
        for factor in (0.5, 1.0, 2.0):
            request = {
                # Three digits, so that the figure is one that a user can type.
                "position_cutoff": float(f"{position:.3g}"),
                "torque_cutoff": float(f"{position * factor:.3g}"),
                "filter_order": own.filter_order,
            }
            # Multiples that no filter can be designed for are left out; the cut-offs of the user were checked above.
            largest = max(request["position_cutoff"], request["torque_cutoff"])
            if largest <= highest or (cutoffs is not None and largest < 0.5 * recording.sampling_rate):
                grid.append(replace(preprocessing_from_request(request, [recording]), reasons=()))
    # The own choice may be among the multiples: it is tried once, in its place at the front.
    return list(dict.fromkeys(grid))


def _try_filters(
    identification: Identification, true: FloatArray, preprocessing: Preprocessing, draws: Sequence[Recording]
) -> FilterTrial:
    model = identification.model
    try:
        reductions = [
            reduce_recordings(
                model.observation, RegressorInputs([draw], preprocessing, identification.estimate.reference)
            )
            for draw in draws
        ]
        # Weighted least squares, whatever the estimator of the model: the filters are judged, not the estimator.
        estimates = np.array([solve_weighted(reduction).values for reduction in reductions])
    except DynidentError as error:
        return FilterTrial(preprocessing, None, None, "", None, error.detail)
    gaps = estimates - true
    # Held against the rows of the identification itself: what the parameters cost there does not depend on the filter.
    size = [compute_relative_change(identification.data.training, gap) for gap in gaps]
    mean = gaps.mean(axis=0)
    deviations = identification.statistics.standard_deviations
    biases = np.abs(mean) / np.maximum(deviations, np.finfo(float).tiny)
    worst = int(np.argmax(biases))
    squared = float(np.mean(np.square(size)))
    # The mean of few draws scatters too; what that alone would make is taken off.
    of_mean = compute_relative_change(identification.data.training, mean) ** 2
    bias = max(of_mean - (squared - of_mean) / (len(draws) - 1), 0.0)
    return FilterTrial(
        preprocessing,
        error=float(np.sqrt(squared)),
        bias=float(np.sqrt(bias)),
        worst=model.kept[worst].name,
        worst_bias=float(biases[worst]),
    )


def _judge_filters(used: FilterTrial, best: FilterTrial, residual: float) -> ValidationOutcome:
    if used.error is None or best.error is None:
        return ValidationOutcome("not_evaluated", "The identification's own filters could not be tried.")
    own = (
        f"The filters used ({_word_cutoffs(used.preprocessing)}) cause a parameter error that changes the torque by "
        f"{format_percent(used.error)}"
    )
    # The smallest of many errors is small by luck, too: a little better is no reason to change.
    if used.error <= _AS_GOOD * best.error:
        return ValidationOutcome(
            "pass",
            f"{own}; no other choice that was tried is better by more than {format_percent(_AS_GOOD - 1, decimals=0)}.",
        )
    if used.error <= _NEGLIGIBLE * residual:
        beside = f"small compared with the {format_percent(residual, decimals=1)} that the model does not explain"
        better = f"with {_word_cutoffs(best.preprocessing)} it would be {format_percent(best.error)}"
        return ValidationOutcome("pass", f"{own}, {beside}; {better}.")
    return ValidationOutcome(
        "fail",
        f"{own}; with {_word_cutoffs(best.preprocessing)} it would be {format_percent(best.error)}. "
        "Identify again with these cut-offs.",
    )


def _word_cutoffs(preprocessing: Preprocessing) -> str:
    position, torque = (
        "none" if value is None else f"{value:.3g} Hz"
        for value in (preprocessing.position_cutoff, preprocessing.torque_cutoff)
    )
    return f"position {position}, torque {torque}"
