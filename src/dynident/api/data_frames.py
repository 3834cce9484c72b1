"""Tables as data frames of pandas or polars, whichever is installed; this library needs neither."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import TYPE_CHECKING, Literal, overload

import numpy as np
from numpy.typing import NDArray

from dynident.errors import DynidentError

if TYPE_CHECKING:
    # For type checkers and editors alone: users have one of them, or none.
    import pandas
    import polars

FrameLibrary = Literal["pandas", "polars"]
_LIBRARIES: tuple[FrameLibrary, ...] = ("pandas", "polars")


@dataclass(frozen=True, eq=False)
class Columns:
    """Named columns of the same length, with the unit of each that has one.

    Parameters
    ----------
    values : mapping of column name to values
        The columns, each of the same length.
    units : mapping of column name to unit
        Units of columns that have one for all their rows; a column whose unit differs by row is not in it.
    """

    values: Mapping[str, Sequence[object] | NDArray[np.generic]]
    units: Mapping[str, str] = field(default_factory=dict)


def build_columns(names: Sequence[str], rows: Sequence[Sequence[object]]) -> Columns:
    """Return rows as named columns.

    Parameters
    ----------
    names : sequence of str
        Names of the columns.
    rows : sequence of sequences
        One sequence a row, each as long as `names`.

    Returns
    -------
    Columns
        The same values, column by column; without units.
    """
    return Columns({name: [row[k] for row in rows] for k, name in enumerate(names)})


class Framed(ABC):
    """Base class of results that can be turned into a data frame; each subclass states its columns and rows."""

    @overload
    def to_frame(self, library: Literal["pandas"]) -> pandas.DataFrame: ...
    @overload
    def to_frame(self, library: Literal["polars"]) -> polars.DataFrame: ...
    @overload
    def to_frame(self, library: FrameLibrary | None = None) -> pandas.DataFrame | polars.DataFrame: ...
    def to_frame(self, library: FrameLibrary | None = None) -> pandas.DataFrame | polars.DataFrame:
        """Return a data frame of pandas or polars, with the columns that the class states.

        Parameters
        ----------
        library : "pandas", "polars" or None
            None: pandas where it is installed, else polars.

        Returns
        -------
        data frame
            With pandas the units are in `frame.attrs["units"]`, where columns have one each; polars has no place for
            them.

        Raises
        ------
        DynidentError
            Where the library, or any of the two, is not installed.
        """
        return _build_frame(self._columns(), library)

    @abstractmethod
    def _columns(self) -> Columns: ...


def _build_frame(columns: Columns, library: FrameLibrary | None) -> pandas.DataFrame | polars.DataFrame:
    if library is not None and library not in _LIBRARIES:
        raise DynidentError(f"data frames of {library!r} are not supported; choose pandas or polars", pointer="library")
    for name in (library,) if library else _LIBRARIES:
        # Imported by name and only now, as the library works without both.
        try:
            frame: pandas.DataFrame | polars.DataFrame = import_module(name).DataFrame(dict(columns.values))
        except ModuleNotFoundError as missing:
            # The library is installed but lacks a package of its own: that is another fault.
            if missing.name != name:
                raise
            continue
        if columns.units and name == "pandas":
            frame.attrs["units"] = dict(columns.units)
        return frame
    libraries = library or "pandas or polars"
    install = f"pip install {library}" if library else "pip install pandas, or pip install polars"
    raise DynidentError(f"a data frame needs {libraries}, which is not installed: {install}", title="Not installed")
