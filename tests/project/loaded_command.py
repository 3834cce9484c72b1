"""The command `dynident` for a shell, in a process that has loaded what each would load anew: it forks one for each.

That the installed command loads what it needs is told by the tests that start it.
"""

from __future__ import annotations

import importlib
import json
import os
import signal
import socket
import subprocess
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

COMMAND = """#!{python} -IS
import json, os, socket, sys
with socket.socket(socket.AF_UNIX) as line:
    line.connect({address!r})
    asked = json.dumps([sys.argv[1:], os.getcwd(), dict(os.environ)]).encode()
    socket.send_fds(line, [len(asked).to_bytes(4, "big")], [0, 1, 2])
    line.sendall(asked)
    sys.exit(int(line.recv(16) or b"1"))
"""


@contextmanager
def loaded_command(folder: Path) -> Iterator[Path]:
    """Give a folder, for PATH, with the command."""
    address = str(folder / "line")
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(address)
        listening.listen()
        command = folder / "dynident"
        command.write_text(COMMAND.format(python=sys.executable, address=address), encoding="utf-8")
        command.chmod(0o755)
        given = listening.fileno()
        process = subprocess.Popen([sys.executable, __file__, str(given)], pass_fds=(given,), start_new_session=True)
    try:
        yield folder
    finally:
        process.kill()
        process.wait()


def serve(listening: socket.socket) -> None:
    """Do what is asked, one after the other or at the same time."""
    importlib.import_module("dynident_cli.program_and_exit_codes").create_application()
    for module in importlib.import_module("dynident_service.jobs.fork_server_main").PRELOADED:
        importlib.import_module(module)
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    while True:
        line, _ = listening.accept()
        with line:
            if os.fork() == 0:
                _become(line)


def _become(line: socket.socket) -> None:
    """Do a command in this process, as its caller would see it, and end."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    size, fds, _, _ = socket.recv_fds(line, 4, 3)
    with line.makefile("rb") as told:
        arguments, folder, environment = json.loads(told.read(int.from_bytes(size, "big")))
    for ours, theirs in enumerate(fds):
        os.dup2(theirs, ours)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = ["dynident", *arguments]
    from dynident_cli.__main__ import main

    code: object = 1
    try:
        main()
        code = 0
    except SystemExit as end:
        code = end.code or 0
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        line.sendall(str(code if isinstance(code, int) else 1).encode())
        os._exit(0)


if __name__ == "__main__":
    serve(socket.socket(fileno=int(sys.argv[1])))
