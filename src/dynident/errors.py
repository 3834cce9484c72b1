"""`DynidentError`: errors that users can remove, with place and remedies; notes, misspelt names, types; `Cancelled`."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from numbers import Integral, Real
from os import PathLike, fspath
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Any, Union, get_args, get_origin

_LONGEST = 60


@dataclass(frozen=True)
class Remedy:
    """A field of a request with a value that would put right what is wrong.

    Its text, which a sentence quotes, is JSON as over HTTP: `"units": {"q": "deg"}`. Command line and Python write it
    in their own syntax (`word_remedies`).

    Parameters
    ----------
    field : str
        Name of a field of the recording's metadata or of the robot.
    value : object
        The value, of the types of JSON; `...` where only the user can know it.
    """

    field: str
    value: object = ...

    def __str__(self) -> str:
        return f'"{self.field}": {_write_json(self.value)}'

    def for_recording(self, name: str) -> Remedy:
        """Return the remedy for one recording alone, as metadata of its own.

        Parameters
        ----------
        name : str
            Name of the recording.
        """
        return Remedy("metadata", {name: {self.field: self.value}})


def word_remedies(text: str, remedies: Iterable[Remedy], write: Callable[[Remedy], str]) -> str:
    """Return a sentence with its remedies in another syntax.

    Parameters
    ----------
    text : str
        The sentence, which quotes the remedies.
    remedies : iterable of Remedy
        Those of the check or the error.
    write : function
        Returns a remedy as it is written there.
    """
    # What another front end of this syntax has worded stays as it is.
    written = {form: write(remedy) for remedy in remedies for form in (str(remedy), write(remedy))}
    # The longest form comes first, as the text of one remedy may begin that of another.
    forms = sorted(written, key=len, reverse=True)
    return re.sub("|".join(map(re.escape, forms)), lambda form: written[form[0]], text) if forms else text


_OTHER_ARGUMENTS = {
    "drives": "drive_gains",
    "cure": "cure=True",
    "meshes": "surroundings=dy.Surroundings(mesh_folders=[…])",
    "assume_floor": "surroundings=dy.Surroundings(assume_floor=False)",
    "contacts": "set_base(robot, contacts=[…])",
    "identification_id": "design(model, …)",
}
"""Arguments that are called otherwise than the field of a remedy."""


def write_argument(remedy: Remedy) -> str:
    """Return a remedy as an argument of this package's functions; other front ends write it in their own syntax."""
    if remedy.field == "metadata" and isinstance(remedy.value, Mapping):
        ((name, own),) = remedy.value.items()
        return f"{', '.join(write_argument(Remedy(*item)) for item in own.items())} for {name} alone"
    text = str(remedy).partition(": ")[2]
    if isinstance(remedy.value, tuple):
        text = f"({text[1:-1]},)" if len(remedy.value) == 1 else f"({text[1:-1]})"
    if remedy.field in ("columns", "units", "windows"):
        return f"{remedy.field}={text}"
    if remedy.field in ("locked_joints", "gravity"):
        return f"load_robot(…, {remedy.field}={text})"
    if remedy.field in _OTHER_ARGUMENTS:
        return _OTHER_ARGUMENTS[remedy.field]
    return f"metadata=dy.RecordingMetadata({remedy.field}={text})"


class Note(str):
    """A sentence for the user, with the remedies that it quotes.

    Parameters
    ----------
    text : str
        The sentence.
    remedies : tuple of Remedy
        Those that it quotes.
    code : str
        What was not checked, where that has to be known before a robot moves; empty otherwise.
    """

    remedies: tuple[Remedy, ...]
    code: str

    def __new__(cls, text: str, remedies: tuple[Remedy, ...] = (), code: str = "") -> Note:
        """Make the sentence, which is a text like any other."""
        note = super().__new__(cls, text)
        note.remedies, note.code = remedies, code
        return note


