"""`python -m dynident_service.new_key NAME` makes an API key and prints it, this once."""

from __future__ import annotations

import sys

from dynident_service.keys import create_key
from dynident_service.settings import Settings
from dynident_service.storage.database import Database
from dynident_service.storage.migrate import migrate


def main(arguments: list[str]) -> int:
    """Make a key under the name given."""
    if len(arguments) != 1:
        print(__doc__, file=sys.stderr)
        return 2
    database = Database(Settings().database)
    migrate(database)
    print(create_key(database, arguments[0]))
    database.close()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
