"""Derive options from request dataclasses (names, types, help), and build requests from what is typed.

A request (for example `IdentificationChoices`) states its fields with units, ranges and sentences once.
`spread_options` turns these fields into typer options; `TypedValues.build_request` builds the request from what the
user typed.
"""

from __future__ import annotations

import functools
import inspect
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass, replace
from types import MappingProxyType
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import typer

from dynident.errors import DynidentError, Remedy, write_number
from dynident.schema.fields import FieldDescription, get_default, get_description, resolve_hint
from dynident.schema.registry import Registry
from dynident_cli import option_parsers

T = TypeVar("T")
_UNUSABLE = "Unusable option"


@dataclass(frozen=True)
class RequestOptions:
    """Marker in the annotation of a command's parameter: the fields of a request are options of the command.

    Fields named in `but` are not options. `words` has the help of fields that mean something else in this command.
    """

    science: type
    but: tuple[str, ...] = ()
    words: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class TypedValues:
    """The values of options that belong to a request, by option name; defaults where nothing was typed."""

    values: Mapping[str, Any] = field(default_factory=dict)

    def build_request(self, science: type[T], **more: object) -> T:
        """Build the request from the options; `more` has the values of fields that are no options.

        The pointer of an error is the option that cannot be read, or whose value the request refuses.
        """
        try:
            return science(**{**dict(self._read_fields(science, more)), **more})
        except DynidentError as error:
            error.pointer = find_option(science, error.pointer)
            raise

    def _read_fields(self, science: type, more: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        for request_field in fields(science):
            if request_field.name in more or get_description(request_field).option == "-":
                continue
            hint = _field_type(science, request_field)
            # A request within a request: its fields are options of the same command.
            if is_dataclass(hint):
                yield request_field.name, self.build_request(hint)  # type: ignore[arg-type]
            elif _parameter_name(request_field) in self.values:
                typed = self.values[_parameter_name(request_field)]
                # None and an empty list mean that the option was not given: then the default of the dataclass holds.
                if typed not in (None, [], ()):
                    yield (
                        request_field.name,
                        _parse_value(typed, get_description(request_field), hint, _option_name(request_field)),
                    )


def find_option(science: type, pointer: str) -> str:
    """Return the option of the field that a pointer into a request names; the pointer itself where there is none."""
    # The request points at its field, or at an item of it; the user knows the option.
    name = pointer.split("/")[1] if pointer.startswith("/") else ""
    return next((_option_name(item) for item in fields(science) if item.name == name), pointer)


def spread_options(command: Callable[..., None]) -> Callable[..., None]:
    """Spread a command's groups of options and requests into single options, as typer needs them.

    A parameter of the command that is a dataclass stands for one option a field; one that is annotated with
    `RequestOptions` stands for one option a field of the request. The function that is returned has one keyword
    parameter an option, gathers them and calls the command.
    """
    hints = get_type_hints(command, include_extras=True)
    groups: dict[str, dict[str, inspect.Parameter]] = {}
    all_parameters: list[inspect.Parameter] = []
    for name, parameter in inspect.signature(command).parameters.items():
        group_parameters = _make_parameters(name, parameter, hints[name])
        # Which options belong to which parameter, to gather them again in the call.
        groups[name] = {option.name: option for option in group_parameters}
        all_parameters += group_parameters
    # A signature must not have a parameter without a default after one with a default.
    all_parameters.sort(key=lambda option: option.default is not inspect.Parameter.empty)

    @functools.wraps(command)
    def run_with_options(**options: Any) -> None:
        command(**{name: _gather_group(hints[name], name, group, options) for name, group in groups.items()})

    # Typer reads both the signature and the annotations; `functools.wraps` copied those of the command.
    run_with_options.__signature__ = inspect.Signature(all_parameters)  # type: ignore[attr-defined]
    run_with_options.__annotations__ = {option.name: option.annotation for option in all_parameters}
    return run_with_options


_OPTIONS_TO_FILL = {
    "drives": "--drive-gains",
    "cure": "--cure",
    "rate": "--rate HZ",
    "contacts": "--contacts",
    "meshes": "--meshes FOLDER",
    "assume_floor": "--no-floor",
    "identification_id": "--identified MODEL",
}
"""Options of remedies that the field does not name, or whose value only the user knows."""


def write_option(remedy: Remedy) -> str:
    """Return a remedy as options of the command line."""
    from dynident.recordings.recording_metadata import DELAY

    option, value = f"--{remedy.field.replace('_', '-')}", remedy.value
    if remedy.field in _OPTIONS_TO_FILL and not (remedy.field == "rate" and value is not ...):
        return _OPTIONS_TO_FILL[remedy.field]
    if remedy.field == "role":
        return f"option --{value}"
    if remedy.field == "metadata" and isinstance(value, Mapping):
        ((name, own),) = value.items()
        return f"--metadata {name}=FILE with {{{', '.join(str(Remedy(*item)) for item in own.items())}}}"
    if remedy.field == "locked_joints" and isinstance(value, Mapping):
        places = (name if not at else f"{name}={_write_value(at)}" for name, at in value.items())
        return f"--lock {_quote(','.join(places))}"
    if remedy.field in ("signs", "scale", "zeros", "effort_kind", DELAY):
        return f"{remedy} in --metadata"
    if isinstance(value, Mapping):
        # A comma in a name would part it: such pairs are typed as a JSON object.
        if any("," in f"{key}{item}" or f"{item}".startswith("{") for key, item in value.items()):
            return f"{option} {_quote(str(remedy).partition(': ')[2])}"
        return f"{option} {_quote(','.join(f'{key}={_write_value(item)}' for key, item in value.items()))}"
    return f"{option} {','.join(map(_write_value, value)) if isinstance(value, tuple) else _write_value(value)}"


def _write_value(value: object) -> str:
    if isinstance(value, tuple):
        return ":".join(map(_write_value, value))
    return "…" if value is ... else write_number(value) if isinstance(value, float) else str(value)


def _quote(text: str) -> str:
    """Quote what a shell would take apart, but not the … that the user fills in."""
    return shlex.quote(text) if shlex.quote(text.replace("…", "")) != text.replace("…", "") else text


def list_option_words(group: object) -> list[str]:
    """Return the words of a command line that set a group of options to its values; none for defaults.

    Each option is named like its field of the group.
    """
    assert is_dataclass(group)
    words = list[str]()
    for group_field in fields(group):
        value, name = getattr(group, group_field.name), group_field.name.replace("_", "-")
        if value == get_default(group_field):
            continue
        if isinstance(value, bool):
            words.append(f"--{name}" if value else f"--no-{name}")
        else:
            items = value if isinstance(value, list) else [value]
            words += [word for item in items for word in (f"--{name}", str(item))]
    return words


def _gather_group(hint: Any, name: str, group: Mapping[str, Any], options: Mapping[str, Any]) -> Any:
    kind, asks = _split_annotation(hint)
    if asks is not None:
        return TypedValues({option_name: options[option_name] for option_name in group})
    if is_dataclass(kind):
        return kind(**{option_name: options[option_name] for option_name in group})  # type: ignore[operator]
    return options[name]


def _make_parameters(name: str, parameter: inspect.Parameter, hint: Any) -> list[inspect.Parameter]:
    kind, asks = _split_annotation(hint)
    if asks is not None:
        return list(_make_request_parameters(asks.science, asks.but, asks.words))
    if is_dataclass(kind):
        inner = get_type_hints(kind, include_extras=True)
        # The default of a list is made by its option, a new list for each call: a shared one could be changed.
        defaults = {
            group_field.name: MISSING if group_field.default_factory is list else get_default(group_field)
            for group_field in fields(kind)
        }
        return [_make_parameter(name, inner[name], default) for name, default in defaults.items()]
    missing = parameter.default is inspect.Parameter.empty
    return [_make_parameter(name, hint, MISSING if missing else parameter.default)]


def _split_annotation(hint: Any) -> tuple[Any, RequestOptions | None]:
    if get_origin(hint) is not Annotated:
        return hint, None
    return hint.__origin__, next((marker for marker in hint.__metadata__ if isinstance(marker, RequestOptions)), None)


def _make_parameter(name: str, hint: Any, default: Any) -> inspect.Parameter:
    signature_default = inspect.Parameter.empty if default is MISSING else default
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=signature_default, annotation=hint)


