"""Check the types of arguments of the notebook functions by their names: what `robot`, `runs`, `model`, … may be."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Container, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import wraps
from numbers import Integral, Real
from pathlib import Path
from types import FunctionType
from typing import Any, ParamSpec, TypeVar

from dynident.advice.campaign_request import CampaignRequest
from dynident.errors import DynidentError, KnownNames, check_names, describe_value
from dynident.excitation import DesignRequest
from dynident.identification import IdentificationChoices
from dynident.identification.methods.base_classes import Estimator
from dynident.recordings import RecordingMetadata
from dynident.robot import Drive, Limits, Robot
from dynident.robot.description_formats import BASE_JOINTS

_TITLE = "Unusable argument"
Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Expectation:
    """What an argument has to be.

    Parameters
    ----------
    admits : function
        Whether a value is one.
    remedy : str
        What to give instead, for the message.
    """

    admits: Callable[[object], bool]
    remedy: str


def _is_a(*kinds: type) -> Callable[[object], bool]:
    return lambda value: isinstance(value, kinds)


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def _maps_to(*kinds: type) -> Callable[[object], bool]:
    return lambda value: isinstance(value, Mapping) and all(isinstance(item, kinds) for item in value.values())


def _is_one_number_a_joint(value: object) -> bool:
    if isinstance(value, Mapping):
        return all(map(_is_number, value.values()))
    return isinstance(value, Iterable) and not isinstance(value, str) and all(map(_is_number, value))


def _is_vector(value: object) -> bool:
    items = list(value) if isinstance(value, Iterable) and not isinstance(value, (str, Mapping)) else []
    return len(items) == 3 and all(map(_is_number, items))


def _are_windows(value: object) -> bool:
    pairs = list(value) if isinstance(value, Iterable) and not isinstance(value, (str, Mapping)) else [None]
    return all(isinstance(pair, (tuple, list)) and len(pair) == 2 and all(map(_is_number, pair)) for pair in pairs)


def _holds_recordings(value: object) -> bool:
    # A data frame with times is a recording; one of positions alone is an array.
    names = getattr(value, "columns", None) if hasattr(value, "__arrow_c_stream__") else None
    return hasattr(value, "recording") or hasattr(value, "recordings") or (names is not None and "t" in list(names))


_TEXTS_BY_NAME = "give a dictionary of texts, such as"
_SIMULATED = Expectation(lambda value: hasattr(value, "feed_forward"), "give dynident.simulation.Simulated(…)")
EXPECTED: Mapping[str, Expectation] = {
    "robot": Expectation(_is_a(Robot), 'read the robot first: robot = dy.load_robot("arm.urdf")'),
    "design.robot": Expectation(
        lambda value: isinstance(value, Robot) or hasattr(value, "identification"),
        'give a robot, dy.load_robot("arm.urdf"), or a model of it',
    ),
    "source": Expectation(_is_a(str, Path), 'give the path of a file, or the name of a well-known arm such as "ur10"'),
    "path": Expectation(_is_a(str, Path, tuple), "give the path of a file"),
    "inspect.path": Expectation(
        lambda value: isinstance(value, (str, Path, tuple, Mapping)) or hasattr(value, "__arrow_c_stream__"),
        "give the path of a file, a data frame, or a dictionary of arrays by name",
    ),
    "name": Expectation(_is_a(str), "give a text"),
    "title": Expectation(_is_a(str), "give a text"),
    "ModelResults.predict.q": Expectation(
        lambda value: not _holds_recordings(value),
        "give arrays q, dq and ddq; for recordings, dy.compare(model, recordings).to_frame() has measured and "
        "predicted torque, and dy.read_recordings(frame, robot=robot) makes recordings of a data frame",
    ),
    "progress": Expectation(callable, "give a function of the fraction done and a message"),
    "choices": Expectation(_is_a(IdentificationChoices), 'give dy.IdentificationChoices(model="energy", …)'),
    "estimator": Expectation(_is_a(str, Estimator), 'give its name, such as "wls", or an estimator with its options'),
    "metadata": Expectation(_is_a(RecordingMetadata), 'give dy.RecordingMetadata(role="friction", …)'),
    "columns": Expectation(_maps_to(str), f'{_TEXTS_BY_NAME} {{"q1": "shoulder_angle"}}'),
    "units": Expectation(_maps_to(str), f'{_TEXTS_BY_NAME} {{"q": "deg"}}'),
    "windows": Expectation(_are_windows, "give pairs (from, to) in s, such as [(3.5, 28)]"),
    "cure": Expectation(_is_a(bool), "give True or False"),
    "rate": Expectation(_is_number, "give a rate in Hz"),
    "limits": Expectation(_maps_to(Limits), 'give limits by joint: {"elbow": dy.Limits(velocity=1.5)}'),
    "drives": Expectation(_maps_to(Drive), 'give drives by joint: {"elbow": dy.Drive(14.9)}'),
    "drive_gains": Expectation(
        _is_one_number_a_joint, 'give one number a joint, [14.9, 13.3, …], or numbers by joint, {"elbow": 14.9}'
    ),
    "locked_joints": Expectation(
        lambda value: isinstance(value, Mapping) and _is_one_number_a_joint(value),
        'give positions by joint: {"finger": 0.0}',
    ),
    "gravity": Expectation(_is_vector, "give its three components in m/s²: (0, 0, -9.81)"),
    "base": Expectation(lambda value: value in BASE_JOINTS, 'give "fixed", "floating" or "planar"'),
    "contacts": Expectation(_is_a(list, tuple), 'give names of links, ["left_foot", "right_foot"]'),
    "max_effects": Expectation(
        lambda value: isinstance(value, Integral) and not isinstance(value, bool), "give a whole number"
    ),
    "limit": Expectation(lambda value: _is_number(value) and not value > 1, "give a fraction: 0.05 for 5 %"),  # type: ignore[operator]
    "seed": Expectation(_is_a(Integral), "give a whole number"),
    "kind": Expectation(_is_a(str), 'give its name, such as "random"'),
    "duration": Expectation(_is_number, "give a number of seconds"),
    "sampling_rate": Expectation(_is_number, "give a rate in Hz"),
    "request": Expectation(
        lambda value: isinstance(value, DesignRequest) or hasattr(value, "next_experiment"),
        'give dy.DesignRequest(…) or a diagnosis; kinds of motions go by name: kind="random"',
    ),
    "DesignedMotion.simulate.request": _SIMULATED,
    "ModelResults.true_params.request": _SIMULATED,
    "Campaign.__init__.request": Expectation(_is_a(CampaignRequest), "give dy.CampaignRequest(error=0.03)"),
    "error": Expectation(_is_number, "give a fraction: 0.05 for 5 %"),
    "minutes": Expectation(_is_number, "give a number of minutes"),
    "days": Expectation(
        lambda value: isinstance(value, Iterable) and not isinstance(value, str),
        'give recordings by day: {"monday": runs}',
    ),
}
"""What the arguments of the front door have to be, by their names, or by function and name where one function
differs; others are checked where they are used."""


def check_arguments(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Make a function check its arguments by `EXPECTED` before it does anything.

    Parameters
    ----------
    function : function
        A function of this package whose arguments have names of `EXPECTED`.

    Returns
    -------
    function
        The same, which raises a `DynidentError` for an argument of another kind. Defaults are not checked.
    """
    signature = inspect.signature(function)
    defaults = {name: parameter.default for name, parameter in signature.parameters.items()}

    @wraps(function)
    def call_with_checks(*args: Parameters.args, **kwargs: Parameters.kwargs) -> Result:
        try:
            given = signature.bind(*args, **kwargs).arguments
        except TypeError:
            owner = function.__qualname__.removesuffix(".__init__").split(".")[-1]
            _check_for_fields(owner, kwargs, signature.parameters)
            _check_for_other_names(owner, kwargs, signature.parameters)
            # What takes recordings or frames elsewhere is often given alone.
            with suppress(TypeError):  # more of them than there are places
                _check_given(function.__qualname__, signature.bind_partial(*args).arguments, defaults)
            check_names(owner, kwargs, signature.parameters)
            # Python's own message about missing arguments is better than that of `bind`.
            return function(*args, **kwargs)
        _check_given(function.__qualname__, given, defaults)
        return function(*args, **kwargs)

    return call_with_checks


