"""Fields of requests with their description: words, unit, range, default.

A request is a frozen dataclass. The description of each field stands beside the code that uses the field. It makes
the bodies of the HTTP contract, the options of the command line with their help, the client's signatures and the forms
of the page.
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
import sys
from typing import get_type_hints


def resolve_hint(science: type, field: Field[object]) -> object:
    """Return the type of one field. Hints of other fields may need modules that are not loaded, and are left alone."""
    # The names in the hint of an inherited field are those of the module that defines the base class.
    stated_by = next(base for base in science.__mro__ if field.name in vars(base).get("__annotations__", {}))
    alone = type("Alone", (), {"__annotations__": {field.name: field.type}, "__module__": stated_by.__module__})
    return get_type_hints(alone, vars(sys.modules[stated_by.__module__]))[field.name]


T = TypeVar("T")
# Key of the description in the field's metadata.
_DESCRIPTION_KEY = "said"
LARGEST_SEED = 2**53 - 1
"""The largest whole number that every reader of JSON keeps."""
LARGEST = 1e16
"""Size of any number in a request: nothing of a robot is larger in any unit, and its fourth power can be taken."""


@dataclass(frozen=True)
class Choice:
    """One of the values that a field takes.

    Parameters
    ----------
    name : str
        The value as a request states it.
    label : str
        What people call it.
    words : str
        What it is for, in a line.
    brief : str
        The same in a few words, for a line of help.
    """

    name: str
    label: str = ""
    words: str = ""
    brief: str = ""


class NamedValues(Protocol):
    """A set of names that a field takes one of (`OneOf`, `dynident.schema.registry.Registry`)."""

    @property
    def names(self) -> tuple[str, ...]:
        """All names, in their order."""
        ...

    @property
    def choices(self) -> tuple[Choice, ...]:
        """The names with their descriptions."""
        ...

    def format_help(self) -> str:
        """Return the names with their short descriptions, for a line of help."""
        ...


class OneOf:
    """A fixed set of names that a field takes one of, with their descriptions.

    Parameters
    ----------
    *choices : Choice or str
        The names, with or without descriptions, in the order of lists.
    """

    def __init__(self, *choices: Choice | str) -> None:
        self.choices = tuple(Choice(choice) if isinstance(choice, str) else choice for choice in choices)

    @property
    def names(self) -> tuple[str, ...]:
        """All names, in their order."""
        return tuple(choice.name for choice in self.choices)

    def format_help(self) -> str:
        """Return the names with their short descriptions, for a line of help."""
        return ", ".join(f"{choice.name} ({choice.brief})" if choice.brief else choice.name for choice in self.choices)


@dataclass(frozen=True)
class FieldDescription:
    """The description of a request's field.

    Parameters
    ----------
    words : str
        What the field is, in a line.
    unit : str
        Unit of a number.
    above, at_least, at_most : float, optional
        The range of a number, or of each number in a list.
    fewest, most : int, optional
        How many items a list may have.
    kinds : NamedValues, optional
        The names that the field takes one of.
    option : str
        The option of the command line, where it is not the field's own name; "-" where there is none.
    local : bool
        True for what concerns one machine only and is not sent to another.
    """

    words: str = ""
    unit: str = ""
    above: float | None = None
    at_least: float | None = None
    at_most: float | None = None
    fewest: int | None = None
    most: int | None = None
    kinds: NamedValues | None = None
    option: str = ""
    local: bool = False

    @property
    def sentence(self) -> str:
        """The description with the unit."""
        return f"{self.words}, in {self.unit}" if self.words and self.unit else self.words or self.unit

    def accepts(self, value: float) -> bool:
        """Check whether a number is finite, of a plausible size and within the range.

        Parameters
        ----------
        value : float
            In the field's unit.

        Returns
        -------
        bool
        """
        return (
            # The first comparison is false for NaN and for infinities, too: neither can be given to any field.
            -LARGEST <= value <= LARGEST
            and (self.above is None or value > self.above)
            and (self.at_least is None or value >= self.at_least)
            and (self.at_most is None or value <= self.at_most)
        )

    @property
    def range_text(self) -> str:
        """The range in words."""
        if self.above is None and self.at_least is None and self.at_most is None:
            return f"{-LARGEST:g} to {LARGEST:g}"
        if self.at_least is not None and self.at_most is not None:
            return f"{self.at_least:g} to {self.at_most:g}"
        ends = (("above", self.above), ("at least", self.at_least), ("at most", self.at_most))
        return " and ".join(f"{words} {end:g}" for words, end in ends if end is not None)


class FieldOptions(TypedDict, total=False):
    """The keyword arguments of `declare_field`: the fields of `FieldDescription` except its words."""

    unit: str
    above: float | None
    at_least: float | None
    at_most: float | None
    fewest: int | None
    most: int | None
    kinds: NamedValues | None
    option: str
    local: bool


def declare_field(
    words: str = "",
    *,
    default: T | Missing = MISSING,
    made_by: Callable[[], T] | None = None,
    **more: Unpack[FieldOptions],
) -> T:
    """Declare a dataclass's field together with its description.

    Parameters
    ----------
    words : str
        What the field is, in a line, without a full stop.
    default, made_by
        The default, or the function that makes it.
    more
        As `FieldDescription` has it: unit, above, at_least, at_most, fewest, most, kinds, option, local.

    Returns
    -------
    dataclasses.Field
        Typed as the field's value, so that it can stand as the default of an annotated field.
    """
    return _make_field(FieldDescription(words, **more), default, made_by)


def get_description(request_field: Field[T]) -> FieldDescription:
    """Return the description of a dataclass's field; an empty one where the field was declared without.

    Parameters
    ----------
    request_field : dataclasses.Field
        A field of any dataclass.

    Returns
    -------
    FieldDescription
        Words, unit and range.
    """
    description: FieldDescription = request_field.metadata.get(_DESCRIPTION_KEY, _NO_DESCRIPTION)
    return description


def redescribe_field(request_field: Field[T], words: str) -> T:
    """Copy a field with another description.

    Parameters
    ----------
    request_field : dataclasses.Field
        The field, as another request declares it.
    words : str
        What the field is, in a line.

    Returns
    -------
    dataclasses.Field
        With the default and every other property of `request_field`.
    """
    # A field has a default or a factory, never both.
    made_by = None if request_field.default_factory is MISSING else request_field.default_factory
    return _make_field(replace(get_description(request_field), words=words), request_field.default, made_by)


def redeclare_field(
    request: type[DataclassInstance],
    name: str,
    *,
    default: T | Missing = MISSING,
    made_by: Callable[[], T] | None = None,
) -> T:
    """Declare the field of a request that changes an earlier one, described as in the earlier request.

    Parameters
    ----------
    request : type
        The dataclass that declares the field first.
    name : str
        The field's name there.
    default, made_by
        The value that leaves the earlier request unchanged, or the function that makes it.

    Returns
    -------
    dataclasses.Field
        The field, typed as its value.
    """
    description = next(
        get_description(request_field) for request_field in fields(request) if request_field.name == name
    )
    return declare_field(description.words, default=default, made_by=made_by)


def get_default(request_field: Field[T]) -> T | Missing:
    """Return a field's default; `MISSING` where it has none.

    Parameters
    ----------
    request_field : dataclasses.Field
        Its default factory is called, if it has one.

    Returns
    -------
    object
        The default, made anew where the field has a factory.
    """
    return request_field.default if request_field.default_factory is MISSING else request_field.default_factory()


def check_ranges(request: DataclassInstance, within: str = "") -> None:
    """Check that all numbers of a request, and of its parts, are within the ranges of their fields.

    Parameters
    ----------
    request : dataclass instance
        An instance; parts of it that are requests themselves are checked, too.
    within : str
        JSON pointer to the request, "" at the top.

    Raises
    ------
    DynidentError
        For the first number out of range, or the first list of a wrong length; its pointer names the place.
    """
    for request_field in fields(request):
        # Fields that were declared without a description have no range to check.
        if _DESCRIPTION_KEY in request_field.metadata:
            _check_values(
                getattr(request, request_field.name),
                request_field.name,
                get_description(request_field),
                f"{within}/{request_field.name}",
            )


def _check_values(value: object, name: str, description: FieldDescription, pointer: str) -> None:
    """Check the value of one field: a number, another request, or several of them."""
    if isinstance(value, (int, float)):
        # For Python a bool is an int. It has no range.
        if not (isinstance(value, bool) or description.accepts(value)):
            raise DynidentError(
                f"{name} is {_format_number(value)}; it must be {description.range_text}", pointer=pointer
            )
    elif isinstance(value, Mapping):
        for key, item in value.items():
            _check_values(item, f"{name} of {key}", description, f"{pointer}/{_escape_key(key)}")
    elif isinstance(value, (tuple, list)):
        most = len(value) if description.most is None else description.most
        if not (description.fewest or 0) <= len(value) <= most:
            ends = (("at least", description.fewest), ("at most", description.most))
            allowed = " and ".join(f"{words} {end}" for words, end in ends if end is not None)
            raise DynidentError(f"{name} has {len(value)} items; it must have {allowed}", pointer=pointer)
        for index, item in enumerate(value):
            _check_values(item, name, description, f"{pointer}/{index}")
    # `is_dataclass` is true for the class itself, too, which has no values to check.
    elif is_dataclass(value) and not isinstance(value, type):
        check_ranges(value, pointer)


def _escape_key(key: object) -> str:
    """Escape a key for use in a JSON pointer (RFC 6901)."""
    # "~" has to be replaced first, since the escape of "/" contains one.
    return str(key).replace("~", "~0").replace("/", "~1")


def _format_number(value: float) -> str:
    # Python refuses to write whole numbers of very many digits.
    return "too large" if isinstance(value, int) and abs(value) > LARGEST else str(value)


def _make_field(description: FieldDescription, default: T | Missing, made_by: Callable[[], T] | None) -> T:
    metadata = {_DESCRIPTION_KEY: description}
    if made_by is not None:
        return field(default_factory=made_by, metadata=metadata)
    if default is not MISSING:
        return field(default=default, metadata=metadata)
    # A field is typed as its value, as dataclasses.field itself is in the stubs of the standard library.
    declared_field: T = field(metadata=metadata)
    return declared_field


_NO_DESCRIPTION = FieldDescription()