def _make_request_parameters(
    science: type, but: Sequence[str] = (), words: Mapping[str, str] = MappingProxyType({})
) -> Iterator[inspect.Parameter]:
    for request_field in fields(science):
        about = get_description(request_field)
        about = replace(about, words=words.get(request_field.name, about.words))
        if request_field.name in but or about.option == "-":
            continue
        hint = _field_type(science, request_field)
        if is_dataclass(hint):
            yield from _make_request_parameters(hint, words=words)  # type: ignore[arg-type]
        else:
            typed, metavar, default = _option_type(hint, get_default(request_field))
            # Flags get a --no- form, because a preset of the command may have switched them on.
            declared = (
                f"{_option_name(request_field)}/--no-{_option_name(request_field)[2:]}"
                if hint is bool
                else _option_name(request_field)
            )
            has_numbers = bool({int, float} & {hint, *get_args(hint)})
            option = typer.Option(
                declared, metavar=metavar, help=_help_text(about, has_numbers), show_default=default not in (None, "")
            )
            if typed is list[str]:
                # Repeatable options start from an empty list, which the help would show as a default.
                option.default_factory = list
                option.show_default = False
                default = MISSING
            yield _make_parameter(_parameter_name(request_field), Annotated[typed, option], default)


def _field_type(science: type, request_field: Field[Any]) -> Any:
    """Return the type of a field without `None`; a choice among kinds is typed by its name."""
    if get_description(request_field).kinds is not None:
        return str
    parts = [part for part in get_args(resolve_hint(science, request_field)) if part is not type(None)]
    whole = resolve_hint(science, request_field)
    return parts[0] if len(parts) == 1 and type(None) in get_args(whole) else whole


