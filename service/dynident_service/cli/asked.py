"""Options of the command line from the requests of the science, and requests from what was typed."""

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
    """Beside a parameter of a command: it is a request, whose fields are options; `but` are those that are not."""

    science: type
    but: tuple[str, ...] = ()


@dataclass(frozen=True)
class Typed:
    """What was typed for the fields of requests; of fields that nothing was typed for, the defaults."""

    values: Mapping[str, Any] = field(default_factory=dict)

    def request(self, science: type[T], **more: object) -> T:
        """The request that was typed; `more` are fields that are no options.

        Raises
        ------
        DynidentError
            With the option that cannot be read, or that the request refuses.
        """
        try:
            return science(**{**dict(self._given(science, more)), **more})
        except DynidentError as error:
            options = {f"/{request_field.name}": _option(request_field) for request_field in fields(science)}  # type: ignore[arg-type]
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
                if typed is not None and typed != []:
                    yield request_field.name, _read(typed, said_of(request_field), hint, _option(request_field))


def with_options(command: Callable[..., None]) -> Callable[..., None]:
    """A command whose parameters are groups of options and requests as one with each option for itself."""
    hints = get_type_hints(command, include_extras=True)
    groups: dict[str, dict[str, inspect.Parameter]] = {}
    all_parameters: list[inspect.Parameter] = []
    for name, parameter in inspect.signature(command).parameters.items():
        group_parameters = _parameters(name, parameter, hints[name])
        groups[name] = {option.name: option for option in group_parameters}
        all_parameters += group_parameters
    all_parameters.sort(key=lambda option: option.default is not inspect.Parameter.empty)

    @functools.wraps(command)
    def spread(**options: Any) -> None:
        command(**{name: _gathered(hints[name], name, group, options) for name, group in groups.items()})

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
        # A list is made anew for every call by its option.
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
            # A flag can be switched off as well as on: a preset of the command may have switched it on.
            declared = (
                f"{_option(request_field)}/--no-{_option(request_field)[2:]}"
                if hint is bool
                else _option(request_field)
            )
            option = typer.Option(declared, metavar=metavar, help=_help(about), show_default=default not in (None, ""))
            if typed is list[str]:
                option.default_factory = list
                option.show_default = False
                default = MISSING
            yield _parameter(_key(science, request_field), Annotated[typed, option], default)


def _hint(science: type, request_field: Field[Any]) -> Any:
    """The type of a field, an optional one without its None; that of a choice is its name."""
    if said_of(request_field).kinds is not None:
        return str
    parts = [part for part in get_args(hint_of(science, request_field)) if part is not type(None)]
    whole = hint_of(science, request_field)
    return parts[0] if len(parts) == 1 and type(None) in get_args(whole) else whole


def _as_typed(hint: Any, about: Said, default: Any) -> tuple[Any, str | None, Any]:
    """What click reads, how help calls it, and the default."""
    origin, parts = get_origin(hint), get_args(hint)
    if hint in (int, float, bool):
        return (hint if default is not None else hint | None), None, default
    if hint is str or origin is Literal:
        return str, None, default or ""
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
    """The name of the parameter: that of the option, which no two fields share."""
    return _option(request_field)[2:].replace("-", "_")
