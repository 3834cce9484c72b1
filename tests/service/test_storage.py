from __future__ import annotations

import hashlib
import io
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest
from alembic import command
from hypothesis import given
from hypothesis import strategies as st
from sqlalchemy import text

from dynident_service.problems import ProblemError
from dynident_service.storage.database import WRITES, Database, build_alembic_config, migrate
from dynident_service.storage.database_tables import KeyRow
from dynident_service.storage.job_queue import JobQueue
from dynident_service.storage.object_store import ObjectStore
from dynident_service.storage.repository_values import Dependency, NewResource, Retry, Siblings, create_identifier
from dynident_service.storage.resource_repository import Resources, SiblingsCame


@pytest.fixture
def objects(tmp_path: Path) -> ObjectStore:
    return ObjectStore((tmp_path / "objects").as_uri(), tmp_path / "cache")


def test_an_object_comes_back_under_the_hash_of_its_bytes(objects: ObjectStore) -> None:
    content = bytes(range(256)) * 50_000
    stored = objects.put_file(io.BytesIO(content))
    assert stored.key == hashlib.sha256(content).hexdigest()
    assert stored.size == len(content)
    assert stored.created
    assert objects.get(stored.key) == content
    assert b"".join(objects.stream(stored.key)) == content
    assert objects.fetch_file(stored.key).read_bytes() == content


def test_the_same_bytes_are_stored_once(objects: ObjectStore) -> None:
    assert objects.put_bytes(b"abc").created
    assert not objects.put_bytes(b"abc").created
    assert not objects.put_file(io.BytesIO(b"abc")).created


def test_deleting_an_object_twice_does_no_harm(objects: ObjectStore) -> None:
    key = objects.put_bytes(b"abc").key
    objects.delete(key)
    objects.delete(key)
    assert objects.get_size(key) is None
    with pytest.raises(ProblemError, match="missing"):
        objects.fetch_file(key)


@pytest.fixture(scope="module")
def module_objects(tmp_path_factory: pytest.TempPathFactory) -> ObjectStore:
    folder = tmp_path_factory.mktemp("objects")
    return ObjectStore(folder.as_uri(), folder / "cache")


@given(st.binary(max_size=300))
def test_any_bytes_survive(module_objects: ObjectStore, content: bytes) -> None:
    assert module_objects.get(module_objects.put_bytes(content).key) == content


def test_the_migrations_make_exactly_the_tables_that_the_code_uses(tmp_path: Path) -> None:
    database = Database(f"sqlite:///{tmp_path / 'db.sqlite3'}")
    migrate(database)
    migrate(database)
    with database.engine.connect() as connection:
        command.check(build_alembic_config(connection))
    database.close()


def test_a_database_of_the_first_version_is_brought_up_with_its_data(tmp_path: Path) -> None:
    database = Database(f"sqlite:///{tmp_path / 'db.sqlite3'}")
    with database.engine.execution_options(**{WRITES: True}).begin() as connection:
        command.upgrade(build_alembic_config(connection), "0001")
        connection.execute(
            text(
                "INSERT INTO jobs (id, kind, function, arguments, state, fraction, message, attempt, deaths, "
                "cancel_requested, created_at) VALUES ('job_old', 'report', 'a:b', '{}', 'queued', 0, '', 0, 1, 0, "
                "'2025-01-01 00:00:00')"
            )
        )
    migrate(database)
    (claim,) = JobQueue(database).claim(1)
    assert claim.job_id == "job_old"
    database.close()


def test_writers_wait_for_each_other_instead_of_failing(tmp_path: Path) -> None:
    database = Database(f"sqlite:///{tmp_path / 'db.sqlite3'}")
    migrate(database)
    failures: list[Exception] = []

    def write(name: str) -> None:
        try:
            for number in range(25):
                with database.write() as session:
                    # Read, then write: what a deferred transaction may not do once another has written.
                    session.get(KeyRow, "none")
                    session.add(KeyRow(sha256=f"{name}{number}", name=name))
        except Exception as error:
            failures.append(error)

    threads = [threading.Thread(target=write, args=(f"t{k}",)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failures == []
    with database.read() as session:
        assert len(session.query(KeyRow).all()) == 100
    database.close()


def test_identifiers_are_unique_and_sort_by_age_also_within_one_millisecond() -> None:
    made = [create_identifier("job") for _ in range(5000)]
    assert made == sorted(set(made))
    assert len(made[0]) <= 40


def test_identifiers_grow_though_the_clock_is_set_back(monkeypatch: pytest.MonkeyPatch) -> None:
    first = create_identifier("robot")
    monkeypatch.setattr("time.time_ns", lambda: 1_000_000)
    assert first < create_identifier("robot") < create_identifier("robot")


def test_of_resources_that_follow_the_same_one_at_the_same_time_one_is_stored(
    new_database: Database, objects: ObjectStore
) -> None:
    migrate(new_database)
    resources = Resources(new_database, objects)
    campaign = resources.create(NewResource("campaign", {}))
    retry = Retry("POST /tell", "key", "of the body")
    model = NewResource(
        "identification",
        {},
        rests_on=(Dependency(campaign.id, "campaign", "campaign", "/"),),
        siblings=Siblings(campaign.id, ()),
        retry=retry,
    )

    def store(number: int) -> str | None:
        try:
            # Two of them are tries of one request.
            return resources.create(model if number < 2 else replace(model, retry=None)).id
        except SiblingsCame:
            return None

    with ThreadPoolExecutor(6) as threads:
        stored = [identifier for identifier in threads.map(store, range(6)) if identifier is not None]
    (first,) = set(stored)
    # What was seen does not stand in the way, nor what is of another kind.
    seen = Siblings(campaign.id, (first,))
    assert resources.create(replace(model, retry=None, siblings=seen)).id != first
    assert resources.create(replace(model, kind="design", retry=None))
