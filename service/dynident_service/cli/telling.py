"""What comes out of a command: into a file where one is named, as JSON for scripts, or in words."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping

from rich.console import Console

from dynident.identification import Identification, to_bytes
from dynident_service.cli import terminal
from dynident_service.cli.inputs import write_whole
from dynident_service.cli.options import Result
from dynident_service.cli.shown import show_identification
from dynident_service.cli.shown_ladders import show_ladder

Document = Mapping[str, object]


def tell(
    result: Result,
    what: str,
    described: Callable[[], Document],
    show: Callable[[Console], None],
    content: Callable[[], bytes] | None = None,
) -> None:
    """Write what came out where it was asked for, its document where there is no `content`, and tell of it.

    Either is made where it is needed: what describes an answer takes longer to load than a small robot to
    identify.
    """
    document = described() if result.as_json or (result.out is not None and content is None) else {}
    if result.out is not None:
        whole = content() if content else json.dumps(document, indent=1, allow_nan=False).encode()
        write_whole(result.out, whole)
    if result.as_json:
        terminal.print_json(document)
        return
    console = terminal.out()
    show(console)
    if result.out is not None:
        console.print(f"{what} written to {result.out}", markup=False)


def tell_rung(result: Result, found: Identification, parent_id: str, parent: Identification) -> None:
    """The same of a model that was made from another one."""

    def described() -> Document:
        from dynident_service.adapters.identifications import describe_identification
        from dynident_service.models.common import plain

        return plain(describe_identification(found, parent_id, parent))

    def show(console: Console) -> None:
        show_ladder(console, found)
        show_identification(console, found, parameters=False)

    tell(result, "model", described, show, lambda: to_bytes(found))
