"""`dynident doctor`."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Annotated

import typer

from dynident_service.cli.commands.backup import DataDir, open_storage

if TYPE_CHECKING:
    from dynident_service.storage.records import Resource

UNSOUND = 1


def doctor(
    data_dir: DataDir = None,
    repair: Annotated[
        bool, typer.Option("--repair", help="Put right what can be without losing anything that anybody owns.")
    ] = False,
    quick: Annotated[bool, typer.Option("--quick", help="Look at the sizes of files alone, not at what they hold.")] = (
        False
    ),
) -> None:
    """Look through all that the service has stored: what is missing, damaged, cannot be read, or kept for nobody.

    Every robot, recording, model and other result is read as the service reads it. May run beside the service. Ends
    with 1 where anything is wrong that is not put right.
    """
    from dynident_service.jobs.stored_file_reader import StoredFilesReader
    from dynident_service.routes.stored_resource_check import show_resource
    from dynident_service.storage import integrity_check as examination
    from dynident_service.storage.migrate import migrate

    wrong: Counter[examination.Trouble] = Counter()
    with (
        open_storage(data_dir, must_exist=True, as_it_is=True) as (database, objects, _),
        StoredFilesReader(objects) as reader,
    ):
        if not any(examination.check_database(database)):
            migrate(database)

        def find_problem(resource: Resource) -> str | None:
            try:
                show_resource(resource)
            except Exception as error:  # of what another version stored, this is no closed list
                return reader.find_problem(resource) or f"its request or its result: {type(error).__name__}: {error}"
            return reader.find_problem(resource)

        read_problem = None if quick else find_problem
        for finding in examination.check_storage(database, objects, by_hash=not quick, problem_of=read_problem):
            mended = repair and finding.is_repairable
            if mended:
                examination.repair(database, objects, finding)
            else:
                wrong[finding.trouble] += 1
            owners = f"; needed by {', '.join(finding.owners)}" if finding.owners else ""
            typer.echo(f"{finding.trouble}: {finding.what}: {finding.detail}{owners}{' (put right)' if mended else ''}")
    if not wrong:
        typer.echo("all is well")
        return
    for trouble, number in wrong.items():
        typer.echo(f"{number} {trouble}: {examination.REMEDIES[trouble]}")
    raise typer.Exit(UNSOUND)
