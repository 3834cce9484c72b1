"""A backup that is killed at any instant, over an older one, leaves one whole backup."""

from __future__ import annotations

import random
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.stores import Store, open_store
from test_backup import Open, at, hashes

from dynident.errors import DynidentError
from dynident_service.storage.backup_and_restore import back_up, open_archive_for_writing, restore
from dynident_service.storage.database import migrate
from dynident_service.storage.integrity_check import check_storage

__all__ = ["at"]
PROGRAM = Path(__file__).parent / "writing_a_backup.py"


def start(folder: Path, target: Path) -> subprocess.Popen[str]:
    """A process that writes a backup; it begins now."""
    command = [sys.executable, str(PROGRAM), str(folder), str(target)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "begin\n"
    return process


@pytest.mark.parametrize("name", ["backup", "backup.zip"])
@pytest.mark.parametrize("kills", [3, pytest.param(20, marks=pytest.mark.thorough)])
def test_a_backup_killed_at_random_instants_leaves_one_whole(at: Open, tmp_path: Path, name: str, kills: int) -> None:
    store, target = at("data"), tmp_path / name
    make_some(store, "first", 30)
    with start(tmp_path / "data", target) as process:
        began = time.monotonic()
        assert process.stdout is not None
        assert process.stdout.readline() == "end\n"
    seconds = time.monotonic() - began
    whole = hashes(store)
    instants = random.Random(1)
    for number in range(kills):
        make_some(store, f"round {number}", 8)
        present = hashes(store)
        with start(tmp_path / "data", target) as process:
            time.sleep(instants.uniform(0.0, seconds))
            process.kill()
        restored = restored_from(target, tmp_path / f"restored {number}")
        assert restored in (whole, present)
        whole = restored
    back_up(store.database, store.objects, target)
    assert restored_from(target, tmp_path / "restored at last") == hashes(store)
    assert list(tmp_path.glob("*.part")) == []
    if target.is_dir():
        assert len(list(target.glob("tables*"))) == 1
        assert {path.name for path in (target / "objects").iterdir()} == {
            key for key, _ in store.objects.list_objects()
        }


def make_some(store: Store, name: str, number: int) -> None:
    for n in range(number):
        store.make(f"{name}, {n}".encode() * 3000)


def restored_from(target: Path, folder: Path) -> dict[str, str]:
    """The hashes of what a backup holds; a doctor finds nothing wrong with it."""
    folder.mkdir()
    store = open_store(f"sqlite:///{folder / 'dynident.sqlite3'}", folder)
    migrate(store.database)
    restore(store.database, store.objects, target, folder / "scratch")
    assert list(check_storage(store.database, store.objects)) == []
    found = hashes(store)
    store.database.close()
    shutil.rmtree(folder)
    return found


@pytest.fixture
def cut(at: Open, tmp_path: Path) -> Iterator[tuple[Store, Path]]:
    """A store with a backup, and what a process left in that which was killed."""
    store, target = at("data"), tmp_path / "backup"
    make_some(store, "first", 3)
    back_up(store.database, store.objects, target)
    (target / "tables-0123456789abcdef").mkdir()
    (target / "tables-0123456789abcdef" / "resources.jsonl.part").write_bytes(b"{")
    (target / "objects" / f"{'0' * 64}.part").write_bytes(b"half")
    (target / "notes.txt").write_text("of somebody else")
    return store, target


def test_what_a_killed_backup_left_is_removed_and_nothing_else(cut: tuple[Store, Path]) -> None:
    store, target = cut
    gone = store.resources.list_page("robot", 1).items[0]
    store.resources.delete("robot", gone.id)
    back_up(store.database, store.objects, target)
    assert len(list(target.glob("tables*"))) == 1
    assert len(list((target / "objects").iterdir())) == 2
    assert (target / "notes.txt").read_text() == "of somebody else"


def test_two_processes_do_not_write_one_backup_at_a_time(cut: tuple[Store, Path], tmp_path: Path) -> None:
    store, target = cut
    for archive in (target, tmp_path / "backup.zip"):
        with open_archive_for_writing(archive), pytest.raises(DynidentError, match="another process is writing"):
            back_up(store.database, store.objects, archive)
    assert restored_from(target, tmp_path / "restored") == hashes(store)


def test_tables_are_read_from_nowhere_but_the_archive(cut: tuple[Store, Path], tmp_path: Path) -> None:
    _, target = cut
    manifest = target / "manifest.json"
    manifest.write_text(manifest.read_text().replace('"tables": "tables-', '"tables": "../tables-'))
    with pytest.raises(DynidentError, match="is not a folder of tables"):
        restored_from(target, tmp_path / "restored")


def test_a_backup_whose_manifest_is_damaged_is_not_written_over(cut: tuple[Store, Path]) -> None:
    store, target = cut
    (target / "manifest.json").write_text("{")
    with pytest.raises(DynidentError, match="its manifest is damaged; write into another folder"):
        back_up(store.database, store.objects, target)
