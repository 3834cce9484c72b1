"""The program `dynident`: the whole story on files, without a server."""

from __future__ import annotations

import sys


def main() -> None:
    """Run the command line."""
    try:
        from dynident_service.cli.app import app
    except ModuleNotFoundError as missing:
        if missing.name not in ("typer", "rich", "click"):
            raise
        sys.exit(
            f"dynident: the command line needs the package {missing.name}, which the light installation leaves out; "
            "install it with: pip install 'dynident[science]' (with 'dynident[service]' for `dynident serve`)"
        )
    app(prog_name="dynident")


if __name__ == "__main__":
    main()
