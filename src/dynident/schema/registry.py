"""`Registry`: classes that a request names (estimators, strategies, …), with options as fields.

Each class is a frozen dataclass, with its description and its options as fields.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import MISSING, dataclass, fields, replace
from functools import cached_property
from importlib import import_module
from pkgutil import iter_modules
from typing import Any, ClassVar, Generic, TypeVar

from dynident.errors import DynidentError
from dynident.schema.fields import Choice, Request, get_default, point_within

EntryT = TypeVar("EntryT", bound="RegistryEntry")
# Kinds without a place of their own come last.
_LAST = 100


@dataclass(frozen=True)
class RegistryEntry(Request):
    """One class of a registry; its fields are the options that it alone takes.

    Attributes
    ----------
    name : str
        The name by which a request asks for it.
    label : str
        What people call it.
    words : str
        What it is for, in a line.
    brief : str
        The same in a few words, for a line of help.
    place : int
        Position in lists, lowest first; classes of the same place are in the order of their names.
    """

    name: ClassVar[str] = ""
    label: ClassVar[str] = ""
    words: ClassVar[str] = ""
    brief: ClassVar[str] = ""
    place: ClassVar[int] = _LAST

    @property
    def name_with_options(self) -> str:
        """The name, followed by the options that differ from their defaults."""
        values = {option.name: getattr(self, option.name) for option in fields(self)}
        chosen = [
            f"{option.name} {values[option.name]}"
            for option in fields(self)
            if values[option.name] != get_default(option)
        ]
        return f"{self.name} ({', '.join(chosen)})" if chosen else self.name

    @property
    def request_value(self) -> RegistryEntry | str:
        """The value of the request's field: the name alone where no option differs from its default."""
        is_default = all(getattr(self, option.name) == get_default(option) for option in fields(self))
        return self.name if is_default else self


class Registry(Generic[EntryT]):
    """The registry of all kinds that a module, or the modules of a package, define, by their names.

    Each class in these files is a kind.

    Parameters
    ----------
    home : str
        The module or the package. It is imported at the first look-up.
    base : type
        The base class of every kind.
    what : str
        The name of the request's field, which messages use as the word for one kind.
    """

    def __init__(self, home: str, base: type[object], what: str) -> None:
        self.home = home
        self.base: type[Any] = base
        self.what = what

    @cached_property
    def by_name(self) -> Mapping[str, type[EntryT]]:
        """The kinds by their names, in their order."""
        kinds: dict[str, type[EntryT]] = {}
        home = import_module(self.home)
        # A module has no path; a package has one, and the kinds are in its modules.
        names = [f"{self.home}.{info.name}" for info in iter_modules(getattr(home, "__path__", []))]
        for module in (home, *map(import_module, names)):
            # Only classes that the module defines itself: a module may import the base class, or another kind to derive
            # from.
            for value in vars(module).values():
                if isinstance(value, type) and issubclass(value, self.base) and value.__module__ == module.__name__:
                    kind: type[EntryT] = value
                    kinds[kind.name] = kind
        return dict(sorted(kinds.items(), key=lambda item: (item[1].place, item[0])))

    @property
    def names(self) -> tuple[str, ...]:
        """All names, in their order."""
        return tuple(self.by_name)

    @property
    def choices(self) -> tuple[Choice, ...]:
        """Names and descriptions of all kinds, in their order."""
        return tuple(Choice(kind.name, kind.label, kind.words, kind.brief) for kind in self)

    def __iter__(self) -> Iterator[type[EntryT]]:
        """Go through the kinds in their order."""
        return iter(self.by_name.values())

    def names_with(self, trait: str) -> tuple[str, ...]:
        """Return the names of the kinds whose attribute `trait` is true.

        Parameters
        ----------
        trait : str
            Name of a class attribute of the kinds.

        Returns
        -------
        tuple of str
            Names in the order of lists.
        """
        return tuple(kind.name for kind in self if getattr(kind, trait))

    def get(self, kind_or_name: EntryT | str) -> EntryT:
        """Return the kind of a name with default options, or the kind that was given.

        Parameters
        ----------
        kind_or_name : RegistryEntry or str
            A name, or a kind, which is returned as it is.

        Returns
        -------
        RegistryEntry
            The kind.

        Raises
        ------
        DynidentError
            Where there is no kind of this name.
        """
        if not isinstance(kind_or_name, str):
            return kind_or_name
        if kind_or_name not in self.by_name:
            raise DynidentError(
                f"there is no {self.what} {kind_or_name!r}; choose from: {', '.join(self.names)}",
                pointer=f"/{self.what}",
            )
        return self.by_name[kind_or_name]()

    def from_document(self, document: Mapping[str, object] | str) -> EntryT:
        """Return the kind that a JSON document states.

        Parameters
        ----------
        document : mapping or str
            A name, or an object with `name` and options.

        Returns
        -------
        RegistryEntry
            The kind with the options of the document.

        Raises
        ------
        DynidentError
            Where there is no such kind or option, or an option is out of its range.
        """
        if isinstance(document, str):
            return self.get(document)
        # A copy: the document belongs to the caller.
        options = dict(document)
        default = self.get(str(options.pop("name", "")))
        option_names = [option_field.name for option_field in fields(default)]
        for option in options:
            if option not in option_names:
                choices = f"; it has: {', '.join(option_names)}" if option_names else ""
                raise DynidentError(
                    f"{self.what} {default.name} has no option {option!r}{choices}", pointer=f"/{self.what}/{option}"
                )
        with point_within(f"/{self.what}"):
            return replace(default, **options)

    def from_text(self, text: str) -> EntryT:
        """Return the kind that a text states: a name, or a name with options, `huber:threshold=1.5,rounds=20`.

        Parameters
        ----------
        text : str
            What the user writes on the command line.

        Returns
        -------
        RegistryEntry
            The kind with the options of the text.

        Raises
        ------
        DynidentError
            Where there is no such kind or option, or an option's value is no number where it has to be one.
        """
        name, _, rest = text.partition(":")
        options: dict[str, Any] = {}
        defaults = {option_field.name: get_default(option_field) for option_field in fields(self.get(name.strip()))}
        for item in (part.strip() for part in rest.split(",") if part.strip()):
            option, sign, value = item.partition("=")
            if not sign:
                raise DynidentError(f"cannot read {item!r} in {text!r}; write option=value", pointer=f"/{self.what}")
            # An option that the kind does not have passes as text; `from_document` reports it by name.
            options[option.strip()] = _parse_option(
                value.strip(), defaults.get(option.strip(), MISSING), self.what, item
            )
        return self.from_document({"name": name.strip(), **options})

    def format_help(self) -> str:
        """Return the names, each with its short description and its options, for a line of help."""
        return ", ".join(_format_help(kind) for kind in self)


