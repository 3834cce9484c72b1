"""Identify gravity and constant torques from poses at rest, with static friction as an interval; refuse mixed data.

The torque that holds a standing joint lies anywhere between both directions of its static friction. So a single pose
tells the torque of gravity only to within that band. Over many poses, or where each is approached from both sides, it
averages out. The residual that remains is reported as the band.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import CATALOGUE, LINKS, OFFSETS, EffectChoice, ReferenceParameters, Signals, build_columns
from dynident.errors import DynidentError
from dynident.estimation import FactorAccumulator, Reduction
from dynident.estimation.parameter_covariance import NORMAL_95
from dynident.identification.description_prior import check_known
from dynident.identification.equations.reduced_recordings import Data, ReducedData
from dynident.identification.identification_choices import IdentificationChoices
from dynident.identification.identified_models.fit_model import finalise_identification
from dynident.identification.identified_models.identification_result import Identification
from dynident.parallel import defer
from dynident.recordings import Recording, choose_preprocessing
from dynident.recordings.pose_recordings import has_poses, read_pose_rows
from dynident.regressors.base_parameters import find_base_parameters
from dynident.regressors.model_structure import Model, build_model
from dynident.robot import Robot

ACTING_AT_REST = tuple(effect.id for effect in CATALOGUE.values() if effect.acts_at_rest)
"""Effects that hold a robot which stands, and need no constant that only a motion tells."""

# Blocks of the covariance: more of them make the factors large, and the covariance no better.
_MOST_BLOCKS = 100


def are_poses(recordings: Sequence[Recording], validation: Sequence[Recording]) -> bool:
    """Tell whether recordings are of poses.

    Parameters
    ----------
    recordings, validation : sequence of Recording
        Data of the fit, and held-out data.

    Raises
    ------
    DynidentError
        Where some are of poses, and others of motions.
    """
    everything = (*recordings, *validation)
    of_poses = [recording for recording in everything if has_poses(recording)]
    names = ", ".join(recording.name for recording in of_poses)
    # Rows at rest and rows of motion have other columns and other noise: they do not go into one fit.
    if of_poses and len(of_poses) < len(everything):
        raise DynidentError(
            f"{names} are poses at rest, the other recordings are motions: identify gravity only from poses, with "
            "held-out poses, and the dynamics from motions",
            pointer="/recordings",
            title="Poses together with motions",
        )
    return bool(of_poses)


def identify_poses(
    robot: Robot, recordings: Sequence[Recording], validation: Sequence[Recording], choices: IdentificationChoices
) -> Identification:
    """Identify what acts on a robot that stands.

    Parameters
    ----------
    robot : Robot
        The robot.
    recordings, validation : sequence of Recording
        Of poses; those of `validation` no parameter sees.
    choices : IdentificationChoices
        Of its effects those that act at rest are identified.

    Returns
    -------
    Identification
        Its warnings say which effects were left out, and how wide the band of static friction is.

    Raises
    ------
    DynidentError
        Where none of the effects acts at rest, or the poses do not determine their parameters.
    """
    effects = tuple(choice for choice in choices.effects if choice.effect in ACTING_AT_REST)
    # Without gravity of the links nothing else at rest has a meaning.
    if not any(choice.effect == LINKS.effect for choice in effects):
        raise DynidentError(
            f"poses at rest show {', '.join(ACTING_AT_REST)}: choose at least {LINKS.effect}", pointer="/effects"
        )
    # Nothing is filtered at rest; the filters are stored so that the file has the form of every other model.
    filters = choose_preprocessing(recordings)
    own = replace(
        choices, effects=effects, model="dynamic", strategy="global", preprocessing=filters, weigh_turns=False
    )
    model = build_model_at_rest(robot, effects, choices.tolerance)
    check_known(model, choices.known)
    equations = reduce_poses(model, recordings)
    data = Data(equations, equations, tuple(recordings), filters, ReferenceParameters.massless(robot))
    reduced = ReducedData(
        equations,
        equations,
        reduce_poses(model, validation) if validation else None,
        None,
        filters,
        tuple(recording.name for recording in recordings),
        tuple(recording.name for recording in validation),
        from_commands=any(recording.torque_from_commands for recording in (*recordings, *validation)),
    )
    identified = finalise_identification(model, own, data, reduced)
    warnings = defer(lambda: (*_describe_poses(identified, choices.effects), *identified.warnings))
    return identified.with_changes(warnings=warnings)


def build_model_at_rest(robot: Robot, effects: Sequence[EffectChoice], tolerance: float) -> Model:
    """Build the model whose base parameters are those that show while the robot stands.

    Parameters
    ----------
    robot : Robot
        The robot.
    effects : sequence of EffectChoice
        Such as act at rest.
    tolerance : float
        Which columns count as dependent.
    """
    signals = Signals(robot)
    # At rest fewer parameters are told apart than in motion: no moment of inertia shows.
    base = find_base_parameters(robot, build_columns(effects, signals), signals, tolerance=tolerance, at_rest=True)
    return build_model(robot, effects, tolerance=tolerance, signals=signals, base=base)


def reduce_poses(model: Model, recordings: Sequence[Recording]) -> Reduction:
    """Reduce the equations of all poses to factors, each pose a block of its own unless there are too many.

    Parameters
    ----------
    model : Model
        Of a robot at rest.
    recordings : sequence of Recording
        Of poses.
    """
    observation = model.observation
    layout = [observation.joint_entries(joint) for joint in range(model.robot.n)]
    accumulator = FactorAccumulator([columns for _, columns in layout], observation.n_columns, np.inf)
    parts = [read_pose_rows(recording) for recording in recordings]
    # Poses have no time between them, so a pose is a block of the covariance. Several share one where there are more
    # than a hundred, which bounds the size of the factors.
    size = -(-sum(len(t) for t, _, _ in parts) // _MOST_BLOCKS)
    for t, q, tau in parts:
        entries = evaluate_at_rest(model, q)
        rows = [np.column_stack([entries[:, places], tau[:, joint]]) for joint, (places, _) in enumerate(layout)]
        for first in range(0, len(t), size):
            own = slice(first, first + size)
            accumulator.push(t[own], [equation[own] for equation in rows])
            accumulator.end_block()
    return accumulator.finish()


def evaluate_at_rest(model: Model, q: FloatArray) -> FloatArray:
    """Return the entries of W (m, k) at positions (m, n), without velocity and acceleration.

    Parameters
    ----------
    model : Model
        The model of a robot at rest.
    q : (m, n)
        Positions in rad or m.
    """
    still = np.zeros_like(q)
    memory = np.zeros((len(q), model.observation.n_memory))
    reference = ReferenceParameters.massless(model.robot)
    return model.observation.evaluate(q, still, still, reference=reference, memory=memory)


@lru_cache(maxsize=4)
def _build_gravity_model(robot: Robot) -> Model:
    return build_model_at_rest(robot, (LINKS, OFFSETS), 2e-5)


def measure_unexplained_at_rest(robot: Robot, q: FloatArray, tau: FloatArray) -> float:
    """Return the share of the torque that gravity and offsets of this robot leave at poses.

    Parameters
    ----------
    robot : Robot
        The robot.
    q, tau : (m, n)
        Positions in rad or m, and torques.

    Returns
    -------
    float
        Norm of the residual over that of the torque.
    """
    model = _build_gravity_model(robot)
    entries = evaluate_at_rest(model, q)
    w = np.zeros((len(q), robot.n, model.n_parameters))
    w[:, model.observation.entry_rows, model.observation.entry_columns] = entries
    # In N m: joints that carry nothing hold friction alone, of which poses tell nothing.
    rows, y = w.reshape(-1, model.n_parameters), tau.reshape(-1)
    solved = np.linalg.lstsq(rows, y, rcond=1e-9)[0]
    return float(np.linalg.norm(y - rows @ solved) / max(np.linalg.norm(y), np.finfo(float).tiny))


def _describe_poses(identified: Identification, requested: Sequence[EffectChoice]) -> tuple[str, ...]:
    """Describe what such data tell, and the band within which friction holds the joints."""
    robot = identified.model.robot
    # The residual of poses is mostly static friction, so its size is that band.
    band = NORMAL_95 * identified.fit.rms
    each = ", ".join(
        f"{joint.name} ±{size:.2g} {joint.effort_unit}" for joint, size in zip(robot.joints, band, strict=True)
    )
    dropped = [choice.effect for choice in requested if choice.effect not in ACTING_AT_REST]
    left_out = f" {', '.join(dropped)} act only in motion and are left out." if dropped else ""
    return (
        f"These are {int(identified.fit.counts.max())} poses at rest: they show gravity and constant torques, but no "
        f"inertia and no friction in motion.{left_out} Record a motion for the dynamics.",
        f"Static friction and noise are within a band around the model: {each} (95 % of the poses).",
    )
