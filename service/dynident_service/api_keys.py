"""API keys: scopes (read, submit, admin), owner, expiry; only their SHA-256 is stored; checked for each request."""

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

from dynident_service.fair_queue import name_address_party, name_key_party
from dynident_service.settings import Settings, hash_key
from dynident_service.storage.database import Database, get_database_time
from dynident_service.storage.database_tables import KeyRow, get_utc_time
from dynident_service.storage.quotas import UNLIMITED, QuotaLimits

Scope = Literal["read", "submit", "admin"]
SCOPES: tuple[Scope, ...] = ("read", "submit", "admin")
"""Scopes in ascending order: read, send and change, delete. Each includes those before it."""
STORES_NOTHING = re.compile("/v1/robots/[^/]+/poses/?")
"""Paths to which a POST only asks a question that is too long for a URL; nothing is stored."""
NOTED_EVERY = 60.0
"""Seconds between records of a key's last use."""


@dataclass(frozen=True)
class KeyHolder:
    """Holder of a key, and what the key allows."""

    name: str
    scope: Scope = "admin"
    owner: str | None = None
    expires_at: datetime | None = None
    last_used_at: datetime | None = None
    limits: QuotaLimits = UNLIMITED
    """Limits of the key, which take precedence over those of the settings."""

    def is_allowed(self, method: str, path: str) -> bool:
        """Return whether the key allows a method on a path."""
        return SCOPES.index(self.scope) >= SCOPES.index(find_needed_scope(method, path))

    @property
    def is_expired(self) -> bool:
        """Whether the key has expired."""
        return self.expires_at is not None and self.expires_at <= get_utc_time()


def find_needed_scope(method: str, path: str) -> Scope:
    """Return the scope that a method on a path requires."""
    if method in ("GET", "HEAD", "OPTIONS") or (method == "POST" and STORES_NOTHING.fullmatch(path)):
        return "read"
    return "admin" if method == "DELETE" else "submit"


def create_key(
    database: Database,
    name: str,
    scope: Scope = "admin",
    owner: str | None = None,
    days: float | None = None,
    limits: QuotaLimits | None = None,
) -> str:
    """Create a key and store its hash; the key itself is returned only this once.

    `name` is that of the account, too, that it acts for; `days` is how long it is valid.
    """
    # The prefix tells what it is wherever it turns up, also to programs that search for leaked secrets.
    key = f"dynident_{secrets.token_urlsafe(32)}"
    with database.write() as session:
        expires_at = None if days is None else get_database_time(session) + timedelta(days=days)
        quotas = {f"quota_{kind}": most for kind, most in asdict(limits or QuotaLimits()).items()}
        session.add(KeyRow(sha256=hash_key(key), name=name, scope=scope, owner=owner, expires_at=expires_at, **quotas))
    return key


def revoke_keys(database: Database, name: str) -> int:
    """Delete all keys of a name, and return their number."""
    with database.write() as session:
        gone = delete(KeyRow).where(KeyRow.name == name).returning(KeyRow.sha256)
        return len(session.scalars(gone).all())


def list_keys(database: Database) -> list[KeyHolder]:
    """Return the holders of all keys in the database."""
    with database.read() as session:
        return [_to_holder(row) for row in session.scalars(select(KeyRow).order_by(KeyRow.name, KeyRow.created_at))]


def extract_key(headers: Headers) -> str | None:
    """Return the key in the headers of a request, or None."""
    # The standard header goes before our own, which programs without bearer tokens use.
    scheme, _, token = headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer" and token:
        return token.strip()
    return headers.get("x-api-key")


class KeyRing:
    """The accepted keys, of the settings and of the database."""

    def __init__(self, settings: Settings, database: Database) -> None:
        self._configured = {key.get_secret_value() for key in settings.api_keys}
        self._database = database
        self._noted: dict[str, float] = {}
        self._names: dict[str, str] = {}
        """Names of keys that were used, by hash: they identify a party before the database is asked."""

    def is_empty(self) -> bool:
        """Return whether there is no key at all, so that nobody could ever use the service."""
        if self._configured:
            return False
        with self._database.read() as session:
            return session.scalar(select(KeyRow.sha256).limit(1)) is None

    def find_holder(self, key: str) -> KeyHolder | None:
        """Return the holder of a key, or None if it is unknown; record its use from time to time."""
        hashed = hash_key(key)
        # Looked up again for each request: a key that was revoked is refused from the next one on.
        holder = self._look_up(hashed)
        if holder is not None:
            self._names[hashed] = holder.name
        return holder

    def find_party(self, scope: RequestScope) -> str:
        """Return the party of a request: its key if that was used before, else its address."""
        key = extract_key(Headers(scope=scope))
        name = None if key is None else self._names.get(hash_key(key))
        return name_address_party(scope) if name is None else name_key_party(name)

    def _look_up(self, hashed: str) -> KeyHolder | None:
        # Compared in constant time, so that the duration tells nothing about the hash.
        if any(secrets.compare_digest(hashed, known_hash) for known_hash in self._configured):
            return KeyHolder("DYNIDENT_API_KEYS")
        with self._database.read() as session:
            row = session.get(KeyRow, hashed)
        if row is None:
            return None
        holder = _to_holder(row)
        if not holder.is_expired and time.monotonic() - self._noted.get(hashed, -NOTED_EVERY) >= NOTED_EVERY:
            # Written once a minute at most: a write for every request would make all of them wait for the writer.
            self._noted[hashed] = time.monotonic()
            with self._database.write() as session:
                session.execute(
                    update(KeyRow).where(KeyRow.sha256 == hashed).values(last_used_at=get_database_time(session))
                )
        return holder


def _to_holder(row: KeyRow) -> KeyHolder:
    limits = QuotaLimits(row.quota_bytes, row.quota_recordings, row.quota_jobs)
    return KeyHolder(row.name, cast(Scope, row.scope), row.owner, row.expires_at, row.last_used_at, limits)