def word_notes(notes: Iterable[str], write: Callable[[Remedy], str]) -> list[str]:
    """Return notes with their remedies in another syntax.

    Parameters
    ----------
    notes : iterable of str or Note
        The notes; plain texts quote no remedies.
    write : function
        Returns a remedy as it is written there.
    """
    return [word_remedies(note, note.remedies, write) if isinstance(note, Note) else note for note in notes]


def join_notes(notes: Iterable[str]) -> Note:
    """Return notes or plain texts as one, which quotes the remedies of all.

    Parameters
    ----------
    notes : iterable of str or Note
        The sentences.
    """
    parts = list(notes)
    return Note(" ".join(parts), tuple(remedy for part in parts for remedy in getattr(part, "remedies", ())))


def _write_json(value: object) -> str:
    # Not by the module json, which knows neither a value to be filled in nor short numbers.
    if isinstance(value, Mapping):
        return "{" + ", ".join(f'"{key}": {_write_json(item)}' for key, item in value.items()) + "}"
    if isinstance(value, (tuple, list)):
        return "[" + ", ".join(map(_write_json, value)) + "]"
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, bool):
        return str(value).lower()
    return "…" if value is ... else write_number(value) if isinstance(value, float) else str(value)


def write_number(value: float) -> str:
    """Return the value of a remedy with six digits, and with more where it is large: a time since 1970, to the ms.

    Parameters
    ----------
    value : float
        The value.
    """
    return f"{value:.{6 if abs(value) < 1e5 else 13}g}"


def suggest_names(name: str, known: Iterable[str]) -> str:
    """Return "; did you mean 'stribeck'?" for a name that is none of the known ones; "" where nothing is near.

    Parameters
    ----------
    name : str
        The name that was given.
    known : iterable of str
        The names that there are.
    """
    from difflib import get_close_matches

    names = list(known)
    near = get_close_matches(name, names, n=3, cutoff=0.7)
    # Somebody who types `load` or `cutoff` knows a part of the name.
    near = near or [item for item in names if len(name) > 2 and name in item.split("_")][:3]
    return f"; did you mean {' or '.join(map(repr, near))}?" if near else ""


def describe_missing_joint(name: str, joints: Iterable[str]) -> str:
    """Return the sentence about a joint that a robot does not have, with the joints that it has.

    Parameters
    ----------
    name : str
        The name that was given.
    joints : iterable of str
        Names of the joints that there are.
    """
    names = list(joints)
    return (
        f"There is no joint {name!r}{suggest_names(name, names) or '.'} The joints are: {', '.join(names) or 'none'}."
    )


ELSEWHERE: Mapping[str, str] = {
    "cov_params": "covariance",
    "corr": "correlation",
    "std_errors": "bse",
    "coef_": "params",
    "resid": "residuals()",
    "fittedvalues": 'dynident.compare(model, recordings).to_frame()["predicted"]',
    "get_prediction": "predict(q, dq, ddq, interval=0.95)",
    "inverse_dynamics": "predict(q, dq, ddq)",
    "rnea": "predict(q, dq, ddq)",
    "crba": "mass_matrix(q)",
    "nonLinearEffects": "coriolis(q, dq) @ dq + gravity(q)",
    "friction_curve": "friction(q, dq), with arrays of velocities",
    "pvalues": "tvalues, conf_int()",
    "compare_lr_test": "compare_f_test(smaller)",
    "f_test": 'wald_test({"Fc1": 0.0})',
    "t_test": 'wald_test({"Fc1": 3.0}) or conf_int(0.99)',
    "update": "identification.choices, for dynident.identify(robot, recordings, choices=…)",
    "aba": "forward_dynamics(q, dq, tau)",
    "simulate": "forward_dynamics(q, dq, tau), integrated in steps of fixed size",
    "bootstrap": "bse: correlated residuals are taken into account",
    "gravity_torque": "gravity(q)",
    "aic": "ladder: errors on held-out data",
    "bic": "ladder: errors on held-out data",
    "rsquared": "errors",
    "rmse": "errors",
    "score": "held_out_moving.relative_total",
    "nobs": "identification.data",
    "identifiable": 'parameters.to_frame()["judgement"]',
    "why": "why_not(effect, joint)",
    "explain": "why_not(effect, joint)",
    "values": "to_frame().values",
    "plot": "to_frame().plot(…)",
    "rows": "n_samples or to_frame()",
    "shape": "n_samples or to_frame().shape",
    "columns": "to_frame().columns",
    "iloc": "to_frame().iloc",
    "names": "joint_names or keys()",
    "ax": "draw(axes)",
    "show": "draw(axes) or plot()",
    "recordings": "simulate(parameters)",
}
"""Where results have what statsmodels, scikit-learn, pandas and Pinocchio call so."""


