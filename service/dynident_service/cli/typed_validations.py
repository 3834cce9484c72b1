"""Run validations for `dynident validate`: parse methods, read files, print the verdicts and their marks."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from rich.console import Console

from dynident.errors import DynidentError
from dynident.identification import Identification
from dynident.identification.identification_choices import STEPS
from dynident.identification.methods.base_classes import ESTIMATORS, MODELS, PRIORS, STRATEGIES
from dynident.progress import Progress
from dynident.recordings import Recording
from dynident.reports.table_cells import ReportedTable
from dynident.robot import Robot
from dynident.schema.fields import NamedValues
from dynident.validation import Method
from dynident.validation.validation_request import Methods, Trial, ValidationData
from dynident_service.adapters.validations import build_validation_tables, describe_validation
from dynident_service.cli.input_checks_and_writes import read_text
from dynident_service.cli.terminal import build_table
from dynident_service.wire_types.validations import ValidationResult

_MARKS = {"pass": "✓ pass", "fail": "✕ fail", "not_evaluated": "– not evaluated"}
_STYLES = {"pass": "bold green", "fail": "bold red", "not_evaluated": "bold"}


def show_validation(console: Console, result: ValidationResult, robot: Robot) -> None:
    """Print the tables of a validation, its verdict, and the reason."""
    names = robot.joint_names
    by_number = {name: str(number) for number, name in enumerate(names, start=1)}
    for reported_table in build_validation_tables(result, names):
        # Where the terminal is too narrow for the joints' names as columns, their numbers stand there.
        short = by_number if _table_width(reported_table) > console.width else {}
        # Only names of joints are shortened; other heads stay as they are.
        columns = [short.get(column, column) for column in reported_table.columns]
        console.print(
            build_table(reported_table.title, columns, reported_table.texts, right_from=reported_table.numbers_from)
        )
        if columns != list(reported_table.columns):
            console.print(f"  Joints: {', '.join(f'{by_number[name]} {name}' for name in names)}.")
    console.print(_MARKS[result.verdict], style=_STYLES[result.verdict])
    console.print(result.reason)


def _table_width(reported_table: ReportedTable) -> int:
    """Return the width of a table in characters, with nothing wrapped."""
    lines = [reported_table.columns, *reported_table.texts]
    return sum(max(len(line[k]) for line in lines) + 2 for k in range(len(reported_table.columns)))


_TITLE = "Unusable option"


def load_validation(path: Path) -> ValidationResult:
    """Read what `dynident validate --out` wrote.

    Raises
    ------
    DynidentError
        Where the file is not there or holds no validation.
    """
    try:
        return ValidationResult.model_validate_json(read_text(path))
    except ValidationError as error:
        detail = f"{path.name} does not contain a validation; give a file that `dynident validate --out` wrote"
        raise DynidentError(detail, pointer="--validated", title="Unusable file") from error


def check_recording_counts(trial: Trial, n_measurements: int, n_held_out: int) -> None:
    """Raise `DynidentError` where measurements are missing, or stand there that the kind does not take."""
    kind = trial.name
    if trial.of_model_alone and n_measurements:
        raise DynidentError(f"{kind} takes no measurement", pointer="MEASUREMENT", title=_TITLE)
    if not trial.of_model_alone and not n_measurements:
        raise DynidentError(f"{kind} needs a measurement", pointer="MEASUREMENT", title=_TITLE)
    if kind == "filters" and n_measurements > 1:
        raise DynidentError("filters needs exactly one measurement", pointer="MEASUREMENT", title=_TITLE)
    if kind == "payload" and not n_held_out:
        raise DynidentError(
            "payload also needs the runs without the load: --unloaded", pointer="--unloaded", title=_TITLE
        )
    if n_held_out and kind not in ("methods", "payload"):
        raise DynidentError(f"{kind} takes no --validation", pointer="--validation", title=_TITLE)


def run_validation(
    identification: Identification,
    trial: Trial,
    recordings: Sequence[Recording],
    held_out: Sequence[Recording],
    progress: Progress,
) -> ValidationResult:
    """Make a validation."""
    # Methods are tried on what was held out; what is given first is what they learn from.
    tested, others = (held_out, recordings) if isinstance(trial, Methods) else (recordings, held_out)
    outcome = trial.judge(ValidationData(identification, tested, others, progress))
    return describe_validation(trial, outcome, [recording.name for recording in tested])


def parse_methods(arguments: list[str]) -> tuple[Method, ...] | None:
    """Parse methods as `model/strategy/estimator`.

    Each of the three may be left out: `filtered`, `sequential/ols`.

    Raises
    ------
    DynidentError
        With the word that is none of these.
    """
    texts = [item.strip() for text in arguments for item in text.split(",") if item.strip()]
    return tuple(_parse_method(text) for text in texts) or None


def _parse_method(text: str) -> Method:
    words_by_kind: dict[str, Any] = {}
    for word in text.split("/"):
        kind = next((name for name, words in _KINDS.items() if word in words.names), None)
        if kind is None or kind in words_by_kind:
            choices = "; ".join(f"{name}: {', '.join(words.names)}" for name, words in _KINDS.items())
            raise DynidentError(
                f"cannot read {word!r} in {text!r}; write words of these kinds, separated by /, at most one of "
                f"each ({choices})",
                pointer="--methods",
                title=_TITLE,
            )
        words_by_kind[kind] = word
    # Steps have a meaning in the sequential strategy alone.
    if "steps" in words_by_kind:
        words_by_kind.setdefault("strategy", "sequential")
    return Method(**words_by_kind)


_KINDS: dict[str, NamedValues] = {
    "model": MODELS,
    "strategy": STRATEGIES,
    "steps": STEPS,
    "estimator": ESTIMATORS,
    "prior": PRIORS,
}
