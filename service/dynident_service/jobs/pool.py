"""Child processes kept warm: started ahead, used for one job at a time, killed as a group, replaced."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Iterator
from multiprocessing.connection import Connection

from dynident_service.jobs.child import Order, Receipt

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
MEMORY_LIMIT = 2_000_000_000
"""A child that once needed more is replaced after its job: freed memory seldom goes back to the system."""


class Child:
    """One child process and the pipe to it."""

    def __init__(self) -> None:
        ours, theirs = socket.socketpair()
        lifeline, self._lifeline = os.pipe()
        try:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "dynident_service.jobs.child", str(theirs.fileno()), str(lifeline)],
                pass_fds=(theirs.fileno(), lifeline),
                stdin=subprocess.DEVNULL,
                env={**os.environ, **ONE_THREAD},
                start_new_session=True,
            )
        finally:
            theirs.close()
            os.close(lifeline)
        self._connection = Connection(ours.detach())

    def send(self, order: Order) -> None:
        """Give it a job; it begins when it has started up."""
        self._connection.send(order)

    def receive(self, timeout: float) -> Receipt | None:
        """Wait for the end of the job; `None` after the timeout, EOFError if the process died."""
        try:
            if not self._connection.poll(timeout):
                return None
            receipt = self._connection.recv()
        except OSError as error:
            raise EOFError from error
        assert isinstance(receipt, Receipt)
        return receipt

    def kill(self) -> int | None:
        """Kill its process group; gives the exit code that it had by itself, if it had ended before."""
        ended_with = self.process.poll()
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        self._connection.close()
        os.close(self._lifeline)
        return ended_with


class ChildPool:
    """Idle children; the one that worked last is taken first, as it remembers most."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._idle: deque[Child] = deque()
        self._busy: set[Child] = set()
        self._lock = threading.Condition()
        self._users = 0
        self.closed = False
        for _ in range(size):
            self._idle.append(Child())

    def take(self) -> Child:
        """Give an idle child, or start one."""
        with self._lock:
            child = None
            while self._idle and child is None:
                child = self._idle.pop()
                if child.process.poll() is not None:
                    child.kill()
                    child = None
            child = child or Child()
            self._busy.add(child)
            return child

    def put_back(self, child: Child, receipt: Receipt) -> None:
        """Take back a child whose job has ended."""
        if receipt.peak_memory > MEMORY_LIMIT or len(self._idle) >= self._size:
            self.replace(child)
            return
        with self._lock:
            self._busy.discard(child)
            if not self.closed:
                self._idle.append(child)
                return
        child.kill()

    def replace(self, child: Child) -> int | None:
        """Kill a child, and start another in its stead; gives the exit code if it had died by itself."""
        with self._lock:
            self._busy.discard(child)
        ended_with = child.kill()
        with self._lock:
            if not self.closed and len(self._idle) + len(self._busy) < self._size:
                self._idle.appendleft(Child())
        return ended_with

    @contextlib.contextmanager
    def in_use(self) -> Iterator[None]:
        """Mark that somebody supervises a child, so that `close` waits for what is still to be written down."""
        with self._lock:
            self._users += 1
        try:
            yield
        finally:
            with self._lock:
                self._users -= 1
                self._lock.notify_all()

    def close(self, patience: float = 5.0) -> None:
        """Kill all children, and wait until those who supervised one have written down that it is gone."""
        with self._lock:
            self.closed = True
            idle, self._idle = list(self._idle), deque()
            busy = list(self._busy)
        for child in idle:
            child.kill()
        for child in busy:  # its supervisor closes the pipe
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child.process.pid, signal.SIGKILL)
        with self._lock:
            self._lock.wait_for(lambda: self._users == 0, patience)
