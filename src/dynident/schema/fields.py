"""`declare_field` and `Request`: a request field's words, unit, range and default, stated once; their checks.

A request is a frozen dataclass of the kind `Request`. The description of each field stands beside the code that uses
the field. It makes the bodies of the HTTP contract, the options of the command line with their help, the client's
signatures and the forms of the page; and a request that is made with a value out of its range is refused, whoever
makes it.

These are plain dataclasses and not pydantic's: pydantic takes 0.1 s to import and as long again to build the schemas of
all requests, as much as the whole help of a command takes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sized
from contextlib import contextmanager, suppress
from dataclasses import MISSING, Field, dataclass, field, fields, replace
from functools import cache
from typing import TYPE_CHECKING, Literal, Protocol, Self, TypeAlias, TypedDict, TypeVar, Unpack

from dynident.errors import DynidentError, check_names, convert_value

if TYPE_CHECKING:
    from dataclasses import _MISSING_TYPE

    from _typeshed import DataclassInstance

    Missing: TypeAlias = Literal[_MISSING_TYPE.MISSING]
import sys


def resolve_hint(science: type, field: Field[object]) -> object:
    """Return the type of one field. Hints of other fields may need modules that are not loaded, and are left alone.

    Parameters
    ----------
    science : type
        The dataclass, or one derived from it, that declares the field.
    field : Field
        The field.

    Returns
    -------
    object
        The type, such as `float | None`.
    """
    # The names in the hint of an inherited field are those of the module that defines the base class.
    stated_by = next(base for base in science.__mro__ if field.name in vars(base).get("__annotations__", {}))
    hint: object = field.type
    return eval(hint, vars(sys.modules[stated_by.__module__])) if isinstance(hint, str) else hint


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
    nonzero : bool
        Whether zero is no value, though it is within the range.
    fewest, most : int, optional
        How many items a list may have.
    kinds : NamedValues, optional
        The names that the field takes one of.
    option : str
        The option of the command line, where it is not the field's own name; "-" where there is none.
    local : bool
        True for what concerns one machine only and is not sent to another.
    label : str
        What a form calls the field, where its name is too short to be understood.
    """

    words: str = ""
    unit: str = ""
    above: float | None = None
    at_least: float | None = None
    at_most: float | None = None
    nonzero: bool = False
    fewest: int | None = None
    most: int | None = None
    kinds: NamedValues | None = None
    option: str = ""
    local: bool = False
    label: str = ""

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
            and not (self.nonzero and value == 0)
        )

    @property
    def has_range(self) -> bool:
        """Whether a range is stated that is narrower than that of any number."""
        return any(end is not None for end in (self.above, self.at_least, self.at_most))

    @property
    def range_text(self) -> str:
        """The range in words."""
        but = " but 0" if self.nonzero else ""
        most = LARGEST if self.at_most is None else self.at_most
        if self.above is not None:
            return f"above {self.above:g} and at most {most:g}{but}"
        return f"{-LARGEST if self.at_least is None else self.at_least:g} to {most:g}{but}"

    @property
    def range_schema(self) -> dict[str, object]:
        """The range as JSON Schema writes it."""
        lowest = -LARGEST if self.at_least is None else self.at_least
        least = {"minimum": lowest} if self.above is None else {"exclusiveMinimum": self.above}
        most = {"maximum": LARGEST if self.at_most is None else self.at_most}
        return least | most | ({"not": {"const": 0}} if self.nonzero else {})


class FieldOptions(TypedDict, total=False):
    """The keyword arguments of `declare_field`: the fields of `FieldDescription` except its words."""

    unit: str
    above: float | None
    at_least: float | None
    at_most: float | None
    nonzero: bool
    fewest: int | None
    most: int | None
    kinds: NamedValues | None
    option: str
    local: bool
    label: str


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
        As `FieldDescription` has it: unit, range, length, kinds, option, local, label.

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
    return _make_field(get_description(get_field(request, name)), default, made_by)


def get_field(request: type[DataclassInstance], name: str) -> Field[object]:
    """Return the field of a request by its name.

    Parameters
    ----------
    request : type
        The dataclass.
    name : str
        Name of one of its fields.

    Returns
    -------
    dataclasses.Field
        The field.
    """
    return next(request_field for request_field in fields(request) if request_field.name == name)


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


