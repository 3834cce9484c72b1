"""An object store that speaks S3, as a process beside the tests."""

from __future__ import annotations

import os
import shutil
import subprocess
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import obstore
import pytest
from obstore.store import from_url
from service_helpers import free_port, wait_for

BUCKET = "s3://dynident"


class S3:
    """A server with one bucket; its objects are also reached without the code under test."""

    def __init__(self, address: str) -> None:
        self.address = address

    def write(self, path: str, content: bytes | None) -> None:
        """Put an object, whatever its name says of it, or remove it."""
        store = from_url(BUCKET)
        if content is None:
            obstore.delete(store, path)
        else:
            obstore.put(store, path, content)

    def requests(self, log: Path) -> list[str]:
        """What was asked of it so far, a line each."""
        return log.read_text(errors="replace").splitlines()

    @property
    def environment(self) -> dict[str, str]:
        """What a service needs to find it."""
        return {
            "AWS_ENDPOINT_URL": self.address,
            "AWS_ALLOW_HTTP": "true",
            "AWS_REGION": "us-east-1",
            "AWS_ACCESS_KEY_ID": "dynident",
            "AWS_SECRET_ACCESS_KEY": "secret",
        }


@contextmanager
def s3_server(log: Path) -> Iterator[S3]:
    """Start moto's server; skips where there is none.

    It needs an older python-dateutil than the project is locked to, so it lives in an environment of its own:
    `python -m venv s3 && s3/bin/pip install 'moto[s3]' flask flask-cors`, with s3/bin at the end of PATH.
    """
    program = shutil.which("moto_server")
    if program is None:
        pytest.skip("moto_server is not on PATH: NOTHING OF S3 IS TESTED (tests/service/s3_server.py says how)")
    port = free_port()
    # Its own packages, not those of the tests.
    environment = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "PYTHONHOME")}
    with log.open("wb") as written:
        command = [program, "-H", "127.0.0.1", "-p", str(port)]
        server = subprocess.Popen(command, stdout=written, stderr=subprocess.STDOUT, env=environment)
    try:
        found = S3(f"http://127.0.0.1:{port}")

        def made() -> bool:
            with suppress(OSError):
                request = urllib.request.Request(f"{found.address}/dynident", method="PUT")
                urllib.request.urlopen(request, timeout=10).close()
                return True
            return False

        wait_for(made, 60.0)
        yield found
    finally:
        server.kill()
        server.wait()