def get_kind_name(kind_or_name: RegistryEntry | str) -> str:
    """Return the name of a request's kind, which may be given by its name.

    Parameters
    ----------
    kind_or_name : RegistryEntry or str
        The value of the request's field.

    Returns
    -------
    str
        The name alone, without options.
    """
    return kind_or_name if isinstance(kind_or_name, str) else kind_or_name.name


def format_kind(kind_or_name: RegistryEntry | str) -> str:
    """Return a request's kind in words: its name, with the options that differ from their defaults.

    Parameters
    ----------
    kind_or_name : RegistryEntry or str
        The value of the request's field.

    Returns
    -------
    str
        Words for a person.
    """
    return kind_or_name if isinstance(kind_or_name, str) else kind_or_name.name_with_options


def kind_to_document(kind_or_name: RegistryEntry | str) -> str | dict[str, object]:
    """Return a request's kind as JSON: its name, or an object with all its options.

    Parameters
    ----------
    kind_or_name : RegistryEntry or str
        The value of the request's field.

    Returns
    -------
    str or dict
        What `Registry.from_document` reads.
    """
    if isinstance(kind_or_name, str):
        return kind_or_name
    return {
        "name": kind_or_name.name,
        **{option_field.name: getattr(kind_or_name, option_field.name) for option_field in fields(kind_or_name)},
    }


def _format_help(kind: type[RegistryEntry]) -> str:
    options = "".join(f":{option.name}=…" for option in fields(kind)[:1]) + "".join(
        f",{option.name}=…" for option in fields(kind)[1:]
    )
    return f"{kind.name}{options} ({kind.brief})" if kind.brief else f"{kind.name}{options}"


def _parse_option(text: str, default: object, field_name: str, item: str) -> object:
    if not isinstance(default, (int, float)):
        return text
    try:
        # The default has the type that the option takes, so that it also says how the text is read.
        return type(default)(text)
    except ValueError:
        raise DynidentError(f"cannot read {item!r}; write a number", pointer=f"/{field_name}") from None
