"""What a job costs those who wait for the service while it is accepted: statements, and looks at the ledger."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from service_helpers import TWO_JOINTS, app_of, wait_for
from sqlalchemy import event
from support.measurement_uploads import as_csv, sound, upload

from dynident_service.settings import Settings
from dynident_service.storage.repository_values import NewJob
from dynident_service.storage_and_engine import Services

READ, WRITE = 4, 6
"""Each begins a transaction. Then resources with their jobs, what they rest on, their objects; and what is needed, the
resource, what it rests on, its job, its event."""


@pytest.fixture
def client(tmp_path: Path) -> Iterator[TestClient]:
    with TestClient(app_of(Settings(data_dir=tmp_path, workers=1)), "http://127.0.0.1") as opened:
        yield opened


@pytest.fixture
def services(client: TestClient) -> Services:
    found = client.app.state.services  # type: ignore[attr-defined]
    assert isinstance(found, Services)
    wait_for(lambda: found.engine.condition == "ready", 60.0)
    return found


@pytest.fixture
def asked(client: TestClient) -> dict[str, Any]:
    described = {"name": "arm", "description": {"format": "modified_dh", "content": TWO_JOINTS}}
    robot = client.post("/v1/robots", json=described).json()
    recordings = [upload(client, robot, as_csv(sound(n))).json()["id"] for n in (300, 320, 340)]
    return {"robot_id": robot["id"], "measurement_ids": recordings}


def test_an_identification_is_accepted_with_a_few_statements_however_many_recordings_it_names(
    client: TestClient, services: Services, asked: dict[str, Any]
) -> None:
    services.engine.close()
    seen: list[tuple[int, str]] = []

    def note(*arguments: Any) -> None:
        seen.append((threading.get_ident(), arguments[2]))

    event.listen(services.database.engine, "before_cursor_execute", note)
    answer = client.post("/v1/identifications", json=asked)
    assert answer.status_code == 202
    (own,) = {thread for thread, told in seen if told.startswith("INSERT INTO jobs")}
    told = [one for thread, one in seen if thread == own]
    assert len(told) <= READ + WRITE, "\n".join(told)
    assert answer.json() == client.get(f"/v1/identifications/{answer.json()['id']}").json()


def test_jobs_that_come_while_all_slots_are_taken_are_not_looked_for_one_by_one(
    services: Services, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    note, go = tmp_path / "note", tmp_path / "go"
    services.job_queue.enqueue(NewJob("report", "small_jobs:waits", {"note": str(note), "go": str(go)}))
    wait_for(note.exists, 60.0)
    looks: list[float] = []
    claim = services.job_queue.claim

    def counted(*arguments: Any) -> Any:
        looks.append(time.monotonic())
        return claim(*arguments)

    monkeypatch.setattr(services.job_queue, "claim", counted)
    last = [services.job_queue.enqueue(NewJob("report", "small_jobs:answer")) for _ in range(3)][-1]
    for _ in range(100):
        services.engine.wake()
        time.sleep(0.01)
    assert len(looks) <= 2
    go.touch()
    assert wait_for(lambda: services.job_queue.get(last).finished_at, 60.0)


def test_a_service_on_one_machine_does_its_jobs_without_a_scheduler_of_its_own(tmp_path: Path) -> None:
    program = """
import sys
from pathlib import Path
from dynident_service.storage_and_engine import open_services
from dynident_service.settings import Settings
from dynident_service.storage.repository_values import NewJob
from service_helpers import SCIENCE, wait_for
with open_services(Settings(data_dir=Path(sys.argv[1]), workers=1), SCIENCE) as services:
    job = services.job_queue.enqueue(NewJob("report", "small_jobs:answer"))
    wait_for(lambda: services.job_queue.get(job).state == "succeeded", 120.0)
SCIENCE.close()
sys.exit("distributed" in sys.modules)
"""
    assert subprocess.run([sys.executable, "-c", program, str(tmp_path)], check=False).returncode == 0
