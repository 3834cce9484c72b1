"""One identification whose recordings several workers of a cluster reduce, whatever happens to them meanwhile."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dask_cluster import PRELOADED, Cluster
from distributed import Client
from fastapi.testclient import TestClient
from service_helpers import TWO_JOINTS, app_of, wait_for
from shared_parts import NOTES, WORKER, Note, notes_in
from support.measurement_uploads import as_csv, sound, upload

from dynident_service.settings import Settings
from dynident_service.storage_and_engine import Services

pytestmark = pytest.mark.slow

SHARING = PRELOADED / "worker_that_shares.py"
RECORDINGS = 6


@dataclass(frozen=True)
class Stored:
    """Recordings of a robot in a data directory, and what one process identifies from them."""

    folder: Path
    body: dict[str, Any]
    alone: dict[str, Any]


@dataclass(frozen=True)
class Team:
    """Two workers by their names, and the folder of their notes."""

    cluster: Cluster
    workers: dict[str, subprocess.Popen[bytes]]
    notes: Path

    def told(self, kind: str) -> list[Note]:
        return [note for note in notes_in(self.notes) if note.kind == kind]


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Stored:
    folder = tmp_path_factory.mktemp("shared")
    with TestClient(app_of(Settings(data_dir=folder, workers=1)), "http://127.0.0.1") as client:
        description = {"format": "modified_dh", "content": TWO_JOINTS}
        robot = client.post("/v1/robots", json={"name": "arm", "description": description}).json()
        measured = []
        for number in range(RECORDINGS):
            columns = sound(2000 + 100 * number)
            columns["tau1"] += np.random.default_rng(number).normal(0.0, 0.1, len(columns["t"]))
            measured.append(upload(client, robot, as_csv(columns), name=f"run{number}").json()["id"])
        body = {"robot_id": robot["id"], "measurement_ids": measured}
        alone = client.post("/v1/identifications", json=body).json()["id"]
        return Stored(folder, body, wait_for(lambda: ended(client, alone), timeout=120))


@pytest.fixture
def team(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Team]:
    notes = tmp_path / "notes"
    notes.mkdir()
    monkeypatch.setenv(NOTES, str(notes))
    monkeypatch.setenv(WORKER, "first")
    cluster = Cluster(tmp_path, SHARING)
    try:
        team = Team(cluster, {"first": cluster.worker, "second": cluster.new_worker(**{WORKER: "second"})}, notes)
        with Client(cluster.address, timeout="60s", set_as_default=False) as client:
            client.wait_for_workers(2, timeout="120s")
        yield team
    finally:
        cluster.end()


@contextmanager
def serving(stored: Stored, team: Team) -> Iterator[TestClient]:
    settings = Settings(data_dir=stored.folder, dask_scheduler=team.cluster.address)
    with TestClient(app_of(settings), "http://127.0.0.1") as client:
        wait_for(lambda: services_of(client).engine.state == "ready", timeout=120)
        yield client


def services_of(client: TestClient) -> Services:
    services: Services = client.app.state.services  # type: ignore[attr-defined]
    return services


def begin(client: TestClient, stored: Stored) -> tuple[str, str]:
    made = client.post("/v1/identifications", json=stored.body).json()
    return made["id"], made["job_id"]


def ended(client: TestClient, identification: str) -> Any:
    shown = client.get(f"/v1/identifications/{identification}").json()
    job = client.get(f"/v1/jobs/{shown['job_id']}").json()
    if job["state"] not in ("succeeded", "failed", "cancelled"):
        return None
    assert job["state"] == "succeeded", job
    return shown["result"]


def as_alone(found: dict[str, Any], stored: Stored) -> bool:
    same = []
    for one, other in zip(found["parameters"], stored.alone["parameters"], strict=True):
        assert one["name"] == other["name"]
        same.append(one["value"] == pytest.approx(other["value"], rel=1e-10))
        same.append(one["standard_deviation"] == pytest.approx(other["standard_deviation"], rel=1e-10))
    return all(same)


def is_there(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_recordings_are_reduced_by_several_workers_to_the_same_parameters(stored: Stored, team: Team) -> None:
    with serving(stored, team) as client:
        identification, job_id = begin(client, stored)
        found = wait_for(lambda: ended(client, identification), timeout=120)
        assert client.get(f"/v1/jobs/{job_id}").json()["attempt"] == 1
    assert as_alone(found, stored)
    assert {note.worker for note in notes_in(team.notes)} == {"first", "second"}
    # Each worker did some, in a process of its own, and no worker parts of its own job.
    own, parts = team.told("own"), team.told("part")
    assert {note.worker for note in own}.isdisjoint(note.worker for note in parts)
    assert {note.recording for note in own + parts} == {f"run{number}" for number in range(RECORDINGS)}


@pytest.mark.parametrize("kind", ["part", pytest.param("own", marks=pytest.mark.thorough)])
def test_a_worker_that_is_killed_in_the_middle_only_costs_time(stored: Stored, team: Team, kind: str) -> None:
    with serving(stored, team) as client:
        identification, job_id = begin(client, stored)
        wait_for(lambda: team.told("part"), timeout=120)
        victim = team.workers[team.told(kind)[-1].worker]
        victim.kill()
        victim.wait()
        found = wait_for(lambda: ended(client, identification), timeout=120)
        # The scheduler gives it to the other worker, for which the same claim holds.
        assert client.get(f"/v1/jobs/{job_id}").json()["attempt"] == 1
    if kind == "own":
        (other,) = (name for name, process in team.workers.items() if process is not victim)
        assert team.told("own")[-1].worker == other
    assert as_alone(found, stored)


@pytest.mark.thorough
def test_a_process_that_is_killed_in_the_middle_of_a_part_only_costs_time(stored: Stored, team: Team) -> None:
    with serving(stored, team) as client:
        identification, _ = begin(client, stored)
        os.kill(wait_for(lambda: team.told("part"), timeout=120)[0].pid, signal.SIGKILL)
        found = wait_for(lambda: ended(client, identification), timeout=120)
    assert as_alone(found, stored)


@pytest.mark.thorough
def test_a_scheduler_that_is_killed_in_the_middle_only_costs_time(stored: Stored, team: Team) -> None:
    with serving(stored, team) as client:
        identification, _ = begin(client, stored)
        wait_for(lambda: team.told("part"), timeout=120)
        team.cluster.scheduler.kill()
        team.cluster.scheduler.wait()
        team.cluster.new_scheduler()
        # Workers end with their scheduler.
        team.cluster.new_worker(**{WORKER: "third"})
        found = wait_for(lambda: ended(client, identification), timeout=120)
    assert as_alone(found, stored)


def test_a_job_that_is_cancelled_ends_its_parts(stored: Stored, team: Team) -> None:
    with serving(stored, team) as client:
        _, job_id = begin(client, stored)
        part = wait_for(lambda: team.told("part"), timeout=120)[0]
        assert client.post(f"/v1/jobs/{job_id}/cancel").is_success
        wait_for(lambda: client.get(f"/v1/jobs/{job_id}").json()["state"] == "cancelled", timeout=60)
        reached = len(notes_in(team.notes))
        wait_for(lambda: not is_there(part.pid), timeout=10)
    assert len(notes_in(team.notes)) == reached


@pytest.mark.thorough
def test_jobs_on_all_workers_do_not_wait_for_each_other(stored: Stored, team: Team) -> None:
    with serving(stored, team) as client:
        begun = [begin(client, stored)[0] for _ in range(3)]
        for identification in begun:
            assert as_alone(wait_for(lambda one=identification: ended(client, one), timeout=120), stored)
