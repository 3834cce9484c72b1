"""Output of a command: to a file, as JSON, or printed."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from rich.console import Console

from dynident.diagnosis import compare
from dynident.identification import Identification
from dynident.progress import Progress, scale_progress
from dynident.recordings.file_names_and_digests import compute_digest
from dynident.reports import ReportedRecording
from dynident_cli import terminal
from dynident_cli.argument_loading import LoadedRecording
from dynident_cli.input_checks_and_writes import write_atomically
from dynident_cli.shared_options import OutputOptions

if TYPE_CHECKING:
    from pydantic import BaseModel

    from dynident.verdict import ModelVerdict


def build_reported_runs(
    identification: Identification,
    training: Sequence[LoadedRecording],
    held_out: Sequence[LoadedRecording],
    progress: Progress,
) -> list[ReportedRecording]:
    """Compare each recording with the model's prediction, for the report."""
    everything = [(item, False) for item in training] + [(item, True) for item in held_out]
    runs = []
    for index, (item, is_held_out) in enumerate(everything):
        share = scale_progress(progress, index / len(everything), (index + 1) / len(everything))
        compared = compare(identification, item.recording, share)
        runs.append(
            ReportedRecording(
                item.recording,
                compared,
                is_held_out,
                item.checks,
                sha256=compute_digest(item.path),
                stated_metadata=item.metadata,
            )
        )
    return runs


Document = Mapping[str, object]
Describe = Callable[[], "BaseModel | Document"]
Show = Callable[[Console], None]


def write_result(
    result: OutputOptions, label: str, described: Describe, show: Show, content: Callable[[], bytes] | None = None
) -> None:
    """Write what came out where it was asked for, its document where there is no `content`, and print it.

    Either is made where it is needed: what describes an answer takes longer to load than a small robot to
    identify.
    """
    # The document is made once, for the file and for the screen.
    document = _to_document(described()) if result.as_json or (result.out is not None and content is None) else {}
    if result.out is not None:
        write_atomically(result.out, content() if content else json.dumps(document, indent=1, allow_nan=False).encode())
    messages = () if result.out is None else (f"{label} written to {result.out}",)
    print_result(result.as_json, lambda: document, show, *messages)


def print_result(as_json: bool, described: Describe, show: Show, *messages: str) -> None:
    """Print what came out: its document for scripts; for people words, and then what was written where."""
    if as_json:
        terminal.print_json(_to_document(described()))
        return
    console = terminal.result_console()
    show(console)
    for message in messages:
        console.print(message)


def write_extended_model(
    result: OutputOptions,
    identification: Identification,
    parent_id: str,
    parent: Identification,
    verdict: ModelVerdict | None = None,
) -> None:
    """Write a model that was made from another one, and print it with the verdict on it where there is one."""
    from dynident.identification import to_bytes
    from dynident_cli.printed_results import show_identification, show_ladder, show_verdict

    def describe_model() -> Document:
        from dynident_service.identifications.adapters import describe_identification
        from dynident_service.identifications.adapters import show_verdict as view_verdict
        from dynident_service.shared.wire_types import to_plain_json

        document = to_plain_json(describe_identification(identification, parent_id, parent))
        return document if verdict is None else {**document, "verdict": to_plain_json(view_verdict(verdict))}

    def show_model(console: Console) -> None:
        show_ladder(console, identification, parent)
        show_identification(console, identification, parameters=False)
        if verdict is not None:
            show_verdict(console, verdict)

    write_result(result, "model", describe_model, show_model, lambda: to_bytes(identification))


def write_unchanged_model(result: OutputOptions, identification: Identification, why: str) -> None:
    """Write a model that stays as it is: scripts find it where they asked for it."""
    from dynident.identification import to_bytes

    def describe_model() -> BaseModel:
        from dynident_service.identifications.adapters import describe_identification

        return describe_identification(identification, None)

    write_result(
        result, "the same model", describe_model, lambda console: console.print(why), lambda: to_bytes(identification)
    )


def _to_document(described: BaseModel | Document) -> Document:
    if isinstance(described, Mapping):
        return described
    from dynident_service.shared.wire_types import to_plain_json

    return to_plain_json(described)
