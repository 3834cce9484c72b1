"""What a field of a request says of itself: words, unit, range; stated once, beside the science that it is asked of.

A request is a frozen dataclass. What is `said` of its fields makes the bodies of the HTTP contract, the options of the
command line with their help, the client's signatures and the forms of the page.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass, replace
from typing import TYPE_CHECKING, Literal, Protocol, TypeAlias, TypedDict, TypeVar, Unpack

from dynident.errors import DynidentError

if TYPE_CHECKING:
    from dataclasses import _MISSING_TYPE

    from _typeshed import DataclassInstance

    Missing: TypeAlias = Literal[_MISSING_TYPE.MISSING]

T = TypeVar("T")
_KEY = "said"
LARGEST_SEED = 2**53 - 1
"""The largest whole number that every reader of JSON keeps."""
LARGEST = 1e16
"""Size of any number in a request: nothing of a robot is larger in any unit, and its fourth power can be taken."""


@dataclass(frozen=True)
class Choice:
    """One of several: what it is asked for by, what people call it, and what it is for, in a line and in short."""

    name: str
    label: str = ""
    words: str = ""
    brief: str = ""


class Named(Protocol):
    """What a field takes one of (`OneOf`, `dynident.kinds.Kinds`)."""

    @property
    def names(self) -> tuple[str, ...]:
        """All names, in their order."""
        ...

    @property
    def choices(self) -> tuple[Choice, ...]:
        """The same with their words."""
        ...

    def told(self) -> str:
        """The names with their words in short, for a line of help."""
        ...


class OneOf:
    """Names that a field takes one of, with their words."""

    def __init__(self, *choices: Choice | str) -> None:
        self.choices = tuple(Choice(one) if isinstance(one, str) else one for one in choices)

    @property
    def names(self) -> tuple[str, ...]:
        """All names, in their order."""
        return tuple(one.name for one in self.choices)

    def told(self) -> str:
        """The names with their words in short, for a line of help."""
        return ", ".join(f"{one.name} ({one.brief})" if one.brief else one.name for one in self.choices)


@dataclass(frozen=True)
class Said:
    """What is said of a field.

    Parameters
    ----------
    words : str
        What it is, in a line.
    unit : str
        Of a number.
    above, at_least, at_most : float, optional
        The range of a number, or of each number in a list.
    fewest, most : int, optional
        How many items a list may have.
    kinds : Named, optional
        What it is one of.
    option : str
        The option of the command line, where it is not the field's own name; "-" where there is none.
    local : bool
        A matter of one machine, which no request to another carries.
    """

    words: str = ""
    unit: str = ""
    above: float | None = None
    at_least: float | None = None
    at_most: float | None = None
    fewest: int | None = None
    most: int | None = None
    kinds: Named | None = None
    option: str = ""
    local: bool = False

    @property
    def sentence(self) -> str:
        """The words with the unit."""
        return f"{self.words}, in {self.unit}" if self.words and self.unit else self.words or self.unit

    def admits(self, value: float) -> bool:
        """Whether a number is finite, of a size that can be meant, and within the range."""
        return (
            -LARGEST <= value <= LARGEST
            and (self.above is None or value > self.above)
            and (self.at_least is None or value >= self.at_least)
            and (self.at_most is None or value <= self.at_most)
        )

    @property
    def range(self) -> str:
        """The range in words."""
        if self.above is None and self.at_least is None and self.at_most is None:
            return f"{-LARGEST:g} to {LARGEST:g}"
        if self.at_least is not None and self.at_most is not None:
            return f"{self.at_least:g} to {self.at_most:g}"
        ends = (("above", self.above), ("at least", self.at_least), ("at most", self.at_most))
        return " and ".join(f"{words} {end:g}" for words, end in ends if end is not None)


class About(TypedDict, total=False):
    """What else is said of a field, by keyword: the fields of `Said` beside its words."""

    unit: str
    above: float | None
    at_least: float | None
    at_most: float | None
    fewest: int | None
    most: int | None
    kinds: Named | None
    option: str
    local: bool


def said(
    words: str = "",
    *,
    default: T | Missing = MISSING,
    made_by: Callable[[], T] | None = None,
    **more: Unpack[About],
) -> T:
    """A dataclass's field with what is said of it.

    Parameters
    ----------
    words : str
        What it is, in a line, without a full stop.
    default, made_by
        The default, or what makes it.
    more
        As `Said` has it: unit, above, at_least, at_most, fewest, most, kinds, option, local.
    """
    return _field(Said(words, **more), default, made_by)


def said_of(one: Field[T]) -> Said:
    """What is said of a field; nothing where it was made without."""
    found: Said = one.metadata.get(_KEY, _NOTHING)
    return found


def retold(one: Field[T], words: str) -> T:
    """A field like another, in other words."""
    made_by = None if one.default_factory is MISSING else one.default_factory
    return _field(replace(said_of(one), words=words), one.default, made_by)


def anew(
    request: type[DataclassInstance],
    name: str,
    *,
    default: T | Missing = MISSING,
    made_by: Callable[[], T] | None = None,
) -> T:
    """A field as a request has it that changes what was asked for; its default is what leaves that as before."""
    about = next(said_of(one) for one in fields(request) if one.name == name)
    return said(about.words, default=default, made_by=made_by)


def default_of(one: Field[T]) -> T | Missing:
    """A field's default; `MISSING` where it has none."""
    return one.default if one.default_factory is MISSING else one.default_factory()


def check_ranges(request: DataclassInstance, within: str = "") -> None:
    """Raise `DynidentError` where a number of a request, or of a part of one, is not within what is said of its field.

    `within` is the pointer to the request.
    """
    for one in fields(request):
        if _KEY in one.metadata:
            _check_values(getattr(request, one.name), one.name, said_of(one), f"{within}/{one.name}")


def _check_values(value: object, name: str, about: Said, at: str) -> None:
    """Check what a field holds: a number, another request, or several of them."""
    if isinstance(value, (int, float)):
        if not (isinstance(value, bool) or about.admits(value)):
            raise DynidentError(f"{name} is {_shown(value)}; it must be {about.range}", pointer=at)
    elif isinstance(value, Mapping):
        for key, item in value.items():
            _check_values(item, f"{name} of {key}", about, f"{at}/{_escaped(key)}")
    elif isinstance(value, (tuple, list)):
        if not (about.fewest or 0) <= len(value) <= (len(value) if about.most is None else about.most):
            ends = (("at least", about.fewest), ("at most", about.most))
            allowed = " and ".join(f"{words} {end}" for words, end in ends if end is not None)
            raise DynidentError(f"{name} has {len(value)} items; it must have {allowed}", pointer=at)
        for index, item in enumerate(value):
            _check_values(item, name, about, f"{at}/{index}")
    elif is_dataclass(value) and not isinstance(value, type):
        check_ranges(value, at)


def _escaped(key: object) -> str:
    """A key as a JSON pointer has it."""
    return str(key).replace("~", "~0").replace("/", "~1")


def _shown(value: float) -> str:
    # Python refuses to write whole numbers of very many digits.
    return "too large" if isinstance(value, int) and abs(value) > LARGEST else str(value)


def _field(about: Said, default: T | Missing, made_by: Callable[[], T] | None) -> T:
    metadata = {_KEY: about}
    if made_by is not None:
        return field(default_factory=made_by, metadata=metadata)
    if default is not MISSING:
        return field(default=default, metadata=metadata)
    found: T = field(metadata=metadata)
    return found


_NOTHING = Said()
