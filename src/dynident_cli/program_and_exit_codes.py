"""Assemble the program: the list of commands, and errors as messages with exit codes (2, 130)."""

from __future__ import annotations

import functools
import json
import sys
from collections.abc import Callable, Collection
from importlib import import_module
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from dynident.errors import Cancelled, DynidentError, word_remedies
from dynident.optional_dependencies import format_install_hint
from dynident.version import __version__
from dynident_cli.option_parsers import check_inputs
from dynident_cli.request_options import spread_options, write_option

if TYPE_CHECKING:
    # Click, as typer brings it.
    from typer._click.core import Context
    from typer._click.formatting import HelpFormatter

EXIT_MISUSED = 2
"""Exit code after an error that the user can mend; typer ends with the same one for wrong options."""
EXIT_CANCELLED = 130
"""Exit code after Ctrl-C: 128 plus the number of SIGINT, as shells have it."""


def print_error(error: DynidentError, as_json: bool, option_names: Collection[str] = ()) -> None:
    """Print what is wrong, where, and how to mend it: on stderr for people, on stdout as JSON where that was asked for.

    The JSON is the problem document that the service answers with (RFC 9457).
    """
    # Many messages name the place already.
    where = f"{error.pointer}: " if error.pointer and error.pointer not in error.detail else ""
    # A place in a request is an option here; a path of a file may begin with a slash, too.
    _, field, *keys = [*error.pointer.split("/"), ""] if error.pointer.startswith("/") else ["", ""]
    if field in option_names:
        names = [key for key in keys if key and not key.isdecimal()]
        option = "--" + field.replace("_", "-")
        where = f"{' '.join([option, *names])}: "
    detail = word_remedies(error.detail, error.remedies, write_option)
    print(f"dynident: {error.title}\n  {where}{detail}", file=sys.stderr)
    # A file may fail several checks; the first is the error itself.
    checks = [
        check for check in getattr(error, "checks", ()) if check.status == "error" and check.detail not in error.detail
    ]
    for check in checks:
        print(f"  also {check.name.replace('_', ' ')}: {check.detail}", file=sys.stderr)
    if as_json:
        from dynident_cli.contract_documents import describe_error

        print(json.dumps(describe_error(error), indent=2))


_GROUPS = {
    "From files to a better model": (
        *("campaign", "inspect", "design", "identify", "compare", "diagnose", "extend", "remove", "ladder"),
        *("changes", "series", "effects"),
    ),
    "Currents and drive gains": ("gains", "currents"),
    "How far to trust a model": ("validate", "essential"),
    "Results for others": ("report", "export"),
    "Without a robot": ("demo", "simulate"),
    "The service and its data": (*("serve", "mcp", "backup", "restore", "export_robot", "import_robot", "doctor"),),
}
"""Commands in the order of the overview, by what they are for."""
_COMMANDS = tuple(command for commands in _GROUPS.values() for command in commands)

_MODULES = {
    **dict.fromkeys(("effects", "essential", "extend", "inspect", "ladder", "remove"), "identify"),
    **dict.fromkeys(("changes", "compare", "series"), "diagnose"),
    **dict.fromkeys(("demo", "simulate"), "design"),
    **dict.fromkeys(("mcp", "backup", "restore", "export_robot", "import_robot", "doctor"), "serve"),
    "currents": "gains",
    "export": "report",
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
            # The library points at the file; the user knows the option.
            written = {str(options[name]): name for name in ("out", "figure", "keep") if options.get(name) is not None}
            if error.pointer in written:
                error.pointer = f"--{written[error.pointer]}"
            print_error(error, bool(options.get("as_json")), options)
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


class CommandsByPurpose(TyperGroup):
    """The program, whose overview lists its commands by what they are for."""

    def format_commands(self, ctx: Context, formatter: HelpFormatter) -> None:
        """Write the sections of commands; their first column is as wide in all of them."""
        names = [name.replace("_", "-") for name in _COMMANDS]
        width = max(map(len, names))
        for title, commands in _GROUPS.items():
            rows = [
                (name.ljust(width), self.commands[name].get_short_help_str(formatter.width - width - 4))
                for name in (command.replace("_", "-") for command in commands)
                if name in self.commands
            ]
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)


def create_application(typed: str | None = None) -> typer.Typer:
    """Build the command line.

    Where the first word that the user typed is a command, only that command is registered, because importing the
    modules of all of them takes time.
    """
    command_names = [command_name for command_name in _COMMANDS if command_name.replace("_", "-") == typed] or _COMMANDS
    application = typer.Typer(
        name="dynident",
        cls=CommandsByPurpose,
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
