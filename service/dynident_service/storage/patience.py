"""Waits for a database or an object store that is away for a moment, instead of failing for it."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import TypeVar

from obstore.exceptions import BaseError
from sqlalchemy.exc import InterfaceError, OperationalError
from sqlalchemy.exc import TimeoutError as NoConnection

from dynident_service.storage.tombstones import ObjectGone

T = TypeVar("T")

AWAY = (OperationalError, InterfaceError, NoConnection, BaseError)
"""A database that is away or locked, a store that does not answer."""
INFRASTRUCTURE = (*AWAY, ObjectGone)
"""What is no fault of a computation, which is therefore done again."""
FIRST_PAUSE = 0.1
LONGEST_PAUSE = 5.0
log = logging.getLogger("dynident.storage")


def patiently(action: Callable[[], T], patience: float) -> T:
    """Try until it succeeds; what went wrong last is raised after so many seconds."""
    until, pause = time.monotonic() + patience, FIRST_PAUSE
    while True:
        try:
            return action()
        except AWAY as error:
            if time.monotonic() + pause > until:
                raise
            log.warning("%s; trying again", reason_of(error))
        time.sleep(pause)
        pause = min(2 * pause, LONGEST_PAUSE)


def reason_of(error: BaseException) -> str:
    """Say in one line what went wrong, without statements and parameters."""
    inner = getattr(error, "orig", None) or error
    first_line = (str(inner).splitlines() or [""])[0]
    return f"{type(inner).__name__}: {first_line}"[:200]
