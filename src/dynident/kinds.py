"""Kinds of which a request takes one, each a frozen dataclass in a file of its own, with its words and its options."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import MISSING, dataclass, fields, replace
from functools import cached_property
from importlib import import_module
from pkgutil import iter_modules
from typing import Any, ClassVar, Generic, TypeVar

from dynident.asking import Choice, check_ranges, default_of
from dynident.errors import DynidentError

KindT = TypeVar("KindT", bound="Kind")
_LAST = 100


@dataclass(frozen=True)
class Kind:
    """One of several, with the options that it alone takes as its fields.

    `name` is what it is asked for by, `label` what people call it, `words` what it is for, in a line; `place` decides
    where it stands in lists.
    """

    name: ClassVar[str] = ""
    label: ClassVar[str] = ""
    words: ClassVar[str] = ""
    brief: ClassVar[str] = ""
    place: ClassVar[int] = _LAST

    @property
    def in_words(self) -> str:
        """The name, with the options that differ from their defaults."""
        values = {one.name: getattr(self, one.name) for one in fields(self)}
        chosen = [f"{one.name} {values[one.name]}" for one in fields(self) if values[one.name] != default_of(one)]
        return f"{self.name} ({', '.join(chosen)})" if chosen else self.name

    @property
    def asked(self) -> Kind | str:
        """How it is asked for: by its name alone where no option differs from its default."""
        plain = all(getattr(self, one.name) == default_of(one) for one in fields(self))
        return self.name if plain else self


class Kinds(Generic[KindT]):
    """All kinds that the modules of a package define, by their names: a new one is a new file in it.

    Parameters
    ----------
    package : str
        Its modules are imported when the first kind is looked for.
    base : type
        What every kind is a subclass of.
    what : str
        What one of them is called in messages, and the field that asks for it.
    """

    def __init__(self, package: str, base: type[object], what: str) -> None:
        self.package = package
        self.base: type[Any] = base
        self.what = what

    @cached_property
    def by_name(self) -> Mapping[str, type[KindT]]:
        """The kinds by their names, in their order."""
        found: dict[str, type[KindT]] = {}
        for one in iter_modules(import_module(self.package).__path__):
            module = import_module(f"{self.package}.{one.name}")
            for value in vars(module).values():
                if isinstance(value, type) and issubclass(value, self.base) and value.__module__ == module.__name__:
                    kind: type[KindT] = value
                    found[kind.name] = kind
        return dict(sorted(found.items(), key=lambda item: (item[1].place, item[0])))

    @property
    def names(self) -> tuple[str, ...]:
        """All names, in their order."""
        return tuple(self.by_name)

    @property
    def choices(self) -> tuple[Choice, ...]:
        """Their names and words, in their order."""
        return tuple(Choice(one.name, one.label, one.words, one.brief) for one in self)

    def __iter__(self) -> Iterator[type[KindT]]:
        """Go through the kinds in their order."""
        return iter(self.by_name.values())

    def having(self, trait: str) -> tuple[str, ...]:
        """Names of the kinds of which something is true."""
        return tuple(one.name for one in self if getattr(one, trait))

    def one(self, asked: KindT | str) -> KindT:
        """The kind of a name, or the one that was given.

        Raises
        ------
        DynidentError
            Where there is no such kind.
        """
        if not isinstance(asked, str):
            return asked
        if asked not in self.by_name:
            raise DynidentError(
                f"{asked!r} is no {self.what}; choose from: {', '.join(self.names)}", pointer=f"/{self.what}"
            )
        return self.by_name[asked]()

    def of(self, document: Mapping[str, object] | str) -> KindT:
        """The kind that a name says, or an object with `name` and options; `DynidentError` where it does not fit."""
        if isinstance(document, str):
            return self.one(document)
        options = dict(document)
        found = self.one(str(options.pop("name", "")))
        known = [one.name for one in fields(found)]
        for option in options:
            if option not in known:
                there = f"; it has: {', '.join(known)}" if known else ""
                raise DynidentError(
                    f"{self.what} {found.name} has no option {option!r}{there}", pointer=f"/{self.what}/{option}"
                )
        made = replace(found, **options)
        check_ranges(made, f"/{self.what}")
        return made

    def written(self, text: str) -> KindT:
        """The kind of a text: a name, or a name with options, `huber:threshold=1.5,rounds=20`.

        Raises
        ------
        DynidentError
            Where there is no such kind or option, or an option's value is no number where it has to be one.
        """
        name, _, rest = text.partition(":")
        options: dict[str, Any] = {}
        defaults = {one.name: default_of(one) for one in fields(self.one(name.strip()))}
        for item in (part.strip() for part in rest.split(",") if part.strip()):
            option, sign, value = item.partition("=")
            if not sign:
                raise DynidentError(f"cannot read {item!r} in {text!r}; write option=value", pointer=f"/{self.what}")
            options[option.strip()] = _value(value.strip(), defaults.get(option.strip(), MISSING), self.what, item)
        return self.of({"name": name.strip(), **options})

    def told(self) -> str:
        """The names, each with its words in short and its options, for a line of help."""
        return ", ".join(_told(one) for one in self)


def name_of(asked: Kind | str) -> str:
    """The name of what was asked for."""
    return asked if isinstance(asked, str) else asked.name


def words_of(asked: Kind | str) -> str:
    """What was asked for in words: its name, with the options that were chosen."""
    return asked if isinstance(asked, str) else asked.in_words


def document_of(asked: Kind | str) -> str | dict[str, object]:
    """What was asked for as it is written in JSON: its name, or an object with its options."""
    if isinstance(asked, str):
        return asked
    return {"name": asked.name, **{one.name: getattr(asked, one.name) for one in fields(asked)}}


def _told(one: type[Kind]) -> str:
    options = "".join(f":{option.name}=…" for option in fields(one)[:1]) + "".join(
        f",{option.name}=…" for option in fields(one)[1:]
    )
    return f"{one.name}{options} ({one.brief})" if one.brief else f"{one.name}{options}"


def _value(text: str, default: object, what: str, item: str) -> object:
    if not isinstance(default, (int, float)):
        return text
    try:
        return type(default)(text)
    except ValueError:
        raise DynidentError(f"cannot read {item!r}; write a number", pointer=f"/{what}") from None
