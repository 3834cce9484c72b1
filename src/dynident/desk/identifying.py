"""Models from recordings, and from files."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from dynident.desk.choosing import checked_effects, named_effects
from dynident.desk.model import NO_DATA, Model
from dynident.desk.recordings import SomeRecordings, as_recordings
from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.identification import Identification, IdentificationChoices, from_bytes
from dynident.identification import identify as identify_parameters
from dynident.identification.choices import EstimatorName
from dynident.identification.methods.bases import Estimator
from dynident.progress import Progress, silent
from dynident.robot import Robot


def identify(
    robot: Robot,
    recordings: SomeRecordings,
    *,
    validation: SomeRecordings = (),
    effects: str | EffectChoice | Iterable[str | EffectChoice] | None = None,
    estimator: EstimatorName | Estimator | None = None,
    choices: IdentificationChoices | None = None,
    progress: Progress = silent,
) -> Model:
    """Identify the base parameters of a robot.

    Parameters
    ----------
    robot : Robot
    recordings : recordings
        What the parameters are fitted to.
    validation : recordings
        What no parameter sees; the held-out errors come from them.
    effects : texts or choices, optional
        ["default", "offset", "stribeck@joint2:vs=0.05"]; "default" stands for links, rotors, Coulomb and viscous
        friction, which are taken where nothing is said. `dynident effects` lists all.
    estimator : str or Estimator, optional
        How the parameters are solved for, by its name or with options of its own: see docs/methods.md.
    choices : IdentificationChoices, optional
        Everything that can be chosen: model, strategy, prior, filters and the rest. What is said beside it wins.

    Raises
    ------
    DynidentError
        Where the choices do not fit each other or the robot, or the data do not determine the parameters.
    """
    wanted = choices or IdentificationChoices()
    if effects is not None:
        wanted = replace(wanted, effects=checked_effects(named_effects(effects), robot))
    if estimator is not None:
        wanted = replace(wanted, estimator=estimator)
    learnt, tried = as_recordings(recordings), as_recordings(validation)
    found = identify_parameters(robot, learnt.recordings, tried.recordings, wanted, progress)
    return Model(found, learnt, tried)


def load_model(path: str | Path) -> Model:
    """Read a model that `Model.save` or `dynident identify --out` wrote.

    Its recordings are not in the file: `Model.with_data` gives them back, for what needs them.

    Raises
    ------
    DynidentError
        Where there is no such file, or it holds no model that this version can read.
    """
    path = Path(path)
    if not path.is_file():
        raise DynidentError(f"there is no file {path}", pointer=str(path), title="No such file")
    try:
        return Model(from_bytes(path.read_bytes()), NO_DATA, NO_DATA)
    except DynidentError as error:
        raise DynidentError(f"{path.name}: {error.detail}", pointer=str(path), title=error.title) from error


def as_model(given: Model | Identification) -> Model:
    """The model, or the library's identification as one."""
    return given if isinstance(given, Model) else Model(given, NO_DATA, NO_DATA)
