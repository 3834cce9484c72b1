"""Repeat calls while the database or object store is away; which errors count as that."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import TypeVar

from obstore.exceptions import BaseError
from sqlalchemy.exc import InterfaceError, OperationalError
from sqlalchemy.exc import TimeoutError as NoConnection

from dynident_service.storage.deletion_and_expiry import ObjectGone

T = TypeVar("T")

AWAY = (OperationalError, InterfaceError, NoConnection, BaseError)
"""Exceptions of a database that is away or locked, and of a store that does not answer."""
INFRASTRUCTURE_ERRORS = (*AWAY, ObjectGone)
"""Exceptions that are no fault of a computation, which is therefore repeated."""
FIRST_PAUSE = 0.1
LONGEST_PAUSE = 5.0
log = logging.getLogger("dynident.storage")


def retry_while_away(action: Callable[[], T], patience: float) -> T:
    """Repeat an action while the database or the store is away.

    After `patience` seconds the last exception is raised.
    """
    until, pause = time.monotonic() + patience, FIRST_PAUSE
    while True:
        try:
            return action()
        except AWAY as error:
            if time.monotonic() + pause > until:
                raise
            log.warning("%s; trying again", describe_error(error))
        time.sleep(pause)
        # Pauses grow, so that many workers do not press a server that is just starting.
        pause = min(2 * pause, LONGEST_PAUSE)


def describe_error(error: BaseException) -> str:
    """Return an exception in one line, without SQL statements and parameters, which may hold user data."""
    inner = getattr(error, "orig", None) or error
    # The lines behind it are the statement and its parameters.
    first_line = (str(inner).splitlines() or [""])[0]
    return f"{type(inner).__name__}: {first_line}"[:200]
