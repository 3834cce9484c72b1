"""Resources that own the same bytes are made and deleted at the same time, and files are damaged."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path

import pytest
from support.stores import CONTENT, Store, open_store

from dynident_service.problems import ProblemError
from dynident_service.storage.database import migrate
from dynident_service.storage.deletion_and_expiry import sweep_objects
from dynident_service.storage.object_store import ObjectGone

AT_ONCE = timedelta(0)


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    opened = open_store(f"sqlite:///{tmp_path / 'db.sqlite3'}", tmp_path)
    migrate(opened.database)
    yield opened
    opened.database.close()


def make_and_delete_the_same_bytes(url: str, folder: Path, times: int) -> None:
    """Four make and delete, each with its own connection as if it were a process; one sweeps without any grace."""
    first = open_store(url, folder)
    migrate(first.database)
    lost: list[str] = []
    made: list[str] = []
    over = threading.Event()

    def work() -> None:
        store = open_store(url, folder)
        for _ in range(times // 4):
            resource = store.make()
            made.append(resource.id)
            try:
                found = store.objects.get(resource.objects["original"].key)
            except ProblemError:
                found = b""
            if found != CONTENT:
                lost.append(resource.id)
            store.resources.delete("robot", resource.id)
        store.database.close()

    def clean() -> None:
        store = open_store(url, folder)
        while not over.wait(0.005):
            sweep_objects(store.database, store.objects, AT_ONCE)
        store.database.close()

    workers = [threading.Thread(target=work) for _ in range(4)]
    cleaner = threading.Thread(target=clean)
    for thread in (*workers, cleaner):
        thread.start()
    for thread in workers:
        thread.join()
    over.set()
    cleaner.join()
    assert len(made) == times
    assert lost == []
    sweep_objects(first.database, first.objects, AT_ONCE)
    assert list(first.objects.list_objects()) == []
    first.database.close()


def test_the_same_bytes_made_and_deleted_at_the_same_time_are_never_lost(tmp_path: Path) -> None:
    make_and_delete_the_same_bytes(f"sqlite:///{tmp_path / 'db.sqlite3'}", tmp_path, times=200)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_thousands_of_times_the_same_bytes_lose_nothing(
    tmp_path: Path, kind: str, request: pytest.FixtureRequest, thorough: bool
) -> None:
    url = f"sqlite:///{tmp_path / 'db.sqlite3'}" if kind == "sqlite" else request.getfixturevalue("postgresql")
    # What once was lost was one of twenty-five: of 500 some 20.
    make_and_delete_the_same_bytes(url, tmp_path, times=10_000 if thorough else 500)


def test_who_comes_to_own_what_was_swept_away_since_is_told_to_put_it_again(store: Store) -> None:
    new = store.put()
    sweep_objects(store.database, store.objects, AT_ONCE)
    with pytest.raises(ObjectGone):
        store.resources.create(new)
    assert store.resources.list_page("robot", 10).items == ()
    assert store.objects.get(store.make().objects["original"].key) == CONTENT


def test_what_nobody_came_to_own_goes_after_a_while_and_no_sooner(store: Store) -> None:
    (owned,) = store.put().objects
    assert sweep_objects(store.database, store.objects, timedelta(minutes=1)) == 0
    assert store.objects.get_size(owned.key) is not None
    assert sweep_objects(store.database, store.objects, AT_ONCE) == 1
    assert store.objects.get_size(owned.key) is None


def test_a_file_stays_as_long_as_anybody_owns_it(store: Store) -> None:
    first, second = store.make(), store.make()
    store.resources.delete("robot", first.id)
    assert sweep_objects(store.database, store.objects, AT_ONCE) == 0
    store.resources.delete("robot", second.id)
    assert sweep_objects(store.database, store.objects, AT_ONCE) == 1


def test_what_a_disk_changed_without_a_mark_on_the_file_is_mended_by_the_next_upload(store: Store) -> None:
    resource = store.make()
    file = store.file_of(resource)
    assert store.objects.fetch_file(file.name) == file  # looked at, and found as it should be
    before = file.stat()
    file.write_bytes(CONTENT[:-1] + b"?")
    os.utime(file, ns=(before.st_atime_ns, before.st_mtime_ns))
    store.make()
    assert file.read_bytes() == CONTENT


@pytest.mark.parametrize("damage", [CONTENT[:-1], CONTENT[:-1] + b"?"], ids=["cut", "changed"])
def test_a_damaged_file_is_noticed_on_reading_and_mended_by_the_next_upload(store: Store, damage: bytes) -> None:
    resource = store.make()
    key = resource.objects["original"].key
    assert store.objects.fetch_file(key).read_bytes() == CONTENT
    file = store.file_of(resource)
    file.write_bytes(damage)
    os.utime(file, ns=(1, 1))  # also one of another time
    for read in (store.objects.get, store.objects.fetch_file, lambda key: list(store.objects.stream(key))):
        with pytest.raises(ProblemError, match="is damaged"):
            read(key)
    store.make()
    assert store.objects.get(key) == CONTENT