_NAME = re.compile(r"\w*")


def _is_public(name: str) -> bool:
    return not name.startswith("_")


class KnownNames:
    """Base of results: the error about an attribute that does not exist names the one that was meant."""

    if not TYPE_CHECKING:
        # Hidden from type checkers: with a __getattr__ they would accept every name.

        def __getattr__(self, name: str) -> object:
            text = f"{type(self).__name__} has no attribute {name!r}"
            # Names with an underscore are asked for by programs, which try many.
            if not name.startswith("_"):
                known = {*dir(type(self)), *getattr(type(self), "__dataclass_fields__", ())}
                # Only what this class has, or what a function of ours gives.
                others = ELSEWHERE.get(name, "").split(" or ")
                fitting = [other for other in others if _NAME.match(other)[0] in {*known, "dynident"}]
                text += f"; use {fitting[0]}" if fitting else suggest_names(name, filter(_is_public, known))
            raise AttributeError(text, name=name, obj=self)


class DynidentError(ValueError):
    """Raised for input that cannot be used as it is; the message says what is wrong, where, and what would be right.

    Parameters
    ----------
    detail : str
        The sentence for the user.
    pointer : str
        The place: a JSON pointer into the request ("/drives/joint2/drive_gain"), a column of a file ("q3"), or "".
    title : str
        A few words for the kind of problem, the same for every instance of it.
    remedies : tuple of Remedy
        Those that the sentence quotes.
    """

    def __init__(
        self, detail: str, *, pointer: str = "", title: str = "Unusable input", remedies: tuple[Remedy, ...] = ()
    ) -> None:
        super().__init__(detail)
        self.detail = detail
        self.pointer = pointer
        self.title = title
        self.remedies = remedies

    def __reduce__(self) -> tuple[object, ...]:
        # Jobs run in child processes. By default an exception is pickled with its `args` alone, which would lose
        # pointer and title.
        return (_rebuild, (type(self), self.detail, self.pointer, self.title, self.remedies))


def check_names(owner: str, given: Iterable[str], known: Iterable[str]) -> None:
    """Check the names of arguments.

    Parameters
    ----------
    owner : str
        The function or class that takes them.
    given, known : iterable of str
        Names that it was given, and those that it takes.

    Raises
    ------
    DynidentError
        For the first that it does not take: says which it takes.
    """
    names = [name for name in known if name not in ("self", "cls")]
    unknown = next((name for name in given if name not in names), None)
    if unknown is None:
        return
    nearest = suggest_names(unknown, names) or "."
    detail = f"{owner} takes no argument {unknown!r}{nearest} Its arguments are: {', '.join(names)}"
    raise DynidentError(detail, pointer=unknown, title="Unknown argument")


