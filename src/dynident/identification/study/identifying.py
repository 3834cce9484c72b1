"""From recordings to an identified model: everything that the choices leave open is found, then it is solved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dynident.identification.choices import IdentificationChoices
from dynident.identification.equations.checks import check_recordings, check_runs, check_temperature
from dynident.identification.equations.data import motions_and_friction
from dynident.identification.equations.model_equations import with_constants
from dynident.identification.shapes.shapes import check_shapes_given
from dynident.identification.study.fitting import identify_model
from dynident.identification.study.preparing import prepared
from dynident.identification.study.result import Identification
from dynident.progress import Progress, part, silent
from dynident.recordings import Recording, choose_preprocessing
from dynident.recordings.sample_hashes import copied_recordings
from dynident.regressors.model import build_model
from dynident.robot.model import Robot
from dynident.threads import single_threaded


@single_threaded
def identify(
    robot: Robot,
    recordings: Sequence[Recording],
    validation: Sequence[Recording] = (),
    choices: IdentificationChoices | None = None,
    progress: Progress = silent,
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

    Raises
    ------
    DynidentError
        Where the choices do not fit the robot or the data do not determine the parameters.
    """
    choices = choices or IdentificationChoices()
    check_recordings(robot, recordings, validation)
    check_temperature(choices.effects, recordings, validation)
    check_runs(choices.effects, recordings, validation)
    ordinary, _ = motions_and_friction(recordings)
    preprocessing = choices.preprocessing or choose_preprocessing(ordinary)
    rows, preprocessing = with_constants(choices.rows_asked, ordinary, preprocessing)
    check_shapes_given(choices.effects)
    effects, reference = prepared(robot, choices, ordinary, preprocessing, part(progress, 0.0, 0.5))
    choices = replace(choices, effects=effects, pole=rows.pole, interval=rows.interval)
    model = build_model(robot, choices.effects, tolerance=choices.tolerance)
    told = part(progress, 0.5, 1.0)
    found = identify_model(model, recordings, validation, choices, preprocessing, reference, told)
    return replace(found, data=replace(found.data, copied=copied_recordings(recordings, validation)))
