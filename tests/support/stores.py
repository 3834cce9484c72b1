"""Object stores and databases in a folder, as tests of the service open them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from service_helpers import TWO_JOINTS

from dynident_service.storage.database import Database
from dynident_service.storage.object_store import ObjectGone, ObjectStore
from dynident_service.storage.repository_values import NewResource, OwnedObject, Resource
from dynident_service.storage.resource_repository import Resources

CONTENT = b"t,q1,tau1\n" * 100
ROBOT = {"name": "arm", "description": {"format": "modified_dh", "content": TWO_JOINTS}}
NO_BASE = {"count": 0, "rank": 0, "names": [], "groupings": []}
SHOWN = {"joints": [], "base_parameters": NO_BASE, "has_inertias": False}
"""As much as it takes for it to be shown."""


@dataclass(frozen=True)
class Store:
    """A database, an object store, and what is made of both."""

    database: Database
    objects: ObjectStore
    resources: Resources

    def put(self, content: bytes = CONTENT) -> NewResource:
        """Put bytes; gives the resource that is to own them."""
        stored = self.resources.put(content)
        owned = (OwnedObject("original", stored.key, stored.size, "text/csv"),)
        return NewResource("robot", ROBOT, "arm", SHOWN, objects=owned)

    def make(self, content: bytes = CONTENT) -> Resource:
        """Make a resource that owns bytes, as often as it takes."""
        while True:
            try:
                return self.resources.create(self.put(content))
            except ObjectGone:
                continue

    def file_of(self, resource: Resource) -> Path:
        """The file that holds what a resource owns."""
        key = resource.objects["original"].key
        (found,) = (path for path in (self.database_folder / "objects").rglob(key))
        return found

    @property
    def database_folder(self) -> Path:
        return Path(self.objects.url.removeprefix("file://")).parent


def open_store(url: str, folder: Path) -> Store:
    database = Database(url)
    objects = ObjectStore((folder / "objects").as_uri(), folder / "cache")
    return Store(database, objects, Resources(database, objects))