def _check_given(function: str, given: Mapping[str, object], defaults: Mapping[str, object]) -> None:
    for name, value in given.items():
        expected = EXPECTED.get(f"{function}.{name}") or EXPECTED.get(name)
        if expected is not None and value is not defaults[name]:
            require(expected.admits(value), value, name, expected.remedy)


def _check_for_other_names(owner: str, given: Iterable[str], known: Container[str]) -> None:
    """Tell what stands for an argument that others call so."""
    for name in given:
        remedy = OTHER_ARGUMENTS.get(f"{owner}.{name}")
        if name not in known and remedy is not None:
            raise DynidentError(f"{owner} takes no argument {name!r}; {remedy}", pointer=name, title="Unknown argument")


def _check_for_fields(owner: str, given: Iterable[str], known: Container[str]) -> None:
    """Tell where a name belongs that is no argument, but a field of one."""
    requests = (("choices", IdentificationChoices), ("request", DesignRequest), ("metadata", RecordingMetadata))
    for name in given:
        for argument, kind in requests:
            if name not in known and argument in known and name in kind.__dataclass_fields__:
                raise DynidentError(
                    f"{owner} takes {name} as a field of {argument}: {argument}=dy.{kind.__name__}({name}=…)",
                    pointer=name,
                    title="Unknown argument",
                )


