from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from fork_servers import StandingBack
from service_helpers import wait_for
from support.processes import is_running

from dynident_service.app import create_app
from dynident_service.jobs.child_process import STANDS_BACK
from dynident_service.settings import Settings
from dynident_service.storage.repository_values import NewJob
from dynident_service.storage_and_engine import Services

Start = Callable[..., str]
Wait = Callable[..., Any]


def events_of(text: str) -> list[tuple[int, str, dict[str, Any]]]:
    """Parse a stream of server-sent events."""
    found = []
    for block in text.strip().split("\n\n"):
        fields = dict(line.split(": ", 1) for line in block.splitlines() if not line.startswith(":"))
        if "data" in fields:
            found.append((int(fields["id"]), fields["event"], json.loads(fields["data"])))
    return found


def test_a_job_runs_and_says_so(client: TestClient, start: Start, wait: Wait) -> None:
    job_id = start("answer")
    wait(job_id)
    job = client.get(f"/v1/jobs/{job_id}").json()
    assert job["state"] == "succeeded"
    assert job["progress"] == {"fraction": 1.0, "message": "done"}
    assert job["attempt"] == 1
    assert job["created_at"] <= job["started_at"] <= job["finished_at"]


def test_a_computation_leaves_the_processor_to_who_answers_requests(tmp_path: Path) -> None:
    nursery = StandingBack()
    with TestClient(create_app(Settings(data_dir=tmp_path, workers=1), nursery), "http://127.0.0.1") as client:
        ledger = client.app.state.services.job_queue  # type: ignore[attr-defined]
        job_id = ledger.enqueue(NewJob("report", "small_jobs:stands_back", {"note": str(tmp_path / "note")}))
        wait_for(lambda: ledger.get(job_id).state == "succeeded")
    nursery.close()
    assert int((tmp_path / "note").read_text()) > os.getpriority(os.PRIO_PROCESS, 0) + STANDS_BACK


def test_a_mendable_error_arrives_with_its_pointer(client: TestClient, start: Start, wait: Wait) -> None:
    job_id = start("wrong")
    assert wait(job_id).state == "failed"
    error = client.get(f"/v1/jobs/{job_id}").json()["error"]
    assert error["status"] == 422
    assert error["title"] == "Gap in time"
    assert error["errors"][0]["pointer"] == "q3"


def test_an_unexpected_error_tells_nothing_of_the_inside(client: TestClient, start: Start, wait: Wait) -> None:
    job_id = start("broken")
    assert wait(job_id).state == "failed"
    answer = client.get(f"/v1/jobs/{job_id}")
    assert answer.json()["error"]["status"] == 500
    assert "secret" not in answer.text
    assert job_id in answer.json()["error"]["detail"]


def test_events_tell_the_whole_course_and_resume_after_any_of_them(
    client: TestClient, start: Start, wait: Wait
) -> None:
    job_id = start("count", steps=4)
    whole = events_of(client.get(f"/v1/jobs/{job_id}/events").text)  # ends with the job
    assert [event for _, event, _ in whole[:2]] == ["state", "state"]
    assert [data["state"] for _, event, data in whole if event == "state"] == ["queued", "running", "succeeded"]
    fractions = [data["fraction"] for _, event, data in whole if event == "progress"]
    assert fractions == sorted(fractions)
    assert len(fractions) >= 3
    assert fractions[-1] == 1.0
    for index, (identifier, _, _) in enumerate(whole):
        headers = {"Last-Event-ID": str(identifier)}
        assert events_of(client.get(f"/v1/jobs/{job_id}/events", headers=headers).text) == whole[index + 1 :]


def test_events_of_no_job_are_a_404(client: TestClient) -> None:
    assert client.get("/v1/jobs/job_nothing/events").status_code == 404


def test_jobs_are_listed_by_state_and_page_by_page(client: TestClient, start: Start, wait: Wait) -> None:
    ids = [start("answer") for _ in range(3)]
    for job_id in ids:
        wait(job_id)
    first = client.get("/v1/jobs", params={"state": "succeeded", "limit": 2}).json()
    assert {job["id"] for job in first["items"]} == set(ids[1:])
    second = client.get("/v1/jobs", params={"state": "succeeded", "limit": 2, "cursor": first["cursor"]}).json()
    assert ids[0] in {job["id"] for job in second["items"]}
    assert client.get("/v1/jobs", params={"state": "asleep"}).status_code == 422


def test_a_job_that_holds_the_interpreter_is_stopped_within_two_seconds_with_all_it_started(
    client: TestClient, start: Start, wait: Wait, tmp_path: Path
) -> None:
    took: list[float] = []
    # Beside other work one try may take longer: of several the best counts.
    while not took or (min(took) >= 2.0 and len(took) < 8):
        note = tmp_path / f"pids{len(took)}"
        job_id = start("stubborn", note=str(note))
        pids = [int(pid) for pid in wait_for(lambda note=note: note.exists() and note.read_text().split())]
        began = time.monotonic()
        assert client.post(f"/v1/jobs/{job_id}/cancel").status_code == 200
        assert wait(job_id).state == "cancelled"
        wait_for(lambda pids=pids: not any(is_running(pid) for pid in pids))
        took.append(time.monotonic() - began)
        assert client.post(f"/v1/jobs/{job_id}/cancel").json()["state"] == "cancelled"
    assert min(took) < 2.0


def test_after_a_killed_job_the_next_one_runs(start: Start, wait: Wait, services: Services, tmp_path: Path) -> None:
    note = tmp_path / "pids"
    job_id = start("stubborn", note=str(note))
    wait_for(note.exists)
    services.job_queue.cancel(job_id)
    assert wait(job_id).state == "cancelled"
    assert wait(start("answer")).state == "succeeded"


def test_a_job_whose_process_dies_is_begun_again(start: Start, wait: Wait, tmp_path: Path) -> None:
    job = wait(start("dies", times=1, note=str(tmp_path / "deaths")))
    assert job.state == "succeeded"
    assert job.attempt == 2


def test_no_more_jobs_run_at_a_time_than_there_are_workers(start: Start, wait: Wait, services: Services) -> None:
    ids = [start("count", steps=2, pause=0.15) for _ in range(5)]
    most = 0
    while any(services.job_queue.get(job_id).state in ("queued", "running") for job_id in ids):
        most = max(most, services.job_queue.count_by_state().get("running", 0))
        time.sleep(0.01)
    assert most == 2
    assert {wait(job_id).state for job_id in ids} == {"succeeded"}


@pytest.mark.slow
def test_the_overhead_of_a_job_is_small(start: Start, wait: Wait) -> None:
    wait(start("answer"))
    times = []
    for _ in range(20):
        began = time.monotonic()
        wait(start("answer"))
        times.append(time.monotonic() - began)
    # Beside other work many take longer: the best few are what the engine itself needs.
    assert sorted(times)[2] < 0.15
