"""Keep secrets (keys, database password) out of the environment that child processes can read.

The system shows the environment with which a process was started as long as it lives (/proc/PID/environ on Linux), so
whatever can be made to read a file can read it. The service therefore restarts itself without its secrets and receives
them through an anonymous file. The process that forks children gets those that it needs in the same way.
"""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from tempfile import TemporaryFile

HANDED_OVER = "DYNIDENT_SECRETS_FD"
"""Variable with the descriptor of the file that holds the secrets."""
KEYS = "DYNIDENT_API_KEYS"
OUR_OWN = frozenset({KEYS, "DYNIDENT_DATABASE_URL", "DYNIDENT_OBJECT_STORE_URL"})
"""Secrets that children do not need: a job is told where its data is."""
_SECRET = re.compile(
    r"(AWS|AZURE|GOOGLE|PG|POSTGRES|OTEL_EXPORTER)\w*|\w*(KEY|SECRET|TOKEN|PASSWORD|PASSWD|CREDENTIAL)\w*", re.I
)
"""Names of variables that hold secrets, or may: those of stores and databases, and common ones."""
_PASSWORD_IN_ADDRESS = re.compile(r"://[^/\s@]*:[^/\s@]*@")


def is_secret(name: str, value: str = "") -> bool:
    """Return whether a variable may hold a secret, by its name or because its value is an address with a password."""
    return name in OUR_OWN or bool(_SECRET.fullmatch(name) or _PASSWORD_IN_ADDRESS.search(value))


def hide_secrets() -> None:
    """Restart this program without secrets in its environment; call it before anything else.

    Without secrets, or without anonymous files (on other systems than Linux), it does nothing. In the restarted process
    it puts the secrets back into `os.environ`, which no other process sees.
    """
    handle = os.environ.pop(HANDED_OVER, None)
    if handle is not None:
        os.environ.update(_read(int(handle)))
        return
    secrets = {name: value for name, value in os.environ.items() if is_secret(name, value)}
    if not secrets or not hasattr(os, "memfd_create"):
        return
    # Anonymous memory without the close-on-exec flag: the restarted program inherits it, and no path leads to it.
    file = os.memfd_create("secrets", 0)
    _write(file, secrets)
    os.set_inheritable(file, True)
    public = {name: value for name, value in os.environ.items() if name not in secrets}
    # execve drops what Python has buffered.
    sys.stdout.flush()
    sys.stderr.flush()
    os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], {**public, HANDED_OVER: str(file)})


def forget_keys() -> None:
    """Remove the accepted API keys from the environment, once the settings hold their hashes."""
    os.environ.pop(KEYS, None)


def build_child_environment() -> dict[str, str]:
    """Return the environment of a child process, which is this one's without secrets."""
    return {name: value for name, value in os.environ.items() if not is_secret(name, value)}


@contextmanager
def open_child_secrets() -> Iterator[int]:
    """Open a file with the secrets of stores and databases, to be the standard input of a child process."""
    needed = {name: value for name, value in os.environ.items() if is_secret(name, value) and name not in OUR_OWN}
    with open(os.memfd_create("secrets"), "r+b") if hasattr(os, "memfd_create") else TemporaryFile() as file:
        _write(file.fileno(), needed)
        yield file.fileno()


def take_secrets() -> None:
    """Read the secrets of a child process from its standard input, and close that."""
    os.environ.update(_read(os.dup(0)))
    # The place of the standard input is taken by an empty file: another file opened later must not get its number.
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)


def forget_secrets() -> None:
    """Remove all secrets from the environment of this process."""
    for name, value in list(os.environ.items()):
        if is_secret(name, value):
            del os.environ[name]


def _write(handle: int, secrets: Mapping[str, str]) -> None:
    with open(handle, "wb", closefd=False) as file:
        file.write(json.dumps(secrets).encode())
    # The reader shares the position in the file: it begins where the writer leaves it.
    os.lseek(handle, 0, os.SEEK_SET)


def _read(handle: int) -> dict[str, str]:
    with open(handle, "rb") as file:
        secrets: dict[str, str] = json.loads(file.read() or b"{}")
    return secrets
