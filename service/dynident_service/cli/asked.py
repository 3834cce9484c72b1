"""Options of the command line, derived from the request dataclasses of the library, and the way back.

A request (for example `IdentificationChoices`) states its fields with units, ranges and sentences once. `with_options`
turns these fields into typer options; `Typed.request` builds the request from what the user typed.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import typer

from dynident.asking import Said, default_of, said_of
from dynident.errors import DynidentError
from dynident.kinds import Kinds
from dynident_service.cli import parsing
from dynident_service.hints import hint_of

T = TypeVar("T")
_UNUSABLE = "Unusable option"


@dataclass(frozen=True)
class Asks:
    """Marker in the annotation of a command's parameter: the fields of a request are options of the command.

    Parameters
    ----------
    science : type
        The request dataclass.
    but : tuple of str
        Names of fields that are not options.
    """

    science: type
    but: tuple[str, ...] = ()


@dataclass(frozen=True)
class Typed:
    """The values of options that belong to a request, by option name; defaults where nothing was typed."""

    values: Mapping[str, Any] = field(default_factory=dict)

    def request(self, science: type[T], **more: object) -> T:
        """Build the request from the options.

        Parameters
        ----------
        science : type
            The request dataclass.
        more
            Values of fields that are no options.

        Returns
        -------
        object
            The request.

        Raises
        ------
        DynidentError
            Where an option cannot be read, or the request refuses its value; the pointer is the option.
        """
        try:
            return science(**{**dict(self._given(science, more)), **more})
        except DynidentError as error:
            options = {f"/{request_field.name}": _option(request_field) for request_field in fields(science)}  # type: ignore[arg-type]
            # The request points at its field; the user knows the option.
            error.pointer = options.get(error.pointer, error.pointer)
            raise

    def _given(self, science: type, more: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        for request_field in fields(science):
            if request_field.name in more or said_of(request_field).option == "-":
                continue
            hint = _hint(science, request_field)
            if is_dataclass(hint):
                yield request_field.name, self.request(hint)  # type: ignore[arg-type]
            elif _key(science, request_field) in self.values:
                typed = self.values[_key(science, request_field)]
                # None and [] mean that the option was not given: then the default of the dataclass holds.
                if typed is not None and typed != []:
                    yield request_field.name, _read(typed, said_of(request_field), hint, _option(request_field))


def with_options(command: Callable[..., None]) -> Callable[..., None]:
    """Spread a command's groups of options and requests into single options, as typer needs them.

    Parameters
    ----------
    command : callable
        A command. A parameter that is a dataclass stands for one option a field; one that is annotated with `Asks`
        stands for one option a field of the request.

    Returns
    -------
    callable
        A function with one keyword parameter an option, which gathers them and calls the command.
    """
    hints = get_type_hints(command, include_extras=True)
    groups: dict[str, dict[str, inspect.Parameter]] = {}
    all_parameters: list[inspect.Parameter] = []
    for name, parameter in inspect.signature(command).parameters.items():
        group_parameters = _parameters(name, parameter, hints[name])
        groups[name] = {option.name: option for option in group_parameters}
        all_parameters += group_parameters
    # A signature must not have a parameter without a default after one with a default.
    all_parameters.sort(key=lambda option: option.default is not inspect.Parameter.empty)

    @functools.wraps(command)
    def spread(**options: Any) -> None:
        command(**{name: _gathered(hints[name], name, group, options) for name, group in groups.items()})

    # Typer reads both the signature and the annotations; `functools.wraps` copied those of the command.
    spread.__signature__ = inspect.Signature(all_parameters)  # type: ignore[attr-defined]
    spread.__annotations__ = {option.name: option.annotation for option in all_parameters}
    return spread


def _gathered(hint: Any, name: str, group: Mapping[str, Any], options: Mapping[str, Any]) -> Any:
    kind, asks = _of(hint)
    if asks is not None:
        return Typed({option_name: options[option_name] for option_name in group})
    if is_dataclass(kind):
        return kind(**{option_name: options[option_name] for option_name in group})  # type: ignore[operator]
    return options[name]


def _parameters(name: str, parameter: inspect.Parameter, hint: Any) -> list[inspect.Parameter]:
    kind, asks = _of(hint)
    if asks is not None:
        return list(_of_request(asks.science, asks.but))
    if is_dataclass(kind):
        inner = get_type_hints(kind, include_extras=True)
        # The default of a list is made by its option, a new list for each call: a shared one could be changed.
        defaults = {
            group_field.name: MISSING if group_field.default_factory is list else default_of(group_field)
            for group_field in fields(kind)
        }
        return [_parameter(name, inner[name], default) for name, default in defaults.items()]
    missing = parameter.default is inspect.Parameter.empty
    return [_parameter(name, hint, MISSING if missing else parameter.default)]


def _of(hint: Any) -> tuple[Any, Asks | None]:
    if get_origin(hint) is not Annotated:
        return hint, None
    return hint.__origin__, next((marker for marker in hint.__metadata__ if isinstance(marker, Asks)), None)


def _parameter(name: str, hint: Any, default: Any) -> inspect.Parameter:
    signature_default = inspect.Parameter.empty if default is MISSING else default
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=signature_default, annotation=hint)


def _of_request(science: type, but: Sequence[str] = ()) -> Iterator[inspect.Parameter]:
    for request_field in fields(science):
        about = said_of(request_field)
        if request_field.name in but or about.option == "-":
            continue
        hint = _hint(science, request_field)
        if is_dataclass(hint):
            yield from _of_request(hint)  # type: ignore[arg-type]
        else:
            typed, metavar, default = _as_typed(hint, about, default_of(request_field))
            # Flags get a --no- form, because a preset of the command may have switched them on.
            declared = (
                f"{_option(request_field)}/--no-{_option(request_field)[2:]}"
                if hint is bool
                else _option(request_field)
            )
            option = typer.Option(declared, metavar=metavar, help=_help(about), show_default=default not in (None, ""))
            if typed is list[str]:
                # Repeatable options start from an empty list, which the help would show as a default.
                option.default_factory = list
                option.show_default = False
                default = MISSING
            yield _parameter(_key(science, request_field), Annotated[typed, option], default)


def _hint(science: type, request_field: Field[Any]) -> Any:
    """Return the type of a field without `None`; a choice among kinds is typed by its name."""
    if said_of(request_field).kinds is not None:
        return str
    parts = [part for part in get_args(hint_of(science, request_field)) if part is not type(None)]
    whole = hint_of(science, request_field)
    return parts[0] if len(parts) == 1 and type(None) in get_args(whole) else whole


def _as_typed(hint: Any, about: Said, default: Any) -> tuple[Any, str | None, Any]:
    """Return the type that click reads, the metavar for the help, and the default."""
    origin, parts = get_origin(hint), get_args(hint)
    if hint in (int, float, bool):
        return (hint if default is not None else hint | None), None, default
    if hint is str or origin is Literal:
        return str, None, default or ""
    # A pair of numbers is two words on the command line, which click reads by itself. Tuples of any length and
    # mappings are texts with commas, which `_read` takes apart.
    if origin is tuple and parts == (float, float):
        return (hint if default is not None else hint | None), None, default
    if origin is tuple:
        return list[str], "NUMBER,…" if parts[0] in (int, float) else "NAME,…", None
    return list[str], "NAME=VALUE,…", None


def _read(typed: Any, about: Said, hint: Any, option: str) -> Any:
    if about.kinds is not None:
        return None if not typed else _chosen(typed, about.kinds, option)
    origin, parts = get_origin(hint), get_args(hint)
    if origin is tuple and isinstance(typed, list):
        items = [part.strip() for text in typed for part in text.split(",") if part.strip()]
        return tuple(parsing.number(item, option) for item in items) if parts[0] in (int, float) else tuple(items)
    if isinstance(typed, list):
        return {name: parsing.number(value, option) for name, value in parsing.pairs(typed, option).items()}
    return typed


def _chosen(typed: str, kinds: Any, option: str) -> Any:
    name = typed.partition(":")[0].strip()
    if name not in kinds.names:
        raise DynidentError(
            f"there is no {option[2:]} {name!r}; choose from: {', '.join(kinds.names)}", pointer=option, title=_UNUSABLE
        )
    # "name" alone is the kind with its defaults; "name:option=value" gives it options.
    if ":" not in typed:
        return name
    if not isinstance(kinds, Kinds):
        raise DynidentError(f"{name} takes no options", pointer=option, title=_UNUSABLE)
    try:
        return kinds.written(typed)
    except DynidentError as error:
        raise DynidentError(error.detail, pointer=option, title=_UNUSABLE) from error


def _help(about: Said) -> str:
    sentence = about.sentence
    if about.kinds is not None:
        sentence = f"{sentence}: {about.kinds.told()}" if sentence else about.kinds.told()
    return f"{sentence}."


def _option(request_field: Field[Any]) -> str:
    return said_of(request_field).option or "--" + request_field.name.replace("_", "-")


def _key(science: type, request_field: Field[Any]) -> str:
    """Return the parameter name of a field: that of its option, which no two fields share."""
    return _option(request_field)[2:].replace("-", "_")
