"""What was picked, with its shape constants refined and without what has become superfluous."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dynident.diagnosis.candidates import Candidate, Pool, width_shows
from dynident.diagnosis.products import products
from dynident.diagnosis.resolution import Resolution
from dynident.diagnosis.search import State, noise_left, pruned
from dynident.diagnosis.words import Finding
from dynident.effects import EffectChoice, columns_of, effect_by_id
from dynident.estimation import weighted
from dynident.identification import Identification
from dynident.identification.shapes import refine_shapes
from dynident.progress import Progress, part
from dynident.recordings import Preprocessing, Recording
from dynident.regressors.model import Model, build_model
from dynident.regressors.observation import Observation
from dynident.regressors.stream import reduce_recordings
from dynident.robot.model import FloatArray


def refined(
    identification: Identification,
    picks: Sequence[Finding],
    recordings: Sequence[Recording],
    reference: FloatArray,
    resolved: Resolution,
    progress: Progress,
) -> tuple[tuple[Finding, ...], tuple[EffectChoice, ...]]:
    """The picks with their shape constants refined, without those that only made up for another's coarse shape.

    A peak of friction whose best width is below what the data resolve made up for sticking, not for Stribeck friction.
    """
    kept = tuple(picks)
    choices = tuple(finding.judged.candidate.choice for finding in kept)
    if not choices:
        return (), ()
    model, preprocessing = identification.model, identification.preprocessing
    choices = refine_shapes(model, choices, recordings, preprocessing, reference, part(progress, 0.0, 0.5))
    visible = [i for i, choice in enumerate(choices) if width_shows(choice, model.robot, resolved)]
    kept, choices = tuple(kept[i] for i in visible), tuple(choices[i] for i in visible)
    while len(kept) > 1:
        reference = _improved(model, choices, recordings, preprocessing, reference)
        needed = _needed(model, kept, choices, recordings, preprocessing, reference)
        if len(needed) == len(kept):
            break
        kept, choices = tuple(kept[i] for i in needed), tuple(choices[i] for i in needed)
        choices = refine_shapes(model, choices, recordings, preprocessing, reference)
    lasting = _lasting(model, choices)
    return tuple(kept[i] for i in lasting), tuple(choices[i] for i in lasting)


def _improved(
    model: Model,
    choices: Sequence[EffectChoice],
    recordings: Sequence[Recording],
    preprocessing: Preprocessing,
    reference: FloatArray,
) -> FloatArray:
    """What torque is predicted with (14 n,) once the effects are in the model: without them it was biased by them."""
    if not any(effect_by_id(choice.effect).needs_load for choice in choices):
        return reference
    grown = build_model(model.robot, (*model.effects, *choices), signals=model.signals)
    reduction = reduce_recordings(grown.observation, recordings, preprocessing, reference)
    return grown.reference(weighted(reduction).values)


def _lasting(model: Model, choices: tuple[EffectChoice, ...]) -> list[int]:
    """Indices of the choices of which at least one column is independent of the model and of those before it."""
    if not choices:
        return []
    grown = build_model(model.robot, model.effects + choices, signals=model.signals)
    independent = {column.key for column in grown.kept}
    return [
        i
        for i, choice in enumerate(choices)
        if any(column.key in independent for column in columns_of([choice], model.signals))
    ]


def _needed(
    model: Model,
    picks: Sequence[Finding],
    choices: Sequence[EffectChoice],
    recordings: Sequence[Recording],
    preprocessing: Preprocessing,
    reference: FloatArray,
) -> list[int]:
    """Indices of the picks that still improve the prediction beside the others, with the shapes of `choices`."""
    columns = list(model.kept)
    refined: list[Finding] = []
    for finding, choice in zip(picks, choices, strict=True):
        made = columns_of([choice], model.signals)
        numbers = tuple(range(len(columns), len(columns) + len(made)))
        candidate = Candidate(choice.effect, choice.joints, choice.shape, numbers, choice.runs)
        refined.append(replace(finding, judged=replace(finding.judged, candidate=candidate)))
        columns += made
    observation = Observation.of(model.robot, columns, model.signals)
    pool = Pool(observation, model.n_parameters, tuple(finding.judged.candidate for finding in refined))
    data = products(reduce_recordings(observation, recordings, preprocessing, reference))
    everything = tuple(range(len(columns)))
    still = pruned(data, pool, State(everything, noise_left(data, everything), np.zeros(data.n_joints), tuple(refined)))
    return [i for i, finding in enumerate(refined) if any(finding is other for other in still)]
