"""`dynident doctor`."""

from __future__ import annotations

from typing import Annotated

import typer

from dynident_service.cli.verbs.backup import DataDir, storage

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
    """Look through all that the service has stored: what is missing, damaged, or kept for nobody.

    May run beside the service. Ends with 1 where anything is wrong that is not put right.
    """
    from dynident_service.storage import doctor as examination
    from dynident_service.storage.migrate import migrate

    wrong = 0
    with storage(data_dir, must_exist=True, as_it_is=True) as (database, objects, _):
        if not any(examination.examine_database(database)):
            migrate(database)
        for finding in examination.examine(database, objects, by_hash=not quick):
            mended = repair and finding.is_curable
            if mended:
                examination.repair(database, objects, finding)
            wrong += not mended
            owners = f"; needed by {', '.join(finding.owners)}" if finding.owners else ""
            typer.echo(f"{finding.trouble}: {finding.what}: {finding.detail}{owners}{' (put right)' if mended else ''}")
    typer.echo("all is well" if not wrong else f"{wrong} found; files that are missing or damaged: upload them again")
    if wrong:
        raise typer.Exit(UNSOUND)
