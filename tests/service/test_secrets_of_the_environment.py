"""No process of the service shows its secrets, and children have those alone that they need."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import httpx2
import pytest
from fork_servers import WithoutScience
from service_helpers import free_port, wait_for

from dynident_service import environment_secrets
from dynident_service.jobs.child_pool import ChildProcess
from dynident_service.jobs.confinement import Confinement
from dynident_service.jobs.task_input_output import Answer, Call
from dynident_service.settings import Settings

KEY, STORE, PASSWORD = "open-sesame", "secret-of-the-store", "password-of-the-proxy"
SECRETS = {
    "DYNIDENT_API_KEYS": json.dumps([KEY]),
    "AWS_SECRET_ACCESS_KEY": STORE,
    "HTTPS_PROXY": f"http://user:{PASSWORD}@proxy.example:3128",
}
STARTS = [
    ["-m", "dynident_service"],
    pytest.param(["-m", "dynident_cli", "serve"], marks=pytest.mark.slow),
]

pytestmark = pytest.mark.skipif(not hasattr(os, "memfd_create"), reason="only Linux shows environments")


@pytest.fixture(params=STARTS)
def service(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[int, str]]:
    """A service that was started with secrets in its environment: its process and its address."""
    port = free_port()
    variables = {
        **SECRETS,
        "DYNIDENT_DATA_DIR": str(tmp_path / "data"),
        "DYNIDENT_PORT": str(port),
        "DYNIDENT_WORKERS": "1",
        "DYNIDENT_REQUIRE_KEYS": "true",
    }
    process = subprocess.Popen([sys.executable, *request.param], env={**os.environ, **variables})
    try:
        address = f"http://127.0.0.1:{port}"
        wait_for(lambda: status(f"{address}/readyz") == 200, timeout=60)
        yield process.pid, address
    finally:
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=60) == 0


def status(url: str, **headers: str) -> int | None:
    try:
        return int(httpx2.get(url, headers=headers, timeout=10).status_code)
    except httpx2.HTTPError:
        return None


def family(pid: int) -> list[int]:
    """A process and all that descend from it."""
    children: dict[int, list[int]] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
        except OSError:
            continue  # it has ended
        children.setdefault(parent, []).append(int(folder.name))
    found, left = [pid], [pid]
    while left:
        found += children.get(left[-1], [])
        left += children.get(left.pop(), [])
    return found


def open_files(pid: int) -> list[str]:
    """What the descriptors of a process lead to; those that close meanwhile are left out."""
    targets = []
    for descriptor in Path(f"/proc/{pid}/fd").iterdir():
        with suppress(FileNotFoundError):
            targets.append(os.readlink(descriptor))
    return targets


def test_no_process_of_the_service_shows_a_secret(service: tuple[int, str]) -> None:
    pid, address = service
    assert status(f"{address}/v1/robots", **{"x-api-key": KEY}) == 200
    assert status(f"{address}/v1/robots", **{"x-api-key": "another"}) == 401
    processes = wait_for(
        lambda: len(family(pid)) >= 4 and family(pid)
    )  # one to fork from, one of a job, two of requests
    for process in processes:
        shown = Path(f"/proc/{process}/environ").read_bytes()
        assert b"DYNIDENT_DATA_DIR" in shown or b"OMP_NUM_THREADS" in shown
        for secret in (KEY, STORE, PASSWORD):
            assert secret.encode() not in shown
        assert not [file for file in open_files(process) if "memfd:secrets" in file]


def test_a_child_has_what_it_needs_and_not_the_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {**SECRETS, "DYNIDENT_DATABASE_URL": "postgresql://user:word@host/name"}.items():
        monkeypatch.setenv(name, value)
    nursery = WithoutScience()
    child = ChildProcess(nursery, Confinement())
    try:
        child.send(Call("small_jobs:variables", {"names": [*SECRETS, "DYNIDENT_DATABASE_URL", "PATH"]}))
        answer = wait_for(lambda: child.receive(1.0), timeout=60)
    finally:
        child.kill()
        nursery.close()
    assert isinstance(answer, Answer)
    told = answer.value
    assert (told["DYNIDENT_API_KEYS"], told["DYNIDENT_DATABASE_URL"]) == (None, None)
    assert (told["AWS_SECRET_ACCESS_KEY"], told["HTTPS_PROXY"]) == (STORE, SECRETS["HTTPS_PROXY"])
    assert told["PATH"] == os.environ["PATH"]
    assert told["standard input"] == ""


def test_the_settings_keep_the_hashes_of_keys_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DYNIDENT_API_KEYS", SECRETS["DYNIDENT_API_KEYS"])
    (kept,) = Settings().api_keys
    assert KEY not in kept.get_secret_value()
    environment_secrets.forget_keys()
    assert "DYNIDENT_API_KEYS" not in os.environ


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("DYNIDENT_DATABASE_URL", "", True),
        ("AWS_ACCESS_KEY_ID", "", True),
        ("SOME_TOKEN", "", True),
        ("http_proxy", "http://user:word@proxy", True),
        ("http_proxy", "http://proxy:3128", False),
        ("PATH", "/usr/bin:/bin", False),
        ("DYNIDENT_DATA_DIR", "/data", False),
    ],
)
def test_secrets_are_told_by_their_names_or_as_addresses_with_passwords(name: str, value: str, expected: bool) -> None:
    assert environment_secrets.is_secret(name, value) == expected
