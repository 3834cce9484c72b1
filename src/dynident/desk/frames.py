"""Tables as data frames of pandas or polars, whichever is there: the project itself needs neither."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any, Literal

from dynident.errors import DynidentError

FrameLibrary = Literal["pandas", "polars"]
_LIBRARIES: tuple[FrameLibrary, ...] = ("pandas", "polars")


def frame_of(columns: Mapping[str, Sequence[object]], library: FrameLibrary | None) -> Any:
    """A data frame with these columns.

    Parameters
    ----------
    columns : mapping of name to values
    library : "pandas", "polars" or None
        None: pandas where it is installed, else polars.

    Raises
    ------
    DynidentError
        Where the library, or any of the two, is not installed.
    """
    if library is not None and library not in _LIBRARIES:
        raise DynidentError(f"there are no frames of {library!r}; choose pandas or polars", pointer="library")
    for name in (library,) if library else _LIBRARIES:
        try:
            return import_module(name).DataFrame(dict(columns))
        except ModuleNotFoundError as missing:
            if missing.name != name:
                raise
    wanted = library or "pandas or polars"
    install = f"pip install {library}" if library else "pip install pandas, or pip install polars"
    raise DynidentError(f"a data frame needs {wanted}, which is not installed: {install}", title="Not installed")
