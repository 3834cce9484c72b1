"""`dynident doctor`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

UNSOUND = 1


def doctor(
    data_dir: Annotated[
        Path | None, typer.Option("--data-dir", help="Where the service keeps its data; ./dynident-data by default.")
    ] = None,
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
    from dynident.errors import DynidentError
    from dynident_service.settings import Settings
    from dynident_service.storage import doctor as examination
    from dynident_service.storage.database import Database
    from dynident_service.storage.migrate import migrate
    from dynident_service.storage.objects import ObjectStore

    settings = Settings() if data_dir is None else Settings(data_dir=data_dir)
    if not settings.database_url and not settings.data_dir.is_dir():
        raise DynidentError(
            f"there is no folder {settings.data_dir}; say where the service keeps its data", pointer="--data-dir"
        )
    database = Database(settings.database)
    wrong = 0
    try:
        if not any(examination.examine_database(database)):
            migrate(database)
        objects = ObjectStore(settings.objects, settings.cache_dir)
        for finding in examination.examine(database, objects, by_hash=not quick):
            mended = repair and finding.is_curable
            if mended:
                examination.repair(database, objects, finding)
            wrong += not mended
            owners = f"; needed by {', '.join(finding.owners)}" if finding.owners else ""
            typer.echo(f"{finding.trouble}: {finding.what}: {finding.detail}{owners}{' (put right)' if mended else ''}")
    finally:
        database.close()
    typer.echo("all is well" if not wrong else f"{wrong} found; files that are missing or damaged: upload them again")
    if wrong:
        raise typer.Exit(UNSOUND)
