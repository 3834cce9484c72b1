"""A process that reads what strangers sent: which files, network, memory and time it can have, whatever it tries."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import anyio
import pytest
from fastapi import Request
from fastapi.testclient import TestClient
from pydantic import ByteSize
from service_helpers import SCIENCE, app_of, wait_for
from support.processes import is_running
from support.service_client import Client

from dynident_service import interactive_compute as awaited_module
from dynident_service.interactive_compute import InteractiveCompute
from dynident_service.jobs.confinement import ComputationLimits
from dynident_service.problems import ProblemError
from dynident_service.settings import Settings
from dynident_service.storage.job_queue import JobQueue
from dynident_service.storage.object_store import ObjectStore
from dynident_service.storage.repository_values import FINAL, NewJob
from dynident_service.storage_and_engine import confine_readers

MEMORY = 600_000_000


@dataclass(frozen=True)
class Installation:
    """A data directory with a secret, and the readers of its service."""

    data: Path
    settings: Settings
    readers: InteractiveCompute

    def ask(self, name: str, limits: ComputationLimits | None = None, **arguments: Any) -> Any:
        """Have a reader call a function."""

        async def call() -> Any:
            request = cast(Request, Client())
            return await self.readers.call(request, f"confined_calls:{name}", object, arguments, limits)

        return anyio.run(call)


@pytest.fixture(scope="module")
def installation(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Installation]:
    data = tmp_path_factory.mktemp("data")
    settings = Settings(data_dir=data)
    (data / "dynident.sqlite3").write_text("the keys of everybody")
    objects = ObjectStore(settings.objects, settings.cache_dir)
    confinement = replace(confine_readers(settings, objects), memory=MEMORY)
    readers = InteractiveCompute(1, SCIENCE, confinement)
    yield Installation(data, settings, readers)
    readers.close()


def test_it_reads_and_writes_what_was_uploaded(installation: Installation) -> None:
    upload = installation.settings.uploads_dir / "source"
    assert installation.ask("write_file", path=str(upload), size=10) == 10
    assert installation.ask("read_file", path=str(upload)) == "\0" * 10


@pytest.mark.parametrize("path", ["dynident.sqlite3", "/etc/passwd", "/proc/1/environ", "/proc/1/maps"])
def test_it_reads_no_other_file(installation: Installation, path: str) -> None:
    _assert_failed(installation, "read_file", path=str(installation.data / path))


def test_it_writes_beside_no_other_file(installation: Installation, tmp_path: Path) -> None:
    for folder in (installation.data, installation.data / "objects", tmp_path):
        _assert_failed(installation, "write_file", path=str(folder / "new"), size=1)
        assert not (folder / "new").exists()


def test_it_lists_no_other_folder(installation: Installation) -> None:
    _assert_failed(installation, "list_folder", path=str(installation.data))


def test_it_reaches_no_network(installation: Installation) -> None:
    # Unreachable where it has a network of its own, else refused.
    with socket.create_server(("127.0.0.1", 0)) as server, pytest.raises(ProblemError):
        installation.ask("connect", port=server.getsockname()[1])


def test_it_has_no_descriptors_but_its_own(installation: Installation) -> None:
    # Standard ones, the pipe, the lifeline, and that of its own folder below /proc.
    assert len(installation.ask("list_descriptors")) <= 6


def test_its_temporary_files_are_in_a_folder_of_its_own_that_goes_with_it(installation: Installation) -> None:
    folder = Path(installation.ask("temporary_folder"))
    assert folder.parent == installation.settings.processes_dir
    assert folder.is_dir()
    with pytest.raises(ProblemError):
        installation.ask("compute", ComputationLimits(0.5), seconds=30)  # killed
    assert not folder.exists()


def test_too_much_memory_is_a_problem_of_the_request_alone(installation: Installation) -> None:
    with pytest.raises(ProblemError, match="more memory than one request may use") as caught:
        installation.ask("allocate", size=MEMORY)
    assert caught.value.problem.status == 422
    assert installation.ask("allocate", size=MEMORY // 4) == MEMORY // 32


def test_too_large_a_file_is_refused_while_it_is_written(installation: Installation) -> None:
    target = installation.settings.uploads_dir / "large"
    with pytest.raises(ProblemError, match="larger than one request may write") as caught:
        installation.ask("write_file", ComputationLimits(file_bytes=1000), path=str(target), size=5000)
    assert caught.value.problem.status == 413
    assert target.stat().st_size <= 1000
    # The next computation has limits of its own.
    assert installation.ask("write_file", path=str(target), size=5000) == 5000


def test_too_much_processor_time_is_told_as_what_it_is(installation: Installation) -> None:
    with pytest.raises(ProblemError, match="more than 1 s, far longer than a file of its size needs") as caught:
        installation.ask("compute", ComputationLimits(60, processor_seconds=1), seconds=20)
    assert caught.value.problem.status == 422
    # What one computation used is not counted to the next.
    limits = ComputationLimits(60, processor_seconds=2)
    assert [installation.ask("compute", limits, seconds=1.2) for _ in range(3)] == ["done"] * 3


def test_a_reader_that_goes_round_in_circles_is_killed_within_seconds(
    installation: Installation, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(awaited_module, "STUCK_SECONDS", 1.0)
    before = [child.pid for child in installation.readers._pool._idle]
    with pytest.raises(ProblemError, match="without any progress") as caught:
        installation.ask("go_round_in_circles", ComputationLimits(60))
    assert caught.value.problem.status == 422
    wait_for(lambda: not any(is_running(pid) for pid in before if pid), timeout=5)
    # One that computes and lives is left alone.
    assert installation.ask("compute", ComputationLimits(60), seconds=2.5) == "done"


@pytest.fixture(scope="module")
def ledger(tmp_path_factory: pytest.TempPathFactory) -> Iterator[JobQueue]:
    settings = Settings(data_dir=tmp_path_factory.mktemp("jobs"), workers=1, job_memory=ByteSize(MEMORY))
    with TestClient(app_of(settings), "http://127.0.0.1") as client:
        yield client.app.state.services.job_queue  # type: ignore[attr-defined]


@pytest.mark.parametrize(("size", "is_killed"), [(2 * MEMORY, False), (int(0.8 * MEMORY), True)])
def test_a_job_that_takes_too_much_memory_is_tried_once(ledger: JobQueue, size: int, is_killed: bool) -> None:
    arguments = {"size": size, "is_killed": is_killed}
    job_id = ledger.enqueue(NewJob("report", "confined_calls:take_memory", arguments))
    job = wait_for(lambda: job if (job := ledger.get(job_id)).state in FINAL else None)
    assert (job.state, job.attempt) == ("failed", 1)
    assert job.error is not None
    assert "more than the 600 MB that a job may use (DYNIDENT_JOB_MEMORY)" in job.error["detail"]


def test_a_job_within_its_memory_is_done(ledger: JobQueue) -> None:
    arguments = {"size": MEMORY // 3, "is_killed": False}
    job_id = ledger.enqueue(NewJob("report", "confined_calls:take_memory", arguments))
    assert wait_for(lambda: job if (job := ledger.get(job_id)).state in FINAL else None).state == "succeeded"


def test_what_may_be_taken_grows_with_what_was_sent() -> None:
    small, large = ComputationLimits.from_file_sizes(8_000), ComputationLimits.from_file_sizes(10**9, 3 * 10**9)
    assert small.longest < 300
    assert small.processor_seconds is not None
    assert large.processor_seconds is not None
    assert large.processor_seconds > 100 * small.processor_seconds
    assert small.file_bytes is not None
    assert large.file_bytes is not None
    assert large.file_bytes > 4 * 10**9 > small.file_bytes


def _assert_failed(installation: Installation, name: str, **arguments: Any) -> None:
    """Assert that the system refused it: the log has why, the answer nothing of it."""
    with pytest.raises(ProblemError) as caught:
        installation.ask(name, **arguments)
    assert (caught.value.problem.status, caught.value.problem.title) == (422, "Points elsewhere")
    assert "keys of everybody" not in str(caught.value.problem)