class Request:
    """Base of the dataclasses that state a request: a value that its field does not take is refused.

    Library, HTTP and command line make the same objects, so that they decide alike. Values are converted to the types
    of the fields before they are checked (`dynident.errors.convert_value`); subclasses with checks of their own
    therefore call `super().__post_init__()` first.

    Raises
    ------
    DynidentError
        For the first value of a wrong type, number out of range, list of a wrong length, or unknown name; its pointer
        names the place.
    """

    def __new__(cls, *_: object, **given: object) -> Self:
        """Refuse unknown names: the error of `__init__` does not tell the known ones."""
        check_names(cls.__name__, given, [request_field.name for request_field in fields(cls)])  # type: ignore[arg-type]
        return super().__new__(cls)

    def __post_init__(self) -> None:
        # A base class is no dataclass itself, only what derives from it is.
        for name, hint in _find_types(type(self)).items():  # type: ignore[arg-type]
            object.__setattr__(self, name, convert_value(getattr(self, name), hint, name, f"/{name}"))
        for request_field in fields(self):  # type: ignore[arg-type]
            # Fields that were declared without a description have no range to check.
            if _DESCRIPTION_KEY in request_field.metadata:
                name = request_field.name
                _check_field(getattr(self, name), name, get_description(request_field))


@cache
def _find_types(request: type[DataclassInstance]) -> Mapping[str, object]:
    types = {}
    for request_field in fields(request):
        # Some hints name what only type checkers import.
        with suppress(NameError):
            types[request_field.name] = resolve_hint(request, request_field)
    return types


def check_value(request: type[DataclassInstance], name: str, value: object) -> None:
    """Check a value that stands for one field of a request, as the request itself would.

    Parameters
    ----------
    request : type
        The dataclass of the request.
    name : str
        Name of the field.
    value : object
        The value.

    Raises
    ------
    DynidentError
        Where the field does not take the value.
    """
    converted = convert_value(value, _find_types(request)[name], name, f"/{name}")
    _check_field(converted, name, get_description(get_field(request, name)))


def describe_refusal(name: str, value: float, description: FieldDescription) -> str:
    """Return the sentence about a number that is out of its range.

    Parameters
    ----------
    name : str
        Name of the field.
    value : float
        The number.
    description : FieldDescription
        The field's range.
    """
    return f"{name} is {_format_number(value)}; it must be {description.range_text}"


@contextmanager
def point_within(pointer: str) -> Iterator[None]:
    """Let errors about a part of a request point at their place in the whole.

    Parameters
    ----------
    pointer : str
        JSON pointer to the part.
    """
    try:
        yield
    except DynidentError as error:
        error.pointer = pointer + error.pointer
        raise


def _check_field(value: object, name: str, description: FieldDescription) -> None:
    # A text has a length, as a list has; the texts in a list have none of their own.
    if isinstance(value, str):
        _check_length(value, "characters", name, description, f"/{name}")
    _check_values(value, name, description, f"/{name}")


def _check_length(value: Sized, items: str, name: str, description: FieldDescription, pointer: str) -> None:
    most = len(value) if description.most is None else description.most
    if not (description.fewest or 0) <= len(value) <= most:
        ends = (("at least", description.fewest), ("at most", description.most))
        allowed = " and ".join(f"{words} {end}" for words, end in ends if end is not None)
        raise DynidentError(f"{name} has {len(value)} {items}; it must have {allowed}", pointer=pointer)


def _check_values(value: object, name: str, description: FieldDescription, pointer: str) -> None:
    """Check the value of one field: a number, a name, or several of them. Parts that are requests check themselves."""
    if isinstance(value, (int, float)):
        # For Python a bool is an int. It has no range.
        if not (isinstance(value, bool) or description.accepts(value)):
            raise DynidentError(describe_refusal(name, value, description), pointer=pointer)
    elif isinstance(value, str):
        if description.kinds is not None and value not in description.kinds.names:
            choices = ", ".join(description.kinds.names)
            raise DynidentError(f"there is no {name} {value!r}; choose from: {choices}", pointer=pointer)
    elif isinstance(value, Mapping):
        for key, item in value.items():
            _check_values(item, f"{name} of {key}", description, f"{pointer}/{_escape_key(key)}")
    elif isinstance(value, (tuple, list)):
        _check_length(value, "items", name, description, pointer)
        for index, item in enumerate(value):
            _check_values(item, name, description, f"{pointer}/{index}")


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
