"""Find the held-out runs in which an effect of some runs acts, such as a load that was put on after the second run.

A diagnosis names the runs of the identification data in which an effect acts. For held-out runs nobody has named them.
A model that leaves the load out there would be judged by a robot that carries one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.effects import EffectChoice, get_effect
from dynident.identification.equations.data import reduce_torque
from dynident.identification.study.gain import SURE_T, compute_block_squares, compute_t
from dynident.identification.study.result import Identification
from dynident.recordings import Recording
from dynident.regressors.extension import extend_model
from dynident.regressors.model import Model


@dataclass(frozen=True)
class RunWithEffect:
    """A held-out run in which the added effects act, and its squared error without them over that with them."""

    run: str
    ratio: float


def needs_search_in_held_out_runs(choice: EffectChoice, validation: Sequence[Recording]) -> bool:
    """Tell whether an effect acts in some runs only, and no held-out run is named among them."""
    held_out = {label for recording in validation for label in (recording.name, *recording.segment_names)}
    return bool(choice.runs) and bool(held_out) and not held_out & set(choice.runs)


def find_runs_with_effects(
    grown: Identification, base: Model, added: Sequence[EffectChoice], validation: Sequence[Recording]
) -> tuple[RunWithEffect, ...]:
    """Find the held-out runs that are predicted better with the added effects than without them, beyond chance.

    Parameters
    ----------
    grown : Identification
        Identified with the effects `added` to the model `base`, in none of the held-out runs.
    base : Model
        The model before the effects were added.
    added : sequence of EffectChoice
        The effects, with the runs of the identification data that they act in.
    validation : sequence of Recording
        Held-out recordings, whose runs are tested one by one.

    Returns
    -------
    tuple of Carrying
        Empty where no run is predicted better.
    """
    names = tuple(recording.name for recording in validation)
    everywhere = tuple(replace(choice, runs=choice.runs + names) if choice.runs else choice for choice in added)
    # Let the effect act in every held-out run at first. The parameters stay those of the fit, so that one reduction
    # of each run serves both predictions.
    model = extend_model(base, everywhere, tolerance=grown.choices.tolerance)
    if model.n_parameters != grown.model.n_parameters:
        return ()
    # The prediction without the effect: its parameters set to zero, all others as they are.
    without = np.where([bool(set(column.runs) & set(names)) for column in model.kept], 0.0, grown.values)
    findings = []
    for label, run in _iterate_runs(validation):
        data = reduce_torque(model, (run,), grown.preprocessing, grown.estimate.reference).torque
        off, on = (compute_block_squares(data, values, grown.noise) for values in (without, grown.values))
        # The gain has to stand out of its own scatter over blocks of time, or a run that was only lucky would count.
        if compute_t(off - on) >= SURE_T:
            findings.append(RunWithEffect(label, float(np.sqrt(off.sum() / on.sum()))))
    return tuple(findings)


def describe_runs_with_effects(added: Sequence[EffectChoice], findings: Sequence[RunWithEffect]) -> str:
    """Return a sentence that names the effects and the held-out runs that they were found in."""
    titles = " and ".join(dict.fromkeys(get_effect(choice.effect).title for choice in added if choice.runs))
    runs = ", ".join(f"{finding.run} (error {finding.ratio:.2g} times as large without it)" for finding in findings)
    return (
        f"{titles} shows in held-out runs as well and is taken to be there: {runs}. Name the runs yourself if you know "
        "better."
    )


def _iterate_runs(recordings: Sequence[Recording]) -> Iterator[tuple[str, Recording]]:
    """Yield every run of the recordings by itself, with its label."""
    for recording in recordings:
        for label in recording.segment_names:
            own = [item for k, item in enumerate(recording.segments) if recording.name_segment(k) == label]
            yield label, replace(recording, segments=tuple(own))
