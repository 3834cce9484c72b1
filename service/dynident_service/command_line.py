"""The program `dynident`: the whole story on files, without a server."""

from __future__ import annotations

import gc
import sys

from dynident.extras import install_hint
from dynident.version import __version__
from dynident_service.environment import hide_secrets

_YOUNG = 20_000
"""Objects between collections of garbage, some megabytes of them. By Python's 700 collections take 0.2 s while the
packages load, and find nothing."""


def main() -> None:
    """Run the command line."""
    if sys.argv[1:] == ["--version"]:
        # Told by the light installation too, which has no packages for anything else.
        print(f"dynident {__version__}")
        return
    if sys.argv[1:2] == ["serve"]:
        hide_secrets()  # before anything is loaded, which would be loaded twice
    gc.set_threshold(_YOUNG)
    try:
        from dynident_service.cli.app import program
    except ModuleNotFoundError as missing:
        if missing.name not in ("typer", "rich", "click"):
            raise
        sys.exit(
            f"dynident: the command line needs the package {missing.name}, which the light installation leaves out; "
            f"{install_hint(missing.name)}"
        )
    program(sys.argv[1] if sys.argv[1:] else None)(prog_name="dynident")


if __name__ == "__main__":
    main()
