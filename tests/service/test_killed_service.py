"""The service is killed in the middle of its work, and started again."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest
from service_helpers import free_port, let_leases_run_out, wait_for
from support.processes import is_running

from dynident.robot import library_table
from dynident_client import Client
from dynident_service.storage.database import Database
from dynident_service.storage.job_queue import JobQueue
from dynident_service.storage.repository_values import NewJob

pytestmark = pytest.mark.slow

SERVICE = (str(Path(__file__).with_name("service_without_science.py")),)
WHOLE_SERVICE = ("-m", "dynident_service")
Serve = Callable[..., tuple[subprocess.Popen[bytes], httpx2.Client]]


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Serve]:
    """Starts the service as a process of its own, on the same data each time."""
    running: list[subprocess.Popen[bytes]] = []

    def start(program: tuple[str, ...] = SERVICE, **more: str) -> tuple[subprocess.Popen[bytes], httpx2.Client]:
        port = free_port()
        variables = {
            "DYNIDENT_DATA_DIR": str(tmp_path / "data"),
            "DYNIDENT_PORT": str(port),
            "DYNIDENT_WORKERS": "1",
            "DYNIDENT_LOG_LEVEL": "warning",
            **more,
        }
        process = subprocess.Popen([sys.executable, *program], env={**os.environ, **variables})
        running.append(process)
        client = httpx2.Client(base_url=f"http://127.0.0.1:{port}", timeout=30)
        wait_for(lambda: answers(client), timeout=60)
        return process, client

    yield start
    for process in running:
        if process.poll() is None:
            process.kill()
        process.wait()


@pytest.fixture
def database_of_service(tmp_path: Path) -> Iterator[Database]:
    database = Database(f"sqlite:///{tmp_path / 'data' / 'dynident.sqlite3'}")
    yield database
    database.close()


@pytest.fixture
def ledger_of_service(database_of_service: Database) -> JobQueue:
    return JobQueue(database_of_service)


def test_a_killed_service_loses_no_job_and_leaves_no_process_behind(
    serve: Serve, ledger_of_service: JobQueue, database_of_service: Database, tmp_path: Path
) -> None:
    process, _ = serve()
    note = tmp_path / "pids"
    running = ledger_of_service.enqueue(NewJob("report", "small_jobs:stubborn", {"note": str(note)}))
    waiting = ledger_of_service.enqueue(NewJob("report", "small_jobs:answer"))
    pids = [int(pid) for pid in wait_for(lambda: note.exists() and note.read_text().split(), timeout=60)]
    process.kill()
    process.wait()
    wait_for(lambda: not any(is_running(pid) for pid in pids), timeout=60)
    note.unlink()
    assert ledger_of_service.get(waiting).state == "queued"

    let_leases_run_out(database_of_service)
    _, client = serve()
    wait_for(note.exists, timeout=60)  # begun again
    assert client.get(f"/v1/jobs/{running}").json()["attempt"] == 2
    client.post(f"/v1/jobs/{running}/cancel")
    wait_for(lambda: state(client, running) == "cancelled", timeout=60)
    wait_for(lambda: state(client, waiting) == "succeeded", timeout=60)


def test_other_jobs_do_not_wait_for_what_a_killed_service_held(
    serve: Serve, ledger_of_service: JobQueue, tmp_path: Path
) -> None:
    process, _ = serve()
    note, go = tmp_path / "pid", tmp_path / "go"
    held = ledger_of_service.enqueue(NewJob("report", "small_jobs:waits", {"note": str(note), "go": str(go)}))
    wait_for(note.exists, timeout=60)
    process.kill()
    process.wait()
    _, client = serve()
    other = ledger_of_service.enqueue(NewJob("report", "small_jobs:answer"))
    wait_for(lambda: state(client, other) == "succeeded", timeout=20)  # sooner than the lease of the dead runs out
    assert state(client, held) == "running"


def test_a_service_that_is_told_to_terminate_says_so_takes_no_job_and_lets_a_short_one_end(
    serve: Serve, ledger_of_service: JobQueue
) -> None:
    process, client = serve(DYNIDENT_DRAIN_SECONDS="60")
    short = ledger_of_service.enqueue(NewJob("report", "small_jobs:count", {"steps": 30}))
    wait_for(lambda: ledger_of_service.get(short).fraction > 0, timeout=60)
    process.send_signal(signal.SIGTERM)
    wait_for(lambda: client.get("/readyz").status_code == 503, timeout=1)
    assert client.get("/readyz").json()["checks"]["engine"] == "draining"
    waiting = ledger_of_service.enqueue(NewJob("report", "small_jobs:answer"))
    assert process.wait(timeout=40) == 0  # as soon as it has ended
    ended = ledger_of_service.get(short)
    assert (ended.state, ended.attempt) == ("succeeded", 1)
    assert ledger_of_service.get(waiting).state == "queued"


def test_a_long_job_of_a_service_that_ends_is_finished_by_another_and_not_held_against_it(
    serve: Serve, ledger_of_service: JobQueue, tmp_path: Path
) -> None:
    first, _ = serve(DYNIDENT_DRAIN_SECONDS="1")
    note, go = tmp_path / "pid", tmp_path / "go"
    long = ledger_of_service.enqueue(NewJob("report", "small_jobs:waits", {"note": str(note), "go": str(go)}))
    wait_for(note.exists, timeout=60)
    serve()
    note.unlink()
    first.send_signal(signal.SIGTERM)
    wait_for(note.exists, timeout=15)  # sooner than a lease runs out
    go.touch()
    wait_for(lambda: ledger_of_service.get(long).state == "succeeded")
    strain = ledger_of_service.measure_health()
    assert (strain.deaths, strain.losses) == (0, 0)
    assert first.wait(timeout=60) == 0


def test_a_second_signal_ends_a_service_that_drains(serve: Serve, ledger_of_service: JobQueue, tmp_path: Path) -> None:
    process, client = serve(DYNIDENT_DRAIN_SECONDS="600")
    note = tmp_path / "pid"
    arguments = {"note": str(note), "go": str(tmp_path / "never")}
    long = ledger_of_service.enqueue(NewJob("report", "small_jobs:waits", arguments))
    wait_for(note.exists, timeout=60)
    process.send_signal(signal.SIGTERM)
    wait_for(lambda: client.get("/readyz").status_code == 503)
    process.send_signal(signal.SIGTERM)
    process.wait(timeout=60)
    assert ledger_of_service.get(long).state == "queued"


def test_a_service_that_is_stopped_gives_its_jobs_back_at_once(
    serve: Serve, ledger_of_service: JobQueue, tmp_path: Path
) -> None:
    process, _ = serve(DYNIDENT_DRAIN_SECONDS="0")
    note = tmp_path / "pids"
    job_id = ledger_of_service.enqueue(NewJob("report", "small_jobs:stubborn", {"note": str(note)}))
    pids = [int(pid) for pid in wait_for(lambda: note.exists() and note.read_text().split(), timeout=60)]
    process.send_signal(signal.SIGTERM)
    process.wait(timeout=60)
    assert not any(is_running(pid) for pid in pids)
    assert ledger_of_service.get(job_id).state == "queued"


def test_a_client_that_lost_its_connection_follows_on_where_it_was(serve: Serve, ledger_of_service: JobQueue) -> None:
    _, client = serve()
    job_id = ledger_of_service.enqueue(NewJob("report", "small_jobs:count", {"steps": 8}))
    first = []
    with client.sse(f"/v1/jobs/{job_id}/events") as source:
        for event in source:
            first.append(event)
            if event.event == "progress":
                break  # the connection is given up in the middle
    with client.sse(f"/v1/jobs/{job_id}/events", headers={"Last-Event-ID": first[-1].id}) as source:
        rest = list(source)
    identifiers = [int(event.id) for event in first + rest]
    assert identifiers == sorted(set(identifiers))
    with client.sse(f"/v1/jobs/{job_id}/events") as source:
        assert [int(event.id) for event in source] == identifiers


# How many runs, in which the service is killed while it designs, and in which while it estimates.
@pytest.mark.parametrize(
    ("runs", "designing", "estimating"), [(5, 2, 4), pytest.param(10, 4, 7, marks=pytest.mark.thorough)]
)
def test_a_campaign_goes_on_through_two_kills(
    serve: Serve, database_of_service: Database, runs: int, designing: int, estimating: int
) -> None:
    process, http = serve(WHOLE_SERVICE)
    live = Client(str(http.base_url))
    robot = live.robots.create("scara", modified_dh=library_table("scara"))
    campaign_id = live.campaigns.create(
        robot,
        # Not reached in so few runs of so few seconds, but within reach of the robot time that is left.
        goal={"kind": "parameters", "parameters": ["Fc1"], "error": 0.001},
        budget={"robot_time": 360000.0, "runs": 10000},
        trajectory={"duration": 4.0, "harmonics": 2, "sampling_rate": 100.0},
        starts=1,
    ).id
    drives = [{"effect": "rotor_inertia"}, {"effect": "coulomb"}, {"effect": "viscous"}]
    told, asked = [], []
    for number in range(1, runs + 1):
        step = live.campaigns.ask(campaign_id)
        if number == designing:
            process, live = kill_and_start_again(serve, process, live, database_of_service, step["job_id"])
            # Asked again, as a client does that lost the answer: the same motion.
            assert live.campaigns.ask(campaign_id).id == step.id
        design = live.designs.get(step.id).wait()
        simulation = live.simulations.create(
            robot.id, effects=drives, design=design, seed=number, name=f"run{number}"
        ).wait()
        told.append(simulation.result["measurement_id"])
        asked.append(design.id)
        step = live.campaigns.tell(campaign_id, told[-1])
        if number == estimating:
            process, live = kill_and_start_again(serve, process, live, database_of_service, step["job_id"])
            assert live.campaigns.get(campaign_id).state == "estimating"
        model = live.identifications.get(step.id).wait()
        assert model["request"]["measurement_ids"] == told
    campaign = live.campaigns.get(campaign_id)
    assert campaign.state == "asking", campaign["decision"]
    recorded = [run for step in campaign.steps for run in step["runs"]]
    assert [run["measurement_id"] for run in recorded] == told
    assert [run["design_id"] for run in recorded] == asked
    assert all(run["promised"] for run in recorded[1:])
    assert max(recorded[-1]["achieved"]) < 0.5 * max(recorded[0]["achieved"])


def kill_and_start_again(
    serve: Serve, process: subprocess.Popen[bytes], live: Client, database: Database, job_id: str
) -> tuple[subprocess.Popen[bytes], Client]:
    """Kill a service while it computes a job, start it on the same data, and wait until it computes the job again."""
    wait_for(lambda: live.jobs.get(job_id)["state"] == "running", timeout=60)
    process.kill()
    process.wait()
    let_leases_run_out(database)
    process, http = serve(WHOLE_SERVICE)
    live = Client(str(http.base_url))
    wait_for(lambda: live.jobs.get(job_id)["attempt"] == 2, timeout=60)
    return process, live


def state(client: httpx2.Client, job_id: str) -> Any:
    return client.get(f"/v1/jobs/{job_id}").json()["state"]


def answers(client: httpx2.Client) -> bool:
    try:
        return client.get("/healthz").status_code == 200
    except httpx2.TransportError:
        return False
