"""Pool of warm child processes: started ahead, used for one job at a time, killed as a group, replaced."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import socket
import tempfile
import threading
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path

from dynident_service.jobs.confinement import Confinement
from dynident_service.jobs.fork_server import ForkServer, ProcessExit
from dynident_service.jobs.messages import Answer, Call, Hello, JobOrder, Receipt

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

    Parameters
    ----------
    size : int
        Number of children.
    fork_server : ForkServer
        Process that forks them.
    confinement : Confinement, optional
        Limits of each child.
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

    @contextlib.contextmanager
    def mark_in_use_if_spare(self) -> Iterator[bool]:
        """Do the same only if a child is free, and yield whether it is so."""
        with self._lock:
            spare = self._users < self._size and not self.closed
            self._users += spare
        try:
            yield spare
        finally:
            with self._lock:
                self._users -= spare
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
