"""Output of a command: results to a file, as JSON or printed on stdout, progress and messages on stderr."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from textwrap import wrap
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

from dynident.file_output import write_atomically
from dynident.progress import Progress as Report
from dynident.progress import ignore_progress
from dynident_cli.shared_options import OutputOptions

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

    from dynident.api.model import Model
    from dynident.api.recording_collection import CheckedRecording
    from dynident.presentation.tables import ReportedTable
    from dynident.verdict import ModelVerdict

_MESSAGE = 40
_WIDE = 120


class _SentenceConsole(Console):
    """A console that breaks lines between words only: a path or a command stays whole, to be copied."""

    def print(self, *objects: Any, **options: Any) -> None:
        """Print objects as `rich` does; words that are longer than a line go beyond its end."""
        if all(isinstance(item, str) for item in objects) and not options.get("soft_wrap"):
            text = " ".join(objects)
            lines = [line for part in text.split("\n") for line in _wrap_sentence(part, self.width) or [""]]
            objects, options = ("\n".join(lines),), {**options, "soft_wrap": True}
        super().print(*objects, **options)


def _wrap_sentence(text: str, width: int) -> list[str]:
    return wrap(text, width, break_long_words=False, break_on_hyphens=False, replace_whitespace=False)


def result_console() -> Console:
    """Return the console for results, names of users in them as they are; into a file or a pipe lines may be longer."""
    return _SentenceConsole(
        file=sys.stdout, markup=False, highlight=False, width=None if sys.stdout.isatty() else _WIDE
    )


def message_console() -> Console:
    """Return the console for everything else."""
    return _SentenceConsole(file=sys.stderr, markup=False, highlight=False)


def print_json(document: Mapping[str, object]) -> None:
    """Print a document on stdout, for scripts."""
    sys.stdout.write(json.dumps(document, indent=2, allow_nan=False) + "\n")


@contextmanager
def show_progress_bar(title: str) -> Iterator[Report]:
    """Show a progress bar on stderr, where that is a terminal; it leaves nothing behind."""
    console = message_console()
    # A log would be filled with control characters.
    if not console.is_terminal:
        yield ignore_progress
        return
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(bar_width=28),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        TextColumn("{task.fields[message]}", style="dim"),
    )
    bar = Progress(*columns, console=console, transient=True)
    with bar:
        yield partial(_advance, bar, bar.add_task(title, total=1.0, message=""))


def _advance(bar: Progress, task: TaskID, fraction: float, message: str) -> None:
    bar.update(task, completed=fraction, message=message[:_MESSAGE])


def print_tables(console: Console, tables: Iterable[ReportedTable]) -> None:
    """Print tables as they are shown elsewhere, without their notes."""
    for table in tables:
        last = len(table.columns) - 1
        # Words in the last column may be long and are wrapped.
        wrapped = None if table.is_figures(last) else last
        console.print(
            build_table(table.title, table.heads, table.texts, right_from=table.numbers_from, wrapped=wrapped)
        )


def build_table(
    title: str,
    columns: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    right_from: int = 1,
    wrapped: int | None = None,
) -> Table:
    """Return a plain table.

    Columns from `right_from` on have figures, which stand at the right and are never wrapped; `wrapped` is another
    column with text, which may be wrapped as those before the figures are.
    """
    rich_table = Table(title=title or None, title_justify="left", title_style="bold", box=None, pad_edge=False)
    for index, column in enumerate(columns):
        is_figure = index >= right_from and index != wrapped
        rich_table.add_column(column, justify="right" if is_figure else "left", no_wrap=is_figure)
    for row in rows:
        rich_table.add_row(*row)
    return rich_table


Document = Mapping[str, object]
Describe = Callable[[], Document]
Show = Callable[[Console], None]


def write_result(
    result: OutputOptions, label: str, described: Describe, show: Show, content: Callable[[], bytes] | None = None
) -> None:
    """Write what came out where it was asked for, its document where there is no `content`, and print it.

    Either is made where it is needed: what describes an answer takes longer to load than a small robot to
    identify.
    """
    # The document is made once, for the file and for the screen.
    document = described() if result.as_json or (result.out is not None and content is None) else {}
    if result.out is not None:
        write_atomically(result.out, content() if content else json.dumps(document, indent=1, allow_nan=False).encode())
    messages = () if result.out is None else (f"{label} written to {result.out}",)
    print_result(result.as_json, lambda: document, show, *messages)


def print_result(as_json: bool, described: Describe, show: Show, *messages: str) -> None:
    """Print what came out: its document for scripts; for people words, and then what was written where."""
    if as_json:
        print_json(described())
        return
    console = result_console()
    show(console)
    for message in messages:
        console.print(message)


def write_model(
    result: OutputOptions,
    label: str,
    model: Model,
    show: Show,
    parent: tuple[str, Model] | None = None,
    verdict: ModelVerdict | None = None,
    recordings: Sequence[CheckedRecording] = (),
) -> None:
    """Write a model, and print it or its document; see `describe_model`."""
    from dynident.identification import to_bytes
    from dynident_cli.contract_documents import describe_model

    write_result(
        result,
        label,
        lambda: describe_model(model, parent, verdict, recordings),
        show,
        lambda: to_bytes(model.identification),
    )
