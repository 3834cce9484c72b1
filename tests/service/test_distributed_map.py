"""Parts of jobs on other workers, without a cluster (`test_distributed_map_on_a_cluster.py` has one)."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from service_helpers import SCIENCE, TWO_JOINTS
from support.measurement_uploads import as_csv, sound

from dynident.identification.robot_recording_import import import_for_robot
from dynident.recordings import Recording, RecordingMetadata, open_recording
from dynident.recordings.row_storage import ParquetSource
from dynident.robot import robot_from_modified_dh
from dynident_service.jobs import distributed_map
from dynident_service.jobs.child_pool import ChildPool
from dynident_service.jobs.distributed_map import OtherWorkers
from dynident_service.jobs.task_input_output import ClusterAddresses, JobEnvironment, pack_value, unpack_value
from dynident_service.problems import ProblemError
from dynident_service.storage.job_transitions import Claim
from dynident_service.storage.object_store import ObjectStore

CLAIM = Claim("job", 1, "small_jobs:answer", {}, None)
NOBODY = ClusterAddresses("tcp://127.0.0.1:9", "tcp://127.0.0.1:10")


def place(folder: Path, colleagues: ClusterAddresses | None = None) -> JobEnvironment:
    return JobEnvironment("sqlite://", (folder / "objects").as_uri(), folder / "cache", 3, 60.0, colleagues)


def test_a_recording_goes_as_the_key_of_its_file_and_is_opened_in_the_store_of_whoever_gets_it(tmp_path: Path) -> None:
    source, file = tmp_path / "run.csv", tmp_path / "run.parquet"
    source.write_bytes(as_csv(sound()))
    import_for_robot(robot_from_modified_dh("arm", json.dumps(TWO_JOINTS)), source, file, RecordingMetadata())
    here, there = (ObjectStore((tmp_path / name).as_uri(), tmp_path / "cache") for name in ("here", "there"))
    stored = here.fetch_file(here.put_bytes(file.read_bytes()).key)
    recording = open_recording(stored).with_windows(((1.0, 4.0),))
    content = pack_value(recording, here)
    assert len(content) < 2_000
    assert str(tmp_path).encode() not in content
    with pytest.raises(ProblemError, match="missing"):
        unpack_value(content, there)
    found = unpack_value(content, ObjectStore(here.url, tmp_path / "another"))
    assert isinstance(found, Recording)
    assert (found.path, found.windows) == (stored, ((1.0, 4.0),))
    assert isinstance(found.source, ParquetSource)
    rows = [next(iter(one.source.rows(0, 100, 100))) for one in (recording, found)]
    np.testing.assert_array_equal(rows[0].q, rows[1].q)
    there.put_bytes(file.read_bytes())
    elsewhere = unpack_value(content, there)
    assert isinstance(elsewhere, Recording)
    assert elsewhere.path == there.fetch_file(stored.name)


def test_only_files_of_the_store_have_a_key(tmp_path: Path) -> None:
    store = ObjectStore((tmp_path / "objects").as_uri(), tmp_path / "cache")
    key = store.put_bytes(b"samples").key
    assert store.find_key(store.fetch_file(key)) == key
    assert store.find_key(tmp_path / key) is None
    assert store.find_key(tmp_path / "objects") is None


def test_others_are_asked_only_for_what_is_worth_it_and_can_be_sent(tmp_path: Path) -> None:
    others = OtherWorkers(CLAIM, place(tmp_path), NOBODY, ObjectStore((tmp_path / "o").as_uri(), tmp_path))
    assert others.list_workers(len, 0.9 * distributed_map.WORTH) == ()  # type: ignore[arg-type]
    assert others.list_workers(lambda item, told: item, 2.0 * distributed_map.WORTH) == ()
    others.close()


def test_a_scheduler_that_is_away_is_asked_once_and_all_is_done_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(distributed_map, "PATIENCE", 0.5)
    asked: list[str] = []
    connected = OtherWorkers._get_client
    monkeypatch.setattr(OtherWorkers, "_get_client", lambda self: asked.append("") or connected(self))
    others = OtherWorkers(CLAIM, place(tmp_path), NOBODY, ObjectStore((tmp_path / "o").as_uri(), tmp_path))
    for _ in range(2):
        assert others.list_workers(max, 2.0 * distributed_map.WORTH) == ()  # type: ignore[arg-type]
    others.close()
    assert len(asked) == 1


def test_parts_leave_a_worker_to_its_jobs() -> None:
    pool = ChildPool(2, SCIENCE)
    try:
        with pool.mark_in_use(), pool.mark_in_use_if_spare() as one, pool.mark_in_use_if_spare() as other:
            assert (one, other) == (True, False)
            with pool.mark_in_use():  # a job comes whatever else there is
                pass
        with pool.mark_in_use_if_spare() as again:
            assert again
    finally:
        pool.close()
    with pool.mark_in_use_if_spare() as closed:
        assert not closed
