"""The service stays awake: what takes long is computed elsewhere, and no longer than its client waits."""

from __future__ import annotations

import http.client
import json
import os
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast
from urllib.parse import urlsplit

import anyio
import pytest
from anyio import to_thread
from fastapi import Request
from fork_servers import StandingBack
from service_helpers import SCIENCE, serving, wait_for
from support.processes import is_running
from support.service_client import Client

from dynident_service import interactive_compute as awaited_module
from dynident_service import job_events as following_module
from dynident_service.interactive_compute import InteractiveCompute
from dynident_service.job_events import LATEST, JobEventNotifier
from dynident_service.jobs.child_process import STANDS_BACK
from dynident_service.jobs.confinement import ComputationLimits
from dynident_service.problems import ProblemError
from dynident_service.settings import Settings
from dynident_service.storage.job_queue import JobQueue
from dynident_service.storage.repository_values import NewJob


@pytest.fixture(scope="module")
def awaited() -> Iterator[InteractiveCompute]:
    made = InteractiveCompute(1, SCIENCE)
    yield made
    made.close()


def ask(
    awaited: InteractiveCompute, name: str, client: Client | None = None, longest: float = 60.0, **arguments: Any
) -> Any:
    async def call() -> Any:
        request = cast(Request, client or Client())
        return await awaited.call(request, f"small_jobs:{name}", object, arguments, ComputationLimits(longest))

    return anyio.run(call)


def test_a_request_gets_what_a_child_computed(awaited: InteractiveCompute) -> None:
    assert [ask(awaited, "twice", number=n) for n in range(3)] == [0, 2, 4]


def test_what_a_request_waits_for_stands_back_behind_who_answers_and_before_jobs() -> None:
    nursery = StandingBack()
    awaited = InteractiveCompute(1, nursery)
    own = os.getpriority(os.PRIO_PROCESS, 0)
    if own > 19 - 2 * STANDS_BACK:
        pytest.skip("these tests stand back themselves, so far that nothing can stand behind them")
    assert ask(awaited, "niceness") == own + STANDS_BACK
    awaited.close()
    nursery.close()


def test_what_goes_wrong_in_the_child_is_the_answer(awaited: InteractiveCompute) -> None:
    with pytest.raises(ProblemError, match="q3 has a gap") as caught:
        ask(awaited, "refuses")
    assert caught.value.problem.status == 422
    with pytest.raises(ProblemError, match="died, most probably because memory ran out") as caught:
        ask(awaited, "dies_at_once")
    assert caught.value.problem.status == 503
    # What crashes the reader is no want of memory, and does so again when it is sent again.
    with pytest.raises(ProblemError, match=r"\(by SIGSEGV\)\. If it is a file, it is probably damaged") as caught:
        ask(awaited, "crashes")
    assert caught.value.problem.status == 422
    assert ask(awaited, "twice", number=4) == 8


def test_a_computation_ends_when_its_client_leaves(awaited: InteractiveCompute, tmp_path: Path) -> None:
    client, note = Client(), tmp_path / "pid"

    def leave() -> None:
        wait_for(lambda: note.exists() and note.read_text())
        client.has_left = True

    leaving = threading.Thread(target=leave)
    leaving.start()
    with pytest.raises(ProblemError, match="left"):
        ask(awaited, "never_answers", client, note=str(note))
    leaving.join()
    wait_for(lambda: not is_running(int(note.read_text())), timeout=5)
    assert ask(awaited, "twice", number=4) == 8


def test_a_computation_that_takes_too_long_for_a_request_is_stopped(
    awaited: InteractiveCompute, tmp_path: Path
) -> None:
    with pytest.raises(ProblemError, match="longer than 1 s") as caught:
        ask(awaited, "never_answers", longest=1.0, note=str(tmp_path / "pid"))
    assert caught.value.problem.status == 503


def test_too_many_that_wait_are_told_to_come_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(awaited_module, "MAX_WAITING", 0)
    awaited = InteractiveCompute(1, SCIENCE)
    with pytest.raises(ProblemError) as caught:
        ask(awaited, "twice", number=1)
    assert caught.value.problem.status == 429
    awaited.close()


