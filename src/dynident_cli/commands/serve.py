"""`dynident serve`, `mcp` (tools for agents), `backup`, `restore`, `export-robot`, `import-robot` and `doctor`."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dynident_cli.option_parsers import READABLE_FOLDER

if TYPE_CHECKING:
    from dynident_service.storage.backup_and_restore import ArchiveSize
    from dynident_service.storage.repository_values import Resource


def serve(
    host: Annotated[str | None, typer.Option("--host", help="Address to listen on; 127.0.0.1 by default.")] = None,
    port: Annotated[int | None, typer.Option("--port", help="Port; 8000 by default.", min=0, max=65535)] = None,
    data_dir: Annotated[
        Path | None, typer.Option("--data-dir", help="Folder for the data; ./dynident-data by default.")
    ] = None,
    workers: Annotated[
        int | None, typer.Option("--workers", help="Jobs at the same time; one per core by default.", min=1)
    ] = None,
) -> None:
    """Run the HTTP service.

    Every setting is also an environment variable, DYNIDENT_HOST, DYNIDENT_PORT and so on.
    """
    from dynident_service.serve import serve as run
    from dynident_service.settings import load_settings

    options = {"host": host, "port": port, "data_dir": data_dir, "workers": workers}
    run(load_settings(**{name: value for name, value in options.items() if value is not None}))


def mcp(
    folder: Annotated[
        Path,
        typer.Option(
            "--folder", metavar="DIR", help="The folder whose files the agent may use; nothing outside of it."
        ),
        READABLE_FOLDER,
    ],
) -> None:
    """Serve the library's functions to an agent (MCP).

    The Model Context Protocol runs over stdin and stdout.
    """
    from dynident_service.agents.server import serve_folder

    serve_folder(folder)


UNSOUND = 1


def doctor(
    data_dir: DataDir = None,
    repair: Annotated[
        bool,
        typer.Option(
            "--repair/--no-repair", help="Repair what can be repaired without losing anything that has an owner."
        ),
    ] = False,
    quick: Annotated[
        bool, typer.Option("--quick/--no-quick", help="Check only the sizes of files, not their content.")
    ] = False,
) -> None:
    """Check everything that the service has stored.

    It finds what is missing, damaged, unreadable, or has no owner.

    It reads every robot, recording, model and other result as the service does. The service may run at the same time.
    The exit code is 1 if there is a fault that is not repaired.
    """
    from dynident_service.readability_checks import StoredFilesReader, show_resource
    from dynident_service.storage import integrity_check as examination
    from dynident_service.storage.backup_and_restore import open_storage
    from dynident_service.storage.database import migrate

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
                examination.repair(database, finding)
            else:
                wrong[finding.trouble] += 1
            owners = f"; needed by {', '.join(finding.owners)}" if finding.owners else ""
            typer.echo(f"{finding.trouble}: {finding.what}: {finding.detail}{owners}{' (repaired)' if mended else ''}")
    if not wrong:
        typer.echo("no faults found")
        return
    for trouble, number in wrong.items():
        typer.echo(f"{number} {trouble}: {examination.REMEDIES[trouble]}")
    raise typer.Exit(UNSOUND)


DataDir = Annotated[
    Path | None, typer.Option("--data-dir", help="Where the service keeps its data; ./dynident-data by default.")
]


def backup(
    target: Annotated[Path, typer.Argument(metavar="TARGET", help="A folder, or a file that ends in .zip.")],
    data_dir: DataDir = None,
) -> None:
    """Write everything that is stored to a folder or a ZIP.

    The service may run at the same time. If the folder has a backup already, only new files are copied.
    """
    from dynident_service.storage.backup_and_restore import back_up, open_storage

    with open_storage(data_dir, must_exist=True) as (database, objects, _):
        _print_amount("written", back_up(database, objects, target))


def restore(
    source: Annotated[Path, typer.Argument(metavar="SOURCE", help="The folder or ZIP that `dynident backup` wrote.")],
    data_dir: DataDir = None,
) -> None:
    """Read a backup into an empty data directory. Unfinished jobs are queued again."""
    from dynident_service.storage.backup_and_restore import open_storage
    from dynident_service.storage.backup_and_restore import restore as read_back

    with open_storage(data_dir, must_exist=False) as (database, objects, scratch):
        _print_amount("restored", read_back(database, objects, source, scratch))


def export_robot(
    robot_id: Annotated[str, typer.Argument(metavar="ROBOT_ID", help="Id of a robot in the service.")],
    target: Annotated[Path, typer.Argument(metavar="TARGET", help="The file to write, which ends in .zip.")],
    data_dir: DataDir = None,
) -> None:
    """Write a robot with all that belongs to it to one file.

    Another service can import its recordings, models, diagnoses and reports.
    """
    from dynident_service.storage.backup_and_restore import open_storage
    from dynident_service.storage.robot_bundle import export_robot as write

    with open_storage(data_dir, must_exist=True) as (database, objects, _):
        _print_amount("written", write(database, objects, robot_id, target))


def import_robot(
    source: Annotated[Path, typer.Argument(metavar="SOURCE", help="The file that `dynident export-robot` wrote.")],
    data_dir: DataDir = None,
) -> None:
    """Read an exported robot with all that belongs to it. Ids stay; existing resources do not change."""
    from dynident_service.readability_checks import check_stored_resource
    from dynident_service.storage.backup_and_restore import open_storage
    from dynident_service.storage.robot_bundle import import_robot as read

    with open_storage(data_dir, must_exist=False) as (database, objects, scratch):
        robot_id, amount = read(database, objects, source, scratch, check_stored_resource)
        typer.echo(robot_id)
        _print_amount("imported", amount)


def _print_amount(done: str, amount: ArchiveSize) -> None:
    typer.echo(f"{done}: {amount.rows} rows, {amount.objects} files, {amount.bytes / 1e6:.1f} MB")
