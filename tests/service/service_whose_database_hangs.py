"""Starts the service, for small jobs; its database answers no request as long as a file is there."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fork_servers import bring_up_without_science
from sqlalchemy.orm import Session

from dynident_service import serve as draining
from dynident_service.serve import serve
from dynident_service.storage.database import Database

HANGS = Path(os.environ["HANGS"])
read = Database.read


@contextmanager
def hang(self: Database) -> Iterator[Session]:
    with read(self) as session:
        if HANGS.exists():
            threading.Event().wait()
        yield session


if __name__ == "__main__":
    bring_up_without_science()
    Database.read = hang  # type: ignore[method-assign]
    draining.LONGEST_END = 2.0
    serve()
