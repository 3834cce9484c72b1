"""Entry point of the program `dynident`, which is `python -m dynident_cli`, too."""

from __future__ import annotations

import gc
import sys

from dynident.optional_dependencies import format_install_hint
from dynident.version import __version__

_YOUNG = 20_000
"""Objects between garbage collections, some megabytes. With Python's 700, collections take 0.2 s while packages are
imported, and find nothing.
"""
_OLDER = 100
"""Collections of new objects between those that look at older ones, too; with Python's 10 these take as long again."""


def main() -> None:
    """Run the command line."""
    if sys.argv[1:] == ["--version"]:
        # Handled before any import, as the light installation lacks the packages of the command line.
        print(f"dynident {__version__}")
        return
    if sys.argv[1:2] == ["serve"]:
        from dynident_service.environment_secrets import hide_secrets

        hide_secrets()  # first of all, as it starts the program again
    gc.set_threshold(_YOUNG, _OLDER)
    try:
        from dynident_cli.program_and_exit_codes import create_application
    except ModuleNotFoundError as missing:
        if missing.name not in ("typer", "rich", "click"):
            raise
        sys.exit(
            f"dynident: the command line needs the package {missing.name}, which the light installation does not "
            f"contain; {format_install_hint(missing.name)}"
        )
    create_application(sys.argv[1] if sys.argv[1:] else None)(prog_name="dynident")


if __name__ == "__main__":
    main()
