"""Thousands of hostile requests with ids that exist: none is answered by a failure of the service, none takes long.

    python -m venv hostile && hostile/bin/pip install schemathesis
    PATH=$PATH:hostile/bin python benchmarks/hostile_cases.py
    PATH=$PATH:hostile/bin python benchmarks/hostile_cases.py --database postgresql --cases 2000

`schemathesis` makes the requests from the contract, of each operation as many; most have the ids of a robot and of
all that was made for it. It fails (exit code 1) with a request that is answered by 5xx or after more than two
seconds, and where a process of the service was larger than 600 MB.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import psutil
from common import show
from mischief.databases import database
from service_beside import Beside, served

from dynident.robot import library_table
from dynident_client import Client

HERE = Path(__file__).parent
CONTRACT = HERE.parent / "openapi" / "openapi.json"
SLOWEST = 2.0
"""Seconds."""
LARGEST = 600.0
"""MB of a process."""
FOLLOWS = "follow_job"
"""Stays open as long as its job runs: not asked."""
COLLECTIONS = {
    "robots": "robot",
    "measurements": "measurement",
    "imports": "import",
    "designs": "design",
    "simulations": "simulation",
    "identifications": "identification",
    "comparisons": "comparison",
    "diagnoses": "diagnosis",
    "series": "series",
    "validations": "validation",
    "reports": "report",
}


def filled(url: str) -> dict[str, list[str]]:
    """Make one of nearly everything; gives the ids of it by kind."""
    with Client(url) as client:
        robot = client.robots.create("scara", modified_dh=library_table("scara"))
        motion = {"duration": 8.0, "sampling_rate": 100.0}
        runs = []
        for seed in (1, 2):
            made = client.simulations.create(robot, trajectory=motion, effects=[{"effect": "coulomb"}], seed=seed)
            runs.append(client.measurements.get(made.wait().result["measurement_id"]))
        quick = {"duration": 3.0, "harmonics": 3, "sampling_rate": 50.0}
        client.designs.create(robot, kind="random", trajectory=quick, random_trajectories=3).wait()
        model = client.identifications.create(robot, runs[:1], validation=runs[1:]).wait()
        batch = client.identifications.create_many([{"robot_id": robot, "measurement_ids": runs[:1]}])
        client.comparisons.create(model, runs[1]).wait()
        client.diagnoses.create(model, candidates=["offset"]).wait()
        client.series.create(model, [[run] for run in runs]).wait()
        client.validations.create(model, "direct").wait()
        client.reports.create(model).wait()
        ids = {kind: [one.id for one in getattr(client, name).all()] for name, kind in COLLECTIONS.items()}
        return {**ids, "batch": [batch.id], "job": [one.id for one in client.jobs.page(limit=50)]}


class Watched:
    """The largest that any process of a service has been, MB of memory that is its own."""

    def __init__(self, service: Beside) -> None:
        self.largest = 0.0
        self._service = psutil.Process(service.pid)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch)
        self._thread.start()

    def _watch(self) -> None:
        while not self._over.wait(0.5):
            for process in (self._service, *self._service.children(recursive=True)):
                try:
                    self.largest = max(self.largest, process.memory_full_info().uss / 1e6)
                except psutil.Error:
                    continue

    def over(self) -> float:
        """Stop watching; gives the largest."""
        self._over.set()
        self._thread.join()
        return self.largest


def attacked(url: str, ids: dict[str, list[str]], cases: int, seed: int, folder: Path) -> int:
    """Have schemathesis make its requests; gives its exit code, which is 0 where nothing was found."""
    program = shutil.which("schemathesis")
    if program is None:
        sys.exit("schemathesis is not on PATH; this file says at its head how it gets there")
    operations = sum(len(path) for path in json.loads(CONTRACT.read_text())["paths"].values()) - 1
    command = [program, "run", str(CONTRACT), "--url", url, "--phases", "fuzzing", "--mode", "all"]
    command += ["--checks", "not_a_server_error", "--max-response-time", str(SLOWEST), "--continue-on-failure"]
    command += ["--exclude-operation-id", FOLLOWS, "--max-examples", str(-(-cases // operations))]
    command += ["--seed", str(seed), "--warnings", "off", "--suppress-health-check", "all", "--workers", "2"]
    paths = os.pathsep.join([str(HERE / "mischief")])
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    told = {"SCHEMATHESIS_HOOKS": "known_ids", "DYNIDENT_KNOWN_IDS": json.dumps(ids), "PYTHONPATH": paths}
    return subprocess.run(command, env={**environment, **told}, cwd=folder, check=False).returncode


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--database", choices=("sqlite", "postgresql"), default="sqlite")
    parser.add_argument("--cases", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    with (
        tempfile.TemporaryDirectory() as name,
        database(asked.database, Path(name)) as kept,
        served(Path(name) / "data", DYNIDENT_DATABASE_URL=kept.url, DYNIDENT_WORKERS="1") as service,
    ):
        ids = filled(service.url)
        watched, began = Watched(service), time.monotonic()
        code = attacked(service.url, ids, asked.cases, asked.seed, Path(name))
        largest = watched.over()
    rows = [("seconds", f"{time.monotonic() - began:.0f}"), ("largest process, MB", f"{largest:.0f}")]
    show(asked.database, [("what", ""), *rows])
    sys.exit(1 if code or largest > LARGEST else 0)


if __name__ == "__main__":
    main()
