"""Tables with named columns and rows, their conversion to data frames of pandas or polars, texts, results of a test.

This library needs neither package: a table prints itself and is indexed by name.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self, TypeVar, cast, overload

import numpy as np
from numpy.typing import NDArray

from dynident.api.argument_checks import CheckedResult
from dynident.errors import DynidentError, suggest_names
from dynident.estimation.backward_elimination import WaldTest
from dynident.file_output import TABLE_ENDINGS, check_ending
from dynident.number_format import format_number
from dynident.optional_dependencies import format_install_hint
from dynident.text_and_html_tables import format_text_table, join_html, render_paragraph, render_table
from dynident.text_encoding import escape_surrogates

if TYPE_CHECKING:
    # For type checkers and editors alone: users have one of them, or none.
    import pandas
    import polars

Item = TypeVar("Item")
FrameLibrary = Literal["pandas", "polars"]
_LIBRARIES: tuple[FrameLibrary, ...] = ("pandas", "polars")
_SHOWN_ROWS, _WIDTH = 30, 98
"""Rows and characters of a table that is printed: a screen of a terminal or a notebook."""


def describe_missing(kind: str, name: str, known: Collection[str], groupings: Mapping[str, str]) -> str:
    """Return the sentence about a name that a table does not have.

    Parameters
    ----------
    kind : str
        What it should name, such as "parameter".
    name : str
        The name that was asked for.
    known : collection of str
        The names that there are.
    groupings : mapping of str to str
        Sums that names stand for, such as "XX2 - YY2 - 0.37 M3".
    """
    sums = [whole for whole, grouping in groupings.items() if name in grouping.split()]
    if sums:
        return (
            f"{name!r} cannot be identified by itself; it is only in the sums {', '.join(sums)} "
            f"(model.parameters[{sums[0]!r}].grouping). model.export writes one possible value of it"
        )
    nearest = suggest_names(name, known) or "."
    return f"there is no {kind} {name!r}{nearest} There are: {', '.join(known)}"


class Items(Sequence[Item]):
    """Base class of results that hold several: by number, by name where they have one, and by slice."""

    items: tuple[Item, ...]

    def __len__(self) -> int:
        return len(self.items)

    def __iter__(self) -> Iterator[Item]:
        return iter(self.items)

    @overload
    def __getitem__(self, index: int | str) -> Item: ...
    @overload
    def __getitem__(self, index: slice) -> Self: ...
    def __getitem__(self, index: int | str | slice) -> Item | Self:
        if isinstance(index, slice):
            return cast(Self, replace(cast(Any, self), items=self.items[index]))
        if isinstance(index, str):
            names = self._list_names()
            if index not in names:
                raise KeyError(self._describe_missing(index))
            return self.items[names.index(index)]
        return self.items[index]

    def _list_names(self) -> list[str]:
        return [getattr(item, "name", str(number)) for number, item in enumerate(self.items)]

    def _describe_missing(self, name: str) -> str:
        return f"there is no {name!r}; there are: {', '.join(self._list_names())}"


class Framed(CheckedResult, ABC):
    """Base class of results that are tables; each subclass states its columns and rows."""

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
            Where the library, or any of the two, is not installed. `to_table` needs neither.
        """
        return _build_frame(self._columns(), library)

    @property
    def loc(self) -> pandas.core.indexing._LocIndexer:
        """Rows by their names, with the columns of `to_frame("pandas")`: `model.bse.loc["Fc1"]`; it needs pandas."""
        frame = self.to_frame("pandas")
        names = self._list_names() if isinstance(self, Items) else []
        # Items without names of their own are listed by number, as the rows of the frame are.
        if len(names) == len(frame) and names != [str(k) for k in range(len(names))]:
            frame = frame.set_axis(names, axis=0)
        return frame.loc

    def to_table(self) -> Table:
        """Return the same columns as a table of this library, which needs neither pandas nor polars.

        Returns
        -------
        Table
            It is indexed by the names of columns: `table["t"]`.
        """
        return self._columns()

    def save(self, path: str | Path) -> None:
        """Write the columns of `to_table` as .csv or .parquet.

        Parameters
        ----------
        path : path
            The file to write; its ending decides on the format. Names of rows become the first column.

        Raises
        ------
        DynidentError
            For another ending, or a folder that does not exist.
        """
        # Imported here: a table that is only printed can do without Arrow.
        import pyarrow as pa

        from dynident.recordings.arrow_tables import write_table

        path, columns = check_ending(path, TABLE_ENDINGS), _name_rows(self._columns())
        # Names come from files and may hold lone surrogates, which no table takes.
        write_table(pa.table({_escape(name): _escape_texts(values) for name, values in columns.items()}), path)

    @abstractmethod
    def _columns(self) -> Table: ...


