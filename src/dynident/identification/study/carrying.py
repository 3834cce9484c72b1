"""Which of the held-out runs carry what sits in some of the runs only: a load that was put on after the second one.

A diagnosis says in which of the runs it looked at an effect is. Of held-out runs nobody has said it, and a model that
leaves the load out there is judged by a robot that carries one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.effects import EffectChoice, effect_by_id
from dynident.identification.equations.data import torque_of
from dynident.identification.study.gain import SURE, stretch_squares, t_of
from dynident.identification.study.result import Identification
from dynident.recordings import Recording
from dynident.regressors.extension import extended_model
from dynident.regressors.model import Model


@dataclass(frozen=True)
class Carrying:
    """A held-out run that shows what was added, and its squared error without it over that with it."""

    run: str
    ratio: float


def is_open(choice: EffectChoice, validation: Sequence[Recording]) -> bool:
    """Whether an effect sits in some of the runs, and nobody has said of any held-out run that it does there."""
    held_out = {label for recording in validation for label in (recording.name, *recording.run_labels)}
    return bool(choice.runs) and bool(held_out) and not held_out & set(choice.runs)


def carrying(
    grown: Identification, base: Model, added: Sequence[EffectChoice], validation: Sequence[Recording]
) -> tuple[Carrying, ...]:
    """Held-out runs that are predicted better with what was added than without it, beyond chance.

    Parameters
    ----------
    grown : Identification
        Identified with the effects `added` to the model `base`, in none of the held-out runs.
    """
    names = tuple(recording.name for recording in validation)
    everywhere = tuple(replace(choice, runs=choice.runs + names) if choice.runs else choice for choice in added)
    model = extended_model(base, everywhere, tolerance=grown.choices.tolerance)
    if model.n_parameters != grown.model.n_parameters:
        return ()
    without = np.where([bool(set(column.runs) & set(names)) for column in model.kept], 0.0, grown.values)
    found = []
    for label, run in _runs(validation):
        data = torque_of(model, (run,), grown.preprocessing, grown.estimate.reference).torque
        off, on = (stretch_squares(data, values, grown.noise) for values in (without, grown.values))
        if t_of(off - on) >= SURE:
            found.append(Carrying(label, float(np.sqrt(off.sum() / on.sum()))))
    return tuple(found)


def note_of(added: Sequence[EffectChoice], found: Sequence[Carrying]) -> str:
    """What is taken of the held-out runs, in words."""
    what = " and ".join(dict.fromkeys(effect_by_id(choice.effect).title for choice in added if choice.runs))
    runs = ", ".join(f"{one.run} (error {one.ratio:.2g} times as large without it)" for one in found)
    return (
        f"{what} shows in held-out runs as well and is taken to be there: {runs}. Name the runs yourself if you know "
        "better."
    )


def _runs(recordings: Sequence[Recording]) -> Iterator[tuple[str, Recording]]:
    for recording in recordings:
        for label in recording.run_labels:
            own = [item for k, item in enumerate(recording.segments) if recording.run_label(k) == label]
            yield label, replace(recording, segments=tuple(own))
