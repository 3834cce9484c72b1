"""`python -m dynident_service`: start the service with the settings of the environment."""

from __future__ import annotations

import sys

from dynident.errors import DynidentError
from dynident_service.environment_secrets import hide_secrets


def main() -> int:
    """Start the service; return the exit code if it cannot start."""
    hide_secrets()
    from dynident_service.serve import serve

    try:
        serve()
    except DynidentError as error:
        print(f"dynident: {error.title}\n  {error.detail}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
