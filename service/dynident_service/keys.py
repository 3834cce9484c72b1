"""API keys: 256 random bits, of which only the SHA-256 is kept."""

from __future__ import annotations

import hashlib
import secrets

from sqlalchemy import select

from dynident_service.settings import Settings
from dynident_service.storage.database import Database
from dynident_service.storage.tables import KeyRow


def create_key(database: Database, name: str) -> str:
    """Make a key and store its hash; the key itself is shown this once."""
    key = f"dynident_{secrets.token_urlsafe(32)}"
    with database.write() as session:
        session.add(KeyRow(sha256=hash_of(key), name=name))
    return key


def hash_of(key: str) -> str:
    """SHA-256 is enough for a random key: there is no dictionary to try."""
    return hashlib.sha256(key.encode()).hexdigest()


class KeyRing:
    """Tells whether a key is known."""

    def __init__(self, settings: Settings, database: Database) -> None:
        self._configured = {hash_of(key.get_secret_value()) for key in settings.api_keys}
        self._database = database

    def is_empty(self) -> bool:
        """Tell whether there is no key at all, so that nobody could ever enter."""
        if self._configured:
            return False
        with self._database.read() as session:
            return session.scalar(select(KeyRow.sha256).limit(1)) is None

    def knows(self, key: str) -> bool:
        """Tell whether a key is known."""
        hashed = hash_of(key)
        if any(secrets.compare_digest(hashed, one) for one in self._configured):
            return True
        with self._database.read() as session:
            return session.get(KeyRow, hashed) is not None