def test_files_that_are_read_for_long_keep_no_short_computation_waiting(tmp_path: Path) -> None:
    awaited = InteractiveCompute(2, SCIENCE)
    clients = [Client(), Client()]
    notes = [tmp_path / "first", tmp_path / "second"]

    async def read_file(client: Client, note: Path) -> None:
        request = cast(Request, client)
        with pytest.raises(ProblemError, match="left"):
            await awaited.call(request, "small_jobs:never_answers", object, {"note": str(note)}, is_long=True)

    async def together() -> None:
        async with anyio.create_task_group() as group:
            for client, note in zip(clients, notes, strict=True):
                group.start_soon(read_file, client, note)
            with anyio.fail_after(30):
                while not notes[0].exists():
                    await anyio.sleep(0.01)
                request = cast(Request, Client())
                assert await awaited.call(request, "small_jobs:twice", int, {"number": 4}) == 8
            assert not notes[1].exists()
            for client in clients:
                client.has_left = True

    anyio.run(together)
    awaited.close()


def test_the_database_is_looked_at_once_for_all_who_follow(ledger: JobQueue, monkeypatch: pytest.MonkeyPatch) -> None:
    job_id, other = (ledger.enqueue(NewJob("report", "small_jobs:answer")) for _ in range(2))
    last = ledger.read_events(job_id)[0][-1].id
    looks = 0
    news = JobQueue.find_newest_events

    def counted(self: JobQueue, after: int, job_ids: Any) -> tuple[dict[str, int], int]:
        nonlocal looks
        looks += 1
        return news(self, after, job_ids)

    monkeypatch.setattr(JobQueue, "find_newest_events", counted)
    told: list[str] = []

    async def follow() -> None:
        following = JobEventNotifier(ledger)

        async def wait(job: str, after: int) -> None:
            await following.wait_for_news(job, after)
            told.append(job)

        async with anyio.create_task_group() as group:
            for _ in range(50):
                group.start_soon(wait, job_id, last)
            await anyio.sleep(10 * LATEST)
            assert told == []
            group.start_soon(wait, "job_that_is_not_there", 7)
            group.start_soon(wait, other, 0)
            await anyio.sleep(5 * LATEST)
            assert set(told) == {"job_that_is_not_there", other}
            await to_thread.run_sync(ledger.cancel, job_id)
        assert told.count(job_id) == 50

    anyio.run(follow)
    assert looks <= 30


@pytest.mark.slow
def test_health_answers_while_many_heavy_requests_are_made_and_left(tmp_path: Path) -> None:
    joints = [{"name": f"j{n}", "alpha": 1.5708 * (n % 2), "d": 0.1, "r": 0.2} for n in range(60)]
    body = json.dumps({"name": "long", "description": {"format": "modified_dh", "content": {"joints": joints}}})
    settings = Settings(data_dir=tmp_path, port=0, workers=1, log_level="error")
    with serving(settings) as url:
        host = urlsplit(url).netloc

        def get(path: str) -> float:
            began = time.monotonic()
            connection = http.client.HTTPConnection(host, timeout=60)
            connection.request("GET", path)
            assert connection.getresponse().status == 200
            connection.close()
            return time.monotonic() - began

        def leave_soon() -> None:
            connection = http.client.HTTPConnection(host, timeout=1)
            connection.request("POST", "/v1/robots", body, {"content-type": "application/json"})
            try:
                connection.getresponse()
            except TimeoutError:
                connection.close()

        wait_until_ready: Callable[[], Any] = lambda: get("/readyz")  # noqa: E731
        wait_for(wait_until_ready, timeout=60)
        leaving = [threading.Thread(target=leave_soon) for _ in range(25)]
        for thread in leaving:
            thread.start()
        took = [get("/healthz") for _ in range(30) if time.sleep(0.1) is None]
        for thread in leaving:
            thread.join()
        # Most of the load is this test's own; one that hangs takes as long as the work.
        assert sorted(took)[len(took) // 2] < 0.5
        assert get("/v1/robots") < 5.0


def test_what_the_engine_tells_is_told_at_once_and_what_others_write_soon(
    ledger: JobQueue, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(following_module, "LATEST", 3.0)
    first, second = (ledger.enqueue(NewJob("report", "small_jobs:answer")) for _ in range(2))
    last = {job: ledger.read_events(job)[0][-1].id for job in (first, second)}

    async def follow() -> None:
        following = JobEventNotifier(ledger)
        following.wake()  # nobody follows yet

        async def waited_for(job: str, *, told: bool) -> float:
            async with anyio.create_task_group() as group:
                group.start_soon(following.wait_for_news, job, last[job])
                await anyio.sleep(0.5)  # it has been looked, and there was nothing
                await to_thread.run_sync(ledger.cancel, job)
                if told:
                    await to_thread.run_sync(following.wake)
                began = time.monotonic()
            return time.monotonic() - began

        assert await waited_for(first, told=True) < 1.5
        assert 1.5 < await waited_for(second, told=False) < 10.0

    anyio.run(follow)
