"""Find what the effects of a model leave open, by a first fit without them: shape constants and predicted loads."""

from __future__ import annotations

from collections.abc import Sequence

from dynident.effects import LINKS, EffectChoice, ReferenceParameters, get_effect
from dynident.errors import DynidentError
from dynident.estimation import estimate_reversal_weights, weighted
from dynident.identification.choices import IdentificationChoices
from dynident.identification.equations.checks import check_reduction
from dynident.identification.prior.prior import build_prior
from dynident.identification.shapes.shapes import complete_shapes, lacks_shape
from dynident.progress import Progress, scale_progress
from dynident.recordings import Preprocessing, Recording
from dynident.regressors.model import build_model
from dynident.regressors.stream import reduce_recordings
from dynident.robot.model import Robot


def prepare_effects(
    robot: Robot,
    choices: IdentificationChoices,
    recordings: Sequence[Recording],
    preprocessing: Preprocessing,
    progress: Progress,
) -> tuple[tuple[EffectChoice, ...], ReferenceParameters]:
    """Return the effects with every shape constant found, and what torque is predicted with.

    Both come from a first fit without the effects that need them.

    Parameters
    ----------
    robot : Robot
    choices : IdentificationChoices
    recordings : sequence of Recording
    preprocessing : Preprocessing
    progress : Progress

    Raises
    ------
    DynidentError
        Where such effects stand alone, or the data do not determine the first fit.
    """
    effects = choices.effects
    plain = tuple(c for c in effects if not get_effect(c.effect).needs_load and not lacks_shape(c))
    if len(plain) == len(effects):
        return effects, ReferenceParameters.massless(robot)
    if not any(choice.effect == LINKS.effect for choice in plain):
        raise DynidentError(
            "effects that depend on the load or whose shape is to be found need rigid_body beside them",
            pointer="/effects",
        )
    # The first model leaves out what it cannot know yet. Its parameters absorb part of that, which is good enough to
    # predict loads and to compare shape constants.
    first = build_model(robot, plain, tolerance=choices.tolerance)
    nothing = ReferenceParameters.massless(robot)
    reduction = reduce_recordings(
        first.observation, recordings, preprocessing, nothing, scale_progress(progress, 0.0, 0.5), by_phase=True
    )
    prior = build_prior(first, choices.trust)
    check_reduction(first, reduction, prior)
    if choices.weighs_turns:
        reduction = reduction.weight_reversals(estimate_reversal_weights(reduction, prior))
    reference = first.build_reference(weighted(reduction, prior).values)
    others = tuple(choice for choice in effects if choice not in plain)
    completed = complete_shapes(first, others, recordings, preprocessing, reference, scale_progress(progress, 0.5, 1.0))
    return plain + completed, reference