@dataclass(frozen=True, eq=False)
class Table(Framed):
    """Named columns of the same length; the rows may have names, too.

    `table["name"]` is a column as an array (m,), or else the row of this name: an array, or a number where the table
    has one column. `table["row", "column"]` is one entry. NumPy takes a table as an array: `numpy.asarray(table)`.

    Parameters
    ----------
    columns : mapping of column name to values
        The columns, each of the same length.
    units : mapping of name to unit
        Units of columns that have one for all their rows, or of rows by their names.
    labels : sequence of str
        Names of the rows; empty where they have none.
    label_name : str
        What the names of the rows are, as the head of their column.
    title : str
        What the table holds.
    groupings : mapping of str to str
        Sums that rows stand for, by the names of the rows. The error about a name that is only in such sums says so.

    Examples
    --------
    >>> from dynident.api.named_tables import Table
    >>> table = Table({"value": [2.0, 0.5]}, labels=("Fc1", "Fv1"))
    >>> table["Fc1"]
    2.0
    >>> dict(table.items())
    {'Fc1': 2.0, 'Fv1': 0.5}
    """

    columns: Mapping[str, Sequence[object] | NDArray[np.generic]]
    units: Mapping[str, str] = field(default_factory=dict)
    labels: Sequence[str] = ()
    label_name: str = "name"
    title: str = ""
    groupings: Mapping[str, str] = field(default_factory=dict)

    def keys(self) -> tuple[str, ...]:
        """Return the names of the rows; where rows have none, those of the columns."""
        return tuple(self.labels) or tuple(self.columns)

    def items(self) -> Iterator[tuple[str, object]]:
        """Yield each of `keys` with its row, or its column."""
        return ((name, self[name]) for name in self.keys())

    def __iter__(self) -> Iterator[str]:
        return iter(self.keys())

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    def __contains__(self, name: object) -> bool:
        return name in self.columns or name in self.labels

    def __getitem__(self, name: str | tuple[str, str]) -> Any:
        if isinstance(name, tuple):
            row, column = name
            return _to_python(self._get_column(column)[self._find_row(row)])
        if name in self.columns:
            return self._get_column(name)
        row_number = self._find_row(name)
        row_values = [self._get_column(column)[row_number] for column in self.columns]
        return _to_python(row_values[0]) if len(row_values) == 1 else np.array(row_values)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        arrays = [self._get_column(name) for name in self.columns]
        array = arrays[0] if len(arrays) == 1 else np.column_stack(arrays)
        return array if dtype is None else array.astype(dtype)

    def _columns(self) -> Table:
        return self

    def _get_column(self, name: str) -> Any:
        if name not in self.columns:
            raise KeyError(describe_missing("column", name, self.columns, self.groupings))
        values = self.columns[name]
        return values if isinstance(values, np.ndarray) else np.array(values)

    def _find_row(self, name: object) -> int:
        if name not in self.labels:
            raise KeyError(describe_missing(self.label_name, str(name), self.keys(), self.groupings))
        return tuple(self.labels).index(str(name))

    def __repr__(self) -> str:
        heads, rows = self._format_rows(_SHOWN_ROWS)
        n_columns = _count_fitting(heads, rows)
        left_out = len(heads) - n_columns
        title = self.title or f"Table({len(self)} rows)"
        if left_out:
            title += f"; {left_out} more columns (.columns)"
        return format_text_table(
            title, heads[:n_columns], [row[:n_columns] for row in rows], len(self), right_from=bool(self.labels)
        )

    def _repr_html_(self) -> str:
        heads, rows = self._format_rows(_SHOWN_ROWS)
        left_out = len(self) - len(rows)
        return join_html(
            render_paragraph(self.title, strong=True) if self.title else "",
            render_table(heads, rows, right_from=bool(self.labels)),
            render_paragraph(f"… and {left_out} more rows") if left_out else "",
        )

    def _format_rows(self, most: int) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
        heads = tuple(f"{name} ({self.units[name]})" if name in self.units else name for name in self.columns)
        columns = [self._get_column(name)[:most] for name in self.columns]
        rows = [tuple(_format_cell(value) for value in row) for row in zip(*columns, strict=True)]
        if not self.labels:
            return heads, rows
        heads, named = (self.label_name, *heads), list(zip(self.labels, rows, strict=False))
        # Units of columns stand in their heads, those of rows in a column of their own.
        if set(self.units) <= set(self.columns):
            return heads, [(label, *row) for label, row in named]
        return (*heads, "unit"), [(label, *row, self.units.get(label, "")) for label, row in named]


