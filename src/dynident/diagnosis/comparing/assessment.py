"""Assess a comparison: its residual against the noise floor, and what its motion can and cannot show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynident.array_types import FloatArray
from dynident.blas_threads import single_threaded
from dynident.diagnosis.comparing.autocorrelation import autocorrelation
from dynident.diagnosis.comparing.compare import Comparison
from dynident.diagnosis.comparing.noise import NoiseFloor, floor_of
from dynident.diagnosis.comparing.repeatability import compute_repeated_share, load_tracks, split_tracks
from dynident.recordings import Preprocessing, Recording

# Share of a motion that has to repeat another, p-value of the lack of fit, and ratio to the noise floor, for a note.
_REPEATED = 0.5
_SURE = 0.01
_MISSING = 1.5


@dataclass(frozen=True)
class RepeatedMotion:
    """A motion that the model has seen.

    Parameters
    ----------
    name : str
        Name of the recording whose motion is repeated.
    share : float
        Share of the moving time that repeats it, 0 to 1.
    """

    name: str
    share: float


@dataclass(frozen=True, eq=False)
class Judgement:
    """The figures of a comparison that need more than the residual.

    Parameters
    ----------
    noise : NoiseFloor
        Noise floor of the recording.
    over_noise : (n,)
        Rms of the residual over the noise floor, where each joint moves.
    effective_samples : (n,)
        Number of independent samples that each joint's residual is worth.
    repeated : RepeatedMotion or None
        The motion of the identification that is repeated; None where there is none.
    notes : tuple of str
        What a user must know of all that, in sentences.
    """

    noise: NoiseFloor
    over_noise: FloatArray
    effective_samples: FloatArray
    repeated: RepeatedMotion | None
    notes: tuple[str, ...]


@single_threaded
def judge(
    comparison: Comparison,
    recording: Recording,
    preprocessing: Preprocessing,
    learnt: Sequence[Recording] = (),
) -> Judgement:
    """Compare a residual with the noise floor, and its motion with those that the model was fitted to.

    Parameters
    ----------
    comparison : Comparison
        The recording with the model's prediction.
    recording : Recording
        What was compared.
    preprocessing : Preprocessing
        The filters of the model.
    learnt : sequence of Recording
        What the model was identified from; empty where the comparison is with one of these.

    Returns
    -------
    Judgement
        Noise floor, ratios to it, and notes.
    """
    noise = floor_of(comparison, recording, preprocessing)
    rms = comparison.moving_errors.rms
    # A joint without noise, as in a simulation, is infinitely far above its floor.
    over = np.where(noise.values > 0, rms / np.where(noise.values > 0, noise.values, 1.0), np.inf)
    memory = [
        autocorrelation(comparison.t, comparison.segment, comparison.residual[:, j]).effective_samples
        for j in range(len(rms))
    ]
    repeated = _find_repeated_motion(comparison, recording, learnt)
    return Judgement(noise, over, np.array(memory), repeated, _word_notes(comparison, noise, over, repeated))


def _find_repeated_motion(
    comparison: Comparison, recording: Recording, learnt: Sequence[Recording]
) -> RepeatedMotion | None:
    own_tracks = split_tracks(comparison.t, comparison.segment, comparison.q)
    motions = [
        RepeatedMotion(other.name, compute_repeated_share(own_tracks, load_tracks(other)))
        for other in learnt
        # The same motion with another payload is new data: it does test the model.
        if other.payload == recording.payload
    ]
    most = max(motions, key=lambda motion: motion.share, default=None)
    return most if most is not None and most.share >= _REPEATED else None


def _word_notes(
    comparison: Comparison, noise: NoiseFloor, over: FloatArray, repeated: RepeatedMotion | None
) -> tuple[str, ...]:
    notes = []
    if repeated is not None:
        notes.append(
            f"{repeated.share:.0%} of this motion repeats that of {repeated.name}, which the model was identified "
            "from: the comparison tests noise, not generalisation. Compare with another motion."
        )
    if noise.source == "repeated_periods":
        notes.append(
            f"The noise floor is from repeated periods: the motion comes {noise.repetitions:.1f} times, every "
            f"{noise.period:.3g} s."
        )
    else:
        notes.append(
            "The noise floor is from the high frequencies of the torque, since the motion does not come twice: slow "
            "disturbances are not in it. Record at least two periods of a motion for a better one."
        )
    fit = noise.lack_of_fit
    if fit is not None:
        wrong = [
            name
            for name, p, ratio in zip(comparison.joint_names, fit.p_value, over, strict=True)
            # Both: with very many rows a trifle is significant, and a large ratio alone may be chance.
            if p < _SURE and ratio > _MISSING
        ]
        if wrong:
            notes.append(f"More than noise is left on {', '.join(wrong)}: something is missing in the model there.")
    return tuple(notes)
