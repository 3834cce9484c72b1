"""`dynident doctor` finds what is missing, damaged or kept for nobody."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest
from fork_servers import WithoutScience
from support.stores import CONTENT, Store, open_store
from typer.testing import CliRunner

from dynident_cli.program_and_exit_codes import app
from dynident_service import readability_checks
from dynident_service.jobs.child_pool import ForkServer
from dynident_service.storage.database import migrate
from dynident_service.storage.deletion_and_expiry import sweep_objects
from dynident_service.storage.integrity_check import Defect, check_storage, repair
from dynident_service.storage.repository_values import Kind, NewResource, OwnedObject

OLDER = Path(__file__).parent.parent / "older_versions"


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    opened = open_store(f"sqlite:///{tmp_path / 'dynident.sqlite3'}", tmp_path)
    migrate(opened.database)
    yield opened
    opened.database.close()


def found(store: Store, *, by_hash: bool = True) -> list[Defect]:
    return list(check_storage(store.database, store.objects, by_hash=by_hash))


def told(store: Store, *options: str) -> tuple[int, str]:
    run = CliRunner().invoke(app, ["doctor", "--data-dir", str(store.database_folder), *options])
    return run.exit_code, run.output


def test_a_sound_store_is_well(store: Store) -> None:
    store.make()
    store.put(b"for nobody yet")
    store.objects.ping()
    assert found(store) == []
    assert told(store) == (0, "no faults found\n")


def test_what_is_missing_cut_or_changed_is_told_with_what_needs_it(store: Store) -> None:
    missing, cut, changed, sound = (store.make(CONTENT + bytes([n])) for n in range(4))
    store.file_of(missing).unlink()
    store.file_of(cut).write_bytes(CONTENT)
    store.file_of(changed).write_bytes(CONTENT + b"?")
    told_of = {(one.owners, one.trouble) for one in found(store)}
    assert told_of == {((missing.id,), "missing"), ((cut.id,), "cut"), ((changed.id,), "damaged")}
    assert len(found(store, by_hash=False)) == 2
    code, text = told(store, "--repair")
    assert code == 1
    assert all(one.id in text for one in (missing, cut, changed))
    assert sound.id not in text


def test_orphans_and_leftovers_are_put_right_and_nothing_else_is_touched(store: Store) -> None:
    resource = store.make()
    orphan = store.objects.put_bytes(b"nobody knows of this one")  # around the resources, as older versions could
    leftover, unfinished = (store.file_of(resource).with_name(f"{orphan.key}#{n}") for n in (1, 2))
    foreign = store.file_of(resource).with_name("notes.txt")
    for path in (leftover, unfinished, foreign):
        path.write_bytes(b"half a fi")
    for path in (leftover, foreign):
        os.utime(path, (1, 1))
    assert {(one.trouble, one.what) for one in found(store)} == {("orphan", orphan.key), ("leftover", str(leftover))}
    assert told(store)[0] == 1
    assert told(store, "--repair")[0] == 0
    assert found(store) == []
    assert (leftover.exists(), unfinished.exists(), foreign.exists()) == (False, True, True)
    assert store.objects.get_size(orphan.key) is not None  # until the sweep
    sweep_objects(store.database, store.objects, timedelta(0))
    assert store.objects.get_size(orphan.key) is None
    assert store.objects.get(resource.objects["original"].key) == CONTENT


def test_what_cannot_be_put_right_without_loss_is_refused(store: Store) -> None:
    with pytest.raises(ValueError, match="missing"):
        repair(store.database, Defect("missing", "0" * 64, "gone"))


def test_damaged_pages_of_the_database_are_told(store: Store) -> None:
    for number in range(200):
        store.make(b"%d" % number)
    store.database.close()
    file = store.database_folder / "dynident.sqlite3"
    content = bytearray(file.read_bytes())
    content[4096 * 3 : 4096 * 12] = b"\x5a" * (4096 * 9)
    file.write_bytes(content)
    code, text = told(store)
    assert code == 1
    assert "database: " in text


def test_a_folder_that_is_not_there_is_told_and_not_made(tmp_path: Path) -> None:
    folder = tmp_path / "nowhere"
    run = CliRunner().invoke(app, ["doctor", "--data-dir", str(folder)])
    assert run.exit_code == 2
    assert not folder.exists()


def test_every_resource_that_cannot_be_read_is_told_with_the_reason_and_what_to_do(store: Store) -> None:
    def made(kind: Kind, role: str, content: bytes) -> str:
        stored = store.resources.put(content)
        owned = (OwnedObject(role, stored.key, stored.size, "application/octet-stream"),)
        return store.resources.create(NewResource(kind, {}, result={}, objects=owned)).id

    newer = io.BytesIO()
    np.savez(newer, header=np.frombuffer(b'{"format": "dynident identification 99", "rungs": 1}', np.uint8))
    older = (OLDER / "model_of_format_1.npz").read_bytes()
    unreadable = {
        made("identification", "model", older): "its request or its result: ValidationError",
        made("identification", "model", newer.getvalue()): "has the format 99, but this version reads formats 1 to 5",
        made("measurement", "recording", b"no Parquet"): "is not a Parquet file",
        made("comparison", "signals", b"no signals"): "ArrowInvalid",
        made("series", "days", b"no days"): "not a file of days",
        made("diagnosis", "evidence", b"[{}]"): "ValidationError",
        made("design", "trajectory", b"no design"): "its trajectory",
        store.resources.create(NewResource("robot", {"name": "old"})).id: "its description",
    }
    code, text = told(store)
    assert code == 1
    lines = {line.split(": ")[1]: line for line in text.splitlines() if line.startswith("unreadable: ")}
    assert lines.keys() == unreadable.keys()
    for identifier, reason in unreadable.items():
        assert reason in lines[identifier]
    assert "\n8 unreadable: compute it again, its request is stored" in text
    assert told(store, "--quick") == (0, "no faults found\n")


def test_a_file_that_kills_or_blocks_its_reader_is_told_and_the_next_is_read(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(readability_checks, "FUNCTION", "small_jobs:read_as_it_says")
    monkeypatch.setattr(ForkServer, "PROGRAM", WithoutScience.PROGRAM)
    with readability_checks.StoredFilesReader(store.objects) as reader:
        assert reader.find_problem(store.resources.create(NewResource("robot", {"it": "is read"}))) is None
        for what in ("dies", "hangs"):
            store.resources.create(NewResource("robot", {"it": what}))
        monkeypatch.setattr(readability_checks, "LONGEST", 5.0)  # from here on each process begins at once
        details = {one.detail for one in check_storage(store.database, store.objects, problem_of=reader.find_problem)}
    assert details == {"the process that read it died", "it was not read within 5 s"}


def test_the_check_alone_knows_how_each_kind_is_shown() -> None:
    """In a process of its own: in this one, the routes may have been imported by others."""
    code = (
        "import sys, typing, dynident_service.readability_checks as checks;"
        "from dynident_service.storage.repository_values import Kind;"
        "print(sorted(set(typing.get_args(Kind)) - set(checks.SHOW_FUNCTIONS)), 'numpy' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[] False"