_KNOWN = 'parameters that are known go into choices=dy.IdentificationChoices(known={"Ia3": 0.2})'
_WEIGHTS = (
    "rows count by the noise of their joint; leave seconds out with dy.revise(run, windows=[…]), or let "
    'estimator="irls" find outliers'
)
OTHER_ARGUMENTS: Mapping[str, str] = {
    "conf_int.alpha": "give the probability of the interval: conf_int(0.99) for alpha=0.01",
    "identify.fixed": _KNOWN,
    "identify.fix": _KNOWN,
    "identify.fix_params": _KNOWN,
    "identify.weights": _WEIGHTS,
    "identify.sample_weight": _WEIGHTS,
    "identify.joints": 'effects name their joints, effects=["rigid_body", "coulomb@elbow"]; a joint that does not move '
    'is locked: dy.load_robot(…, locked_joints={"wrist": 0.0})',
    "read_recordings.mask": "give the seconds to use: windows=[(3.5, 28)]",
    "plot.ax": "draw on axes of your own by plot().draw(axes)",
    "export.payload": 'a load is an effect, model.extend("payload") from a run with it; C headers take one later',
}
"""What stands for arguments that people look for by other names, by function."""


class CheckedResult(KnownNames):
    """Base of this package's results: their public methods check their arguments."""

    def __init_subclass__(cls, **options: Any) -> None:
        """Make the public methods of a result check their arguments."""
        super().__init_subclass__(**options)
        for name, member in list(vars(cls).items()):
            if isinstance(member, FunctionType) and not name.startswith("_"):
                setattr(cls, name, check_arguments(member))


def require(holds: bool, value: object, name: str, remedy: str) -> None:
    """Raise an error about an argument unless a condition holds.

    Parameters
    ----------
    holds : bool
        Whether the argument can be used.
    value : object
        What was given.
    name : str
        Name of the argument.
    remedy : str
        What to give instead.

    Raises
    ------
    DynidentError
        Where it does not hold: names the argument, what it is, and what to give.
    """
    if not holds:
        raise DynidentError(f"{name} is {describe_value(value)}; {remedy}", pointer=name, title=_TITLE)


def check_is_file(path: Path, name: str) -> None:
    """Check that there is a file.

    Parameters
    ----------
    path : Path
        Its path.
    name : str
        What the file holds, such as "model", for the message.

    Raises
    ------
    DynidentError
        Where there is none, or a folder instead.
    """
    if path.is_dir():
        raise DynidentError(
            f"{path} is a folder; give the file of a {name} in it", pointer=str(path), title="No such file"
        )
    if not path.is_file():
        raise DynidentError(f"there is no file {path}", pointer=str(path), title="No such file")
