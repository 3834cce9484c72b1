"""`dynident.identify` and `load_model`: models from recordings, and from files."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from dynident.api.argument_checks import check_arguments, check_is_file, require
from dynident.api.effect_arguments import check_effects, resolve_effects
from dynident.api.model import NO_RECORDINGS, Model
from dynident.api.recording_collection import Recordings, SomeRecordings, as_recordings
from dynident.effects import EffectChoice, UnknownEffectError
from dynident.errors import DynidentError
from dynident.identification import Identification, IdentificationChoices, from_bytes
from dynident.identification import identify as identify_parameters
from dynident.identification.equations.reduced_recordings import split_friction_tests
from dynident.identification.identification_choices import EstimatorName
from dynident.identification.methods.base_classes import Estimator
from dynident.progress import Progress, ignore_progress
from dynident.recordings import Filters, Preprocessing, preprocessing_from_request
from dynident.robot import Robot


@check_arguments
def identify(
    robot: Robot,
    recordings: SomeRecordings,
    *,
    validation: SomeRecordings = (),
    effects: str | EffectChoice | Iterable[str | EffectChoice] | None = None,
    estimator: EstimatorName | Estimator | None = None,
    filters: Filters | Preprocessing | None = None,
    choices: IdentificationChoices | None = None,
    progress: Progress = ignore_progress,
) -> Model:
    """Identify the base parameters of a robot.

    Parameters
    ----------
    robot : Robot
        The robot that was recorded.
    recordings : recordings
        The parameters are fitted to them.
    validation : recordings
        No parameter is fitted to them; they give the held-out errors.
    effects : texts or choices, optional
        ["default", "offset", "stribeck@joint2:vs=0.05"]; "default", which is the default, stands for links, rotors,
        Coulomb and viscous friction. `dynident effects` lists all.
    estimator : str or Estimator, optional
        How the parameters are solved for, by its name or with options of its own: see docs/methods.md.
    filters : Filters, optional
        Filters of the recordings, `dy.Filters(torque_cutoff=15.0)`; by default all of them are chosen from the data.
        `model.filters` gives those of a model, also to be used for another one. A diagnosis uses those of its model.
    choices : IdentificationChoices, optional
        All options: equation type, strategy, prior and the rest. The arguments of their own take precedence.
    progress : function, optional
        Called with the fraction done and a message.

    Returns
    -------
    Model
        The model, with its recordings.

    Raises
    ------
    DynidentError
        Where the choices do not fit each other or the robot, or the data do not determine the parameters.

    Examples
    --------
    >>> import dynident as dy
    >>> robot = dy.load_robot("scara")
    >>> runs = dy.read_recordings("run1.csv", "run2.csv", robot=robot)
    >>> model = dy.identify(robot, runs[:1], validation=runs[1:])
    >>> model.held_out.relative_total < 0.05
    True
    >>> robust = dy.identify(robot, runs[:1], effects=["default", "stribeck@elbow"], estimator="irls")
    >>> len(robust.parameters) - len(model.parameters)
    1
    """
    # Arguments of their own override the options, so that a stored set of options can be varied in one call.
    all_choices = choices or IdentificationChoices()
    if effects is not None:
        all_choices = replace(all_choices, effects=check_effects(resolve_effects(effects), robot))
    if estimator is not None:
        all_choices = replace(all_choices, estimator=estimator)
    fit_recordings, held_out = as_recordings(recordings), as_recordings(validation)
    if filters is not None:
        all_choices = replace(all_choices, preprocessing=_resolve_filters(filters, fit_recordings))
    identification = identify_parameters(robot, fit_recordings.recordings, held_out.recordings, all_choices, progress)
    return Model(identification, fit_recordings, held_out)


def _resolve_filters(filters: Filters | Preprocessing, recordings: Recordings) -> Preprocessing:
    if isinstance(filters, Preprocessing):
        return filters
    if not isinstance(filters, Filters):
        raise DynidentError(
            f"filters is {filters!r:.60}; give dy.Filters(…), such as dy.Filters(torque_cutoff=15.0) in Hz",
            pointer="filters",
            title="Impossible preprocessing",
        )
    # Tests of friction at constant velocity say nothing about the bandwidth of the motion.
    motions, _ = split_friction_tests(recordings.recordings)
    return preprocessing_from_request(filters, motions)


@check_arguments
def load_model(path: str | Path) -> Model:
    """Read a model that `Model.save` or `dynident identify --out` wrote.

    The file does not hold its recordings. `Model.with_data` adds them for methods that need them.

    Parameters
    ----------
    path : path
        An .npz file.

    Returns
    -------
    Model
        The model, with the models that led to it, and without recordings.

    Raises
    ------
    DynidentError
        Where there is no such file, or it holds no model that this version can read.

    Examples
    --------
    >>> dy.identify(robot, runs[:1]).save("model.npz")
    >>> model = dy.load_model("model.npz").with_data(runs[:1])
    >>> model.robot.name
    'scara'
    """
    path = Path(path)
    check_is_file(path, "model")
    try:
        return Model(from_bytes(path.read_bytes()), NO_RECORDINGS, NO_RECORDINGS)
    except DynidentError as error:
        # The reader sees bytes alone, so the name of the file is added here.
        own = isinstance(error, UnknownEffectError)
        hint = ". An effect of your own is registered before a model with it is read: dy.register(…)" if own else ""
        raise DynidentError(f"{path.name}: {error.detail}{hint}", pointer=str(path), title=error.title) from error


def as_model(model: Model | Identification) -> Model:
    """Return a model without data where the library's identification is given, else the model itself.

    Parameters
    ----------
    model : Model or Identification
        What a function was given as a model.

    Returns
    -------
    Model
        The same model, in the form that the methods of this package need.

    Raises
    ------
    DynidentError
        For anything else, such as the path of its file.
    """
    require(
        isinstance(model, (Model, Identification)),
        model,
        "model",
        'give one model, as identify(…) gives it or as it is read from its file: dy.load_model("model.npz")',
    )
    return model if isinstance(model, Model) else Model(model, NO_RECORDINGS, NO_RECORDINGS)
