"""Writes a backup of a folder: a process to be killed meanwhile."""

import sys
from pathlib import Path

from dynident_service.storage.backup_and_restore import back_up
from dynident_service.storage.database import Database
from dynident_service.storage.object_store import ObjectStore

if __name__ == "__main__":
    folder, target = Path(sys.argv[1]), Path(sys.argv[2])
    database = Database(f"sqlite:///{folder / 'dynident.sqlite3'}")
    objects = ObjectStore((folder / "objects").as_uri(), folder / "cache")
    print("begin", flush=True)
    back_up(database, objects, target)
    print("end", flush=True)
