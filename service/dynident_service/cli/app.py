"""All commands, and what happens when one of them fails."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable
from typing import Annotated, Any

import typer

from dynident.errors import Cancelled, DynidentError
from dynident.extras import install_hint
from dynident.version import __version__
from dynident_service.cli.asked import with_options
from dynident_service.cli.failures import CANCELLED, MISUSED, tell_failure
from dynident_service.cli.files import check_inputs
from dynident_service.cli.verbs import (
    backup,
    changes,
    compare,
    currents,
    demo,
    design,
    diagnose,
    doctor,
    effects,
    essential,
    export,
    extend,
    gains,
    identify,
    inspect,
    ladder,
    remove,
    report,
    series,
    serve,
    simulate,
    validate,
)

app = typer.Typer(
    name="dynident",
    help="Identify the dynamic parameters of a robot, and name the physics that its model is missing.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"dynident {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", help="Show the version and leave.", is_eager=True, callback=_show_version)
    ] = False,
) -> None:
    """Take the options before the command."""


def _guarded(command: Callable[..., None]) -> Callable[..., None]:
    """The command, with errors that the user can mend told in words, and Ctrl-C ending it quietly."""

    @functools.wraps(command)
    def guarded(*arguments: Any, **options: Any) -> None:
        try:
            check_inputs(command, options)
            command(*arguments, **options)
        except DynidentError as error:
            tell_failure(error, bool(options.get("as_json")))
            raise typer.Exit(MISUSED) from error
        except ModuleNotFoundError as missing:
            if (missing.name or "").startswith("dynident"):
                raise
            detail = f"this needs the package {missing.name}; {install_hint(missing.name or '')}"
            tell_failure(DynidentError(detail, title="Not installed"), as_json=False)
            raise typer.Exit(MISUSED) from missing
        except (KeyboardInterrupt, Cancelled):
            print("dynident: cancelled", file=sys.stderr)
            raise typer.Exit(CANCELLED) from None

    return guarded


for _command in (
    demo.demo,
    design.design,
    simulate.simulate,
    inspect.inspect,
    identify.identify,
    compare.compare,
    diagnose.diagnose,
    changes.changes,
    validate.validate,
    essential.essential,
    gains.gains,
    currents.currents,
    extend.extend,
    remove.remove,
    ladder.ladder,
    report.report,
    series.series,
    export.export,
    effects.effects,
    doctor.doctor,
    backup.backup,
    backup.restore,
    backup.export_robot,
    backup.import_robot,
    serve.serve,
):
    app.command()(_guarded(with_options(_command)))
