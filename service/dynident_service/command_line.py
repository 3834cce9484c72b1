"""The program `dynident`: the whole story on files, without a server."""

from __future__ import annotations

import sys

from dynident.extras import install_hint
from dynident.version import __version__


def main() -> None:
    """Run the command line."""
    if sys.argv[1:] == ["--version"]:
        # Told by the light installation too, which has no packages for anything else.
        print(f"dynident {__version__}")
        return
    try:
        from dynident_service.cli.app import app
    except ModuleNotFoundError as missing:
        if missing.name not in ("typer", "rich", "click"):
            raise
        sys.exit(
            f"dynident: the command line needs the package {missing.name}, which the light installation leaves out; "
            f"{install_hint(missing.name)}"
        )
    app(prog_name="dynident")


if __name__ == "__main__":
    main()
