"""The fork server and the pool of warm child processes; memory after which one is replaced (2 GB).

A child of the pool is started ahead, used for one job at a time, killed as a group and replaced. What runs in the fork
server's process is in `fork_server_main`; it is kept apart so that what children do is not imported here.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import ClassVar, NamedTuple

from dynident_service.environment_secrets import build_child_environment, open_child_secrets
from dynident_service.jobs.confinement import Confinement
from dynident_service.jobs.task_input_output import Answer, Call, Hello, JobOrder, Receipt

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment that keeps linear algebra to one thread, as a process that forks must not have others."""
BOUNDED_ARROW = {"ARROW_DEFAULT_MEMORY_POOL": "system"}
"""Environment for Arrow, whose own allocator reserves 1 GB of addresses at once; limits of children would count it."""
MESSAGE = struct.Struct("!iiq")
"""Message in both directions: kind, process id or exit code, and peak memory."""
FORK, REAP, LOOK = 1, 2, 3
RUNNING = 1 << 20
"""Exit code that stands for a process that still runs."""


class ProcessExit(NamedTuple):
    """End of a process: its exit code, negative for a signal, and its peak memory in bytes."""

    code: int
    peak_memory: int


class ForkServer:
    """Client of the process that forks children; starts it when it is needed."""

    PROGRAM: ClassVar[Sequence[str]] = ("-m", "dynident_service.jobs.fork_server_main")
    """Arguments of Python that run `fork_server_main.main`; tests put code before it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._control: socket.socket | None = None

    def fork(self, jobs: int, lifeline: int) -> None:
        """Fork a child that serves the pipe `jobs`; it appears once the science is imported.

        Closing the pipe `lifeline` ends the child.
        """
        with self._lock:
            try:
                self._send_fork(jobs, lifeline)
            except OSError:  # it has died: begin with a new one
                self._stop()
                self._send_fork(jobs, lifeline)

    def get_exit(self, pid: int, *, reap: bool) -> ProcessExit | None:
        """Return how a child ended; None while it runs, or if the fork server itself has died.

        With `reap` the child is waited for, after which its process id may be used again; only then its peak memory is
        known.
        """
        with self._lock:
            if self._control is None:
                return None
            try:
                self._control.sendall(MESSAGE.pack(REAP if reap else LOOK, pid, 0))
                _, code, peak_memory = MESSAGE.unpack(receive_exactly(self._control))
            except OSError:
                return None
        return None if code == RUNNING else ProcessExit(code, peak_memory)

    def close(self) -> None:
        """End the process."""
        with self._lock:
            self._stop()

    def _send_fork(self, jobs: int, lifeline: int) -> None:
        control = self._control or self._start()
        socket.send_fds(control, [MESSAGE.pack(FORK, 0, 0)], [jobs, lifeline])

    def _start(self) -> socket.socket:
        ours, theirs = socket.socketpair()
        with theirs, open_child_secrets() as secrets:
            self._process = subprocess.Popen(
                [sys.executable, *self.PROGRAM, str(theirs.fileno())],
                pass_fds=(theirs.fileno(),),
                stdin=secrets,
                env={**build_child_environment(), **ONE_THREAD, **BOUNDED_ARROW},
                start_new_session=True,
            )
        self._control = ours
        return ours

    def _stop(self) -> None:
        if self._control is not None:
            self._control.close()
            self._control = None
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None


def receive_exactly(control: socket.socket, size: int = MESSAGE.size) -> bytes:
    """Return the next `size` bytes of a socket; raise ConnectionError if its other end is closed before."""
    content = b""
    while len(content) < size:
        part = control.recv(size - len(content))
        if not part:
            raise ConnectionError("the other end is closed")
        content += part
    return content


MEMORY_LIMIT = 2_000_000_000
"""Bytes of peak memory after which a child is replaced: freed memory seldom returns to the system."""


class ChildProcess:
    """Child process and the pipe to it."""

    def __init__(self, fork_server: ForkServer, confinement: Confinement) -> None:
        self._fork_server = fork_server
        self.pid: int | None = None
        self.heartbeats = 0
        self._scratch = _make_scratch(confinement.scratch)
        ours, theirs = socket.socketpair()
        # The child holds the other end of this pipe: when this process ends, however that happens, the child is killed.
        lifeline, self._lifeline = os.pipe()
        try:
            fork_server.fork(theirs.fileno(), lifeline)
        finally:
            theirs.close()
            os.close(lifeline)
        self._connection = Connection(ours.detach())
        with contextlib.suppress(EOFError):  # whoever gives it something to do finds that it has died
            self._send(replace(confinement, scratch=self._scratch))

    def send(self, order: JobOrder | Call) -> None:
        """Send a job or call, which begins when the child has started; raise EOFError if the process died."""
        self._send(order)

    def _send(self, message: Confinement | JobOrder | Call) -> None:
        try:
            self._connection.send(message)
        except OSError as error:  # a broken pipe, or one that was reset
            raise EOFError from error

    def receive(self, timeout: float) -> Receipt | Answer | None:
        """Wait for the end of a job or call; return None after `timeout` seconds, raise EOFError if the child died."""
        # Heartbeats arrive in between; they do not extend the time.
        until = time.monotonic() + timeout
        while True:
            try:
                if not self._connection.poll(max(0.0, until - time.monotonic())):
                    return None
                received = self._connection.recv()
            except OSError as error:
                raise EOFError from error
            if isinstance(received, Receipt | Answer):
                return received
            self.heartbeats += 1
            if isinstance(received, Hello):
                self.pid = received.pid

    def is_alive(self) -> bool:
        """Return whether an idle child still runs."""
        try:
            self.receive(0.0)
        except EOFError:
            return False
        return True

    def kill_process_group(self) -> None:
        """Kill the process group, if it has begun."""
        if self.pid is not None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.pid, signal.SIGKILL)

    def kill(self) -> ProcessExit | None:
        """Kill the process group, and return how the process ended if it had ended by itself before."""
        with contextlib.suppress(EOFError):
            self.receive(0.0)  # its Hello, with the process id, may have arrived
        ended = None
        if self.pid is not None:
            had_ended = self._fork_server.get_exit(self.pid, reap=False) is not None
            self.kill_process_group()
            end = self._fork_server.get_exit(self.pid, reap=True)
            # A process that was just ending closes its pipe first; it then has an exit code other than our signal.
            if end is not None and (had_ended or end.code != -signal.SIGKILL):
                ended = end
        self._connection.close()
        os.close(self._lifeline)  # the kernel kills one that has not begun yet
        if self._scratch is not None:
            shutil.rmtree(self._scratch, ignore_errors=True)
        return ended


def _make_scratch(folder: Path | None) -> Path | None:
    """Create a folder for the temporary files of one child."""
    if folder is None:
        return None
    folder.mkdir(parents=True, exist_ok=True)
    return Path(tempfile.mkdtemp(dir=folder))


class ChildPool:
    """Pool of idle children.

    The fork server outlives the pool. The child that worked last is taken first, as its caches are the most useful.
    """

    def __init__(self, size: int, fork_server: ForkServer, confinement: Confinement | None = None) -> None:
        self._size = size
        self.confinement = confinement or Confinement()
        self._idle: deque[ChildProcess] = deque()
        self._busy: set[ChildProcess] = set()
        self._lock = threading.Condition()
        self._users = 0
        self.closed = False
        self._fork_server = fork_server
        for _ in range(size):
            self._idle.append(ChildProcess(self._fork_server, self.confinement))

    def take(self) -> ChildProcess:
        """Return an idle child, or start one."""
        with self._lock:
            child = None
            while self._idle and child is None:
                child = self._idle.pop()
                if not child.is_alive():
                    child.kill()
                    child = None
            child = child or ChildProcess(self._fork_server, self.confinement)
            self._busy.add(child)
            return child

    def put_back(self, child: ChildProcess, receipt: Receipt | Answer) -> None:
        """Take back a child whose job has ended."""
        # The allocator keeps freed memory, so a child that once needed much would hold it for good.
        if receipt.peak_memory > MEMORY_LIMIT or len(self._idle) >= self._size:
            self.replace(child)
            return
        with self._lock:
            self._busy.discard(child)
            if not self.closed:
                self._idle.append(child)
                return
        child.kill()

    def replace(self, child: ChildProcess) -> ProcessExit | None:
        """Kill a child and start another one; return how it ended if it had died by itself."""
        with self._lock:
            self._busy.discard(child)
        ended = child.kill()
        with self._lock:
            if not self.closed and len(self._idle) + len(self._busy) < self._size:
                self._idle.appendleft(ChildProcess(self._fork_server, self.confinement))
        return ended

    @contextlib.contextmanager
    def mark_in_use(self) -> Iterator[None]:
        """Mark that a child is supervised, so that `close` waits until its end is written into the queue."""
        with self._lock:
            self._users += 1
        try:
            yield
        finally:
            with self._lock:
                self._users -= 1
                self._lock.notify_all()

    def close(self, patience: float = 5.0) -> None:
        """Kill all children, and wait up to `patience` seconds until their supervisors have recorded it."""
        with self._lock:
            self.closed = True
            idle, self._idle = list(self._idle), deque()
            busy = list(self._busy)
        for child in idle:
            child.kill()
        for child in busy:  # its supervisor closes the pipe
            child.kill_process_group()
        with self._lock:
            self._lock.wait_for(lambda: self._users == 0, patience)
