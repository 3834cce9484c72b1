"""Tables of recordings, their checks, and the guesses about the columns of a file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from dynident.errors import Remedy, word_remedies
from dynident.number_format import format_count, format_percent
from dynident.presentation.labels import format_standstill_shares
from dynident.presentation.tables import Cell, Mark, ReportedTable, make_text_cells
from dynident.recordings import Check, Recording, phase_shares

if TYPE_CHECKING:
    # For type checkers alone: what shows recordings seldom infers columns.
    from dynident.identification.column_inference import Guess

CHECK_MARKS: dict[str, tuple[str, Mark]] = {"ok": ("✓", "ok"), "warning": ("!", "warning"), "error": ("✕", "error")}
_MOST_WINDOWS = 5
_MOST_RECORDINGS = 3
"""Recordings that a finding names; of a night of runs their number says more."""
_ROWS = "after filter and decimation"


@dataclass(frozen=True)
class ShownRecording:
    """A recording with its checks, what it was used for ("" for nothing yet), and its rows after filtering."""

    recording: Recording
    checks: Sequence[Check] = ()
    use: str = ""
    n_rows: int | None = None


def build_recording_table(items: Sequence[ShownRecording]) -> ReportedTable:
    """Return a table of recordings."""
    rows = []
    for item in items:
        recording = item.recording
        payload = ", ".join(f"{key} {value}" for key, value in (recording.payload or {}).items())
        samples = format_count(recording.n_samples, "sample")
        rows.append(
            (
                *make_text_cells(recording.name, item.use),
                Cell(samples, recording.n_samples),
                Cell(f"{recording.sampling_rate:.4g} Hz", recording.sampling_rate),
                Cell(format_duration(recording), is_figures=True),
                Cell(format_windows(recording)),
                Cell("" if item.n_rows is None else format_count(item.n_rows, "row"), item.n_rows),
                Cell(format_standstill_shares(phase_shares(recording).standing), is_figures=True),
                Cell(payload or "none stated"),
            )
        )
    columns = (
        "recording",
        "used for",
        "stored",
        "rate",
        "duration",
        "windows used",
        _ROWS,
        "standstill per joint",
        "payload",
    )
    notes = (
        "Standstill per joint: the share of time at standstill in the windows, in the robot's order of joints. The fit "
        "does not use these rows of that joint.",
    )
    table = ReportedTable("Recordings", columns, tuple(rows), numbers_from=2, notes=notes, name="recordings")
    return table if any(item.n_rows is not None for item in items) else table.drop_columns(_ROWS)


def format_duration(recording: Recording) -> str:
    """Return the length of a recording, with the number of its segments where it has several."""
    segments = f" in {len(recording.segments)} segments" if len(recording.segments) > 1 else ""
    return f"{recording.n_samples * recording.period:.4g} s{segments}"


def format_windows(recording: Recording) -> str:
    """Return the intervals of time of a recording that are used, of many the first ones."""
    texts = [f"{start:g} to {end:g} s" for start, end in recording.windows]
    return ", ".join(texts if len(texts) <= _MOST_WINDOWS else [*texts[:_MOST_WINDOWS], "…"]) or "all"


def describe_findings(items: Iterable[ShownRecording]) -> Iterator[str]:
    """Yield a line for each check that is not ok; one for all recordings that it says the same of."""
    recordings: dict[tuple[str, str, str], list[str]] = {}
    # Passed checks are no news: that the recording is shown says already that the file was read.
    for item in items:
        for check in item.checks:
            if check.status != "ok":
                finding = CHECK_MARKS[check.status][0], check.name.replace("_", " "), check.detail
                recordings.setdefault(finding, []).append(item.recording.name)
    for (mark, check_name, detail), names in recordings.items():
        further = len(names) - _MOST_RECORDINGS
        listed = ", ".join(names[:_MOST_RECORDINGS]) + (f" and {further} more" if further > 0 else "")
        yield f"{mark} {listed}, {check_name}: {detail}"


def build_check_table(title: str, checks: Iterable[tuple[str, Check]]) -> ReportedTable:
    """Return a table of checks, each with the name of its recording.

    Parameters
    ----------
    title : str
        Heading of the table.
    checks : iterable of (str, Check)
        Names of recordings with their checks.
    """
    rows = tuple(
        (
            *make_text_cells(name, check.name.replace("_", " ")),
            Cell(f"{CHECK_MARKS[check.status][0]} {check.status}", mark=CHECK_MARKS[check.status][1]),
            *make_text_cells(check.detail, _format_place(check)),
        )
        for name, check in checks
    )
    return ReportedTable(title, ("recording", "check", "result", "found", "where"), rows, numbers_from=5, name="checks")


def _format_place(check: Check) -> str:
    places = [f"column {check.column}"] if check.column else []
    places += [] if check.row is None else [f"row {check.row}"]
    places += [] if check.time is None else [f"t = {check.time:.6g} s"]
    return ", ".join(places)


def build_guess_table(guesses: Iterable[Guess], write: Callable[[Remedy], str] = str) -> ReportedTable:
    """Return a table of what the columns of a file seem to be, with reasons.

    Parameters
    ----------
    guesses : iterable of Guess
        The guesses.
    write : function
        Returns a remedy in the syntax of a front end; by default in that of the library.
    """
    rows = tuple(
        (
            *make_text_cells(guess.field, guess.value),
            Cell(format_percent(guess.confidence, decimals=0), guess.confidence),
            Cell(word_remedies(guess.reason, guess.remedies, write)),
        )
        for guess in guesses
    )
    return ReportedTable(
        "What the columns are", ("field", "guess", "sure", "why"), rows, numbers_from=2, name="guesses"
    )