def convert_value(value: object, hint: object, name: str, pointer: str) -> object:
    """Return a value as the type hint of its field has it, inside of lists and dictionaries, too.

    Parameters
    ----------
    value : object
        What was given.
    hint : object
        A type, or what `typing` makes of types. What is not known of it admits everything.
    name : str
        Name of the field, for the message.
    pointer : str
        The place, for programs.

    Returns
    -------
    object
        Numbers of NumPy as Python's; lists, arrays and iterators as tuples, and paths as texts where the hint says so.

    Raises
    ------
    DynidentError
        Where the value is of another type: says what to give.
    """
    if getattr(value, "ndim", None) == 0:
        value = value.item()  # type: ignore[attr-defined]
    origin, parts = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        others = [part for part in parts if part is not NoneType]
        if value is None and len(others) < len(parts):
            return None
        if len(others) == 1:
            # The message then names the place within the value.
            return convert_value(value, others[0], name, pointer)
        for part in others:
            with suppress(DynidentError):
                return convert_value(value, part, name, pointer)
    elif origin is tuple and isinstance(value, Iterable) and not isinstance(value, (str, bytes, Mapping)):
        # An iterator can be read only once.
        value = tuple(value)
        hints = [parts[0]] * len(value) if parts[-1] is ... else parts
        if len(value) == len(hints):
            return tuple(
                convert_value(item, part, f"{name}[{index}]", f"{pointer}/{index}")
                for index, (item, part) in enumerate(zip(value, hints, strict=True))
            )
    elif origin is Mapping and isinstance(value, Mapping):
        return {
            convert_value(key, parts[0], f"a key of {name}", pointer): convert_value(
                item, parts[1], f"{name}[{key!r}]", f"{pointer}/{key}"
            )
            for key, item in value.items()
        }
    elif hint is str and isinstance(value, PathLike):
        return fspath(value)
    elif hint is float and isinstance(value, Real) and not isinstance(value, int):
        return float(value)
    elif origin not in (tuple, Mapping) and _is_instance(value, hint):
        return value
    raise DynidentError(f"{name} is {describe_value(value)}; give {_describe_hint(hint)}", pointer=pointer)


def _is_instance(value: object, hint: object) -> bool:
    if hint in (float, int):
        return isinstance(value, Integral) and not isinstance(value, bool)
    # Names of a Literal are checked where their choices are known.
    return hint is Any or not isinstance(hint, type) or isinstance(value, hint)


_NOUNS = {float: "a number", int: "a whole number", bool: "True or False", str: "a text"}


def _describe_hint(hint: object) -> str:
    origin, parts = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return " or ".join(_describe_hint(part) for part in parts if part is not NoneType)
    if origin is tuple:
        count = "a list, each item" if parts[-1] is ... else f"{len(parts)} values, each"
        return f"{count} {_describe_hint(parts[0])}"
    if origin is not None:
        return "a dictionary" + ("" if parts[-1] is Any else f", each value {_describe_hint(parts[-1])}")
    if isinstance(hint, type) and hint not in _NOUNS:
        names = ", ".join(getattr(hint, "__dataclass_fields__", ()))
        return _add_article(hint.__name__) + (f", {hint.__name__}({names})" if names else "")
    return _NOUNS.get(hint, str(hint))  # type: ignore[call-overload, no-any-return]


def describe_value(value: object) -> str:
    """Return what an argument is in a few words, for messages: "a list of 3 items", "'arm.urdf'".

    Parameters
    ----------
    value : object
        What was given.

    Returns
    -------
    str
        Part of a sentence, at most some 60 characters.
    """
    shape = getattr(value, "shape", None)
    if isinstance(shape, tuple) and shape:
        return f"{_add_article(type(value).__name__)} of shape {shape}"
    text = repr(value)
    if len(text) <= _LONGEST and "\n" not in text:
        return text
    if isinstance(value, (list, tuple, set, dict)):
        return f"{_add_article(type(value).__name__)} of {len(value)} item{'' if len(value) == 1 else 's'}"
    return _add_article(type(value).__name__)


def _add_article(noun: str) -> str:
    return f"{'an' if noun[0].lower() in 'aeiou' else 'a'} {noun}"


class Cancelled(Exception):
    """Raised by a progress callback to stop a computation that the user no longer wants."""


def _rebuild(
    kind: type[DynidentError], detail: str, pointer: str, title: str, remedies: tuple[Remedy, ...]
) -> DynidentError:
    # Subclasses have constructors with further parameters. Only the fields of this class cross the border.
    error = kind.__new__(kind)
    DynidentError.__init__(error, detail, pointer=pointer, title=title, remedies=remedies)
    return error
