"""One identification from several large recordings on a Dask cluster of one worker, and of two: how many times faster.

    python benchmarks/recordings_on_a_cluster.py [--recordings 8] [--samples 1000000] [--times 3] [--keep FOLDER]

Each worker has a processor of its own, and so has all that it does; the service has the disk and does nothing. Told is
the shortest time of so many identifications by each. The exit code is 1 where the two do not find the same parameters.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
from common import show
from distributed import Client as Watch
from engine.robots import arm_by_name
from recordings_side_by_side import written
from service_beside import free_port, served

from dynident.robot import library_table
from dynident_client import Client

ROBOT = "ur5"
SAME = 1e-10


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recordings", type=int, default=8)
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--times", type=int, default=3)
    parser.add_argument("--keep", type=Path, help="keep the recordings in this folder, and find them there next time")
    asked = parser.parse_args()
    processors = sorted(os.sched_getaffinity(0))[:2]
    if len(processors) < 2:
        sys.exit("two processors are needed")
    with tempfile.TemporaryDirectory() as name:
        folder, port = Path(name), free_port()
        recordings = asked.keep or folder / "recordings"
        files = [written(arm_by_name(ROBOT), recordings, asked.samples, seed) for seed in range(asked.recordings)]
        address = f"tcp://127.0.0.1:{port}"
        scheduler = begun("dask_scheduler", "--host", "127.0.0.1", "--port", str(port))
        try:
            with served(folder / "data", DYNIDENT_DASK_SCHEDULER=address) as service, Client(service.url) as client:
                robot = client.robots.create(ROBOT, modified_dh=library_table(ROBOT))
                runs = [client.measurements.upload(robot, file) for file in files]
                found = []
                for at_once in (1, 2):
                    with workers(address, processors[:at_once]):
                        found.append(shortest(client, robot.id, [run.id for run in runs], asked.times))
        finally:
            scheduler.kill()
            scheduler.wait()
    (alone, one), (together, other) = found
    rows = [("workers", "time", "times faster"), ("1", f"{alone:.1f} s", "")]
    show("Identified", [*rows, ("2", f"{together:.1f} s", f"{alone / together:.2f}")])
    sys.exit(0 if np.allclose(one, other, rtol=SAME, atol=0.0) else 1)


def begun(program: str, *arguments: str) -> subprocess.Popen[bytes]:
    """A process of a cluster."""
    command = [sys.executable, "-m", f"distributed.cli.{program}", *arguments, "--dashboard-address", "127.0.0.1:0"]
    quiet = {**os.environ, "DASK_DISTRIBUTED__LOGGING__DISTRIBUTED": "error", "DYNIDENT_LOG_LEVEL": "error"}
    return subprocess.Popen(command, env=quiet, cwd=tempfile.gettempdir())


@contextmanager
def workers(address: str, processors: Sequence[int]) -> Iterator[None]:
    """A worker on each of these processors."""
    processes = []
    with Watch(address, timeout="60s", set_as_default=False) as watch:
        try:
            for processor in processors:
                processes.append(begun("dask_worker", address, "--nthreads", "1", "--no-nanny"))
                os.sched_setaffinity(processes[-1].pid, {processor})
            watch.wait_for_workers(len(processors), timeout="120s")
            yield
        finally:
            for process in processes:
                process.terminate()
                process.wait()
            while watch.nthreads():
                time.sleep(0.1)


def shortest(client: Client, robot: str, runs: Sequence[str], times: int) -> tuple[float, list[float]]:
    """Seconds of the shortest of so many identifications, after one that loads what is loaded once; and its values."""
    took: list[float] = []
    for _ in range(1 + times):
        began = time.monotonic()
        found = client.identifications.create(robot, runs).wait()
        took.append(time.monotonic() - began)
    return min(took[1:]), [one["value"] for one in found.result["parameters"]]


if __name__ == "__main__":
    main()