def build_columns(names: Sequence[str], rows: Sequence[Sequence[object]]) -> Table:
    """Return rows as named columns.

    Parameters
    ----------
    names : sequence of str
        Names of the columns.
    rows : sequence of sequences
        One sequence a row, each as long as `names`.

    Returns
    -------
    Table
        The same values, column by column; without units.
    """
    return Table({name: [row[k] for row in rows] for k, name in enumerate(names)})


def _name_rows(table: Table) -> dict[str, Sequence[object] | NDArray[np.generic]]:
    """Return the columns with the names of the rows as the first of them."""
    return {**({table.label_name: list(table.labels)} if table.labels else {}), **table.columns}


def _escape_texts(values: Sequence[object] | NDArray[np.generic]) -> Sequence[object] | NDArray[np.generic]:
    # Signals are long, and hold numbers alone.
    is_signal = isinstance(values, np.ndarray) and values.dtype.kind in "biuf"
    return values if is_signal else list(map(_escape, values))


def _escape(value: Any) -> Any:
    return escape_surrogates(value) if isinstance(value, str) else value


def _to_python(value: object) -> object:
    """Return a number of NumPy as one of Python, which prints itself as a number alone."""
    return value.item() if isinstance(value, np.generic) else value


def _format_cell(value: object) -> str:
    if value is None:
        return "–"
    if isinstance(value, (float, np.floating)):
        return "–" if np.isnan(value) else format_number(float(value))
    return str(value)


def _count_fitting(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> int:
    """Return how many leading columns fit on a line; at least two."""
    widths = np.cumsum([2 + max(len(row[k]) for row in (heads, *rows)) for k in range(len(heads))])
    return max(2, int(np.searchsorted(widths, _WIDTH, side="right")))


def _build_frame(table: Table, library: FrameLibrary | None) -> pandas.DataFrame | polars.DataFrame:
    if library is not None and library not in _LIBRARIES:
        raise DynidentError(f"data frames of {library!r} are not supported; choose pandas or polars", pointer="library")
    for name in (library,) if library else _LIBRARIES:
        # Imported by name and only now, as the library works without both.
        try:
            module = import_module(name)
        except ModuleNotFoundError as missing:
            # The library is installed but lacks a package of its own: that is another fault.
            if missing.name != name:
                raise
            continue
        if name == "pandas":
            frame: pandas.DataFrame = module.DataFrame(dict(table.columns))
            if table.labels:
                frame.index = module.Index(list(table.labels), name=table.label_name)
            if table.units:
                frame.attrs["units"] = dict(table.units)
            return frame
        columns: polars.DataFrame = module.DataFrame(_name_rows(table))
        return columns
    wanted = library or "pandas or polars"
    hint = "install it with: pip install polars" if library == "polars" else format_install_hint("pandas")
    raise DynidentError(
        f"a data frame needs {wanted}, which is not installed; {hint}. to_table() gives the same columns without it",
        title="Not installed",
    )


class PlainText(str):
    """A text that a console and a notebook show as it is printed, with its line breaks.

    Calling it returns it, so that `summary` may be read as an attribute or called as a method, of every result.
    """

    def __call__(self) -> PlainText:
        """Return the text itself."""
        return self

    def __repr__(self) -> str:
        return str(self)


@dataclass(frozen=True)
class FTest:
    """Result of an F test: of a model against a smaller one, or of values of its parameters.

    Parameters
    ----------
    f_value : float
        The statistic.
    p_value : float
        Probability that noise alone makes it as large, if the smaller model, or the values, are right.
    df_diff : int
        Number of conditions that are tested.
    df_resid : float
        Degrees of freedom with which the residual's variance is known.
    """

    f_value: float
    p_value: float
    df_diff: int
    df_resid: float

    @classmethod
    def from_test(cls, test: WaldTest) -> FTest:
        """Return the test by statsmodels' names."""
        return cls(test.statistic, test.p_value, test.count, test.freedom)

    def __iter__(self) -> Iterator[float]:
        # As statsmodels gives it: f_value, p_value, df_diff = ….
        return iter((self.f_value, self.p_value, self.df_diff))
