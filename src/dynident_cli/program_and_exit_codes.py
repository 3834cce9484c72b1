"""Assemble the program: the list of commands, and errors as messages with exit codes (2, 130)."""

from __future__ import annotations

import functools
import json
import sys
from collections.abc import Callable
from importlib import import_module
from typing import Annotated, Any

import typer

from dynident.errors import Cancelled, DynidentError, word_remedies
from dynident.optional_dependencies import format_install_hint
from dynident.version import __version__
from dynident_cli.input_checks_and_writes import check_inputs
from dynident_cli.request_options import spread_options, write_option

EXIT_MISUSED = 2
"""Exit code after an error that the user can mend; typer ends with the same one for wrong options."""
EXIT_CANCELLED = 130
"""Exit code after Ctrl-C: 128 plus the number of SIGINT, as shells have it."""


def print_error(error: DynidentError, as_json: bool) -> None:
    """Print what is wrong, where, and how to mend it.

    Parameters
    ----------
    error : DynidentError
        The error. It is printed on stderr for people.
    as_json : bool
        Whether to print it on stdout, too, as the problem document that the service answers with (RFC 9457).
    """
    # Many messages name the place already.
    where = f"{error.pointer}: " if error.pointer and error.pointer not in error.detail else ""
    detail = word_remedies(error.detail, error.remedies, write_option)
    print(f"dynident: {error.title}\n  {where}{detail}", file=sys.stderr)
    # A file may fail several checks; the first is the error itself.
    checks = [
        check for check in getattr(error, "checks", ()) if check.status == "error" and check.detail not in error.detail
    ]
    for check in checks:
        print(f"  also {check.name.replace('_', ' ')}: {check.detail}", file=sys.stderr)
    if as_json:
        print(json.dumps(_problem_document(error), indent=2))


def _problem_document(error: DynidentError) -> dict[str, object]:
    from dynident.recordings import RecordingError
    from dynident_service.measurements.adapters import describe_file_problem
    from dynident_service.problems import to_problem

    problem = describe_file_problem(error) if isinstance(error, RecordingError) else to_problem(error)
    # The same document as the service sends: a script need not know which of the two it talks to.
    document: dict[str, object] = problem.model_dump(exclude_none=True)
    return document


_COMMANDS = (
    *(
        "demo",
        "campaign",
        "design",
        "simulate",
        "inspect",
        "identify",
        "compare",
        "diagnose",
        "changes",
        "validate",
        "essential",
    ),
    *("gains", "currents", "extend", "remove", "ladder", "report", "series", "export", "effects", "doctor"),
    *("backup", "restore", "export_robot", "import_robot", "serve", "mcp"),
)
"""Commands in the order of the overview."""

_MODULES = {
    **dict.fromkeys(("effects", "essential", "extend", "ladder", "remove"), "identify"),
    **dict.fromkeys(("changes", "series"), "diagnose"),
    "simulate": "design",
    **dict.fromkeys(("restore", "export_robot", "import_robot", "doctor"), "backup"),
    "currents": "gains",
    "export": "report",
    "mcp": "serve",
}
"""Modules of `dynident_cli.commands`, for commands that do not stand in the one with their name."""


def _show_version(is_requested: bool) -> None:
    if is_requested:
        typer.echo(f"dynident {__version__}")
        raise typer.Exit


def _root(
    version: Annotated[
        bool, typer.Option("--version", help="Show the version and exit.", is_eager=True, callback=_show_version)
    ] = False,
) -> None:
    """Take the options that stand before the command."""


def handle_errors(command: Callable[..., None]) -> Callable[..., None]:
    """Wrap a command: print errors that the user can mend as messages, and end quietly on Ctrl-C.

    Other exceptions are bugs and keep their traceback.
    """

    @functools.wraps(command)
    def run_command(*arguments: Any, **options: Any) -> None:
        try:
            # Missing files are reported before the command imports anything that takes seconds.
            check_inputs(command, options)
            command(*arguments, **options)
        except DynidentError as error:
            print_error(error, bool(options.get("as_json")))
            raise typer.Exit(EXIT_MISUSED) from error
        except ModuleNotFoundError as missing:
            # A missing module of dynident itself is a bug. Any other belongs to an optional dependency, whose extra
            # the message names.
            if (missing.name or "").startswith("dynident"):
                raise
            detail = f"this needs the package {missing.name}; {format_install_hint(missing.name or '')}"
            print_error(DynidentError(detail, title="Not installed"), as_json=False)
            raise typer.Exit(EXIT_MISUSED) from missing
        except (KeyboardInterrupt, Cancelled):
            print("dynident: cancelled", file=sys.stderr)
            # Without a traceback: the user knows what happened.
            raise typer.Exit(EXIT_CANCELLED) from None

    return run_command


def create_application(typed: str | None = None) -> typer.Typer:
    """Build the command line.

    Parameters
    ----------
    typed : str, optional
        The first word that the user typed. Where it is a command, only that command is registered, because importing
        the modules of all of them takes time.

    Returns
    -------
    typer.Typer
        The application, with the command typed or with all of them.
    """
    command_names = [command_name for command_name in _COMMANDS if command_name.replace("_", "-") == typed] or _COMMANDS
    application = typer.Typer(
        name="dynident",
        help="Identify the dynamic parameters of a robot, and name the physics that its model is missing.",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        add_completion=False,
        rich_markup_mode=None,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    application.callback()(_root)
    for command_name in command_names:
        module = import_module(f"dynident_cli.commands.{_MODULES.get(command_name, command_name)}")
        # `spread_options` gives the command the signature that typer reads; `handle_errors`, around it, keeps that.
        application.command()(handle_errors(spread_options(getattr(module, command_name))))
    return application


def __getattr__(name: str) -> typer.Typer:
    """Build `app`, the program with all its commands, when it is asked for."""
    # Lazily: whoever imports `create_application` from here does not pay for importing every command.
    if name != "app":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return create_application()
