"""API keys: 256 random bits, of which only the SHA-256 is kept; what each allows, to whom, and until when."""

from __future__ import annotations

import re
import secrets
import time
from dataclasses import asdict, dataclass
from datetime import datetime, timedelta
from typing import Literal, cast

from sqlalchemy import delete, select, update
from starlette.datastructures import Headers
from starlette.types import Scope as RequestScope

from dynident_service.fair_shares import party_of_address, party_of_key
from dynident_service.settings import Settings, hash_of
from dynident_service.storage.database import Database, clock
from dynident_service.storage.quotas import UNLIMITED, Limits
from dynident_service.storage.tables import KeyRow, now

Scope = Literal["read", "submit", "admin"]
SCOPES: tuple[Scope, ...] = ("read", "submit", "admin")
"""Each allows what those before it allow: to look, to send and change, to delete."""
STORES_NOTHING = re.compile("/v1/robots/[^/]+/poses/?")
"""Paths to which a POST only asks: its question is too long for an address, and nothing is kept of it."""
NOTED_EVERY = 60.0
"""Seconds after which the use of a key is noted again."""


@dataclass(frozen=True)
class Holder:
    """Who uses a key, and what it allows."""

    name: str
    scope: Scope = "admin"
    owner: str | None = None
    expires_at: datetime | None = None
    last_used_at: datetime | None = None
    limits: Limits = UNLIMITED
    """Its own, which go before those of the settings."""

    def may(self, method: str, path: str) -> bool:
        """Tell whether the key allows requests of a method to a path."""
        return SCOPES.index(self.scope) >= SCOPES.index(needed_scope(method, path))

    @property
    def is_expired(self) -> bool:
        """Whether its time is over."""
        return self.expires_at is not None and self.expires_at <= now()


def needed_scope(method: str, path: str) -> Scope:
    """Tell what a key must allow for requests of a method to a path."""
    if method in ("GET", "HEAD", "OPTIONS") or (method == "POST" and STORES_NOTHING.fullmatch(path)):
        return "read"
    return "admin" if method == "DELETE" else "submit"


def create_key(
    database: Database,
    name: str,
    scope: Scope = "admin",
    owner: str | None = None,
    days: float | None = None,
    limits: Limits | None = None,
) -> str:
    """Make a key and store its hash; the key itself is shown this once."""
    key = f"dynident_{secrets.token_urlsafe(32)}"
    with database.write() as session:
        expires_at = None if days is None else clock(session) + timedelta(days=days)
        quotas = {f"quota_{kind}": most for kind, most in asdict(limits or Limits()).items()}
        session.add(KeyRow(sha256=hash_of(key), name=name, scope=scope, owner=owner, expires_at=expires_at, **quotas))
    return key


def revoke_keys(database: Database, name: str) -> int:
    """Delete the keys of a name; tells how many there were."""
    with database.write() as session:
        gone = delete(KeyRow).where(KeyRow.name == name).returning(KeyRow.sha256)
        return len(session.scalars(gone).all())


def list_keys(database: Database) -> list[Holder]:
    """List the keys of the database, without anything that opens."""
    with database.read() as session:
        return [_holder(row) for row in session.scalars(select(KeyRow).order_by(KeyRow.name, KeyRow.created_at))]


def key_in(headers: Headers) -> str | None:
    """Take the key of a request from its headers; `None` where it has none."""
    scheme, _, token = headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer" and token:
        return token.strip()
    return headers.get("x-api-key")


class KeyRing:
    """Tells whether a key is known, and what it allows."""

    def __init__(self, settings: Settings, database: Database) -> None:
        self._configured = {key.get_secret_value() for key in settings.api_keys}
        self._database = database
        self._noted: dict[str, float] = {}
        self._names: dict[str, str] = {}
        """Of the keys that were used, by their hashes: for who is counted before the database is asked."""

    def is_empty(self) -> bool:
        """Tell whether there is no key at all, so that nobody could ever enter."""
        if self._configured:
            return False
        with self._database.read() as session:
            return session.scalar(select(KeyRow.sha256).limit(1)) is None

    def holder_of(self, key: str) -> Holder | None:
        """Give who uses a key, and note from time to time that it is used; `None` where it is not known."""
        hashed = hash_of(key)
        holder = self._look_up(hashed)
        if holder is not None:
            self._names[hashed] = holder.name
        return holder

    def party_of(self, scope: RequestScope) -> str:
        """Name the party that a request comes from: its key where that was used before, else its address."""
        key = key_in(Headers(scope=scope))
        name = None if key is None else self._names.get(hash_of(key))
        return party_of_address(scope) if name is None else party_of_key(name)

    def _look_up(self, hashed: str) -> Holder | None:
        if any(secrets.compare_digest(hashed, one) for one in self._configured):
            return Holder("DYNIDENT_API_KEYS")
        with self._database.read() as session:
            row = session.get(KeyRow, hashed)
        if row is None:
            return None
        holder = _holder(row)
        if not holder.is_expired and time.monotonic() - self._noted.get(hashed, -NOTED_EVERY) >= NOTED_EVERY:
            self._noted[hashed] = time.monotonic()
            with self._database.write() as session:
                session.execute(update(KeyRow).where(KeyRow.sha256 == hashed).values(last_used_at=clock(session)))
        return holder


def _holder(row: KeyRow) -> Holder:
    limits = Limits(row.quota_bytes, row.quota_recordings, row.quota_jobs)
    return Holder(row.name, cast(Scope, row.scope), row.owner, row.expires_at, row.last_used_at, limits)
