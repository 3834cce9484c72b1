"""Gravity and constant torques identified from poses at which the robot stands: W without velocities and accelerations.

What holds a joint that stands is between both directions of its static friction, so that a single pose tells the torque
of gravity to within that band. Over many poses, or where each is approached from both sides, it averages out; what is
left is told as the band.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from dynident.arrays import FloatArray
from dynident.effects import CATALOGUE, LINKS, OFFSETS, EffectChoice, ReferenceParameters, Signals, columns_of
from dynident.errors import DynidentError
from dynident.estimation import FactorAccumulator, Reduction
from dynident.estimation.statistics import NORMAL_95
from dynident.identification.choices import IdentificationChoices
from dynident.identification.equations.data import Data
from dynident.identification.study.concluding import conclude
from dynident.identification.study.reduced_data import ReducedData
from dynident.identification.study.result import Identification
from dynident.recordings import Recording, choose_preprocessing
from dynident.recordings.poses import is_of_poses, pose_rows
from dynident.regressors.base_parameters import base_parameters
from dynident.regressors.model import Model, build_model
from dynident.robot import Robot

ACTING_AT_REST = tuple(effect.id for effect in CATALOGUE.values() if effect.acts_at_rest)
"""Effects that hold a robot which stands, and need no constant that only a motion tells."""

_MOST_STRETCHES = 100


def are_poses(recordings: Sequence[Recording], validation: Sequence[Recording]) -> bool:
    """Whether recordings are of poses.

    Raises
    ------
    DynidentError
        Where some are, and others are of motions.
    """
    everything = (*recordings, *validation)
    of_poses = [recording for recording in everything if is_of_poses(recording)]
    if of_poses and len(of_poses) < len(everything):
        raise DynidentError(
            f"{', '.join(one.name for one in of_poses)} are poses at rest, the others motions: identify gravity from "
            "poses alone, held out by poses, and the dynamics from motions",
            pointer="/measurement_ids",
            title="Poses beside motions",
        )
    return bool(of_poses)


def identify_poses(
    robot: Robot, recordings: Sequence[Recording], validation: Sequence[Recording], choices: IdentificationChoices
) -> Identification:
    """Identify what acts on a robot that stands.

    Parameters
    ----------
    robot : Robot
    recordings, validation : sequence of Recording
        Of poses; those of `validation` no parameter sees.
    choices : IdentificationChoices
        Of its effects those that act at rest are identified.

    Raises
    ------
    DynidentError
        Where none of the effects acts at rest, or the poses do not determine their parameters.
    """
    effects = tuple(choice for choice in choices.effects if choice.effect in ACTING_AT_REST)
    if not any(choice.effect == LINKS.effect for choice in effects):
        raise DynidentError(
            f"poses at rest show {', '.join(ACTING_AT_REST)}: choose {LINKS.effect} at least", pointer="/effects"
        )
    filters = choose_preprocessing(recordings)
    own = replace(
        choices, effects=effects, model="dynamic", strategy="global", preprocessing=filters, weigh_turns=False
    )
    model = model_at_rest(robot, effects, choices.tolerance)
    equations = reduce_poses(model, recordings)
    data = Data(equations, equations, tuple(recordings), filters, ReferenceParameters.nothing(robot))
    reduced = ReducedData(
        equations,
        equations,
        reduce_poses(model, validation) if validation else None,
        None,
        filters,
        tuple(recording.name for recording in recordings),
        tuple(recording.name for recording in validation),
    )
    found = conclude(model, own, data, reduced)
    return replace(found, warnings=(*_sentences(found, choices.effects), *found.warnings))


def model_at_rest(robot: Robot, effects: Sequence[EffectChoice], tolerance: float) -> Model:
    """Build the model whose base parameters are those that show while the robot stands."""
    signals = Signals(robot)
    base = base_parameters(robot, columns_of(effects, signals), signals, tolerance=tolerance, at_rest=True)
    return build_model(robot, effects, tolerance=tolerance, signals=signals, base=base)


def reduce_poses(model: Model, recordings: Sequence[Recording]) -> Reduction:
    """Fold the equations of all poses, each a stretch of its own as far as there are not too many."""
    observation = model.observation
    layout = [observation.joint_entries(joint) for joint in range(model.robot.n)]
    accumulator = FactorAccumulator([columns for _, columns in layout], observation.n_columns, np.inf)
    parts = [pose_rows(recording) for recording in recordings]
    size = -(-sum(len(t) for t, _, _ in parts) // _MOST_STRETCHES)
    for t, q, tau in parts:
        entries = entries_at_rest(model, q)
        rows = [np.column_stack([entries[:, places], tau[:, joint]]) for joint, (places, _) in enumerate(layout)]
        for first in range(0, len(t), size):
            own = slice(first, first + size)
            accumulator.push(t[own], [one[own] for one in rows])
            accumulator.end_stretch()
    return accumulator.finish()


def entries_at_rest(model: Model, q: FloatArray) -> FloatArray:
    """Entries of W (m, k) at positions (m, n), without velocity and acceleration."""
    still = np.zeros_like(q)
    memory = np.zeros((len(q), model.observation.n_memory))
    reference = ReferenceParameters.nothing(model.robot)
    return model.observation.evaluate(q, still, still, reference=reference, memory=memory)


@lru_cache(maxsize=4)
def _gravity_model(robot: Robot) -> Model:
    return model_at_rest(robot, (LINKS, OFFSETS), 2e-5)


def left_at_rest(robot: Robot, q: FloatArray, tau: FloatArray) -> float:
    """Share of the torque (m, n) at poses (m, n) in rad or m that gravity and offsets of this robot leave."""
    model = _gravity_model(robot)
    entries = entries_at_rest(model, q)
    w = np.zeros((len(q), robot.n, model.n_parameters))
    w[:, model.observation.entry_rows, model.observation.entry_columns] = entries
    # In N m: joints that carry nothing hold friction alone, of which poses tell nothing.
    rows, y = w.reshape(-1, model.n_parameters), tau.reshape(-1)
    solved = np.linalg.lstsq(rows, y, rcond=1e-9)[0]
    return float(np.linalg.norm(y - rows @ solved) / max(np.linalg.norm(y), np.finfo(float).tiny))


def _sentences(found: Identification, asked: Sequence[EffectChoice]) -> tuple[str, ...]:
    """What such data tell, and within which band friction holds the joints."""
    robot = found.model.robot
    band = NORMAL_95 * found.fit.rms
    each = ", ".join(
        f"{joint.name} ±{size:.2g} {joint.effort_unit}" for joint, size in zip(robot.joints, band, strict=True)
    )
    dropped = [choice.effect for choice in asked if choice.effect not in ACTING_AT_REST]
    left_out = f" {', '.join(dropped)} show in motion alone and are left out." if dropped else ""
    return (
        f"These are {int(found.fit.counts.max())} poses at rest: they tell the torque of gravity and constant torques, "
        f"and nothing of inertia or friction in motion.{left_out} Record a motion for the dynamics.",
        f"Static friction and noise are within a band about the model: {each} (95 % of the poses).",
    )
