"""Hostile and damaged files of every format, sent to a service in a process of its own, which is watched meanwhile."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx2
import pytest
from service_helpers import free_port, wait_for
from support.file_mutations import DESCRIPTIONS, FILE_NAMES, JOINTS, MESHES, MUTABLE_FILES, URDF, mutant
from support.hostile_files import gltf, hostile_files

pytestmark = pytest.mark.slow

SECRET = "the secret of another file on this machine"
MAIN_PROCESS = 600_000_000
"""Bytes of resident memory that the process which answers may have."""
CHILD = 2_300_000_000
"""The same of a child: what is loaded, 1.5 GB, and what the allocator keeps beside it."""
LONGEST = 60.0
"""Seconds after which an answer counts as a hang, beside whatever else the machine does."""
REFUSED = (413, 422, 429)
MESHED = URDF.replace('<box size=".1 .2 .3"/>', '<mesh filename="package://arm/part.stl"/>')


def memory_of(pid: int) -> int:
    """Bytes of the largest resident memory that a process has had; 0 where it has ended."""
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return 0
    return next((1024 * int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM")), 0)


@dataclass
class Descendants:
    """Processes that were started by a process, or by those that it started, whenever one looks."""

    pid: int
    parents: dict[int, int] = field(default_factory=dict)

    def list_running(self) -> list[int]:
        running = {int(name) for name in os.listdir("/proc") if name.isdigit()}
        # A process is asked for its parent once: to ask all of a machine takes a tenth of a processor from the service.
        for pid in running - self.parents.keys():
            with suppress(OSError):
                self.parents[pid] = int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
        self.parents = {pid: parent for pid, parent in self.parents.items() if pid in running}
        found, new = [], [self.pid]
        while new:
            new = [pid for pid, parent in self.parents.items() if parent in new]
            found += new
        return found


@dataclass
class Watched:
    """A service in a process of its own: what its processes took, and what it answered."""

    process: subprocess.Popen[bytes]
    client: httpx2.Client
    data: Path
    log: Path
    peaks: dict[str, int] = field(default_factory=lambda: {"main": 0, "child": 0})
    slowest: float = 0.0
    answers: Counter[int] = field(default_factory=Counter)
    is_over: threading.Event = field(default_factory=threading.Event)

    def watch(self) -> None:
        """Look at the memory of all its processes until it is over."""
        descendants = Descendants(self.process.pid)
        while not self.is_over.wait(0.05):
            self.peaks["main"] = max(self.peaks["main"], memory_of(self.process.pid))
            children = [memory_of(pid) for pid in descendants.list_running()]
            self.peaks["child"] = max([self.peaks["child"], *children])

    def ask(self, method: str, path: str, **what: Any) -> httpx2.Response:
        """Send a request; checks what holds of every answer."""
        began = time.monotonic()
        answer = self.client.request(method, path, **what)
        self.slowest = max(self.slowest, time.monotonic() - began)
        self.answers[answer.status_code] += 1
        failed = answer.status_code >= 500 and answer.status_code != 507
        assert not failed, (answer.text, self.log.read_text(errors="replace")[-3000:])
        assert "Traceback" not in answer.text
        assert SECRET not in answer.text
        return answer

    def files(self) -> list[str]:
        """What lies among the uploads and temporary files."""
        folders = (self.data / "uploads", self.data / "processes")
        return [str(path) for folder in folders for path in folder.rglob("*") if path.is_file()]


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Watched]:
    folder = tmp_path_factory.mktemp("hostile")
    port, log = free_port(), folder / "log"
    variables = {
        "DYNIDENT_DATA_DIR": str(folder / "data"),
        "DYNIDENT_PORT": str(port),
        "DYNIDENT_WORKERS": "1",
        "DYNIDENT_LOG_LEVEL": "warning",
        # What is looked for in answers; and a name that stands for the keys of a store.
        "AWS_SECRET_ACCESS_KEY": SECRET,
    }
    with log.open("wb") as file:
        process = subprocess.Popen(
            [sys.executable, "-m", "dynident_service"], env={**os.environ, **variables}, stderr=file, stdout=file
        )
    client = httpx2.Client(base_url=f"http://127.0.0.1:{port}", timeout=120)
    watched = Watched(process, client, folder / "data", log)
    try:
        wait_for(lambda: _is_ready(client), timeout=120)
        watching = threading.Thread(target=watched.watch)
        watching.start()
        yield watched
        watched.is_over.set()
        watching.join()
    finally:
        process.kill()
        process.wait()


def _is_ready(client: httpx2.Client) -> bool:
    try:
        return client.get("/readyz").status_code == 200
    except httpx2.HTTPError:
        return False


@pytest.fixture(scope="module")
def robot(service: Watched) -> str:
    body = {"name": "arm", "description": {"format": "urdf", "content": MESHED}}
    return str(service.ask("POST", "/v1/robots", json=body).json()["id"])


def send(service: Watched, robot: str, kind: str, name: str, content: bytes) -> httpx2.Response:
    """Send a file as what it is: a description, a mesh, or a recording, whose signals are asked for, too."""
    if kind in ("urdf", "mjcf", "modified_dh"):
        text = content.decode("utf-8", errors="replace")
        body = {"name": "sent", "description": {"format": kind, "content": text}}
        return service.ask("POST", "/v1/robots", content=json.dumps(body).encode(), headers=JSON)
    if kind == "mesh":
        files = {"files": (f"part{Path(name).suffix}", io.BytesIO(content))}
        answer = service.ask("PUT", f"/v1/robots/{robot}/meshes", files=files)
        service.ask("GET", f"/v1/robots/{robot}/geometry")
        return answer
    service.ask("POST", "/v1/imports", files={"file": (name, io.BytesIO(content))}, data=_said(robot, {}))
    columns = {"t": "t"} | {
        f"{kind}{k + 1}": f"{kind}_{joint}" for kind in ("q", "tau") for k, joint in enumerate(JOINTS)
    }
    answer = service.ask(
        "POST", "/v1/measurements", files={"file": (name, io.BytesIO(content))}, data=_said(robot, {"columns": columns})
    )
    if answer.status_code == 422:
        answer = service.ask(
            "POST", "/v1/measurements", files={"file": (name, io.BytesIO(content))}, data=_said(robot, {})
        )
    if answer.status_code == 201:
        for signals in ("leak", "q1,tau1", ""):
            service.ask("GET", f"/v1/measurements/{answer.json()['id']}/raw", params={"signals": signals})
    return answer


JSON = {"content-type": "application/json"}


def _said(robot: str, more: dict[str, Any]) -> dict[str, str]:
    return {"metadata": json.dumps({"robot_id": robot, "name": "sent", **more})}


def kind_of(name: str) -> str:
    endings = {".urdf": "urdf", ".xml": "mjcf", ".json": "modified_dh"}
    meshes = (".stl", ".obj", ".ply", ".dae", ".gltf", ".glb", ".off", ".3mf")
    return "mesh" if Path(name).suffix in meshes else endings.get(Path(name).suffix, "recording")


def test_every_hostile_file_is_refused_with_its_reason_or_does_no_harm(
    service: Watched, robot: str, tmp_path: Path, thorough: bool
) -> None:
    outside = tmp_path / "outside.txt"
    outside.write_text(SECRET * 1000)
    files = hostile_files(str(outside))
    assert len(files) >= 60
    # What reads them is told about each without the service, in `tests/recordings/test_hostile_files.py`.
    for file in files if thorough else files[::3]:
        answer = send(service, robot, kind_of(file.file_name), file.file_name, file.content)
        assert answer.status_code in (*REFUSED, 200, 201, 507), (file.name, answer.text)
        if answer.status_code >= 400:
            assert len(answer.json()["detail"]) > 20, file.name
    _assert_unharmed(service)


def test_a_mesh_brings_nothing_of_another_file(service: Watched, robot: str, tmp_path: Path) -> None:
    outside = tmp_path / "floats"
    outside.write_bytes(bytes(range(200)) * 10)
    for name in ("part.stl", "part.gltf", "part.obj"):
        answer = send(service, robot, "mesh", name, gltf(f"../../..{outside}"))
        assert answer.status_code == 422


@pytest.mark.sweep
@pytest.mark.parametrize("kind", MUTABLE_FILES)
def test_no_damaged_file_harms_the_service(service: Watched, robot: str, kind: str, thorough: bool) -> None:
    content = MUTABLE_FILES[kind]()
    what = kind if kind in DESCRIPTIONS else "mesh" if kind in MESHES else "recording"
    before = service.answers.copy()
    for number in range(2000 if thorough else 25):
        send(service, robot, what, FILE_NAMES[kind], mutant(kind, 11, number, content))
    print(kind, dict(service.answers - before), f"slowest {service.slowest:.1f} s", service.peaks)
    _assert_unharmed(service)


def _assert_unharmed(service: Watched) -> None:
    assert service.process.poll() is None
    assert service.slowest < LONGEST
    assert 0 < service.peaks["main"] < MAIN_PROCESS
    assert 0 < service.peaks["child"] < CHILD
    # An answer's files are removed once it has been sent, which the client may see before.
    assert wait_for(lambda: not service.files(), timeout=10), service.files()
    assert wait_for(lambda: _is_ready(service.client), timeout=10)
    assert service.ask("GET", "/v1/robots").status_code == 200