def _option_type(hint: Any, default: Any) -> tuple[Any, str | None, Any]:
    """Return the type that click reads, the metavar for the help, and the default."""
    origin, parts = get_origin(hint), get_args(hint)
    if hint in (int, float, bool):
        # click shows no default for None, which here means that the library chooses.
        return (hint if default is not None else hint | None), None, default
    if hint is str or origin is Literal:
        return str, None, default or ""
    # A pair of numbers is two words on the command line, which click reads by itself. Tuples of any length and
    # mappings are texts with commas, which `_parse_value` takes apart.
    if origin is tuple and parts == (float, float):
        return (hint if default is not None else hint | None), None, default
    if origin is tuple:
        return list[str], "NUMBER,…" if parts[0] in (int, float) else "NAME,…", None
    return list[str], "NAME=VALUE,…", None


def _parse_value(typed: Any, about: FieldDescription, hint: Any, option: str) -> Any:
    if about.kinds is not None:
        return None if not typed else _parse_kind(typed, about.kinds, option)
    origin, parts = get_origin(hint), get_args(hint)
    if origin is tuple and isinstance(typed, list):
        # Names may be those of contacts, whose points have commas themselves.
        if parts[0] is str:
            return tuple(item for text in typed for item in option_parsers.split_contacts(text, option))
        items = [part.strip() for text in typed for part in text.split(",") if part.strip()]
        return tuple(option_parsers.parse_number(item, option) for item in items)
    if isinstance(typed, list):
        return {
            name: option_parsers.parse_number(value, option)
            for name, value in option_parsers.parse_pairs(typed, option).items()
        }
    return typed


def _parse_kind(typed: str, kinds: Any, option: str) -> Any:
    name = typed.partition(":")[0].strip()
    if name not in kinds.names:
        raise DynidentError(
            f"there is no {option[2:]} {name!r}; choose from: {', '.join(kinds.names)}", pointer=option, title=_UNUSABLE
        )
    # "name" alone is the kind with its defaults; "name:option=value" gives it options.
    if ":" not in typed:
        return name
    if not isinstance(kinds, Registry):
        raise DynidentError(f"{name} takes no options", pointer=option, title=_UNUSABLE)
    try:
        return kinds.from_text(typed)
    except DynidentError as error:
        raise DynidentError(error.detail, pointer=option, title=_UNUSABLE) from error


def _help_text(about: FieldDescription, has_numbers: bool) -> str:
    sentence = about.sentence
    if has_numbers and about.has_range:
        sentence = f"{sentence} ({about.range_text})"
    if about.kinds is not None:
        sentence = f"{sentence}: {about.kinds.format_help()}" if sentence else about.kinds.format_help()
    return f"{sentence}."


def _option_name(request_field: Field[Any]) -> str:
    return get_description(request_field).option or "--" + request_field.name.replace("_", "-")


def _parameter_name(request_field: Field[Any]) -> str:
    """Return the parameter name of a field: that of its option, which no two fields share."""
    return _option_name(request_field)[2:].replace("-", "_")
