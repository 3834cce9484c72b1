"""Identify a model from recordings: find what the choices leave open, then solve."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dynident.identification.choices import IdentificationChoices
from dynident.identification.equations.checks import (
    check_joint_torques,
    check_recordings,
    check_runs,
    check_temperature,
)
from dynident.identification.equations.data import split_friction_tests
from dynident.identification.equations.model_equations import find_constants
from dynident.identification.shapes.shapes import check_shapes_given
from dynident.identification.study.explained_band import find_narrower_band
from dynident.identification.study.fitting import identify_model
from dynident.identification.study.poses import are_poses, identify_poses
from dynident.identification.study.preparing import prepare_effects
from dynident.identification.study.result import Identification
from dynident.identification.study.same_recordings import add_digests
from dynident.progress import Progress, ignore_progress, make_monotonic, scale_progress
from dynident.recordings import Recording, choose_preprocessing
from dynident.regressors.model import build_model
from dynident.robot.model import Robot
from dynident.threads import single_threaded


def mark_unrecorded_torques(robot: Robot, recordings: Sequence[Recording]) -> Robot:
    """Return the robot with the joints marked for which no recording has the torque.

    Parameters
    ----------
    robot : Robot
    recordings : sequence of Recording
    """
    recorded = np.any([recording.has_torque for recording in recordings], axis=0)
    names = tuple(name for name, known in zip(robot.joint_names, recorded, strict=True) if not known)
    return replace(robot, joints_without_torque=names) if names != robot.joints_without_torque else robot


@single_threaded
def identify(
    robot: Robot,
    recordings: Sequence[Recording],
    validation: Sequence[Recording] = (),
    choices: IdentificationChoices | None = None,
    progress: Progress = ignore_progress,
) -> Identification:
    """Identify the base parameters of a robot from recordings.

    Parameters
    ----------
    robot : Robot
    recordings : sequence of Recording
        The data that parameters are fitted to; those with the role "friction" are tests of single joints, which the
        strategy separate_friction alone uses.
    validation : sequence of Recording
        Data that no parameter sees; the held-out errors come from them.
    choices : IdentificationChoices, optional
    progress : Progress

    Returns
    -------
    Identification

    Raises
    ------
    DynidentError
        Where the choices do not fit the robot or the data do not determine the parameters.
    """
    progress = make_monotonic(progress)  # a narrower band is identified in once more
    requested = choices = choices or IdentificationChoices()
    check_recordings(robot, recordings, validation)
    if are_poses(recordings, validation):
        return identify_poses(robot, recordings, validation, requested)
    check_temperature(choices.effects, recordings, validation)
    check_runs(choices.effects, recordings, validation)
    ordinary, _ = split_friction_tests(recordings)
    check_joint_torques(choices.model, ordinary)
    robot = mark_unrecorded_torques(robot, ordinary)
    preprocessing = choices.preprocessing or choose_preprocessing(ordinary)
    rows, preprocessing = find_constants(choices.row_options, ordinary, preprocessing)
    check_shapes_given(choices.effects)
    effects, reference = prepare_effects(robot, choices, ordinary, preprocessing, scale_progress(progress, 0.0, 0.5))
    choices = replace(choices, effects=effects, pole=rows.pole, interval=rows.interval)
    model = build_model(robot, choices.effects, tolerance=choices.tolerance)
    fit_progress = scale_progress(progress, 0.5, 1.0)
    identified = identify_model(model, recordings, validation, choices, preprocessing, reference, fit_progress)
    # Whether the filters let in torque that no rigid model explains shows only after a fit. Filters that the user
    # gave are not changed.
    narrow = None if requested.preprocessing else find_narrower_band(identified, ordinary)
    if narrow is not None:
        band, why = narrow
        identified = identify(robot, recordings, validation, replace(requested, preprocessing=band), progress)
        return replace(identified, warnings=(why, *identified.warnings))
    return add_digests(identified, recordings, validation)
