"""Tables as data frames of pandas or polars, whichever is there: the project itself needs neither."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from types import MappingProxyType
from typing import Any, Literal

from numpy.typing import NDArray

from dynident.errors import DynidentError

FrameLibrary = Literal["pandas", "polars"]
_NONE: Mapping[str, str] = MappingProxyType({})
_LIBRARIES: tuple[FrameLibrary, ...] = ("pandas", "polars")


def columns_of(names: Sequence[str], rows: Sequence[Sequence[object]]) -> dict[str, list[object]]:
    """Rows as columns of these names."""
    return {name: [row[k] for row in rows] for k, name in enumerate(names)}


def frame_of(
    columns: Mapping[str, Sequence[object] | NDArray[Any]],
    library: FrameLibrary | None,
    units: Mapping[str, str] = _NONE,
) -> Any:
    """A data frame with these columns.

    Parameters
    ----------
    columns : mapping of name to values
    library : "pandas", "polars" or None
        None: pandas where it is installed, else polars.
    units : mapping of name to unit
        Of pandas they are in `frame.attrs["units"]`; frames of polars have no place for them.

    Raises
    ------
    DynidentError
        Where the library, or any of the two, is not installed.
    """
    if library is not None and library not in _LIBRARIES:
        raise DynidentError(f"there are no frames of {library!r}; choose pandas or polars", pointer="library")
    for name in (library,) if library else _LIBRARIES:
        try:
            made = import_module(name).DataFrame(dict(columns))
        except ModuleNotFoundError as missing:
            if missing.name != name:
                raise
            continue
        if units and name == "pandas":
            made.attrs["units"] = dict(units)
        return made
    wanted = library or "pandas or polars"
    install = f"pip install {library}" if library else "pip install pandas, or pip install polars"
    raise DynidentError(f"a data frame needs {wanted}, which is not installed: {install}", title="Not installed")
