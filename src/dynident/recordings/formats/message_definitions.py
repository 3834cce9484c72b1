"""Definitions of message types that files bring along, parsed within limits.

The package that reads messages turns a definition into a program, in which arrays of fixed length are written out.
Here nothing but names of fields and their types gets there, and no type that holds itself or is larger than a message.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from dynident.recordings.file_limits import DEEPEST, LARGEST_DEFINITION, MOST_COLUMNS
from dynident.recordings.formats.packed_messages import normalise_type

if TYPE_CHECKING:
    from rosbags.interfaces.typing import Typesdict

_BETWEEN = "=" * 80 + "\n"


def parse_definition(definition: str, type_name: str, known: Typesdict) -> Typesdict:
    """Parse the types of a definition that are not known yet.

    Parameters
    ----------
    definition : str
        That of a type, with those of its parts behind it.
    type_name : str
    known : mapping
        Types that need no definition.

    Returns
    -------
    mapping
        Of the names of types to their fields.

    Raises
    ------
    ValueError
        The text is too long, or a type holds itself or more numbers than a recording has columns.
    """
    from rosbags.typesys import get_types_from_msg

    if len(definition) > LARGEST_DEFINITION:
        raise ValueError(f"the definition of {type_name} has {len(definition)} characters")
    first, *others = definition.split(_BETWEEN)
    parsed = get_types_from_msg(first, type_name)
    for other in others:
        head, _, text = other.partition("\n")
        parsed |= get_types_from_msg(text, normalise_type(head.removeprefix("MSG: ").strip()))
    # Constants say nothing of how a message is stored.
    types: Typesdict = {name: ([], fields) for name, (_, fields) in parsed.items() if name not in known}
    _TypeSizes({**known, **types}).measure_type(type_name, ())
    return types


class _TypeSizes:
    """Counts the numbers in a message of a type, without those in sequences."""

    def __init__(self, types: Typesdict) -> None:
        self._types = types
        self._sizes: dict[str, int] = {}

    def measure_type(self, name: str, within: tuple[str, ...]) -> int:
        if name in within or len(within) > DEEPEST:
            raise ValueError(f"the type {name} holds itself, or types more than {DEEPEST} deep")
        if name not in self._types:
            raise ValueError(f"the type {name} is not defined")
        if name not in self._sizes:
            fields = self._types[name][1]
            # An array of an empty type costs, too: every type counts as one number at least.
            size = max(1, sum(self._measure_field(kind, (*within, name)) for _, kind in fields))
            if size > MOST_COLUMNS:
                raise ValueError(f"the type {name} holds {size} numbers; at most {MOST_COLUMNS} are read")
            self._sizes[name] = size
        return self._sizes[name]

    def _measure_field(self, kind: Any, within: tuple[str, ...]) -> int:
        node, inner = kind
        if node.name == "BASE":
            return 1
        if node.name == "NAME":
            return self.measure_type(inner, within)
        element = self._measure_field(inner[0], within)
        return element * max(int(inner[1]), 1) if node.name == "ARRAY" else element
